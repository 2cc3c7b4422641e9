"""Calibration curves, and the numbers that are read off them.

ω_k(q) of joint k is the mean over poses of how far inside its q-ball the truth lies (:mod:`posecal.calibration.ranks`).
For a calibrated model ω_k(q) = q; below the diagonal the truth falls outside too often and the model is overconfident,
above it is underconfident.

The ECE is the mean over levels of ``|ω(q) - q|``: how far the curve lies from the diagonal, on either side. The signed
area says on which side: negative is overconfident. Coverage is the curve at one level. Over the joints the paper takes
the median curve, in which joints that err in opposite ways cancel; the mean over joints and the worst joint show them.
Numbers of occluded joints take the pooled curve instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import get_args

import numpy as np
import numpy.typing as npt

from posecal.calibration.ranks import DEFINITIONS, LEVELS, Definition, coincide, inside
from posecal.data.arguments import any_unit, checked
from posecal.data.arrays import (
    BoolArray,
    FloatArray,
    checked_choice,
    checked_number,
    checked_root,
    real_array,
)
from posecal.engine.block import Block
from posecal.engine.finish import mean_over_joints
from posecal.engine.per_pose import per_pose
from posecal.engine.protocol import OverJoints
from posecal.errors import PoseDataError

OVER_JOINTS: tuple[OverJoints, ...] = get_args(OverJoints)
"""The summaries over joints, that of the paper first."""

# --- arrays of curves (..., Q) and tables (..., K + 1, Q): K joints, and their pooled curve ------------------------


def _checked_curves(curves: npt.ArrayLike) -> FloatArray:
    array = real_array(curves, "curves")
    if array.shape[-1:] != LEVELS.shape:
        raise PoseDataError(f"curves {array.shape}: expected (..., {LEVELS.size}), a share at each level.")
    return array


def joint_ece(curves: npt.ArrayLike) -> FloatArray:
    """Mean over levels of the distance of each curve from the diagonal.

    Parameters
    ----------
    curves : array (..., Q)
        ω(q) at :data:`posecal.calibration.LEVELS`.

    Returns
    -------
    array (...)
        ECEs, 0 to about 0.5; lower is better; NaN for curves of NaN.

    Examples
    --------
    >>> joint_ece(LEVELS), round(float(joint_ece(0 * LEVELS)), 3)
    (np.float64(0.0), 0.5)
    """
    distances: FloatArray = np.abs(_checked_curves(curves) - LEVELS).mean(axis=-1)
    return distances


def signed_area(curves: npt.ArrayLike) -> FloatArray:
    r"""Area between each curve and the diagonal, with its sign.

    .. math:: \int_0^1 (\omega(q) - q)\, \mathrm{d}q

    by the trapezoidal rule over the 21 levels.

    Parameters
    ----------
    curves : array (..., Q)
        ω(q) at :data:`posecal.calibration.LEVELS`.

    Returns
    -------
    array (...)
        Areas, -0.5 to 0.5; 0 is best, negative is overconfident, positive underconfident.

    Examples
    --------
    >>> round(float(signed_area(0 * LEVELS)), 12)
    -0.5
    """
    return np.asarray(np.trapezoid(_checked_curves(curves) - LEVELS, LEVELS, axis=-1))


def is_resolved(level: float, n_hypotheses: float) -> bool:
    """Whether N hypotheses have a ball of a level: beyond q = N / (N + 1) its weight only nears 1, whatever the truth.

    Examples
    --------
    >>> is_resolved(0.9, 9), is_resolved(0.9, 8)
    (True, False)
    """
    return level * (n_hypotheses + 1) <= n_hypotheses + 1e-9


def coverage_at(curves: FloatArray, level: float) -> FloatArray:
    """Curves (..., Q) read at one level from 0 to 1, (...), interpolated between two of :data:`LEVELS`."""
    level = checked_number(level, "level", lambda level: 0 <= level <= 1, "a share from 0 to 1")
    below = min(int(level * (LEVELS.size - 1)), LEVELS.size - 2)
    share = level * (LEVELS.size - 1) - below
    return np.asarray(curves[..., below] * (1 - share) + curves[..., below + 1] * share)


MANY = 100
"""Of more joints than this a partition gives the median faster than a sort."""


def joint_median(curves: FloatArray) -> FloatArray:
    """Median over the joints that count of curves (..., K, Q), (..., Q)."""
    joints = curves.shape[-2]
    ends = [(joints - 1) // 2, joints // 2]
    if joints > MANY and not np.isnan(curves[..., 0]).any():
        pair = np.partition(curves, ends, axis=-2)[..., ends, :]
        return np.asarray((pair[..., 0, :] + pair[..., 1, :]) / 2)
    ordered = np.sort(curves, axis=-2)  # NaN last
    known = (~np.isnan(ordered[..., 0])).sum(axis=-1)
    middle = np.stack([(known - 1) // 2, known // 2], axis=-1)
    every = (known == joints).all()
    pair = ordered[..., ends, :] if every else np.take_along_axis(ordered, middle[..., None], axis=-2)
    return np.asarray((pair[..., 0, :] + pair[..., 1, :]) / 2)


def summary_curve(table: FloatArray, over: OverJoints) -> FloatArray:
    """Summarize each table, (..., K + 1, Q), by one curve, (..., Q); NaN where no joint counts."""
    curves = table[..., :-1, :]
    if over == "pooled":
        return table[..., -1, :]
    if over == "median":
        return joint_median(curves)
    if over == "mean":
        return mean_over_joints(curves.swapaxes(-1, -2))
    errors = joint_ece(curves)
    worst = np.where(np.isnan(errors), -np.inf, errors).argmax(axis=-1)
    return np.take_along_axis(curves, worst[..., None, None], axis=-2)[..., 0, :]


SUMMARIES = {over: partial(summary_curve, over=over) for over in OVER_JOINTS}
""":func:`summary_curve` by the summary over joints."""


def ece_over_joints(table: FloatArray, over: OverJoints) -> FloatArray:
    """ECE of each table, (..., K + 1, Q) to (...): of its summary, or for ``mean`` the mean of the joints' ECEs."""
    if over == "mean":
        return mean_over_joints(joint_ece(table[..., :-1, :]))
    return joint_ece(summary_curve(table, over))


