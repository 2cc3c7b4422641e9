"""The command ``posecal-models``: arguments, progress and exit codes, nothing else.

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
from posecal.errors import PosecalError

__all__ = ["app", "main"]

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Reference estimators of 3D pose distributions: train them, sample them, judge them with posecal evaluate.",
)

_Output = Annotated[Path, typer.Option("--output", "-o", help="The file to write.")]
_Threads = Annotated[int, typer.Option(help="CPU threads; 0 leaves it to PyTorch.", min=0)]
_Device = Annotated[str, typer.Option(help="cpu, cuda, cuda:1 or auto.")]
_Seed = Annotated[int, typer.Option(help="Of everything random.", min=0, max=2**63 - 1)]


class Format(StrEnum):
    """Formats of other projects' data."""

    PROHPE = "prohpe"
    HUMAN36M = "human36m"
    VIDEOPOSE3D = "videopose3d"


class Experiment(StrEnum):
    """What a cGNF is asked that it was not taught."""

    PENDULUM = "pendulum"
    POSE_WORLD = "pose-world"


@app.callback()
def _of_all_commands() -> None:
    pass


def main() -> None:
    """Run the command line."""
    try:
        app()
    except PosecalError as problem:
        if os.environ.get("LOCAL_RANK", "0") == "0":  # the processes of a machine refuse the same: one of them says it
            _say(f"posecal-models: {problem}")
        sys.exit(3)
    except KeyboardInterrupt:
        sys.exit(130)


def _say(words: str) -> None:
    Console(stderr=True, highlight=False, soft_wrap=True).print(words, markup=False)


def _set_threads(count: int) -> None:
    import torch

    if count:
        torch.set_num_threads(count)


@app.command()
def train(
    config: Annotated[str, typer.Argument(help="A named configuration or a TOML file.")],
    data: Annotated[Path, typer.Option(help="Motion capture, or pairs of poses and keypoints, .npz.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder of the training.")],
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a setting, e.g. --set train.epochs=20 --set model.scale=exp."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder's checkpoint.")] = False,
    device: _Device = "cpu",
    threads: _Threads = 0,
) -> None:
    """Train an estimator; it can be stopped and resumed at any time."""
    from posecal_models.checkpoint import device_named
    from posecal_models.config import Config
    from posecal_models.distributed import crew_of_torchrun
    from posecal_models.preparation import prepare
    from posecal_models.progress import shown

    _set_threads(threads)
    settings = Config.load(config).changed(change or [])
    with crew_of_torchrun(device_named(device)) as crew:
        run = prepare(settings, data, output, device=crew.device, resume=resume, crew=crew)
        with shown(run) as on_step:
            run.run(on_step=on_step)


@app.command()
def sample(
    weights: Annotated[str, typer.Argument(help="Named weights or a .safetensors file.")],
    keypoints: Annotated[Path, typer.Argument(help="An .npz with keypoints_2d and their joints' names.")],
    output: _Output,
    n: Annotated[int, typer.Option(help="Hypotheses of each image.", min=1)] = 200,
    temperature: Annotated[float, typer.Option(help="Spread of the noise; 1 is the distribution.", min=0)] = 1.0,
    mode: Annotated[bool, typer.Option("--mode", help="Write the single best pose instead.")] = False,
    seed: _Seed = 0,
    device: _Device = "cpu",
    threads: _Threads = 0,
) -> None:
    """Draw hypotheses for every image, into a file that posecal evaluate reads."""
    check_outputs(keypoints, Path(weights), output=output)
    from posecal.errors import first_few
    from posecal_models.checkpoint import device_named, load_estimator
    from posecal_models.data.keypoint_set import KeypointSet
    from posecal_models.progress import counted
    from posecal_models.sample import sample_to_file

    _set_threads(threads)
    where = device_named(device)
    estimator = load_estimator(weights, device=where)
    images = KeypointSet.load(keypoints)
    if lacking := images.lacking(estimator.keypoints):
        _say(f"note: {keypoints} has no keypoint {first_few(lacking)}: missing in every image.")
    with counted("sampling", len(images)) as progress:
        sample_to_file(
            estimator,
            images,
            output,
            n=n,
            seed=seed,
            temperature=temperature,
            mode=mode,
            device=where,
            progress=progress,
        )


