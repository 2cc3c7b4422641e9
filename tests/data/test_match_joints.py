"""Joints join by name, and the root is found among them."""

from typing import Any

import numpy as np
import pytest

from posecal.data.declarations import Declarations
from posecal.data.pose_data import PoseData, match_poses
from posecal.errors import PoseDataError
from tests.helpers.small_files import (
    JOINTS,
    K,
    M,
    coordinates,
    gt,
    hypotheses,
    hyps,
    truth,
)

# --- joints ---------------------------------------------------------------------------------------------------


def test_numbers_of_joints_that_differ_are_said_with_the_way_out() -> None:
    words = (
        r"^hyps\.npz has K = 16 joints and gt\.npz 17; expected as many, or joints named in both and "
        r'shared_joints="common"\.$'
    )
    with pytest.raises(PoseDataError, match=words):
        match_poses(hyps(hypotheses()[:, :, 1:]), gt(joints=JOINTS))


def test_joints_that_one_file_lacks_are_named_with_the_way_out() -> None:
    kept = [k for k, name in enumerate(JOINTS) if name not in {"LElbow", "LWrist"}]
    with pytest.raises(
        PoseDataError, match=r"^hyps\.npz lacks 1 of the other's joints \(Hip\)\. Pass shared_joints=.common."
    ):
        match_poses(hyps(hypotheses()[:, :, 1:], joints=JOINTS[1:]), gt(joints=JOINTS))
    with pytest.raises(PoseDataError, match=r"^gt\.npz lacks 2 of the other's joints \(LElbow, LWrist\)\. Pass sh"):
        match_poses(hyps(joints=JOINTS), gt(truth()[:, kept], joints=tuple(JOINTS[k] for k in kept)))


def test_common_joints_are_scored_in_the_truths_order_and_the_rest_is_named() -> None:
    few = ("RWrist", "Head", "antenna", "LHip")
    x = np.stack([hypotheses()[:, :, JOINTS.index(name) if name in JOINTS else 0] for name in few], axis=2)
    pairs = match_poses(hyps(x, joints=few), gt(joints=JOINTS), Declarations(shared_joints="common"))
    assert pairs.joints == ("LHip", "Head", "RWrist")
    np.testing.assert_array_equal(coordinates(pairs), hypotheses()[:, :, [JOINTS.index(name) for name in pairs.joints]])
    assert "3 joints are in both; left out: Hip, RHip, RKnee, RFoot, LKnee and 10 more." in pairs.remarks


def test_joints_that_only_one_side_has_are_left_out_and_said() -> None:
    common = Declarations(shared_joints="common")
    fewer = match_poses(hyps(hypotheses()[:, :, 1:], joints=JOINTS[1:]), gt(joints=JOINTS), common)
    assert "16 joints are in both; left out: Hip." in fewer.remarks
    more = match_poses(hyps(joints=JOINTS), gt(truth()[:, :16], joints=JOINTS[:16]), common)
    assert "16 joints are in both; left out: RWrist." in more.remarks
    assert match_poses(hyps(joints=JOINTS), gt(joints=JOINTS), common).remarks == ()


@pytest.mark.parametrize("joints", ["same", "common"])
def test_no_joint_in_common_is_refused_once_and_shown(joints: Any) -> None:
    words = (
        r"^hyps\.npz and gt\.npz have no joint in common \(a0, a1, a2 and 14 more against b0, b1, b2 and 14 more\); "
        r"expected the same names\.$"
    )
    with pytest.raises(PoseDataError, match=words):
        match_poses(
            hyps(joints=tuple(f"a{k}" for k in range(K))),
            gt(joints=tuple(f"b{k}" for k in range(K))),
            Declarations(shared_joints=joints),
        )


def test_names_for_another_number_of_joints_are_refused() -> None:
    with pytest.raises(PoseDataError, match=r"^gt\.npz: 2 joints named for K = 17; expected one name each\.$"):
        match_poses(hyps(), gt(joints=("Hip", "Head")))


def test_two_names_of_one_joint_are_refused() -> None:
    twice = ("r_hip", "RHip", *JOINTS[2:])
    with pytest.raises(PoseDataError, match=r"^gt\.npz names joints more than once: r_hip = RHip\.$"):
        match_poses(hyps(), gt(joints=twice))


