"""Poses whose hypotheses have weights: unequal ones, or 0 where a hypothesis is absent, which NaN stand for as well.

A block of such poses is laid out as several, one for each number of hypotheses that are there, apart for equal and
unequal weights, and what is computed of those is put together in the order of the poses. So everything that is defined
for any N is right; metrics that need as many hypotheses of every pose are left out of the report.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.pose_data import PoseData
from posecal.data.remarks import Count, Remark
from posecal.data.stored_poses import sample_rows
from posecal.data.weights import OF_WEIGHTS
from posecal.engine.block import Block
from posecal.engine.chunks import Chunk, Indices, read_chunks
from posecal.engine.coordinate_range import CoordinateRange
from posecal.engine.metric import Statistic
from posecal.engine.scope import DataSpec
from posecal.engine.weighted import alike
from posecal.errors import PoseDataError, first_few

_SAMPLE = 64
"""How many poses are looked at for hypotheses that are absent."""


def present(hypotheses: FloatArray, scores: FloatArray | None, weights: FloatArray | None = None) -> BoolArray:
    """Find the hypotheses (N, m, K, D) that are there, (N, m).

    Absent are those of weight 0. Without weights, absent are those that are NaN in every coordinate, and those of
    score 0 where the scores of a pose are weights, of a sum of 1, or where the hypothesis is one point.
    """
    if weights is not None:
        return np.asarray(weights > 0)
    there: BoolArray = np.asarray(~np.isnan(hypotheses).all(axis=(2, 3)))
    if scores is None or (scores < 0).any():
        return there
    sum_to_one = np.abs(scores.sum(axis=0) - 1) < OF_WEIGHTS
    is_point = (hypotheses == hypotheses[:, :, :1]).all(axis=(2, 3))
    return np.asarray(there & ((scores > 0) | ~(sum_to_one | is_point)))


def with_weights(chunk: Chunk, spec: DataSpec) -> Chunk:
    """Give the poses of a chunk weights, equal ones where they have none, if those of others of them differ."""
    if chunk.weights is not None or not (spec.is_ragged or spec.has_weights):
        return chunk
    there = present(chunk.hypotheses, chunk.scores)
    return replace(chunk, weights=there / there.sum(axis=0))


def has_absent(data: PoseData) -> bool:
    """Whether some hypotheses of a pose are absent and others not, by their weights, or among poses that lie evenly."""
    if data.weights is not None:
        return not data.weights.all()
    rows, scores = sample_rows(len(data.truth), _SAMPLE), data.scores
    if scores is not None and (scores >= 0).all() and (scores == 0).any():
        if (scores > 0).sum(axis=0).max() == 1:
            return False  # one score above 0 for each pose marks a hypothesis, and is no weight
        lacking = np.flatnonzero((scores == 0).any(axis=0))
        rows = np.union1d(rows, lacking[:: max(1, len(lacking) // _SAMPLE)])
    return _some_absent(data.hypotheses.select(rows).read(0, len(rows)), None if scores is None else scores[:, rows])


def has_absent_anywhere(data: PoseData) -> bool:
    """Whether NaN stand for some hypotheses of any pose, where no weights say so."""
    chunks = read_chunks(data.replace(reference=None)) if data.weights is None else ()
    return any(_some_absent(chunk.hypotheses, None) for chunk in chunks)


def _some_absent(hypotheses: FloatArray, scores: FloatArray | None) -> bool:
    if scores is None and not np.isnan(hypotheses[:, :, 0, 0]).any():
        return False
    there = present(hypotheses, scores)
    return bool((there.any(axis=0) & ~there.all(axis=0)).any())


def n_present(data: PoseData) -> Indices:
    """Count the hypotheses of every pose that are there, (M,)."""
    chunks = read_chunks(data.replace(reference=None))
    return np.concatenate([present(chunk.hypotheses, chunk.scores, chunk.weights).sum(axis=0) for chunk in chunks])


def live_remark(data: PoseData) -> str:
    """Say how many hypotheses are absent.

    Raises
    ------
    PoseDataError
        Where a pose has none, with the number of such poses and the first.
    """
    live, (n, m, *_) = n_present(data), data.shape
    if not live.all():
        frames = data.frame_id[live == 0].tolist()
        raise PoseDataError(
            f"{data.names[0]}: {len(frames):,} of {m:,} frames have no hypothesis (first: {first_few(frames)}); "
            "expected at least one. Leave these frames out."
        )
    return Remark(
        f"{data.names[0]}: ",
        Count(int(n * m - live.sum()), "hypothesis is absent", "hypotheses are absent"),
        f" (NaN, or of weight 0); a pose has up to N = {n}.",
    )


class RaggedBlock:
    """B poses as blocks of as many hypotheses each, with the rows in which their poses stand.

    Parameters
    ----------
    parts : list of pairs of array of int and Block
        Rows and block, of each number of hypotheses.
    n_poses : int
        B.
    """

    def __init__(self, parts: list[tuple[Indices, Block]], n_poses: int) -> None:
        self.parts, self.n_poses = parts, n_poses

    @property
    def reference(self) -> RaggedBlock | None:
        """The same poses with the hypotheses that skills are relative to; None without any."""
        parts = [(rows, block.reference) for rows, block in self.parts if block.reference is not None]
        return RaggedBlock(parts, self.n_poses) if parts else None

    @property
    def where(self) -> BoolArray:
        """The joints that count, (B, K)."""
        return self._together([block.where for _, block in self.parts])

    @property
    def non_finite(self) -> BoolArray:
        """The poses and joints, (B, K), at which a coordinate that counts is not finite."""
        return self._together([block.non_finite for _, block in self.parts])

    def measure(self, statistic: Statistic) -> FloatArray:
        """Compute a statistic of every pose, (B, …)."""
        return self._together([np.asarray(statistic.compute(block), dtype=np.float64) for _, block in self.parts])

    def _together(self, values: list[np.ndarray]) -> np.ndarray:
        found = np.empty((self.n_poses, *values[0].shape[1:]), dtype=values[0].dtype)
        for (rows, _), some in zip(self.parts, values, strict=True):
            found[rows] = some
        return found


def lay_out_ragged(chunk: Chunk, spec: DataSpec, limits: CoordinateRange | None) -> RaggedBlock:
    """Lay out poses of a chunk as a block for each number of hypotheses, and apart those of unequal weights."""
    assert chunk.weights is not None
    parts = []
    for rows, kept, weights in alike(chunk.weights):
        some, poses = chunk.select(rows), np.arange(len(rows))
        block = Block(
            some.hypotheses[kept, poses],
            some.truth,
            some.where,
            root=spec.root,
            scores=None if some.scores is None else some.scores[kept, poses],
            log_prob=some.log_prob,
            weights=weights,
            occluded=some.occluded,
            usable=some.usable,
            reference=some.reference,
            limits=None if limits is None else lambda: limits,
            sequence=some.sequence,
            period=spec.period,
        )
        parts.append((rows, block))
    return RaggedBlock(parts, len(chunk))


def lay_out(
    chunk: Chunk, start: int, stop: int, spec: DataSpec, limits: CoordinateRange | None, before: Chunk | None
) -> Callable[[], Block | RaggedBlock]:
    """Lay out some poses of a chunk as a block, when called; ``before`` holds the poses right before the first."""
    if spec.is_ragged or spec.has_weights:
        return partial(lay_out_ragged, chunk.select(slice(start, stop)), spec, limits)
    return chunk.block(start, stop, spec.root, limits, before, spec.period)


def measure(block: Block | RaggedBlock, statistic: Statistic) -> FloatArray:
    """Compute a statistic of every pose of a block, (B, …), once: skills ask again."""
    if isinstance(block, RaggedBlock):
        return block.measure(statistic)
    return block.share(("statistic", statistic.name), partial(statistic.compute, block))
