"""Arguments of ``python -m toy``: a command for each toy result, its figure and its numbers."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, ParamSpec

import numpy as np
import typer

from posecal.errors import PosecalError

if TYPE_CHECKING:
    from toy.experiments.result import Result

P = ParamSpec("P")

app = typer.Typer(
    help="Problems with known solutions: the paper's toy problems and a pose world with exact posteriors.",
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def command(body: Callable[P, None]) -> Callable[P, None]:
    """Register a command; an error of posecal gives one message and exit code 3, Ctrl-C 130."""

    @functools.wraps(body)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            body(*args, **kwargs)
        except PosecalError as error:
            typer.echo(f"toy: {error}", err=True)
            raise typer.Exit(3) from None
        except KeyboardInterrupt:
            typer.echo("toy: interrupted.", err=True)
            raise typer.Exit(130) from None

    return app.command(body.__name__.replace("_", "-"))(guarded)


def _figure(path: Path) -> Path:
    from posecal.plot import check_suffix

    try:
        check_suffix(path)
    except PosecalError as error:
        raise typer.BadParameter(str(error)) from None
    return path


Output = Annotated[Path, typer.Option("-o", "--output", help="The figure: .svg, .png or .pdf.", callback=_figure)]
Seed = Annotated[int, typer.Option(help="Random seed.", min=0)]
Poses = Annotated[int, typer.Option(help="Number of truths in the check by simulation.", min=2)]


def _print_and_save(result: Result, output: Path) -> None:
    from posecal.plot import save

    typer.echo(result.text)
    save(result.figure, output)
    typer.echo(f"wrote {output}")


@command
def sigma_map(
    output: Output = Path("sigma-map.svg"),
    seed: Seed = 0,
    poses: Poses = 100_000,
    grid: Annotated[int, typer.Option(help="Points per axis, log-spaced and rounded.", min=2)] = 20,
) -> None:
    """Figure 1b: the spread that minimises minMPJPE, over dimensions and hypotheses."""
    from toy.experiments.sigma_map import run

    _print_and_save(run(np.random.default_rng(seed), poses=poses, grid=grid), output)


@command
def landscape(output: Output = Path("landscape.svg"), seed: Seed = 0, poses: Poses = 200_000) -> None:
    """Figure 1d: minMPJPE and ECE over the mean and the spread of a 1D Gaussian."""
    from toy.experiments.landscape import run

    _print_and_save(run(np.random.default_rng(seed), poses=poses), output)


@command
def collapse(output: Output = Path("collapse.svg"), seed: Seed = 0, poses: Poses = 200_000) -> None:
    """Supplement A.1: the mean MPJPE is lowest for a model without spread."""
    from toy.experiments.collapse import run

    _print_and_save(run(np.random.default_rng(seed), poses=poses), output)


@command
def mean(output: Output = Path("mean.svg"), seed: Seed = 0, poses: Poses = 100_000) -> None:
    """Supplement A.2: minMPJPE keeps the mean of a symmetric truth."""
    from toy.experiments.mean import run

    _print_and_save(run(np.random.default_rng(seed), poses=poses), output)


@command
def curves(output: Output = Path("curves.svg"), seed: Seed = 0, poses: Poses = 100_000) -> None:
    """Closed-form calibration curves of a wrong spread, mean or dimension."""
    from toy.experiments.curves import run

    _print_and_save(run(np.random.default_rng(seed), poses=poses), output)


@command
def motion(
    output: Output = Path("motion.svg"),
    seed: Seed = 0,
    clips: Annotated[int, typer.Option(help="Number of clips.", min=3)] = 200,
) -> None:
    """Motion with a known law at each horizon: coverage and energy scores of forecasts against the exact curves."""
    from toy.experiments.motion import run

    _print_and_save(run(np.random.default_rng(seed), clips=clips), output)


@command
def pose_world(
    output: Output = Path("pose-world.svg"),
    seed: Seed = 0,
    data: Annotated[Path, typer.Option(help="The folder for hyps.npz and gt.npz.")] = Path("pose-world"),
    fault: Annotated[
        str, typer.Option(help="The fault: a name (--list), spread-FACTOR, or all, with a folder each.")
    ] = "perfect",
    world: Annotated[Literal["person", "independent-joints"], typer.Option(help="The world.")] = "person",
    joints: Annotated[str, typer.Option(help="One of posecal's joint sets.")] = "h36m-16",
    hypotheses: Annotated[int, typer.Option(help="Hypotheses of each pose.", min=1)] = 200,
    sequences: Annotated[int, typer.Option(help="Number of sequences.", min=1)] = 40,
    frames: Annotated[int, typer.Option(help="Frames per sequence.", min=1)] = 25,
    correlation: Annotated[float, typer.Option(help="Between consecutive frames.", min=0, max=0.9999)] = 0.0,
    hidden: Annotated[
        float, typer.Option(help="Share of keypoints missing in every other sequence.", min=0, max=1)
    ] = 0.3,
    list_: Annotated[bool, typer.Option("--list", help="List the faults and exit.")] = False,
) -> None:
    """Poses with a known posterior: files for posecal evaluate, perfect or with a named fault."""
    from toy.faults import FAULTS, find_fault

    if list_:
        for listed in FAULTS.values():
            typer.echo(f"{listed.name:20} {listed.description}")
        return
    from toy.experiments.pose_world import run
    from toy.pose_world import PoseWorld

    result = run(
        PoseWorld.person(joints) if world == "person" else PoseWorld.independent_joints(joints),
        list(FAULTS.values()) if fault == "all" else [find_fault(fault)],
        data,
        seed=seed,
        N=hypotheses,
        sequences=sequences,
        frames=frames,
        correlation=correlation,
        hidden=hidden,
    )
    _print_and_save(result, output)


@command
def fault_table(
    seed: Seed = 0,
    hypotheses: Annotated[int, typer.Option(help="Hypotheses of each pose.", min=2)] = 100,
    poses: Annotated[int, typer.Option(help="Number of independent poses.", min=6)] = 1000,
    joint_correlation: Annotated[
        float, typer.Option(help="Between the deviations of any two joints.", min=0, max=0.9999)
    ] = 0.0,
) -> None:
    """Table of all named faults: calibration errors and tests, with the paper's ECE, as Markdown."""
    from toy.experiments.fault_table import LEVEL, evaluate_faults
    from toy.experiments.fault_table import fault_table as as_markdown

    correlated = f", joints correlated {joint_correlation:g}" if joint_correlation else ""
    typer.echo(
        f"N = {hypotheses}, M = {poses:,} independent poses{correlated}. Cells: mean |ω − q|, bold where sign-flips "
        f"give p < {LEVEL:g}.\nES ratio: energy score over that of samples from the truth's distribution.\n"
    )
    typer.echo(as_markdown(evaluate_faults(seed, N=hypotheses, M=poses, joint_correlation=joint_correlation)))


@command
def pendulum(
    output: Output = Path("pendulum.svg"),
    seed: Seed = 0,
    data: Annotated[Path, typer.Option(help="The .npz for positions and observations.")] = Path("pendulum.npz"),
    pendulums: Annotated[int, typer.Option(help="Number of pendulums.", min=1)] = 50,
    timesteps: Annotated[int, typer.Option(help="Times of each pendulum, 0.02 s apart.", min=2)] = 25,
) -> None:
    """Supplement B.2: triple pendulums, the data of the zero-shot experiment."""
    from toy.experiments.pendulum import run

    _print_and_save(run(np.random.default_rng(seed), data, pendulums=pendulums, timesteps=timesteps), output)


@command
def rank_law(
    output: Annotated[Path, typer.Option("-o", "--output", help="The .json.")] = Path("finite_n.json"),
    seed: Seed = 0,
    draws: Annotated[int, typer.Option(help="Sets of hypotheses for each N.", min=1)] = 400_000,
) -> None:
    """The bias of the paper's and the reference's curves at finite N, the table of posecal.calibration.expected."""
    from toy.rank_law import write_table

    write_table(output, draws, seed)
    typer.echo(f"wrote {output}")


if __name__ == "__main__":
    app(prog_name="python -m toy")
