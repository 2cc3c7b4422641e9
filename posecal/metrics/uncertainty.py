"""Uncertainty: how far the predicted spread of poses goes with their error.

Poses are put in the order of their predicted spread and of their error, and the two orders compared: by rank
correlation, and by how fast the error falls when the most uncertain poses are dropped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np
import numpy.typing as npt

from posecal.calibration.ranks import shared_ranks
from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.bounds import CORRELATION, POSITIVE
from posecal.engine.metric import Metric, Need, Statistic
from posecal.engine.scope import Scope
from posecal.engine.sums import Indices
from posecal.metrics.failures import failure_metrics
from posecal.metrics.position import OfPoses, pose_errors
from posecal.metrics.risk_coverage import known_pairs, risk_metrics, run_numbers
from posecal.metrics.sharpness import predicted_spread

DROPPED: FloatArray = np.arange(20) / 20
"""Shares of poses that the sparsification curve drops: 0, 0.05, … 0.95."""


def rank_correlation(spread: npt.ArrayLike, error: npt.ArrayLike) -> float:
    """Spearman's rank correlation of the predicted spread with the error.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, mm; poses with NaN are left out.

    Returns
    -------
    float
        -1 to 1; higher is better: 1 where the spread puts poses in the order of their errors. NaN where one of the
        two is constant.

    Raises
    ------
    PoseDataError
        For shapes that don't fit.

    Notes
    -----
    Even a perfect sampler does not reach 1: an error is one draw of what the spread describes. Differs from the
    published code: none; ours.

    See Also
    --------
    ause : What dropping poses by their spread loses.

    Examples
    --------
    >>> rank_correlation([10, 20, 30], [5, 40, 20])
    0.5
    """
    s, e = (shared_ranks(values) - (len(values) - 1) / 2 for values in known_pairs(spread, error))
    square = float((s * s).sum() * (e * e).sum())
    return round(float((s * e).sum()) / math.sqrt(square), 12) if square > 0 else math.nan


def sparsification(spread: npt.ArrayLike, error: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Mean error of what is left when the poses of the largest predicted spread are dropped.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, mm; poses with NaN are left out.

    Returns
    -------
    by_spread, by_error : arrays (20,)
        At each share of ``DROPPED``, the mean error of the rest over the mean error of all: dropping by the
        predicted spread, and by the error itself, the best there is. 1 at first; lower is better.

    Raises
    ------
    PoseDataError
        For shapes that don't fit.

    Notes
    -----
    Differs from the published code: none.

    See Also
    --------
    ause : One number from the two curves.

    References
    ----------
    Ilg et al., arXiv:1802.07095 (sparsification curves and their area).

    Examples
    --------
    >>> by_spread, by_error = sparsification([1, 2, 3, 4], [2, 4, 6, 8])
    >>> by_spread[10]
    np.float64(0.6)
    """
    s, e = known_pairs(spread, error)
    if not len(e):
        return np.full(DROPPED.size, np.nan), np.full(DROPPED.size, np.nan)
    number = np.maximum(np.rint((1 - DROPPED) * len(e)).astype(int), 1)
    means = (np.cumsum(e[np.argsort(values, kind="stable")]) / np.arange(1, len(e) + 1) for values in (s, e))
    with np.errstate(invalid="ignore"):  # of errors that are all 0
        by_spread, by_error = (mean[number - 1] / mean[-1] for mean in means)
    return by_spread, by_error


def ause(spread: npt.ArrayLike, error: npt.ArrayLike) -> float:
    """Area under the sparsification error (AUSE): between the sparsification curves by spread and by error.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, mm; poses with NaN are left out.

    Returns
    -------
    float
        Lower is better; 0 where the spread puts poses in the order of their errors.

    Raises
    ------
    PoseDataError
        For shapes that don't fit.

    Notes
    -----
    Mean over the shares of ``DROPPED``, of curves in shares of the mean error, so that models of other errors compare.
    Differs from the published code: none.

    See Also
    --------
    sparsification : The two curves.
    excess_aurc : The same area in mm, over all shares.
    rank_correlation : How alike the two orders are.

    References
    ----------
    Ilg et al., arXiv:1802.07095.

    Examples
    --------
    >>> ause([1, 2, 3], [10, 20, 30])
    0.0
    """
    by_spread, by_error = sparsification(spread, error)
    return float((by_spread - by_error).mean())


# --- without each sequence ------------------------------------------------------------------------------------

MAX_BINS = 512
"""In :func:`rank_correlation_without` the term of second order is summed over at most so many classes of ranks."""


