"""Which numbers does an evaluation give? Tidy rows, each with its definition.

A row is a metric over all poses, over a group of them, or at one joint; beside the calibration errors stand what a
perfect sampler and what chance would show.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import numpy.typing as npt

from posecal.calibration import DEFINITIONS, OverJoints, perfect_sampler
from posecal.engine.metric import Metric
from posecal.engine.totals import Totals
from posecal.stats.resampling import Null
from posecal.stats.uncertainty import independent_poses, interval, joint_intervals, unbiased_squared_error

__all__ = [
    "WORTH",
    "Beside",
    "Cells",
    "Row",
    "adjusted",
    "beside",
    "by_joint",
    "floors",
    "kinds",
    "nulls",
    "over_poses",
    "worth",
]

Cells = npt.NDArray[np.bool_] | None
"""Which of the cells count; None for all."""

Metrics = Mapping[str, Metric]


@dataclass(frozen=True)
class Row:
    """One reported number.

    Attributes
    ----------
    metric : str
        Name in snake case.
    label : str
        Name for people.
    group : str or None
        The poses it is over, as ``label=value``; None for all.
    joint : str or None
        The joint it is about; None for the summary over joints.
    value : float
        The number; NaN where nothing counts.
    unit : str
        ``mm``, ``mm/frame``, ``mm/s`` or empty.
    direction : str
        ``lower`` or ``higher`` is better, ``zero`` is best, or ``none``.
    definition : str
        What it is, in one line.
    poses : int
        How many poses count in it.
    low, high : float
        A 95 % interval over repetitions of the sequences; NaN where there is none. Calibration errors have none: for
        them the rows ``…_null``, ``…_null_95`` and ``…_p`` say what a calibrated sampler would show.
    """

    metric: str
    label: str
    group: str | None
    joint: str | None
    value: float
    unit: str
    direction: str
    definition: str
    poses: int
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True)
class Beside:
    """A number that stands beside a calibration error and is no metric of its own.

    Attributes
    ----------
    name, label, definition, direction : str
        As of a :class:`Row`.
    """

    name: str
    label: str
    definition: str
    direction: str = "none"


WORTH = {
    "effective_poses": Beside(
        "effective_poses",
        "effective number of poses",
        "independent poses whose calibration curves would vary as much as those of the sequences do",
    ),
    "squared_error": Beside(
        "squared_error",
        "squared error of the curves, unbiased",
        "mean over joints and q of (ω_k(q) − q)² − its variance over sequences; exchangeable definition",
        "lower",
    ),
}
"""What is said of the exchangeable curves besides their errors."""

_SIGNS = "random signs of whole sequences"
_BESIDE = {
    "null": (", of a calibrated sampler", f"mean of {{}} over {_SIGNS}"),
    "null_95": (", of a calibrated sampler, 95 %", f"95 % quantile of {{}} over {_SIGNS}"),
    "p": (", p-value", f"share of {_SIGNS} that make {{}} as large"),
    "p_adjusted": (", adjusted p-value", f"share of {_SIGNS} that make {{}} as large, adjusted for all tests (Holm)"),
    "floor": (" of a perfect sampler", "expected {} of a perfect sampler"),
    "floor_95": (" of a perfect sampler, 95 %", "95 % quantile of the {} of a perfect sampler"),
}


def kinds(metric: Metric) -> tuple[str, ...]:
    """Which numbers stand beside a metric: endings of its name."""
    if metric.deviation is None:
        return ()
    errors = ("ece", *(f"ece_{definition}" for definition in DEFINITIONS))
    of_battery = ("p_adjusted",) if metric.family == "rank_tests" else ()
    return ("null", "null_95", "p", *of_battery, *(("floor", "floor_95") if metric.name in errors else ()))


def beside(metric: Metric, ending: str) -> Beside:
    """Describe a number that stands beside a metric."""
    label, definition = _BESIDE[ending]
    return Beside(f"{metric.name}_{ending}", metric.label + label, definition.format(metric.label))


def _beside(of: Row, found: Beside, value: float, definition: str = "") -> Row:
    return replace(
        of,
        metric=found.name,
        label=found.label,
        value=value,
        direction=found.direction,
        definition=definition or found.definition,
    )


def over_poses(
    totals: Totals, metric: Metric, group: str | None = None, cells: Cells = None, row: int | None = None
) -> Row:
    """Give a metric over a group of poses, with its interval where it has one; ``row`` is that of its statistic."""
    sure = None if metric.deviation is not None else interval(totals, metric, cells)
    return Row(
        metric=metric.name,
        label=metric.label,
        group=group,
        joint=None,
        value=totals.value(metric, cells),
        unit=metric.unit,
        direction=metric.direction,
        definition=metric.definition,
        poses=totals.count(metric.statistic, cells, row),
        low=math.nan if sure is None else sure.low,
        high=math.nan if sure is None else sure.high,
    )


def by_joint(totals: Totals, metric: Metric) -> Iterator[Row]:
    """Give a metric at each joint where it has a value."""
    if metric.by_joint is None:
        return
    values, whole = totals.by_joint(metric), over_poses(totals, metric)
    counts = np.broadcast_to(totals.counts[metric.by_joint[0].name].sum(axis=0)[: len(values)], values.shape)
    sure = joint_intervals(totals, metric) if metric.deviation is None else None
    for k, joint in enumerate(totals.spec.joints):
        if not math.isnan(values[k]):
            low, high = (math.nan, math.nan) if sure is None else (sure[k].low, sure[k].high)
            yield replace(whole, joint=joint, value=float(values[k]), poses=int(counts[k]), low=low, high=high)


def floors(totals: Totals, metrics: Metrics) -> Iterator[Row]:
    """Give what a perfect sampler's ECE would be with this N, M and K, for each ECE that is reported."""
    for definition in DEFINITIONS:
        name = "ece" if definition == "exchangeable" else f"ece_{definition}"
        if name not in metrics:
            continue
        metric = metrics[name]
        worths = totals.worth(metric.statistic)[:-1]
        poses, joints = round(worths.max(initial=0)), int((worths > 0).sum())
        if not poses:
            continue
        over = cast(OverJoints, totals.protocol.summary_over_joints)
        n = totals.spec.n_hypotheses
        floor = perfect_sampler(n, poses, joints, definition, over)
        many = f"{poses:,} independent pose{'s' * (poses != 1)} and {joints} independent joint{'s' * (joints != 1)}"
        about = f"N={n}, {many} (more where they are correlated)"
        for ending, value in (("floor", floor.mean), ("floor_95", floor.high)):
            found = beside(metric, ending)
            said = f"{found.definition}: {about}; {definition} definition"
            yield _beside(over_poses(totals, metric), found, value, definition=said)


