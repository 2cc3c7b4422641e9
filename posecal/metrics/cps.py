"""CPS, the correct pose score: the share of poses of which every joint is right, over all thresholds to 300 mm.

With N hypotheses, one of them is taken per pose, as for PCK. The area is a closed form of the largest joint error of
that hypothesis, and no loop over thresholds is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import refuse_all_but_lengths
from posecal.data.arrays import BoolArray, FloatArray, checked_choice
from posecal.engine.block import Block
from posecal.engine.metric import Curve, Metric, Need, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.scope import Scope
from posecal.geometry.procrustes import ALIGNMENTS, Alignment
from posecal.metrics.mpjpe import aligned_words
from posecal.metrics.pck import SELECTED, THRESHOLDS, correct_share
from posecal.metrics.position import joint_errors, linked, scored_weights
from posecal.metrics.selection import SELECTIONS, Score, Selection

CPS_MOST = 300.0
"""CPS's largest threshold, mm."""


def cps_area(errors: FloatArray) -> FloatArray:
    """Trapezoid over the thresholds τ = 1, 2, … 300 mm of strict :func:`correct_share`, 0 … 299 mm."""
    first = np.floor(np.minimum(errors, CPS_MOST)) + 1  # the smallest threshold that is reached, 301 for none
    return np.asarray(CPS_MOST + 1 - first - 0.5 * (first <= CPS_MOST) - 0.5 * (first <= 1))


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
        As for :func:`posecal.metrics.pck.joint_score`.

    Returns
    -------
    array (B, ...)
        Scores; NaN for poses without a joint that counts, or with too few to align.
    """
    fit = body if fit is None else fit
    weights = scored_weights(block, align, joints, fit)

    def largest() -> FloatArray:
        errors, counted = joint_errors(block, align, None, fit), weights > 0
        if joints is not None:
            errors, counted = errors[:, joints], counted[:, joints]
        return np.asarray((errors if counted.all() else np.where(counted[..., None], errors, 0)).max(axis=1))

    masks = (None if mask is None else mask.tobytes() for mask in (joints, fit))
    worst = block.share(("largest_error", align, *masks), largest)
    if select == "own":
        scores = score(worst.min(axis=-1))
    elif select == "linked":
        scores = score(linked(block, worst, body))
    else:
        each = score(worst)
        scores = each.mean(axis=1) if block.weights is None else np.einsum("bn,bn...->b...", block.weights, each)
    scores = np.asarray(scores, dtype=np.float64)
    scores[~weights.any(axis=1)] = np.nan
    return scores


def cps(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    select: Selection = "own",
    align: Alignment = "similarity",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Correct pose score of each pose: CPS.

    .. math:: \max(0,\; 300 - \lfloor d^* \rfloor - \tfrac12 1[d^* < 300] - \tfrac12 1[d^* < 1]),
              \qquad d^* = \min_n \max_k d_{nmk}

    which is the trapezoid over τ = 1, 2, … 300 mm of 1[d* < τ].

    Parameters
    ----------
    hypotheses, truth, select, where, root, weights, axes, unit
        As for :func:`posecal.metrics.pck`; Human3.6M's CPS has 16 of 17 joints, all but the spine.
    align : str
        See :mod:`posecal.geometry.procrustes`; Procrustes by default.

    Returns
    -------
    array (M,)
        Areas, 0 to 299 mm; higher is better; NaN for a pose without a joint that counts, or with too few to align.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    Procrustes fits the joints that ``where`` names. Differs from the published code: none in value; there is no
    loop over thresholds.

    See Also
    --------
    posecal.metrics.pck : The same question of single joints.

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
    checked_choice(select, "select", SELECTIONS)
    checked_choice(align, "align", ALIGNMENTS)
    refuse_all_but_lengths(unit, "thresholds: 1 to 300 mm")

    def statistic(block: Block) -> FloatArray:
        return pose_score(block, cps_area, select, align)

    return per_pose(statistic, hypotheses, truth, where, root=root, weights=weights, axes=axes, unit=unit)


# --- metrics --------------------------------------------------------------------------------------------------


def _statistic(scope: Scope, name: str, score: Score) -> Statistic:
    p = scope.protocol
    joints = partial(pose_score, joints=scope.cps, body=scope.body, fit=scope.fit)
    return Statistic(name, partial(joints, score=score, select=p.cps_best, align=p.cps_align))


def _needs(scope: Scope) -> tuple[Need, ...]:
    return ("lengths",) if scope.protocol.cps_align == "none" else ("lengths", "three axes")


def cps_metrics(scope: Scope) -> Iterator[Metric]:
    """CPS."""
    p, joints, share = scope.protocol, scope.named(scope.cps), scope.protocol.cps_unit == "share"
    yield Metric(
        name="cps",
        label="CPS",
        unit="" if share else "mm",
        direction="higher",
        family="accuracy",
        brief=f"area to 300 mm of: all of {joints} within τ",
        definition=f"mean over poses of the area over τ = 1 … 300 mm of 1[each of {joints} within τ]"
        f"{aligned_words(scope, p.cps_align, scope.cps)}, {SELECTED[p.cps_best]} at each τ"
        + ("; over 300 mm" if share else ""),
        statistic=_statistic(scope, "cps", cps_area),
        finish=lambda means: means / (CPS_MOST if share else 1),
        needs=_needs(scope),
        headline=True,
        range="0 to 299/300" if share else "0 to 299 mm",
        bounds=(0.0, (CPS_MOST - 1) / (CPS_MOST if share else 1)),
        reading="190 mm means that the worst joint of the best hypothesis is about 110 mm off, after alignment.",
        source="Wandt et al., arXiv:2011.14679",
    )


def cps_curve(scope: Scope) -> Curve:
    """Share of correct poses against the threshold."""
    p = scope.protocol
    return Curve(
        name="cps_curve",
        at=THRESHOLDS,
        axes=("threshold τ [mm]", "share of correct poses"),
        definition=f"share of poses with each of {scope.named(scope.cps)} within τ"
        f"{aligned_words(scope, p.cps_align, scope.cps)}, {SELECTED[p.cps_best]} at each τ",
        statistic=_statistic(scope, "cps_curve", lambda errors: correct_share(errors[..., None], THRESHOLDS)),
        needs=_needs(scope),
    )
