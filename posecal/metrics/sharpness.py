"""How wide do the hypotheses lie, whatever the truth? Diversity and sharpness.

A calibrated model can be useless, if it says only that a person is somewhere; so spread stands beside every
calibration number, in millimetres.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, squared_norms
from posecal.engine.block import Block
from posecal.engine.blocks import per_pose
from posecal.errors import PoseDataError

__all__ = ["diversity", "joint_deviations", "joint_radii", "mean_over_joints", "predicted_spread", "radius"]


def joint_deviations(block: Block, *, population: bool = False) -> FloatArray:
    """Standard deviation over the hypotheses, averaged over the axes.

    Returns
    -------
    array (B, K)
        Deviations, mm; NaN for joints that don't count, and for one hypothesis unless ``population``.
    """
    if block.n_hypotheses == 1 and not population:
        return np.full(block.where.shape, np.nan)
    found = block.offsets.std(axis=-1, ddof=0 if population else 1, dtype=np.float64).mean(axis=-1)
    return np.where(block.where, found, np.nan)


def predicted_spread(block: Block, joints: BoolArray | None = None) -> FloatArray:
    """How wide a pose's hypotheses lie: mean over its moving joints of :func:`joint_deviations`, (B,), mm."""
    found = joint_deviations(block)
    if joints is not None:
        found = np.where(joints, found, np.nan)
    moving = mean_over_joints(np.where(found > 0, found, np.nan))
    return np.where(np.isnan(moving), mean_over_joints(found), moving)


def joint_radii(block: Block, shares: tuple[float, ...]) -> FloatArray:
    """Radius of the ball about the median that holds a share of the hypotheses.

    Returns
    -------
    array (B, K, len(shares))
        The ⌈q N⌉-th smallest distance from the per-coordinate median, mm; NaN for joints that don't count.
    """
    n = block.n_hypotheses
    squares = block.share(
        "sorted_squares", lambda: np.sort(squared_norms(block.offsets - block.median[..., None]), axis=-1)
    )
    places = [max(1, int(np.ceil(round(share * n, 9)))) - 1 for share in shares]
    found = np.sqrt(squares[..., places], dtype=np.float64)
    found[~block.where] = np.nan
    return found


def diversity(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    population: bool = False,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Standard deviation of the hypotheses of each pose, over n, averaged over axes and joints.

    .. math:: \frac{1}{KD} \sum_{k,d} \sqrt{\frac{1}{N-1} \sum_n (x_{nmkd} - \bar x_{mkd})^2}

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    truth : array (M, K, D)
        True poses; only their shape matters.
    population : bool
        Divide by N instead of N - 1.
    where : bool array (M, K), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first; its spread of 0 counts unless ``where`` leaves it out.

    Returns
    -------
    array (M,)
        Deviations, mm; neither lower nor higher is better. NaN for one hypothesis unless ``population``.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    Differs from the published code: none; GFPose's script takes ``population=True``.

    References
    ----------
    Wehrbein et al., arXiv:2107.13788; Ci et al., arXiv:2212.08641.

    Examples
    --------
    Values 1 and 3 have the standard deviation √2.

    >>> import numpy as np
    >>> hypotheses = np.array([1.0, 3.0]).reshape(2, 1, 1, 1)
    >>> diversity(hypotheses, np.zeros((1, 1, 1))).round(4)
    array([1.4142])
    """

    def statistic(block: Block) -> FloatArray:
        return mean_over_joints(joint_deviations(block, population=population))

    return per_pose(statistic, hypotheses, truth, where, root=root)


def radius(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    share: float = 0.5,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Sharpness of each pose: mean radius of the balls that hold a share q of the hypotheses of a joint.

    .. math:: \frac{1}{K} \sum_k \varepsilon_{(\lceil qN \rceil)mk}, \qquad
              \varepsilon_{nmk} = \lVert x_{nmk} - \operatorname{median}_n x_{nmk} \rVert

    Parameters
    ----------
    hypotheses, truth, where, root
        As for :func:`diversity`.
    share : float
        q, above 0 and at most 1.

    Returns
    -------
    array (M,)
        Radii, mm; lower is sharper, which is better only among calibrated models.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    Differs from the published code: none; ours.

    References
    ----------
    Gneiting, Balabdaoui and Raftery, J. R. Stat. Soc. B 69, 243 (2007), doi:10.1111/j.1467-9868.2007.00587.x.

    Examples
    --------
    Of five points on a line, three lie within 1 of the middle.

    >>> import numpy as np
    >>> hypotheses = np.array([0.0, 5.0, 4.0, 6.0, 9.0]).reshape(5, 1, 1, 1)
    >>> radius(hypotheses, np.zeros((1, 1, 1)))
    array([1.])
    """
    if not 0 < share <= 1:
        raise PoseDataError(f"share: {share}; expected above 0 and at most 1.")
    return per_pose(lambda b: mean_over_joints(joint_radii(b, (share,))[..., 0]), hypotheses, truth, where, root=root)


def mean_over_joints(values: FloatArray) -> FloatArray:
    """Mean over the last axis of what is not NaN; NaN where nothing is left."""
    number = np.isfinite(values).sum(axis=-1)
    return np.where(number > 0, np.nansum(values, axis=-1) / np.maximum(number, 1), np.nan)