def test_a_joint_set_names_unnamed_joints() -> None:
    pairs = match_poses(hyps(hypotheses()[:, :, 1:]), gt(truth()[:, 1:]), Declarations(joints="h36m-16"))
    assert pairs.joints == JOINTS[1:]


def test_a_joint_set_of_another_size_is_refused() -> None:
    with pytest.raises(PoseDataError, match=r"hyps\.npz: h36m-16 has 16 joints for K = 17; expected one name each\."):
        match_poses(hyps(), gt(), Declarations(joints="h36m-16"))


def test_names_of_a_file_come_before_a_joint_set() -> None:
    with pytest.raises(PoseDataError, match=r"^gt\.npz: 2 joints named for K = 17; expected one name each\.$"):
        match_poses(hyps(), gt(joints=("Hip", "Head")), Declarations(joints="h36m-17"))
    back = JOINTS[::-1]
    assert match_poses(hyps(joints=back), gt(joints=back), Declarations(joints="h36m-17")).joints == back


def test_names_in_one_file_name_the_joints_of_both() -> None:
    assert match_poses(hyps(joints=JOINTS), gt()).joints == JOINTS
    assert match_poses(hyps(), gt(joints=JOINTS)).joints == JOINTS


# --- the root -------------------------------------------------------------------------------------------------


def moved(pairs: PoseData) -> tuple[int | None, bool]:
    return pairs.root, any("no root joint is known" in remark for remark in pairs.remarks)


def test_the_hip_is_the_root_by_name() -> None:
    assert moved(match_poses(hyps(), gt(truth() + 5, joints=JOINTS))) == (0, False)


def test_the_one_unnamed_joint_that_stays_at_zero_is_the_root() -> None:
    order = np.r_[1:K, 0]
    assert moved(match_poses(hyps(hypotheses()[:, :, order]), gt(truth()[:, order]))) == (
        K - 1,
        False,
    )


def test_a_joint_that_stays_at_zero_in_some_coordinates_or_poses_is_no_root() -> None:
    flat, resting = truth() + 5, truth() + 5
    flat[:, 3, 0] = resting[1:, 3] = 0
    for true in (flat, resting):
        assert moved(match_poses(hyps(), gt(true))) == (None, True)


def test_the_one_of_two_joints_that_stays_at_zero_is_the_root() -> None:
    assert moved(match_poses(hyps(hypotheses()[:, :, :2]), gt(truth()[:, :2]))) == (0, False)


def test_a_single_joint_is_no_root() -> None:
    data = match_poses(hyps(hypotheses()[:, :, 1:2]), gt(np.zeros((M, 1, 3))), Declarations(unit="mm"))
    assert moved(data) == (None, True)


def test_without_a_root_positions_are_taken_as_they_stand_and_that_is_said() -> None:
    assert moved(match_poses(hyps(), gt(truth() + 5))) == (None, True)
    two = truth()
    two[:, 3] = 0
    assert moved(match_poses(hyps(), gt(two))) == (None, True)


@pytest.mark.parametrize(
    ("said", "root"),
    [("none", None), ("3", 3), ("right_ankle", 3), ("Hip", 0)],
)
def test_a_root_by_flag_is_a_name_an_index_or_none(said: str, root: int | None) -> None:
    pairs = match_poses(hyps(), gt(joints=JOINTS), Declarations(root_joint=said))
    assert moved(pairs) == (root, False)


@pytest.mark.parametrize("said", ["17", "-1", "antenna", ""])
def test_a_root_that_is_no_joint_is_refused(said: str) -> None:
    with pytest.raises(PoseDataError, match=f"^root_joint: '{said}' is not among the joints"):
        match_poses(hyps(), gt(joints=JOINTS), Declarations(root_joint=said))


def test_a_root_that_the_hypotheses_lack_is_subtracted_from_the_truth_alone() -> None:
    far = truth() + np.float32([100, 200, 300])
    pairs = match_poses(
        hyps(hypotheses()[:, :, 1:], joints=JOINTS[1:]),
        gt(far, joints=JOINTS),
        Declarations(shared_joints="common"),
    )
    np.testing.assert_array_equal(pairs.truth, truth()[:, 1:])
    assert pairs.root is None
    assert "hyps.npz lacks the root Hip; its positions are taken as relative to it." in pairs.remarks
