"""What definitions depend on: the data as they are described, and the joints that each kind of metric is about."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest

from posecal.data.pose_data import PoseData
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from posecal.stats.skill import with_reference

JOINTS = ("Hip", "RHip", "Head", "RWrist")
SPEC = DataSpec(7, JOINTS, 0)


def data(n: int = 3, **options: Any) -> PoseData:
    y = np.random.default_rng(0).normal(0, 300, (5, 4, 3))
    x = y + np.random.default_rng(1).normal(0, 50, (n, 5, 4, 3))
    return PoseData(x, y, unit="mm", axes="NMKD", joints=JOINTS, **options)


def test_data_are_described_by_what_they_have() -> None:
    assert DataSpec.of(data()) == DataSpec(3, JOINTS, 0)
    full = data(
        labels={"sequence": list("aabbb"), "action": "walk"}, fps=50, scores=np.ones((3, 5)), root_joint="Head",
        occluded=np.zeros((5, 4), dtype=bool),
    )  # fmt: skip
    full = with_reference(full, data(6, root_joint="Head").replace(names=("other model", "truth")))
    found = DataSpec.of(full, has_mask=True, preranks=("mine",))
    assert found == DataSpec(3, JOINTS, 2, ("sequence", "action"), 50.0, True, True, True, ("mine",), "other model", 6)
    lacking = {"has_scores", "has_occlusion", "has_mask", "fps", "reference", "preranks", "labels", "n_reference"}
    assert not any(getattr(SPEC, name) for name in lacking)
    assert DataSpec(7, JOINTS).root is None


def test_the_difference_of_two_descriptions_names_what_differs() -> None:
    assert SPEC.difference(SPEC) == ""
    other = replace(SPEC, n_hypotheses=5, fps=25.0)
    assert SPEC.difference(other) == "n_hypotheses 7 against 5; fps None against 25.0"


@pytest.mark.parametrize(
    ("options", "root", "fit", "body", "moving"),
    [
        ({}, 0, [0, 1, 2, 3], [0, 1, 2, 3], [1, 2, 3]),
        ({"root": "drop"}, 0, [0, 1, 2, 3], [1, 2, 3], [1, 2, 3]),
        ({"root": "drop"}, None, [0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 2, 3]),
        ({"joints": "Hip, Head"}, 0, [0, 2], [0, 2], [2]),
        ({"joints": "all but Head", "root": "drop"}, 1, [0, 1, 3], [0, 3], [0, 3]),
    ],
)
def test_the_joints_of_a_pose_are_fitted_scored_or_moving(
    options: dict[str, str], root: int | None, fit: list[int], body: list[int], moving: list[int]
) -> None:
    scope = Scope(Protocol().changed(options), replace(SPEC, root=root))
    for mask, expected in ((scope.fit, fit), (scope.body, body), (scope.moving, moving)):
        assert np.flatnonzero(mask).tolist() == expected


def test_joints_of_pck_and_cps_are_among_those_that_are_scored() -> None:
    scope = Scope(Protocol(joints="Hip, Head", pck_joints="Head, RWrist", cps_joints="Hip, RWrist"), SPEC)
    assert np.flatnonzero(scope.pck).tolist() == [2]
    assert np.flatnonzero(scope.cps).tolist() == [0]
    unnamed = Scope(Protocol(cps_joints="all"), DataSpec(7, ("joint 0", "joint 1")))
    assert unnamed.pck.tolist() == [True, True]  # the set of a person's joints has none of them


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"joints": "Hip"}, "joints without the root"),
        ({"joints": "Hip", "root": "drop"}, "joints"),
    ],
)
def test_of_no_joint_there_is_no_number(options: dict[str, str], what: str) -> None:
    words = rf"^{what}: none is left; the poses have Hip, RHip, Head, RWrist\. Of positions as they are, pass root_j"
    with pytest.raises(PoseDataError, match=words):
        Scope(Protocol().changed(options), SPEC)


def test_what_no_joint_of_pck_or_cps_is_scored_for_is_said() -> None:
    scope = Scope(Protocol(joints="Hip, Head", pck_joints="RWrist", cps_joints="RHip", cps_align="none"), SPEC)
    assert scope.lack("auc") == scope.lack("pck_curve") == "joints to score: none of pck_joints = RWrist is"
    assert scope.lack("cps") == "joints to score: none of cps_joints = RHip is"
    assert scope.lack("mpjpe") == Scope(Protocol(), SPEC).lack("pck") == ""


@pytest.mark.parametrize(("joints", "align", "least"), [("Hip, Head", "similarity", 3), ("Head", "rigid", 2)])
def test_of_so_few_joints_that_all_alignments_are_perfect_there_is_no_aligned_number(
    joints: str, align: Literal["similarity", "rigid"], least: int
) -> None:
    scope = Scope(Protocol(joints=joints, align=align), SPEC)
    assert scope.lack("pa_min_mpjpe") == f"at least {least} joints to align"
    assert scope.lack("cps") == "at least 3 joints to align"
    assert scope.lack("mpjpe") == Scope(Protocol(joints="Hip, RHip, Head"), SPEC).lack("pa_mpjpe") == ""


def test_masks_of_joints_are_described_in_words() -> None:
    one, all_ = np.array([False, True, False, False]), np.ones(4, dtype=bool)
    scope = Scope(Protocol(), SPEC)
    assert scope.counted(all_) == "the 4 joints (root counted)"
    assert scope.number(one) == scope.size(one) == "1 joint (no root)"
    assert Scope(Protocol(), replace(SPEC, root=None)).number(one) == "1 joint"
    occluded = Scope(Protocol(where="occluded"), replace(SPEC, has_occlusion=True))
    assert occluded.number(one) == "occluded ones of 1 joint (no root)"
    assert occluded.size(all_) == "4 joints (root counted)"
