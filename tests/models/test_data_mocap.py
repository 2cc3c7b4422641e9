"""Motion capture: projection into virtual cameras, clips that share names, and invalid files."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from posecal.errors import PoseDataError
from posecal_models.cli import app, main
from posecal_models.config import Config
from posecal_models.data.cameras import Camera
from posecal_models.data.mocap import MocapPoses
from posecal_models.preparation import split


def mocap(path: Path, **changes) -> None:
    members = {
        "poses": np.array([[[0, 0, 1000], [0, 100, 500]]] * 4, float),
        "joints": ["Hip", "RKnee"],
        "unit": "mm",
        "subject": [1, 1, 2, 2],
        "clip_id": ["a", "a", "b", "b"],
    }
    np.savez(path, **{**members, **changes})


def test_motion_capture_is_projected_into_each_camera(tmp_path):
    mocap(tmp_path / "m.npz")
    pairs = MocapPoses(tmp_path / "m.npz").project(views=3, seed=1)
    assert len(pairs) == 4 * 3
    assert sorted(set(pairs.subject.tolist())) == ["S1", "S2"]
    # lengths are kept, and up in the world is against y in the image
    np.testing.assert_allclose(np.linalg.norm(pairs.poses[:, 0], axis=1), np.hypot(100, 500), rtol=1e-5)
    assert (pairs.poses[:, 0, 1] > 400).all()
    # a camera at about 5 m sees 510 mm as about 510 / 5000 * 1146 pixels; perspective and its place vary it
    hip_free = pairs.keypoints[:, 0]
    assert ((hip_free > 0) & (hip_free < 1100)).all()


def test_a_clip_s_cameras_do_not_depend_on_the_other_clips(tmp_path):
    mocap(tmp_path / "m.npz")
    poses = MocapPoses(tmp_path / "m.npz")
    both, one = poses.project(seed=3), poses.project(exclude=["S1"], seed=3)
    np.testing.assert_array_equal(both.take(both.subject == "S2").poses, one.poses)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joints": ["RHip", "RKnee"]}, "no Hip among RHip, RKnee"),
        ({"up": "y"}, "up is y; expected z"),
        ({"poses": np.zeros((4, 3, 3))}, r"poses \(4, 3, 3\); expected \(M, 2, 3\)"),
        ({"unit": "inch"}, "unit: 'inch'"),
    ],
)
def test_motion_capture_that_does_not_fit_is_refused(tmp_path, changes, words):
    mocap(tmp_path / "m.npz", **changes)
    with pytest.raises(PoseDataError, match=words):
        MocapPoses(tmp_path / "m.npz")


def test_an_unknown_subject_is_named(tmp_path):
    mocap(tmp_path / "m.npz")
    with pytest.raises(PoseDataError, match="subjects: S7 not there; expected some of S1, S2"):
        MocapPoses(tmp_path / "m.npz").project(exclude=["S7"])


def test_a_camera_refuses_points_behind_it():
    camera = Camera.looking_at((0, -5000, 0), (0, 0, 0))
    with pytest.raises(PoseDataError, match="1 of 2 points lie behind the camera"):
        camera.project(np.array([[0.0, 0, 0], [0, -6000, 0]]))


# --- clips whose names people share -------------------------------------------------------------------------------


def file_with_shared_names(path: Path) -> None:
    """Two people, each with a clip a; the second one's poses are larger."""
    poses = np.array([[[0, 0, 1000], [0, 100, 500]]] * 2 + [[[0, 0, 2000], [0, 200, 1000]]] * 2, float)
    mocap(path, poses=poses, clip_id=["a"] * 4, frame=[0, 1, 0, 1])


def test_a_person_held_out_is_held_out_whatever_the_clips_are_called(tmp_path):
    file_with_shared_names(tmp_path / "m.npz")
    poses = MocapPoses(tmp_path / "m.npz")
    for pairs in (poses.project(exclude=["S2"]), poses.project(subjects=["S1"])):
        assert set(pairs.subject) == {"S1"}
        np.testing.assert_allclose(np.linalg.norm(pairs.poses[:, 0], axis=1), np.hypot(100, 500), rtol=1e-5)
    other = poses.project(subjects=["S2"])
    np.testing.assert_allclose(np.linalg.norm(other.poses[:, 0], axis=1), 2 * np.hypot(100, 500), rtol=1e-5)


def test_a_split_of_such_a_file_leaks_no_subject(tmp_path):
    file_with_shared_names(tmp_path / "m.npz")
    config = Config().with_changes(['data.test_subjects=["S2"]'])
    training, _, _ = split(tmp_path / "m.npz", config.data)
    assert set(training.subject) == {"S1"}


def test_frames_and_sequences_of_such_a_file_are_distinct(tmp_path):
    file_with_shared_names(tmp_path / "m.npz")
    pairs = MocapPoses(tmp_path / "m.npz").project(views=2)
    assert pairs.frame_id.tolist()[:3] == ["S1/a/0/0", "S1/a/1/0", "S1/a/0/1"]
    assert len(set(pairs.frame_id)) == len(pairs) == 8
    assert set(pairs.sequence) == {"S1/a", "S2/a"}
    chosen = MocapPoses(tmp_path / "m.npz").project(views=2, subjects=["S1"])
    assert set(chosen.frame_id) < set(pairs.frame_id)


