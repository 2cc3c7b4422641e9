"""Remarks on what numbers rest on: sequences, weights, few hypotheses, poses without a spread, likelihoods."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

from posecal.calibration.error import FEW_HYPOTHESES, unresolved_coverages
from posecal.calibration.expected import ece_range
from posecal.data.arrays import FloatArray
from posecal.data.remarks import Count
from posecal.engine.measure import HAS_SPREAD
from posecal.engine.metric import Metric, Statistic
from posecal.engine.scope import Scope
from posecal.engine.sums import Counts
from posecal.engine.totals import Totals
from posecal.engine.weighted import LEAST_SPREAD
from posecal.errors import first_few
from posecal.metrics.likelihood import LIKELIHOODS, is_unbounded, likelihood_remarks, moments_statistic
from posecal.registry import left_out
from posecal.stats.heterogeneity import COLUMNS, SequenceAreas, remark_on_differences
from posecal.stats.resampling import Null
from posecal.stats.uncertainty import effective_hypotheses, measured_spec, weights_allow_no_test

_FEW_BY_WEIGHTS = (
    f" Below an effective N of {FEW_HYPOTHESES}, the ECE of a calibrated model is up to about 0.6 / effective N, and "
    "scores are up to 9 % too low: calibration errors and rank tests are not tested."
)


def remarks_on_sequences(totals: Totals) -> Iterator[str]:
    """Say what is taken as independent where no sequences are labelled."""
    if not totals.has_sequences:
        consecutive = totals.units().replace("of frames", "of consecutive frames")
        are = "is" if totals.n_sequences == 1 else "are"
        yield f"no sequence labels: {consecutive} {are} taken as independent. In a video they are not."


def remarks_on_numbers(totals: Totals, metrics: Mapping[str, Metric]) -> Iterator[str]:
    """Say what a careful reader should know about the numbers of a report, or of a model of a comparison.

    Parameters
    ----------
    totals : Totals
        The sums.
    metrics : mapping of Metric
        Those that are shown, by name.
    """
    if (average := totals.protocol.average) != "poses":
        groups = [value for value, _ in totals.groups(average)]
        yield f"numbers are means over {len(groups):,} values of {average} ({first_few(groups, 5)})."
    steps = {name: m.statistic for name, m in metrics.items() if m.statistic.earlier == 1}
    several = totals.has_sequences and totals.poses.sum() > totals.n_sequences
    if steps and several and not any(map(totals.count, steps.values())):
        yield (
            f"{next(iter(steps))}: no value, because no frame comes right after another of its sequence; expected the "
            "frames of each sequence one after another, or a frame_id with their numbers."
        )
    if line := left_out(totals.protocol, totals.spec):
        yield line
    yield from _of_segments(totals, metrics)
    if {*LIKELIHOODS} & metrics.keys():
        yield from _of_likelihood(totals)
    n, families = totals.spec.n_hypotheses, {metric.family for metric in metrics.values()}
    effective = effective_hypotheses(totals)
    if n > 1 and totals.spec.has_weights:
        few = _FEW_BY_WEIGHTS * weights_allow_no_test(totals)
        of_up_to = f"effective N = {effective:.1f} (mean of 1 / Σ w²), of up to {n}{_unknown_coverage(totals, metrics)}"
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
        yield _of_few_hypotheses(totals, metrics)
    elif totals.spec.is_ragged and not totals.spec.has_weights and _unknown_coverage(totals, metrics):
        yield f"poses have {effective:.1f} hypotheses on average{_unknown_coverage(totals, metrics)}."


def remarks_on_chance(
    metrics: Mapping[str, Metric],
    test: Callable[[str], Null],
    differences: Callable[[], tuple[SequenceAreas, float]],
    chance: str = COLUMNS,
) -> Iterator[str]:
    """Say where what a calibrated sampler would show is not known, or is of one whose sequences differ.

    Parameters
    ----------
    metrics : mapping of Metric
        Those that are shown, by name.
    test : callable
        Gives the test of a metric.
    differences : callable
        Gives what :func:`posecal.stats.heterogeneity.sequences_differ` does.
    chance : str
        What is said of a calibrated sampler.
    """
    tested = next((name for name, metric in metrics.items() if metric.deviation is not None), None)
    if tested is None or math.isnan((null := test(tested)).p):
        return
    if math.isnan(null.mean):
        yield (
            "what a calibrated sampler would show is not known: hypotheses are so much too wide for their number that "
            "nothing tells how much frames resemble each other. p-values don't rest on it."
        )
    elif remark := remark_on_differences(*differences(), chance):
        yield remark


def _of_segments(totals: Totals, metrics: Mapping[str, Metric]) -> Iterator[str]:
    """Count the poses of segments that can't be aligned."""
    of_segments = [metric for metric in metrics.values() if metric.statistic.by_segment]
    poses = int(totals.poses.sum())
    for left in sorted({poses - totals.count(metric.statistic) for metric in of_segments} - {0}):
        labels = [metric.label for metric in of_segments if poses - totals.count(metric.statistic) == left]
        yield (
            f"{', '.join(labels)}: {Count(left, 'pose')} of {poses:,} left out: without a joint that counts, or in a "
            "segment with fewer than three joints to align."
        )


