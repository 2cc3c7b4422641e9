"""Delete-one-sequence jackknife: metrics without each sequence, and the intervals and p-values that follow.

Leaving out a sequence takes its sums from those of all; every metric is then finished from the stack of S means at
once, in slices of bounded memory. Time is linear in the number of cells, also where groups are averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.engine.bounds import EDGE, UNBOUNDED, Bounds, ends_at_edges, from_scale, to_scale
from posecal.engine.metric import Metric, Statistic
from posecal.engine.sums import Cells, Counts, Indices, Number, compact, mean_of, slices, split_by, sum_by
from posecal.engine.totals import CURVES, Totals, batch_sums

FEWEST = 3
"""Fewer sequences than this have no interval: the t of one degree of freedom is 12.7."""

LARGEST_STEP = float(np.log(5))
"""So far at most a sequence that is left out moves a number on the log or logit scale: where one sequence holds all
misses, the share without it is 1, at infinity. Larger steps cover no better in simulations, smaller ones less."""


@dataclass(frozen=True)
class Interval:
    """A 95 % interval of a number, over repetitions of the sequences.

    Attributes
    ----------
    low, high : float
        Its ends; NaN with fewer than three sequences.
    error : float
        Standard error.
    freedom : float
        Degrees of freedom: the effective number of sequences, less one.
    sequences : int
        How many there are.
    """

    low: float
    high: float
    error: float
    freedom: float
    sequences: int


# --- metrics without each sequence --------------------------------------------------------------------------------


def leave_one_out(totals: Totals, metric: Metric, cells: Cells = None) -> FloatArray:
    """Compute a metric with each sequence left out in turn.

    Parameters
    ----------
    totals : Totals
        The sums.
    metric : Metric
        What is computed, averaged over groups where the option ``average`` says so.
    cells : array of int, optional
        Indices of cells; all by default.

    Returns
    -------
    array (S,)
        In the order of the names of the sequences among the cells.
    """
    if cells is not None and not len(cells):
        return np.zeros(0)
    if totals.protocol.average == "poses":
        return _pooled_without(totals, metric, cells)
    if metric.family in CURVES:
        return _finish_each(totals, metric, cells)
    return _averaged_without(totals, metric, cells)


def sequence_sizes(totals: Totals, metric: Metric, cells: Cells = None) -> FloatArray:
    """Count the poses of each sequence of :func:`leave_one_out` that count in a metric, (S,), on average over joints.

    By the option ``average`` each is a share of the poses of its group, so that all groups weigh the same.
    """
    sequence, S = compact(totals.sequence_of, cells)
    if metric.statistic.per_pose:
        counts = np.bincount(totals.cell_of[totals.known_poses(metric.statistic, cells)], minlength=len(totals.poses))
        counts = counts if cells is None else counts[cells]
    else:
        counts = totals.of_cells(metric.statistic, cells)[1].reshape(len(sequence), -1).mean(axis=1)
    if totals.protocol.average != "poses":
        group, G = compact(totals.group_of, cells)
        number = np.bincount(group, counts, G)[group]
        counts = np.divide(counts, number, out=np.zeros(len(group)), where=number > 0)
    return np.bincount(sequence, counts, S).astype(np.float64)


def joint_leave_one_out(totals: Totals, metric: Metric, cells: Cells = None) -> tuple[FloatArray, Counts]:
    """Compute a metric at each joint with each sequence left out in turn, (S, K), and the poses that count there."""
    if metric.by_joint is None:
        raise ValueError(f"{metric.name} has no values per joint")
    statistic, finish = metric.by_joint
    sizes = joint_sequence_sizes(totals, statistic, cells)
    return _finish(finish, _means_without(totals, statistic, cells)).reshape(sizes.shape), sizes


def joint_sequence_sizes(totals: Totals, statistic: Statistic, cells: Cells = None) -> Counts:
    """Count the poses of each sequence that count at each joint, (S, K)."""
    counts = sum_by(*compact(totals.sequence_of, cells), totals.of_cells(statistic, cells)[1])
    shape = len(counts), len(totals.spec.joints)
    return counts[:, : shape[1]] if counts.ndim > 1 else np.broadcast_to(counts[:, None], shape)


def _finish_each(totals: Totals, metric: Metric, cells: Cells) -> FloatArray:
    means = partial(_means_without, totals, metric.statistic, cells)
    return totals.finished(metric, cells, "without each sequence", lambda finish: _finish(finish, means()))


def _finish(finish: Callable[[FloatArray], npt.ArrayLike], means: Iterable[FloatArray]) -> FloatArray:
    parts = [np.asarray(finish(some), dtype=np.float64) for some in means]
    return np.concatenate(parts) if parts else np.zeros(0)


def _pooled_without(totals: Totals, metric: Metric, cells: Cells) -> FloatArray:
    """Leave out each sequence among some cells from the number over their poses together."""
    if metric.statistic.per_pose:
        return _orders_without(totals, metric, cells)
    if metric.sequences_per_batch:
        return _batches_without(metric, *totals.sequences_in_order(metric, cells))
    return _finish_each(totals, metric, cells)


def _orders_without(totals: Totals, metric: Metric, cells: Cells) -> FloatArray:
    """Leave out each sequence from a number that is read off the order of the poses."""
    poses = totals.known_poses(metric.statistic, cells)
    values = totals.per_pose[metric.statistic.name][poses]
    sequences = np.unique(totals.sequence_of if cells is None else totals.sequence_of[cells])
    present, sequence = np.unique(totals.sequence_of[totals.cell_of[poses]], return_inverse=True)
    if metric.leave_out is None or not len(poses):
        each = range(len(present))
        rest = np.array([float(np.asarray(metric.finish(values[sequence != number]))) for number in each])
    else:
        rest = np.asarray(metric.leave_out(values, sequence), dtype=np.float64)
    if len(present) == len(sequences):
        return rest
    without = np.full(len(sequences), totals.pooled(metric, cells))  # of sequences without a known pose
    without[np.searchsorted(sequences, present)] = rest
    return without


def _batches_without(metric: Metric, order: Indices, sums: FloatArray, counts: Counts) -> FloatArray:
    """Leave out each of S sequences in turn where each k in a row are a batch.

    The batches before the one that is left out stay as they are, those after it move on by one sequence, and its own
    takes in the first sequence of the next.
    """
    S, k = len(sums), metric.sequences_per_batch
    batch = np.arange(S) // k
    following = np.minimum((batch + 1) * k, S)

    def own(values: npt.NDArray[Number]) -> npt.NDArray[Number]:
        padded = np.concatenate([values, np.zeros_like(values[:1])])
        changed: npt.NDArray[Number] = sum_by(batch, -(-S // k), values)[batch] + padded[following] - values
        return changed

    before, after = (
        batch_sums(metric, *(np.add.reduceat(values, np.arange(first, S, k)) for values in (sums, counts)))
        for first in (0, 1)
    )
    changed = batch_sums(metric, own(sums), own(counts))
    total, number = (
        np.concatenate([[0.0], np.cumsum(b)])[batch] + c + (a.sum() - np.concatenate([np.cumsum(a), [a.sum()]])[batch])
        for b, c, a in zip(before, changed, after, strict=True)
    )
    without = np.empty(S)
    without[order] = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    return without


@dataclass(frozen=True)
class _Pairs:
    """Sums over each of P pairs of a sequence and a group of the option ``average``, in the order of the sequences."""

    sequence: Indices
    group: Indices
    sums: FloatArray
    counts: Counts
    group_sums: FloatArray
    group_counts: Counts

    @classmethod
    def of(cls, totals: Totals, statistic: Statistic, cells: Cells) -> _Pairs:
        sequence, _ = compact(totals.sequence_of, cells)
        group, G = compact(totals.group_of, cells)
        sums, counts = totals.of_cells(statistic, cells)
        pairs, of_cell = np.unique(sequence * G + group, return_inverse=True)
        of_pair = sum_by(of_cell, len(pairs), sums), sum_by(of_cell, len(pairs), counts)
        return cls(*np.divmod(pairs, G), *of_pair, sum_by(group, G, sums), sum_by(group, G, counts))

    def rest(self, some: slice) -> tuple[FloatArray, Counts]:
        """Sums and counts of the groups of some pairs without the pairs' sequences."""
        groups = self.group[some]
        return self.group_sums[groups] - self.sums[some], self.group_counts[groups] - self.counts[some]


