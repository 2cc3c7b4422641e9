"""Risk–coverage: the error of the poses that are kept when those of large predicted spread are rejected.

A rejected pose is left to a person, say. Poses are kept in the order of their predicted
spread: the mean error of what is kept, at every share that is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray, real_array
from posecal.engine.bounds import POSITIVE
from posecal.engine.metric import Metric, Statistic
from posecal.engine.sums import Indices
from posecal.errors import PoseDataError


def known_pairs(spread: npt.ArrayLike, error: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Give the spreads and errors (M,) of the poses that have both, in double.

    Raises
    ------
    PoseDataError
        For shapes that don't fit.
    """
    s, e = real_array(spread, "spread").astype(np.float64), real_array(error, "error").astype(np.float64)
    if s.ndim != 1 or s.shape != e.shape:
        raise PoseDataError(f"spread {s.shape} and error {e.shape}: expected (M,) both.")
    known = ~(np.isnan(s) | np.isnan(e))
    return s[known], e[known]


def run_numbers(*ordered: npt.NDArray[np.generic]) -> Indices:
    """Number runs of equal rows of columns in order, from 0."""
    apart = np.any([column[1:] != column[:-1] for column in ordered], axis=0)
    return np.concatenate([[0], np.cumsum(apart)])[: len(ordered[0])]