def nulls(totals: Totals, metric: Metric, null: Null, of: Row) -> Iterator[Row]:
    """Give what a calibrated sampler would show for a calibration error, and the p-value, beside the error's row."""
    values = {"null": null.mean, "null_95": null.high, "p": null.p}
    for ending, value in values.items():
        found = beside(metric, ending)
        units = f"; {totals.units(null.sequences)}" if ending == "p" else ""
        yield _beside(of, found, value, definition=found.definition + units)


def adjusted(totals: Totals, tests: Mapping[str, Metric], p: Mapping[str, float]) -> Iterator[Row]:
    """Give the p-value of each test of the battery, adjusted for their number."""
    for name, metric in tests.items():
        found = beside(metric, "p_adjusted")
        yield _beside(over_poses(totals, metric), found, p[name], definition=f"{found.definition}; {len(tests)} tests")


def worth(totals: Totals, metrics: Metrics) -> Iterator[Row]:
    """Give how many independent poses these are worth, and the squared error without what chance adds."""
    if "ece" not in metrics:
        return
    statistic, row = metrics["ece"].statistic, over_poses(totals, metrics["ece"])
    values = independent_poses(totals, statistic), unbiased_squared_error(totals, statistic)
    yield from (_beside(row, found, value) for found, value in zip(WORTH.values(), values, strict=True))
