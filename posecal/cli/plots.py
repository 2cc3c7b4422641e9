"""``posecal plot``: draw a saved result, or some poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posecal.cli.options import (
    Axes,
    Hypotheses,
    JointNames,
    Missing,
    MissingFrames,
    Output,
    Result,
    RootJoint,
    Truth,
    TruthAxes,
    TruthUnit,
    Unit,
    option,
)
from posecal.cli.running import check_outputs, guarded, join_of, read_pairs

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help="Draw a saved result, or some poses.", rich_markup_mode="rich")


def _draw(result: Path, kind: str, output: Path) -> None:
    check_outputs(result, plot=output)
    from posecal.engine.storage import load_totals
    from posecal.plot import draw, save
    from posecal.report.report import Report

    save(draw(Report(load_totals(result)), kind), output)


@app.command()
@guarded
def reliability(result: Result, output: Output) -> None:
    """Calibration curves against the diagonal."""
    _draw(result, "reliability", output)


@app.command()
@guarded
def joints(result: Result, output: Output) -> None:
    """The signed area of every joint, on a skeleton."""
    _draw(result, "joints", output)


@app.command()
@guarded
def errors(result: Result, output: Output) -> None:
    """MinMPJPE against the number of hypotheses."""
    _draw(result, "errors", output)


@app.command()
@guarded
def correct(result: Result, output: Output) -> None:
    """PCK and CPS against the threshold."""
    _draw(result, "correct", output)


@app.command()
@guarded
def rank_tests(result: Result, output: Output) -> None:
    """What each test of the battery shows, beside what chance would."""
    _draw(result, "rank_tests", output)


@app.command()
@guarded
def guide(result: Result, output: Output) -> None:
    """Error left when the most uncertain poses are dropped."""
    _draw(result, "guide", output)


@app.command()
@guarded
def event(result: Result, output: Output) -> None:
    """Reliability of the probability that the median pose is right at every joint."""
    _draw(result, "event", output)


@app.command()
@guarded
def poses(
    hypotheses: Hypotheses,
    truth: Truth,
    output: Output,
    frames: Annotated[str | None, option("Frame ids or numbers, with commas.", show_default="5, evenly spaced")] = None,
    joint: Annotated[str, option("The joint whose hypotheses are shown as points.")] = "RWrist",
    most: Annotated[int, option("How many hypotheses to draw.", min=1)] = 50,
    axes: Axes = None,
    truth_axes: TruthAxes = None,
    unit: Unit = None,
    truth_unit: TruthUnit = None,
    joint_names: JointNames = None,
    root_joint: RootJoint = None,
    missing: MissingFrames = Missing.error,
) -> None:
    """Skeletons in 3D: hypotheses grey, truth blue, one joint's hypotheses pink."""
    how = join_of(axes, truth_axes, unit, truth_unit, joint_names, root_joint, missing)
    check_outputs(hypotheses, truth, plot=output)
    from posecal.plot import draw_poses, frames_of, save

    pairs = read_pairs(hypotheses, truth, how)
    save(draw_poses(pairs, frames_of(pairs, frames), cloud=joint, most=most), output)
