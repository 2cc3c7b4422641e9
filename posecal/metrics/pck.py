"""PCK and AUC: the share of joints whose error is below a threshold, and its area.

With N hypotheses, one of them is taken per pose: the best for this very number and threshold (``own``), the one that
minMPJPE chose (``linked``), or the mean over all (``mean``).

The best hypothesis at every threshold comes from one sort: the number of joints that the best hypothesis gets right at
τ is the number of i with min_n e_(i),n < τ, where e_(i),n is the i-th smallest joint error of hypothesis n. So PCK and
AUC are closed forms of K numbers per pose, and no loop over thresholds is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, checked_choice, checked_number
from posecal.engine.block import Block, per_pose
from posecal.engine.metric import Curve, Metric, Statistic, entry
from posecal.engine.protocol import Protocol
from posecal.engine.scope import Scope
from posecal.geometry.procrustes import Alignment
from posecal.metrics.position import joint_errors, linked

Selection = Literal["own", "linked", "mean"]
SELECTIONS: tuple[Selection, ...] = get_args(Selection)

Score = Callable[[FloatArray], FloatArray]

AUC_STEP, AUC_THRESHOLDS = 5.0, 31
"""AUC's thresholds: 0, 5, … 150 mm."""


def correct_share(errors: FloatArray, threshold: float | FloatArray, *, strict: bool = True) -> FloatArray:
    """1 where an error is below the threshold (or at it, where not strict), else 0."""
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
        share = linked(block, shares, body)
    else:
        share = shares.max(axis=-1) if select == "own" else shares.mean(axis=-1)
    return np.where(weights.any(axis=1), share, np.nan)


def auc_share(errors: FloatArray, *, exact: bool = False, strict: bool = True) -> FloatArray:
    """Mean of :func:`correct_share` over the thresholds 0, 5, … 150 mm, or its exact integral over 0 … 150 mm."""
    last = AUC_STEP * (AUC_THRESHOLDS - 1)
    if exact:
        return np.asarray(1 - np.minimum(errors, last) / last)
    steps = np.minimum(errors, last + AUC_STEP) / AUC_STEP
    above = AUC_THRESHOLDS - 1 - np.floor(steps) if strict else AUC_THRESHOLDS - np.ceil(steps)
    return np.asarray(np.maximum(above, 0) / AUC_THRESHOLDS)


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
        One of :data:`SELECTIONS`; ``own`` takes the best hypothesis at each threshold that the score sums over.
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
    scores: FloatArray
    if select == "own":
        scores = score(_best_ordered(block, align, joints, fit)).sum(axis=1)
        number = np.maximum(np.count_nonzero(weights, axis=1), 1)
        scores /= number.reshape(-1, *[1] * (scores.ndim - 1))
    elif select == "linked":
        errors = linked(block, joint_errors(block, align, None, fit), body)
        scores = np.einsum("bk,bk...->b...", weights, score(errors))
    else:
        each = score(joint_errors(block, align, None, fit))
        scores = np.einsum("bk,bkn...->b...", weights, each) / block.n_hypotheses
    scores[~weights.any(axis=1)] = np.nan
    return scores


def least_of_each_rank(errors: FloatArray) -> FloatArray:
    """Sort (K, B, N) errors over the K joints, in place, and give the smallest of the N hypotheses, (K, B).

    Few joints are sorted by a network of comparisons, each of two rows of memory.
    """
    if len(errors) > 40:
        return np.asarray(np.sort(errors, axis=0).min(axis=-1))
    rows, smaller = list(errors), np.empty_like(errors[0])
    for i, j in _comparisons(len(rows)):
        np.minimum(rows[i], rows[j], out=smaller)
        np.maximum(rows[i], rows[j], out=rows[j])
        rows[i], smaller = smaller, rows[i]
    return np.stack([row.min(axis=-1) for row in rows])


@cache
def _comparisons(n: int) -> list[tuple[int, int]]:
    """Pairs of positions that Batcher's odd-even merge sort puts in order, one after another."""
    return [
        (i + j, i + j + step)
        for size in (1 << level for level in range((n - 1).bit_length()))
        for step in (size >> level for level in range(size.bit_length()))
        for j in range(step % size, n - step, 2 * step)
        for i in range(min(step, n - j - step))
        if (i + j) // (2 * size) == (i + j + step) // (2 * size)
    ]


