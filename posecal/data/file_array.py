"""How are a few poses read out of an array of many gigabytes? Memory-mapped where they lie, and let go at once.

A map of the whole array would not do: its pages count as memory of the process, and the kernel brings up to two
megabytes around each byte that is touched, so that some poses of each of 200 hypotheses would hold half a gigabyte. So
each run of bytes that lie together has a map of its own, which lives while it is copied.
"""

from __future__ import annotations

import math
import mmap
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from io import FileIO
from itertools import product

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseFileError

__all__ = ["FileArray"]


@dataclass(frozen=True)
class FileArray:
    """An array that lies in an open file, as a :class:`posecal.data.layout.LazyArray`.

    Attributes
    ----------
    name : str
        What messages call it.
    file : FileIO
        Unbuffered; closed when the array is no longer used.
    offset : int
        Where its first byte lies.
    shape : tuple of int
        The length of every axis.
    dtype : numpy.dtype
        The type of its numbers.
    fortran : bool
        Whether the first axis is the fastest.
    """

    name: str
    file: FileIO
    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    fortran: bool = False

    def __post_init__(self) -> None:
        weakref.finalize(self, self.file.close)

    @property
    def bytes_missing(self) -> int:
        """How many bytes the file is too short for the array."""
        length = self.file.seek(0, 2) - self.offset
        return max(0, self.dtype.itemsize * math.prod(self.shape) - length)

    def part(self, where: tuple[slice, ...]) -> npt.NDArray[np.generic]:
        """Read what lies between two places along every axis.

        Parameters
        ----------
        where : tuple of slice
            ``slice(start, stop)`` for each axis, within its length.

        Returns
        -------
        array
            In memory.

        Raises
        ------
        PoseFileError
            Where the file ends before the array does, or can't be mapped.
        """
        shape, between = (self.shape[::-1], where[::-1]) if self.fortran else (self.shape, where)
        found = np.empty([one.stop - one.start for one in between], dtype=self.dtype)
        cut = max((axis for axis, length in enumerate(found.shape) if length < shape[axis]), default=0)
        runs = found.view(np.uint8).reshape(math.prod(found.shape[:cut]), -1)
        for run, place in zip(runs, _starts(shape, between, cut), strict=True):
            self._fill(run.data, self.offset + place * self.dtype.itemsize)
        return found.T if self.fortran else found

    def _fill(self, run: memoryview, offset: int) -> None:
        if not run:
            return
        before = offset % mmap.ALLOCATIONGRANULARITY
        try:
            pages = mmap.mmap(self.file.fileno(), before + len(run), access=mmap.ACCESS_READ, offset=offset - before)
        except (ValueError, OSError) as error:
            where = f"bytes {offset:,} to {offset + len(run):,}"
            raise PoseFileError(f"{self.name}: {where} can't be read ({error}). Was it changed meanwhile?") from None
        with pages, memoryview(pages) as seen:
            run[:] = seen[before:]


def _starts(shape: tuple[int, ...], between: tuple[slice, ...], cut: int) -> Iterator[int]:
    """Give the place of the first number of each run: axes after ``cut`` are whole, so that a run holds them all."""
    step = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    for outer in product(*(range(one.start, one.stop) for one in between[:cut])):
        yield sum(place * length for place, length in zip(outer, step, strict=False)) + between[cut].start * step[cut]
