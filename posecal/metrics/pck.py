"""PCK and AUC: the share of joints whose error is below a threshold, and its area.

With N hypotheses, one of them is taken per pose: the best for this very number and threshold (``own``), the one that
minMPJPE chose (``linked``), or the mean over all (``mean``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import refuse_all_but_lengths
from posecal.data.arrays import BoolArray, FloatArray, checked_choice, checked_number
from posecal.engine.block import Block
from posecal.engine.bounds import SHARE
from posecal.engine.finish import entry
from posecal.engine.metric import Curve, Metric, Need, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.protocol import Protocol
from posecal.engine.scope import Scope
from posecal.errors import PoseDataError
from posecal.metrics.mpjpe import aligned_words
from posecal.metrics.position import linked
from posecal.metrics.selection import SELECTIONS, Selection, joint_score
from posecal.metrics.thresholds import is_range, range_of, reference_length

Area = Literal["thresholds", "integral", "trapezoid"]
AREAS: tuple[Area, ...] = get_args(Area)

AUC_RANGE = 0.0, 150.0, 31
"""First and last threshold of AUC, mm, and how many there are: 0, 5, … 150."""


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
    length: Callable[[Block], FloatArray] | None = None,
) -> FloatArray:
    """PCK of each pose at one threshold, (B,); as :func:`joint_score` of :func:`correct_share`, without its sort."""
    weights = block.joint_weights(joints)
    if length is not None:
        weights = weights * np.isfinite(length(block))[:, None]
    limit = threshold if length is None else threshold * np.nan_to_num(length(block))[:, None, None]
    right = block.errors < limit if strict else block.errors <= limit
    shares = (weights[:, None] @ right)[:, 0]
    if select == "linked":
        share = linked(block, shares, body)
    else:
        share = shares.max(axis=-1) if select == "own" else block.mean_of_each(shares)
    return np.where(weights.any(axis=1), share, np.nan)


def auc_share(
    errors: FloatArray,
    thresholds: tuple[float, float, int] = AUC_RANGE,
    area: Area = "thresholds",
    *,
    strict: bool = True,
) -> FloatArray:
    """Mean of :func:`correct_share` over thresholds, or its integral from the first to the last over their distance.

    Parameters
    ----------
    errors : array
        Errors, mm.
    thresholds : tuple of float, float and int
        The first, the last, and how many there are, evenly spaced.
    area : str
        The mean over ``thresholds``, the exact ``integral``, or the ``trapezoid`` rule over the thresholds.
    strict : bool
        Whether an error at a threshold is wrong.

    Returns
    -------
    array
        Shares, 0 to 1, of the shape of the errors.
    """
    first, last, number = thresholds
    if area == "integral":
        return np.asarray(1 - (np.clip(errors, first, last) - first) / (last - first))
    step = (last - first) / (number - 1)
    steps = (np.clip(errors, first - step, last + step) - first) / step
    above = number - 1 - np.floor(steps) if strict else number - np.ceil(steps)
    above = np.clip(above, 0, number)
    if area == "thresholds":
        return np.asarray(above / number)
    return np.asarray((above - 0.5 * (above > 0) - 0.5 * (above == number)) / (number - 1))


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
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
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
        τ, mm; for angles, pixels or no unit another than 150, in theirs.
    select : str
        The hypothesis that counts: the best for PCK itself (``own``), the one of smallest MPJPE (``linked``),
        or the ``mean`` over all.
    strict : bool
        Whether a joint at the very threshold is wrong.
    where : bool array (M, K) or (M,), optional
        The joints that count; Human3.6M's PCK has 14 of 17 (:data:`posecal.data.skeleton.JOINT_SETS`).
    root : int, optional
        The joint to subtract from every pose first.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 where absent; (M, N) where ``axes`` has M first.
    axes, unit : str, optional
        Such as ``MNKD`` and ``m``, where the hypotheses are not (N, M, K, D), or both not in mm, or it is not clear.

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
    if threshold == Protocol().pck_threshold:
        refuse_all_but_lengths(unit, f"threshold: {threshold:g} mm")

    def statistic(block: Block) -> FloatArray:
        return correct_joints(block, threshold, select, strict=strict)

    return per_pose(statistic, hypotheses, truth, where, root=root, weights=weights, axes=axes, unit=unit)


def auc(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    thresholds: tuple[float, float, int] = AUC_RANGE,
    area: Area = "thresholds",
    select: Selection = "own",
    strict: bool = True,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    """Mean of PCK over thresholds, 0, 5, … 150 mm by default, of each pose: AUC.

    Parameters
    ----------
    hypotheses, truth, select, strict, where, root, weights, axes, unit
        As for :func:`pck`; ``own`` takes the best hypothesis at each threshold.
    thresholds : tuple of float, float and int
        The first and the last threshold, mm, and how many there are: hands take (0, 50, 100).
    area : str
        The mean over the ``thresholds``, or the integral between the first and the last over their distance: exactly
        (``integral``) or by the ``trapezoid`` rule over the thresholds.

    Returns
    -------
    array (M,)
        Areas; higher is better. At most 30/31 with the default thresholds (none is below 0 mm), else 1.

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
    Mehta et al., arXiv:1611.09813; Zimmermann et al., arXiv:1909.04349 (FreiHAND: 100 thresholds from 0 to 50 mm,
    trapezoid).

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
    checked_choice(area, "area", AREAS)
    if not is_range(thresholds):
        raise PoseDataError(f"thresholds: {thresholds!r}; expected the first, a larger last, and how many, at least 2.")
    if thresholds == AUC_RANGE:
        refuse_all_but_lengths(unit, "thresholds: 0 to 150 mm")

    def score(errors: FloatArray) -> FloatArray:
        return auc_share(errors, thresholds, area, strict=strict)

    def statistic(block: Block) -> FloatArray:
        return joint_score(block, score, select)

    return per_pose(statistic, hypotheses, truth, where, root=root, weights=weights, axes=axes, unit=unit)


