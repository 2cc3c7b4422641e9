"""Sentences: what the numbers of a report say about calibration, and remarks on what they rest on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from posecal.calibration.error import FEW_HYPOTHESES, unresolved_coverages
from posecal.calibration.expected import ece_range
from posecal.calibration.ranks import DEFINITIONS
from posecal.calibration.standardized import NAME
from posecal.data.frames import DIFFERENT_FRAMES
from posecal.engine.measure import HAS_SPREAD
from posecal.engine.scope import Scope
from posecal.engine.totals import Totals
from posecal.engine.weighted import LEAST_SPREAD
from posecal.errors import first_few, for_python
from posecal.metrics.likelihood import LIKELIHOODS, likelihood_remarks, moments_statistic
from posecal.metrics.occlusion import occlusion_words
from posecal.registry import left_out
from posecal.report.evidence import STRONG, evidence_of
from posecal.report.format import counted
from posecal.report.sentences import sentences
from posecal.stats.resampling import MIN_SEQUENCES
from posecal.stats.uncertainty import (
    are_points,
    effective_hypotheses,
    measured_spec,
    p_without_each,
    weights_allow_no_test,
)

if TYPE_CHECKING:
    from posecal.report.report import Report

FEW_SEQUENCES = 20
"""With fewer sequences than this the report says what p-values assume: rare bad ones may be missing from so few."""

_SYMMETRY = "p-values assume that sequences err to either side alike"

_FEW_BY_WEIGHTS = (
    f" Below an effective N of {FEW_HYPOTHESES}, the ECE of a calibrated model is up to about 0.6 / effective N, and "
    "scores are up to 9 % too low: calibration errors and rank tests are not tested."
)


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
    if not totals.has_sequences:
        consecutive = units.replace("of frames", "of consecutive frames")
        are = "is" if totals.n_sequences == 1 else "are"
        yield f"no sequence labels: {consecutive} {are} taken as independent. In a video they are not."
    sequences = totals.n_sequences
    if sequences < MIN_SEQUENCES:
        yield (
            f"{units} allow{'s' * (sequences == 1)} no test: even if all err alike, chance would do that in "
            f"{2 / 2**sequences:.0%} of cases. At least {MIN_SEQUENCES} are needed for a p-value."
        )
    elif sequences < FEW_SEQUENCES and "ece" in report.metrics and not weights_allow_no_test(totals):
        yield _of_symmetry(report)
    if (average := totals.protocol.average) != "poses":
        groups = [value for value, _ in totals.groups(average)]
        yield f"numbers are means over {len(groups):,} values of {average} ({first_few(groups, 5)})."
    steps = {name: m.statistic for name, m in report.metrics.items() if m.statistic.earlier == 1}
    if steps and totals.has_sequences and totals.poses.sum() > sequences and not any(map(totals.count, steps.values())):
        yield (
            f"{next(iter(steps))}: no value, because no frame comes right after another of its sequence; expected the "
            "frames of each sequence one after another, or a frame_id with their numbers."
        )
    if line := left_out(totals.protocol, totals.spec):
        yield line
    if "occlusion" in report.by:
        yield occlusion_words(totals.protocol, totals.spec)
    if {*LIKELIHOODS} & report.metrics.keys():
        yield from _of_likelihood(totals)
    n, families = totals.spec.n_hypotheses, {metric.family for metric in report.metrics.values()}
    effective = effective_hypotheses(totals)
    if n > 1 and totals.spec.has_weights:
        few = _FEW_BY_WEIGHTS * weights_allow_no_test(totals)
        of_up_to = f"effective N = {effective:.1f} (mean of 1 / Σ w²), of up to {n}{_unknown_coverage(report)}"
        yield f"hypotheses count by their weights: {of_up_to}.{few}"
    elif n > 1 and totals.spec.has_scores and {"calibration", "rank_tests", "scores"} & families:
        yield (
            "scores are not used by calibration and proper scores, which count all hypotheses alike. Where they are "
            "chances of the hypotheses, give them as weights."
        )
    if {"calibration", "rank_tests", "scores", "sharpness"} & families:
        yield from _of_poses_without_spread(totals)
    if n < 2:
        yield "calibration and spread need at least 2 hypotheses; there is 1."
    elif n < FEW_HYPOTHESES and "calibration" in families and not totals.spec.has_weights:
        yield _of_few_hypotheses(report, n)
    elif totals.spec.is_ragged and not totals.spec.has_weights and _unknown_coverage(report):
        yield f"poses have {effective:.1f} hypotheses on average{_unknown_coverage(report)}."
    yield from _of_what_is_unknown(report)


def _of_poses_without_spread(totals: Totals) -> Iterator[str]:
    """Count the poses that drop out of what needs several hypotheses."""
    poses = int(totals.poses.sum())
    alone = poses - round(float(totals.sums.get(HAS_SPREAD.name, totals.poses).sum()))
    if alone:
        yield (
            f"{counted(alone, 'pose')} of {poses:,} ha{'s' if alone == 1 else 've'} one hypothesis, or one of nearly "
            f"all weight (effective N below {LEAST_SPREAD:g}): calibration, scores and spread are those of the other "
            f"{poses - alone:,}."
        )


def _of_few_hypotheses(report: Report, n: int) -> str:
    """Say which values an ECE can have, and at which levels coverage is not known."""
    low, high = ece_range(n)
    return (
        f"N = {n} hypotheses are few: an ECE lies between {low:.2g} and {high:.2g}; look at what a perfect sampler "
        f"would show before reading an ECE (paper){_unknown_coverage(report)}."
    )


def _unknown_coverage(report: Report) -> str:
    """Say at which levels coverage is not known."""
    levels = unresolved_coverages(measured_spec(report.totals).n_in_balls)
    hidden = [percent for percent in levels if f"coverage_{percent}" in report.metrics]
    if not hidden:
        return ""
    words = " or ".join(filter(None, [", ".join(map(str, hidden[:-1])), *(f"{p} %" for p in hidden[-1:])]))
    return f"; no ball holds {words} of them, so that coverage is not known"


def _of_what_is_unknown(report: Report) -> Iterator[str]:
    """Give the reasons of calibration numbers that are NaN, or are of fewer joints."""
    totals, metrics = report.totals, report.metrics
    empty = _joints_without_a_rank(totals)
    if empty and len(empty) == totals.counts[NAME].any(axis=0).sum():
        yield "all hypotheses equal the truth at every joint that counts: no calibration can be measured."
        return
    if empty:
        yield (
            f"at {first_few(empty, 6)} all hypotheses equal the truth in every pose: no calibration can be measured "
            "there, and its summaries over joints leave them out."
        )
    tested = next((metric for metric in metrics.values() if metric.deviation is not None), None)
    if tested is not None and not _is_summarized(report) and are_points(totals, tested):
        yield "the hypotheses of each pose are all the same: they have no spread that could be tested."
    if "tarp_box" in metrics and not report.count("tarp_box") and totals.poses.any():
        yield "tarp_box: no value, because the true poses of the other sequences have no range; expected several."


def _joints_without_a_rank(totals: Totals) -> list[str]:
    """Name the joints at which the truth has no rank in any pose, because all hypotheses equal it."""
    counts, ranks = totals.counts, f"inside_{DEFINITIONS[0]}"
    if not {NAME, ranks} <= counts.keys():
        return []
    empty = np.asarray(counts[NAME].any(axis=0) & ~counts[ranks][:, :-1].any(axis=0))
    return [totals.spec.joints[k] for k in np.flatnonzero(empty)]


def _of_likelihood(totals: Totals) -> Iterator[str]:
    scope = Scope(totals.protocol, totals.spec)
    moments = moments_statistic(scope)
    name = "" if moments is None else moments.name
    sums, counts = totals.sums.get(name), totals.counts.get(name, totals.poses)
    of_others = math.nan if sums is None or moments is None else float(totals.mean(moments)[1])
    yield from likelihood_remarks(scope, sums, counts, totals.sequence_of, of_others)


def _of_symmetry(report: Report) -> str:
    """Say what p-values assume, and between which values that of the ECE is without any one of the sequences."""
    p = report.once(("p without each",), lambda: p_without_each(report.totals, report.metrics["ece"]))
    known = p[~np.isnan(p)]
    if not len(known):
        return f"{_SYMMETRY}."
    low, high = (f"{p:.2f}" if p >= STRONG else f"below {STRONG:g}" for p in (known.min(), known.max()))
    moves = f"stays {high}" if low == high else f"is {low} to {high}"
    return f"{_SYMMETRY}; without any one, p {moves}."


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
