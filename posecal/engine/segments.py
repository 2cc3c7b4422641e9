"""Segments: consecutive poses of one sequence that are measured together, whatever the blocks they come in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from posecal.engine.chunks import Chunk, join_chunks
from posecal.engine.sums import Indices


class Segments:
    """Poses that wait until the segment of their sequence is complete: it has all its poses, or another sequence began.

    Parameters
    ----------
    length : int
        How many poses a segment has, counted from the first of each sequence; the last has those that are left. 0 for
        none.
    """

    def __init__(self, length: int) -> None:
        self.length = length
        self._waiting: list[Chunk] = []
        self._sequence = ""

    def add(self, chunk: Chunk, sequence: npt.NDArray[np.str_]) -> Iterator[Chunk]:
        """Give the segments that more poses, of these sequences (m,), complete."""
        edges = np.concatenate([[0], np.flatnonzero(sequence[1:] != sequence[:-1]) + 1, [len(chunk)]])
        for start, stop in pairwise(edges):
            if sequence[start] != self._sequence:
                yield from self.rest()
                self._sequence = str(sequence[start])
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
