"""Frame numbers: the order of the frames of each sequence, and the steps between them."""

from __future__ import annotations

import numpy as np
import pytest

from posecal import PoseData
from posecal.data.frame_numbers import order_by_number

RUN_AND_WALK = ["run", "walk"] * 3


def ordered(names: list[str], sequence: list[str], n_before: int = 0) -> tuple[list[int], list[int], list[str]] | None:
    found = order_by_number(np.array(names), np.array(sequence), n_before)
    return None if found is None else (found[0].tolist(), found[1].tolist(), found[2])


@pytest.mark.parametrize(
    "names",
    [
        ["a1", "b2", "a3", "b1", "a2", "b3"],
        ["r_0007_cam1", "w_0012_cam1", "r_0009_cam1", "w_0011_cam1", "r_0008_cam1", "w_0013_cam1"],
        ["7/7", "clip3_12", "9/9", "clip3_11", "8/8", "clip3_13"],
    ],
)
def test_frames_are_in_the_order_of_the_number_that_varies_in_a_sequence(names: list[str]) -> None:
    assert ordered(names, RUN_AND_WALK) == ([0, 4, 2, 3, 1, 5], [0, 1, 2, 4, 5, 6], [])


@pytest.mark.parametrize(
    "names",
    [
        ["1", "1", "2", "2", "2", "3"],  # run has 2 twice
        ["f1_c2", "1", "f2_c1", "2", "f3_c3", "3"],  # two numbers vary
        ["12:58", "1", "12:59", "2", "13:00", "3"],  # a time of day
        ["9fa3", "1", "1cb2", "2", "77e1", "3"],  # hashes
        ["a", "1", "b", "2", "c", "3"],
        [str(2**63), "1", "5", "2", "6", "3"],
    ],
)
def test_names_without_numbers_of_frames_leave_the_order_of_the_rows(names: list[str]) -> None:
    assert ordered(names, RUN_AND_WALK) is None


def test_the_last_number_counts_where_the_names_differ_otherwise_and_it_rises() -> None:
    assert ordered(["left1", "right2", "left4"], ["a"] * 3) == ([0, 1, 2], [0, 1, 3], [])


@pytest.mark.parametrize(
    ("numbers", "order", "remark"),
    [
        ([0, 5, 2, 6, 4, 7], [0, 1, 2, 4, 5, 6], "2 apart in run"),
        ([0, 5, 2, 7, 4, 9], [0, 1, 2, 4, 5, 6], "2 apart"),
        ([0, 5, 2, 8, 6, 11], [0, 1, 3, 5, 6, 7], "2 apart in run"),
        ([0, 5, 3, 8, 9, 11], [0, 1, 3, 5, 6, 7], "3 apart"),
    ],
)
def test_each_sequence_has_a_step_of_its_own(numbers: list[int], order: list[int], remark: str) -> None:
    rows = [0, 2, 4, 1, 3, 5]
    said = f"frame numbers are {remark}: velocities are of steps of so many frames."
    assert ordered(list(map(str, numbers)), RUN_AND_WALK) == (rows, order, [said])


def test_sequences_of_one_frame_have_no_step() -> None:
    assert ordered(["x", "9", "x1"], ["a", "b", "c"]) == ([0, 1, 2], [0, 2, 4], [])


@pytest.mark.parametrize(("number", "first"), [(4, 0), (5, 1), (1, 1)])
def test_frames_continue_those_that_came_before_one_step_later(number: int, first: int) -> None:
    assert ordered(["2", "3", str(number)], ["a"] * 3, n_before=2) == ([0], [first], [])


def test_rows_of_all_members_follow_the_numbers() -> None:
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (6, 5, 3))
    x, scores, occluded = y + random.normal(0, 9, (2, 6, 5, 3)), random.normal(size=(2, 6)), random.random((6, 5)) < 0.5
    numbers, action = np.array([2, 0, 1, 1, 0, 2]), np.array(list("uvwxyz"))
    where = random.random((6, 5)) < 0.7
    data = PoseData(
        *(x, y),
        frame_id=np.char.add(["a", "b"] * 3, numbers.astype(str)),
        labels={"sequence": ["a", "b"] * 3, "action": action},
        scores=scores,
        occluded=occluded,
        where=where,
        unit="mm",
        root_joint="none",
        axes="NMKD",
    )
    rows = [4, 2, 0, 1, 3, 5]
    np.testing.assert_array_equal(data.truth, y[rows])
    np.testing.assert_array_equal(data.hypotheses.read(0, 6), x[:, rows])
    np.testing.assert_array_equal(data.scores, scores[:, rows])
    np.testing.assert_array_equal(data.occluded, occluded[rows])
    np.testing.assert_array_equal(data.where, where[rows])
    assert "".join(data.labels["action"]) == "ywuvxz"
    assert data.frame_id.tolist() == ["a0", "a1", "a2", "b0", "b1", "b2"]
