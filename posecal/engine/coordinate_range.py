"""Range of the coordinates of true poses, of all and without any one sequence."""

from __future__ import annotations

from collections.abc import Sequence
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
    reached_by : array of int (2, 2, K, D)
        The sequences that reach the two least and the two largest values.
    """

    least: FloatArray
    largest: FloatArray
    reached_by: Ints

    @classmethod
    def joined(cls, parts: Sequence[CoordinateRange]) -> CoordinateRange:
        """Put the ranges of several parts together, whose sequences have the same numbers."""
        least, largest = (np.concatenate([part[end] for part in parts]) for end in (0, 1))
        low, high = (np.concatenate([part.reached_by[end] for part in parts]) for end in (0, 1))
        (least, low), (largest, high) = _two_least(least, low), _two_least(-largest, high)
        return cls(least, -largest, np.stack([low, high]))

    def without(self, sequence: Ints) -> tuple[FloatArray, FloatArray]:
        """Give the least and the largest values over all sequences but one, (B, K, D) each, for each of B poses."""
        own = sequence[:, None, None] == self.reached_by[:, :1]
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
    (least, low), (largest, high) = _two_least(least, names), _two_least(-largest, names)
    return CoordinateRange(least, -largest, np.stack([low, high]))


def _two_least(values: FloatArray, names: Ints) -> tuple[FloatArray, Ints]:
    """Give the least of values (R, K, D), and the least of those of other names, (2, K, D); with both names."""
    names = np.broadcast_to(names.reshape(len(names), *names.shape[1:] or (1, 1)), values.shape)
    first = values.argmin(axis=0)[None]
    name = np.take_along_axis(names, first, axis=0)
    others = np.where(names == name, np.inf, values)
    second = others.argmin(axis=0)[None]
    least = np.concatenate([np.take_along_axis(values, first, axis=0), np.take_along_axis(others, second, axis=0)])
    return least, np.concatenate([name, np.take_along_axis(names, second, axis=0)])
