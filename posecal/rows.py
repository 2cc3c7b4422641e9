"""Which numbers does an evaluation give? Tidy rows, each with its definition.

A row is a metric over all poses, over a group of them, or at one joint; beside the calibration errors stand what a
perfect sampler and what chance would show.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import numpy.typing as npt

from posecal.calibration import DEFINITIONS, OverJoints, perfect_sampler
from posecal.inference import Null
from posecal.metric import Metric
from posecal.sureness import independent_poses, interval, unbiased_squared_error
from posecal.totals import Totals

__all__ = ["Cells", "Row", "by_joint", "floors", "nulls", "over_poses", "worth"]

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
    values = totals.by_joint(metric)
    whole = replace(over_poses(totals, metric), low=math.nan, high=math.nan)
    counts = np.broadcast_to(totals.counts[metric.by_joint[0].name].sum(axis=0)[: len(values)], values.shape)
    for joint, value, poses in zip(totals.subject.joints, values, counts, strict=True):
        if not math.isnan(value):
            yield replace(whole, joint=joint, value=float(value), poses=int(poses))


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
        n = totals.subject.n_hypotheses
        floor = perfect_sampler(n, poses, joints, definition, over)
        about = f"N={n}, {poses:,} independent poses and {joints} independent joints (more where they are correlated)"
        for ending, words, value in (("", "expected", floor.mean), ("_95", "95 % quantile of the", floor.high)):
            yield replace(
                over_poses(totals, metric),
                metric=f"{name}_floor{ending}",
                label=f"{metric.label} of a perfect sampler{', 95 %' if ending else ''}",
                value=value,
                direction="none",
                definition=f"{words} {metric.label} of a perfect sampler: {about}; {definition} definition",
            )


def nulls(totals: Totals, metrics: Metrics, null: Callable[[str], Null]) -> Iterator[Row]:
    """Give what a calibrated sampler would show for each calibration error, and the p-value."""
    how = "random signs of whole sequences"
    for name, metric in metrics.items():
        if metric.deviation is None:
            continue
        found = null(name)
        words = (
            ("null", "of a calibrated sampler", found.mean, f"mean of {metric.label} over {how}"),
            ("null_95", "of a calibrated sampler, 95 %", found.high, f"95 % quantile of {metric.label} over {how}"),
            ("p", "p-value", found.p, f"share of {how} that make {metric.label} as large; {totals.units(found.sequences)}"),
        )
        for ending, label, value, definition in words:
            yield replace(
                over_poses(totals, metric),
                metric=f"{name}_{ending}",
                label=f"{metric.label}, {label}",
                value=value,
                direction="none",
                definition=definition,
            )


def worth(totals: Totals, metrics: Metrics) -> Iterator[Row]:
    """Give how many independent poses these are worth, and the squared error without what chance adds."""
    if "ece" not in metrics:
        return
    statistic = metrics["ece"].statistic
    row = over_poses(totals, metrics["ece"])
    yield replace(
        row,
        metric="effective_poses",
        label="effective number of poses",
        value=independent_poses(totals, statistic),
        direction="none",
        definition="independent poses whose calibration curves would vary as much as those of the sequences do",
    )
    yield replace(
        row,
        metric="squared_error",
        label="squared error of the curves, unbiased",
        value=unbiased_squared_error(totals, statistic),
        direction="lower",
        definition="mean over joints and q of (ω_k(q) − q)² − its variance over sequences; exchangeable definition",
    )
