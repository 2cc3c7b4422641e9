"""How often does the truth lie within the ball that holds a share q of its hypotheses? The calibration curve.

ω_k(q) of joint k is the mean over poses of how far inside its q-ball the truth lies
(:mod:`posecal.calibration.ranks`). For a calibrated model ω_k(q) = q; below the diagonal the truth falls
outside too often and the model is overconfident, above it is underconfident.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from posecal.calibration.ranks import LEVELS, Definition, inside, known_definition
from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.blocks import per_pose

__all__ = ["CalibrationCurve", "calibration_curve", "inside_table", "joint_median"]


@dataclass(frozen=True)
class CalibrationCurve:
    """Calibration curves of K joints.

    Attributes
    ----------
    definition : str
        One of :data:`posecal.calibration.ranks.DEFINITIONS`.
    coverage : array (K, Q)
        ω_k(q), 0 to 1; NaN for joints that never count.
    pooled : array (Q,)
        The curve whose statistic is, per pose, the mean over the joints that count: the one column that the
        paper's numbers of occluded joints come from.
    """

    definition: Definition
    coverage: FloatArray
    pooled: FloatArray

    @property
    def levels(self) -> FloatArray:
        """The quantile levels q, (Q,)."""
        return LEVELS

    @property
    def median(self) -> FloatArray:
        """ω(q), (Q,): the median over the joints that count, the curve of the paper."""
        counted = self.coverage[~np.isnan(self.coverage).any(axis=1)]
        return joint_median(counted) if len(counted) else np.full(LEVELS.size, np.nan)


def joint_median(curves: FloatArray) -> FloatArray:
    """Median over the joints of curves (..., K, Q) without NaN; by sorting, faster than NumPy's median."""
    ordered = np.sort(curves, axis=-2)
    middle = ordered.shape[-2] // 2
    upper: FloatArray = ordered[..., middle, :]
    return upper if ordered.shape[-2] % 2 else (ordered[..., middle - 1, :] + upper) / 2


def inside_table(block: Block, definition: Definition, joints: BoolArray | None = None) -> FloatArray:
    """Per pose, the K rows of :func:`posecal.calibration.ranks.inside` and below them their mean.

    Parameters
    ----------
    block : Block
        B poses.
    definition : str
        One of :data:`posecal.calibration.ranks.DEFINITIONS`.
    joints : bool array (K,), optional
        The joints that are scored.

    Returns
    -------
    array (B, K + 1, Q)
        Weights; NaN for joints that don't count.
    """
    weights = inside(block, definition)
    if joints is not None:
        weights[:, ~joints] = np.nan
    counted = ~np.isnan(weights[..., 0])
    number = counted.sum(axis=1)
    mean = np.where(counted[..., None], weights, 0).sum(axis=1) / np.maximum(number, 1)[:, None]
    mean[number == 0] = np.nan
    return np.concatenate([weights, mean[:, None]], axis=1)


def calibration_curve(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    definition: Definition = "exchangeable",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> CalibrationCurve:
    r"""Calibration curve of every joint.

    .. math:: \omega_k(q) = \frac{1}{M} \sum_m W_{mk}(q)

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, any unit.
    truth : array (M, K, D)
        True poses, the same unit.
    definition : str
        ``exchangeable``, ``paper`` or ``reference``; see :mod:`posecal.calibration.ranks`.
    where : bool array (M, K), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first; it carries no information then and is left out.

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
    >>> curve.coverage[0, [0, 5, 10]]
    array([0. , 0.5, 1. ])
    """
    known = known_definition(definition)
    n_joints = np.shape(truth)[1] if np.ndim(truth) == 3 else 0
    joints = None if root is None else np.arange(n_joints) != root % max(n_joints, 1)
    table = per_pose(lambda b: inside_table(b, known, joints), hypotheses, truth, where, root=root)
    number = (~np.isnan(table[..., 0])).sum(axis=0)[:, None]
    mean = np.where(number > 0, np.nansum(table, axis=0) / np.maximum(number, 1), np.nan)
    return CalibrationCurve(known, mean[:-1], mean[-1])
