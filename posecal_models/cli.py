"""The command ``posecal-models``: arguments, progress and exit codes.

Exit codes: 0 done, 2 a wrong call, 3 files or settings that don't work (one message, no traceback), 130 interrupted.
PyTorch is imported by the commands that need it, so that ``--help`` is quick.
"""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from posecal.cli.running import check_outputs
from posecal.errors import PosecalError, printable

__all__ = ["app", "main"]

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Reference estimators of 3D pose distributions: train and sample them, evaluate them with posecal evaluate.",
)

_CAPTURED_MOTION = Path(__file__).parent / "data" / "captured_motion.npz"
"""Eight clips of two seconds of subjects 3, 6 and 49. The data used in this project was obtained from mocap.cs.cmu.edu.
The database was created with funding from NSF EIA-0196217."""

_Output = Annotated[Path, typer.Option("--output", "-o", help="The file to write.")]
_Threads = Annotated[int, typer.Option(help="CPU threads; 0: PyTorch's default.", min=0)]
_Device = Annotated[str, typer.Option(help="cpu, cuda, cuda:1, xpu, mps or auto.")]
_Seed = Annotated[int, typer.Option(help="Random seed.", min=0, max=2**63 - 1)]


class Format(StrEnum):
    """Formats of other projects' data."""

    PROHPE = "prohpe"
    HUMAN36M = "human36m"
    VIDEOPOSE3D = "videopose3d"


class Experiment(StrEnum):
    """Zero-shot experiments: sets of observed nodes that are not in the training set."""

    PENDULUM = "pendulum"
    POSE_WORLD = "pose-world"


@app.callback()
def _callback() -> None:
    pass


def main() -> None:
    """Run the command line."""
    try:
        app()
    except PosecalError as problem:
        if os.environ.get("LOCAL_RANK", "0") == "0":  # all processes of a machine raise the same error: print it once
            _print_note(f"posecal-models: {problem}")
        sys.exit(3)
    except KeyboardInterrupt:
        sys.exit(130)


def _print_note(text: str) -> None:
    Console(stderr=True, highlight=False, soft_wrap=True).print(text, markup=False)


def _set_threads(count: int) -> None:
    import torch

    if count:
        torch.set_num_threads(count)


@app.command()
def train(
    config: Annotated[str, typer.Argument(help="A named configuration or a TOML file.")],
    data: Annotated[Path, typer.Option(help="Motion capture, or pairs of poses and keypoints, .npz.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Output folder.")],
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a setting, e.g. --set train.epochs=20 --set model.scale=exp."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Resume from the folder's checkpoint.")] = False,
    tensorboard: Annotated[Path | None, typer.Option(help="A folder for losses in TensorBoard's format.")] = None,
    device: _Device = "cpu",
    threads: _Threads = 0,
) -> None:
    """Train an estimator; a training can be stopped and resumed at any time."""
    from posecal_models.checkpoint import resolve_device
    from posecal_models.config import Config
    from posecal_models.distributed import torchrun_group
    from posecal_models.preparation import prepare
    from posecal_models.progress import training_progress
    from posecal_models.tensorboard import summary_writer, tensorboard_log
    from posecal_models.train import TrainingProgress

    if tensorboard is not None:
        summary_writer()  # before any work
    _set_threads(threads)
    settings = Config.load(config).with_changes(change or [])
    with torchrun_group(resolve_device(device)) as processes:
        run = prepare(settings, data, output, device=processes.device, resume=resume, processes=processes)
        with training_progress(run) as show, tensorboard_log(run, tensorboard) as log:

            def on_step(progress: TrainingProgress) -> None:
                show(progress)
                log(progress)

            run.run(on_step=on_step)


@app.command()
def sample(
    weights: Annotated[str, typer.Argument(help="Named weights or a .safetensors file.")],
    keypoints: Annotated[Path, typer.Argument(help="An .npz with keypoints_2d and their joints' names.")],
    output: _Output,
    n: Annotated[int, typer.Option(help="Hypotheses of each image.", min=1)] = 200,
    temperature: Annotated[float, typer.Option(help="Scale of the noise; 1: the distribution itself.", min=0)] = 1.0,
    mode: Annotated[bool, typer.Option("--mode", help="Write the mode, a single pose, instead of samples.")] = False,
    seed: _Seed = 0,
    device: _Device = "cpu",
    threads: _Threads = 0,
) -> None:
    """Sample hypotheses of every image into a file for posecal evaluate."""
    check_outputs(keypoints, Path(weights), output=output)
    from posecal.errors import first_few
    from posecal_models.checkpoint import load_estimator, resolve_device
    from posecal_models.data.keypoint_set import KeypointSet
    from posecal_models.progress import progress_bar
    from posecal_models.sample import sample_to_file

    _set_threads(threads)
    torch_device = resolve_device(device)
    estimator = load_estimator(weights, device=torch_device)
    images = KeypointSet.load(keypoints)
    if missing := images.missing(estimator.keypoints):
        _print_note(printable(f"note: {keypoints} has no keypoint {first_few(missing)}: missing in every image."))
    with progress_bar("sampling", len(images)) as progress:
        sample_to_file(
            estimator,
            images,
            output,
            n=n,
            seed=seed,
            temperature=temperature,
            mode=mode,
            device=torch_device,
            progress=progress,
        )