# --- curves of one evaluation -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class CalibrationCurve:
    """Calibration curves of K joints.

    Attributes
    ----------
    definition : str
        One of :data:`posecal.calibration.DEFINITIONS`.
    joints : array (K, Q)
        ω_k(q), 0 to 1; NaN for joints that never count.
    pooled : array (Q,)
        The curve whose statistic is, per pose, the mean over the joints that count: the one that the paper's numbers
        of occluded joints come from.
    n_hypotheses : float, optional
        N, of weighted hypotheses the mean effective one, which says which levels the exchangeable definition resolves.

    Notes
    -----
    Where a method takes ``over``, it names the summary over joints: ``median``, of the median curve (the paper's);
    ``mean``, of the mean curve, and for the ECE the mean of the joints' ECEs; ``worst``, of the joint with the largest
    ECE; ``pooled``, of the pooled curve.
    """

    definition: Definition
    joints: FloatArray
    pooled: FloatArray
    n_hypotheses: float | None = None

    @property
    def levels(self) -> FloatArray:
        """The quantile levels q, (Q,)."""
        return LEVELS

    @property
    def median(self) -> FloatArray:
        """ω(q), (Q,): the median over the joints that count, the curve of the paper."""
        return joint_median(self.joints)

    def _table(self, over: OverJoints) -> FloatArray:
        checked_choice(over, "over", OVER_JOINTS)
        return np.concatenate([self.joints, self.pooled[None]])

    def summary(self, over: OverJoints = "median") -> FloatArray:
        """Give the one curve, (Q,), that stands for all joints."""
        return summary_curve(self._table(over), over)

    def ece(self, over: OverJoints = "median") -> float:
        """Give the expected calibration error, 0 to about 0.5; lower is better; see :func:`posecal.ece`."""
        return float(ece_over_joints(self._table(over), over))

    def joint_ece(self) -> FloatArray:
        """Give the ECE of each joint, (K,)."""
        return joint_ece(self.joints)

    def signed_area(self, over: OverJoints = "median") -> float:
        """Give the area between the curve and the diagonal, -0.5 to 0.5: negative is overconfident."""
        return float(signed_area(self.summary(over)))

    def joint_signed_area(self) -> FloatArray:
        """Give the signed area of each joint, (K,)."""
        return signed_area(self.joints)

    def coverage(self, level: float, over: OverJoints = "median") -> float:
        """Give the share of truths inside the ball that holds a share of the hypotheses.

        Parameters
        ----------
        level : float
            That share, 0 to 1; between two of the levels the curve is interpolated.
        over : str
            The summary over joints.

        Returns
        -------
        float
            0 to 1; the level itself is best. NaN where (N + 1) q > N, of the exchangeable definition: so few hypotheses
            have no ball that holds a share q of them.

        Raises
        ------
        PoseDataError
            For a level that is no share, or an unknown summary.
        """
        return float(self._resolved(coverage_at(self.summary(over), level), level))

    def joint_coverage(self, level: float) -> FloatArray:
        """Give the coverage of each joint, (K,); NaN as that of the summary."""
        return self._resolved(coverage_at(self.joints, level), level)

    def _resolved(self, coverage: FloatArray, level: float) -> FloatArray:
        if self.n_hypotheses is None or self.definition != "exchangeable" or is_resolved(level, self.n_hypotheses):
            return coverage
        return np.full_like(coverage, np.nan)


