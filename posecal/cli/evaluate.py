"""``posecal evaluate`` and what is done with its results: ``report`` and ``merge``; and ``presets`` and ``demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from posecal.cli import options as opt
from posecal.cli.running import check_outputs, of_results, progress, say, show, terminal
from posecal.cli.shards import ShardOptions


def evaluate(
    hypotheses: Annotated[str, opt.argument("Hypotheses, (N, M, K, 3): .npz or .npy; with stars, many files.")],
    truth: Annotated[str, opt.argument("True poses, (M, K, 3); paired by what the stars stand for.")],
    *,
    by: opt.By = None,
    scoring: opt.ScoringOptions,
    skill: Annotated[str | None, opt.option("Add skill scores: climatology or a file.", metavar="REFERENCE")] = None,
    prerank: Annotated[
        list[str] | None, opt.option("Add a rank test of your own. Repeatable.", metavar="FILE.py:FUNCTION")
    ] = None,
    threads: opt.Threads = None,
    many: ShardOptions,
    data: opt.DataOptions,
    written: opt.ReportOptions,
    save: Annotated[Path | None, opt.writing("Keep the result: sums, and the gallery's poses; .npz.")] = None,
) -> None:
    """Evaluate hypotheses against the truth: accuracy, calibration and sharpness, each with its definition."""
    import posecal
    from posecal.data.remote import is_address, name_of
    from posecal.engine.user_code import FileFunction, load_function
    from posecal.evaluation.pairs import pair_files

    reference = None if skill in {None, "climatology"} else skill
    sources = (hypotheses, truth, *([] if reference is None else [reference]))
    are_many = many.are_needed(*sources)
    pairs = pair_files(*sources) if are_many else [sources]
    read = [Path(source) for pair in pairs for source in pair if not is_address(source)]
    check_outputs(*read, *(scoring.metric or []), *(prerank or []), save=save, plot=written.plot, html=written.html)
    preranks: dict[str, Any] = dict(load_function(entry, "prerank") for entry in prerank or [])
    added = [word for word, asked in (("rank_tests", preranks), ("scores", skill)) if asked]
    protocol = scoring.protocol(*added, preranks=preranks)
    how: dict[str, Any] = {"by": by or (), "preranks": preranks, "protocol": protocol, "threads": threads}
    how["gallery"] = written.gallery and (save or written.html) is not None
    if are_many:
        how["preranks"] = {name: FileFunction(e, "prerank") for name, e in zip(preranks, prerank or [], strict=True)}
        described = {**data.given(), **scoring.matching, "reference": skill}
        report = many.evaluate(pairs, save, scoring.metric, **how, **described)
        written.write(report, name_of(hypotheses), save)
        return
    poses = data.read(Path(hypotheses), Path(truth), **scoring.matching)
    other = None if reference is None else data.read(Path(reference), Path(truth), **scoring.matching)
    with progress() as bar:
        report = posecal.evaluate(poses, reference=other or skill, progress=bar("evaluating", len(poses.truth)), **how)
    written.write(report, Path(hypotheses).name, save)


def report(result: opt.Result, *, by: opt.By = None, metric: opt.OwnMetrics = None, written: opt.ReportOptions) -> None:
    """Write the report of a saved result, without the hypotheses."""
    check_outputs(result, *(metric or []), plot=written.plot, html=written.html)
    import posecal

    opt.register_all(metric)
    with of_results(result):
        written.write(posecal.Report(posecal.load_totals(result), by or ()), result.name)


def merge(
    results: Annotated[list[Path], opt.argument("Saved results of shards of one test set.")],
    output: opt.Output,
    *,
    gallery: opt.Gallery = True,
) -> None:
    """Add the results of shards: the same numbers as one run, without what depends on all poses of a run."""
    check_outputs(*results, output=output)
    import posecal
    from posecal.report.format import counted

    with of_results(*results):
        total = posecal.merge_totals([posecal.load_totals(path) for path in results], [path.name for path in results])
        posecal.Report(total).save(output, gallery=gallery)
    say(f"{output}: {total.poses.sum():,} poses of {counted(len(results), 'result')}.")


def presets() -> None:
    """List the published protocols with every option that they set, and all options."""
    from posecal.report.text import presets_sheet

    show(presets_sheet())


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Where to leave files.")] = Path("posecal-demo"),
) -> None:
    """Make a world where the truth is known, evaluate three samplers on it, and say what to notice."""
    from posecal.demo import run_demo

    run_demo(folder, typer.echo, **terminal())
