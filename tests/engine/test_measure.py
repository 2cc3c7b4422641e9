"""Statistics of a block are summed over runs of poses of one cell."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from posecal.engine.block import Block
from posecal.engine.measure import SUM_OF_TRUE_POSES, measure_block, measure_segment
from posecal.engine.metric import Statistic

CELLS = np.array([4, 4, 0, 4, 4])
VALUES = np.array([1.0, 2.0, 4.0, np.nan, 8.0])
STATISTICS = [Statistic("numbers", lambda _: VALUES), Statistic("kept", lambda _: VALUES, per_pose=True)]


def block(x: np.ndarray) -> partial[Block]:
    return partial(Block, x, np.zeros((5, 2, 3)))


def test_each_run_of_a_cell_has_its_sum_and_count() -> None:
    found = measure_block(7, block(np.ones((3, 5, 2, 3))), CELLS, STATISTICS)
    sums, counts = found.sums["numbers"]
    assert found.cells.tolist() == [4, 0, 4]
    assert (found.poses, found.poses_of_cells.tolist()) == (5, [2, 1, 2])
    assert (sums.tolist(), counts.tolist()) == ([3, 4, 8], [2, 1, 1])  # one pose does not count
    np.testing.assert_array_equal(found.per_pose["kept"], VALUES)
    assert len(found.non_finite) == 0


def test_nothing_is_measured_where_a_coordinate_is_not_finite() -> None:
    x = np.ones((3, 5, 2, 3))
    x[1, 2, 1, 0] = np.nan
    found = measure_block(7, block(x), CELLS, STATISTICS)
    assert (found.sums, found.per_pose) == ({}, {})
    assert found.non_finite.tolist() == [[9, 1]]


def test_a_segment_adds_sums_and_no_poses() -> None:
    found = measure_segment(block(np.ones((3, 5, 2, 3))), CELLS, STATISTICS[:1])
    assert found.sums["numbers"][0].tolist() == [3, 4, 8]
    assert (found.poses, found.poses_of_cells.tolist()) == (0, [0, 0, 0])
    x = np.full((3, 5, 2, 3), np.inf)
    found = measure_segment(block(x), CELLS, STATISTICS[:1])
    assert (found.sums, len(found.non_finite)) == ({}, 0)


def test_the_sum_of_true_poses_sees_an_exchange_of_coordinates() -> None:
    y = np.arange(12.0).reshape(2, 2, 3)
    one, other = (SUM_OF_TRUE_POSES.compute(Block(np.zeros((1, 2, 2, 3)), of)) for of in (y, y[..., [1, 0, 2]]))
    assert (np.abs(one - other) > 0.1).all()
    weights = np.arange(1, 7) * 2**0.5 % 1
    assert one == pytest.approx([(weights * range(6)).sum(), (weights * range(6, 12)).sum()])
