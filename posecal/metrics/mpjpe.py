"""The MPJPE family: distances of the hypotheses from the truth, and the metrics that are made of them.

The error of a hypothesis is the mean over a pose's joints of the distance to the truth, in the unit of the arrays. Ways
from N hypotheses to one number per pose differ by tens of millimetres, and each has a name of its own:

- of the N errors: the smallest (``min``, the field's minMPJPE), their ``mean``, ``median`` or the largest (``worst``);
- the error of one pose made of the hypotheses; see :mod:`posecal.metrics.position`.

Functions of arrays take positions as they stand; ``root`` subtracts one joint, which counts unless ``where`` lacks it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Literal, cast, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked
from posecal.data.arrays import BoolArray, FloatArray, checked_choice, checked_index
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE
from posecal.engine.finish import entry, per_joint
from posecal.engine.metric import Metric, Need, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.scope import Scope
from posecal.engine.weighted import weighted_median
from posecal.errors import PoseDataError
from posecal.geometry.procrustes import ALIGNMENTS, Alignment
from posecal.metrics.position import OF_POSES, OfPoses, joint_errors, linked, pose_errors, sorted_errors

OfErrors = Literal["min", "mean", "median", "worst"]
OF_ERRORS: tuple[OfErrors, ...] = get_args(OfErrors)


def reduce_errors(errors: FloatArray, of: OfErrors = "min", weights: FloatArray | None = None) -> FloatArray:
    """Reduce the N errors of each pose, (..., N), to one, (...), mm; mean and median by weights (..., N)."""
    if of == "median":
        return np.asarray(np.median(errors, axis=-1) if weights is None else weighted_median(errors, weights))
    if of == "mean":
        return np.asarray(errors.mean(axis=-1) if weights is None else (errors * weights).sum(axis=-1))
    return np.asarray(errors.min(axis=-1) if of == "min" else errors.max(axis=-1))


def mpjpe(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    of: OfErrors | OfPoses = "mean",
    align: Alignment = "none",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    mode: int = 0,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Mean per-joint position error of each pose.

    .. math:: e_{nm} = \frac{1}{K} \sum_k \lVert x_{nmk} - y_{mk} \rVert_2

    and of the N errors of a pose their mean, or what ``of`` names.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    truth : array (M, K, D)
        True poses, mm.
    of : str
        ``mean``, ``min``, ``median`` or ``worst`` of the N errors; or the error of one pose made of the
        hypotheses: ``mean_pose``, ``median_pose`` or ``mode`` (that of index ``mode``). Means and medians by weight.
    align : str
        ``none``, ``similarity`` (PA-MPJPE), ``rigid``, ``reflection``, ``scale`` (N-MPJPE), ``norm_root`` or
        ``rms_mean``; see :mod:`posecal.geometry.procrustes`.
    where : bool array (M, K) or (M,), optional
        The joints that count: those that the mean is over and, too, those that the alignment is fitted to.
    root : int, optional
        The joint to subtract from every pose first.
    mode : int
        The index that ``of="mode"`` takes.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 where absent; (M, N) where ``axes`` has M first.
    axes, unit : str, optional
        Such as ``MNKD`` and ``m``, where the hypotheses are not (N, M, K, D), or both not in mm, or it is not clear.
        Angles, ``deg`` or ``rad``, are measured the shorter way round, in degrees.

    Returns
    -------
    array (M,)
        Errors, mm; lower is better, 0 at best; NaN for a pose without a joint that counts, or with too few to align.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    ``of="median"`` of an even N lies between the two middle errors. Differs from the published code: that of ProHPE
    takes the lower one; none for the default.

    See Also
    --------
    min_mpjpe : Error of the best hypothesis.
    posecal.metrics.pck : Share of joints whose error is below a threshold.
    posecal.metrics.mpjve : Error of the steps between frames.

    References
    ----------
    Wang et al., arXiv:2104.11536 (MPJPE and its protocols).

    Examples
    --------
    Two hypotheses of one pose with two joints; the first is a 3-4-5 triangle off at one joint.

    >>> import numpy as np
    >>> truth, hypotheses = np.zeros((1, 2, 3)), np.zeros((2, 1, 2, 3))
    >>> hypotheses[0, 0, 0] = 3, 4, 0
    >>> mpjpe(hypotheses, truth)
    array([1.25])
    >>> mpjpe(hypotheses, truth, of="worst")
    array([2.5])
    """
    checked_choice(align, "align", ALIGNMENTS)
    checked_choice(of, "of", [*OF_ERRORS, *(name for name in OF_POSES if name != "weighted_pose")])
    index: int | None = None
    if of == "mode":
        if weights is not None:
            raise PoseDataError("weights: a hypothesis by its number has none; expected another of than mode.")
        index = checked_index(mode, "mode", len(checked(hypotheses, truth, axes=axes, unit=unit)[0]), "hypotheses")

    def statistic(block: Block) -> FloatArray:
        if of in OF_ERRORS:
            return reduce_errors(pose_errors(block, align), of, block.weights)
        return pose_errors(block, align, cast(OfPoses, of), mode=index)[:, 0]

    return per_pose(statistic, hypotheses, truth, where, root=root, weights=weights, axes=axes, unit=unit)