@app.command()
def motion(
    output: _Output = Path("motion.npz"),
    subjects: Annotated[int, typer.Option(help="People.", min=1)] = 6,
    clips: Annotated[int, typer.Option(help="Clips of each.", min=1)] = 10,
    frames: Annotated[int, typer.Option(help="Frames of each clip.", min=1)] = 100,
    seed: _Seed = 0,
) -> None:
    """Make up motion capture data to try things on."""
    check_outputs(output=output)
    import numpy as np

    from posecal.data.write import write_file
    from posecal_models.data.synthetic import synthetic_motion

    members: dict[str, Any] = {**synthetic_motion(subjects=subjects, clips=clips, frames=frames, seed=seed)}
    write_file(output, lambda file: np.savez_compressed(file, **members))


@app.command()
def project(
    poses: Annotated[Path, typer.Argument(help="Motion capture, .npz.")],
    output: _Output,
    subject: Annotated[list[str] | None, typer.Option(help="Only this one; repeatable.")] = None,
    every: Annotated[int, typer.Option(help="Only every so manieth frame.", min=1)] = 1,
    views: Annotated[int, typer.Option(help="Cameras around each clip.", min=1)] = 4,
    exact: Annotated[bool, typer.Option("--exact", help="Keypoints without a detector's noise.")] = False,
    seed: _Seed = 0,
) -> None:
    """Look at motion capture through virtual cameras: true poses and detected keypoints in one file."""
    check_outputs(poses, output=output)
    from posecal_models.data.detector import Detector
    from posecal_models.data.mocap import MocapPoses

    seen = MocapPoses(poses).seen_by_cameras(subjects=subject, every=every, views=views, seed=seed)
    (seen if exact else Detector().seen(seen, seed=seed)).save(output)


@app.command("import")
def import_(
    kind: Annotated[Format, typer.Argument(help="Whose format.")],
    path: Annotated[Path, typer.Argument(help="The pickle, the folder of Human3.6M, or data_3d_h36m.npz.")],
    output: _Output,
    keypoints: Annotated[Path | None, typer.Option(help="VideoPose3D's data_2d_h36m_*.npz.")] = None,
    cameras: Annotated[Path | None, typer.Option(help="VideoPose3D: the cameras, .npz.")] = None,
    every: Annotated[
        int | None,
        typer.Option(
            help="Only every so manieth frame; 4 for human36m, whose S9 and S11 are taken every 64th anyway, else 1.",
            min=1,
            show_default=False,
        ),
    ] = None,
    as_released: Annotated[
        bool,
        typer.Option("--as-released", help="ProHPE: flags by position, not by name, as published code does."),
    ] = False,
) -> None:
    """Turn another project's data into pairs of poses and keypoints."""
    check_outputs(path, *filter(None, [keypoints, cameras]), output=output)
    from posecal_models.data.cameras import read_cameras
    from posecal_models.data.human36m import read_human36m
    from posecal_models.data.prohpe import read_prohpe
    from posecal_models.data.videopose3d import read_videopose3d

    steps: dict[str, Any] = {} if every is None else {"every": every}
    if kind is Format.PROHPE:
        read_prohpe(path, joined="as-released" if as_released else "by-name", **steps).save(output)
    elif kind is Format.HUMAN36M:
        read_human36m(path, **steps).save(output)
    elif keypoints is None or cameras is None:
        raise typer.BadParameter("videopose3d needs --keypoints and --cameras too.")
    else:
        read_videopose3d(path, keypoints, read_cameras(cameras), **steps).save(output)


@app.command()
def convert(
    released: Annotated[Path, typer.Argument(help="A published cGNF checkpoint, the state_dict of propose 0.2.0.")],
    output: _Output,
) -> None:
    """Turn a published cGNF checkpoint into weights of ours, and say what it holds in vain."""
    check_outputs(released, output=output)
    from posecal_models.checkpoint import load_released, save_estimator

    estimator, dead = load_released(released)
    save_estimator(output, estimator, notes={"converted_from": released.name})
    count = sum(tensor.numel() for tensor in dead.values())
    _say(f"{len(dead)} tensors with {count:,} parameters that nothing uses were left out:")
    for name, tensor in dead.items():
        _say(f"  {name} {tuple(tensor.shape)}")


