"""What would each number be without one of the sequences? The samples that intervals are made from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.engine.metric import Metric, Statistic
from posecal.engine.totals import CURVES, Totals, mean_of, mean_of_known

__all__ = ["joints_without", "without"]


def without(totals: Totals, metric: Metric, cells: npt.NDArray[np.bool_] | None = None) -> FloatArray:
    """Give a metric with each sequence left out in turn, (S,)."""
    chosen = np.ones(len(totals.poses), dtype=bool) if cells is None else cells
    names = totals.cells["sequence"]
    if totals.protocol.average != "poses":
        if metric.family in CURVES:
            return np.array([metric.finish(mean) for mean in _averaged_without(totals, metric.statistic, chosen)])
        groups = [chosen & group for _, group in totals.groups(totals.protocol.average)]
        whole = [totals.pooled(metric, group) for group in groups]
        return np.array(
            [mean_of_known(_left_out(totals, metric, groups, whole, names == n)) for n in np.unique(names[chosen])]
        )
    if metric.sequences_per_batch or metric.statistic.per_pose:
        return np.array([totals.value(metric, chosen & (names != name)) for name in np.unique(names[chosen])])
    sums, counts = totals.by_sequence(metric.statistic, chosen)
    rest, number = sums.sum(axis=0) - sums, counts.sum(axis=0) - counts
    return np.array([metric.finish(mean_of(a, n)) for a, n in zip(rest, number, strict=True)])


def _left_out(
    totals: Totals, metric: Metric, groups: list[npt.NDArray[np.bool_]], whole: list[float], out: npt.NDArray[np.bool_]
) -> list[float]:
    """A metric of each group without some cells; known already for the groups that hold none of them."""
    return [
        totals.pooled(metric, group & ~out) if (group & out).any() else value
        for group, value in zip(groups, whole, strict=True)
    ]


def _averaged_without(totals: Totals, statistic: Statistic, chosen: npt.NDArray[np.bool_]) -> Iterator[FloatArray]:
    """Mean of the groups' means with each sequence left out in turn: only those of its groups change."""
    sums, counts = totals.sums[statistic.name][chosen], totals.counts[statistic.name][chosen]
    group = totals.group_of[chosen]
    _, sequence = np.unique(totals.cells["sequence"][chosen], return_inverse=True)
    total = np.zeros((group.max(initial=-1) + 1, *sums.shape[1:]))
    number = np.zeros((len(total), *counts.shape[1:]), dtype=np.int64)
    np.add.at(total, group, sums)
    np.add.at(number, group, counts)
    means, counted = np.nan_to_num(mean_of(total, number)), number > 0
    added, groups = means.sum(axis=0), counted.sum(axis=0)
    order = np.argsort(sequence, kind="stable")
    for cells in np.split(order, np.flatnonzero(np.diff(sequence[order])) + 1):
        own, place = np.unique(group[cells], return_inverse=True)
        rest, left = total[own], number[own]
        np.subtract.at(rest, place, sums[cells])
        np.subtract.at(left, place, counts[cells])
        changed = np.nan_to_num(mean_of(rest, left)) - means[own]
        yield mean_of(added + changed.sum(axis=0), groups + (left > 0).sum(axis=0) - counted[own].sum(axis=0))


def joints_without(totals: Totals, metric: Metric) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Give a metric per joint with each sequence left out in turn, (S, K), and whether the joint counts in it."""
    if metric.by_joint is None:
        raise ValueError(f"{metric.name} has no values per joint")
    statistic, finish = metric.by_joint
    K, names = len(totals.spec.joints), totals.cells["sequence"]
    sums, counts = totals.by_sequence(statistic)
    if totals.protocol.average == "poses":
        rest, number = sums.sum(axis=0) - sums, counts.sum(axis=0) - counts
        without = [finish(mean_of(a, n)) for a, n in zip(rest, number, strict=True)]
    else:
        without = [finish(mean) for mean in _averaged_without(totals, statistic, np.ones(len(names), dtype=bool))]
    by_joint = counts if counts.ndim > 1 else np.broadcast_to(counts[:, None], (len(counts), K))
    return np.stack(without), by_joint[:, :K] > 0
