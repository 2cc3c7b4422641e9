"""Chunks of poses in memory, read from pose data some at a time and laid out as blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.pose_data import PoseData
from posecal.data.root import AnyRoot
from posecal.data.units import PERIODS
from posecal.engine.block import Block, block_length
from posecal.engine.coordinate_range import CoordinateRange
from posecal.engine.pose_hashes import PoseHashes
from posecal.engine.threads import run_in_order

WINDOW_BYTES = 32 * 1024 * 1024
"""How much of the hypotheses is read at a time."""

Indices = npt.NDArray[np.intp]
Result = TypeVar("Result")


@dataclass(frozen=True)
class Chunk:
    """Consecutive poses in memory: (N, m, K, D) or (N, m) hypotheses, scores and weights, (m, …) all else.

    ``sequence`` are numbers in the coordinate range, ``sequence_name`` names, empty where poses have no sequences.
    """

    hypotheses: FloatArray
    truth: FloatArray
    follows: BoolArray
    cells: Indices
    sequence: Indices
    hashes: PoseHashes
    where: BoolArray | None
    usable: BoolArray | None
    occluded: BoolArray | None
    scores: FloatArray | None
    reference: FloatArray | None
    sequence_name: npt.NDArray[np.str_]
    frame_id: npt.NDArray[np.str_]
    order: Indices
    log_prob: FloatArray | None = None
    weights: FloatArray | None = None
    clip: npt.NDArray[np.str_] | None = None

    def __len__(self) -> int:
        return len(self.truth)

    def select(self, poses: slice | Indices) -> Chunk:
        """Keep some poses, by a range or by their numbers."""
        parts: dict[str, Any] = {
            name: values if values is None else values[:, poses] if name in _HYPOTHESES else values[poses]
            for name, values in vars(self).items()
        }
        return Chunk(**parts)

    def copy(self) -> Chunk:
        """Copy the poses into memory of their own: who gave them may write over theirs."""
        return join_chunks([self])

    def block(
        self,
        start: int,
        stop: int,
        root: AnyRoot,
        limits: CoordinateRange | None = None,
        before: Chunk | None = None,
        period: float | None = None,
    ) -> Callable[[], Block]:
        """Lay out some poses as a block, when called; ``before`` holds the poses right before the first."""
        part = self.select(slice(start, stop))
        return partial(
            Block,
            part.hypotheses,
            part.truth,
            part.where,
            root=root,
            previous=None if before is None else before.block(0, len(before), root, period=period),
            follows=part.follows,
            scores=part.scores,
            log_prob=part.log_prob,
            occluded=part.occluded,
            usable=part.usable,
            reference=part.reference,
            limits=None if limits is None else lambda: limits,
            sequence=part.sequence,
            period=period,
        )


_HYPOTHESES = ("hypotheses", "scores", "weights", "reference")
"""The members whose second axis is poses."""


def join_chunks(chunks: Sequence[Chunk]) -> Chunk:
    """Put chunks one after another, in memory of its own, laid out alike: rounding depends on it."""
    joined: dict[str, Any] = dict.fromkeys(vars(chunks[0]))
    for name in joined:
        parts = [getattr(chunk, name) for chunk in chunks]
        if parts[0] is not None:
            axis, shape = int(name in _HYPOTHESES), list(parts[0].shape)
            shape[axis] = sum(part.shape[axis] for part in parts)
            joined[name] = np.concatenate(parts, axis, out=np.empty(shape, np.result_type(*parts)))
    return Chunk(**joined)


def read_chunks(data: PoseData, multiple: int = 1) -> Iterator[Chunk]:
    """Read poses some at a time; each chunk but the last has a multiple of so many."""
    _, m, k, d = data.shape
    sources = [data.hypotheses, *([] if data.reference is None else [data.reference.hypotheses])]
    window = WINDOW_BYTES // (k * d * max(source.n_hypotheses * source.itemsize for source in sources))
    window = max(1, window // multiple) * multiple
    sequence = data.labels.get("sequence", np.zeros(m, dtype=np.str_))
    follows = np.concatenate([[False], (sequence[1:] == sequence[:-1]) & (np.diff(data.order) == 1)])
    if (clip := data.labels.get("clip")) is not None:
        follows[1:] &= clip[1:] == clip[:-1]
    nothing, no_hashes = np.zeros(m, dtype=np.intp), np.zeros((m, 2), dtype=np.uint64)
    others: dict[str, npt.NDArray[Any] | None] = {
        "truth": data.truth,
        "where": data.where,
        "usable": data.usable,
        "occluded": data.occluded,
    }
    others |= {"log_prob": data.log_prob, "clip": clip}
    # laid out alike, whoever made them, because rounding depends on it
    rows = {name: values if values is None else np.ascontiguousarray(values) for name, values in others.items()}
    for start in range(0, m, window):
        stop = min(start + window, m)
        part: dict[str, Any] = {name: None if values is None else values[start:stop] for name, values in rows.items()}
        yield Chunk(
            hypotheses=data.hypotheses.read(start, stop),
            follows=follows[start:stop],
            cells=nothing[start:stop],
            sequence=nothing[start:stop],
            hashes=no_hashes[start:stop],
            scores=None if data.scores is None else data.scores[:, start:stop],
            weights=None if data.weights is None else data.weights[:, start:stop],
            reference=None if data.reference is None else data.reference.hypotheses.read(start, stop),
            sequence_name=sequence[start:stop],
            frame_id=data.frame_id[start:stop],
            order=data.order[start:stop],
            **part,
        )


def map_blocks(data: PoseData, compute: Callable[[Block], Result], threads: int | None = None) -> Iterator[Result]:
    """Compute something of every block, in the order of the poses.

    Parameters
    ----------
    data : PoseData
        M poses.
    compute : callable
        Applied to each block, on threads.
    threads : int, optional
        One per core by default.

    Yields
    ------
    object
        What it gives for each block.
    """
    length = block_length(data.shape, data.hypotheses.read(0, 1).dtype)
    tasks = (
        partial(_apply, compute, chunk.block(start, start + length, data.root, period=PERIODS.get(data.unit)))
        for chunk in read_chunks(data.replace(reference=None), length)
        for start in range(0, len(chunk), length)
    )
    yield from run_in_order(tasks, threads)


def _apply(compute: Callable[[Block], Result], lay_out: Callable[[], Block]) -> Result:
    return compute(lay_out())
