r"""Statistics of weighted hypotheses, and poses put together by how many they have and whether their weights differ.

A pose with weights w of sum 1 has an *effective number* of hypotheses :math:`N_\mathrm{eff} = 1 / \sum_i w_i^2`, which
is N where all are equal. Counts become effective counts, :math:`N_\mathrm{eff} \sum_{i \in A} w_i`; with those in
place of counts, and N_eff in place of N, formulas for plain hypotheses hold for weighted ones. Poses whose weights
above 0 are equal are measured as plain ones of the hypotheses that are there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.weights import EQUAL, are_unequal
from posecal.engine.sums import Indices

LEAST_SPREAD = 1.5
"""Poses of a smaller effective number count as such of one hypothesis: what is left of a spread is that of rounding."""

_ROUNDING = 1e-9
"""Sums of weights that differ by less are equal."""

_SLACK = 2 * EQUAL
"""A share q of weights is reached up to this much times q (1 - q), so that nearly equal weights have the quantiles of
equal ones: where weights differ by a share of e, sums of them are off by at most e q (1 - q)."""


def effective_number(weights: FloatArray) -> FloatArray:
    r"""Effective number of hypotheses, of weights (..., N) of any sum, (...).

    .. math:: N_\mathrm{eff} = \frac{(\sum_i w_i)^2}{\sum_i w_i^2}

    Examples
    --------
    >>> effective_number(np.array([[0.25, 0.25, 0.25, 0.25], [1, 0, 0, 0], [0.5, 0.5, 0, 0]]))
    array([4., 1., 2.])
    """
    return np.asarray(weights.sum(axis=-1) ** 2 / (weights**2).sum(axis=-1))


def effective_counts(chosen: BoolArray, weights: FloatArray) -> FloatArray:
    """Effective number of the chosen hypotheses (B, ..., N), of weights (B, N) of any sum, (B, ...)."""
    scaled = weights * (weights.sum(axis=-1) / (weights**2).sum(axis=-1))[:, None]
    return np.asarray(np.einsum("b...n,bn->b...", chosen, scaled))


def weighted_median(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted median along the last axis: the plain one where weights are equal, and continuous in the weights.

    In ascending order each value stands in the middle of its share of the weight; the median is where half is reached,
    on the line between two values.

    Examples
    --------
    The middles lie at 0.1, 0.4 and 0.8.

    >>> weighted_median(np.array([3.0, 1, 7]), np.array([0.4, 0.2, 0.4])).round(9)
    np.float64(4.0)
    """
    ordered, reached = _in_order(values, weights)
    middle = reached - np.diff(reached, axis=-1, prepend=0) / 2
    above = np.minimum((middle < 0.5 - _ROUNDING).sum(axis=-1), values.shape[-1] - 1)[..., None]
    below = np.maximum(above - 1, 0)
    (low, high), (start, end) = (
        [np.take_along_axis(some, at, axis=-1)[..., 0] for at in (below, above)] for some in (ordered, middle)
    )
    share = np.clip(np.divide(0.5 - start, end - start, out=np.ones_like(end), where=end > start), 0, 1)
    return np.asarray(low + share.astype(values.dtype) * (high - low))


def weighted_quantiles(values: FloatArray, weights: FloatArray, shares: tuple[float, ...]) -> FloatArray:
    """Give the smallest values, of (..., N), up to which a share of the weight lies, (..., len(shares))."""
    ordered, reached = _in_order(values, weights)
    at = np.stack(
        [(reached < share - _SLACK * share * (1 - share) - _ROUNDING).sum(axis=-1) for share in shares], axis=-1
    )
    return np.take_along_axis(ordered, np.minimum(at, values.shape[-1] - 1), axis=-1)


def _in_order(values: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sort values along the last axis; and the share of the weight that is reached at each."""
    order = np.argsort(values, axis=-1, kind="stable")
    reached = np.cumsum(np.take_along_axis(np.broadcast_to(weights, values.shape), order, axis=-1), axis=-1)
    return np.take_along_axis(values, order, axis=-1), reached / reached[..., -1:]


def alike(weights: FloatArray) -> Iterator[tuple[Indices, Indices, FloatArray | None]]:
    """Put poses together that have as many hypotheses of a weight above 0, equal ones or not, and a spread or none.

    Parameters
    ----------
    weights : array (N, M)
        Of sum 1 for each pose.

    Yields
    ------
    rows : array of int (m,)
        The poses.
    kept : array of int (n, m)
        Their hypotheses, in their order.
    weights : array (m, n) or None
        Their weights; None where those of each pose are equal.
    """
    live = weights > 0
    order, number, unequal = np.argsort(~live, axis=0, kind="stable"), live.sum(axis=0), are_unequal(weights)
    has_spread = effective_number(weights.T) >= LEAST_SPREAD
    kinds = 4 * number + 2 * has_spread + unequal
    for kind in np.unique(kinds):
        rows = np.flatnonzero(kinds == kind)
        kept = order[: kind // 4, rows]
        yield rows, kept, weights[kept, rows].T if kind % 2 else None