@app.command()
def describe(
    weights: Annotated[str, typer.Argument(help="Named weights or a .safetensors file.")],
) -> None:
    """Say what weights are weights of, and how they were trained, as JSON."""
    import json

    from posecal_models.checkpoint import load_estimator, notes_of
    from posecal_models.estimators import describe as description_of
    from posecal_models.estimators import parameter_count

    estimator = load_estimator(weights)
    about = {
        "parameters": parameter_count(estimator),
        "estimator": description_of(estimator),
        "notes": notes_of(weights),
    }
    typer.echo(json.dumps(about, indent=2))


@app.command()
def benchmark(
    data: Annotated[Path, typer.Option(help="Motion capture, .npz.")],
    model: Annotated[list[str], typer.Option(help="NAME=WEIGHTS, a row of the table; repeatable.")],
    subject: Annotated[list[str], typer.Option(help="Somebody whom no model was trained on; repeatable.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder for table and pictures.")],
    n: Annotated[int, typer.Option(help="Hypotheses of each image.", min=2)] = 200,
    every: Annotated[int, typer.Option(help="Only every so manieth frame.", min=1)] = 16,
    seeds: Annotated[int, typer.Option(help="How often each model is sampled.", min=1)] = 3,
    threads: _Threads = 0,
) -> None:
    """Compare estimators on real motion: the paper's Table 1 and its pictures."""
    models = _named(model)
    from posecal_models.benchmark_report import run_benchmark, seen_in_training

    _set_threads(threads)
    for name, weights in models.items():
        if seen := seen_in_training(weights, subject):
            _say(f"note: {name} was not trained without {', '.join(seen)}. If that was on these data, it is no test.")
    typer.echo(run_benchmark(data, models, subject, output, n=n, every=every, seeds=seeds))


@app.command()
def losses(
    run: Annotated[list[str], typer.Argument(help="NAME=FOLDER of a training, each.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="A picture, .png, .svg or .pdf.")],
) -> None:
    """Draw how the losses of trainings fell, to see whether they are flat."""
    check_outputs(plot=output)
    from posecal.plot import save
    from posecal_models import pictures
    from posecal_models.progress import read_losses

    save(pictures.losses({name: read_losses(Path(folder)) for name, folder in _named(run).items()}), output)


@app.command("zero-shot")
def zero_shot(
    experiment: Annotated[Experiment, typer.Argument(help="Which.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="A picture, .png, .svg or .pdf.")] = None,
    steps: Annotated[int, typer.Option(help="Training steps of each model.", min=1)] = 3000,
    seed: _Seed = 0,
    threads: _Threads = 0,
) -> None:
    """Judge cGNFs on sets of observed nodes that they never saw; run it in a checkout."""
    check_outputs(plot=output)
    from posecal.plot import save
    from posecal_models import pictures
    from posecal_models import zero_shot as experiments
    from posecal_models.progress import counted

    _set_threads(threads)
    if experiment is Experiment.PENDULUM:
        with counted("training", steps * len(experiments.PENDULUM_MODELS)) as progress:
            found = experiments.pendulum(steps=steps, seed=seed, progress=progress)
        for name, log_density in found.log_density.items():
            typer.echo(f"{name}: log p(x | c1, c2, c3) = {log_density}")
        if output is not None:
            titles = {name: f"{name}: {log_density}" for name, log_density in found.log_density.items()}
            save(pictures.pendulum(found.samples, found.truth, titles), output)
        return
    with counted("training", steps) as progress:
        rows = experiments.pose_world(steps=steps, seed=seed, progress=progress)
    typer.echo("observed  in training  true log p   cGNF log p   nats above the true posterior")
    for row in rows:
        seen = "yes" if row.trained else "no"
        typer.echo(
            f"{row.observed:8d}  {seen:>11}  {row.true_log_density:10.2f}  {row.log_density:11.2f}   "
            f"{row.gap:.2f} ± {row.standard_error:.2f}"
        )


def _named(models: list[str]) -> dict[str, str]:
    pairs = [model.rpartition("=") for model in models]
    if bad := [model for model, (name, _, weights) in zip(models, pairs, strict=True) if not name or not weights]:
        raise typer.BadParameter(f"{bad[0]!r}: expected NAME=WEIGHTS.")
    names = [name.casefold() for name, *_ in pairs]
    if twice := [name for name, *_ in pairs if names.count(name.casefold()) > 1]:
        raise typer.BadParameter(f"{twice[0]!r}: named more than once; expected names that differ in more than case.")
    return {name: weights for name, _, weights in pairs}


if __name__ == "__main__":
    main()