def min_mpjpe(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    align: Alignment = "none",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Error of the best of the N hypotheses of each pose: minMPJPE.

    .. math:: \min_n \frac{1}{K} \sum_k \lVert x_{nmk} - y_{mk} \rVert_2

    Parameters
    ----------
    hypotheses, truth, align, where, root, weights, axes, unit
        As for :func:`mpjpe`.

    Returns
    -------
    array (M,)
        Errors, mm; lower is better, 0 at best; NaN for a pose without a joint that counts, or with too few to align.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    It falls with N whatever the model (see :func:`posecal.metrics.min_mpjpe_curve`), and the distribution that
    minimises it is not the true one. Differs from the published code: none.

    See Also
    --------
    mpjpe : Mean, median or largest of the N errors, or the error of one pose made of the hypotheses.
    posecal.metrics.min_mpjpe_curve : Expected minMPJPE with fewer hypotheses.
    posecal.metrics.energy_score : A proper score, which rewards the true spread.

    References
    ----------
    Jahangiri and Yuille, arXiv:1702.02258; Pierzchlewicz et al., arXiv:2210.11179.

    Examples
    --------
    >>> import numpy as np
    >>> hypotheses = np.zeros((2, 1, 1, 3))
    >>> hypotheses[:, 0, 0] = [[3, 4, 0], [0, 0, 2]]
    >>> min_mpjpe(hypotheses, np.zeros((1, 1, 3)))
    array([2.])
    """
    of_arrays = partial(mpjpe, hypotheses, truth, of="min", align=align, where=where, root=root)
    return of_arrays(weights=weights, axes=axes, unit=unit)


# --- metrics --------------------------------------------------------------------------------------------------

ERROR = partial(
    Metric,
    unit="mm",
    direction="lower",
    family="accuracy",
    range="0 mm (every joint right) upwards",
    bounds=POSITIVE,
    reading="The mean error of all hypotheses of a good model is larger than that of its mean pose: it pays for the "
    "spread that the image leaves open. Alone it rewards hypotheses that all agree.",
    source="Ionescu et al., TPAMI 2014 (protocol); Wang et al., arXiv:2104.11536",
)
BEST_ERROR = partial(
    ERROR,
    range="0 mm (the truth is among the hypotheses) upwards",
    reading="Falls with N for any model, so numbers at different N share no column; min_mpjpe_at_n compares at the "
    "same n. It rewards a wrong spread: the best for 200 hypotheses in 45 dimensions is 2.5 times too narrow. Read it "
    "beside a calibration error.",
    source="Jahangiri and Yuille, arXiv:1702.02258; Pierzchlewicz et al., arXiv:2210.11179",
)

_ALIGNED: dict[Alignment, str] = {
    "none": "",
    "similarity": " after Procrustes alignment (scale, rotation, translation)",
    "rigid": " after rigid alignment (rotation, translation)",
    "reflection": " after Procrustes alignment with reflections allowed",
    "scale": " after least-squares scaling about the root",
    "norm_root": " after scaling to the true norm about the root",
    "rms_mean": " after centring and scaling to the true root mean square",
}


def error_words(scope: Scope, align: Alignment = "none") -> str:
    """Describe the error of a hypothesis."""
    return f"mean over {scope.counted(scope.body)} of ‖x − y‖{aligned_words(scope, align, scope.body)}"


def aligned_words(scope: Scope, align: Alignment, scored: BoolArray) -> str:
    """Describe an alignment, and to which joints it is fitted where that is not those that are scored."""
    fitted_to_scored = scope.protocol.where == "all" and np.array_equal(scored, scope.fit)
    return _ALIGNED[align] + ("" if align == "none" or fitted_to_scored else f", fitted to {scope.size(scope.fit)}")


_NEEDS: dict[str, tuple[Need, ...]] = {"": (), "pa_": ("positions", "three axes"), "n_": ("positions",)}


def mpjpe_metrics(scope: Scope) -> Iterator[Metric]:
    """The MPJPE family, as it stands, aligned (``pa_``) and scaled (``n_``)."""
    variants: tuple[tuple[str, Alignment], ...]
    variants = ("", "none"), ("pa_", scope.protocol.align), ("n_", scope.protocol.scale)
    for prefix, align in variants:
        for metric in (*_of_hypotheses(scope, prefix, align), *_of_one_pose(scope, prefix, align)):
            yield replace(metric, needs=(*metric.needs, *_NEEDS[prefix]))


def _label(prefix: str, label: str) -> str:
    return prefix.upper().replace("_", "-") + label


def _of_hypotheses(scope: Scope, prefix: str, align: Alignment) -> Iterator[Metric]:
    """Of the N errors of a pose: the smallest, the mean, the median and the largest."""
    n, body, fit = scope.spec.n_hypotheses, scope.body, scope.fit
    linking = prefix == "pa_" and scope.protocol.align_best == "linked"

    def of_poses(block: Block) -> FloatArray:
        errors, ordered = pose_errors(block, align, body=body, fit=fit), sorted_errors(block, align, body, fit)
        least = linked(block, errors, body) if linking else ordered[:, 0]
        there = errors.shape[-1]  # of these poses; N is the most of all
        middle = (ordered[:, (there - 1) // 2] + ordered[:, there // 2]) / 2
        median = middle if block.weights is None else weighted_median(errors, block.weights)
        reduced = (least, block.mean_of_each(errors), median, ordered[:, -1])
        return np.stack(reduced, axis=1, dtype=np.float64)

    def of_joints(block: Block) -> FloatArray:
        errors = joint_errors(block, align, fit=fit)
        best = pose_errors(block, align, body=body, fit=fit).argmin(axis=-1)[:, None, None]
        least = np.take_along_axis(errors, best, axis=-1)[..., 0]
        mean = np.einsum("bkn->bk", errors) / errors.shape[-1] if block.weights is None else block.mean_of_each(errors)
        values = np.stack([least, mean], axis=-1, dtype=np.float64)
        return np.where((block.where & body)[..., None], values, np.nan)

    statistic, joints = Statistic(f"{prefix}errors", of_poses), Statistic(f"{prefix}joint_errors", of_joints, True)
    brief, words = f"best of N={n} per frame", f"smallest of the N={n} errors"
    if linking:
        brief, words = f"best of N={n} after aligning minMPJPE's", f"error of minMPJPE's of the N={n} hypotheses"
    for index, (name, label, short, long) in enumerate(
        (
            ("min_mpjpe", "minMPJPE", brief, words),
            ("mpjpe", "MPJPE", f"mean of N={n}", f"mean of the N={n} errors"),
            ("median_mpjpe", "MPJPE (median of N)", f"median of N={n}", f"median of the N={n} errors"),
            ("worst_mpjpe", "MPJPE (worst of N)", f"worst of N={n}", f"largest of the N={n} errors"),
        )
    ):
        headline, by_joint = prefix + name in {"min_mpjpe", "mpjpe", "pa_min_mpjpe"}, index < 2 and not prefix
        metric = (ERROR if index else BEST_ERROR)(
            name=prefix + name,
            label=_label(prefix, label),
            brief=f"{short}, {scope.number(body)}",
            definition=f"mean over poses of the {long}; error: {error_words(scope, align)}",
            statistic=statistic,
            finish=entry(index),
            by_joint=(joints, per_joint(index)) if by_joint else None,
            headline=headline,
            in_group_table=headline,
            in_joint_table=by_joint,
        )
        yield metric if index else _best_per(scope, metric, align, prefix)


def _best_per(scope: Scope, metric: Metric, align: Alignment, prefix: str) -> Metric:
    """Turn the minimum of each pose into the minimum that the option ``best`` asks for."""
    kind, _, number = scope.protocol.best.partition(":")
    n, body, fit, error = scope.spec.n_hypotheses, scope.body, scope.fit, error_words(scope, align)
    if kind == "frame":
        return metric
    if kind == "joint":

        def of_poses(block: Block) -> FloatArray:
            weights = block.joint_weights(body)
            errors = (weights * joint_errors(block, align, fit=fit).min(axis=-1)).sum(axis=1, dtype=np.float64)
            return np.where(weights.any(axis=1), errors, np.nan)

        def of_joints(block: Block) -> FloatArray:
            return np.where(block.where & body, joint_errors(block, align, fit=fit).min(axis=-1), np.nan)

        joints = Statistic(f"{prefix}joint_errors_of_best_joints", of_joints, True)
        return replace(
            metric,
            statistic=Statistic(f"{prefix}errors_of_best_joints", of_poses),
            finish=entry(),
            by_joint=None if metric.by_joint is None else (joints, np.asarray),
            brief=f"best of N={n} at each joint, {scope.number(body)}",
            definition=f"mean over poses of the {error}, of the best of N={n} hypotheses at each joint",
        )
    if "sequence" not in scope.spec.labels:
        raise PoseDataError(f"best: {scope.protocol.best} needs sequences. Store a label sequence in the truth's file.")
    span = "sequence" if kind == "sequence" else f"batch of {number} sequences"
    return replace(
        metric,
        statistic=Statistic(f"{prefix}errors_of_n", partial(pose_errors, align=align, body=body, fit=fit)),
        finish=partial(np.min, axis=-1),
        by_joint=None,
        in_joint_table=False,
        sequences_per_batch=int(number or 1),
        brief=f"best of N={n} per {span}, {scope.number(body)}",
        definition=f"mean over poses, one of the N={n} hypotheses chosen per {span}; error: {error}",
    )


def _of_one_pose(scope: Scope, prefix: str, align: Alignment) -> Iterator[Metric]:
    """Of one pose made of the hypotheses."""
    mode, n = scope.protocol.mode, scope.spec.n_hypotheses
    index = None if mode == "score" else int(mode)
    if index is not None and index >= n:
        raise PoseDataError(f"mode: {mode}; expected score or the index of one of {n} hypotheses.")
    poses: dict[OfPoses, str] = {
        "mean_pose": "mean of the hypotheses",
        "median_pose": "per-coordinate median of the hypotheses",
    }
    if scope.spec.has_scores:
        poses["weighted_pose"] = "mean of the hypotheses weighted by their scores"
    if scope.spec.has_scores or index is not None:
        poses["mode"] = "hypothesis of the highest score" if index is None else f"hypothesis of index {mode}"
    for of, words in poses.items():
        yield ERROR(
            name=f"{prefix}{of}_mpjpe",
            label=f"{of.replace('_', '-')} {_label(prefix, 'MPJPE')}",
            brief=f"of the {words}",
            definition=f"mean over poses of the error of the {words}; error: {error_words(scope, align)}",
            statistic=Statistic(
                f"{prefix}{of}_error",
                partial(pose_errors, align=align, of=of, body=scope.body, mode=index, fit=scope.fit),
            ),
            finish=entry(0),
            headline=not prefix and of == "mean_pose",
            needs=("alike hypotheses",) if of == "mode" else (),
        )
