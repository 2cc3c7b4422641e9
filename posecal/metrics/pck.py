"""Which share of joints, or of poses, is right? PCK, its area AUC, and CPS.

A joint is correct where its error lies below a threshold, a pose where all of its joints are. With N hypotheses,
one of them is taken per pose: the best for this very number and threshold (``own``), the one that minMPJPE chose
(``linked``), or the mean over all (``mean``).

The best hypothesis at every threshold comes from one sort: the number of joints that the best hypothesis gets
right at τ is the number of i with min_n e_(i),n < τ, where e_(i),n is the i-th smallest joint error of hypothesis
n. So PCK, AUC and CPS are closed forms of K numbers per pose, and no loop over thresholds is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.blocks import per_pose
from posecal.errors import PoseDataError, did_you_mean
from posecal.geometry.procrustes import Alignment
from posecal.metrics.position import joint_errors, linked

__all__ = [
    "AUC_STEP",
    "AUC_THRESHOLDS",
    "CPS_MOST",
    "SELECTIONS",
    "Selection",
    "auc",
    "auc_share",
    "correct_joints",
    "correct_share",
    "cps",
    "cps_area",
    "joint_score",
    "pck",
    "pose_score",
]

Selection = Literal["own", "linked", "mean"]
SELECTIONS: tuple[Selection, ...] = get_args(Selection)

Score = Callable[[FloatArray], FloatArray]

AUC_STEP, AUC_THRESHOLDS = 5.0, 31
"""AUC's thresholds: 0, 5, … 150 mm."""

CPS_MOST = 300.0
"""CPS's largest threshold, mm."""


def correct_share(errors: FloatArray, threshold: float | FloatArray, *, strict: bool = True) -> FloatArray:
    """Say 1 where an error is below the threshold (or at it, where not strict), else 0."""
    return np.asarray(errors < threshold if strict else errors <= threshold, dtype=np.float64)


def correct_joints(
    block: Block,
    threshold: float,
    select: Selection = "own",
    joints: BoolArray | None = None,
    body: BoolArray | None = None,
    *,
    strict: bool = True,
) -> FloatArray:
    """PCK of each pose at one threshold, (B,); as :func:`joint_score` of :func:`correct_share`, without its sort."""
    weights = block.weights(joints)
    right = block.errors < threshold if strict else block.errors <= threshold
    shares = (weights[:, None] @ right)[:, 0]
    if select == "linked":
        found = linked(block, shares, body)
    else:
        found = shares.max(axis=-1) if select == "own" else shares.mean(axis=-1)
    return np.where(weights.any(axis=1), found, np.nan)


def auc_share(errors: FloatArray, *, exact: bool = False, strict: bool = True) -> FloatArray:
    """Mean of :func:`correct_share` over the thresholds 0, 5, … 150 mm, or its exact integral over 0 … 150 mm."""
    last = AUC_STEP * (AUC_THRESHOLDS - 1)
    if exact:
        return np.asarray(1 - np.minimum(errors, last) / last)
    steps = np.minimum(errors, last + AUC_STEP) / AUC_STEP
    above = AUC_THRESHOLDS - 1 - np.floor(steps) if strict else AUC_THRESHOLDS - np.ceil(steps)
    return np.asarray(np.maximum(above, 0) / AUC_THRESHOLDS)


def cps_area(errors: FloatArray) -> FloatArray:
    """Trapezoid over the thresholds τ = 1, 2, … 300 mm of strict :func:`correct_share`, 0 … 299 mm."""
    first = np.floor(np.minimum(errors, CPS_MOST)) + 1  # the smallest threshold that is reached, 301 for none
    return np.asarray(CPS_MOST + 1 - first - 0.5 * (first <= CPS_MOST) - 0.5 * (first <= 1))


