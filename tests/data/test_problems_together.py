"""Independent problems of two arrays, and of the options, are raised together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError, for_python

RANDOM = np.random.default_rng(0)
TRUTH = RANDOM.normal(0, 300, (20, 5, 3))
HYPOTHESES = TRUTH + RANDOM.normal(0, 40, (20, 20, 5, 3))  # N = M: the layout is open

WRONG: dict[str, tuple[Any, str]] = {
    "joints": (["a", "b"], "truth: 2 joints named for K = 5"),
    "labels": ({"sequence": ["a"] * 3}, "truth: sequence has 3 values for 20 poses"),
    "where": (np.ones((3, 3)), "where: float64 (3, 3)"),
    "occluded": (np.zeros((4, 4), dtype=bool), "truth: occluded (4, 4)"),
    "fps": (-3, "fps: -3"),
}


def problems(hypotheses: Any, truth: Any, **options: Any) -> list[str]:
    with pytest.raises(PoseDataError) as refusal:
        posecal.evaluate(hypotheses, truth, **options)
    return [for_python(problem) for problem in refusal.value.problems or [str(refusal.value)]]


def assert_each(found: list[str], *starts: str) -> None:
    """Each problem begins with one of these, and none is missing."""
    assert all(sum(start in problem for problem in found) == 1 for start in starts), found
    assert len(found) == len(starts), found


def test_an_open_layout_stands_beside_what_the_shape_of_the_truth_tells() -> None:
    found = problems(HYPOTHESES, TRUTH, unit="mm", **{name: value for name, (value, _) in WRONG.items()})
    assert_each(found, "the shapes don't tell the axes apart", *(start for _, start in WRONG.values()))


def test_of_a_truth_of_no_known_layout_nothing_is_said_but_that() -> None:
    assert_each(
        problems(HYPOTHESES, TRUTH[0], labels={"sequence": ["a"] * 3}), "truth (5, 3): expected (N, M, K, D) and"
    )


@pytest.mark.parametrize("name", WRONG)
def test_metres_stand_beside_each_other_problem_but_that_of_joints(name: str) -> None:
    value, start = WRONG[name]
    found = problems(HYPOTHESES / 1000, TRUTH / 1000, axes="NMKD", **{name: value})
    assert any(start in problem for problem in found)
    assert any("looks like metres" in problem for problem in found) == (name != "joints")


def test_options_stand_beside_data() -> None:
    wrong = {"metrics": "mpjpee", "unit": "inch", "root_joint": True, "scores": np.zeros((2, 2))}
    found = problems(HYPOTHESES, TRUTH, axes="NMKD", labels={"action": ["a"]}, **wrong)
    assert_each(
        found, "mpjpee", "unit: 'inch'", "root_joint: True", "scores (2, 2)", "action has 1 values for 20 poses"
    )


def test_labels_of_another_type_stand_beside_a_wrong_shape() -> None:
    found = problems(HYPOTHESES[:3], TRUTH[:7], axes="NMKD", labels={"action": [[1]]}, occluded=[["x"]])
    assert_each(
        found,
        "truth: action (1, 1); expected one for each pose, (M,) = (7,)",
        "occluded: dtype",
        "hypotheses has M = 20 poses and truth 7",
    )