def rank_correlation_without(spread: FloatArray, error: FloatArray, sequence: Indices) -> FloatArray:
    r"""Spearman's rank correlation without the poses of each sequence in turn, from one sort of all poses.

    .. math:: \sum_{m \notin s} (u_m - a_m)(v_m - b_m) =
              \sum_m u_m v_m - \sum_{m \in s} (V_m + U_m) + \sum_m a_m b_m - \sum_{m \in s} (u_m - a_m)(v_m - b_m)

    with the centred ranks u and v among all poses, the centred ranks a and b that the same values would have among the
    poses of s, and the sums V of v over the poses of larger spread and U of u over those of larger error, ties by half.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, without NaN.
    sequence : array of int (M,)
        0 … S - 1, all of which occur.

    Returns
    -------
    array (S,)
        As :func:`rank_correlation`, NaN where one of the two is constant without the sequence.

    Notes
    -----
    Time grows as M log M + S. All is exact but for :math:`\sum_m a_m b_m`, which counts the pairs of poses of the
    sequence below each pose: there the ranks are grouped into up to :data:`MAX_BINS` classes, fewer with more than
    1,000 sequences, and what that leaves out is taken to be the correlation times what it leaves out of the squares.
    With no more poses than classes it is exact as well; with more, a standard error over 10 sequences is off by less
    than 1 % for correlations up to 0.99, by a few at 0.999, and one over more sequences by less.
    """
    S = int(sequence.max(initial=-1)) + 1
    size = np.bincount(sequence, minlength=S)
    n_bins = min(MAX_BINS, len(spread), 64 + int(np.sqrt(2e8 / max(S, 1))))
    first, second = (_RanksWithout.of(values, sequence, size, n_bins) for values in (spread, error))
    joint = np.bincount(first.bins * n_bins + second.bins, minlength=n_bins**2).reshape(n_bins, n_bins)
    cross = ((first.own_by_bin @ joint) * second.own_by_bin).sum(axis=1)
    total, scale = first.rank @ second.rank, np.sqrt((first.rank @ first.rank) * (second.rank @ second.rank))
    cross += total / max(float(scale), 1.0) * (first.lost(sequence) + second.lost(sequence)) / 2
    changed = first.above(second.rank) + second.above(first.rank)
    changed += (first.rank - first.own) * (second.rank - second.own)
    covariance = total + cross - np.bincount(sequence, changed, minlength=S)
    square = first.squares * second.squares
    return np.where(square > 0, np.round(covariance / np.sqrt(np.where(square > 0, square, 1)), 12), np.nan)


@dataclass(frozen=True)
class _RanksWithout:
    """Centred ranks of M values, and what they become without each of S sequences.

    Attributes
    ----------
    code : array of int (M,)
        The number of each value among the distinct ones.
    rank, own : arrays (M,)
        Rank among all, and among those of the same sequence, less their mean; ties share the mean.
    squares : array (S,)
        Sum of the squared ranks of the others among themselves.
    bins : array of int (M,)
        The class of each rank.
    own_by_bin : array (S, bins)
        The centred rank that a value of each class would have among those of the sequence.
    """

    code: Indices
    rank: FloatArray
    own: FloatArray
    squares: FloatArray
    bins: Indices
    own_by_bin: FloatArray

    @classmethod
    def of(cls, values: FloatArray, sequence: Indices, size: Indices, n_bins: int) -> _RanksWithout:
        M, S = len(values), len(size)
        order = np.argsort(values)
        ordered = run_numbers(values[order])
        ties = np.bincount(ordered)
        middle = np.cumsum(ties) - (ties + 1) / 2  # rank of each distinct value, from 0
        sequences = sequence[order]
        within = np.argsort(sequences.astype(np.min_scalar_type(S)), kind="stable")  # numbers of few bits sort fastest
        pairs = run_numbers(ordered[within], sequences[within])
        own_ties = np.bincount(pairs)
        first = within[np.cumsum(own_ties) - own_ties]
        own_sequence, own_code = sequences[first], ordered[first]
        before = (np.cumsum(size) - size)[own_sequence]
        own = np.cumsum(own_ties) - own_ties / 2 - before - size[own_sequence] / 2
        rest = M - size
        lost = np.bincount(own_sequence, _cube(ties[own_code]) - _cube(ties[own_code] - own_ties), minlength=S)
        bins = (middle * n_bins / M).astype(np.intp)
        table = np.bincount(own_sequence * n_bins + bins[own_code], own_ties, S * n_bins).reshape(S, n_bins)
        code, of_pose = np.empty((2, M), dtype=np.intp)
        code[order], of_pose[order[within]] = ordered, pairs
        return cls(
            code=code,
            rank=(middle - (M - 1) / 2)[code],
            own=own[of_pose],
            squares=_cube(rest) - (_cube(ties).sum() - lost),
            bins=bins[code],
            own_by_bin=np.cumsum(table, axis=1) - table / 2 - size[:, None] / 2,
        )

    def above(self, other: FloatArray) -> FloatArray:
        """Sum another quantity over the poses of larger values than each pose's, and half of it over equal ones."""
        by_code = np.bincount(self.code, other)
        return np.asarray((by_code.sum() - np.cumsum(by_code) + by_code / 2)[self.code])

    def lost(self, sequence: Indices) -> FloatArray:
        """Give what the classes leave out of the sum over all poses of the squared own ranks, (S,)."""
        S, n_bins = self.own_by_bin.shape
        changed = 2 * self.above(self.rank) + (self.rank - self.own) ** 2
        exact = self.squares - self.rank @ self.rank + np.bincount(sequence, changed, minlength=S)
        return np.asarray(exact - self.own_by_bin**2 @ np.bincount(self.bins, minlength=n_bins))


