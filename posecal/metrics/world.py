"""Errors in the world frame: trajectories aligned once per sequence, WA-MPJPE and W-MPJPE."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked, period_of
from posecal.data.arrays import BoolArray, FloatArray, as_array, checked_choice, checked_number
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE
from posecal.engine.metric import Metric, Statistic
from posecal.engine.per_pose import refuse_non_finite_arrays
from posecal.engine.scope import Scope
from posecal.errors import PoseDataError
from posecal.geometry.procrustes import aligned_errors

WorldAlignment = Literal["whole", "first_two"]
OverHypotheses = Literal["mean", "min"]


def world_mpjpe(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    sequence: npt.ArrayLike | None = None,
    align: WorldAlignment = "whole",
    segment: int | None = 100,
    of: OverHypotheses = "mean",
    where: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Error of each pose in the world frame, after one alignment of its whole trajectory: WA-MPJPE, W-MPJPE.

    .. math:: \frac{1}{K} \sum_k \lVert s_n R_n x_{nmk} + t_n - y_{mk} \rVert_2

    with one scale, rotation and translation for all frames of a segment and hypothesis n, by least squares.

    Parameters
    ----------
    hypotheses : array (N, M, K, 3)
        Hypotheses as they stand in the world, mm; hypothesis n is followed through the sequence. No root is subtracted.
    truth : array (M, K, 3)
        True poses in the world, mm, in the order of time.
    sequence : array (M,), optional
        The sequence of each pose; all are one sequence by default.
    align : str
        To which frames the alignment is fitted: the ``whole`` segment (WA-MPJPE), or its ``first_two`` frames
        (W-MPJPE), so that drift counts.
    segment : int, optional
        The number of frames that are aligned together, from the first of each sequence; None for whole sequences. The
        last segment has the frames that are left.
    of : str
        ``mean`` over the hypotheses, or ``min``: of each sequence the hypothesis whose mean error over it is smallest.
    where : bool array (M, K) or (M,), optional
        The joints that count, in the fit and in the mean.
    axes, unit : str, optional
        Such as ``MNKD`` and ``m``, where the hypotheses are not (N, M, K, D), or both not in mm, or it is not clear.

    Returns
    -------
    array (M,)
        Errors, mm; lower is better, 0 at best; NaN for a pose without a joint that counts, and for a segment with
        fewer than three joints to align.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit, and for coordinates that are not finite.

    Notes
    -----
    Differs from the published code: its scripts take one hypothesis.

    See Also
    --------
    posecal.metrics.mpjpe : Each pose aligned by itself.

    References
    ----------
    Ye et al., arXiv:2302.12827 (SLAHMR); Shin et al., arXiv:2312.07531 (WHAM).

    Examples
    --------
    A trajectory that is turned and twice as large is right after alignment.

    >>> import numpy as np
    >>> truth = np.random.default_rng(0).normal(0, 300, (5, 4, 3))
    >>> hypotheses = 2 * truth[None, ..., [1, 2, 0]] + 70
    >>> (world_mpjpe(hypotheses, truth) < 1e-6).all()
    np.True_
    """
    checked_choice(align, "align", get_args(WorldAlignment))
    checked_choice(of, "of", get_args(OverHypotheses))
    if period_of(unit) is not None:
        raise PoseDataError(f"unit: {unit}; expected positions, not angles, to align.")
    x, y, mask = checked(hypotheses, truth, where, axes=axes, unit=unit)
    most = len(y)
    if segment is not None:
        frames = "a whole number of frames, at least 2"
        most = int(checked_number(segment, "segment", lambda n: n >= 2 and n.is_integer(), frames))
    labels = np.zeros(len(y)) if sequence is None else as_array(sequence, "sequence")
    if labels.shape != (len(y),):
        raise PoseDataError(f"sequence {labels.shape}: expected (M,) = ({len(y)},).")
    counted = np.ones(y.shape[:2], dtype=bool) if mask is None else mask
    refuse_non_finite_arrays(x, y, counted)
    found = np.full(len(y), np.nan)
    for label in np.unique(labels):
        poses = np.flatnonzero(labels == label)
        parts = [poses[start : start + most] for start in range(0, len(poses), most)]
        errors = np.concatenate(
            [
                _segment_errors((x[:, m] - y[m]).transpose(1, 2, 3, 0), y[m], counted[m], counted[m], align)
                for m in parts
            ]
        )
        known = counted[poses].any(axis=1)
        best = int(np.argmin(np.nansum(errors[known], axis=0)))
        found[poses] = np.where(known, errors[:, best] if of == "min" else errors.mean(axis=1), np.nan)
    return found


