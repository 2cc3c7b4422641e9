"""``posecal evaluate`` and what is done with its results: ``report`` and ``merge``; and ``presets`` and ``demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from posecal.cli.options import (
    WRITING,
    By,
    Definitions,
    Form,
    Formats,
    Html,
    Hypotheses,
    MetricNames,
    Output,
    OwnMetrics,
    PerJoint,
    Plot,
    PresetName,
    Result,
    Scored,
    Settings,
    Threads,
    Truth,
    describes_data,
    option,
)
from posecal.cli.running import (
    check_outputs,
    guarded,
    own_metrics,
    progress,
    protocol_of,
    read_data,
    show,
    write_report,
)


@describes_data()
@guarded
def evaluate(
    hypotheses: Hypotheses,
    truth: Truth,
    described: dict[str, Any],
    by: By = None,
    where: Scored = None,
    joints_scored: Annotated[
        str | None,
        option("all, a joint set, names with commas, or common: those in both files.", "--joints", show_default="all"),
    ] = None,
    metrics: MetricNames = None,
    metric: OwnMetrics = None,
    rank_tests: Annotated[bool, option("Add the rank tests, for what the ECE can't see.", "--rank-tests")] = False,
    scores: Annotated[bool, option("Add the proper scores.", "--scores")] = False,
    skill: Annotated[
        str | None,
        option("Add skill scores against climatology, or against a file of hypotheses.", metavar="REFERENCE"),
    ] = None,
    prerank: Annotated[
        list[str] | None, option("Add a rank test of your own. Repeatable.", metavar="FILE.py:FUNCTION")
    ] = None,
    preset: PresetName = None,
    settings: Settings = None,
    form: Formats = Form.text,
    per_joint: PerJoint = False,
    definitions: Definitions = False,
    save: Annotated[Path | None, option("Keep the result (sums, not hypotheses), .npz.", panel=WRITING)] = None,
    plot: Plot = None,
    html: Html = None,
    threads: Threads = None,
) -> None:
    """Evaluate hypotheses against the truth: accuracy, calibration and sharpness, each with its definition."""
    import posecal
    from posecal.engine.user_code import load_function

    reference = None if skill in {None, "climatology"} else Path(str(skill))
    code = [Path(entry.rpartition(":")[0]) for entry in (*(prerank or []), *(metric or []))]
    check_outputs(hypotheses, truth, reference, *code, save=save, plot=plot, html=html)
    preranks = dict(load_function(entry, "prerank") for entry in prerank or [])
    added = [word for word, asked in (("rank_tests", rank_tests or prerank), ("scores", scores or skill)) if asked]
    added += own_metrics(metric or [])
    scored = None if joints_scored == "common" else joints_scored
    protocol = protocol_of(preset, settings or [], where, scored, metrics, added, [*preranks])
    if joints_scored == "common":
        described["shared_joints"] = "common"
    data = read_data(hypotheses, truth, described)
    other = None if reference is None else read_data(reference, truth, described)
    with progress(len(data.truth)) as advance:
        report = posecal.evaluate(
            data,
            by=by or (),
            reference=other or skill,
            preranks=preranks,
            protocol=protocol,
            threads=threads,
            progress=advance,
        )
    write_report(
        report,
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

    loaded = Report(load_totals(result), by or ())
    write_report(loaded, form, joints=per_joint, definitions=definitions, plot=plot, html=html, name=result.name)


@guarded
def merge(
    results: Annotated[list[Path], typer.Argument(help="Saved results of shards of one test set.", show_default=False)],
    output: Output,
) -> None:
    """Add the results of shards: the same numbers as one run, but for what depends on all poses of a run."""
    check_outputs(*results, output=output)
    from posecal.engine.merge import merge_totals
    from posecal.engine.storage import load_totals, save_totals

    total = merge_totals([load_totals(path) for path in results], [path.name for path in results])
    save_totals(total, output)
    typer.echo(f"{output}: {total.poses.sum():,} poses of {len(results)} results.", err=True)


@guarded
def presets() -> None:
    """List the published protocols with every option that they set, and all options."""
    from posecal.report.text import presets_sheet

    show(presets_sheet())


@guarded
def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Where to leave files.")] = Path("posecal-demo"),
) -> None:
    """Make a world where the truth is known, evaluate three samplers on it, and say what to notice."""
    from posecal.demo import run_demo

    run_demo(folder, typer.echo)
