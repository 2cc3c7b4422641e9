"""Readers of other projects' formats, on tiny files written here; invalid ones are refused."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError, PoseFileError
from posecal_models.contract import Context
from posecal_models.data.cameras import Camera, read_cameras
from posecal_models.data.human36m import read_human36m
from posecal_models.data.keypoint_set import KeypointSet
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.npz import read_npz
from posecal_models.data.prohpe import read_prohpe
from posecal_models.data.videopose3d import OF_32, read_videopose3d

H36M, MPII = joint_set("h36m-17"), joint_set("mpii-16")


def numbers(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape) * 100


# --- VideoPose3D ------------------------------------------------------------------------------------------------


def videopose3d(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    room, image = numbers(5, 32, 3) / 1000, numbers(4, 17, 2, seed=1)
    tables = {"positions_3d": {"S1": {"Walking 1": room}}, "S2": {}}
    np.savez(folder / "3d.npz", positions_3d=tables["positions_3d"])
    np.savez(folder / "2d.npz", positions_2d={"S1": {"Walking 1": [image, image + 1]}}, metadata={"num_joints": 17})
    return room, image


def test_videopose3d_s_files_are_joined_and_turned_into_the_camera(tmp_path):
    room, image = videopose3d(tmp_path)
    quarter = Camera(np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]), np.zeros(3))
    pairs = read_videopose3d(tmp_path / "3d.npz", tmp_path / "2d.npz", {"S1": [quarter, quarter]})
    assert len(pairs) == 2 * 4  # two views of the four frames that both files have
    hip, knee = room[2, 0] * 1000, room[2, OF_32[5]] * 1000
    x, y, z = knee - hip
    np.testing.assert_allclose(pairs.poses[2, H36M.index("LKnee") - 1], [y, -z, -x], rtol=1e-5)
    np.testing.assert_allclose(pairs.keypoints[4 + 2, 4], image[2, 4] + 1, rtol=1e-6)
    assert pairs.frame_id[6] == "S1/Walking 1/1/2"
    assert (pairs.action[0], pairs.sequence[0], pairs.camera[6]) == ("Walking", "S1 Walking 1", "1")


def test_videopose3d_without_cameras_is_refused(tmp_path):
    videopose3d(tmp_path)
    with pytest.raises(PoseDataError, match="cameras: none for S1"):
        read_videopose3d(tmp_path / "3d.npz", tmp_path / "2d.npz", {})


def test_a_file_that_is_not_videopose3d_s_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", poses=numbers(2, 2))
    with pytest.raises(PoseFileError, match="no positions_3d by subject and action"):
        read_videopose3d(tmp_path / "a.npz", tmp_path / "a.npz", {})


def test_cameras_come_from_a_plain_file(tmp_path):
    np.savez(tmp_path / "c.npz", subject=["S1", "S1"], rotation=[np.eye(3)] * 2, position=[[0, 0, 0], [1, 2, 3]])
    cameras = read_cameras(tmp_path / "c.npz")
    np.testing.assert_array_equal(cameras["S1"][1].position, [1, 2, 3])
    np.savez(tmp_path / "c.npz", subject=["S1"], rotation=[np.eye(3) * 2], position=[[0, 0, 0]])
    with pytest.raises(PoseDataError, match="rotation of camera 0 is none"):
        read_cameras(tmp_path / "c.npz")


# --- ProHPE -----------------------------------------------------------------------------------------------------


def prohpe(folder: Path, *, frames: int = 3, flagged: tuple[int, str] = (1, "RWrist")) -> tuple[np.ndarray, np.ndarray]:
    """A pickle in ProHPE's form; one keypoint of one frame is uncertain."""
    poses, keypoints = numbers(frames, 17, 3), numbers(frames, 16, 2, seed=1)
    fits = np.ones((frames, 16, 7))
    fits[flagged[0], MPII.index(flagged[1]), 5] = 5.1
    table = {
        "3d_gt": poses.transpose(0, 2, 1).reshape(frames, 51),
        "2d_hrnet": keypoints.transpose(0, 2, 1).reshape(frames, 32),
        "gaussfit": fits.reshape(frames, 112),
        "imgpath": [f"/S9/Directions.54138969/{4 * i}.jpg" for i in range(frames)],
    }
    empty = {"3d_gt": [], "2d_hrnet": [], "gaussfit": [], "imgpath": []}
    tree = {"S9": {"Directions": {"0": {"54138969": table, "55011271": empty}}}}
    (folder / "merged.pickle").write_bytes(pickle.dumps(tree))
    return poses, keypoints


