"""Range of the coordinates of true poses, of all and without any one sequence."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.data.root import AnyRoot, origin

Ints = npt.NDArray[np.intp]


class CoordinateRange(NamedTuple):
    """The range of each coordinate of some true poses, and what it is without any one sequence.

    Attributes
    ----------
    least, largest : array (2, K, D)
        Over all poses, and over those of other sequences than the one that reaches it, mm; infinite where none is.
    reached_by : array of int (2, K, D)
        The sequence that reaches the least and the largest value.
    """

    least: FloatArray
    largest: FloatArray
    reached_by: Ints

    def without(self, sequence: Ints) -> tuple[FloatArray, FloatArray]:
        """Give the least and the largest values over all sequences but one, (B, K, D) each, for each of B poses."""
        own = sequence[:, None, None] == self.reached_by[:, None]
        low, high = np.where(own[0], self.least[1], self.least[0]), np.where(own[1], self.largest[1], self.largest[0])
        return low, high


def coordinate_range(
    truth: FloatArray,
    where: npt.NDArray[np.bool_] | None = None,
    *,
    root: AnyRoot = None,
    sequence: Ints | None = None,
) -> CoordinateRange:
    """Give the range of true poses.

    Parameters
    ----------
    truth : array (M, K, D)
        True poses, mm.
    where : bool array (M, K), optional
        The joints that count.
    root : int or Root, optional
        What is subtracted from every pose.
    sequence : array of int (M,), optional
        The sequence of each pose, by any number; each pose is one by default.

    Returns
    -------
    CoordinateRange
        Of the coordinates that count and are finite.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # joints that don't count may hold anything
        relative = truth if root is None else truth - origin(truth, root)
    counted = np.isfinite(relative) if where is None else np.isfinite(relative) & where[..., None]
    least, largest = np.where(counted, relative, np.inf), np.where(counted, relative, -np.inf)
    names = np.arange(len(truth))
    if sequence is not None:
        order = np.argsort(sequence, kind="stable")
        names, starts = np.unique(sequence[order], return_index=True)
        least, largest = np.minimum.reduceat(least[order], starts), np.maximum.reduceat(largest[order], starts)
    reached_by = np.stack([least.argmin(axis=0), largest.argmax(axis=0)])
    ends = _with_next(least, reached_by[0], np.min), _with_next(largest, reached_by[1], np.max)
    return CoordinateRange(*ends, names[reached_by])


def _with_next(values: FloatArray, reached_by: Ints, end: Callable[..., FloatArray]) -> FloatArray:
    """Give the end of (S, K, D) values that sequences reach, and that of the other sequences, (2, K, D)."""
    first = end(values, axis=0)
    np.put_along_axis(values, reached_by[None], -np.inf if end is np.max else np.inf, axis=0)
    return np.stack([first, end(values, axis=0)])
