"""What a report knows about calibration, gathered once, for the sentences that may be said about it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from posecal.calibration.modes import LEAST, share_with_modes
from posecal.calibration.standardized import MODES
from posecal.engine.bounds import UNBOUNDED, Bounds, to_scale
from posecal.stats.heterogeneity import SequenceAreas, sequences_differ
from posecal.stats.resampling import LEVEL, STRONG
from posecal.stats.uncertainty import bias_of_weights, effective_hypotheses, freedom_of, weights_allow_no_test

if TYPE_CHECKING:
    from posecal.report.report import Report

ONE_SIDED = 0.5
"""Share of an ECE above which the signed area names a side: |∫ (ω − q) dq| ≤ ∫ |ω − q| dq, and where it is more than
half of that, more than three quarters of the deviation lie on one side of the diagonal."""

ROUNDING = 1e-6
"""A spread of no more than so much of the error is rounding of single precision."""

OVER, UNDER, NEITHER = "overconfident", "underconfident", "miscalibrated, on neither side throughout"


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
    if abs(area) <= ONE_SIDED * error:
        return NEITHER
    return OVER if area < 0 else UNDER


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval, and what it is for a calibrated model.

    Attributes
    ----------
    label : str
        Its name in tables.
    value, low, high : float
        The number and the ends of its interval; NaN where there is none.
    best : float
        What a calibrated model has.
    freedom : float
        Degrees of freedom of the interval.
    bounds : tuple of two float
        Smallest and largest possible value.
    slack : float
        By so much that of calibrated draws with weights may differ from what is best.
    """

    label: str
    value: float
    low: float
    high: float
    best: float
    freedom: float = math.nan
    bounds: Bounds = UNBOUNDED
    slack: float = 0.0

    @property
    def excludes(self) -> int:
        """Give -1 where the whole interval lies below what is best, 1 where above, and 0 where neither is known."""
        return int(self.low > self.best + self.slack) - int(self.high < self.best - self.slack)

    def excludes_at_99(self) -> bool:
        """Whether its 99 % interval does as well: wider on the number's own scale by the ratio of Student's quantiles.

        At the edge of the range, where the scale ends, on the plain one.
        """
        from scipy.special import stdtrit

        near = self.low if self.value > self.best else self.high
        if not self.excludes or math.isnan(self.freedom):
            return False
        ends = np.array([self.value, near, self.best + math.copysign(self.slack, self.value - self.best)])
        scaled = to_scale(ends, self.bounds)
        value, near, best = scaled if np.isfinite(scaled).all() else ends
        wider = float(stdtrit(self.freedom, 0.995) / stdtrit(self.freedom, 0.975))
        return bool(abs(value - near) * wider < abs(value - best))


@dataclass(frozen=True)
class NullComparison:
    """A calibration error against those of a calibrated sampler.

    Attributes
    ----------
    error, mean, high, p : float
        The error; mean and 95 % quantile of a calibrated sampler's; p-value, NaN without a test.
    """

    error: float
    mean: float = math.nan
    high: float = math.nan
    p: float = math.nan


@dataclass(frozen=True)
class Joint:
    """The calibration curve of one joint.

    Attributes
    ----------
    error, p : float
        ECE, and its p-value, adjusted for the number of joints.
    area : Estimate
        Signed area.
    """

    error: float
    p: float
    area: Estimate


@dataclass(frozen=True)
class Sequences:
    """The sequences that deviate most to either side.

    Attributes
    ----------
    lowest, highest : tuple of str and float
        Name and signed area.
    independent, frames : float
        As how many independent frames a sequence counts at most if the model is calibrated in each, and how many it
        has, on average.
    p : float
        Of the test that sequences differ from beginning to end; NaN without one.
    """

    lowest: tuple[str, float]
    highest: tuple[str, float]
    independent: float
    frames: float
    p: float = math.nan


@dataclass(frozen=True)
class Evidence:
    """All that the sentences of a summary rest on.

    Attributes
    ----------
    ece : NullComparison
        The ECE.
    area : Estimate
        The signed area.
    units : str
        What is treated as independent, with its number: ``16 sequences``.
    n_units : int
        That number.
    floor : float
        The 95 % quantile of a perfect sampler's ECE over as many independent poses.
    coverage : tuple of Estimate
        The coverages that the report shows.
    balls : str
        What the truths are covered by: ``balls`` or ``intervals``.
    sequences : Sequences or None
        None where there are no two sequences long enough.
    joints : dict of Joint
        Those that could be tested.
    mean_of_joints : NullComparison or None
        The mean of the joints' own ECEs; None where it is not needed.
    rank_tests : tuple of tuple
        Label, what a rejection means, and adjusted p-value of each.
    modes : dict of float
        Joints at which hypotheses have two modes, beyond chance, and in which share of the poses.
    spreads : bool
        Whether the hypotheses of a pose differ.
    few_by_weights : float
        The effective number of hypotheses with unequal weights, where it is too small for a test; else NaN.
    """

    ece: NullComparison
    area: Estimate
    units: str = "0 sequences"
    n_units: int = 0
    floor: float = math.nan
    coverage: tuple[Estimate, ...] = ()
    balls: str = "balls"
    sequences: Sequences | None = None
    joints: dict[str, Joint] = field(default_factory=dict)
    mean_of_joints: NullComparison | None = None
    rank_tests: tuple[tuple[str, str, float], ...] = ()
    modes: dict[str, float] = field(default_factory=dict)
    spreads: bool = True
    few_by_weights: float = math.nan

    @cached_property
    def strong(self) -> bool:
        """Whether the ECE is beyond chance."""
        return self.is_beyond_chance(self.ece.p, self.area)

    def is_beyond_chance(self, p: float, area: Estimate) -> bool:
        """Whether a curve is off beyond chance, by its p-value and its signed area.

        That is p < 0.01; or, since few sequences have no such p, p < 0.05 where the 99 % interval of the signed area
        excludes 0.
        """
        return p < STRONG or (p < LEVEL and area.excludes_at_99())

    @cached_property
    def side(self) -> str:
        """The side of the curve; neither, too, where a coverage lies on the other side with its whole interval."""
        side = side_of(self.area.value, self.ece.error)
        sign = {OVER: -1, UNDER: 1}.get(side, 0)
        return NEITHER if any(row.excludes == -sign != 0 for row in self.coverage) else side

    @property
    def excluded(self) -> tuple[Estimate, ...]:
        """The numbers whose intervals exclude what a calibrated model has."""
        return tuple(row for row in (self.area, *self.coverage) if row.excludes)