def joint_score(
    block: Block,
    score: Score,
    select: Selection = "own",
    align: Alignment = "none",
    joints: BoolArray | None = None,
    body: BoolArray | None = None,
    fit: BoolArray | None = None,
) -> FloatArray:
    """Mean over a pose's joints of a score of their errors, of the hypothesis that ``select`` takes.

    Parameters
    ----------
    block : Block
        B poses.
    score : callable
        From errors in mm to numbers that fall with the error, elementwise; 0 at infinity.
    select : str
        One of :data:`SELECTIONS`; ``own`` takes the best hypothesis at each threshold that the score adds up.
    align : str
        See :mod:`posecal.geometry.procrustes`.
    joints : bool array (K,), optional
        The joints that are scored.
    body : bool array (K,), optional
        The joints that minMPJPE is of, by which ``linked`` chooses.
    fit : bool array (K,), optional
        The joints to which the alignment is fitted, of those that are usable; those of ``body`` by default.

    Returns
    -------
    array (B, ...)
        Scores, with the trailing axes that the score adds; NaN for poses without a joint that counts.
    """
    weights = block.weights(joints).astype(np.float64)
    fit = body if fit is None else fit
    found: FloatArray
    if select == "own":
        found = score(_best_ordered(block, align, joints, fit)).sum(axis=1)
        number = np.maximum(np.count_nonzero(weights, axis=1), 1)
        found /= number.reshape(-1, *[1] * (found.ndim - 1))
    elif select == "linked":
        errors = linked(block, joint_errors(block, align, None, fit), body)
        found = np.einsum("bk,bk...->b...", weights, score(errors))
    else:
        scores = score(joint_errors(block, align, None, fit))
        found = np.einsum("bk,bkn...->b...", weights, scores) / block.n_hypotheses
    found[~weights.any(axis=1)] = np.nan
    return found


def pose_score(
    block: Block,
    score: Score,
    select: Selection = "own",
    align: Alignment = "none",
    joints: BoolArray | None = None,
    body: BoolArray | None = None,
    fit: BoolArray | None = None,
) -> FloatArray:
    """Score the largest error among a pose's joints, of the hypothesis that ``select`` takes.

    Parameters
    ----------
    block, score, select, align, joints, body, fit
        As for :func:`joint_score`.

    Returns
    -------
    array (B, ...)
        Scores; NaN for poses without a joint that counts.
    """
    weights = block.weights(joints)
    aligned = joint_errors(block, align, None, body if fit is None else fit)
    errors = np.where(weights[..., None] > 0, aligned, 0)
    worst = errors.max(axis=1)
    if select == "own":
        found = score(worst.min(axis=-1))
    elif select == "linked":
        found = score(linked(block, worst, body))
    else:
        found = score(worst).mean(axis=1)
    found = np.asarray(found, dtype=np.float64)
    found[~weights.any(axis=1)] = np.nan
    return found


def _best_ordered(block: Block, align: Alignment, joints: BoolArray | None, fit: BoolArray | None) -> FloatArray:
    """Smallest, over the hypotheses, of the i-th smallest joint error, (B, K); infinite for joints left out."""

    def compute() -> FloatArray:
        errors = joint_errors(block, align, None, fit)
        counted = block.weights(joints) > 0
        if joints is not None:
            errors, counted = errors[:, joints], counted[:, joints]
        ordered = np.sort(np.where(counted[..., None], errors, np.inf), axis=1)
        return np.asarray(ordered.min(axis=-1))

    masks = (None if mask is None else mask.tobytes() for mask in (joints, fit))
    return block.share(("best_ordered", align, *masks), compute)


