"""Joint names: read by whole lists, matched by what they mean, printed as the user spells them."""

from __future__ import annotations

import re

import numpy as np
import pytest

import posecal
from posecal.data.joint_names import find_joint, joint_keys, match_joints, repeated_names, side_of
from posecal.data.skeleton import JOINT_SET_TABLE, JOINT_SETS, Skeleton, known_set
from posecal.engine.protocol import named_joints
from posecal.errors import PoseDataError

H36M = JOINT_SETS["h36m-17"]
OWN_H36M = (
    *("Pelvis", "RHip", "RKnee", "RAnkle", "LHip", "LKnee", "LAnkle", "Spine1", "Neck", "Head", "Site"),
    *("LShoulder", "LElbow", "LWrist", "RShoulder", "RElbow", "RWrist"),
)


def arrays(joints: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    truth = rng.normal(0, 300, (6, joints, 3))
    return truth + rng.normal(0, 50, (4, 6, joints, 3)), truth


def matched(names: tuple[str, ...], others: tuple[str, ...]) -> dict[str, str]:
    return {names[k]: others[j] for k, j in match_joints(names, others)[0].items()}


def test_a_synonym_gives_way_where_the_list_has_both_names() -> None:
    assert joint_keys(("LAnkle", "LFoot", "Head")) == ("LFoot", "lfoot", "Head")
    assert joint_keys(("head_top", "head")) == ("Head", "head")
    for name in ("smpl-24", "3dhp-28", "3dhp-17", "halpe-26", "h36m-32"):
        assert len(set(joint_keys(JOINT_SETS[name]))) == len(JOINT_SETS[name])


def test_human36ms_own_list_means_the_joints_of_the_field() -> None:
    assert joint_keys(OWN_H36M) == H36M
    assert matched(OWN_H36M, H36M)["Head"] == "Neck/Nose"
    bones = JOINT_SETS["h36m-32"]
    of_bones = {"Hips": "Hip", "RightUpLeg": "RHip", "RightFoot": "RFoot", "Spine1": "Spine", "Neck": "Thorax"}
    of_bones |= {"Head": "Neck/Nose", "Site of Head": "Head", "LeftArm": "LShoulder", "LeftHand": "LWrist"}
    assert of_bones.items() <= matched(bones, H36M).items()
    assert len(matched(bones, H36M)) == 17


@pytest.mark.parametrize("neck", ["Neck", "neck_base"])
def test_a_neck_between_thorax_and_head_is_human36ms_neck(neck: str) -> None:
    names = tuple(neck if name == "Neck/Nose" else name for name in H36M)
    assert joint_keys(names) == H36M


def test_a_name_that_may_be_two_joints_of_the_other_list_is_ambiguous() -> None:
    assert match_joints(("RFoot", "Head"), ("right_ankle", "right_foot", "headtop")) == (
        {1: 2},
        ["RFoot may be right_ankle or right_foot"],
    )
    assert match_joints(("right_ankle", "right_foot"), ("RAnkle",)) == ({0: 0}, [])
    assert match_joints(("right_ankle", "right_foot"), ("RFoot", "R.Ankle")) == ({0: 1, 1: 0}, [])
    assert match_joints(("Thorax", "Neck"), ("Neck",))[1] == ["Neck may be Thorax or Neck"]


# Names of one joint that data sets place apart, and the sets in which each stands.
APART = ("Hip, RHip, Spine, Thorax, Neck/Nose, Head", "nose, left_eye, right_eye, neck, RHip, Hip")


def test_a_nose_is_no_neck_and_joins_noses_alone() -> None:
    own, their = (tuple(names.split(", ")) for names in APART)
    assert matched(own, their) == {"Hip": "Hip", "RHip": "RHip", "Thorax": "neck"}
    assert match_joints(JOINT_SETS["coco-17"], JOINT_SETS["halpe-26"])[0][0] == 0
    for neck in ("Thorax", "Neck"):  # without eyes it is the joint between neck and head
        names = ("Hip", "Spine", neck, "Nose", "Head", "LWrist", "RWrist")
        assert joint_keys(names)[2:5] == ("Thorax", "Neck/Nose", "Head")
    with pytest.raises(PoseDataError) as refused:
        files_match("coco-17", "h36m-17")
    assert "coco-17 lacks 5 of the other's joints (Hip, Spine, Thorax" in str(refused.value)
    assert "h36m-17 lacks 5 of the other's joints (nose, left_eye, right_eye" in str(refused.value)


def test_the_base_of_a_head_is_not_taken_for_its_top() -> None:
    without_site = tuple(name for name in OWN_H36M if name != "Site")
    for names in (without_site, JOINT_SETS["smpl-24"]):
        head = next(name for name in names if name.lower() == "head")
        assert f"{head} may be Neck/Nose or Head" in match_joints(names, H36M)[1]
        assert f"{head} may be HeadTop or another point" in match_joints(JOINT_SETS["lsp-14"], names)[1]
    assert matched(JOINT_SETS["smpl-24"], JOINT_SETS["smplx-22"])["head"] == "head"
    assert matched(H36M, JOINT_SETS["3dhp-17"]) == {
        **dict(zip(H36M[:4], ("pelvis", "right_hip", "right_knee", "right_ankle"), strict=True)),
        **dict(zip(H36M[4:9], ("left_hip", "left_knee", "left_ankle", "spine", "neck"), strict=True)),
        **dict(zip(H36M[10:14], ("head_top", "left_shoulder", "left_elbow", "left_wrist"), strict=True)),
        **dict(zip(H36M[14:], ("right_shoulder", "right_elbow", "right_wrist"), strict=True)),
    }


def test_a_neck_beside_two_necks_is_ambiguous() -> None:
    assert match_joints(JOINT_SETS["lsp-14"], JOINT_SETS["mpii-16"])[1] == ["Neck may be Thorax or UpperNeck"]
    assert match_joints(("UpperNeck",), ("neck",))[1] == ["neck may be UpperNeck or another point"]


def test_joints_that_are_placed_apart_are_joined_with_a_remark() -> None:
    data = files_match("lsp-14", "h36m-14")
    assert (
        "joints: Thorax and Neck, Head and HeadTop are taken as one; rename them where they are different points."
        in data.remarks
    )
    assert not any("taken as one" in remark for remark in files_match("h36m-17", "h36m-17").remarks)


def test_ambiguous_names_are_refused_with_all_spellings() -> None:
    x, y = arrays(24)
    truth = posecal.PoseData(x, y, unit="mm", axes="NMKD", joints="smpl-24")
    assert truth.joints == JOINT_SETS["smpl-24"]
    with pytest.raises(PoseDataError, match=r"LFoot may be left_ankle or left_foot"):
        files_match("smpl-24", "h36m-17")


def files_match(hypotheses: str, truth: str) -> posecal.PoseData:
    from posecal.data.layout import MemoryArray
    from posecal.data.pose_data import match_poses
    from posecal.data.stored_poses import StoredPoses

    x, _ = arrays(len(JOINT_SETS[hypotheses]))
    _, y = arrays(len(JOINT_SETS[truth]))
    return match_poses(
        StoredPoses(hypotheses, MemoryArray(x), unit="mm", joints=JOINT_SETS[hypotheses]),
        StoredPoses(truth, MemoryArray(y), unit="mm", joints=JOINT_SETS[truth]),
    )


def test_the_users_names_are_printed_and_options_take_either_spelling() -> None:
    x, y = arrays(17)
    report = posecal.evaluate(x, y, unit="mm", joints=OWN_H36M, root_joint="Hip")
    assert "relative to Pelvis" in str(report)
    assert report.table.query("joint == 'RAnkle'").shape[0] > 0
    assert report.value("mpjpe", joint="right_foot") == report.value("mpjpe", joint="RAnkle")
    assert any("Site is Head" in remark for remark in report.remarks)
    plain = posecal.evaluate(x, y, unit="mm", joints="h36m-17")
    assert (report["pck"], report["cps"]) == (plain["pck"], plain["cps"])
    assert report.signature == plain.signature
    assert named_joints("joints", "RFoot, Neck", OWN_H36M) == ("RAnkle", "Neck")
    assert named_joints("cps_joints", "all but Spine", OWN_H36M)[7] == "Neck"
    assert len(named_joints("pck_joints", "h36m-14", OWN_H36M)) == 14


def test_a_joint_is_found_as_it_is_spelt_before_what_it_means() -> None:
    assert find_joint("Head", OWN_H36M) == 9
    assert find_joint("Neck/Nose", OWN_H36M) == 9
    assert find_joint("left foot", JOINT_SETS["smpl-24"]) == 10
    assert find_joint("antenna", OWN_H36M) is None
    assert (find_joint("16", OWN_H36M), find_joint("17", OWN_H36M)) == (16, None)


def test_repeated_ends_are_told_apart_by_the_joint_before_them() -> None:
    x, y = arrays(5)
    data = posecal.PoseData(x, y, axes="NMKD", unit="mm", joints=("Hips", "Head", "Site", "Toe", "Site"))
    assert data.joints == ("Hips", "Head", "Site of Head", "Toe", "Site of Toe")
    assert repeated_names(("r_hip", "RHip", "Head")) == ["r_hip = RHip"]


def test_names_near_known_ones_get_a_remark() -> None:
    x, y = arrays(4)
    remarks = posecal.PoseData(x, y, axes="NMKD", unit="mm", joints=("Hip", "RAnkel", "tail", "mid_neck")).remarks
    (found,) = [remark for remark in remarks if "not known" in remark]
    assert re.search(r"(?i)RAnkel \(like RAnkle\), mid_neck \(like Neck\) not known", found)
    known = posecal.PoseData(*arrays(24), axes="NMKD", unit="mm", joints="smpl-24").remarks
    assert not any("not known" in remark for remark in known)


def test_sides_are_read_in_each_spelling() -> None:
    names = ("left_index1", "R_Eye", "rThumb", "RWrist", "wrist left", "Lantern", "RIBS", "l.ulna", "root")
    sides = ("left", "right", "right", "right", "left", "middle", "middle", "left", "middle")
    assert tuple(map(side_of, names)) == sides


@pytest.mark.parametrize("name", JOINT_SETS)
def test_a_joint_set_has_one_tree_and_as_many_lefts_as_rights(name: str) -> None:
    entry = JOINT_SET_TABLE[name]
    skeleton = Skeleton(entry.names)
    assert len(entry.names) == int(name.split("-")[1]) if name != "ap-10k" else len(entry.names) == 17
    assert entry.source
    assert all(parent < len(entry.names) for parent in skeleton.parents)
    assert skeleton.side.count("left") == skeleton.side.count("right")
    if entry.parents:
        assert skeleton.parents == entry.parents
        assert known_set(entry.names[::-1]) == entry


def test_a_part_of_a_joint_set_keeps_its_bones() -> None:
    joints = ("wrist", "index_tip", "index1", "Pinky 3")
    assert Skeleton(joints).parents == (-1, 2, 0, 0)
