r"""Collapse of a model that is trained on the mean MPJPE of its hypotheses to a point: the paper's supplement A.1.

For a Gaussian truth both objectives have closed forms here: the squared error of the supplement's proof, and the MPJPE
itself. The best spread is 0 for both; the squared error collapses to the mean, the MPJPE to the median. The exponential
distribution, whose mean and median differ, is an example.

In general ``g(x̂) = E‖x − x̂‖`` is convex, so by Jensen's inequality moving all hypotheses to their mean never
increases the expected error, for any distribution of hypotheses and truth.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy import special

from posecal.errors import PoseDataError

__all__ = ["exponential_mpjpe", "exponential_squared_error", "mean_mpjpe", "mean_squared_error"]

Floats = npt.NDArray[np.float64]


def mean_mpjpe(sigma: npt.ArrayLike, *, D: int, truth_sigma: float = 1.0, offset: npt.ArrayLike = 0.0) -> Floats:
    r"""Return the expected distance between a Gaussian hypothesis and a Gaussian truth.

    .. math::

        E‖x − \hat x‖ = s \sqrt2\, \frac{Γ(\frac{D+1}2)}{Γ(\frac D2)}\,
        {}_1F_1\!\left(−\tfrac12; \tfrac D2; −\tfrac{‖μ^*−μ‖²}{2s²}\right), \quad s² = σ² + σ^{*2}

    Parameters
    ----------
    sigma : array_like, shape (...)
        The hypotheses' standard deviation per coordinate.
    D : int
        Number of coordinates.
    truth_sigma : float
        The truth's standard deviation per coordinate, above 0, in the unit of ``sigma``.
    offset : array_like, shape (...)
        Distance between the two means, in the unit of ``sigma``.

    Returns
    -------
    ndarray, shape (...)
        Expected mean MPJPE of any number of hypotheses, in the unit of ``sigma``. Lower is better; lowest at
        ``sigma = offset = 0``, and √2 times that for the true distribution.

    Raises
    ------
    PoseDataError
        Where D is below 1 or ``truth_sigma`` is not above 0.

    Notes
    -----
    Differs from the published code: not in it. The supplement's proof is for the squared error.

    References
    ----------
    arXiv:2210.11179, supplement A.1.

    Examples
    --------
    In one dimension x − x̂ ~ N(0, 3² + 4²), whose mean absolute value is 5 √(2/π).

    >>> round(float(mean_mpjpe(4, D=1, truth_sigma=3)), 6), round(5 * (2 / np.pi) ** 0.5, 6)
    (3.989423, 3.989423)
    """
    if D < 1 or not 0 < truth_sigma < math.inf:
        raise PoseDataError(f"D = {D}, truth_sigma {truth_sigma}; expected at least 1, and a length above 0.")
    variance = np.asarray(sigma, float) ** 2 + truth_sigma**2
    central = math.sqrt(2) * math.exp(math.lgamma((D + 1) / 2) - math.lgamma(D / 2))
    offset_squared = np.asarray(offset, float) ** 2
    return np.sqrt(variance) * central * special.hyp1f1(-0.5, D / 2, -offset_squared / (2 * variance))


def mean_squared_error(
    sigma: npt.ArrayLike, *, D: int, truth_sigma: float = 1.0, offset: npt.ArrayLike = 0.0
) -> Floats:
    r"""Return the expected squared distance between a Gaussian hypothesis and a Gaussian truth.

    .. math:: E‖x − \hat x‖² = D (σ² + σ^{*2}) + ‖μ^* − μ‖²

    Parameters
    ----------
    sigma : array_like, shape (...)
        The hypotheses' standard deviation per coordinate.
    D : int
        Number of coordinates.
    truth_sigma : float
        The truth's standard deviation per coordinate, in the unit of ``sigma``.
    offset : array_like, shape (...)
        Distance between the two means, in the unit of ``sigma``.

    Returns
    -------
    ndarray, shape (...)
        In the squared unit of ``sigma``. Lower is better; lowest at ``sigma = offset = 0``.

    Notes
    -----
    Differs from the published code: not in it.

    References
    ----------
    arXiv:2210.11179, supplement A.1.

    Examples
    --------
    >>> float(mean_squared_error(4, D=2, truth_sigma=3, offset=1))  # 2 (16 + 9) + 1
    51.0
    """
    variance = np.asarray(sigma, float) ** 2 + truth_sigma**2
    return np.asarray(D * variance + np.asarray(offset, float) ** 2)


def exponential_mpjpe(point: npt.ArrayLike) -> Floats:
    r"""Return the expected distance of a collapsed model from an exponential truth of mean 1.

    .. math:: E|x − a| = a − 1 + 2 e^{−a}

    Parameters
    ----------
    point : array_like, shape (...)
        The value a ≥ 0 of all hypotheses, in units of the truth's mean.

    Returns
    -------
    ndarray, shape (...)
        In units of the truth's mean. Lower is better; lowest, ln 2, at the median ln 2.

    Notes
    -----
    Differs from the published code: not in it.

    Examples
    --------
    >>> float(exponential_mpjpe(0.0))  # the truth's mean
    1.0
    """
    point = np.asarray(point, float)
    return np.asarray(point - 1 + 2 * np.exp(-point))


def exponential_squared_error(point: npt.ArrayLike) -> Floats:
    r"""Return the expected squared distance of a collapsed model from an exponential truth of mean 1.

    .. math:: E(x − a)² = 1 + (a − 1)²

    Parameters
    ----------
    point : array_like, shape (...)
        The value a of all hypotheses, in units of the truth's mean.

    Returns
    -------
    ndarray, shape (...)
        In squared units of the truth's mean. Lower is better; lowest, 1, at the mean 1.

    Notes
    -----
    Differs from the published code: not in it.

    Examples
    --------
    >>> float(exponential_squared_error(3.0))
    5.0
    """
    return np.asarray(1 + (np.asarray(point, float) - 1) ** 2)
