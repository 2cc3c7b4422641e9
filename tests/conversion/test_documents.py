"""JSON documents of pose tools as they are converted, each from a file that is written here."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import posecal
from posecal.cli import app
from posecal.conversion import convert
from posecal.errors import PoseDataError
from tests.helpers.tables import JOINTS, Array, K, M, wide


def test_openpose_a_file_per_frame(poses: Array, tmp_path: Path) -> None:
    files = []
    for m in range(M):
        keypoints = np.concatenate([poses[m, :, :2], np.full((K, 1), 0.7)], axis=1).ravel().tolist()
        files.append(tmp_path / f"walk_{m:03}_keypoints.json")
        files[-1].write_text(json.dumps({"version": 1.3, "people": [{"pose_keypoints_2d": keypoints}]}))
    members, assumed = convert(files, joints=JOINTS)
    np.testing.assert_allclose(members["truth"], poses[..., :2])
    assert members["unit"] == "px"
    assert members["frame_id"][2] == "walk_002_keypoints"
    assert "each of 6 files is one frame" in assumed


def test_panoptic(tmp_path: Path) -> None:
    joints = np.random.default_rng(1).normal(0, 90, (19, 4))
    joints[:, 3] = 0.5
    joints[4, 3] = -1  # what Panoptic writes where it saw no joint
    (tmp_path / "a.json").write_text(
        json.dumps({"frame": 7, "bodies": [{"id": 0, "joints19": joints.ravel().tolist()}]})
    )
    members, assumed = convert(tmp_path / "a.json")
    assert np.flatnonzero(~members["valid"][0]).tolist() == [4]
    np.testing.assert_allclose(members["truth"][members["valid"]], np.delete(joints[:, :3], 4, axis=0))
    assert "joints of a confidence of 0 or less are not known" in assumed
    assert members["unit"] == "cm"
    assert members["joints"].tolist() == list(posecal.JOINT_SETS["panoptic-19"])
    assert members["frame_id"].tolist() == ["7"]
    assert "lengths are in cm, as the data set has them" in assumed


@pytest.mark.parametrize(("number", "joint_set"), [(25, "body-25"), (18, "coco-18"), (15, "")])
def test_joints_of_openpose_are_named_by_their_number(tmp_path: Path, number: int, joint_set: str) -> None:
    keypoints = np.random.default_rng(0).uniform(1, 500, (number, 3))
    (tmp_path / "a.json").write_text(json.dumps({"people": [{"pose_keypoints_2d": keypoints.ravel().tolist()}]}))
    members, assumed = convert(tmp_path / "a.json")
    np.testing.assert_allclose(members["truth"][0], keypoints[:, :2])
    assert members.get("joints", np.array([])).tolist() == list(posecal.JOINT_SETS.get(joint_set, ()))
    assert (f"joints are those of {joint_set}, by their number" in assumed) == bool(joint_set)


def people(poses: Array, tool: str) -> dict[str, object]:
    """Two people in each frame, the second one first, as a tool writes them."""
    full = np.concatenate([np.stack([poses + 5, poses]), np.ones((2, M, K, 1))], axis=3)
    if tool == "mmpose":
        frames = [[{"keypoints": full[p, m, :, :3].tolist()} for p in range(2)] for m in range(M)]
        return {"instance_info": [{"frame_id": m + 1, "instances": some} for m, some in enumerate(frames)]}
    if tool == "panoptic":
        return {"bodies": [{"id": 9 - p, "joints19": np.resize(full[p, 0], 76).tolist()} for p in range(2)]}
    return {"people": [{"pose_keypoints_3d": full[p, 0].ravel().tolist()} for p in range(2)]}


@pytest.mark.parametrize(
    ("tool", "ids", "kind"),
    [("openpose", "01", "place in the list"), ("mmpose", "01", "place in the list"), ("panoptic", "98", "id")],
)
def test_one_of_several_people_is_chosen_and_none_is_taken_unasked(
    poses: Array, tmp_path: Path, tool: str, ids: str, kind: str
) -> None:
    (tmp_path / "a.json").write_text(json.dumps(people(poses, tool)))
    words = (
        rf'^a\.json: 2 people in a frame; expected one\. Pass person="{ids[0]}", or another of {ids[0]}, {ids[1]} '
        rf"\(by {kind}\)\.$"
    )
    with pytest.raises(PoseDataError, match=words):
        convert(tmp_path / "a.json", unit="m")
    members, _ = convert(tmp_path / "a.json", person=ids[1])
    np.testing.assert_allclose(members["truth"][0, :K], poses[0])
    assert convert(tmp_path / "a.json", person=int(ids[0]))[0]["truth"][0, 0, 0] == pytest.approx(poses[0, 0, 0] + 5)
    words = rf"^a\.json: no person 7 in a frame; it holds {ids[0]}, {ids[1]} \(by {kind}\)\.$"
    with pytest.raises(PoseDataError, match=words):
        convert(tmp_path / "a.json", person=7)
    out = str(tmp_path / "out.npz")
    done = CliRunner().invoke(app, ["convert", str(tmp_path / "a.json"), "-o", out, "--person", ids[1], "--unit", "cm"])
    assert done.exit_code == 0, done.output


def test_a_person_of_a_file_without_people_is_refused(poses: Array, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(poses.tolist()))
    for path in (tmp_path / "a.json", wide(poses, tmp_path / "a.csv")):
        with pytest.raises(PoseDataError, match=rf"^person: 0 for {path.name}.*; expected "):
            convert(path, person=0)


def test_frames_of_mmpose_without_people_are_left_out(poses: Array, tmp_path: Path) -> None:
    frames = [{"frame_id": 3, "instances": []}, {"frame_id": 4, "instances": [{"keypoints": poses[0].tolist()}]}]
    (tmp_path / "a.json").write_text(json.dumps({"instance_info": frames}))
    members, assumed = convert(tmp_path / "a.json", unit="m")
    assert (members["frame_id"].tolist(), assumed[0]) == (["4"], "left out: 1 frame without people")
    (tmp_path / "a.json").write_text(json.dumps({"instance_info": frames[:1]}))
    with pytest.raises(PoseDataError, match=r"^a\.json: no people in 1 frames; expected one in some\.$"):
        convert(tmp_path / "a.json", unit="m")


def test_frames_without_the_chosen_person_are_left_out_and_counted(poses: Array, tmp_path: Path) -> None:
    def one(m: int, track: int) -> dict[str, object]:
        return {"keypoints": poses[m].tolist(), "track_id": track}

    found = [[one(0, 4)], [], [one(3, 5), one(2, 4)], [one(3, 5)]]
    frames = [{"frame_id": m, "instances": some} for m, some in enumerate(found)]
    (tmp_path / "a.json").write_text(json.dumps({"instance_info": frames}))
    members, assumed = convert(tmp_path / "a.json", unit="m", person=4)
    np.testing.assert_allclose(members["truth"], poses[[0, 2]])
    assert (members["frame_id"].tolist(), assumed[0]) == (["0", "2"], "left out: 2 frames without person 4")
    with pytest.raises(PoseDataError, match=r"^a\.json: no person 0 in a frame; it holds 4 \(by track_id\)\.$"):
        convert(tmp_path / "a.json", unit="m", person=0)
    files = [tmp_path / f"{m}.json" for m in range(3)]
    for m, path in enumerate(files):
        keypoints = np.concatenate([poses[m], np.ones((K, 1))], axis=1).ravel().tolist()
        path.write_text(json.dumps({"people": [{"pose_keypoints_3d": keypoints}] * (m != 1)}))
    members, assumed = convert(files, unit="mm")
    np.testing.assert_allclose(members["truth"], poses[[0, 2]])
    assert (members["frame_id"].tolist(), assumed[1]) == (["0", "2"], "left out: 1 frame without people")
    with pytest.raises(PoseDataError, match=r"^1\.json: 0 people in a frame; expected one\.$"):
        convert(files, unit="mm", each_file="hypothesis")


def test_interhand(tmp_path: Path) -> None:
    world = np.random.default_rng(2).normal(0, 90, (2, 42, 3))
    seen = np.ones((42, 1))
    seen[5] = 0
    frames = {str(m): {"world_coord": world[m].tolist(), "joint_valid": seen.tolist()} for m in range(2)}
    (tmp_path / "a.json").write_text(json.dumps({"0": frames}))
    members, _ = convert(tmp_path / "a.json")
    np.testing.assert_allclose(members["truth"][:, :5], world[:, :5])
    assert not members["valid"][:, 5].any()
    assert members["unit"] == "mm"
    assert members["sequence"].tolist() == ["0", "0"]


def test_results_of_mmpose(poses: Array, tmp_path: Path) -> None:
    frames = [
        {"frame_id": m, "instances": [{"keypoints": poses[m].tolist(), "keypoint_scores": [0.5] * K}]} for m in range(M)
    ]
    meta = {"keypoint_id2name": {str(k): name for k, name in enumerate(JOINTS)}}
    (tmp_path / "a.json").write_text(json.dumps({"meta_info": meta, "instance_info": frames}))
    members, _ = convert(tmp_path / "a.json", unit="m")
    np.testing.assert_allclose(members["truth"], poses)
    assert members["joints"].tolist() == JOINTS


def test_nested_lists(poses: Array, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(poses.tolist()))
    members, assumed = convert(tmp_path / "a.json", joints=JOINTS)
    np.testing.assert_allclose(members["truth"], poses)
    assert "no unit is stated: evaluate takes mm, or refuses what can't be mm; unit declares another" in assumed
