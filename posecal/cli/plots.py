"""``posecal plot``: figures of saved results, and of poses."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from posecal.cli.options import Hypotheses, Output, Result, Truth, describes_data, option
from posecal.cli.running import check_outputs, guarded, read_data

app = typer.Typer(no_args_is_help=True, help="Draw a saved result, or some poses.", rich_markup_mode="rich")

KINDS = {
    "reliability": "Calibration curves against the diagonal.",
    "joints": "The signed area of every joint, on a skeleton.",
    "errors": "minMPJPE against the number of hypotheses.",
    "pck": "PCK and CPS against the threshold.",
    "rank-tests": "The rank curves of each test, with the band that chance allows.",
    "sparsification": "The error left when the most uncertain poses are dropped.",
    "event": "Reliability of the probability that the median pose is right at every joint.",
}
"""Figures of a report, with their help."""


def _add(kind: str, about: str) -> None:
    @app.command(name=kind, help=about)
    @guarded
    def draw_result(result: Result, output: Output) -> None:
        check_outputs(result, plot=output)
        from posecal.engine.storage import load_totals
        from posecal.plot import draw, save
        from posecal.report.report import Report

        save(draw(Report(load_totals(result)), kind.replace("-", "_")), output)


for _kind, _about in KINDS.items():
    _add(_kind, _about)


@app.command()
@describes_data()
@guarded
def poses(
    hypotheses: Hypotheses,
    truth: Truth,
    output: Output,
    described: dict[str, Any],
    frames: Annotated[str | None, option("Frame ids or numbers, with commas.", show_default="5, evenly spaced")] = None,
    joint: Annotated[str, option("The joint whose hypotheses are shown as points.")] = "RWrist",
    most: Annotated[int, option("How many hypotheses to draw.", min=1)] = 50,
) -> None:
    """Skeletons in 3D: hypotheses grey, truth blue, one joint's hypotheses pink."""
    check_outputs(hypotheses, truth, plot=output)
    from posecal.plot import draw_poses, frames_of, save

    data = read_data(hypotheses, truth, described)
    save(draw_poses(data, frames_of(data, frames), cloud=joint, most=most), output)