def _segment_errors(
    offsets: FloatArray, truth: FloatArray, counted: BoolArray, fitted: BoolArray, align: WorldAlignment
) -> FloatArray:
    """Mean error over the joints that count of each pose and hypothesis, (T, N), of a segment aligned like one pose."""
    t, k, d, n = offsets.shape
    known = counted | fitted
    y = np.where(known[..., None], truth, 0).astype(np.float64).reshape(1, t * k, d)
    x = np.where(known[..., None, None], offsets, 0).astype(np.float64).reshape(1, t * k, d, n)
    if align == "first_two":
        fitted = fitted.copy()
        fitted[np.flatnonzero(fitted.any(axis=1))[2:]] = False
    weights = fitted.reshape(1, -1) / max(fitted.sum(), 1)
    errors = aligned_errors(x, y, weights, "similarity").reshape(t, k, n)
    sums: FloatArray = np.einsum("tk,tkn->tn", counted.astype(np.float64), errors)
    return np.asarray(sums / np.maximum(counted.sum(axis=1), 1)[:, None])


# --- metrics --------------------------------------------------------------------------------------------------


def world_errors(block: Block, align: WorldAlignment, body: BoolArray, fit: BoolArray) -> FloatArray:
    """Error of each pose and hypothesis after one alignment of all poses of a block, (B, N), mm; NaN as elsewhere."""
    whole, counted = block.fit_block, block.where & body
    errors = _segment_errors(whole.offsets, whole.truth, counted, whole.where & fit, align)
    return np.where(counted.any(axis=1, keepdims=True), errors, np.nan)


def world_metrics(scope: Scope) -> Iterator[Metric]:
    """WA- and W-MPJPE, of the mean over hypotheses and of the best for each sequence, of positions in the world."""
    if "sequence" not in scope.spec.labels or scope.spec.root is not None:
        return
    n, frames = scope.spec.n_hypotheses, scope.protocol.segment
    segment = "sequence" if frames == "sequence" else f"segment of {frames} frames of a sequence"
    kinds: tuple[tuple[str, WorldAlignment, str, str], ...] = (
        ("wa", "whole", "", "Ye et al., arXiv:2302.12827 (SLAHMR)"),
        ("w", "first_two", ", fitted to its first two frames", "Shin et al., arXiv:2312.07531 (WHAM)"),
    )
    for name, align, fitted, source in kinds:
        make = partial(
            Metric,
            unit="mm",
            direction="lower",
            family="accuracy",
            statistic=Statistic(
                f"{name}_errors",
                partial(world_errors, align=align, body=scope.body, fit=scope.fit),
                by_segment=True,
            ),
            needs=("positions", "three axes"),
            range="0 at best",
            bounds=POSITIVE,
            reading="The error of a trajectory in the world: WA-MPJPE of its shape, W-MPJPE also of its drift.",
            source=source,
        )
        error = f"mean over {scope.counted(scope.body)} of ‖x − y‖ after one similarity for each {segment}{fitted}"
        yield make(
            name=f"{name}_mpjpe",
            label=f"{name.upper()}-MPJPE",
            brief=f"mean of N={n}, {scope.number(scope.body)}",
            definition=f"mean over poses of the mean of the N={n} errors; error: {error}",
            finish=partial(np.mean, axis=-1),
        )
        yield make(
            name=f"min_{name}_mpjpe",
            label=f"{name.upper()}-minMPJPE",
            brief=f"best of N={n} per sequence, {scope.number(scope.body)}",
            definition=f"mean over poses, one of the N={n} hypotheses chosen per sequence; error: {error}",
            finish=partial(np.min, axis=-1),
            sequences_per_batch=1,
        )