def test_prohpe_s_joints_are_joined_by_name(tmp_path):
    poses, keypoints = prohpe(tmp_path)
    pairs = read_prohpe(tmp_path / "merged.pickle")
    assert pairs.joints == H36M[1:]
    np.testing.assert_allclose(pairs.poses, poses[:, 1:] - poses[:, :1], rtol=1e-4, atol=1e-4)
    for name in ("RFoot", "LElbow", "Thorax", "Head"):
        column = pairs.keypoint_joints.index(name)
        of_mpii = MPII.index("HeadTop" if name == "Head" else name)
        np.testing.assert_allclose(pairs.keypoints[:, column], keypoints[:, of_mpii], rtol=1e-5)
    assert pairs.keypoint_joints == H36M  # with the hip, which a converted checkpoint reads the others relative to
    absent = [name for name, seen in zip(pairs.keypoint_joints, pairs.observed[0], strict=True) if not seen]
    assert absent == ["Spine", "Neck/Nose"]  # MPII has neither
    assert np.isnan(pairs.keypoints[:, H36M.index("Spine")]).all()
    assert pairs.frame_id[1] == "S9/Directions.54138969/4"


def test_prohpe_s_flag_of_a_right_wrist_removes_the_right_wrist(tmp_path):
    prohpe(tmp_path)
    pairs = read_prohpe(tmp_path / "merged.pickle")
    changed = np.argwhere(pairs.observed[0] != pairs.observed[1]).ravel()
    assert [pairs.keypoint_joints[i] for i in changed] == ["RWrist"]


def test_as_released_a_flag_of_a_right_wrist_removes_the_left_shoulder(tmp_path):
    prohpe(tmp_path)
    pairs = read_prohpe(tmp_path / "merged.pickle", join="as-released")
    removed = [name for name, seen in zip(pairs.keypoint_joints, pairs.observed[1], strict=True) if not seen]
    assert removed == ["Spine", "Neck/Nose", "Head", "LShoulder"]  # MPII lacks the first two
    Context(torch.from_numpy(pairs.keypoints), torch.from_numpy(pairs.observed))  # no observed one is NaN


def test_a_pickle_of_another_form_is_refused(tmp_path):
    (tmp_path / "a.pickle").write_bytes(pickle.dumps({"S9": [1, 2]}))
    with pytest.raises(PoseFileError, match="not subject, action, subaction, camera"):
        read_prohpe(tmp_path / "a.pickle")


def test_a_table_of_another_width_is_refused(tmp_path):
    prohpe(tmp_path)
    tree = pickle.loads((tmp_path / "merged.pickle").read_bytes())
    tree["S9"]["Directions"]["0"]["54138969"]["3d_gt"] = np.zeros((3, 48))
    (tmp_path / "merged.pickle").write_bytes(pickle.dumps(tree))
    with pytest.raises(PoseDataError, match=r"3d_gt \(3, 48\); expected \(3, 51\)"):
        read_prohpe(tmp_path / "merged.pickle")


# --- Human3.6M --------------------------------------------------------------------------------------------------


def cdf(path: Path, values: np.ndarray) -> None:
    import cdflib.cdfwrite

    path.parent.mkdir(parents=True, exist_ok=True)
    with_frames = values.reshape(1, len(values), -1)
    file = cdflib.cdfwrite.CDF(path, cdf_spec={"Compressed": 0}, delete=True)
    spec = {
        "Variable": "Pose",
        "Data_Type": 44,
        "Num_Elements": 1,
        "Rec_Vary": True,
        "Dim_Sizes": list(with_frames.shape[1:]),
    }
    file.write_var(spec, var_data=with_frames.astype(np.float32))
    file.close()


