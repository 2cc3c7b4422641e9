"""Sums and means of the rows of an array by integer codes, and slices of rows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray

Indices = npt.NDArray[np.intp]
Cells = Indices | None
"""Indices of cells, rising; None for all."""

Counts = npt.NDArray[np.number[Any]]
"""Numbers of poses, or sums of their weights."""

Number = TypeVar("Number", bound=np.generic)


def slices(length: int, row_bytes: int, most: int = 64 * 1024 * 1024) -> Iterator[slice]:
    """Cut rows into slices of at most so many bytes, or of a single row."""
    step = max(1, most // max(1, row_bytes))
    return (slice(start, start + step) for start in range(0, length, step))


def compact(codes: Indices, cells: Cells) -> tuple[Indices, int]:
    """Number the codes that occur among some cells 0 … n - 1, in their order; give them with n."""
    if cells is None:
        return codes, int(codes.max(initial=-1)) + 1
    known, renumbered = np.unique(codes[cells], return_inverse=True)
    return renumbered, len(known)


def split_by(codes: Indices, n: int) -> list[Indices]:
    """Give the rising indices of the rows of each code 0 … n - 1, from one sort."""
    order = np.argsort(codes, kind="stable")
    return np.split(order, np.cumsum(np.bincount(codes, minlength=n))[:-1]) if n else []


def sum_by(codes: Indices, n: int, values: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """Sum rows (R, …) by their codes (R,) to (n, …); each code of 0 … n - 1 occurs."""
    if n == len(codes) and (codes[1:] > codes[:-1]).all():  # they are 0 … n - 1
        return values
    total = np.zeros((n, *values.shape[1:]), dtype=values.dtype)
    first = np.flatnonzero(np.concatenate([[True], codes[1:] != codes[:-1]]))
    if values.ndim > 1 and len(first) < len(codes) // 2:  # many rows in a row are of one code
        values, codes = np.add.reduceat(values, first, axis=0), codes[first]
    add_rows(total, codes, values)
    return total


def add_rows(total: npt.NDArray[Number], codes: Indices, values: npt.NDArray[Number]) -> None:
    """Add rows (R, …) to those of a total by their codes (R,), one after another where a code comes back.

    As ``np.add.at``, which takes 40 times as long for rows that are tables.
    """
    turns = np.flatnonzero(codes[1:] <= codes[:-1]) + 1
    if values.ndim == 1 or not len(codes) or len(turns) > len(codes) // 8:
        np.add.at(total, codes, values)
        return
    for part in map(slice, [0, *turns.tolist()], [*turns.tolist(), len(codes)]):  # whose codes rise
        some = codes[part]
        rows = slice(some[0], some[-1] + 1) if some[-1] - some[0] == len(some) - 1 else some
        total[rows] += values[part]  # type: ignore[misc]


def padded(values: npt.NDArray[Number], rows: int) -> npt.NDArray[Number]:
    """Add so many rows of zeros, which take no memory until they are written to."""
    total = np.zeros((len(values) + rows, *values.shape[1:]), dtype=values.dtype)
    total[: len(values)] = values
    return total


def joined_rows(moved: Indices, values: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """Give the first rows their new numbers, adding up those that are one now; as many rows, the last ones zeros."""
    total = np.zeros_like(values)
    np.add.at(total, moved, values[: len(moved)])
    return total


def mean_of(sums: FloatArray, counts: Counts) -> FloatArray:
    """Divide sums by counts; NaN where nothing counts."""
    number = np.where(np.greater(counts, 0), counts, np.nan)
    return np.asarray(sums / np.expand_dims(number, tuple(range(number.ndim, np.ndim(sums)))))


def mean_of_known(values: FloatArray) -> float:
    """Give the mean of those that are not NaN."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else float("nan")


def batches(sequence: Indices, number: int, group: Indices) -> Indices:
    """Number the batches of so many sequences, in the order of their first rows, within each group.

    Parameters
    ----------
    sequence, group : arrays of int (R,)
        Of each row.
    number : int
        Sequences of a batch; the last of a group has those that are left.

    Returns
    -------
    array of int (R,)
        The batch of each row.

    Examples
    --------
    >>> batches(np.array([2, 0, 1, 2, 0]), 2, np.array([0, 0, 0, 1, 1])).tolist()
    [0, 0, 1, 2, 2]
    """
    _, first, codes = np.unique(group * (sequence.max() + 1) + sequence, return_index=True, return_inverse=True)
    order = np.lexsort((first, group[first]))
    groups = group[first][order]
    begins = (np.arange(len(order)) - np.searchsorted(groups, groups)) % number == 0
    batch = np.empty(len(order), dtype=np.intp)
    batch[order] = np.cumsum(begins) - 1
    return batch[codes]