# --- metrics --------------------------------------------------------------------------------------------------

THRESHOLDS: FloatArray = np.arange(0, 301, 10.0)
"""Thresholds of the PCK and CPS curves, mm."""

SELECTED: dict[Selection, str] = {
    "own": "best hypothesis",
    "linked": "minMPJPE's hypothesis",
    "mean": "mean over hypotheses",
}

_PA: tuple[Need, ...] = ("positions", "three axes")

_SHARE = partial(
    Metric,
    unit="",
    direction="higher",
    family="accuracy",
    finish=entry(),
    bounds=SHARE,
    source="Mehta et al., arXiv:1611.09813",
)


def pck_metrics(scope: Scope) -> Iterator[Metric]:
    """PCK and AUC, as they stand and aligned (``pa_``)."""
    p, joints, select = scope.protocol, scope.named(scope.pck), scope.protocol.pck_best
    strict, thresholds = p.pck_rule == "<", range_of(p.auc_range)
    of, length = reference_length(p.pck_relative, scope.spec.joints)
    own_unit = length is not None, p.pck_threshold != Protocol().pck_threshold, p.auc_range != Protocol().auc_range
    unit = of if length is not None else "mm"
    threshold = f"{p.pck_threshold:g} {unit}"
    common: dict[str, Any] = {"select": select, "joints": scope.pck, "body": scope.body, "length": length}
    aligned: dict[str, Any] = {**common, "align": p.align, "fit": scope.fit}
    right = partial(correct_joints, threshold=p.pck_threshold, strict=strict, **common)
    is_right = partial(correct_share, threshold=p.pck_threshold, strict=strict)
    share = partial(auc_share, thresholds=thresholds, area=p.auc, strict=strict)
    first, last, number = thresholds
    second = f", {first + (last - first) / (number - 1):.3g}, …" if number > 2 else ","
    grid = f"the {number} thresholds {first:g}{second} {last:g} {unit}"
    if p.auc == "integral":
        grid = f"its integral over {first:g} … {last:g} {unit}"
    elif p.auc == "trapezoid":
        grid += " by the trapezoid rule"
    in_lengths: tuple[Need, ...] = ("lengths",)
    for prefix, at, over, more in (
        ("", right, partial(joint_score, score=share, **common), ()),
        ("pa_", partial(joint_score, score=is_right, **aligned), partial(joint_score, score=share, **aligned), _PA),
    ):
        label, after = ("PA-", aligned_words(scope, p.align, scope.pck)) if prefix else ("", "")
        brief = ", aligned" if prefix else ""
        yield _SHARE(
            name=f"{prefix}pck",
            label=f"{label}PCK {threshold}",
            brief=f"{scope.number(scope.pck)} {p.pck_rule} {threshold}, {SELECTED[select]}{brief}",
            definition=f"mean over poses of the share of {joints} with ‖x − y‖ {p.pck_rule} {threshold}{after}, "
            f"{SELECTED[select]}",
            statistic=Statistic(f"{prefix}pck", at),
            headline=not prefix,
            in_group_table=not prefix,
            needs=more if any(own_unit[:2]) else (*in_lengths, *more),
            range="0 to 1",
            reading="The share of joints that are right to the threshold, of the best hypothesis at it: rises with N.",
        )
        yield _SHARE(
            name=f"{prefix}auc",
            label=f"AUC of {label}PCK",
            brief=f"mean of PCK over {grid}{brief}",
            definition=f"mean over {grid} of PCK ({p.pck_rule}) over {joints}{after}, {SELECTED[select]} at each "
            "threshold",
            statistic=Statistic(f"{prefix}auc", over),
            headline=not prefix,
            needs=more if own_unit[0] or own_unit[2] else (*in_lengths, *more),
            range="0 to 1; below it where a first threshold of 0 is strict (30/31 of the thresholds 0, 5, … 150 mm)",
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
