"""Is a wide spread a sign of a large error? What users who act on uncertainty want to know.

A calibrated model may still give every pose the same spread. Here poses are put in the order of their predicted
spread and of their error, and the two orders compared: by rank correlation, and by how fast the error falls when
the most uncertain poses are dropped.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.calibration.ranks import shared_ranks
from posecal.data.arrays import FloatArray
from posecal.errors import PoseDataError

__all__ = ["DROPPED", "rank_correlation", "sparsification", "sparsification_area"]

DROPPED: FloatArray = np.arange(20) / 20
"""Shares of poses that the sparsification curve drops: 0, 0.05, … 0.95."""


def _pair(spread: npt.ArrayLike, error: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    s, e = np.asarray(spread, dtype=np.float64), np.asarray(error, dtype=np.float64)
    if s.ndim != 1 or s.shape != e.shape:
        raise PoseDataError(f"spread {s.shape} and error {e.shape}: expected (M,) both.")
    known = ~(np.isnan(s) | np.isnan(e))
    return s[known], e[known]


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

    Examples
    --------
    >>> rank_correlation([10, 20, 30], [5, 40, 20])
    0.5
    """
    s, e = _pair(spread, error)
    if len(np.unique(s)) < 2 or len(np.unique(e)) < 2:
        return float("nan")
    return round(float(np.corrcoef(shared_ranks(s), shared_ranks(e))[0, 1]), 12)


def sparsification(spread: npt.ArrayLike, error: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Mean error of what is left when the poses of the largest predicted spread are dropped.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, mm; poses with NaN are left out.

    Returns
    -------
    by_spread, by_error : arrays (20,)
        At each share of :data:`DROPPED`, the mean error of the rest over the mean error of all: dropping by the
        predicted spread, and by the error itself, the best there is. 1 at first; lower is better.

    Raises
    ------
    PoseDataError
        For shapes that don't fit.

    Notes
    -----
    Differs from the published code: none.

    References
    ----------
    Ilg et al., arXiv:1802.07095 (sparsification curves and their area).

    Examples
    --------
    >>> by_spread, by_error = sparsification([1, 2, 3, 4], [2, 4, 6, 8])
    >>> by_spread[10]
    np.float64(0.6)
    """
    s, e = _pair(spread, error)
    if not len(e):
        return np.full(DROPPED.size, np.nan), np.full(DROPPED.size, np.nan)
    kept = np.maximum(np.rint((1 - DROPPED) * len(e)).astype(int), 1)

    def rest(order: FloatArray) -> FloatArray:
        means = np.cumsum(e[np.argsort(order, kind="stable")]) / np.arange(1, len(e) + 1)
        return np.asarray(means[kept - 1] / means[-1])

    return rest(s), rest(e)


def sparsification_area(spread: npt.ArrayLike, error: npt.ArrayLike) -> float:
    """Area between the sparsification curves by spread and by error.

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
    Mean over the shares of :data:`DROPPED`. Differs from the published code: none.

    References
    ----------
    Ilg et al., arXiv:1802.07095.

    Examples
    --------
    >>> sparsification_area([1, 2, 3], [10, 20, 30])
    0.0
    """
    by_spread, by_error = sparsification(spread, error)
    return float((by_spread - by_error).mean())