@dataclass(frozen=True)
class Rule:
    """One thing that a summary may say.

    Attributes
    ----------
    group, name : str
        Of each group the first rule that holds applies.
    when : str
        The condition in words, for the documentation.
    holds : callable
        The condition.
    say : callable
        The sentence.
    alone : bool
        Whether nothing else is said beside it.
    """

    group: str
    name: str
    when: str
    holds: Callable[[Evidence], bool]
    say: Callable[[Evidence], str]
    alone: bool = False


def evidence_of(report: Report) -> Evidence:
    """Gather what a report knows about calibration.

    Parameters
    ----------
    report : Report
        With ``ece`` and ``signed_area``.

    Returns
    -------
    Evidence
        What its sentences rest on.
    """
    totals, test = report.totals, report.test("ece")
    ece = NullComparison(report["ece"], test.mean, test.high, test.p)
    prefix = "interval_coverage_" if "interval_coverage_90" in report.headline_metrics else "coverage_"
    shown = [name for name in report.headline_metrics if name.startswith(prefix)]
    evidence = Evidence(
        ece=ece,
        area=_estimate(report, "signed_area"),
        units=totals.units(test.sequences),
        n_units=test.sequences,
        floor=report["ece_floor_95"] if math.isnan(test.p) else math.nan,
        coverage=tuple(_estimate(report, name) for name in shown),
        balls="intervals" if prefix != "coverage_" else "balls",
        sequences=_sequences(report),
        joints=dict(_joints(report)),
        modes=_modes(report),
        rank_tests=tuple(
            (report.metrics[name].label, report.metrics[name].rejection, p)
            for name, (_, p) in report.rank_tests().items()
        ),
        spreads=not {"diversity", "mpjpe"} <= report.metrics.keys() or report["diversity"] > ROUNDING * report["mpjpe"],
        few_by_weights=effective_hypotheses(totals) if weights_allow_no_test(totals) else math.nan,
    )
    if evidence.strong or math.isnan(test.p) or "ece_mean" not in report.metrics or len(totals.spec.joints) < 2:
        return evidence
    mean = report.test("ece_mean")
    return replace(evidence, mean_of_joints=NullComparison(report["ece_mean"], mean.mean, mean.high, mean.p))


def _estimate(report: Report, name: str) -> Estimate:
    metric = report.metrics[name]
    freedom, slack = freedom_of(report.totals, metric), bias_of_weights(report.totals)
    low, high = report.interval(name)
    return Estimate(metric.label, report[name], low, high, metric.calibrated, freedom, metric.bounds, slack)


def _joints(report: Report) -> Iterator[tuple[str, Joint]]:
    for joint, (area, p) in report.joint_tests().items():
        estimate, metric = Estimate("signed area", area, math.nan, math.nan, 0.0), report.metrics["signed_area"]
        if p < LEVEL:
            low, high = report.interval("signed_area", joint=joint)
            freedom = freedom_of(report.totals, metric, report.totals.spec.joints.index(joint))
            estimate = replace(estimate, low=low, high=high, freedom=freedom, bounds=metric.bounds)
        yield joint, Joint(report.value("ece", joint=joint), p, estimate)


def differences_of(report: Report) -> tuple[SequenceAreas, float]:
    """Give the signed areas of single sequences, and the p-value of their differences, computed once."""
    return report.once(("sequences differ",), lambda: sequences_differ(report.totals, report.metrics))


def _sequences(report: Report) -> Sequences | None:
    found, p = differences_of(report)
    if len(found.names) < 2:
        return None
    low, high = int(np.argmin(found.areas)), int(np.argmax(found.areas))
    return Sequences(
        (found.names[low], float(found.areas[low])),
        (found.names[high], float(found.areas[high])),
        found.independent_frames,
        found.frames,
        p,
    )


def _modes(report: Report) -> dict[str, float]:
    """Give the joints at which two modes are beyond chance, and in which share of their poses they have two."""
    totals, deviation = report.totals, report.metrics["ece"].deviation
    statistic = None if deviation is None else deviation.errors
    if statistic is None or statistic.name not in totals.sums:
        return {}
    sums, counts = (part.sum(axis=0) for part in totals.of_cells(statistic, None))
    if sums.shape[-1] <= MODES:
        return {}
    n = LEAST if totals.spec.is_ragged or totals.spec.has_weights else totals.spec.n_hypotheses
    share, limit = share_with_modes(sums[..., MODES], counts, n)
    return {joint: float(s) for joint, s, most in zip(totals.spec.joints, share, limit, strict=True) if s > most}
