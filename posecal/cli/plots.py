"""``posecal plot``: figures of saved results, and of poses; ``posecal view``: poses in a viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posecal.cli import options as opt
from posecal.cli.running import check_outputs, command

app = typer.Typer(no_args_is_help=True, help="Draw saved results, or some poses.", rich_markup_mode="rich")

KINDS = {
    "reliability": "Calibration curves against the diagonal.",
    "joints": "The signed area of every joint, on a skeleton.",
    "errors": "minMPJPE against the number of hypotheses.",
    "pck": "PCK and CPS against the threshold.",
    "rank-tests": "The rank curves of each test, with the band that chance allows.",
    "sparsification": "The error left when the most uncertain poses are dropped.",
    "risk-coverage": "The error of the poses that are kept by their predicted spread.",
    "horizon": "Coverage, errors and spread against the horizon of a prediction.",
    "event": "Reliability of the probability that the median pose is right at every joint.",
}
"""Figures of a report, with their help."""


Results = Annotated[list[Path], opt.argument("Results of evaluate --save; of several models for one figure.")]


def _add(kind: str, about: str) -> None:
    @command(app, kind, about)
    def draw_result(
        results: Results,
        output: opt.Output,
        *,
        labels: opt.Labels = None,
        panels: Annotated[bool, opt.option("A panel for each model, instead of one for all.", "--panels")] = False,
        figure: opt.FigureOptions,
    ) -> None:
        check_outputs(*results, plot=output)
        import posecal

        how, files = figure.given(), opt.named(results, labels)
        reports = {name: posecal.Report(posecal.load_totals(path)) for name, path in files.items()}
        one = reports if len(reports) > 1 or labels else next(iter(reports.values()))
        posecal.plot.save(posecal.plot.draw(one, kind.replace("-", "_"), panels=panels, **how), output)


for _kind, _about in KINDS.items():
    _add(_kind, _about)


@command(app)
def comparison(results: Results, output: opt.Output, *, labels: opt.Labels = None, figure: opt.FigureOptions) -> None:
    """MinMPJPE against the ECE of two or more models."""
    check_outputs(*results, plot=output)
    import posecal

    how, files = figure.given(), opt.named(results, labels)
    if len(files) < 2:
        raise typer.BadParameter("expected saved results of two or more models.")
    compared = posecal.compare({name: posecal.load_totals(path) for name, path in files.items()})
    posecal.plot.save(posecal.plot.draw_comparison(compared, **how), output)


@command(app)
def poses(
    hypotheses: opt.Hypotheses,
    truth: opt.Truth,
    output: opt.Output,
    *,
    frames: Annotated[
        str | None, opt.option("Frame ids or numbers with commas, worst, or even.", show_default="worst, 5 of them")
    ] = None,
    joint: Annotated[
        str | None,
        opt.option("The joint whose hypotheses are points.", show_default="RWrist, if there is one"),
    ] = None,
    most: Annotated[int, opt.option("How many hypotheses to draw.", min=1)] = 50,
    view: Annotated[
        tuple[float, float],
        opt.option("From where, degrees.", metavar="AZIMUTH ELEVATION", show_default="-62 8"),
    ] = (-62.0, 8.0),
    figure: opt.FigureOptions,
    data: opt.DataOptions,
) -> None:
    """Skeletons in 2D or 3D: hypotheses grey, truth blue, one joint's hypotheses pink."""
    check_outputs(hypotheses, truth, plot=output)
    from posecal.data.joint_names import find_joint
    from posecal.plot import draw_poses, frames_of, save

    how, matched = figure.given(), data.read(hypotheses, truth)
    cloud = "RWrist" if joint is None and find_joint("RWrist", matched.joints) is not None else joint
    save(draw_poses(matched, frames_of(matched, frames), cloud=cloud, most=most, view=view, **how), output)


@command(app)
def intervals(
    hypotheses: opt.Hypotheses,
    truth: opt.Truth,
    output: opt.Output,
    *,
    joint: Annotated[str | None, opt.option("The joint, or its number.", show_default="the first but the root")] = None,
    coordinate: Annotated[str | None, opt.option("x, y, z, or a number.", show_default="the first")] = None,
    sequence: Annotated[str | None, opt.option("Sequences with commas, or all.", show_default="the first")] = None,
    figure: opt.FigureOptions,
    data: opt.DataOptions,
) -> None:
    """Central 50 % and 90 % intervals of one coordinate or angle over time, against the truth."""
    check_outputs(hypotheses, truth, plot=output)
    from posecal.plot import draw_intervals, save

    how, matched = figure.given(), data.read(hypotheses, truth)
    save(draw_intervals(matched, joint=joint, coordinate=coordinate, sequence=sequence, **how), output)


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