def _of_poses_without_spread(totals: Totals) -> Iterator[str]:
    """Count the poses that drop out of what needs several hypotheses."""
    poses = int(totals.poses.sum())
    alone = poses - round(float(totals.sums.get(HAS_SPREAD.name, totals.poses).sum()))
    if alone:
        yield (
            f"{Count(alone, 'pose')} of {poses:,} ha{'s' if alone == 1 else 've'} one hypothesis, or one of nearly "
            f"all weight (effective N below {LEAST_SPREAD:g}): calibration, scores and spread are those of the other "
            f"{poses - alone:,}."
        )


def _of_few_hypotheses(totals: Totals, metrics: Mapping[str, Metric]) -> str:
    """Say which values an ECE can have, and at which levels coverage is not known."""
    n = totals.spec.n_hypotheses
    low, high = ece_range(n)
    return (
        f"N = {n} hypotheses are few: an ECE lies between {low:.2g} and {high:.2g}; look at what a perfect sampler "
        f"would show before reading an ECE (paper){_unknown_coverage(totals, metrics)}."
    )


def _unknown_coverage(totals: Totals, metrics: Mapping[str, Metric]) -> str:
    """Say at which levels coverage is not known."""
    levels = unresolved_coverages(measured_spec(totals).n_in_balls)
    hidden = [percent for percent in levels if f"coverage_{percent}" in metrics]
    if not hidden:
        return ""
    words = " or ".join(filter(None, [", ".join(map(str, hidden[:-1])), *(f"{p} %" for p in hidden[-1:])]))
    return f"; no ball holds {words} of them, so that coverage is not known"


def _of_likelihood(totals: Totals) -> Iterator[str]:
    scope, moments, sums, counts = _moments(totals)
    of_others = math.nan if sums is None or moments is None else float(totals.mean(moments)[1])
    yield from likelihood_remarks(scope, sums, counts, totals.sequence_of, of_others)


def likelihood_is_unbounded(totals: Totals) -> bool:
    """Whether the true poses obey constraints, so that a likelihood ranks no models."""
    scope, _, sums, counts = _moments(totals)
    return sums is not None and is_unbounded(scope, sums, counts, totals.sequence_of)


def _moments(totals: Totals) -> tuple[Scope, Statistic | None, FloatArray | None, Counts]:
    """Give the sums of the true poses' moments, and how many poses they are of."""
    scope = Scope(totals.protocol, totals.spec)
    moments = moments_statistic(scope)
    name = "" if moments is None else moments.name
    return scope, moments, totals.sums.get(name), totals.counts.get(name, totals.poses)
