"""The files of the pose world: their members, and their evaluation by posecal."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.errors import PoseFileError
from toy.faults import FAULTS, Case
from toy.pose_files import make_folder, write_case
from toy.pose_world import PoseWorld


@pytest.fixture
def case() -> Case:
    world = PoseWorld.person("h36m-17")
    rng = np.random.default_rng(0)
    return Case.of(world, world.draw(rng, sequences=4, frames=3, hidden=0.5), rng)


def members(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as stored:
        return dict(stored)


def test_hypotheses_say_their_axes_unit_joints_and_frames(tmp_path: Path, case: Case) -> None:
    hypotheses, _ = write_case(tmp_path, case, FAULTS["perfect"], 5)
    stored = members(tmp_path / "hyps.npz")
    assert set(stored) == {"hypotheses", "axes", "unit", "joints", "frame_id"}
    assert stored["hypotheses"].dtype == np.float32
    assert stored["hypotheses"].shape == (5, 12, 17, 3)
    np.testing.assert_array_equal(stored["hypotheses"], hypotheses)
    assert (stored["axes"].item(), stored["unit"].item()) == ("NMKD", "mm")
    assert tuple(stored["joints"]) == case.world.joints
    assert len(set(stored["frame_id"])) == 12


def test_truth_carries_its_labels(tmp_path: Path, case: Case) -> None:
    _, truth = write_case(tmp_path, case, FAULTS["perfect"], 5)
    stored = members(tmp_path / "gt.npz")
    assert (stored["axes"].item(), stored["unit"].item()) == ("MKD", "mm")
    np.testing.assert_array_equal(stored["truth"], truth)
    np.testing.assert_allclose(truth, case.scene.truth, rtol=1e-6, atol=1e-4)
    np.testing.assert_array_equal(stored["occluded"], ~case.scene.observed)
    assert list(stored["sequence"][[0, 3, 11]]) == ["s000", "s001", "s003"]
    occluded = stored["occluded"].any(axis=1)
    np.testing.assert_array_equal(stored["action"], np.where(occluded, "occluded", "open"))
    np.testing.assert_array_equal(np.isnan(stored["keypoints_2d"]).any(axis=-1), stored["occluded"])
    np.testing.assert_array_equal(stored["frame_id"], members(tmp_path / "hyps.npz")["frame_id"])


def test_members_are_not_compressed_so_that_they_can_be_mapped(tmp_path: Path, case: Case) -> None:
    from zipfile import ZIP_STORED, ZipFile

    write_case(tmp_path, case, FAULTS["perfect"], 2)
    with ZipFile(tmp_path / "hyps.npz") as stored:
        assert {member.compress_type for member in stored.infolist()} == {ZIP_STORED}


@pytest.mark.slow
def test_posecal_evaluates_the_files_as_they_are(tmp_path: Path) -> None:
    world = PoseWorld.person()
    rng = np.random.default_rng(1)
    case = Case.of(world, world.draw(rng, sequences=30, frames=10, hidden=0.3), rng)
    write_case(tmp_path, case, FAULTS["perfect"], 50)
    files = [str(tmp_path / "hyps.npz"), str(tmp_path / "gt.npz")]
    arguments = [sys.executable, "-m", "posecal", "evaluate", *files, "--by", "action", "--format", "json"]
    checkout = Path(posecal.__file__).parents[1]
    done = subprocess.run(arguments, cwd=checkout, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["rows"]
    value = {row["metric"]: row["value"] for row in rows if not row["group"] and row["joint"] is None}
    expected, error = case.posterior.expected_min_mpjpe(50, np.random.default_rng(2))
    # Both are means over 300 poses of the same law, so their difference has √2 times the error of one
    np.testing.assert_allclose(value["min_mpjpe"], expected, rtol=0, atol=4 * np.sqrt(2) * error)
    assert value["ece"] < 3 * 0.0099 * np.sqrt(1000 / 300)  # the noise of test_faults.py at 300 poses
    groups = {row["group"] for row in rows if row["group"]}
    assert len(groups) == 2
    assert all(any(action in group for group in groups) for action in ("open", "occluded"))


def test_a_missing_folder_leaves_nothing(tmp_path: Path, case: Case) -> None:
    with pytest.raises(PoseFileError, match=r"deep: can't be made .* Make the folder above it first"):
        write_case(tmp_path / "no" / "deep", case, FAULTS["perfect"], 2)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_made_in_a_folder_that_is_there(tmp_path: Path) -> None:
    make_folder(tmp_path / "new")
    make_folder(tmp_path / "new")
    assert (tmp_path / "new").is_dir()
    with pytest.raises(PoseFileError, match=r"deep: can't be made .* Make the folder above it first"):
        make_folder(tmp_path / "no" / "deep")