@app.command()
def motion(
    output: _Output = Path("motion.npz"),
    captured: Annotated[
        bool, typer.Option("--captured", help="16 seconds of captured motion of three people instead.")
    ] = False,
    subjects: Annotated[int, typer.Option(help="People.", min=1)] = 6,
    clips: Annotated[int, typer.Option(help="Clips per person.", min=1)] = 10,
    frames: Annotated[int, typer.Option(help="Frames per clip.", min=1)] = 100,
    seed: _Seed = 0,
) -> None:
    """Generate synthetic motion capture data, or write captured motion that no packaged weights were trained on."""
    check_outputs(output=output)
    from posecal.data.write import write_file, write_members
    from posecal_models.data.npz import read_npz
    from posecal_models.data.synthetic import synthetic_motion

    members = (
        read_npz(_CAPTURED_MOTION)
        if captured
        else synthetic_motion(subjects=subjects, clips=clips, frames=frames, seed=seed)
    )
    write_file(output, lambda file: write_members(file, members, compressed=True))


@app.command()
def project(
    poses: Annotated[Path, typer.Argument(help="Motion capture, .npz.")],
    output: _Output,
    subject: Annotated[list[str] | None, typer.Option(help="Use only this subject; repeatable.")] = None,
    every: Annotated[int, typer.Option(help="Use every n-th frame.", min=1)] = 1,
    views: Annotated[int, typer.Option(help="Cameras around each clip.", min=1)] = 4,
    exact: Annotated[bool, typer.Option("--exact", help="Exact keypoints, without the detector's noise.")] = False,
    seed: _Seed = 0,
) -> None:
    """Project motion capture into virtual cameras: true poses and detected keypoints in one file."""
    check_outputs(poses, output=output)
    from posecal_models.data.detector import Detector
    from posecal_models.data.mocap import MocapPoses

    images = MocapPoses(poses).project(subjects=subject, every=every, views=views, seed=seed)
    (images if exact else Detector().detect_set(images, seed=seed)).save(output)


@app.command("import")
def import_(
    kind: Annotated[Format, typer.Argument(help="The format.")],
    path: Annotated[Path, typer.Argument(help="The pickle, the folder of Human3.6M, or data_3d_h36m.npz.")],
    output: _Output,
    keypoints: Annotated[Path | None, typer.Option(help="VideoPose3D's data_2d_h36m_*.npz.")] = None,
    cameras: Annotated[Path | None, typer.Option(help="VideoPose3D: the cameras, .npz.")] = None,
    every: Annotated[
        int | None,
        typer.Option(
            help="Use every n-th frame; default 4 for human36m (S9 and S11: always every 64th), else 1.",
            min=1,
            show_default=False,
        ),
    ] = None,
    as_released: Annotated[
        bool,
        typer.Option("--as-released", help="ProHPE: flags by position, not by name, as in the published code."),
    ] = False,
) -> None:
    """Convert data of another project to pairs of poses and keypoints."""
    check_outputs(path, *filter(None, [keypoints, cameras]), output=output)
    from posecal_models.data.cameras import read_cameras
    from posecal_models.data.human36m import read_human36m
    from posecal_models.data.prohpe import read_prohpe
    from posecal_models.data.videopose3d import read_videopose3d

    options: dict[str, Any] = {} if every is None else {"every": every}
    if kind is Format.PROHPE:
        read_prohpe(path, join="as-released" if as_released else "by-name", **options).save(output)
    elif kind is Format.HUMAN36M:
        read_human36m(path, **options).save(output)
    elif keypoints is None or cameras is None:
        raise typer.BadParameter("videopose3d needs --keypoints and --cameras too.")
    else:
        read_videopose3d(path, keypoints, read_cameras(cameras), **options).save(output)


@app.command()
def convert(
    source: Annotated[
        Path,
        typer.Argument(
            help="A published cGNF checkpoint, the state_dict of propose 0.2.0, or a .safetensors file of format 1."
        ),
    ],
    output: _Output,
) -> None:
    """Convert a published cGNF checkpoint, or weights of an older format, to a weights file."""
    check_outputs(source, output=output)
    from posecal_models.checkpoint import convert_format_1, load_released, save_estimator

    if source.suffix == ".safetensors":
        convert_format_1(source, output)
        return
    estimator, unused = load_released(source)
    save_estimator(output, estimator, notes={"converted_from": source.name})
    count = sum(tensor.numel() for tensor in unused.values())
    _print_note(f"{len(unused)} tensors with {count:,} unused parameters were left out:")
    for name, tensor in unused.items():
        _print_note(printable(f"  {name} {tuple(tensor.shape)}"))


