r"""minMPJPE and ECE over the mean and the spread of a one-dimensional Gaussian: the paper's Figure 1d.

Hypotheses ``N(μ, σ²)`` of a truth ``N(0, 4²)``. The minimum of minMPJPE is at the correct mean and a wrong spread; the
ECE has a valley, with one spread for every mean; the lowest minMPJPE along the valley is at the truth. Both surfaces
are exact: minMPJPE by quadrature (:mod:`toy.best_of`), the ECE in closed form (:mod:`toy.curves`).

Conventions: rows are spreads, columns are means; every length is in the truth's unit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import optimize

from toy import best_of, curves

__all__ = ["Landscape", "landscape", "valley_spread"]

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Landscape:
    """minMPJPE and ECE over mean and spread, and the valley of the ECE.

    Attributes
    ----------
    mu : ndarray, shape (A,)
        Means of the hypotheses.
    sigma : ndarray, shape (B,)
        Their standard deviations.
    min_mpjpe, ece : ndarray, shape (B, A)
        Expected minMPJPE, in the truth's unit, and ECE.
    valley : ndarray, shape (A,)
        For each mean, the spread with the lowest ECE.
    valley_ece, valley_min_mpjpe : ndarray, shape (A,)
        The ECE and the minMPJPE there.
    truth_mu, truth_sigma : float
        Mean and standard deviation of the truth.
    """

    mu: Floats
    sigma: Floats
    min_mpjpe: Floats
    ece: Floats
    valley: Floats
    valley_ece: Floats
    valley_min_mpjpe: Floats
    truth_mu: float
    truth_sigma: float

    @property
    def lowest_min_mpjpe(self) -> tuple[float, float]:
        """The mean and spread of the grid point with the lowest minMPJPE."""
        row, column = np.unravel_index(self.min_mpjpe.argmin(), self.min_mpjpe.shape)
        return float(self.mu[column]), float(self.sigma[row])

    @property
    def lowest_in_valley(self) -> tuple[float, float]:
        """The mean and spread with the lowest minMPJPE along the valley of the ECE."""
        column = self.valley_min_mpjpe.argmin()
        return float(self.mu[column]), float(self.valley[column])


def _ece(mu: float, sigma: float, truth_mu: float, truth_sigma: float) -> float:
    return curves.ece(spread=sigma / truth_sigma, offset=abs(mu - truth_mu) / truth_sigma, D=1)


def valley_spread(mu: float, *, truth_mu: float = 0.0, truth_sigma: float = 4.0) -> float:
    r"""Return the spread that minimises the ECE of hypotheses with a given mean.

    .. math:: σ(μ) = \arg\min_σ \mathrm{ECE}(μ, σ)

    Parameters
    ----------
    mu : float
        Mean of the hypotheses.
    truth_mu, truth_sigma : float
        Mean and standard deviation of the truth.

    Returns
    -------
    float
        The spread, at least ``truth_sigma``: a wrong mean needs a larger spread.

    Notes
    -----
    Differs from the published code: there the valley is taken from a grid of simulated values.

    References
    ----------
    arXiv:2210.11179, section 3.4.

    Examples
    --------
    >>> round(valley_spread(0.0), 4)
    4.0
    """
    offset = abs(mu - truth_mu)
    optimum = optimize.minimize_scalar(
        lambda sigma: _ece(mu, sigma, truth_mu, truth_sigma),
        bounds=(0.9 * truth_sigma, truth_sigma + 2 * offset + 0.1 * truth_sigma),
        method="bounded",
        options={"xatol": 1e-8 * truth_sigma},
    )
    return float(optimum.x)


def landscape(
    mu: npt.ArrayLike,
    sigma: npt.ArrayLike,
    *,
    N: int = 10,
    truth_mu: float = 0.0,
    truth_sigma: float = 4.0,
    rows: Callable[[list[float]], Iterable[float]] = iter,
) -> Landscape:
    r"""Compute both surfaces and the valley.

    .. math:: E \min_n |x − μ − σ z_n| \quad\text{and}\quad \frac1Q Σ_q |ω_{μσ}(q) − q|

    Parameters
    ----------
    mu : array_like, shape (A,)
        Means of the hypotheses.
    sigma : array_like, shape (B,)
        Standard deviations of the hypotheses, above 0.
    N : int
        Number of hypotheses of minMPJPE; the ECE is that of infinitely many.
    truth_mu, truth_sigma : float
        Mean and standard deviation of the truth.
    rows : callable
        Wraps the iteration over spreads, for a progress bar.

    Returns
    -------
    Landscape
        Lower is better on both surfaces.

    Raises
    ------
    PoseDataError
        Where N is below 1, or a spread is negative or not finite.

    Notes
    -----
    Differs from the published code: there 10,000 truths and 200 draws of hypotheses are averaged, at 101 levels.

    References
    ----------
    arXiv:2210.11179, Figure 1d.

    Examples
    --------
    >>> small = landscape([-1, 0, 1], [3, 4, 5])
    >>> small.lowest_in_valley[0], round(small.lowest_in_valley[1], 4)
    (0.0, 4.0)
    """
    mu, sigma = np.asarray(mu, float), np.asarray(sigma, float)

    def min_mpjpe(spread: float, means: Floats) -> Floats:
        offset = means - truth_mu
        return best_of.expected_min_mpjpe(spread, N=N, D=1, truth_sigma=truth_sigma, offset=offset, nodes=32)

    surfaces = [(min_mpjpe(s, mu), [_ece(m, s, truth_mu, truth_sigma) for m in mu]) for s in rows(sigma.tolist())]
    valley = np.array([valley_spread(m, truth_mu=truth_mu, truth_sigma=truth_sigma) for m in mu])
    return Landscape(
        mu=mu,
        sigma=sigma,
        min_mpjpe=np.array([errors for errors, _ in surfaces]),
        ece=np.array([eces for _, eces in surfaces]),
        valley=valley,
        valley_ece=np.array([_ece(m, s, truth_mu, truth_sigma) for m, s in zip(mu, valley, strict=True)]),
        valley_min_mpjpe=np.array([float(min_mpjpe(s, m)) for m, s in zip(mu, valley, strict=True)]),
        truth_mu=truth_mu,
        truth_sigma=truth_sigma,
    )
