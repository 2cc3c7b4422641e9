"""``posecal compare``: which of two models is better, paired by sequence."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from posecal.cli.options import (
    WRITING,
    Axes,
    Form,
    Formats,
    JointNames,
    Missing,
    MissingFrames,
    Most,
    RootJoint,
    Threads,
    TruthAxes,
    TruthUnit,
    Unit,
    Where,
    option,
)
from posecal.cli.running import check_outputs, guarded, join_of, progress, protocol_of, read_pairs, say

if TYPE_CHECKING:
    from posecal.engine.totals import Totals

__all__ = ["compare"]


@guarded
def compare(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Hypotheses of two or more models and, last, the truth; or two or more saved results.",
            show_default=False,
        ),
    ],
    where: Annotated[Where | None, option("Which joints to score.", show_default="all")] = None,
    metrics: Annotated[
        str | None,
        option("default, battery, scores, all, or names, with commas.", show_default="default and, from N = 2, scores"),
    ] = None,
    preset: Annotated[str | None, option("A published protocol; see posecal presets.")] = None,
    options: Annotated[
        list[str] | None, option("Any option that posecal presets lists. Repeatable.", "--set", metavar="OPTION=VALUE")
    ] = None,
    axes: Axes = None,
    truth_axes: TruthAxes = None,
    unit: Unit = None,
    truth_unit: TruthUnit = None,
    joint_names: JointNames = None,
    root_joint: RootJoint = None,
    missing: MissingFrames = Missing.error,
    most: Most = None,
    form: Formats = Form.text,
    plot: Annotated[Path | None, option("Draw minMPJPE against the ECE: .svg, .png or .pdf.", panel=WRITING)] = None,
    threads: Threads = None,
) -> None:
    """Compare models on the same poses: differences with intervals, p-values and ranks."""
    check_outputs(*files, plot=plot)
    from posecal.engine.accumulate import accumulate
    from posecal.engine.storage import is_result, load_totals
    from posecal.report.sheets import comparison_sheet
    from posecal.stats.comparison import compare as compare_totals

    totals: list[Totals] = []
    if all(is_result(path) for path in files):
        names = _names(files)
        totals = [load_totals(path) for path in files]
    else:
        *models, truth = files
        if len(models) < 2:
            raise typer.BadParameter(
                "expected hypotheses of two or more models and, last, the truth; or two or more saved results."
            )
        names = _names(models)
        how = join_of(axes, truth_axes, unit, truth_unit, joint_names, root_joint, missing)
        protocol = protocol_of(preset, options or [], where, None, metrics)
        models_of = [read_pairs(path, truth, how, most) for path in models]
        if protocol.metrics == "default" and all(pairs.shape[0] > 1 for pairs in models_of):
            protocol = protocol.changed({"metrics": "default, scores"})
        for path, pairs in zip(models, models_of, strict=True):
            with progress(len(pairs.truth), path.name) as advance:
                totals.append(accumulate(pairs, protocol, threads=threads, progress=advance))
    found = compare_totals(totals, names)
    if plot is not None:
        from posecal.plot import draw_comparison, save

        save(draw_comparison(found), plot)
    if form is Form.text:
        say(comparison_sheet(found))
    else:
        typer.echo(comparison_sheet(found).markdown() if form is Form.markdown else found.render(form.value))


def _names(files: list[Path]) -> list[str]:
    """Call models by their files' names, or by their paths where two files are called alike."""
    stems = [path.stem for path in files]
    return stems if len(set(stems)) == len(stems) else [str(path.with_suffix("")) for path in files]