def curve_of(table: FloatArray, definition: Definition, n_hypotheses: float | None = None) -> CalibrationCurve:
    """Read a table (K + 1, Q) as calibration curves of N hypotheses."""
    return CalibrationCurve(definition, table[:-1], table[-1], n_hypotheses)


def inside_table(block: Block, definition: Definition, joints: BoolArray | None = None) -> FloatArray:
    """Per pose, the K rows of :func:`posecal.calibration.ranks.inside` and below them their mean.

    Parameters
    ----------
    block : Block
        B poses.
    definition : str
        One of :data:`posecal.calibration.DEFINITIONS`.
    joints : bool array (K,), optional
        The joints that are scored.

    Returns
    -------
    array (B, K + 1, Q)
        Weights; NaN for joints that don't count, and where all hypotheses equal the truth.
    """
    weights, counted = inside(block, definition), block.where & ~coincide(block)
    if joints is not None:
        counted &= joints
    number = counted.sum(axis=1, keepdims=True)
    weights[~counted] = 0
    mean = np.einsum("bk,bkq->bq", counted.astype(np.float64), weights) / np.where(number > 0, number, np.nan)
    weights[~counted] = np.nan
    return np.concatenate([weights, mean[:, None]], axis=1)


def calibration_curve(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    definition: Definition = "exchangeable",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> CalibrationCurve:
    r"""Calibration curve of every joint.

    .. math:: \omega_k(q) = \frac{1}{M} \sum_m W_{mk}(q)

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, any unit; of angles give it.
    truth : array (M, K, D)
        True poses, the same unit.
    definition : str
        ``exchangeable``, ``paper`` or ``reference``; see :mod:`posecal.calibration.ranks`.
    where : bool array (M, K) or (M,), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first; it carries no information then and is left out.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 where absent; (M, N) where ``axes`` has M first.
    axes : str, optional
        The layout of the hypotheses, such as ``MNKD``; needed where the shapes leave it open.
    unit : str or float, optional
        ``deg`` or ``rad`` where both are angles, whose distances are the shorter way round; any other is the same.

    Returns
    -------
    CalibrationCurve
        Curves at the 21 levels 0, 0.05, … 1. NaN with fewer than two hypotheses.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    Differs from the published code: the default is exact at every N; ``reference`` follows the released script.

    See Also
    --------
    ece : Mean distance of the curve from the diagonal.
    posecal.perfect_sampler : What a perfect sampler would show.

    References
    ----------
    Pierzchlewicz et al., arXiv:2210.11179, section 3.1.

    Examples
    --------
    The median of the four points -2, 0, 1 and 3 is 0.5. The truth, 1, is as far from it as one hypothesis and
    nearer than two: it shares the ranks 0 and 1, so its weight rises from 0 at q = 0 to 1 at q = 1/2.

    >>> import numpy as np
    >>> hypotheses = np.array([-2.0, 0.0, 3.0]).reshape(3, 1, 1, 1)
    >>> curve = calibration_curve(hypotheses, np.full((1, 1, 1), 1.0))
    >>> curve.coverage(0), curve.coverage(0.25), curve.coverage(0.5)
    (0.0, 0.5, 1.0)
    """
    checked_choice(definition, "definition", DEFINITIONS)
    unit = any_unit(unit)
    number_of_all, _, n_joints, _ = checked(hypotheses, truth, axes=axes, unit=unit)[0].shape
    root = checked_root(root, n_joints)
    joints = None if root is None else np.arange(n_joints) != root
    statistic = partial(inside_table, definition=definition, joints=joints)
    table = per_pose(statistic, hypotheses, truth, where, root=root, weights=weights, axes=axes, unit=unit)
    number = (~np.isnan(table[..., 0])).sum(axis=0)[:, None]
    mean = np.where(number > 0, np.nansum(table, axis=0) / np.maximum(number, 1), np.nan)
    n_hypotheses = float(number_of_all)
    if weights is not None:
        numbers = per_pose(lambda block: block.n_effective, hypotheses, truth, weights=weights, axes=axes, unit=unit)
        n_hypotheses = float(numbers.mean()) if len(numbers) else math.nan
    return curve_of(mean, definition, n_hypotheses)