def risk_coverage(spread: npt.ArrayLike, error: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    r"""Mean error of the poses that are kept at each coverage, the risk–coverage curve.

    .. math:: r(n / M) = \frac{1}{n} \sum_{m \,:\, \text{n smallest spreads}} e_m

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, mm; poses with NaN are left out.

    Returns
    -------
    coverage : array (M,)
        Shares of poses that are kept: 1/M, 2/M, … 1.
    by_spread, by_error : arrays (M,)
        Mean error at each, mm: of the poses of smallest predicted spread, and of smallest error, the best there is.
        Lower is better; both end at the mean error of all.

    Raises
    ------
    PoseDataError
        For shapes that don't fit.

    Notes
    -----
    Poses of equal spread are kept in random order: the curve is the mean over these orders. Differs from the published
    code: that keeps them in the order in which they come.

    See Also
    --------
    aurc : The area under the curve.
    sparsification : The same curve in shares of the mean error, against the share that is dropped.

    References
    ----------
    Geifman and El-Yaniv, arXiv:1705.08500.

    Examples
    --------
    >>> coverage, by_spread, by_error = risk_coverage([1, 3, 2], [30, 60, 90])
    >>> by_spread, by_error
    (array([30., 60., 60.]), array([30., 45., 60.]))
    """
    s, e = known_pairs(spread, error)
    number = np.arange(1, len(e) + 1)
    return number / max(len(e), 1), _kept(s, e) / number, _kept(e, e) / number


def _kept(values: FloatArray, error: FloatArray) -> FloatArray:
    """Sum of the errors of the n poses of smallest values, (M,); equal ones in random order."""
    if not len(values):
        return np.zeros(0)
    order = np.argsort(values)
    run = run_numbers(values[order])
    return np.cumsum((np.bincount(run, error[order]) / np.bincount(run))[run])


def aurc(spread: npt.ArrayLike, error: npt.ArrayLike) -> float:
    """Area under the risk–coverage curve (AURC): the mean error of the poses kept, averaged over all coverages.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, mm; poses with NaN are left out.

    Returns
    -------
    float
        mm; lower is better. The mean error of all where the spread says nothing. NaN without poses.

    Raises
    ------
    PoseDataError
        For shapes that don't fit.

    Notes
    -----
    A model of smaller errors has a smaller area whatever its spread; see ``excess_aurc``. Differs from the published
    code: the loss is the error in mm, theirs 0 or 1.

    See Also
    --------
    risk_coverage : The curve.
    excess_aurc : The part that a better order of the same poses would save.

    References
    ----------
    Geifman, Uziel and El-Yaniv, arXiv:1805.08206; the curve: Geifman and El-Yaniv, arXiv:1705.08500.

    Examples
    --------
    (30 + 60 + 60) / 3:

    >>> aurc([1, 3, 2], [30, 60, 90])
    50.0
    """
    risk = risk_coverage(spread, error)[1]
    return float(risk.mean()) if len(risk) else math.nan


def excess_aurc(spread: npt.ArrayLike, error: npt.ArrayLike) -> float:
    """Excess AURC: the area under the risk–coverage curve above that of the poses in the order of their errors.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, mm; poses with NaN are left out.

    Returns
    -------
    float
        mm; lower is better; 0 where the spread puts poses in the order of their errors. NaN without poses.

    Raises
    ------
    PoseDataError
        For shapes that don't fit.

    Notes
    -----
    Above 0 even for a perfect sampler: an error is one draw of what the spread describes. ``ause`` is this area over 20
    shares, divided by the mean error. Differs from the published code: as ``aurc``.

    See Also
    --------
    aurc : The whole area.
    ause : In shares of the mean error.

    References
    ----------
    Geifman, Uziel and El-Yaniv, arXiv:1805.08206.

    Examples
    --------
    50 for the order of the spreads, and (30 + 45 + 60) / 3 for that of the errors:

    >>> excess_aurc([1, 3, 2], [30, 60, 90])
    5.0
    """
    _, by_spread, by_error = risk_coverage(spread, error)
    return float((by_spread - by_error).mean()) if len(by_spread) else math.nan


# --- without each sequence ------------------------------------------------------------------------------------

MAX_PARTS = 512
"""In :func:`aurc_without` the order of the poses is cut into at most so many parts."""


def aurc_without(spread: FloatArray, error: FloatArray, sequence: Indices) -> FloatArray:
    r"""AURC without the poses of each sequence in turn, from one sort of all poses.

    .. math:: \frac{1}{M} \sum_n \frac{1}{n} \sum_{r \le n} e_r = \frac{1}{M} \sum_r e_r (H_M - H_{r - 1})

    with the harmonic numbers H. The order is cut into parts, between which ranks are exact without each sequence;
    within a part the mean error of the others has their mean weight.

    Parameters
    ----------
    spread, error : arrays (M,)
        Of each pose, without NaN.
    sequence : array of int (M,)
        0 … S - 1, all of which occur.

    Returns
    -------
    array (S,)
        As :func:`aurc`, NaN where no other pose is left.

    Notes
    -----
    Time grows as M log M + S. Exact where there are no more different spreads than parts: half of these are of one
    pose, the first ones, where the weight falls fastest; the others grow by some per cent each.
    """
    M, S = len(spread), int(sequence.max(initial=-1)) + 1
    if not M:
        return np.zeros(0)
    order = np.argsort(spread, kind="stable")
    e, of = error[order].astype(np.float64), sequence[order]
    most = min(MAX_PARTS, M, max(64, int(2e6 / S)))
    half = M if most >= M else most // 2
    stops = np.concatenate([np.arange(half), np.rint(np.geomspace(half, M, most - most // 2)).astype(np.intp) - 1])
    run = run_numbers(spread[order])
    stops = np.unique(np.cumsum(np.bincount(run))[run[stops]])  # equal spreads are of one part
    T = len(stops)
    part = np.repeat(np.arange(T), np.diff(stops, prepend=0))
    cell = of * T + part
    shape = S, T
    number: Indices = np.bincount(part)[None]
    total: FloatArray = np.bincount(part, e)[None].astype(np.float64)
    others = number - np.bincount(cell, minlength=S * T).reshape(shape)
    error_of_others = total - np.bincount(cell, e, S * T).reshape(shape)
    harmonic = np.concatenate([[0.0], np.cumsum(1 / np.arange(1, M + 1))])

    def areas(number: Indices, total: FloatArray) -> FloatArray:
        n = np.concatenate([np.zeros((len(number), 1), dtype=np.intp), np.cumsum(number, axis=1)], axis=1)
        weight = np.diff(n * (harmonic[n] - 1), axis=1) / np.maximum(number, 1)  # mean of H_0 … H_(n - 1), by part
        left = n[:, -1]
        sums = (total * (harmonic[left, None] - weight)).sum(axis=1)
        return np.asarray(np.where(left > 0, sums / np.maximum(left, 1), np.nan))

    return areas(others, error_of_others) + (aurc(spread, error) - areas(number, total))


def excess_aurc_without(spread: FloatArray, error: FloatArray, sequence: Indices) -> FloatArray:
    """Excess AURC without the poses of each sequence in turn, (S,); as :func:`aurc_without`."""
    return aurc_without(spread, error, sequence) - aurc_without(error, error, sequence)


# --- metrics --------------------------------------------------------------------------------------------------

_RISK = partial(
    Metric,
    unit="mm",
    direction="lower",
    family="sharpness",
    bounds=POSITIVE,
    source="Geifman, Uziel and El-Yaniv, arXiv:1805.08206",
)


def risk_metrics(of_poses: Statistic, about: str) -> Iterator[Metric]:
    """Areas under the risk–coverage curve.

    Parameters
    ----------
    of_poses : Statistic
        Predicted spread and error of every pose, (B, 2).
    about : str
        What these are.
    """
    yield _RISK(
        name="aurc",
        label="AURC",
        brief="mean error of the poses of smallest spread, averaged over the shares that are kept",
        definition="mean over n = 1 … M of the mean error of the n poses of smallest spread, equal spreads in random "
        f"order; {about}",
        statistic=of_poses,
        finish=lambda values: aurc(*values.T),
        leave_out=lambda values, sequence: aurc_without(values[:, 0], values[:, 1], sequence),
        range="0 upwards; the mean error of all where the spread says nothing",
        reading="The error that is left to a user who rejects poses of large spread, over all shares that may be "
        "kept. Models of smaller errors have a smaller area, whatever their spread: see excess_aurc.",
    )
    yield _RISK(
        name="excess_aurc",
        label="excess AURC",
        brief="AURC, minus that of the poses in the order of their errors",
        definition=f"aurc minus the same of the poses in the order of their errors; {about}",
        statistic=of_poses,
        finish=lambda values: excess_aurc(*values.T),
        leave_out=lambda values, sequence: excess_aurc_without(values[:, 0], values[:, 1], sequence),
        range="0 (spread orders poses as their errors do) upwards",
        reading="What is lost by rejecting poses by their spread instead of their error. A perfect sampler stays "
        "above 0, since an error is one draw.",
    )
