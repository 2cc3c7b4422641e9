"""Segments: consecutive poses of one sequence that are measured together, whatever the blocks they come in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from posecal.engine.chunks import Chunk, join_chunks
from posecal.engine.sums import Indices
from posecal.errors import PoseDataError


class Segments:
    """Poses that wait until the segment of their sequence is complete: it has all its poses, or another sequence began.

    Parameters
    ----------
    length : int
        How many poses a segment has, counted from the first of each sequence; the last has those that are left. 0 for
        none.

    Raises
    ------
    PoseDataError
        By :meth:`add`, for a sequence that comes back after another one.
    """

    def __init__(self, length: int) -> None:
        self.length = length
        self._waiting: list[Chunk] = []
        self._sequence = ""
        self._ended: set[str] = set()

    def __copy__(self) -> Segments:
        other = Segments(self.length)
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
                    raise PoseDataError(
                        f"sequence: {self._sequence} comes back after another one, and WA- and W-MPJPE align "
                        "consecutive frames; expected the poses of each sequence one after another."
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
            yield join_chunks(waiting)

    def renumber(self, moved: Indices) -> None:
        """Give cells their new numbers."""
        self._waiting = [replace(chunk, cells=moved[chunk.cells]) for chunk in self._waiting]
