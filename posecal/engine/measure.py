"""Statistics of the poses of one block, as sums for each run of poses of one cell."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.gallery import POSE_NUMBERS, Gallery
from posecal.engine.metric import Statistic
from posecal.engine.ragged import RaggedBlock, measure
from posecal.engine.sums import Indices


@dataclass(frozen=True)
class Measured:
    """The sums of one block: a row for each run of poses of one cell."""

    poses: int
    cells: Indices
    poses_of_cells: Indices
    sums: dict[str, tuple[FloatArray, npt.NDArray[np.int64]]]
    per_pose: dict[str, FloatArray]
    cell_of: Indices
    non_finite: Indices
    non_finite_of_reference: Indices
    worst: Gallery | None = None


def measure_block(
    first: int,
    make: Callable[[], Block | RaggedBlock],
    cells: Indices,
    statistics: Sequence[Statistic],
    choose: Callable[[FloatArray], Gallery | None] = lambda _: None,
) -> Measured:
    """Measure a block, of which the first pose has this number; nothing where a coordinate is not finite.

    ``choose`` gives the poses for pictures from the numbers that they are chosen by, where those are measured.
    """
    block = make()
    finite = np.zeros_like(block.where)
    masks = block.non_finite, finite if block.reference is None else block.reference.non_finite
    bad, bad_of_reference = (np.argwhere(mask) + np.array([first, 0]) for mask in masks)
    runs = np.flatnonzero(np.concatenate([[True], cells[1:] != cells[:-1]]))
    poses = np.diff(np.append(runs, len(cells)))
    sums: dict[str, tuple[FloatArray, npt.NDArray[np.int64]]] = {}
    per_pose: dict[str, FloatArray] = {}
    worst = None
    for statistic in () if len(bad) or len(bad_of_reference) else statistics:
        values = measure(block, statistic)
        if statistic.name == POSE_NUMBERS:
            worst = choose(values)
            continue
        if statistic.per_pose:
            per_pose[statistic.name] = np.asarray(values, dtype=np.float64)
            continue
        values = np.asarray(values, dtype=np.float64)
        axes = 2 if statistic.per_joint else 1
        counted = ~np.isnan(values.reshape(*values.shape[:axes], -1)[..., 0])
        if not counted.all():
            values = np.where(counted.reshape(*counted.shape, *[1] * (values.ndim - axes)), values, 0)
        if len(runs) == len(cells):  # as by horizon
            sums[statistic.name] = values, counted.astype(np.int64)
            continue
        total = np.add.reduceat(values, runs, axis=0)
        sums[statistic.name] = total, np.add.reduceat(counted, runs, axis=0, dtype=np.int64)
    return Measured(len(cells), cells[runs], poses, sums, per_pose, cells, bad, bad_of_reference, worst)


def measure_segment(make: Callable[[], Block], cells: Indices, statistics: Sequence[Statistic]) -> Measured:
    """Measure poses that were measured in blocks before, and add none to the count."""
    measured = measure_block(0, make, cells, statistics)
    nothing = np.zeros((0, 2), dtype=np.intp)  # what is not finite was found in those blocks
    no_poses = np.zeros_like(measured.poses_of_cells)
    return replace(measured, poses=0, poses_of_cells=no_poses, non_finite=nothing, non_finite_of_reference=nothing)


def _weighted_sum_of_truth(block: Block) -> FloatArray:
    """Sum the true coordinates of each pose, each with a weight of its own, so that no exchange of them goes unseen."""
    truth = block.truth.reshape(len(block.truth), -1)
    weights = np.arange(1, truth.shape[1] + 1) * math.sqrt(2) % 1
    return np.asarray(truth @ weights)


EFFECTIVE_NUMBER = Statistic("effective_hypotheses", lambda block: block.n_effective)
"""Effective number of hypotheses of each pose; of those of plain ones it is N, and not measured."""

HAS_SPREAD = Statistic("has_spread", lambda block: np.full(len(block.truth), float(block.has_spread)))
"""Whether each pose has more than one hypothesis that counts; of plain ones it is not measured."""


def of_plain_poses(n_hypotheses: int) -> dict[str, float]:
    """Give what these two are for every pose whose hypotheses all count alike, by name."""
    return {EFFECTIVE_NUMBER.name: float(n_hypotheses), HAS_SPREAD.name: float(n_hypotheses > 1)}


SUM_OF_TRUE_POSES = Statistic("truth", _weighted_sum_of_truth)
"""Weighted sum of a true pose's coordinates: not a metric, but the check that two results have the same truth."""