def _best_ordered(block: Block, align: Alignment, joints: BoolArray | None, fit: BoolArray | None) -> FloatArray:
    """Smallest, over the hypotheses, of the i-th smallest joint error, (B, K); infinite for joints left out."""

    def compute() -> FloatArray:
        rows, counted = joint_errors(block, align, None, fit).swapaxes(0, 1), block.weights(joints).T > 0
        chosen = np.ones(len(rows), dtype=bool) if joints is None else joints
        rows, counted = rows[chosen], counted[chosen]
        if not counted.all():
            rows[~counted] = np.inf
        return least_of_each_rank(rows).T

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

    See Also
    --------
    auc : Mean of PCK over thresholds.
    posecal.metrics.cps : The same of entire poses.

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
    checked_choice(select, "select", SELECTIONS)
    threshold = checked_number(threshold, "threshold", lambda mm: 0 < mm < np.inf, "a length above 0")
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

    See Also
    --------
    pck : At one threshold.

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
    checked_choice(select, "select", SELECTIONS)

    def score(errors: FloatArray) -> FloatArray:
        return auc_share(errors, exact=exact, strict=strict)

    return per_pose(lambda b: joint_score(b, score, select), hypotheses, truth, where, root=root)


# --- metrics --------------------------------------------------------------------------------------------------

THRESHOLDS: FloatArray = np.arange(0, 301, 10.0)
"""Thresholds of the PCK and CPS curves, mm."""

SELECTED: dict[Selection, str] = {
    "own": "best hypothesis",
    "linked": "minMPJPE's hypothesis",
    "mean": "mean over hypotheses",
}

_SHARE = partial(
    Metric,
    unit="",
    direction="higher",
    family="accuracy",
    finish=entry(),
    headline=True,
    source="Mehta et al., arXiv:1611.09813",
)


def pck_metrics(scope: Scope) -> Iterator[Metric]:
    """PCK and AUC."""
    p, joints, select = scope.protocol, scope.named(scope.pck), scope.protocol.pck_best
    strict, exact, threshold = p.pck_rule == "<", p.auc == "integral", f"{p.pck_threshold:g} mm"
    right = partial(correct_joints, threshold=p.pck_threshold, select=select, strict=strict)
    yield _SHARE(
        name="pck",
        label=f"PCK {threshold}",
        brief=f"{scope.number(scope.pck)} {p.pck_rule} {threshold}, {SELECTED[select]}",
        definition=f"mean over poses of the share of {joints} with ‖x − y‖ {p.pck_rule} {threshold}, "
        f"{SELECTED[select]}",
        statistic=Statistic("pck", partial(right, joints=scope.pck, body=scope.body)),
        in_group_table=True,
        needs=("lengths",) if p.pck_threshold == Protocol().pck_threshold else (),
        range="0 to 1",
        reading="The share of joints that are right to the threshold, of the best hypothesis at that: it rises with N.",
    )
    grid = "its integral over 0 … 150 mm" if exact else "the thresholds 0, 5, … 150 mm"
    area = partial(joint_score, score=partial(auc_share, exact=exact, strict=strict), select=select)
    yield _SHARE(
        name="auc",
        label="AUC of PCK",
        brief=f"mean of PCK over {grid}",
        definition=f"mean over {grid} of PCK ({p.pck_rule}) over {joints}, {SELECTED[select]} at each threshold",
        statistic=Statistic("auc", partial(area, joints=scope.pck, body=scope.body)),
        needs=("lengths",),
        range="0 to 30/31 with strict thresholds (none is below 0 mm), else 1",
        reading="PCK without the choice of one threshold.",
    )


def pck_curve(scope: Scope) -> Curve:
    """PCK against the threshold."""
    p = scope.protocol

    def reached(errors: FloatArray) -> FloatArray:
        return correct_share(errors[..., None], THRESHOLDS, strict=p.pck_rule == "<")

    return Curve(
        name="pck_curve",
        at=THRESHOLDS,
        axes=("threshold τ [mm]", "share of correct joints (PCK)"),
        definition=f"mean over poses of the share of {scope.named(scope.pck)} with ‖x − y‖ {p.pck_rule} τ, "
        f"{SELECTED[p.pck_best]} at each τ",
        statistic=Statistic(
            "pck_curve",
            partial(joint_score, score=reached, select=p.pck_best, joints=scope.pck, body=scope.body),
        ),
        needs=("lengths",),
    )
