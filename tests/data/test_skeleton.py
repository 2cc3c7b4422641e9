"""Joints by name: every spelling, every named set, and the bones that follow from one human tree."""

import numpy as np
import pytest

from posecal.data.joint_names import canonical_names, joint_keys
from posecal.data.skeleton import JOINT_SETS, REST_POSE, Skeleton, joint_set
from posecal.errors import PoseDataError

# Human3.6M's own order and parents, as its papers' repositories list them for 17 joints.
H36M_PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 9, 8, 11, 12, 8, 14, 15)


@pytest.mark.parametrize(
    ("spelt", "name"),
    [
        *[(spelt, "Hip") for spelt in ("pelvis", "Pelvis", "ROOT", "hips", "mid_hip", "Hip")],
        *[(spelt, "RFoot") for spelt in ("RAnkle", "right_ankle", "rightAnkle", "R.Foot", "right foot")],
        *[(spelt, "LWrist") for spelt in ("l_wrist", "wrist left", "LeftWrist", "LWRIST", "wrist-left")],
        *[("neck", "Thorax"), ("thorax", "Thorax"), ("upper_neck", "UpperNeck"), ("Neck/Nose", "Neck/Nose")],
        *[("nose", "nose"), ("head_top", "Head"), ("Head", "Head"), ("spine", "Spine")],
        *[("RHip", "RHip"), ("right_hip", "RHip"), ("LHip", "LHip"), ("hip_left", "LHip")],
    ],
)  # fmt: skip
def test_a_joint_has_one_name_in_every_spelling(spelt: str, name: str) -> None:
    assert canonical_names((spelt,)) == (name,)


@pytest.mark.parametrize("name", ["antenna 3", "ankle_r", "RToe", "left", "r", "", "neck2", "joint 3"])
def test_a_name_that_is_not_known_stays_as_it_is(name: str) -> None:
    assert canonical_names((name,)) == (name,)


@pytest.mark.parametrize("name", REST_POSE)
def test_a_known_name_stays_as_it_is(name: str) -> None:
    assert canonical_names((name,)) == (name,)


@pytest.mark.parametrize(
    ("name", "number"), [("h36m-17", 17), ("h36m-16", 16), ("h36m-14", 14), ("3dhp-14", 14), ("mpii-16", 16)]
)
def test_a_joint_set_has_as_many_known_joints_as_its_name_says(name: str, number: int) -> None:
    found = joint_set(name)
    assert len(found) == len(set(found)) == number
    assert set(joint_keys(found)) <= set(REST_POSE)


def test_the_sets_of_human36m_are_parts_of_each_other_in_one_order() -> None:
    whole = JOINT_SETS["h36m-17"]
    assert JOINT_SETS["h36m-16"] == whole[1:]
    assert JOINT_SETS["h36m-14"] == tuple(whole[k] for k in (*range(1, 7), 8, *range(10, 17)))


def test_the_joints_of_mpii_stand_in_its_own_order() -> None:
    found = ("r_ankle", "r_knee", "r_hip", "l_hip", "l_knee", "l_ankle", "pelvis", "thorax", "upper_neck", "head_top")
    found += ("r_wrist", "r_elbow", "r_shoulder", "l_shoulder", "l_elbow", "l_wrist")
    assert joint_keys(JOINT_SETS["mpii-16"]) == joint_keys(found)
    assert Skeleton(found).parents == (1, 2, 6, 6, 3, 4, -1, 6, 7, 8, 11, 12, 7, 7, 13, 14)


def test_an_unknown_set_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"^joint set: 'h36m17' is not known\. Did you mean h36m-17\?$"):
        joint_set("h36m17")


def test_the_bones_of_human36m_are_its_own() -> None:
    assert Skeleton(JOINT_SETS["h36m-17"]).parents == H36M_PARENTS
    assert Skeleton(JOINT_SETS["h36m-17"]).bones == tuple((p, c) for c, p in enumerate(H36M_PARENTS) if p >= 0)


def test_a_joint_hangs_on_its_nearest_ancestor_that_is_there() -> None:
    skeleton = Skeleton(("Head", "left_wrist", "Spine", "LShoulder", "antenna"))
    assert skeleton.parents == (2, 3, -1, 2, -1)  # no neck, no thorax, no elbow


def test_every_bone_but_the_roots_is_there_in_every_set() -> None:
    for joints in JOINT_SETS.values():
        roots = [k for k, parent in enumerate(Skeleton(joints).parents) if parent < 0]
        assert len(Skeleton(joints).bones) == len(joints) - len(roots)


def test_the_root_is_the_hip_wherever_it_stands() -> None:
    assert Skeleton(("Head", "pelvis")).root == 1
    assert Skeleton(JOINT_SETS["h36m-16"]).root is None


def test_the_rest_pose_is_a_person_who_stands_upright_with_the_left_on_their_left() -> None:
    skeleton = Skeleton(JOINT_SETS["h36m-17"])
    at = dict(zip(skeleton.joints, skeleton.rest_pose, strict=True))
    assert at["Head"][2] > at["Thorax"][2] > at["Hip"][2] > at["LKnee"][2] > at["LFoot"][2]
    assert at["Hip"].tolist() == [0, 0, 0]
    lengths = [np.linalg.norm(at[skeleton.joints[c]] - at[skeleton.joints[p]]) for p, c in skeleton.bones]
    assert 50 < min(lengths) < max(lengths) < 700


def test_the_rest_pose_is_the_same_on_both_sides() -> None:
    for name, (x, y, z) in REST_POSE.items():
        other = {"L": "R", "R": "L"}.get(name[0], "") + name[1:]
        if other in REST_POSE:
            assert REST_POSE[other] == (-x, y, z)
        else:
            assert x == 0


def test_a_rest_pose_of_unknown_joints_is_refused() -> None:
    assert not Skeleton(("Hip", "antenna")).is_known
    with pytest.raises(PoseDataError, match=r"^joints: antenna not known; expected names such as RFoot\.$"):
        Skeleton(("Hip", "antenna")).rest_pose  # noqa: B018


def test_sides_are_told_by_name() -> None:
    assert Skeleton(("left_knee", "RWrist", "Spine", "Lantern")).side == ("left", "right", "middle", "middle")
