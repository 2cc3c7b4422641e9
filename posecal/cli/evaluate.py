"""``posecal evaluate`` and what is done with its results: ``report``, ``merge``; and ``presets`` and ``demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posecal.cli.options import (
    WRITING,
    Axes,
    By,
    Definitions,
    Form,
    Formats,
    Html,
    Hypotheses,
    JointNames,
    Missing,
    MissingFrames,
    Most,
    Output,
    PerJoint,
    Plot,
    Result,
    RootJoint,
    Threads,
    Truth,
    TruthAxes,
    TruthUnit,
    Unit,
    Where,
    option,
)
from posecal.cli.running import check_outputs, guarded, join_of, progress, protocol_of, read_pairs, say, write_report

__all__ = ["demo", "evaluate", "merge", "presets", "report"]

Metrics = Annotated[str | None, option("default, battery, scores, all, or names, with commas.", show_default="default")]


@guarded
def evaluate(
    hypotheses: Hypotheses,
    truth: Truth,
    by: By = None,
    where: Annotated[Where | None, option("Which joints to score.", show_default="all")] = None,
    joints: Annotated[
        str | None,
        option("all, a joint set, names with commas, or common: those in both files.", show_default="all"),
    ] = None,
    metrics: Metrics = None,
    battery: Annotated[bool, option("Add the tests for what the ECE can't see.", "--rank-tests")] = False,
    scores: Annotated[bool, option("Add the proper scores.", "--scores")] = False,
    skill: Annotated[
        str | None,
        option("Add skill scores against climatology, or against a file of hypotheses.", metavar="REFERENCE"),
    ] = None,
    prerank: Annotated[
        list[str] | None, option("Add a test of your own to the battery. Repeatable.", metavar="FILE.py:FUNCTION")
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
    per_joint: PerJoint = False,
    definitions: Definitions = False,
    save: Annotated[Path | None, option("Keep the result (sums, not hypotheses), .npz.", panel=WRITING)] = None,
    plot: Plot = None,
    html: Html = None,
    threads: Threads = None,
) -> None:
    """Evaluate hypotheses against the truth: accuracy, calibration and spread, each with its definition."""
    from posecal.calibration.rank_tests import load_prerank
    from posecal.engine.accumulate import accumulate
    from posecal.report.report import Report

    reference = Path(skill) if skill not in {None, "climatology"} else None
    tests = [Path(entry.rpartition(":")[0]) for entry in prerank or []]
    check_outputs(hypotheses, truth, *filter(None, [reference]), *tests, save=save, plot=plot, html=html)
    groups = [word for word, asked in (("rank_tests", battery or prerank), ("scores", scores or skill)) if asked]
    preranks = dict(load_prerank(entry) for entry in prerank or [])
    protocol = protocol_of(preset, options or [], where, joints, metrics, preranks)
    protocol = protocol.changed({"metrics": ", ".join([protocol.metrics, *groups])}) if groups else protocol
    how = join_of(axes, truth_axes, unit, truth_unit, joint_names, root_joint, missing, joints)
    pairs = read_pairs(hypotheses, truth, how, most)
    if skill is not None:
        from posecal.stats.skill import climatology, with_reference

        pairs = with_reference(
            pairs, climatology(pairs) if reference is None else read_pairs(reference, truth, how, most)
        )
    with progress(len(pairs.truth)) as advance:
        totals = accumulate(pairs, protocol, by=by or (), preranks=preranks, threads=threads, progress=advance)
    write_report(
        Report(totals, by or ()),
        form,
        joints=per_joint,
        definitions=definitions,
        plot=plot,
        html=html,
        name=hypotheses.name,
        save=save,
    )


@guarded
def report(
    result: Result,
    by: By = None,
    form: Formats = Form.text,
    per_joint: PerJoint = False,
    definitions: Definitions = False,
    plot: Plot = None,
    html: Html = None,
) -> None:
    """Write the report of a saved result, without the hypotheses."""
    check_outputs(result, plot=plot, html=html)
    from posecal.engine.storage import load_totals
    from posecal.report.report import Report

    found = Report(load_totals(result), by or ())
    write_report(found, form, joints=per_joint, definitions=definitions, plot=plot, html=html, name=result.name)


@guarded
def merge(
    results: Annotated[list[Path], typer.Argument(help="Saved results of shards of one test set.", show_default=False)],
    output: Output,
) -> None:
    """Add the results of shards: the same numbers as one run, but for what depends on all poses of a run."""
    check_outputs(*results, output=output)
    from posecal.engine.merge import merge_totals
    from posecal.engine.storage import load_totals, save_totals

    whole = merge_totals([load_totals(path) for path in results], [path.name for path in results])
    save_totals(whole, output)
    typer.echo(f"{output}: {whole.poses.sum():,} poses of {len(results)} results.", err=True)


@guarded
def presets() -> None:
    """List the published protocols with every option that they set, and all options."""
    from posecal.report.sheets import presets_sheet

    say(presets_sheet())


@guarded
def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Where to leave files.")] = Path("posecal-demo"),
) -> None:
    """Make a world where the truth is known, evaluate three samplers on it, and say what to notice."""
    from posecal.demo import run_demo

    run_demo(folder, typer.echo)