def _averaged_without(totals: Totals, metric: Metric, cells: Cells) -> FloatArray:
    """Leave out each sequence from the mean of the groups' values: only those of its groups change."""
    values = totals.group_values(metric, cells)
    sequences, S = compact(totals.sequence_of, cells)
    if metric.statistic.per_pose or metric.sequences_per_batch:
        parts = split_by(*compact(totals.group_of, cells))
        rests = [_pooled_without(totals, metric, part if cells is None else cells[part]) for part in parts]
        sequence = np.concatenate([np.unique(sequences[part]) for part in parts])
        group, rest = np.repeat(np.arange(len(parts)), [len(rest) for rest in rests]), np.concatenate(rests)
    else:
        pairs = _Pairs.of(totals, metric.statistic, cells)
        sequence, group = pairs.sequence, pairs.group
        means = (mean_of(*pairs.rest(some)) for some in slices(len(group), pairs.sums[:1].nbytes))
        rest = _finish(metric.finish, means)
    changes = np.nan_to_num(rest) - np.nan_to_num(values)[group]
    gained = (~np.isnan(rest)).astype(np.float64) - ~np.isnan(values)[group]
    total = np.nansum(values) + np.bincount(sequence, changes, S)
    number = (~np.isnan(values)).sum() + np.bincount(sequence, gained, S)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def _means_without(totals: Totals, statistic: Statistic, cells: Cells) -> Iterator[FloatArray]:
    """Give the means of a statistic with each sequence left out in turn, in slices (s, …) of the sequences."""
    if totals.protocol.average == "poses":
        sums, counts = totals.by_sequence(statistic, cells)
        total, number = sums.sum(axis=0), counts.sum(axis=0)
        for some in slices(len(sums), total.nbytes):
            yield mean_of(total - sums[some], number - counts[some])
        return
    pairs = _Pairs.of(totals, statistic, cells)
    means, counted = np.nan_to_num(mean_of(pairs.group_sums, pairs.group_counts)), (pairs.group_counts > 0).astype(int)
    total, number = means.sum(axis=0), counted.sum(axis=0)
    S = int(pairs.sequence.max(initial=-1)) + 1
    for some in slices(S, pairs.sums.nbytes // max(S, 1)):
        of_pairs = slice(*np.searchsorted(pairs.sequence, (some.start, some.stop)))
        sequence, group = pairs.sequence[of_pairs] - some.start, pairs.group[of_pairs]
        sums, counts = pairs.rest(of_pairs)
        n = int(sequence[-1]) + 1
        changes = sum_by(sequence, n, np.nan_to_num(mean_of(sums, counts)) - means[group])
        yield mean_of(total + changes, number + sum_by(sequence, n, (counts > 0).astype(int) - counted[group]))


# --- intervals ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Intervals:
    """95 % intervals of K numbers: the attributes of :class:`Interval` as arrays (K,)."""

    low: FloatArray
    high: FloatArray
    error: FloatArray
    freedom: FloatArray
    sequences: npt.NDArray[np.int_]


def jackknife_columns(
    values: FloatArray, without: FloatArray, sizes: npt.NDArray[Any] | None = None, bounds: Bounds = UNBOUNDED
) -> Intervals:
    """Jackknife many numbers at once; see :func:`jackknife`.

    Parameters
    ----------
    values : array (K,)
        The numbers over all sequences.
    without : array (S, K)
        The numbers with each sequence left out.
    sizes : array (S, K), optional
        How many poses, or which weight, each sequence has in each number; as many in all by default.
    bounds : tuple of two float
        Smallest and largest possible value.
    """
    from scipy.special import stdtrit

    weights = np.ones(without.shape) if sizes is None else np.asarray(sizes, dtype=np.float64)
    counted, freedom = weights > 0, degrees_of_freedom(weights)
    number = counted.sum(axis=0)
    several, student = np.where(np.isnan(freedom), np.nan, number), stdtrit(freedom, 0.975)

    def error_of(steps: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt((several - 1) / several * (np.where(counted, steps, 0) ** 2).sum(axis=0)))

    error = error_of(without - np.where(counted, without, 0).sum(axis=0) / several)
    low, high = values - student * error, values + student * error
    if bounds != UNBOUNDED:
        scaled, rest = to_scale(values, bounds), to_scale(without, bounds)
        inner = np.isfinite(scaled)
        steps = rest - np.where(inner, scaled, 0)
        reach = student * error_of(np.clip(steps, -LARGEST_STEP, LARGEST_STEP))
        ends = (from_scale(np.where(inner, scaled + side * reach, 0), bounds) for side in (-1, 1))
        stays = (~counted | (rest == scaled)).all(axis=0) & ~np.isnan(freedom)
        at_edges = (np.where(stays, end, np.nan) for end in ends_at_edges(values, freedom + 1, bounds))
        is_possible = np.isclose(np.clip(values, *bounds), values, rtol=0, atol=EDGE)
        low, high = (
            np.where(inner, end, np.where(np.isnan(edge), np.where(is_possible, np.clip(plain, *bounds), plain), edge))
            for end, edge, plain in zip(ends, at_edges, (low, high), strict=True)
        )
    return Intervals(low, high, error, freedom, number)


def degrees_of_freedom(weights: FloatArray) -> FloatArray:
    """Effective number of sequences of some sizes (S, K), less one, (K,); NaN where they are too few."""
    squares = (weights**2).sum(axis=0)
    freedom = weights.sum(axis=0) ** 2 / np.where(squares > 0, squares, np.nan) - 1
    return np.where(((weights > 0).sum(axis=0) >= FEWEST) & (freedom >= 1 - 1e-9), freedom, np.nan)


def jackknife(
    value: float, without: FloatArray, sizes: npt.NDArray[Any] | None = None, bounds: Bounds = UNBOUNDED
) -> Interval:
    r"""Interval of a number from its values with each sequence left out.

    .. math:: \hat\theta \pm t_\nu\, \sqrt{\tfrac{S-1}{S} \sum_s (\hat\theta_{(s)} - \bar\theta_{(\cdot)})^2},
              \qquad \nu = \frac{(\sum_s n_s)^2}{\sum_s n_s^2} - 1

    and of a number with a possible range the same on the scale of :func:`posecal.engine.bounds.to_scale`, about the
    number itself, so that the ends stay within the range. With sequences of one length, ν is S - 1.

    Parameters
    ----------
    value : float
        The number over all sequences.
    without : array (S,)
        The number with each sequence left out.
    sizes : array (S,), optional
        How many poses each sequence has that count, n, or their weight; as many in all by default. Sequences without
        one are as if they were not there.
    bounds : tuple of two float
        Smallest and largest possible value.

    Returns
    -------
    Interval
        NaN ends with fewer than three sequences, where one of them outweighs the others so much that they count as
        fewer than two, or where the number is not defined without one of them. At the edge of a finite range, where it
        lies there without any sequence too, the ends are those of :func:`posecal.engine.bounds.ends_at_edges`; else
        at the edge the plain ones, cut to the range; outside of it the plain ones.

    Notes
    -----
    For a ratio of sums this is the cluster-robust t interval. Differs from the published code: none; papers report
    spread over sampling seeds, which says nothing about other people or clips.

    References
    ----------
    Efron and Stein, Ann. Stat. 9, 586 (1981), doi:10.1214/aos/1176345462.

    Examples
    --------
    The mean of 1, 2 and 3: left-out values 2.5, 2 and 1.5, standard error 1/√3, and t with two degrees of freedom is
    4.3.

    >>> interval = jackknife(2.0, np.array([2.5, 2.0, 1.5]))
    >>> round(interval.error, 6), round(interval.high, 3)
    (0.57735, 4.484)
    """
    many = jackknife_columns(np.array([value]), without[:, None], None if sizes is None else sizes[:, None], bounds)
    if np.isnan(value):
        return Interval(np.nan, np.nan, np.nan, np.nan, int(many.sequences[0]))
    return Interval(*(getattr(many, field.name)[0].item() for field in fields(Interval)))


def paired_p(difference: Interval) -> float:
    """Two-sided p-value of a difference, from its standard error over sequences; NaN where there is no interval."""
    from scipy.special import stdtr

    if np.isnan(difference.error):
        return float("nan")
    middle = (difference.low + difference.high) / 2
    if difference.error == 0:
        return 1.0 if middle == 0 else 0.0
    return float(2 * stdtr(difference.freedom, -abs(middle) / difference.error))
