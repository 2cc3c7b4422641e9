"""Segments of sequences do not depend on the parts in which their poses come."""

from __future__ import annotations

import copy

import numpy as np
import numpy.typing as npt
import pytest

from posecal.engine.chunks import Chunk
from posecal.engine.segments import Segments
from posecal.errors import PoseDataError

M = 17
SEQUENCE = np.array(["a"] * 7 + ["b"] * 3 + ["d"] * 2 + ["c"] * 5)


def poses(numbers: npt.NDArray[np.float64]) -> Chunk:
    """One hypothesis of one joint, whose coordinate is the number of the pose; its cell is its tens."""
    truth = numbers.reshape(-1, 1, 1).copy()
    follows, cells = np.ones(len(numbers), dtype=bool), (numbers // 10).astype(np.intp)
    hashes = np.zeros((len(numbers), 2), dtype=np.uint64)
    names, order = numbers.astype(np.str_), numbers.astype(np.intp)
    absent = None, None, None, None, None
    return Chunk(truth[None] + 0.5, truth, follows, cells, cells, hashes, *absent, names, names, order)


@pytest.mark.parametrize("parts", [[], [1], [3, 4, 9], list(range(1, M))])
@pytest.mark.parametrize(
    ("length", "expected"),
    [
        (3, [[0, 1, 2], [3, 4, 5], [6], [7, 8, 9], [10, 11], [12, 13, 14], [15, 16]]),
        (5, [[0, 1, 2, 3, 4], [5, 6], [7, 8, 9], [10, 11], [12, 13, 14, 15, 16]]),
        (99, [[0, 1, 2, 3, 4, 5, 6], [7, 8, 9], [10, 11], [12, 13, 14, 15, 16]]),
    ],
)
def test_a_segment_has_so_many_consecutive_poses_of_a_sequence(
    parts: list[int], length: int, expected: list[list[int]]
) -> None:
    segments, found = Segments(length), []
    for part in np.split(np.arange(float(M)), parts):
        found += segments.add(poses(part), SEQUENCE[part.astype(int)])
    found += segments.rest()
    assert [chunk.truth.ravel().tolist() for chunk in found] == expected
    assert [(chunk.hypotheses.ravel() - 0.5).tolist() for chunk in found] == expected
    assert not [*segments.rest()]


def test_poses_that_wait_are_copies_with_cells_that_can_change() -> None:
    segments, chunk = Segments(4), poses(np.array([8.0, 9.0, 10.0]))
    assert not [*segments.add(chunk, np.array(["a"] * 3))]
    chunk.truth[:], chunk.hypotheses[:] = 77, 77
    segments.renumber(np.array([5, 3]))
    (rest,) = segments.rest()
    assert rest.truth.ravel().tolist() == [8, 9, 10]
    assert rest.hypotheses.ravel().tolist() == [8.5, 9.5, 10.5]
    assert rest.cells.tolist() == [5, 5, 3]


def test_a_sequence_that_comes_back_is_refused() -> None:
    """Its segment would hold some of its consecutive frames only, and be aligned better."""
    segments = Segments(3)
    assert len([*segments.add(poses(np.arange(4.0)), np.array(["a", "a", "b", "b"]))]) == 1
    later = copy.copy(segments)
    with pytest.raises(PoseDataError, match=r"^sequence: a comes back after another one, and WA- and W-MPJPE align"):
        list(segments.add(poses(np.arange(2.0)), np.array(["b", "a"])))
    assert [len(chunk) for chunk in later.add(poses(np.arange(2.0)), np.array(["b", "c"]))] == [3]
