"""``posecal plot``: figures of saved results, and of poses; ``posecal view``: poses in a viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posecal.cli import options as opt
from posecal.cli.running import check_outputs, command, wrong_call

app = typer.Typer(no_args_is_help=True, help="Draw a saved result, or some poses.", rich_markup_mode="rich")

KINDS = {
    "reliability": "Calibration curves against the diagonal.",
    "joints": "The signed area of every joint, on a skeleton.",
    "errors": "minMPJPE against the number of hypotheses.",
    "pck": "PCK and CPS against the threshold.",
    "rank-tests": "The rank curves of each test, with the band that chance allows.",
    "sparsification": "The error left when the most uncertain poses are dropped.",
    "risk-coverage": "The error of the poses that are kept by their predicted spread.",
    "event": "Reliability of the probability that the median pose is right at every joint.",
}
"""Figures of a report, with their help."""


def _add(kind: str, about: str) -> None:
    @command(app, kind, about)
    def draw_result(result: opt.Result, output: opt.Output) -> None:
        check_outputs(result, plot=output)
        import posecal

        report = posecal.Report(posecal.load_totals(result))
        posecal.plot.save(posecal.plot.draw(report, kind.replace("-", "_")), output)


for _kind, _about in KINDS.items():
    _add(_kind, _about)


@command(app)
def poses(
    hypotheses: opt.Hypotheses,
    truth: opt.Truth,
    output: opt.Output,
    *,
    frames: Annotated[str | None, opt.option("Frame ids or numbers, with commas.", show_default="5 of them")] = None,
    joint: Annotated[
        str | None,
        opt.option("The joint whose hypotheses are points.", show_default="RWrist, if there is one"),
    ] = None,
    most: Annotated[int, opt.option("How many hypotheses to draw.", min=1)] = 50,
    data: opt.DataOptions,
) -> None:
    """Skeletons in 2D or 3D: hypotheses grey, truth blue, one joint's hypotheses pink."""
    check_outputs(hypotheses, truth, plot=output)
    from posecal.data.joint_names import find_joint
    from posecal.plot import draw_poses, frames_of, save

    matched = data.read(hypotheses, truth)
    cloud = "RWrist" if joint is None and find_joint("RWrist", matched.joints) is not None else joint
    save(draw_poses(matched, frames_of(matched, frames), cloud=cloud, most=most), output)


@command(app)
def intervals(
    hypotheses: opt.Hypotheses,
    truth: opt.Truth,
    output: opt.Output,
    *,
    joint: Annotated[str | None, opt.option("The joint, or its number.", show_default="the first but the root")] = None,
    coordinate: Annotated[str | None, opt.option("x, y, z, or a number.", show_default="the first")] = None,
    sequence: Annotated[str | None, opt.option("Sequences with commas, or all.", show_default="the first")] = None,
    size: Annotated[
        tuple[float, float] | None, opt.option("Inches across and down.", metavar="WIDTH HEIGHT", show_default=False)
    ] = None,
    data: opt.DataOptions,
) -> None:
    """Central 50 % and 90 % intervals of one coordinate or angle over time, against the truth."""
    check_outputs(hypotheses, truth, plot=output)
    from posecal.plot import draw_intervals, save
    from posecal.plot.intervals import check_size

    with wrong_call():
        check_size(size)
    matched = data.read(hypotheses, truth)
    save(draw_intervals(matched, joint=joint, coordinate=coordinate, sequence=sequence, size=size), output)


def view(
    hypotheses: opt.Hypotheses,
    truth: opt.Truth,
    *,
    frames: Annotated[str | None, opt.option("Frame ids or numbers, with commas.", show_default="all")] = None,
    most: Annotated[int, opt.option("How many hypotheses to show.", min=1)] = 50,
    output: Annotated[Path | None, opt.option("Write a file for the viewer, .rrd.", "--output", "-o")] = None,
    data: opt.DataOptions,
) -> None:
    """Show poses in the viewer of rerun, frame by frame: hypotheses grey, truth blue. Needs the extra view."""
    check_outputs(hypotheses, truth, output=output)
    from posecal import plot

    matched = data.read(hypotheses, truth)
    plot.view(matched, frames=None if frames is None else plot.frames_of(matched, frames), most=most, path=output)
