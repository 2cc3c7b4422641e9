"""Copies of pose data: some of the poses, with other values, pickled and in another process."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.data.file_array import FileArray
from posecal.data.pose_data import PoseData
from posecal.data.stored_poses import ArrayHypotheses
from posecal.errors import PoseDataError, PoseFileError
from tests.helpers.small_files import (
    JOINTS,
    OCCLUDED,
    SCORES,
    WORDS,
    M,
    coordinates,
    hypotheses,
    npy,
    same,
    save,
    truth,
)

# --- copies ---------------------------------------------------------------------------------------------------


def complete() -> PoseData:
    data = PoseData(
        hypotheses(),
        truth(),
        joints=JOINTS,
        where=~OCCLUDED,
        occluded=OCCLUDED,
        scores=SCORES,
        labels={"action": WORDS},
    )
    return data.replace(reference=data, usable=OCCLUDED)


@pytest.mark.parametrize("poses", [np.array([5, 1]), [5, 1], np.array([-2, -6])])
def test_selected_poses_are_those_of_every_attribute(poses: Any) -> None:
    data, rows = complete(), [5, 1]
    part = data.select(poses)
    for selected in (part, part.reference):
        assert selected is not None
        np.testing.assert_array_equal(coordinates(selected), hypotheses()[:, rows])
        np.testing.assert_array_equal(selected.truth, truth()[rows])
        np.testing.assert_array_equal(selected.scores, SCORES[:, rows])
        np.testing.assert_array_equal(selected.occluded, OCCLUDED[rows])
        np.testing.assert_array_equal(selected.where, ~OCCLUDED[rows])
        assert (selected.order.tolist(), selected.frame_id.tolist()) == ([5, 1], ["5", "1"])
        assert selected.labels["action"].tolist() == ["y", "u"]
    np.testing.assert_array_equal(part.usable, OCCLUDED[rows])
    assert (part.joints, part.root, part.fps, part.names) == (data.joints, data.root, data.fps, data.names)


def test_poses_are_selected_by_a_mask() -> None:
    mask = np.arange(M) % 2 == 0
    assert complete().select(mask).frame_id.tolist() == ["0", "2", "4", "6"]


@pytest.mark.parametrize("poses", [[7], [-8], [True, False], [0.5], "a"])
def test_poses_that_are_not_there_are_refused(poses: Any) -> None:
    with pytest.raises(PoseDataError, match=r"^poses: .*; expected numbers below M = 7, or a mask \(M,\)\.$"):
        complete().select(poses)


def test_a_copy_changes_what_is_named_and_nothing_else() -> None:
    data = complete()
    copy = data.replace(fps=50.0)
    assert (copy.fps, data.fps) == (50.0, None)
    same(copy, data, but=("fps",))
    with pytest.raises(TypeError, match=r"^PoseData has no attribute 'fsp'$"):
        data.replace(fsp=50)
    with pytest.raises(AttributeError):
        data.fps = 50  # type: ignore[misc]


# --- pickling -------------------------------------------------------------------------------------------------


def test_data_of_arrays_pickle() -> None:
    data = complete()
    copy = pickle.loads(pickle.dumps(data))
    same(copy, data, but=())
    assert copy.reference is not None


@pytest.mark.parametrize("form", ["npz", "compressed", "npy"])
def test_data_of_files_pickle_as_their_paths(tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    many = np.concatenate([hypotheses()] * 40)
    if form == "npy":
        npy(tmp_path, "h.npy", many)
    else:
        (np.savez if form == "npz" else np.savez_compressed)(tmp_path / "h.npz", before=np.zeros(3), hypotheses=many)
    monkeypatch.chdir(tmp_path)
    data = PoseData("h.npy" if form == "npy" else "h.npz", truth())
    state = pickle.dumps(data)
    assert len(state) < many.nbytes / 10
    monkeypatch.chdir("/")
    copy = pickle.loads(state)
    same(copy, data, but=())
    assert isinstance(copy.hypotheses, ArrayHypotheses)
    assert isinstance(copy.hypotheses.array, FileArray)
    same(pickle.loads(pickle.dumps(copy)), data, but=())


def test_another_process_reads_pickled_data_of_files(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "h.npz", hypotheses=hypotheses())
    (tmp_path / "data").write_bytes(pickle.dumps(PoseData(tmp_path / "h.npz", truth())))
    code = "import pickle, sys; print(float(pickle.load(open(sys.argv[1], 'rb')).hypotheses.read(0, 7).sum()))"
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "data"], capture_output=True, text=True, check=True)
    assert float(done.stdout) == float(hypotheses().sum())


def test_a_file_that_changed_meanwhile_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "h.npz", hypotheses=hypotheses())
    state = pickle.dumps(PoseData(path, truth()))
    save(tmp_path / "new.npz", hypotheses=hypotheses()[::-1]).replace(path)
    with pytest.raises(PoseFileError, match=r"^h\.npz: hypotheses: has changed since it was opened\. Open it again\.$"):
        pickle.loads(state)
    path.unlink()
    with pytest.raises(PoseFileError, match=r"h\.npz: no such file\.$"):
        pickle.loads(state)
