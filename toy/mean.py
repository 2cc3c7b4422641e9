r"""The mean that minimises the expected squared minMPJPE: the paper's supplement A.2.

In one dimension, with hypotheses ``μ + σ z_i`` and ``z*`` the ``z_i`` nearest to the truth, the derivative of the
expected squared minMPJPE vanishes where ``E[x] − μ = σ E[z*]`` (the supplement omits the σ). The paper simulates E[z*]
and approximates it by a scaled sigmoid of ``E[x] − μ``, so that the root is at the mean. Here E[z*] is computed by
quadrature, the sigmoid is fitted to it, and the root is solved for: it is at the mean for a Gaussian truth, by
symmetry, and away from the mean for a skewed one.

Conventions: the offset is ``E[x] − μ``; lengths share the data's unit, z has none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import optimize, special

from posecal.errors import PoseDataError
from toy.nearest import gauss_legendre, nearest_points

__all__ = [
    "SigmoidFit",
    "best_offset_skewed",
    "expected_z",
    "fit_sigmoid",
    "largest_of",
    "nearest_z",
    "simulated_z",
]

Floats = npt.NDArray[np.float64]


def _density(z: Floats) -> Floats:
    return np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)


def nearest_z(u: npt.ArrayLike, *, N: int) -> Floats:
    r"""Return the expected value of the one of N standard normals that is nearest to u.

    .. math:: E[z^*|u] = N ∫_0^∞ \big((u+t) φ(u+t) + (u−t) φ(u−t)\big) \big(1 − Φ(u+t) + Φ(u−t)\big)^{N−1} dt

    Parameters
    ----------
    u : array_like, shape (...)
        The truth, (x − μ)/σ.
    N : int
        Number of hypotheses.

    Returns
    -------
    ndarray, shape (...)
        Without a unit; odd in u, 0 for N = 1.

    Raises
    ------
    PoseDataError
        Where N is below 1.

    Notes
    -----
    Differs from the published code: not in it.

    References
    ----------
    arXiv:2210.11179, supplement A.2.

    Examples
    --------
    For large u, the nearest of two is the larger, whose mean is 1/√π.

    >>> round(float(nearest_z(30.0, N=2)), 6), round(np.pi**-0.5, 6)
    (0.56419, 0.56419)
    """
    if N < 1:
        raise PoseDataError(f"N = {N} hypotheses; expected at least 1.")
    u = np.asarray(u, float)
    t, weights = nearest_points(u**2, N=max(N - 1, 1), D=1, nodes=96)
    above, below = u[..., None] + t, u[..., None] - t
    farther = special.ndtr(-above) + special.ndtr(below)
    nearest = above * _density(above) + below * _density(below)
    return np.asarray(np.sum(weights * N * nearest * farther ** (N - 1), axis=-1))


def expected_z(offset: npt.ArrayLike, *, sigma: float, truth_sigma: float, N: int) -> Floats:
    r"""Return E[z*] for a Gaussian truth whose mean lies ``offset`` above the hypotheses'.

    .. math:: E[z^*] = ∫ E\left[z^* \,\middle|\, \frac{a + σ^* v}{σ}\right] φ(v)\, dv

    Parameters
    ----------
    offset : array_like, shape (...)
        a = E[x] − μ.
    sigma : float
        The hypotheses' standard deviation, above 0.
    truth_sigma : float
        The truth's standard deviation, in the unit of ``sigma``.
    N : int
        Number of hypotheses.

    Returns
    -------
    ndarray, shape (...)
        Without a unit; odd in the offset, and between ∓ :func:`largest_of`.

    Raises
    ------
    PoseDataError
        Where N is below 1.

    Notes
    -----
    Differs from the published code: not in it.

    References
    ----------
    arXiv:2210.11179, supplement A.2.

    Examples
    --------
    >>> round(float(expected_z(0.0, sigma=2.0, truth_sigma=1.0, N=10)), 12)
    0.0
    """
    v, weights = gauss_legendre(-7.5, 7.5, 96)
    u = (np.asarray(offset, float)[..., None] + truth_sigma * v) / sigma
    return np.asarray(np.sum(weights * _density(v) * nearest_z(u, N=N), axis=-1))


def simulated_z(
    offset: float, *, sigma: float, truth_sigma: float, N: int, poses: int, rng: np.random.Generator
) -> tuple[float, float]:
    """Simulate truths and hypotheses, and average the z of the nearest.

    Parameters
    ----------
    offset, sigma, truth_sigma, N
        As in :func:`expected_z`.
    poses : int
        Number of independent truths, each with its own hypotheses.
    rng : numpy.random.Generator
        The source of randomness.

    Returns
    -------
    mean, standard_error : float
        Without a unit.

    Notes
    -----
    Differs from the published code: not in it.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> mean, error = simulated_z(30, sigma=1, truth_sigma=1, N=2, poses=2000, rng=rng)
    >>> abs(mean - np.pi**-0.5) < 4 * error
    True
    """
    truth = offset + truth_sigma * rng.standard_normal(poses)
    z = rng.standard_normal((N, poses))
    nearest = np.abs(truth - sigma * z).argmin(axis=0)
    nearest_values = z[nearest, np.arange(poses)]
    return float(nearest_values.mean()), float(nearest_values.std(ddof=1) / math.sqrt(poses))


def largest_of(N: int) -> float:
    r"""Return the expected maximum of N standard normals, the limit of E[z*] for large offsets.

    .. math:: N ∫ z φ(z) Φ(z)^{N−1} dz

    Parameters
    ----------
    N : int
        Number of hypotheses.

    Returns
    -------
    float
        Without a unit.

    Notes
    -----
    Differs from the published code: not in it. It is the exact limit of the paper's C(σ, N), and does not depend on σ.

    Examples
    --------
    >>> round(largest_of(3), 6), round(1.5 * np.pi**-0.5, 6)
    (0.846284, 0.846284)
    """
    z, weights = gauss_legendre(-9, 9, 200)
    return float(np.sum(weights * N * z * _density(z) * special.ndtr(z) ** (N - 1)))


@dataclass(frozen=True)
class SigmoidFit:
    """A scaled sigmoid fitted to E[z*], and its errors.

    Attributes
    ----------
    scale, slope : float
        C and k of ``C (2 S(k a) − 1)`` with S(t) = 1/(1 + exp(−t)); k is per unit of the offset a.
    largest_error, rms_error : float
        Over the offsets of the fit; without a unit, as z.
    """

    scale: float
    slope: float
    largest_error: float
    rms_error: float

    def __call__(self, offset: npt.ArrayLike) -> Floats:
        """Evaluate the sigmoid."""
        return self.scale * np.tanh(self.slope * np.asarray(offset, float) / 2)


def fit_sigmoid(offset: npt.ArrayLike, z: npt.ArrayLike) -> SigmoidFit:
    r"""Fit the paper's sigmoid to E[z*] by least squares.

    .. math:: E[z^*] ≈ C \left(\frac{2}{1 + e^{−k a}} − 1\right)

    Parameters
    ----------
    offset : array_like, shape (A,)
        Offsets a.
    z : array_like, shape (A,)
        E[z*] at them.

    Returns
    -------
    SigmoidFit
        The curve and its errors.

    Notes
    -----
    The paper writes S·C. A sigmoid between 0 and 1 can't be odd, as E[z*] is, so S is rescaled to −1 to 1.

    Differs from the published code: not in it.

    References
    ----------
    arXiv:2210.11179, supplement A.2.

    Examples
    --------
    >>> a = np.linspace(-3, 3, 13)
    >>> fit = fit_sigmoid(a, 2 * np.tanh(a))  # k = 2
    >>> round(fit.scale, 6), round(fit.slope, 6)
    (2.0, 2.0)
    """
    offset, z = np.asarray(offset, float), np.asarray(z, float)
    start = (float(np.abs(z).max()), 2 / float(np.abs(offset).max()))
    (scale, slope), _ = optimize.curve_fit(lambda a, c, k: c * np.tanh(k * a / 2), offset, z, p0=start)
    error = scale * np.tanh(slope * offset / 2) - z
    return SigmoidFit(float(scale), float(slope), float(np.abs(error).max()), float(np.sqrt(np.mean(error**2))))


def expected_z_skewed(offset: npt.ArrayLike, *, sigma: float, N: int) -> Floats:
    r"""Return E[z*] for an exponential truth of deviation 1 whose mean lies ``offset`` above the hypotheses'.

    .. math:: E[z^*] = ∫_0^∞ E\left[z^* \,\middle|\, \frac{a + e − 1}{σ}\right] e^{−e}\, de

    Parameters
    ----------
    offset : array_like, shape (...)
        a = E[x] − μ, in units of the truth's standard deviation.
    sigma : float
        The hypotheses' standard deviation, above 0, in the same unit.
    N : int
        Number of hypotheses.

    Returns
    -------
    ndarray, shape (...)
        Without a unit; not odd in the offset.

    Raises
    ------
    PoseDataError
        Where N is below 1.

    Notes
    -----
    Differs from the published code: not in it.

    Examples
    --------
    >>> abs(float(expected_z_skewed(0.0, sigma=1.0, N=1))) < 1e-12
    True
    """
    e, weights = gauss_legendre(0, 40, 160)
    u = (np.asarray(offset, float)[..., None] + e - 1) / sigma
    return np.asarray(np.sum(weights * np.exp(-e) * nearest_z(u, N=N), axis=-1))


def best_offset_skewed(*, sigma: float, N: int) -> float:
    r"""Return the offset that minimises the squared minMPJPE of an exponential truth of deviation 1.

    .. math:: a = σ\, E[z^*]

    Parameters
    ----------
    sigma : float
        The hypotheses' standard deviation, in units of the truth's.
    N : int
        Number of hypotheses.

    Returns
    -------
    float
        E[x] − μ at the minimum, in units of the truth's standard deviation. 0: the mean is correct, as with N = 1;
        below 0: the hypotheses are shifted towards the long tail.

    Raises
    ------
    PoseDataError
        Where N is below 1.

    Notes
    -----
    Differs from the published code: not in it. The supplement's argument holds for symmetric truths only.

    References
    ----------
    arXiv:2210.11179, supplement A.2.

    Examples
    --------
    >>> abs(best_offset_skewed(sigma=1.0, N=1)) < 1e-9
    True
    """

    def half_derivative(offset: float) -> float:
        return offset - sigma * float(expected_z_skewed(offset, sigma=sigma, N=N))

    reach = sigma * largest_of(N) + 1
    root: float = optimize.brentq(half_derivative, -reach, reach, xtol=1e-10)
    return root
