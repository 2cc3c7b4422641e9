"""The printed page of a leaderboard: for each test set its models, best first, and the tests of their differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from posecal.engine.metric import Metric
from posecal.errors import for_python
from posecal.report.comparison import definitions, pairs_table, paper_pairs, sentences
from posecal.report.format import ARROWS, MISSING, as_printed, number, p_value, span
from posecal.report.sheet import Sheet, Table

if TYPE_CHECKING:
    from posecal.evaluation.entries import Entry
    from posecal.report.comparison import Comparison

SHOWN = ("min_mpjpe", "signed_area")
"""Metrics of the table, beside the primary ones."""

COLUMNS = ("test_set", "model", "metric", "unit", "primary", "value", "low", "high", "p", "rank")
"""Of the tidy table."""

_DIGITS = 0.0, 0.09
"""Numbers without an interval have three digits."""

_COMMIT = 16
"""Longer names of commits are cut."""


def standings_sheet(
    test_set: str,
    entries: Sequence[Entry],
    comparison: Comparison,
    words: Callable[[str], str] = for_python,
    *,
    paper: bool = False,
) -> Sheet:
    """Lay out the models of a test set in the order of the comparison: numbers, sources and pairs.

    Parameters
    ----------
    test_set : str
        Its name.
    entries : sequence of Entry
        What is said of the models, in the same order.
    comparison : Comparison
        One or more models.
    words : callable
        How remarks name options.
    paper : bool
        Whether units stand in headings, pairs in a table for each metric, and sources among the definitions.

    Returns
    -------
    Sheet
        To be written as text, Markdown or LaTeX.
    """
    first = comparison.totals[0]
    primary = [comparison.metrics[name] for name in comparison.primary]
    others = [comparison.metrics[name] for name in SHOWN if name in comparison.metrics]
    shown = [*primary, *(metric for metric in others if metric not in primary)]
    tables, sources, about = [_models(comparison, shown, paper=paper)], _sources(entries), []
    if not paper:
        tables.append(sources)
    if len(comparison.names) > 1:
        tables += paper_pairs(comparison, primary) if paper else [pairs_table(comparison, primary)]
        ranks = f"by the {primary[0].label}: 1, and one more for each model that is better beyond chance."
        about = [("rank", ranks), *definitions(comparison, shown)]
    if paper:
        beside = sources.headings[1:]
        about += [(name, ", ".join(map(" ".join, zip(beside, cells, strict=True)))) for name, *cells in sources.rows]
    brackets = "95 % intervals over sequences; of calibration errors p, alone, of the hypothesis that it is calibrated."
    return Sheet(
        f"{test_set} · M = {first.poses.sum():,} poses in {first.units()} · N = {first.spec.n_hypotheses}",
        sentences=sentences(comparison),
        remarks=list(comparison.remarks_in(words)),
        tables=tables,
        definitions=[("in brackets", brackets), *about],
        footer=f"signature: {first.signature}",
    )


def _models(comparison: Comparison, metrics: Sequence[Metric], *, paper: bool) -> Table:
    """Lay out a row for each model, with the rank by the first metric; the best ones of each metric are bold."""
    names = comparison.names
    ranks = [[comparison.rank(metric.name, name) for name in names] for metric in metrics]
    rows = [
        (name, str(rank), *(_cell(comparison, metric, name, paper=paper) for metric in metrics))
        for name, rank in zip(names, ranks[0], strict=True)
    ]
    best = [
        (row, 2 + column)
        for column, of_metric in enumerate(ranks)
        for row, rank in enumerate(of_metric)
        if rank == 1 < max(of_metric)
    ]
    columns = (as_printed(m)[0] if paper else f"{m.label} {ARROWS[m.direction]}".rstrip() for m in metrics)
    return Table("Models", ("model", "rank", *columns), rows, best=best)


def _cell(comparison: Comparison, metric: Metric, model: str, *, paper: bool) -> str:
    """Write a number with its interval, or with its p-value where it has a test."""
    _, unit, scale = as_printed(metric) if paper else ("", metric.unit, 1.0)
    value, ends, beside = scale * comparison.value(metric.name, model), _DIGITS, ""
    if metric.deviation is not None:
        p = comparison.test(metric.name, model).p
        beside = "" if math.isnan(p) else p_value(p)
    else:
        interval = comparison.interval(metric.name, model)
        if interval.low < interval.high:  # not unknown, nor of a number that is the same for all sequences
            ends = scale * interval.low, scale * interval.high
            beside = span(*ends, unit)
    shown = number(value, unit, ends)
    return (shown.removesuffix(f" {unit}") if paper else shown) + (f" ({beside})" if beside else "")


def _sources(entries: Sequence[Entry]) -> Table:
    rows = []
    for one in entries:
        commit = one.commit if len(one.commit) <= _COMMIT else one.commit[:12]
        rows.append((one.name, one.source, commit, one.preset or MISSING, one.hypotheses_sha256[:12]))
    headings = ("model and its source", "source", "commit", "preset", "hypotheses")
    return Table("Sources", headings, rows, headings[1:])


def standings_rows(test_set: str, comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Give a row of :data:`COLUMNS` for every metric and model."""
    for name, metric in comparison.metrics.items():
        for model in comparison.names:
            interval = comparison.interval(name, model)
            p = math.nan if metric.deviation is None else comparison.test(name, model).p
            numbers = (comparison.value(name, model), interval.low, interval.high, p, comparison.rank(name, model))
            row = (test_set, model, name, metric.unit, name in comparison.primary, *numbers)
            yield dict(zip(COLUMNS, row, strict=True))
