"""Stored poses give what is declared about their frames, and hypotheses are read some poses at a time."""

from typing import Any

import numpy as np
import pytest

from posecal.data.layout import Layout, MemoryArray
from posecal.data.stored_poses import ArrayHypotheses, in_millimetres
from tests.helpers.small_files import K, M, N, gt, hypotheses, hyps, ids


def test_what_is_declared_about_frames_is_given_as_members_of_a_file() -> None:
    assert hyps().frame_members == {}
    mask, scores = np.ones((M, K), dtype=bool), np.ones((N, M))
    poses = gt(
        labels={"action": ids(*"tuvwxyz")}, marks={"visible": mask}, frame_id=ids(*range(M)), scores=scores, fps=25.0
    )
    members: dict[str, Any] = poses.frame_members
    assert list(members) == ["action", "visible", "frame_id", "scores", "fps"]
    assert "".join(members["action"]) == "tuvwxyz"
    assert members["visible"] is mask
    assert members["frame_id"].tolist() == [*"0123456"]
    assert members["scores"] is scores
    assert (members["fps"].shape, float(members["fps"])) == ((), 25.0)


def part(**changes: Any) -> ArrayHypotheses:
    given = {"rows": np.arange(M), "columns": np.arange(K), "factor": 1.0, "n_hypotheses": N, **changes}
    return ArrayHypotheses(MemoryArray(hypotheses()), Layout("NMKD", "NMKD"), **given)


def test_some_poses_are_read_in_the_order_of_rows_and_columns() -> None:
    rows, columns = np.array([3, 0, 6]), np.array([2, 1])
    chosen = part(rows=rows, columns=columns, n_hypotheses=2)
    expected = hypotheses()[:2][:, rows][:, :, columns]
    np.testing.assert_array_equal(chosen.read(0, 3), expected)
    np.testing.assert_array_equal(chosen.read(1, 3), expected[:, 1:])
    np.testing.assert_array_equal(chosen.select(np.array([2, 0])).read(0, 2), expected[:, [2, 0]])
    assert (chosen.n_hypotheses, chosen.itemsize) == (2, 4)


def test_numbers_in_memory_that_need_no_change_are_not_copied() -> None:
    stored = part()
    assert np.shares_memory(stored.read(0, M), stored.array.array)  # type: ignore[attr-defined]


@pytest.mark.parametrize(("dtype", "working"), [("f2", "f4"), ("f4", "f4"), ("f8", "f8"), ("i2", "f8")])
def test_lengths_become_millimetres_in_their_precision(dtype: str, working: str) -> None:
    lengths = in_millimetres(np.array([1, 2], dtype=dtype), 10.0)
    assert lengths.tolist() == [10, 20]
    assert lengths.dtype == np.dtype(working)
