"""Distances of clips, each a run of T poses: what errors, diversity and scores of whole motions are made of.

The distance of two poses is the norm over all their joints and coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked, period_of
from posecal.data.arrays import BoolArray, FloatArray, as_array, checked_root
from posecal.data.layout import HYPOTHESES, Layout
from posecal.engine.block import Block
from posecal.engine.metric import Statistic
from posecal.engine.offsets import relative_to_root
from posecal.engine.per_pose import refuse_non_finite_arrays
from posecal.engine.scope import Scope
from posecal.engine.true_clips import KEY, TrueClips
from posecal.errors import PoseDataError
from posecal.geometry.distances import half_mean_distances


def pose_distances(block: Block, body: BoolArray | None = None) -> FloatArray:
    """Norm over joints and coordinates of each hypothesis minus the truth, (T, N), mm; NaN where no joint counts."""

    def compute() -> FloatArray:
        counted = block.where if body is None else block.where & body
        squares = np.einsum("tk,tkn->tn", counted.astype(np.float64), block.squared_errors)
        return np.where(counted.any(axis=1, keepdims=True), np.sqrt(squares), np.nan)

    return block.share(("pose_distances", None if body is None else body.tobytes()), compute)


def is_whole(block: Block, distances: FloatArray, length: int) -> bool:
    """Whether all T frames are there, one after another, and each has a joint that counts."""
    return len(distances) == length and bool(block.follows[1:].all()) and not np.isnan(distances).any()


def at_last(value: float, block: Block) -> FloatArray:
    """Give a value of a whole clip at its last pose, and NaN at the others, (T,)."""
    found = np.full(len(block.truth), np.nan)
    found[-1] = value
    return found


def half_distance(block: Block, body: BoolArray | None) -> float:
    """Half the mean distance of two hypotheses of a clip."""

    def compute() -> float:
        counted = block.where if body is None else block.where & body
        points = (block.offsets * counted[..., None, None]).reshape(1, 1, -1, block.n_hypotheses)
        return float(half_mean_distances(points)[0, 0]) if block.n_hypotheses > 1 else 0.0

    return block.share(("half_distance", None if body is None else body.tobytes()), compute)


def clip_statistic(scope: Scope, name: str, compute: Callable[..., FloatArray], **more: Any) -> Statistic:
    """Give the statistic of clips that ``compute(block, body, length, …)`` gives."""
    return Statistic(name, partial(compute, body=scope.body, length=scope.spec.clip_length, **more), by_clip=True)


def of_clips(
    statistic: Callable[..., FloatArray],
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    clip: npt.ArrayLike | None,
    where: npt.ArrayLike | None,
    root: int | None,
    axes: str | None,
    unit: str | float | None,
    observed: FloatArray | None = None,
) -> FloatArray:
    """Compute a statistic of each clip, (C,): the mean over the frames that have a value."""
    if period_of(unit) is not None:
        raise PoseDataError(f"unit: {unit}; expected positions, not angles.")
    x, y, mask = checked(hypotheses, truth, where, axes=axes, unit=unit)
    root, counted = checked_root(root, y.shape[1]), np.ones(y.shape[:2], dtype=bool) if mask is None else mask
    refuse_non_finite_arrays(x, y, counted)
    length = Layout(axes, HYPOTHESES).clip_length(np.shape(hypotheses)) if axes else None
    labels = np.arange(len(y)) // (length or len(y)) if clip is None else as_array(clip, "clip")
    if labels.shape != (len(y),):
        raise PoseDataError(f"clip {labels.shape}: expected (M,) = ({len(y)},).")
    starts = np.concatenate([[0], np.flatnonzero(labels[1:] != labels[:-1]) + 1])
    if len(starts) > len(np.unique(labels)):
        raise PoseDataError("clip: one comes back after another; expected the poses of each clip one after another.")
    parts = [slice(start, stop) for start, stop in zip(starts, [*starts[1:], len(y)], strict=True)]
    clips = None if observed is None else _true_clips(y, observed, parts, root)
    body, values = np.ones(y.shape[1], dtype=bool), []
    for number, part in enumerate(parts):
        block = Block(x[:, part], y[part], counted[part], root=root)
        block.share(KEY, partial(tuple, (clips, str(number))))
        found = statistic(block, body, part.stop - part.start)
        known = found[~np.isnan(found)]
        values.append(known.mean() if known.size else np.nan)
    return np.array(values)


def _true_clips(y: FloatArray, observed: FloatArray, parts: list[slice], root: int | None) -> TrueClips:
    """Give true clips of one length and the poses before them, as arrays."""
    lengths = sorted({part.stop - part.start for part in parts})
    if len(lengths) > 1:
        raise PoseDataError(f"clip: {lengths[0]} to {lengths[-1]} frames; expected one length.")
    if observed.shape != (len(parts), *y.shape[1:]):
        expected = (len(parts), *y.shape[1:])
        alone = "" if len(parts) > 1 else " Without clip=, all poses are one clip."
        raise PoseDataError(f"observed {observed.shape}: expected a pose for each clip, (C, K, D) = {expected}.{alone}")
    poses, before = (relative_to_root(some, root, np.dtype(np.float64)) for some in (y, observed))
    number = {str(n): n for n in range(len(parts))}
    return TrueClips(number, poses.reshape(len(parts), lengths[0], *y.shape[1:]), before, frozenset(number))
