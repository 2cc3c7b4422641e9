"""Segments and clips: consecutive poses that are measured together, whatever the blocks they come in."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.engine.block import Block
from posecal.engine.chunks import Chunk, join_chunks
from posecal.engine.measure import Measured, measure_segment
from posecal.engine.metric import Statistic
from posecal.engine.scope import DataSpec
from posecal.engine.sums import Indices
from posecal.engine.true_clips import KEY, TrueClips, clip_of
from posecal.errors import PoseDataError


class Segments:
    """Poses that wait until the segment of their sequence is complete: it has all its poses, or another sequence began.

    Parameters
    ----------
    length : int
        How many poses a segment has, counted from the first of each sequence; the last has those that are left. 0 for
        none.
    name : str
        The label whose values the sequences are: ``sequence``, or ``clip``.

    Raises
    ------
    PoseDataError
        By :meth:`add`, for a sequence that comes back after another one.
    """

    def __init__(self, length: int, name: str = "sequence") -> None:
        self.length, self.name = length, name
        self._waiting: list[Chunk] = []
        self._sequence = ""
        self._ended: set[str] = set()

    def __copy__(self) -> Segments:
        other = Segments(self.length, self.name)
        other._waiting, other._sequence, other._ended = list(self._waiting), self._sequence, set(self._ended)
        return other

    def add(self, chunk: Chunk, sequence: npt.NDArray[np.str_]) -> Iterator[Chunk]:
        """Give the segments that more poses, of these sequences (m,), complete."""
        edges = np.concatenate([[0], np.flatnonzero(sequence[1:] != sequence[:-1]) + 1, [len(chunk)]])
        for start, stop in pairwise(edges):
            if sequence[start] != self._sequence:
                yield from self.rest()
                self._ended.add(self._sequence)
                self._sequence = str(sequence[start])
                if self._sequence in self._ended:
                    what = "WA- and W-MPJPE align" if self.name == "sequence" else "metrics of whole clips need"
                    raise PoseDataError(
                        f"{self.name}: {self._sequence} comes back after another one, and {what} consecutive frames; "
                        f"expected the poses of each {self.name} one after another."
                    )
            while start < stop:
                more = min(self.length - sum(map(len, self._waiting)), stop - start)
                part = replace(chunk.select(slice(start, start + more)), reference=None).copy()
                self._waiting = [*self._waiting, part]
                start += more
                if sum(map(len, self._waiting)) == self.length:
                    yield from self.rest()

    def rest(self) -> Iterator[Chunk]:
        """Give the poses that wait, as a segment."""
        waiting, self._waiting = self._waiting, []
        if waiting:
            yield join_chunks(waiting) if len(waiting) > 1 else waiting[0]

    def renumber(self, moved: Indices) -> None:
        """Give cells their new numbers."""
        self._waiting = [replace(chunk, cells=moved[chunk.cells]) for chunk in self._waiting]


class SegmentsAndClips:
    """Poses that wait until their segment, or their clip, is complete, and the tasks that measure these.

    Parameters
    ----------
    statistics : sequence of Statistic
        Some of which are of segments or of clips.
    segment_length : int
        As the option ``segment`` has it.
    spec : DataSpec
        What the data are.
    clips : TrueClips, optional
        All true clips, where statistics need them.
    """

    def __init__(
        self, statistics: Sequence[Statistic], segment_length: int, spec: DataSpec, clips: TrueClips | None = None
    ) -> None:
        self._segments = Segments(segment_length * any(statistic.by_segment for statistic in statistics))
        self._clips = Segments(spec.clip_length * any(statistic.by_clip for statistic in statistics), "clip")
        self._root, self._true_clips = spec.root, clips

    def __copy__(self) -> SegmentsAndClips:
        other = object.__new__(SegmentsAndClips)
        other.__dict__ |= self.__dict__
        other._segments, other._clips = copy.copy(self._segments), copy.copy(self._clips)
        return other

    def add(
        self, chunk: Chunk, sequence: Callable[[], npt.NDArray[np.str_]], statistics: Sequence[Statistic]
    ) -> Iterator[Callable[[], Measured]]:
        """Give the tasks of what more poses complete; ``sequence`` gives their sequences (m,)."""
        if self._segments.length:
            for part in self._segments.add(chunk, sequence()):
                yield self._task(part, [statistic for statistic in statistics if statistic.by_segment])
        if self._clips.length and chunk.clip is not None:
            for part in self._clips.add(chunk, chunk.clip):
                yield self._task(part, [statistic for statistic in statistics if statistic.by_clip])

    def rest(self, statistics: Sequence[Statistic]) -> Iterator[Callable[[], Measured]]:
        """Give the tasks of the poses that wait."""
        for part in self._segments.rest():
            yield self._task(part, [statistic for statistic in statistics if statistic.by_segment])
        for part in self._clips.rest():
            yield self._task(part, [statistic for statistic in statistics if statistic.by_clip])

    def renumber(self, moved: Indices) -> None:
        """Give cells their new numbers."""
        self._segments.renumber(moved)
        self._clips.renumber(moved)

    def _task(self, chunk: Chunk, statistics: Sequence[Statistic]) -> Callable[[], Measured]:
        make = partial(_lay_out, chunk.block(0, len(chunk), self._root), (self._true_clips, clip_of(chunk)))
        return partial(measure_segment, make, chunk.cells, statistics)


def _lay_out(make: Callable[[], Block], shared: Any) -> Block:
    block = make()
    block.share(KEY, lambda: shared)
    return block
