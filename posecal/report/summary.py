"""Sentences: what the numbers of a report say about calibration, and remarks on what they rest on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from posecal.data.frames import DIFFERENT_FRAMES
from posecal.engine.totals import Totals
from posecal.engine.weighted import effective_number
from posecal.errors import first_few, for_python
from posecal.metrics.occlusion import occlusion_words
from posecal.report.absent import NO_RANK, joints_without_a_rank, remarks_on_absence
from posecal.report.evidence import differences_of, evidence_of
from posecal.report.sentences import sentences
from posecal.stats.jackknife import FEWEST
from posecal.stats.remarks import remarks_on_chance, remarks_on_numbers, remarks_on_sequences
from posecal.stats.resampling import MIN_SEQUENCES, STRONG
from posecal.stats.uncertainty import (
    are_points,
    p_without_each,
    weights_allow_no_test,
)

if TYPE_CHECKING:
    from posecal.report.report import Report

FEW_SEQUENCES = 20
"""With fewer sequences than this the report says what p-values assume: rare bad ones may be missing from so few."""

_SYMMETRY = "p assumes that sequences err to either side alike"


def remarks(report: Report, words: Callable[[str], str] = for_python) -> tuple[str, ...]:
    """Say what a careful reader should know about the data and about what can be tested on them.

    Parameters
    ----------
    report : Report
        The numbers.
    words : callable
        How options are named: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.
    """
    return tuple(words(remark) for remark in (*report.totals.remarks, *_of_statistics(report)))


def _of_statistics(report: Report) -> Iterator[str]:
    totals, units = report.totals, report.totals.units()
    yield from remarks_on_sequences(totals)
    sequences = totals.n_sequences
    if sequences < MIN_SEQUENCES:
        yield (
            f"{units} allow{'s' * (sequences == 1)} no test: even if all err alike, chance would do that in "
            f"{2 / 2**sequences:.0%} of cases. At least {MIN_SEQUENCES} are needed for a p-value"
            f"{f', {FEWEST} for an interval' * (sequences < FEWEST)}."
        )
    if sequences >= FEWEST and effective_number(np.bincount(totals.sequence_of, totals.poses).astype(np.float64)) < 2:
        yield "one sequence holds so many of the poses that sequences count as fewer than two: there are no intervals."
    if MIN_SEQUENCES <= sequences < FEW_SEQUENCES and _is_tested(report):
        yield _of_symmetry(report)
    if "occlusion" in report.by:
        yield occlusion_words(totals.protocol, totals.spec)
    yield from remarks_on_numbers(totals, report.metrics)
    yield from remarks_on_chance(report.metrics, report.test, lambda: differences_of(report))
    yield from _of_what_is_unknown(report)


def _of_what_is_unknown(report: Report) -> Iterator[str]:
    """Give the reasons of calibration numbers that are NaN, or are of fewer joints."""
    totals, metrics = report.totals, report.metrics
    empty, everywhere = joints_without_a_rank(totals)
    if everywhere:
        yield f"{NO_RANK}: no calibration can be measured."
    elif empty:
        yield (
            f"at {first_few(empty, 6)} all hypotheses equal the truth in every pose: no calibration can be measured "
            "there, and its summaries over joints leave them out."
        )
    tested = next((metric for metric in metrics.values() if metric.deviation is not None), None)
    if not everywhere and tested is not None and not _is_summarized(report) and are_points(totals, tested):
        yield "the hypotheses of each pose are all the same: they have no spread that could be tested."
    yield from remarks_on_absence(report)


def _is_tested(report: Report) -> bool:
    """Whether the ECE has a p-value, of enough sequences, without its computation."""
    if "ece" not in report.metrics or not report.count("ece"):
        return False
    return not are_points(report.totals, report.metrics["ece"]) and not weights_allow_no_test(report.totals)


def _of_symmetry(report: Report) -> str:
    """Say what p-values assume, and between which values that of the ECE is without any one of the sequences."""
    p = report.once(("p without each",), lambda: p_without_each(report.totals, report.metrics["ece"]))
    known = p[~np.isnan(p)]
    if not len(known):
        return f"{_SYMMETRY}."
    low, high = (f"{p:.2f}" if p >= STRONG else f"below {STRONG:g}" for p in (known.min(), known.max()))
    moves = f"stays {high}" if low == high else f"is {low} to {high}"
    return f"{_SYMMETRY}; without any one, the ECE's {moves}."


def summarize(report: Report) -> list[str]:
    """Say in sentences what is shown about calibration, by :data:`posecal.report.sentences.RULES`.

    Parameters
    ----------
    report : Report
        The numbers.

    Returns
    -------
    list of str
        Sentences; none without calibration.

    Examples
    --------
    >>> import numpy as np
    >>> from posecal.evaluation import evaluate
    >>> summarize(evaluate(np.zeros((1, 8, 2, 3)), np.zeros((8, 2, 3)), unit="mm"))
    []
    """
    if not _is_summarized(report):
        return []
    if frames_differ(report.totals):
        return []  # what a curve says then is about axes, not about the model
    return list(sentences(evidence_of(report)))


def _is_summarized(report: Report) -> bool:
    return {"ece", "signed_area"} <= report.metrics.keys() and report.count("ece") > 0


def frames_differ(totals: Totals) -> bool:
    """Whether a remark says that the coordinate frames of hypotheses and truth differ."""
    return any(remark.startswith(DIFFERENT_FRAMES) for remark in totals.remarks)
