"""Ranges of true poses, of all and without one sequence, against loops over the other poses."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.engine.coordinate_range import CoordinateRange, coordinate_range

Array = np.ndarray


def range_by_loops(poses: list[Array], counted: list[Array]) -> tuple[Array, Array]:
    """Least and largest value of each coordinate that counts and is finite; infinite where none is."""
    shape = poses[0].shape
    least, largest = np.full(shape, np.inf), np.full(shape, -np.inf)
    for pose, mask in zip(poses, counted, strict=True):
        for joint, axis in np.ndindex(shape):
            value = pose[joint, axis]
            if mask[joint] and np.isfinite(value):
                least[joint, axis] = min(least[joint, axis], value)
                largest[joint, axis] = max(largest[joint, axis], value)
    return least, largest


def other_poses(truth: Array, where: Array, root: int | None, sequence: Array, own: int) -> tuple[Array, Array]:
    poses = [pose if root is None else pose - pose[root] for pose in truth]
    chosen = np.flatnonzero(sequence != own)
    if not len(chosen):
        return range_by_loops([np.full(truth.shape[1:], np.nan)], [where[0]])
    return range_by_loops([poses[m] for m in chosen], [where[m] for m in chosen])


@pytest.mark.parametrize("root", [None, 1])
@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize("masked", [True, False])
def test_the_range_without_a_sequence_is_that_of_the_other_poses(
    root: int | None, labelled: bool, masked: bool
) -> None:
    for seed in range(5):
        random = np.random.default_rng(seed)
        M, K = 9, 3
        truth = random.integers(-4, 5, (M, K, 2)).astype(float)  # small numbers: ends are often reached twice
        truth[random.random((M, K, 2)) < 0.1] = np.nan
        truth[2, 0, 0] = np.inf
        where = random.random((M, K)) < 0.7 if masked else np.ones((M, K), dtype=bool)
        sequence = random.choice([40, -7, 3], M) if labelled else np.arange(M)
        found = coordinate_range(truth, where if masked else None, root=root, sequence=sequence if labelled else None)
        every = other_poses(truth, where, root, sequence, 99)
        np.testing.assert_array_equal((found.least[0], found.largest[0]), every)
        some = random.random(M) < 0.5
        parts = [
            coordinate_range(truth[part], where[part] if masked else None, root=root, sequence=sequence[part])
            for part in (some, ~some)
            if part.any()
        ]
        for one, joined in zip(found[:2], CoordinateRange.joined(parts)[:2], strict=True):
            np.testing.assert_array_equal(one, joined)  # whatever is in which part
        asked = np.array([*np.unique(sequence), 99])
        low, high = found.without(asked)
        for row, own in enumerate(asked):
            np.testing.assert_array_equal((low[row], high[row]), other_poses(truth, where, root, sequence, own))


def test_the_sequence_that_reaches_an_end_is_named_by_its_number() -> None:
    truth = np.array([[[1.0]], [[5.0]], [[-2.0]], [[4.0]]])
    found = coordinate_range(truth, sequence=np.array([30, 20, 10, 20]))
    assert found.reached_by.reshape(2, 2).tolist() == [[10, 30], [20, 30]]
    assert found.least.ravel().tolist() == [-2, 1]
    assert found.largest.ravel().tolist() == [5, 1]  # 4 is of the same sequence as 5


def test_of_one_sequence_there_is_no_other() -> None:
    found = coordinate_range(np.ones((3, 1, 1)), sequence=np.zeros(3, dtype=int))
    assert (found.least.ravel().tolist(), found.largest.ravel().tolist()) == ([1, np.inf], [1, -np.inf])


def test_values_of_joints_that_do_not_count_may_be_anything() -> None:
    truth = np.array([[[3.0], [np.inf]], [[4.0], [1e308]]])
    where = np.array([[True, False], [True, True]])
    with np.errstate(all="raise"):
        found = coordinate_range(truth, where, root=1)
    assert found.least[0, 0] == 4 - 1e308
    assert found.largest[0, 1] == 0
