"""Weights of hypotheses: the checks of what is given, and copies of one hypothesis as weights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, real_array
from posecal.data.layout import HYPOTHESES, Layout, MemoryArray
from posecal.errors import PoseDataError, first_few

OF_WEIGHTS = 2.5e-3
"""Numbers whose sum is 1 to this, as of numbers of bfloat16, are weights."""

EQUAL = 1e-4
"""Weights of one pose that differ by less than this share are equal: rounding of a softmax is 2e-6 in single
precision."""


def as_weights(values: object, name: str) -> FloatArray:
    """Convert the weight of every hypothesis into double precision.

    Raises
    ------
    PoseDataError
        Where one is not a finite number of at least 0.
    """
    weights = real_array(values, name).astype(np.float64)
    wrong = ~np.isfinite(weights) | (weights < 0)
    if wrong.any():
        raise PoseDataError(
            f"{name}: {int(wrong.sum()):,} of {wrong.size:,} are below 0 or not finite; expected numbers of at least "
            "0, whose sum is 1 for each pose. Give an absent hypothesis the weight 0."
        )
    return weights


def poses_last(values: FloatArray, shape: tuple[int, int], axes: str, name: str) -> FloatArray:
    """Give numbers of hypotheses as (N, M), of (M, N) where the layout has M first.

    Raises
    ------
    PoseDataError
        For another shape.
    """
    n, m = shape
    is_poses_first = "N" in axes and "M" in axes and axes.index("M") < axes.index("N")
    turned = values.T if is_poses_first and values.shape == (m, n) else values
    if turned.shape != shape:
        raise PoseDataError(f"{name} {values.shape}; expected (N, M) = {shape}.")
    return turned


def are_unequal(weights: FloatArray) -> BoolArray:
    """Find the poses (M,) whose weights above 0, of (N, M), are not all equal."""
    least = np.where(weights > 0, weights, np.inf).min(axis=0)
    return np.asarray(weights.max(axis=0) > least * (1 + EQUAL))


def checked_weights(
    weights: FloatArray, number: int, name: str, frames: Sequence[str] | npt.NDArray[np.str_]
) -> FloatArray | None:
    """Give the weights of the first so many hypotheses, of sum 1; None where all are equal, and above 0.

    Parameters
    ----------
    weights : array (N, M)
        As given.
    number : int
        How many hypotheses are taken, the first ones.
    name : str
        What messages call them.
    frames : array of str (M,)
        The names of the poses.

    Raises
    ------
    PoseDataError
        Where a sum is not 1, with the number of such poses and the first; where only the first hypotheses are taken,
        for weights that are not equal, since the first of those are no sample, and for poses without any left.
    """

    def refuse(wrong: npt.ArrayLike, what: str, expected: str) -> None:
        wrong = np.asarray(wrong)
        if wrong.any():
            first = first_few([str(frames[row]) for row in np.flatnonzero(wrong).tolist()])
            where = f"{int(wrong.sum()):,} of {len(wrong):,} frames (first: {first})"
            raise PoseDataError(f"{name}: {what} in {where}; expected {expected}")

    sums = weights.sum(axis=0)
    wrong = np.abs(sums - 1) > OF_WEIGHTS
    found = f"sums from {sums[wrong].min():.4g} to {sums[wrong].max():.4g}" if wrong.any() else ""
    refuse(wrong, found, "1 for each pose. Divide the weights of a pose by their sum.")
    if number < len(weights):
        draw = f"all {len(weights)} hypotheses of such, not the first ones. Draw as many from them by their weights."
        refuse(are_unequal(weights), "not equal", draw)
        weights = weights[:number]
        refuse(~weights.any(axis=0), f"all of the first {number} are 0", "one above 0.")
    weights = weights / weights.sum(axis=0)
    return weights if are_unequal(weights).any() or not weights.all() else None


def collapse_copies(hypotheses: npt.ArrayLike, /, *, axes: str | None = None) -> tuple[FloatArray, FloatArray]:
    r"""Distinct hypotheses of each pose, and the share of each among all.

    .. math:: w_i = \frac{\#\{n : x_n = x_i\}}{N}

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, some of which are copies of others, equal in every coordinate; NaN in all where absent.
    axes : str, optional
        Their layout, such as ``MNKD``; ``NMKD`` by default.

    Returns
    -------
    distinct : array (N', M, K, D)
        Those of each pose, in the order of their first copies; N' is the most that a pose has, and NaN fill the rest.
    weights : array (N', M)
        Shares among those present, of sum 1 for each pose; 0 for what is filled, and at poses of none.

    Raises
    ------
    PoseDataError
        For another number of axes.

    Notes
    -----
    Copies are no draws: of 10 draws that stand in N = 200 places, calibration and fair scores are right only with the
    copies as weights. Where every draw has as many copies, the weights are equal, and the numbers those of the distinct
    draws. Where a sampler draws one of a few poses again by chance, the shares estimate the chances of these poses.
    Differs from the published code: none; ours.

    See Also
    --------
    evaluate : Takes ``weights``.

    Examples
    --------
    >>> hypotheses = np.array([7.0, 7.0, 4.0, 7.0]).reshape(4, 1, 1, 1)
    >>> distinct, weights = collapse_copies(hypotheses)
    >>> distinct.ravel(), weights.ravel()
    (array([7., 4.]), array([0.75, 0.25]))
    """
    x = real_array(hypotheses, "hypotheses")
    if axes is not None:
        layout = Layout(axes, HYPOTHESES)
        x = layout.read(MemoryArray(x), np.arange(layout.shape(x.shape)[1]))
    if x.ndim != 4:
        raise PoseDataError(f"hypotheses {x.shape}: expected (N, M, K, D).")
    n, m, *_ = x.shape
    flat = x.reshape(n, m, -1)
    first, number = np.zeros((n, m), dtype=np.intp), np.zeros((n, m))
    most = 0
    for pose in range(m):
        there = np.flatnonzero(~np.isnan(flat[:, pose]).all(axis=1))
        _, rows, counts = np.unique(flat[there, pose], axis=0, return_index=True, return_counts=True)
        order = np.argsort(rows)
        first[: len(rows), pose], number[: len(rows), pose] = there[rows[order]], counts[order]
        most = max(most, len(rows))
    weights = number[:most] / np.maximum(number.sum(axis=0), 1)
    distinct = x[first[:most], np.arange(m)].astype(np.result_type(x.dtype, np.float32))
    distinct[weights == 0] = np.nan
    return distinct, weights
