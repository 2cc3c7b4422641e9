"""Expected distance from a fixed point to the nearest of N Gaussian hypotheses, by quadrature.

The inner integral of every best-of-N expectation: one-dimensional over the distance t, restricted to the distances
that the nearest hypothesis may have. :mod:`toy.best_of` averages it over a Gaussian truth, :mod:`toy.mean` uses the
same points for the nearest hypothesis itself.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy import special

from posecal.errors import PoseDataError

__all__ = ["TAIL", "check", "expected_nearest", "gauss_legendre", "nearest_points"]

Floats = npt.NDArray[np.float64]

NODES = 48
TAIL = 25.0
"""Tails are cut where their probability is below exp(-25) = 1.4e-11."""


def check(N: int, D: int, **lengths: float) -> None:
    """Check numbers of hypotheses and coordinates, and lengths.

    Raises
    ------
    PoseDataError
        Where N or D is below 1, or a length is negative or not finite.
    """
    if N < 1 or D < 1:
        raise PoseDataError(f"N = {N} hypotheses of D = {D} coordinates; expected at least 1 of each.")
    for name, length in lengths.items():
        if not 0 <= length < math.inf:
            raise PoseDataError(f"{name}: {length}; expected a length, 0 or more.")


def gauss_legendre(low: npt.ArrayLike, high: npt.ArrayLike, nodes: int = NODES) -> tuple[Floats, Floats]:
    """Return the points and weights of Gauss-Legendre quadrature from ``low`` to ``high``.

    .. math:: ∫_{low}^{high} f(x) dx ≈ Σ_i w_i f(x_i)

    Parameters
    ----------
    low, high : array_like, shape (...)
        Ends of the interval, or of many intervals at once.
    nodes : int
        Number of points; exact for polynomials of degree ``2 nodes − 1``.

    Returns
    -------
    points, weights : ndarray, shape (..., nodes)
        In the unit of the ends.

    Notes
    -----
    Differs from the published code: not in it.

    Examples
    --------
    >>> points, weights = gauss_legendre(0, 3)
    >>> round(float(weights @ points**2), 12)  # 3³ / 3
    9.0
    """
    points, weights = np.polynomial.legendre.leggauss(nodes)
    low, high = np.asarray(low, float)[..., None], np.asarray(high, float)[..., None]
    half = (high - low) / 2
    return low + half * (points + 1), half * weights


def _least_distance(noncentrality: Floats, N: int, D: int) -> Floats:
    """Return a lower bound of the distance of the nearest of N hypotheses, exceeded with probability 1 - exp(-25)."""
    return np.maximum(0, np.sqrt(D + noncentrality - 1) - math.sqrt(2 * (TAIL + math.log(N))))


def nearest_points(noncentrality: Floats, *, N: int, D: int, nodes: int = NODES) -> tuple[Floats, Floats]:
    r"""Return quadrature points and weights over the distance t of the nearest of N hypotheses.

    .. math:: \sqrt{D + λ - 1} - \sqrt{2 (25 + \ln N)} ≤ t ≤ \sqrt{D + λ} + \sqrt{50 / N}

    Parameters
    ----------
    noncentrality : ndarray, shape (...)
        λ = ‖x − μ‖²/σ² of the fixed point x.
    N : int
        Number of hypotheses.
    D : int
        Number of coordinates.
    nodes : int
        Quadrature points.

    Returns
    -------
    t, weights : ndarray, shape (..., nodes)
        In units of the hypotheses' standard deviation.

    Notes
    -----
    The norm of a Gaussian vector of unit variances deviates from its mean by more than t with a probability below
    exp(−t²/2) on either side, and its mean is between √(D + λ − 1) and √(D + λ): outside these bounds the integrand
    is 0 or 1 to within 1.4e-11. The points are squares, so that they are denser at small distances, where the nearest
    of many hypotheses is.

    Differs from the published code: not in it.

    Examples
    --------
    >>> t, weights = nearest_points(np.array(0.0), N=100, D=1)
    >>> round(float(t.max()), 1), round(float(weights.sum()), 4)  # √1 + √(50/100)
    (1.7, 1.7071)
    """
    low = _least_distance(noncentrality, N, D)[..., None]
    width = np.sqrt(D + noncentrality)[..., None] + math.sqrt(2 * TAIL / N) - low
    root, weights = gauss_legendre(0, 1, nodes)
    return low + width * root**2, 2 * root * width * weights


def expected_nearest(radius: npt.ArrayLike, *, sigma: float, N: int, D: int, nodes: int = NODES) -> Floats:
    r"""Return the expected distance from a fixed point to the nearest of N Gaussian hypotheses.

    .. math:: σ ∫_0^∞ \left(1 − F_{D,\, r²/σ²}(t²)\right)^N dt

    with :math:`F_{D,λ}` the noncentral χ² distribution function.

    Parameters
    ----------
    radius : array_like, shape (...)
        Distance r of the point from the hypotheses' mean, in the unit of ``sigma``.
    sigma : float
        Standard deviation of each coordinate of a hypothesis; with 0 all hypotheses are at the mean.
    N : int
        Number of hypotheses.
    D : int
        Number of coordinates.
    nodes : int
        Quadrature points.

    Returns
    -------
    ndarray, shape (...)
        Expected distance, in the unit of ``sigma``. Lower is better; 0 is best.

    Raises
    ------
    PoseDataError
        Where N or D is below 1, or ``sigma`` is negative or not finite.

    Notes
    -----
    Differs from the published code: there it is simulated.

    References
    ----------
    arXiv:2210.11179, section 3.2.

    Examples
    --------
    One hypothesis in one dimension, from its mean: the mean of |z| is √(2/π).

    >>> round(float(expected_nearest(0.0, sigma=1, N=1, D=1)), 6), round((2 / np.pi) ** 0.5, 6)
    (0.797885, 0.797885)
    """
    check(N, D, sigma=sigma)
    radius = np.asarray(radius, float)
    if sigma == 0:
        return radius
    noncentrality = (radius / sigma) ** 2
    t, weights = nearest_points(noncentrality, N=N, D=D, nodes=nodes)
    farther = 1 - special.chndtr(t**2, D, noncentrality[..., None])
    low = _least_distance(noncentrality, N, D)
    return np.asarray(sigma * (low + np.sum(weights * farther**N, axis=-1)))
