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
from posecal.engine.scope import Scope
from posecal.engine.totals import Totals
from posecal.errors import first_few, for_python
from posecal.metrics.likelihood import LIKELIHOODS, likelihood_remarks, moments_statistic
from posecal.metrics.occlusion import occlusion_words
from posecal.registry import left_out
from posecal.report.format import counted, p_value
from posecal.stats.resampling import LEVEL, MIN_SEQUENCES
from posecal.stats.uncertainty import are_points, effective_hypotheses

if TYPE_CHECKING:
    from posecal.report.report import Report

ONE_SIDED = 0.5
"""Share of an ECE above which the signed area names a side: |∫ (ω − q) dq| ≤ ∫ |ω − q| dq, and where it is more than
half of that, more than three quarters of the deviation lie on one side of the diagonal."""

NEITHER = "miscalibrated, on neither side throughout"


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
        few = " So few leave a calibrated model an ECE of 0.01 to 0.04, and scores 1 to 7 % too low."
        few *= effective < FEW_HYPOTHESES
        yield f"hypotheses count by their weights: effective N = {effective:.1f} (mean of 1 / Σ w²), of up to {n}.{few}"
    elif n > 1 and totals.spec.has_scores and {"calibration", "rank_tests", "scores"} & families:
        yield (
            "scores are not used by calibration and proper scores, which count all hypotheses alike. Where they are "
            "chances of the hypotheses, give them as weights."
        )
    if n < 2:
        yield "calibration and spread need at least 2 hypotheses; there is 1."
    elif n < FEW_HYPOTHESES and "calibration" in families and not totals.spec.has_weights:
        yield _of_few_hypotheses(report, n)
    yield from _of_what_is_unknown(report)


def _of_few_hypotheses(report: Report, n: int) -> str:
    """Say which values an ECE can have, and at which levels coverage is not known."""
    low, high = ece_range(n)
    hidden = [percent for percent in unresolved_coverages(n) if f"coverage_{percent}" in report.metrics]
    levels = " or ".join(filter(None, [", ".join(map(str, hidden[:-1])), *(f"{p} %" for p in hidden[-1:])]))
    unknown = f"; no ball holds {levels} of them, so that coverage is not known" if hidden else ""
    return (
        f"N = {n} hypotheses are few: an ECE lies between {low:.2g} and {high:.2g}; look at what a perfect sampler "
        f"would show before reading an ECE (paper){unknown}."
    )


def _of_what_is_unknown(report: Report) -> Iterator[str]:
    """Give the reasons of calibration numbers that are NaN, or are of fewer joints."""
    totals, metrics = report.totals, report.metrics
    empty = _joints_without_a_rank(totals)
    if empty and len(empty) == totals.counts[NAME].any(axis=0).sum():
        yield "all hypotheses equal the truth at every joint that counts: no calibration can be measured."
        return
    if empty:
        yield (
            f"at {_several(empty)} all hypotheses equal the truth in every pose: no calibration can be measured there, "
            "and its summaries over joints leave them out."
        )
    tested = next((metric for metric in metrics.values() if metric.deviation is not None), None)
    if tested is not None and are_points(totals, tested):
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


