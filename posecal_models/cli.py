"""The command ``posecal-models``: arguments, progress and exit codes, nothing else.

Exit codes: 0 done, 2 a wrong call, 3 files or settings that don't work (one message, no traceback), 130 interrupted.
PyTorch is imported by the commands that need it, so that ``--help`` is quick.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from posecal.errors import PosecalError

__all__ = ["app", "main"]

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Reference estimators of 3D pose distributions: train them, sample them, judge them with posecal evaluate.",
)

_Threads = Annotated[int, typer.Option(help="CPU threads; 0 leaves it to PyTorch.", min=0)]
_Device = Annotated[str, typer.Option(help="cpu, cuda, cuda:1 or auto.")]


@app.callback()
def _of_all_commands() -> None:
    pass


def main() -> None:
    """Run the command line."""
    try:
        app(standalone_mode=True)
    except PosecalError as problem:
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"posecal-models: {problem}", markup=False)
        sys.exit(3)
    except KeyboardInterrupt:
        sys.exit(130)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    import torch

    if count:
        torch.set_num_threads(count)
    yield


@app.command()
def train(
    config: Annotated[str, typer.Argument(help="A named configuration or a TOML file.")],
    data: Annotated[Path, typer.Option(help="Motion capture or pairs of poses and keypoints, .npz.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder of the training.")],
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help='Change a setting, e.g. --set train.epochs=20 or model.scale="exp".'),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder's checkpoint.")] = False,
    device: _Device = "cpu",
    threads: _Threads = 0,
) -> None:
    """Train an estimator; stop and resume it at any time."""
    import torch

    from posecal_models.checkpoint import device_named
    from posecal_models.config import Config
    from posecal_models.distributed import crew_of_torchrun
    from posecal_models.preparation import prepare
    from posecal_models.progress import shown

    with _threads(threads), crew_of_torchrun(torch.device(device_named(device))) as crew:
        settings = Config.load(config).changed(change or [])
        run = prepare(settings, data, output, device=device_named(device), resume=resume, crew=crew)
        with shown(run) as on_step:
            run.run(on_step=on_step)


if __name__ == "__main__":
    main()
