r"""Closed-form calibration curves of Gaussian samplers with a wrong spread, mean or dimension.

One Gaussian joint: hypotheses ``N(μ, σ² I_D)``, truth ``N(μ*, σ*² I_D*)``, infinitely many of both, so that the
hypotheses' median is μ and every quantile is exact. Each of the three errors is a number without a unit: the spread
σ/σ*, the offset ‖μ* − μ‖/σ*, and the truth's number of coordinates D* where it varies in fewer than the model. These
curves are the oracles of posecal's own at large N and M.

Conventions: a level q is a share between 0 and 1, ω(q) the share of truths within the q-ball. Where ω lies below
the diagonal the sampler is overconfident, above it underconfident.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import special

from posecal.errors import PoseDataError

__all__ = ["LEVELS", "coverage", "coverage_of", "ece", "simulated_coverage"]

Floats = npt.NDArray[np.float64]

LEVELS: Floats = np.arange(21) / 20
"""The levels of the published ECE: 0, 0.05, …, 1."""


def _check(spread: float, offset: float, D: int, truth_D: int) -> None:
    if not 0 <= spread < np.inf or not 0 <= offset < np.inf:
        raise PoseDataError(f"spread {spread} and offset {offset}: expected ratios, 0 or more.")
    if not 1 <= truth_D <= D:
        raise PoseDataError(f"truth_D = {truth_D} of D = {D} coordinates; expected 1 to D.")


def coverage(
    levels: npt.ArrayLike = LEVELS,
    *,
    spread: float = 1.0,
    offset: float = 0.0,
    D: int = 3,
    truth_D: int | None = None,
) -> Floats:
    r"""Return the share ω(q) of truths that lie within the hypotheses' q-ball.

    .. math:: ω(q) = F_{D^*,\,‖μ^*-μ‖²/σ^{*2}}\left(\frac{σ²}{σ^{*2}} F_D^{-1}(q)\right)

    with F the χ² distribution function, noncentral where there is an offset.

    Parameters
    ----------
    levels : array_like, shape (Q,)
        Shares q of the hypotheses, between 0 and 1.
    spread : float
        σ/σ*: below 1 the model is overconfident. 0 is the collapsed model.
    offset : float
        ‖μ* − μ‖/σ*, along a coordinate in which the truth varies.
    D : int
        Number of coordinates in which the hypotheses vary.
    truth_D : int, optional
        Number of coordinates in which the truth varies, at most D; D where not given.

    Returns
    -------
    ndarray, shape (Q,)
        Shares between 0 and 1; equal to ``levels`` for the perfect sampler.

    Raises
    ------
    PoseDataError
        Where a ratio is negative or not finite, or ``truth_D`` is not between 1 and D.

    Notes
    -----
    The ball of level 1 is the whole space, so ω(1) = 1, even for the collapsed model.

    Differs from the published code: not in it.

    References
    ----------
    arXiv:2210.11179, section 3.1.

    Examples
    --------
    In one dimension half of the hypotheses are within 0.6745 σ. At half the spread the radius of that ball is
    0.3372 σ*, and it contains 2 Φ(0.3372) − 1 = 26 % of the truths.

    >>> coverage([0.0, 0.5, 1.0], spread=0.5, D=1).round(4).tolist()
    [0.0, 0.2641, 1.0]
    """
    levels = np.asarray(levels, float)
    truth_D = D if truth_D is None else truth_D
    _check(spread, offset, D, truth_D)
    if not np.all((levels >= 0) & (levels <= 1)):
        raise PoseDataError(f"levels: {levels.min():g} to {levels.max():g}; expected shares between 0 and 1.")
    below_one = levels < 1
    radius_squared = spread**2 * 2 * special.gammaincinv(D / 2, np.where(below_one, levels, 0.0))
    within = special.chndtr(radius_squared, truth_D, offset**2)
    return np.where(below_one, within, 1.0)


def coverage_of(
    N: int, levels: npt.ArrayLike = LEVELS, *, spread: float = 1.0, D: int = 3, step: float = 1e-4
) -> Floats:
    r"""Return the expected coverage of exchangeable ranks among N hypotheses of a wrong spread.

    .. math:: E\,ω_N(q) = ω(q) + \frac{q(1−q) + 2π\, T f_D(T)²}{2N}\, ω''(q) + O(N^{−2}), \quad T = F_D^{-1}(q)

    with f the χ² density. The first term of the fraction is the variance of a rank among N, the second that of a
    median of N.

    Parameters
    ----------
    N : int
        Number of hypotheses, at least 20 for the expansion to be accurate.
    levels : array_like, shape (Q,)
        Shares q, between 0 and 1; only 0 and 1 may be nearer than ``step`` to an end.
    spread : float
        σ/σ*, above 0.
    D : int
        Number of coordinates.
    step : float
        Step of the numerical second derivative.

    Returns
    -------
    ndarray, shape (Q,)
        Shares between 0 and 1, infinitely many poses; for the ranks of N + 1 pooled points about their median
        (posecal's ``exchangeable``).

    Raises
    ------
    PoseDataError
        As :func:`coverage`.

    Notes
    -----
    The ranks of a perfect sampler are uniform for every N, and there ω'' = 0.

    Differs from the published code: not in it.

    Examples
    --------
    >>> narrow = coverage_of(20, [0.5], spread=0.5) - coverage([0.5], spread=0.5)
    >>> bool(0 < narrow.item() < 0.02)  # few hypotheses show slightly less overconfidence
    True
    """
    levels = np.asarray(levels, float)
    exact = coverage(levels, spread=spread, D=D)
    inner = (levels > 0) & (levels < 1)
    q = levels[inner]
    near = [coverage(q + shift, spread=spread, D=D) for shift in (-step, step)]
    curvature = (near[0] + near[1] - 2 * exact[inner]) / step**2
    half_T = special.gammaincinv(D / 2, q)
    density = np.exp(special.xlogy(D / 2 - 1, half_T) - half_T - special.gammaln(D / 2)) / 2
    variance = q * (1 - q) + 4 * np.pi * half_T * density**2
    exact[inner] += variance * curvature / (2 * N)
    return exact


def ece(
    *,
    spread: float = 1.0,
    offset: float = 0.0,
    D: int = 3,
    truth_D: int | None = None,
    levels: npt.ArrayLike = LEVELS,
) -> float:
    r"""Return the expected calibration error of the closed-form curve.

    .. math:: \frac1Q Σ_q |ω(q) − q|

    Parameters
    ----------
    spread, offset, D, truth_D
        As in :func:`coverage`.
    levels : array_like, shape (Q,)
        The levels of the average; by default the published 21.

    Returns
    -------
    float
        Between 0 (calibrated; lower is better) and 0.452 at the published levels: a collapsed model still has
        ω(1) = 1, and the mean of 0, 0.05, …, 0.95 and 0 over 21 levels is 9.5/21.

    Raises
    ------
    PoseDataError
        As :func:`coverage`.

    Notes
    -----
    Differs from the published code: not in it. The paper calls 0.5 the maximum, which is the limit of many levels.

    References
    ----------
    arXiv:2210.11179, equation 1.

    Examples
    --------
    >>> round(ece(spread=0.0), 4), round(9.5 / 21, 4)
    (0.4524, 0.4524)
    """
    levels = np.asarray(levels, float)
    return float(np.abs(coverage(levels, spread=spread, offset=offset, D=D, truth_D=truth_D) - levels).mean())


def simulated_coverage(
    *, spread: float, offset: float, D: int, truth_D: int, draws: int, rng: np.random.Generator
) -> Floats:
    r"""Simulate the distances of truths and hypotheses from the centre, and count the truths within each ball.

    .. math:: \hat ω(q) = \frac1M Σ_m 1\left[‖y_m − μ‖ ≤ \hat Q(q)\right]

    Parameters
    ----------
    spread, offset, D, truth_D
        As in :func:`coverage`.
    draws : int
        Number of truths, and of hypotheses.
    rng : numpy.random.Generator
        The source of randomness.

    Returns
    -------
    ndarray, shape (21,)
        Shares at :data:`LEVELS`; 0 and 1 at the ends, where the ball is a point and the whole space. The standard
        error is √((ω(1−ω) + ω'² q(1−q)) / draws): the truths' share and the hypotheses' quantile.

    Raises
    ------
    PoseDataError
        As :func:`coverage`.

    Notes
    -----
    Differs from the published code: not in it.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> drawn = simulated_coverage(spread=0.5, offset=0, D=3, truth_D=3, draws=10_000, rng=rng)
    >>> float(np.abs(drawn - coverage(spread=0.5)).max()) < 5 / 20_000**0.5
    True
    """
    _check(spread, offset, D, truth_D)
    model = spread * np.linalg.norm(rng.standard_normal((draws, D)), axis=1)
    truth = rng.standard_normal((draws, truth_D))
    truth[:, 0] += offset
    radii = np.quantile(model, LEVELS[1:-1])
    within = (np.linalg.norm(truth, axis=1)[:, None] <= radii).mean(axis=0)
    return np.concatenate([[0.0], within, [1.0]])