def test_people_who_share_a_clip_s_name_have_cameras_of_their_own(tmp_path):
    file_with_shared_names(tmp_path / "m.npz")
    pairs = MocapPoses(tmp_path / "m.npz").project(views=1)
    first, second = (pairs.poses[pairs.subject == name][0, 0] for name in ("S1", "S2"))
    assert np.abs(2 * first - second).max() > 10  # twice as large, and from another side


def test_frames_of_clips_with_names_of_their_own_are_named_by_them(tmp_path):
    mocap(tmp_path / "m.npz")
    pairs = MocapPoses(tmp_path / "m.npz").project(views=1)
    assert pairs.frame_id.tolist() == ["a/0/0", "a/1/0", "b/2/0", "b/3/0"]
    assert pairs.sequence.tolist() == ["a", "a", "b", "b"]


# --- files that don't fit -----------------------------------------------------------------------------------------

NOT_FINITE = np.array([[[0, 0, 1000], [0, 100, 500]]] * 4, float)
NOT_FINITE[2, 1, 0] = np.nan


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"poses": NOT_FINITE},
            r"not finite in 1 of 4 frames \(first: clip b, frame 2, joint RKnee\)\. Leave them out",
        ),
        ({"poses": np.full((4, 2, 3), 0.3) * [[[0, 0, 0], [1, 1, 1]]]}, r"looks like metres: joints lie 0\.26 from"),
        ({"poses": np.full((4, 2, 3), "1")}, "poses: dtype <U1; expected real numbers"),
        ({"poses": np.zeros((4, 6))}, r"axes: MKD names 3 axes; the array has 2"),
        ({"subject": [1, 1]}, r"subject \(2,\); expected \(4,\)"),
        ({"clip_id": ["a", "a"]}, r"clip_id \(2,\); expected \(4,\)"),
        ({"clip_id": "a"}, r"clip_id \(\); expected \(4,\)"),
        ({"frame": [0, 1]}, r"frame \(2,\); expected \(4,\)"),
        ({"description": ["walk"]}, r"description \(1,\); expected \(4,\)"),
        ({"frame": [0, 0, 0, 1]}, r"1 frames occur more than once \(first: clip a, frame 0\)"),
        ({"joints": ["Hip", "hip"]}, "joints name Hip = hip more than once"),
        ({"joints": [1.5, 2.5]}, "no Hip among"),
        ({"joints": np.array([b"Hip", b"\xff"])}, "joints: .*; expected text"),
        ({"unit": ["mm", "mm"]}, "unit has 2 values; expected one word"),
    ],
)
def test_a_damaged_file_of_motion_is_refused(tmp_path, changes, words):
    mocap(tmp_path / "m.npz", **changes)
    with pytest.raises(PoseDataError, match=rf"m\.npz: .*{words}"):
        MocapPoses(tmp_path / "m.npz")


def test_metres_that_are_called_so_are_read(tmp_path):
    mocap(tmp_path / "m.npz", poses=np.array([[[0, 0, 1.0], [0, 0.1, 0.5]]] * 4), unit="m")
    np.testing.assert_allclose(MocapPoses(tmp_path / "m.npz").poses[0], [[0, 0, 1000], [0, 100, 500]])


def test_the_layout_of_motion_is_the_declared_one(tmp_path):
    poses = np.array([[[0, 0, 1000 + row], [0, 100, 500]] for row in range(4)], float)
    mocap(tmp_path / "m.npz", poses=poses.transpose(2, 1, 0), axes="DKM")
    np.testing.assert_array_equal(MocapPoses(tmp_path / "m.npz").poses, poses)


def test_names_stored_as_bytes_are_text(tmp_path):
    mocap(tmp_path / "m.npz", joints=np.array([b"Hip", b"RKnee"]), unit=b"mm", clip_id=[b"a", b"a", b"b", b"b"])
    poses = MocapPoses(tmp_path / "m.npz")
    assert (poses.joints, set(poses.clip)) == (("Hip", "RKnee"), {"a", "b"})


def test_projecting_what_is_not_finite_gives_one_message_and_no_file(tmp_path, monkeypatch, capsys):
    mocap(tmp_path / "m.npz", poses=NOT_FINITE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["posecal-models", "project", "m.npz", "-o", "pairs.npz"])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err
    assert ended.value.code == 3
    assert said.startswith("posecal-models: m.npz: poses are not finite")
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "pairs.npz").exists()


def test_one_person_of_several_who_share_names_is_projected(tmp_path):
    file_with_shared_names(tmp_path / "m.npz")
    assert CliRunner().invoke(app, ["project", str(tmp_path / "m.npz"), "-o", str(tmp_path / "p.npz"),
                                    "--subject", "S1"]).exit_code == 0  # fmt: skip
    assert set(np.load(tmp_path / "p.npz")["subject"]) == {"S1"}
