"""Sentences: what the numbers of a report say about calibration, and remarks on what they rest on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from posecal.data.frames import DIFFERENT_FRAMES
from posecal.engine.totals import Totals
from posecal.errors import first_few, for_python
from posecal.metrics.occlusion import occlusion_words
from posecal.registry import left_out
from posecal.report.format import counted, p_value
from posecal.stats.resampling import LEVEL, MIN_SEQUENCES
from posecal.stats.uncertainty import p_without_each

if TYPE_CHECKING:
    from posecal.report.report import Report

ONE_SIDED = 0.5
"""Share of an ECE above which the signed area names a side: |∫ (ω − q) dq| ≤ ∫ |ω − q| dq, and where it is more than
half of that, more than three quarters of the deviation lie on one side of the diagonal."""

FEW_HYPOTHESES = 20
"""With fewer hypotheses than this a perfect sampler's ECE (paper) is above 0.018, however many poses there are."""

FEW_SEQUENCES = 20
"""With fewer sequences than this the report says what p-values assume: rare bad ones may be missing from so few."""

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
    elif sequences < FEW_SEQUENCES and "ece" in report.metrics:
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
    n = totals.spec.n_hypotheses
    if n < 2:
        yield "calibration and spread need at least 2 hypotheses; there is 1."
    elif n < FEW_HYPOTHESES and any(metric.family == "calibration" for metric in report.metrics.values()):
        yield f"N = {n} hypotheses are few: look at what a perfect sampler would show before reading an ECE (paper)."


def _of_symmetry(report: Report) -> str:
    """Say what p-values assume, and between which values that of the ECE is without one of the sequences."""
    p = report.once(("p without each",), lambda: p_without_each(report.totals, report.metrics["ece"]))
    known = p[~np.isnan(p)]
    moves = f"; without one sequence, the ECE's is {known.min():.3f} to {known.max():.3f}" if len(known) else ""
    return f"p-values assume errors to both sides alike{moves}."


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
    if frames_differ(report.totals):
        return []  # what a curve says then is about axes, not about the model
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
    if name in report.metrics:
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
        yield f"Rank tests reject as well: {labels}. Recalibrate the spread first, then rerun the rank tests."
    elif rejected:
        meanings = dict.fromkeys(metric.rejection for metric in rejected)
        yield f"Rank tests reject what the ECE can't see ({labels}): {'; '.join(meanings)}."
    elif tests and not any(math.isnan(p) for _, p in tests.values()):
        yield "No rank test rejects. A model that ignores the image would pass them too: look at a proper score."
