"""Sums of statistics over the poses of one block."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.chunks import Indices
from posecal.engine.metric import Statistic
from posecal.engine.ragged import RaggedBlock, measure


@dataclass(frozen=True)
class BlockSums:
    """The sums of one block: a row for each run of poses of one cell."""

    poses: int
    cells: Indices
    poses_of_cells: Indices
    sums: dict[str, tuple[FloatArray, npt.NDArray[np.int64]]]
    per_pose: dict[str, FloatArray]
    cell_of: Indices
    non_finite: Indices  # (pose, joint), counted from the first pose of all
    non_finite_of_reference: Indices


def sum_block(
    first: int, make: Callable[[], Block | RaggedBlock], cells: Indices, statistics: Sequence[Statistic]
) -> BlockSums:
    """Compute statistics of a block and sum them over each run of poses of one cell.

    Parameters
    ----------
    first : int
        How many poses come before.
    make : callable
        Lays the block out.
    cells : array of int (B,)
        The cell of each pose.
    statistics : sequence of Statistic
        What is summed; nothing where coordinates are not finite.
    """
    block = make()
    finite = np.zeros_like(block.where)
    masks = block.non_finite, finite if block.reference is None else block.reference.non_finite
    bad, bad_of_reference = (np.argwhere(mask) + np.array([first, 0]) for mask in masks)
    runs = np.flatnonzero(np.concatenate([[True], cells[1:] != cells[:-1]]))
    poses = np.diff(np.append(runs, len(cells)))
    sums: dict[str, tuple[FloatArray, npt.NDArray[np.int64]]] = {}
    per_pose: dict[str, FloatArray] = {}
    for statistic in () if len(bad) or len(bad_of_reference) else statistics:
        values = measure(block, statistic)
        if statistic.per_pose:
            per_pose[statistic.name] = np.asarray(values, dtype=np.float64)
            continue
        values = np.asarray(values, dtype=np.float64)
        axes = 2 if statistic.per_joint else 1
        counted = ~np.isnan(values.reshape(*values.shape[:axes], -1)[..., 0])
        if not counted.all():
            values = np.where(counted.reshape(*counted.shape, *[1] * (values.ndim - axes)), values, 0)
        total = np.add.reduceat(values, runs, axis=0)
        sums[statistic.name] = total, np.add.reduceat(counted, runs, axis=0, dtype=np.int64)
    return BlockSums(len(cells), cells[runs], poses, sums, per_pose, cells, bad, bad_of_reference)
