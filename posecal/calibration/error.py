"""What numbers does a calibration curve come down to?

The ECE is the mean over levels of ``|ω(q) - q|``: how far the curve lies from the diagonal, without saying on which
side. The signed area says on which: negative is overconfident. Coverage reads the curve at one level.

Over the joints the paper takes the median curve. That hides joints that err in opposite ways, so the mean over
joints and the worst joint stand beside it. Numbers of occluded joints take one pooled column instead.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from posecal.calibration.curve import CalibrationCurve
from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import FloatArray
from posecal.errors import PoseDataError, did_you_mean

__all__ = ["OVER_JOINTS", "OverJoints", "coverage_at", "ece", "joint_ece", "signed_area"]

OverJoints = Literal["median", "mean", "worst", "pooled"]
OVER_JOINTS: tuple[OverJoints, ...] = get_args(OverJoints)


def joint_ece(coverage: FloatArray) -> FloatArray:
    """Mean over levels of the distance of each curve from the diagonal.

    Parameters
    ----------
    coverage : array (..., Q)
        ω(q) at :data:`posecal.calibration.ranks.LEVELS`.

    Returns
    -------
    array (...)
        ECEs, 0 to about 0.5; lower is better; NaN for curves of NaN.

    Notes
    -----
    Differs from the published code: none.

    References
    ----------
    Naeini, Cooper and Hauskrecht, AAAI 2015 (the name); Pierzchlewicz et al., arXiv:2210.11179.

    Examples
    --------
    >>> joint_ece(LEVELS), round(float(joint_ece(0 * LEVELS)), 3)
    (np.float64(0.0), 0.5)
    """
    found: FloatArray = np.abs(coverage - LEVELS).mean(axis=-1)
    return found


def ece(curve: CalibrationCurve, over: OverJoints = "median") -> float:
    r"""Expected calibration error: mean distance of the calibration curve from the diagonal.

    .. math:: \mathrm{ECE} = \frac{1}{Q} \sum_q \left| \operatorname{median}_k \omega_k(q) - q \right|

    Parameters
    ----------
    curve : CalibrationCurve
        Curves of K joints.
    over : str
        ``median``: ECE of the median curve (the paper's); ``mean``: mean of the joints' ECEs; ``worst``: the
        largest of them; ``pooled``: ECE of the pooled column, for occluded joints.

    Returns
    -------
    float
        The ECE, 0 to about 0.5; lower is better; NaN where nothing counts. The paper also writes it as a
        percentage of 0.5.

    Raises
    ------
    PoseDataError
        For an unknown summary.

    Notes
    -----
    A perfect sampler shows more than 0 at finite M; see :func:`posecal.calibration.expected.perfect_sampler`.
    Differs from the published code: none, given the same curves.

    References
    ----------
    Pierzchlewicz et al., arXiv:2210.11179, section 3.1.

    Examples
    --------
    >>> from posecal.calibration import CalibrationCurve
    >>> never = CalibrationCurve("exchangeable", np.zeros((2, 21)), np.zeros(21))
    >>> round(ece(never), 12)
    0.5
    """
    if over == "median":
        return float(joint_ece(curve.median))
    if over == "pooled":
        return float(joint_ece(curve.pooled))
    if over not in OVER_JOINTS:
        raise PoseDataError(f"over: {over!r} is not known. {did_you_mean(over, OVER_JOINTS)}")
    errors = joint_ece(curve.coverage)
    errors = errors[~np.isnan(errors)]
    if not len(errors):
        return float("nan")
    return float(errors.mean() if over == "mean" else errors.max())


def signed_area(coverage: FloatArray) -> FloatArray:
    r"""Area between a calibration curve and the diagonal, with its sign.

    .. math:: \int_0^1 (\omega(q) - q)\, \mathrm{d}q

    by the trapezoidal rule over the 21 levels.

    Parameters
    ----------
    coverage : array (..., Q)
        ω(q) at :data:`posecal.calibration.ranks.LEVELS`.

    Returns
    -------
    array (...)
        Areas, -0.5 to 0.5; 0 is best, negative is overconfident, positive underconfident.

    Notes
    -----
    Differs from the published code: none; ours.

    Examples
    --------
    >>> round(float(signed_area(0 * LEVELS)), 12)
    -0.5
    """
    return np.asarray(np.trapezoid(coverage - LEVELS, LEVELS, axis=-1))


def coverage_at(coverage: FloatArray, level: float) -> FloatArray:
    """Share of truths within the ball of a level: the curve read at that level, interpolated between two.

    Parameters
    ----------
    coverage : array (..., Q)
        ω(q) at :data:`posecal.calibration.ranks.LEVELS`.
    level : float
        q, 0 to 1.

    Returns
    -------
    array (...)
        Shares, 0 to 1; the level itself is best.

    Raises
    ------
    PoseDataError
        For a level that is no share.

    Notes
    -----
    Differs from the published code: none; ours.

    Examples
    --------
    >>> float(coverage_at(LEVELS, 0.5))
    0.5
    """
    if not 0 <= level <= 1:
        raise PoseDataError(f"level: {level}; expected a share from 0 to 1.")
    place = level * (LEVELS.size - 1)
    below = min(int(place), LEVELS.size - 2)
    share = place - below
    return np.asarray(coverage[..., below] * (1 - share) + coverage[..., below + 1] * share)