def test_human36m_s_own_files_are_read(tmp_path):
    pose, projection = numbers(9, 32, 3), numbers(9, 32, 2, seed=1)
    for subject in ("S1", "S9"):
        for kind, values in (("D3_Positions_mono", pose), ("D2_Positions", projection)):
            cdf(tmp_path / subject / "MyPoseFeatures" / kind / "Walking 1.54138969.cdf", values)
    pairs = read_human36m(tmp_path, every=4, test_every=8)
    assert pairs.frame_id.tolist() == [
        *(f"S1/Walking 1/54138969/{row}" for row in (0, 4, 8)),
        *(f"S9/Walking 1/54138969/{row}" for row in (0, 8)),
    ]
    np.testing.assert_allclose(pairs.poses[1, H36M.index("Head") - 1], pose[4, 15] - pose[4, 0], rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(pairs.keypoints[2, H36M.index("RWrist")], projection[8, 27], rtol=1e-5)
    assert pairs.action[0] == "Walking"


def test_an_empty_folder_of_human36m_is_refused(tmp_path):
    with pytest.raises(PoseFileError, match="no D3_Positions_mono"):
        read_human36m(tmp_path)


# --- our own files ----------------------------------------------------------------------------------------------


def lifting_set(poses: int = 4) -> LiftingSet:
    names = np.array([f"f{i}" for i in range(poses)])
    return LiftingSet(
        joints=("RHip", "RKnee", "RFoot"),
        poses=numbers(poses, 3, 3).astype(np.float32),
        keypoint_joints=("RFoot", "RHip"),
        keypoints=numbers(poses, 2, 2, seed=1).astype(np.float32),
        observed=np.arange(2 * poses).reshape(poses, 2) % 3 > 0,
        sigma=np.full((poses, 2), 3, np.float32),
        frame_id=names,
        sequence=names,
        subject=names,
        action=names,
        camera=names,
    )


def test_pairs_come_back_from_their_file(tmp_path):
    pairs = lifting_set()
    pairs.save(tmp_path / "a.npz")
    back = LiftingSet.load(tmp_path / "a.npz")
    assert back.joints == pairs.joints
    np.testing.assert_array_equal(back.poses, pairs.poses)
    assert back.keypoint_joints == ("Hip", "RHip", "RKnee", "RFoot")
    np.testing.assert_array_equal(back.keypoints[:, [3, 1]], pairs.keypoints)
    np.testing.assert_array_equal(back.observed[:, [3, 1]], pairs.observed)
    assert not back.observed[:, [0, 2]].any()
    assert back.frame_id.tolist() == pairs.frame_id.tolist()


def test_occluded_joints_are_those_without_an_observed_keypoint(tmp_path):
    pairs = lifting_set()
    pairs.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        hip, right_hip, knee, foot = file["occluded"].T
    assert not hip.any()
    assert knee.all()
    np.testing.assert_array_equal(right_hip, ~pairs.observed[:, 1])
    np.testing.assert_array_equal(foot, ~pairs.observed[:, 0])


def test_the_occluded_joints_of_a_file_stay_where_its_poses_are_split(tmp_path):
    """Declared in the file, also for joints whose keypoints were detected."""
    pairs = lifting_set()
    pairs.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        members = dict(file)
    members["occluded"] = np.roll(np.eye(4, dtype=bool), 2, axis=1) & (np.arange(4) > 0)
    np.savez(tmp_path / "b.npz", **members)
    LiftingSet.load(tmp_path / "b.npz").take(slice(1, 4)).save(tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as file:
        np.testing.assert_array_equal(file["occluded"], members["occluded"][1:])
        np.testing.assert_array_equal(file["keypoints_observed"], members["keypoints_observed"][1:])
    turned = LiftingSet.load(tmp_path / "b.npz").in_order_of(("RFoot", "RKnee", "RHip"))
    np.testing.assert_array_equal(turned.occluded, members["occluded"][:, [3, 2, 1]])
    np.savez(tmp_path / "b.npz", **{**members, "occluded": [True]})
    with pytest.raises(PoseDataError, match=r"b\.npz: occluded \(1,\); expected \(4, 4\)"):
        LiftingSet.load(tmp_path / "b.npz")
    assert LiftingSet.load(tmp_path / "a.npz").occluded is None  # the keypoints say it


def test_occluded_joints_are_no_keypoints_whatever_the_order_of_either(tmp_path):
    members = {"keypoints_2d": numbers(2, 3, 2), "keypoint_joints": ["LHip", "Nose", "RHip"]}
    hidden = [[False, True, False], [True, False, False]]
    np.savez(tmp_path / "k.npz", **members, joints=["Hip", "right_hip", "LHip"], occluded=hidden)
    assert KeypointSet.load(tmp_path / "k.npz").observed.tolist() == [[True, True, False], [True, True, True]]
    np.savez(tmp_path / "k.npz", **members, joints=np.array([b"Hip", b"right_hip", b"LHip"]), occluded=hidden)
    assert KeypointSet.load(tmp_path / "k.npz").observed.tolist() == [[True, True, False], [True, True, True]]
    np.savez(tmp_path / "k.npz", **members, joints=["Hip", "RHip"], occluded=hidden)
    with pytest.raises(PoseDataError, match=r"occluded \(2, 3\); expected \(2, 2\)"):
        KeypointSet.load(tmp_path / "k.npz")


def test_joints_and_keypoints_are_ordered_by_name():
    pairs = lifting_set().in_order_of(("RFoot", "right_hip"), ("RKnee", "right_hip"))
    np.testing.assert_array_equal(pairs.poses, lifting_set().poses[:, [2, 0]])
    assert not pairs.observed[:, 0].any()
    np.testing.assert_array_equal(pairs.keypoints[:, 1], lifting_set().keypoints[:, 1])


def test_a_joint_that_is_not_there_is_named():
    with pytest.raises(PoseDataError, match="joints: Head missing among RHip, RKnee, RFoot"):
        lifting_set().in_order_of(("Head", "RHip"))


def test_shapes_that_do_not_fit_are_all_named():
    with pytest.raises(PoseDataError, match=r"(?s)2 problems:.*observed \(3, 2\).*sigma \(3, 2\)"):
        LiftingSet(**{**vars(lifting_set()), "observed": np.ones((3, 2), bool), "sigma": np.ones((3, 2), np.float32)})


def test_keypoints_without_poses_are_read_and_nan_marks_missing_ones(tmp_path):
    keypoints = numbers(3, 2, 2)
    keypoints[1, 0, 1] = np.nan
    np.savez(tmp_path / "k.npz", keypoints_2d=keypoints, joints=["RHip", "LHip"])
    seen = KeypointSet.load(tmp_path / "k.npz")
    assert seen.observed.tolist() == [[True, True], [False, True], [True, True]]
    assert seen.frame_id.tolist() == ["0", "1", "2"]


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"keypoints_2d": np.zeros((3, 2, 2))}, "lacks keypoint_joints"),
        ({"keypoints_2d": np.zeros((3, 2)), "joints": ["a", "b"]}, r"keypoints_2d \(3, 2\); expected \(M, 2, 2\)"),
        ({"poses": np.zeros(3)}, "lacks keypoints_2d; it holds poses"),
    ],
)
def test_files_without_keypoints_are_refused(tmp_path, members, words):
    np.savez(tmp_path / "k.npz", **members)
    with pytest.raises(PoseFileError if "lacks" in words else PoseDataError, match=words):
        KeypointSet.load(tmp_path / "k.npz")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut off", b"not a zip"])
def test_a_damaged_npz_is_refused(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(PoseFileError, match=r"a\.npz: can't be read as \.npz"):
        read_npz(tmp_path / "a.npz")


def test_a_pickled_array_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", poses=np.array([{}], dtype=object))
    with pytest.raises(PoseDataError, match=r"a\.npz: poses: can't be read \(Objects are never unpickled"):
        read_npz(tmp_path / "a.npz")
