"""Pairs of poses and keypoints: declared layouts and units, and invalid files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError, PoseFileError
from posecal_models.contract import Context
from posecal_models.data.keypoint_set import KeypointSet
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.mocap import MocapPoses
from posecal_models.data.standardizer import check_pixels
from posecal_models.data.unit_checks import check_millimetres
from tests.models.test_data_formats import numbers

NAMES = ("Hip", "RHip", "RKnee")
M = 3  # as many as joints, so that no shape tells an axis


def pairs_file(path: Path, **changes: object) -> np.ndarray:
    """Three poses of three joints; a change to None takes a member out."""
    poses = numbers(M, 3, 3)
    members = {
        "truth": poses,
        "unit": "mm",
        "joints": list(NAMES),
        "keypoints_2d": numbers(M, 3, 2, seed=1),
        "subject": ["S1", "S1", "S2"],
    }
    np.savez(path, **{name: array for name, array in {**members, **changes}.items() if array is not None})
    return poses


def relative(poses: np.ndarray) -> np.ndarray:
    return poses[:, 1:] - poses[:, :1]


@pytest.mark.parametrize("axes", ["MKD", "KMD", "MDK", "DKM", "M(KD)", "M(DK)"])
def test_the_layout_of_the_truth_is_the_declared_one(tmp_path, axes):
    poses = numbers(M, 3, 3)
    stored = poses.transpose(["MKD".index(letter) for letter in axes if letter in "MKD"])
    stored = stored.reshape(M, 9) if "(" in axes else stored
    pairs_file(tmp_path / "a.npz", truth=stored, axes=axes)
    np.testing.assert_allclose(LiftingSet.load(tmp_path / "a.npz").poses, relative(poses), rtol=1e-5, atol=1e-4)


def test_clips_of_frames_are_poses_one_after_another(tmp_path):
    poses = numbers(6, 3, 3)
    pairs_file(
        tmp_path / "a.npz",
        truth=poses.reshape(2, 3, 3, 3),
        axes="MTKD",
        keypoints_2d=numbers(6, 3, 2),
        subject=["S1"] * 6,
    )
    np.testing.assert_allclose(LiftingSet.load(tmp_path / "a.npz").poses, relative(poses), rtol=1e-5, atol=1e-4)


def test_without_a_unit_poses_are_in_mm(tmp_path):
    poses = pairs_file(tmp_path / "a.npz", unit=None)
    np.testing.assert_allclose(LiftingSet.load(tmp_path / "a.npz").poses, relative(poses), rtol=1e-5, atol=1e-4)


def test_the_truth_may_be_called_gt(tmp_path):
    poses = numbers(M, 3, 3)
    pairs_file(tmp_path / "a.npz", truth=None, gt=poses / 1000, unit="m")
    np.testing.assert_allclose(LiftingSet.load(tmp_path / "a.npz").poses, relative(poses), rtol=1e-5, atol=1e-4)


def test_poses_without_a_hip_are_taken_where_they_are_said_to_be_relative_to_it(tmp_path):
    poses = numbers(M, 3, 3)
    names = ["RFoot", "RHip", "RKnee"]
    pairs_file(tmp_path / "a.npz", truth=poses, joints=names, root_relative=True)
    pairs = LiftingSet.load(tmp_path / "a.npz")
    assert pairs.joints == tuple(names)
    np.testing.assert_allclose(pairs.poses, poses, rtol=1e-5)


@pytest.mark.parametrize("said", [None, False])
def test_poses_without_a_hip_are_refused_otherwise(tmp_path, said):
    pairs_file(tmp_path / "a.npz", joints=["RFoot", "RHip", "RKnee"], root_relative=said)
    with pytest.raises(PoseDataError, match=r"a\.npz: no joint Hip among RFoot, .*Store the hip too, or .*root_rel"):
        LiftingSet.load(tmp_path / "a.npz")


def test_our_own_pairs_of_motion_hold_the_hip(tmp_path, motion_file):
    MocapPoses(motion_file).project(views=1, every=5).save(tmp_path / "a.npz")
    assert LiftingSet.load(tmp_path / "a.npz").joints == joint_set("h36m-16")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axes": "NMKD"}, "axes: 'NMKD' is no layout"),
        ({"axes": "MK"}, "axes: MK names 2 axes; the array has 3"),
        ({"axes": ["MKD", "MKD"]}, "axes has 2 values; expected one word"),
        ({"truth": numbers(M, 4, 3)}, r"truth \(3, 4, 3\); expected \(M, 3, 3\)"),
        ({"truth": numbers(M, 3, 2)}, r"truth \(3, 3, 2\); expected \(M, 3, 3\)"),
        ({"truth": numbers(M, 3, 3).astype(str)}, "truth: dtype <U.*; expected real numbers"),
        ({"truth": numbers(M, 3, 3) / 1000}, r"truth looks like metres: joints lie 0\.\d+ from .*Store unit"),
        ({"truth": numbers(M, 3, 3) / 1000, "unit": None}, "truth looks like metres"),
        ({"subject": ["S1"]}, r"subject \(1,\); expected \(3,\)"),
        ({"frame_id": [1, 2]}, r"frame_id \(2,\); expected \(3,\)"),
        ({"joints": ["Hip", "RHip", "right_hip"]}, "joints name RHip = right_hip more than once"),
        ({"keypoint_joints": ["Hip", "RHip", "RHip"]}, "names of the keypoints name RHip more than once"),
        ({"joints": "Hip"}, r"joints \(\); expected"),
        ({"keypoints_observed": np.full((3, 3), 0.7)}, "keypoints_observed: dtype float64; expected bool"),
        ({"keypoints_2d": np.full((3, 3, 2), "1")}, "keypoints_2d: dtype <U1; expected real numbers"),
        ({"unit": "inch"}, "unit: 'inch'"),
    ],
)
def test_pairs_that_do_not_fit_are_refused(tmp_path, changes, words):
    pairs_file(tmp_path / "a.npz", **changes)
    with pytest.raises(PoseDataError, match=words):
        LiftingSet.load(tmp_path / "a.npz")


def test_a_file_without_poses_is_named_with_what_it_holds(tmp_path):
    pairs_file(tmp_path / "a.npz", truth=None)
    with pytest.raises(PoseFileError, match=r"a\.npz: lacks truth; it holds joints, keypoints_2d"):
        LiftingSet.load(tmp_path / "a.npz")


def test_ones_and_zeros_mark_observed_keypoints(tmp_path):
    pairs_file(tmp_path / "a.npz", keypoints_observed=[[1, 0, 1]] * 3)
    assert KeypointSet.load(tmp_path / "a.npz").observed.tolist() == [[True, False, True]] * 3


# --- sizes --------------------------------------------------------------------------------------------------------


def test_poses_that_are_not_finite_are_ignored_in_the_size():
    poses = numbers(5, 3, 3)
    poses[:4] /= 1000
    poses[:4, 0] = np.nan
    check_millimetres(poses, "poses")
    check_millimetres(poses[:4], "poses")
    check_millimetres(poses[:0], "poses")


def test_the_median_size_decides():
    poses = numbers(7, 3, 3)
    poses[:3] /= 1000
    check_millimetres(poses, "poses")
    poses[3] /= 1000
    with pytest.raises(PoseDataError, match="poses looks like metres"):
        check_millimetres(poses, "poses")


# --- keypoints that a standardizer is fitted on -------------------------------------------------------------------


def keypoints() -> torch.Tensor:
    return 60 * torch.randn(50, 4, 2, generator=torch.Generator().manual_seed(0)) + 500


def test_keypoints_that_were_normalised_are_refused():
    observed = torch.ones(50, 4, dtype=torch.bool)
    check_pixels(Context(keypoints(), observed))
    with pytest.raises(
        PoseDataError, match=r"standard deviation 0\.1\d* about their centre; expected 2 pixels or more"
    ):
        check_pixels(Context(keypoints() / 500 - 1, observed))


def test_keypoints_that_are_not_observed_are_ignored_in_the_spread():
    seen, observed = keypoints() / 500, torch.ones(50, 4, dtype=torch.bool)
    seen[:, 0], observed[:, 0] = 1e6, False
    with pytest.raises(PoseDataError, match="look normalised already"):
        check_pixels(Context(seen, observed))
    seen = keypoints()
    seen[:, 0] = torch.nan
    check_pixels(Context(seen, observed))


def test_one_keypoint_alone_has_no_spread():
    check_pixels(Context(keypoints()[:, :1], torch.ones(50, 1, dtype=torch.bool)))