def summarize(report: Report) -> list[str]:
    """Say in sentences whether the model is calibrated, at which joints it is not, and what the ECE can't see.

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
    if not {"ece", "signed_area"} <= report.metrics.keys() or math.isnan(report["ece"]):
        return []
    if frames_differ(report.totals) or are_points(report.totals, report.metrics["ece"]):
        return []  # what a curve says then is about axes, or about a spread that is none, not about the model
    return [_of_curve(report), *_of_joints(report), *_of_rank_tests(report)]


def frames_differ(totals: Totals) -> bool:
    """Whether a remark says that the coordinate frames of hypotheses and truth differ."""
    return any(remark.startswith(DIFFERENT_FRAMES) for remark in totals.remarks)


def side_of(area: float, error: float) -> str:
    """Name the side on which a curve lies: of the signed area, where it is more than half of the error, else neither.

    Parameters
    ----------
    area, error : float
        Signed area and ECE of the same curve.

    Returns
    -------
    str
        ``overconfident``, ``underconfident`` or :data:`NEITHER`.

    Examples
    --------
    >>> side_of(-0.03, 0.04), side_of(0.01, 0.04)
    ('overconfident', 'miscalibrated, on neither side throughout')
    """
    return NEITHER if abs(area) <= ONE_SIDED * error else _sign_of(area)


def _sign_of(area: float) -> str:
    return "overconfident" if area < 0 else "underconfident"


def _of_curve(report: Report) -> str:
    error, area, test = report["ece"], report["signed_area"], report.test("ece")
    share, interval = "", report.metrics.get("interval_coverage_90")
    name, what = ("coverage_90", "balls") if interval is None or not interval.headline else (interval.name, "intervals")
    if name in report.metrics and not math.isnan(report[name]):
        share = f"; the 90\u00a0% {what} hold {100 * report[name]:.0f}\u00a0% of the truths"
    if math.isnan(test.p):
        side = side_of(area, error)
        looks = f"ECE {error:.3f}, on neither side throughout" if side == NEITHER else f"Looks {side}"
        return f"{looks} (signed area {area:+.3f}{share}); whether by chance can't be tested here."
    if test.p < LEVEL:
        return (
            f"{side_of(area, error).capitalize()}, beyond chance: ECE {error:.3f} where a calibrated sampler would "
            f"show {test.mean:.3f} ({p_value(test.p)}){share}."
        )
    return (
        f"Not miscalibrated beyond chance: ECE {error:.3f}, and a calibrated sampler would show up to {test.high:.3f} "
        f"on these {report.totals.units(test.sequences)} ({p_value(test.p)}){share}."
    )


def _of_joints(report: Report) -> Iterator[str]:
    tests = report.joint_tests()
    sides: dict[str, list[str]] = {"overconfident": [], "underconfident": [], NEITHER: []}
    for joint, (area, p) in sorted(tests.items(), key=lambda entry: -abs(entry[1][0])):
        if p < LEVEL:
            sides[side_of(area, report.value("ece", joint=joint))].append(joint)
    named = [f"{side}{',' * (side == NEITHER)} at {_several(joints)}" for side, joints in sides.items() if joints]
    if named and len(tests) > 1:
        yield f"Joint by joint: {', '.join(named)} (adjusted for {counted(len(tests), 'joint')})."
    if "ece_mean" in report.metrics and report.test("ece").p >= LEVEL > (p := report.test("ece_mean").p):
        mean = report["ece_mean"]
        yield f"The median over joints hides it: the joints' own errors average {mean:.3f} ({p_value(p)})."


def _several(joints: list[str], most: int = 6) -> str:
    if len(joints) > most:
        return f"{', '.join(joints[:most])} and {len(joints) - most} more"
    return ", ".join(joints[:-1]) + (" and " if len(joints) > 1 else "") + joints[-1]


def _of_rank_tests(report: Report) -> Iterator[str]:
    tests = report.rank_tests()
    rejected = [report.metrics[name] for name, (_, p) in tests.items() if p < LEVEL]
    labels = ", ".join(metric.label for metric in rejected)
    if rejected and report.test("ece").p < LEVEL:
        yield (
            f"Rank tests reject as well: {labels}. Where recalibrating the spread helps (recalibrate fit says so), do "
            "that first, then rerun the rank tests."
        )
    elif rejected:
        meanings = dict.fromkeys(metric.rejection for metric in rejected)
        yield f"Rank tests reject what the ECE can't see ({labels}): {'; '.join(meanings)}."
    elif tests and not any(math.isnan(p) for _, p in tests.values()):
        yield "No rank test rejects. A model that ignores the image would pass them too: look at a proper score."