def pck(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    threshold: float = 150.0,
    select: Selection = "own",
    strict: bool = True,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Share of correct keypoints of each pose: PCK.

    .. math:: \max_n \frac{1}{K} \sum_k 1[\lVert x_{nmk} - y_{mk} \rVert < \tau]

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    truth : array (M, K, D)
        True poses, mm.
    threshold : float
        τ, mm.
    select : str
        The hypothesis that counts: the best for PCK itself (``own``), the one of smallest MPJPE (``linked``),
        or the ``mean`` over all.
    strict : bool
        Whether a joint at the very threshold is wrong.
    where : bool array (M, K), optional
        The joints that count; Human3.6M's PCK has 14 of 17 (:data:`posecal.data.skeleton.JOINT_SETS`).
    root : int, optional
        The joint to subtract from every pose first.

    Returns
    -------
    array (M,)
        Shares, 0 to 1; higher is better; NaN for a pose without a joint that counts.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    Differs from the published code: cGNF's function of this name counts a pose only where all joints are within
    the threshold; that is a correct-pose rate.

    References
    ----------
    Mehta et al., arXiv:1611.09813 (150 mm).

    Examples
    --------
    >>> import numpy as np
    >>> hypotheses = np.zeros((1, 1, 2, 3))
    >>> hypotheses[0, 0, 0, 0] = 150
    >>> pck(hypotheses, np.zeros((1, 2, 3))), pck(hypotheses, np.zeros((1, 2, 3)), strict=False)
    (array([0.5]), array([1.]))
    """
    _known(select)

    if not 0 < threshold < float("inf"):
        raise PoseDataError(f"threshold: {threshold}; expected a length above 0.")
    return per_pose(lambda b: correct_joints(b, threshold, select, strict=strict), hypotheses, truth, where, root=root)


def auc(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    exact: bool = False,
    select: Selection = "own",
    strict: bool = True,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    """Mean of PCK over the thresholds 0, 5, … 150 mm of each pose: AUC.

    Parameters
    ----------
    hypotheses, truth, select, strict, where, root
        As for :func:`pck`; ``own`` takes the best hypothesis at each threshold.
    exact : bool
        Take the integral over 0 … 150 mm instead of the 31 thresholds.

    Returns
    -------
    array (M,)
        Areas; higher is better. At most 30/31 with strict thresholds (none is below 0 mm), else 1.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    Differs from the published code: none.

    References
    ----------
    Mehta et al., arXiv:1611.09813.

    Examples
    --------
    Errors of 0 and of 75 mm: 30 and 15 thresholds of 31, so 45/62.

    >>> import numpy as np
    >>> hypotheses = np.zeros((1, 1, 2, 3))
    >>> hypotheses[0, 0, 0, 0] = 75
    >>> auc(hypotheses, np.zeros((1, 2, 3))) * 62
    array([45.])
    """
    _known(select)

    def score(errors: FloatArray) -> FloatArray:
        return auc_share(errors, exact=exact, strict=strict)

    return per_pose(lambda b: joint_score(b, score, select), hypotheses, truth, where, root=root)


def cps(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    select: Selection = "own",
    align: Alignment = "similarity",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Correct pose score of each pose: CPS.

    .. math:: \max(0,\; 300 - \lfloor d^* \rfloor - \tfrac12 1[d^* < 300] - \tfrac12 1[d^* < 1]),
              \qquad d^* = \min_n \max_k d_{nmk}

    which is the trapezoid over τ = 1, 2, … 300 mm of 1[d* < τ].

    Parameters
    ----------
    hypotheses, truth, select, where, root
        As for :func:`pck`; Human3.6M's CPS has 16 of 17 joints, all but the spine.
    align : str
        See :mod:`posecal.geometry.procrustes`; Procrustes by default.

    Returns
    -------
    array (M,)
        Areas, 0 to 299 mm; higher is better.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    Procrustes fits the joints that ``where`` names. Differs from the published code: none in value; there is no
    loop over thresholds.

    References
    ----------
    Wandt et al., arXiv:2011.14679.

    Examples
    --------
    >>> import numpy as np
    >>> hypotheses = np.zeros((1, 1, 2, 3))
    >>> hypotheses[0, 0, 0, 0] = 110.2
    >>> cps(hypotheses, np.zeros((1, 2, 3)), align="none")
    array([189.5])
    """
    _known(select)
    return per_pose(lambda b: pose_score(b, cps_area, select, align), hypotheses, truth, where, root=root)


def _known(select: str) -> None:
    if select not in SELECTIONS:
        raise PoseDataError(f"select: {select!r} is not known. {did_you_mean(select, SELECTIONS)}")