@app.command()
def describe(
    weights: Annotated[str, typer.Argument(help="Named weights or a .safetensors file.")],
) -> None:
    """Print the estimator of a weights file and notes on its training, as JSON."""
    import json

    from posecal_models.checkpoint import load_estimator, notes_of
    from posecal_models.estimators.registry import describe as describe_estimator
    from posecal_models.estimators.registry import parameter_count

    estimator = load_estimator(weights)
    about = {
        "parameters": parameter_count(estimator),
        "estimator": describe_estimator(estimator),
        "notes": notes_of(weights),
    }
    typer.echo(json.dumps(about, indent=2))


@app.command()
def benchmark(
    data: Annotated[Path, typer.Option(help="Motion capture, .npz.")],
    model: Annotated[list[str], typer.Option(help="NAME=WEIGHTS, a row of the table; repeatable.")],
    subject: Annotated[list[str], typer.Option(help="A test subject, not in any training set; repeatable.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder for table and figures.")],
    n: Annotated[int, typer.Option(help="Hypotheses of each image.", min=2)] = 200,
    every: Annotated[int, typer.Option(help="Use every n-th frame.", min=1)] = 16,
    seeds: Annotated[int, typer.Option(help="Number of sampling seeds.", min=1)] = 3,
    device: _Device = "cpu",
    threads: _Threads = 0,
) -> None:
    """Compare estimators on motion capture: the paper's Table 1 and its figures."""
    models = _parse_named(model)
    from posecal_models.benchmark_report import leaked_subjects, run_benchmark
    from posecal_models.checkpoint import resolve_device

    _set_threads(threads)
    torch_device = resolve_device(device)
    for name, weights in models.items():
        if leaked := leaked_subjects(weights, subject):
            _print_note(
                f"note: the training of {printable(name)} did not hold out {printable(', '.join(leaked))}; on the same "
                "data this is no test."
            )
    typer.echo(run_benchmark(data, models, subject, output, n=n, every=every, seeds=seeds, device=torch_device))


@app.command()
def losses(
    run: Annotated[list[str], typer.Argument(help="NAME=FOLDER of a training, each.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The figure, .png, .svg or .pdf.")],
) -> None:
    """Plot the loss curves of trainings, to check convergence."""
    check_outputs(plot=output)
    from posecal.plot import save
    from posecal_models import figures
    from posecal_models.progress import read_losses

    save(figures.losses({name: read_losses(Path(folder)) for name, folder in _parse_named(run).items()}), output)


@app.command("zero-shot")
def zero_shot(
    experiment: Annotated[Experiment, typer.Argument(help="The experiment.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="The figure, .png, .svg or .pdf.")] = None,
    steps: Annotated[int, typer.Option(help="Training steps of each model.", min=1)] = 3000,
    seed: _Seed = 0,
    threads: _Threads = 0,
) -> None:
    """Evaluate estimators on sets of observed nodes that are not in the training set; needs a checkout."""
    check_outputs(plot=output)
    from posecal.plot import save
    from posecal_models import figures
    from posecal_models import pendulum as pendulums
    from posecal_models import zero_shot as experiments
    from posecal_models.progress import progress_bar

    _set_threads(threads)
    if experiment is Experiment.PENDULUM:
        with progress_bar("training", steps * (len(pendulums.MODELS) - 1)) as progress:  # the linear part has no steps
            result = pendulums.pendulum(steps=steps, seed=seed, progress=progress)
        typer.echo("log p(x | c1, c2, c3), and the energy score of samples")
        for line in result.lines.values():
            typer.echo(line)
        if output is not None:
            save(figures.pendulum(result.samples, result.truth, result.lines), output)
        return
    with progress_bar("training", 2 * steps) as progress:
        rows = experiments.pose_world(steps=steps, seed=seed, progress=progress)
    typer.echo("nats above the true posterior:")
    typer.echo("  ".join(["observed  in training  true log p", *(f"{name:>19}" for name in rows[0].gaps)]))
    for row in rows:
        typer.echo(row)


def _parse_named(models: list[str]) -> dict[str, str]:
    """Parse NAME=PATH arguments."""
    pairs = [model.rpartition("=") for model in models]
    if bad := [model for model, (name, _, weights) in zip(models, pairs, strict=True) if not name or not weights]:
        raise typer.BadParameter(f"{bad[0]!r}: expected NAME=WEIGHTS.")
    names = [name.casefold() for name, *_ in pairs]
    if repeated := [name for name, *_ in pairs if names.count(name.casefold()) > 1]:
        raise typer.BadParameter(
            f"{repeated[0]!r}: given more than once; expected names that differ in more than case."
        )
    return {name: weights for name, _, weights in pairs}


if __name__ == "__main__":
    main()