def _cube(number: Indices) -> FloatArray:
    """(n³ - n) / 12: the sum of squared centred ranks of n values, and what as many ties take from it."""
    n = number.astype(np.float64)
    return (n * n - 1) * n / 12


def ause_without(spread: FloatArray, error: FloatArray, sequence: Indices) -> FloatArray:
    """Area between the sparsification curves without the poses of each sequence in turn, from one sort of all poses.

    The n poses of smallest spread among the others are the first n + j of all in their order, of which j are the
    sequence's own: those before which there are fewer than n others.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, without NaN.
    sequence : array of int (M,)
        0 … S - 1, all of which occur.

    Returns
    -------
    array (S,)
        As :func:`ause`, NaN where no other pose is left. Exact but for rounding.
    """
    M, S = len(spread), int(sequence.max(initial=-1)) + 1
    error = error.astype(np.float64)  # sums of so many in single precision would be off
    size = np.bincount(sequence, minlength=S)
    rest = M - size
    number = np.maximum(np.rint((1 - DROPPED) * rest[:, None]).astype(np.intp), 1)
    start = np.cumsum(size) - size
    area = np.zeros(S)
    for values, sign in ((spread, 1), (error, -1)):
        order = np.argsort(values, kind="stable")
        total = np.concatenate([[0.0], np.cumsum(error[order])])
        own = np.argsort(sequence[order], kind="stable")  # positions in the order, by sequence
        own_total = np.concatenate([[0.0], np.cumsum(error[order][own])])
        key = np.repeat(np.arange(S), size)
        others = own - (np.arange(M) - start[key])  # of other sequences, before each
        last = np.searchsorted(key * (M + 1) + others, np.arange(S)[:, None] * (M + 1) + number)
        own_sum = own_total[last] - own_total[start][:, None]
        area += sign * ((total[np.minimum(number + last - start[:, None], M)] - own_sum) / number).mean(axis=1)
    mean = (error.sum() - np.bincount(sequence, error, minlength=S)) / np.maximum(rest, 1)
    known = (rest > 0) & (mean > 0)
    return np.where(known, area / np.where(known, mean, 1), np.nan)


# --- metrics --------------------------------------------------------------------------------------------------

_UNCERTAINTY = partial(Metric, unit="", family="sharpness", bounds=POSITIVE)


def uncertainty_metrics(scope: Scope) -> Iterator[Metric]:
    """Orders of poses by predicted spread and by error: correlation, sparsification, risk–coverage, failures."""
    protocol = scope.protocol
    of = cast(OfPoses, protocol.single_pose)
    index = int(protocol.mode) if of == "mode" and protocol.mode != "score" else None
    alike: tuple[Need, ...] = () if index is None else ("alike hypotheses",)  # numbers are others where some are absent
    for metric in _order_metrics(scope, of, index):
        yield replace(metric, needs=(*metric.needs, *alike))


def _order_metrics(scope: Scope, of: OfPoses, index: int | None) -> Iterator[Metric]:
    def spread_and_error(block: Block) -> FloatArray:
        error = pose_errors(block, "none", of, scope.body, index)[:, 0]
        return np.stack([predicted_spread(block, scope.moving), error], axis=1, dtype=np.float64)

    statistic = Statistic("predicted_spread_and_error", spread_and_error, per_pose=True)
    pose, moving, body = of.replace("_", " "), scope.counted(scope.moving), scope.counted(scope.body)
    about = f"predicted spread (mean standard deviation of {moving}) and error of the {pose} (mean over {body})"
    yield _UNCERTAINTY(
        name="spread_error_correlation",
        label="rank correlation of spread and error",
        direction="higher",
        brief="over poses: whether a wide spread is a sign of error",
        definition=f"Spearman's rank correlation over poses of {about}",
        statistic=statistic,
        finish=lambda values: rank_correlation(*values.T),
        leave_out=lambda values, sequence: rank_correlation_without(values[:, 0], values[:, 1], sequence),
        headline=True,
        range="−1 to 1",
        bounds=CORRELATION,
        reading="Whether a wide spread is a sign of error, which is what acting on uncertainty needs. A perfect "
        "sampler stays below 1, since an error is one draw.",
        source="posecal",
    )
    yield _UNCERTAINTY(
        name="ause",
        label="AUSE",
        direction="lower",
        brief="sparsification: error left when poses are dropped by spread, beyond that by error, in mean errors",
        definition="mean over dropped shares 0 … 0.95 of the error left when poses are dropped by spread, minus by "
        f"error, over the mean error; {about}",
        statistic=statistic,
        finish=lambda values: ause(*values.T),
        leave_out=lambda values, sequence: ause_without(values[:, 0], values[:, 1], sequence),
        range="about 0 (spread orders poses as their errors do) upwards",
        reading="What is lost, in mean errors, by dropping poses by their spread instead of their error.",
        source="Ilg et al., arXiv:1802.07095",
    )
    yield from risk_metrics(statistic, about)
    yield from failure_metrics(scope, statistic, about)
