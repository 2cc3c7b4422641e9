"""Sums come back from a file as they were, and files that hold none are refused."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from posecal.engine.metric import Metric, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.storage import digest_of, is_result, load_totals, save_totals
from posecal.errors import PoseDataError, PoseFileError
from posecal.registry import known_metrics
from tests.helpers.example_totals import keeping, metric, totals
from tests.helpers.random_worlds import world


def test_a_file_gives_back_what_was_saved(tmp_path: Path) -> None:
    protocol = Protocol(where="visible", best="batch:2", average="action", pck_threshold=80.5)
    before = replace(world(8).totals(protocol), remarks=("one", "two, three"))
    save_totals(before, tmp_path / "result.npz")
    after = load_totals(tmp_path / "result.npz")
    assert after.spec == before.spec
    assert after.protocol == before.protocol
    assert (after.version, after.remarks) == (before.version, before.remarks)
    assert list(after.cells) == list(before.cells)
    assert after.has_sequences is before.has_sequences is True
    assert after.signature == before.signature
    np.testing.assert_array_equal(after.poses, before.poses)
    np.testing.assert_array_equal(after.cell_of, before.cell_of)
    for name in before.sums:
        np.testing.assert_array_equal(after.sums[name], before.sums[name])
        np.testing.assert_array_equal(after.counts[name], before.counts[name])
    assert before.per_pose
    for name in before.per_pose:
        np.testing.assert_array_equal(after.per_pose[name], before.per_pose[name])
    metrics = known_metrics(after.protocol, after.spec)
    for name, metric_ in metrics.items():
        np.testing.assert_array_equal(after.value(metric_), before.value(metric_), err_msg=name)


@pytest.mark.parametrize("by_joint", [False, True])
def test_metrics_of_the_user_s_own_come_back_as_they_are_described(by_joint: bool, tmp_path: Path) -> None:
    own = Metric.from_function(np.cross, name="own", unit="cm", definition="odd · «x»", by_joint=by_joint)
    other = metric(Statistic("kept", lambda block: block.truth, per_pose=True), name="other", rejection="No.")
    save_totals(totals(own_metrics=(own, other)), tmp_path / "result.npz")
    first, second = load_totals(tmp_path / "result.npz").own_metrics
    assert (first.description, second.description) == (own.description, other.description)
    assert (first.unit, first.definition, first.by_joint is not None) == ("cm", "odd · «x»", by_joint)
    assert second.statistic.per_pose
    np.testing.assert_array_equal(first.finish(np.full((2, 3), 2.0)), np.full(2 if by_joint else (2, 3), 2.0))


def test_a_saved_result_is_known_as_one(tmp_path: Path) -> None:
    save_totals(totals(), tmp_path / "result.npz")
    np.savez(tmp_path / "other.npz", hypotheses=np.zeros(3))
    (tmp_path / "text.npz").write_text("no zip")
    assert is_result(tmp_path / "result.npz") is True
    assert is_result(tmp_path / "other.npz") is False
    assert is_result(tmp_path / "text.npz") is False
    assert is_result(tmp_path / "nothing.npz") is False


def test_a_saved_result_is_compressed(tmp_path: Path) -> None:
    save_totals(totals(), tmp_path / "result.npz")
    with zipfile.ZipFile(tmp_path / "result.npz") as archive:
        assert {member.compress_type for member in archive.infolist()} == {zipfile.ZIP_DEFLATED}


def test_a_file_that_is_missing_or_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"nothing\.npz: no such file\."):
        load_totals(tmp_path / "nothing.npz")
    with pytest.raises(PoseFileError, match=r"is a folder; expected a file\."):
        load_totals(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(PoseFileError, match=r"file/inside: can't be read \(Not a directory\)\."):
        load_totals(tmp_path / "file" / "inside")


@pytest.mark.parametrize("kind", ["empty", "text", "array", "other members", "cut", "no json", "unknown option"])
def test_a_file_that_is_no_complete_result_is_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "bad.npz"
    save_totals(totals(), tmp_path / "good.npz")
    whole = (tmp_path / "good.npz").read_bytes()
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_text("hello, I am no archive")
    elif kind == "array":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    elif kind == "other members":
        np.savez(path, hypotheses=np.zeros(3))
    elif kind == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    else:
        with np.load(tmp_path / "good.npz") as stored:
            members: dict[str, npt.NDArray[np.generic]] = dict(stored)
        about = str(members["about"])
        members["about"] = np.array("{" if kind == "no json" else about.replace('"root": "count"', '"root": "gone"'))
        np.savez(path, **members)
    with pytest.raises(PoseFileError, match=r"bad\.npz: no result of posecal evaluate --save, or not a whole one\."):
        load_totals(path)


def changed(name: str, values: Any, folder: Path) -> Path:
    """A saved result with a member that is changed, or left out where ``values`` is None."""
    save_totals(keeping()[0], folder / "good.npz")
    with np.load(folder / "good.npz") as stored:
        members = {key: stored[key] for key in stored.files if key != name}
        if values is not None:
            members[name] = values(stored[name])
    np.savez(folder / "bad.npz", **members)
    return folder / "bad.npz"


@pytest.mark.parametrize(
    "name",
    [
        *("poses", "cell_of", "cell/sequence", "cell/action"),
        *("sum/height", "count/height", "sum/joints", "per_pose/kept"),
    ],
)
def test_a_member_that_lacks_or_is_too_short_is_refused(name: str, tmp_path: Path) -> None:
    for values in (None, lambda stored: stored[:-1]):
        with pytest.raises(PoseFileError, match=r"bad\.npz: no result of posecal evaluate --save, or not a whole"):
            load_totals(changed(name, values, tmp_path))


@pytest.mark.parametrize("cell", [-1, 4])
def test_cells_of_poses_that_are_not_there_are_refused(cell: int, tmp_path: Path) -> None:
    assert load_totals(changed("cell_of", lambda stored: stored, tmp_path)).cell_of.max() == 3
    with pytest.raises(PoseFileError, match=r"bad\.npz: no result of posecal"):
        load_totals(changed("cell_of", lambda stored: np.append(stored[:-1], cell), tmp_path))


def about(stored: Any, **changes: Any) -> Any:
    """What a result says of itself, with other properties of the data."""
    texts = json.loads(str(stored))
    return np.array(json.dumps({**texts, "spec": {**texts["spec"], **changes}}))


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("sum/height", lambda stored: stored * 0.5, "was changed since posecal wrote it"),
        ("about", lambda stored: np.array(str(stored).replace('"n_hypotheses": ', '"n_hypotheses": 1')), "was changed"),
        ("cell/action", lambda stored: stored[::-1], "was changed since posecal wrote it"),
        ("poses", lambda stored: -stored, "no result of posecal evaluate --save"),
        ("count/height", lambda stored: stored + 1000, "no result of posecal evaluate --save"),
        ("sum/height", lambda stored: stored * np.nan, "no result of posecal evaluate --save"),
        ("sum/height", lambda stored: stored.astype("M8[s]"), "no result of posecal evaluate --save"),
        ("sum/height", lambda stored: stored + 1e300, "no result of posecal evaluate --save"),
        ("per_pose/kept", lambda stored: stored + np.inf, "no result of posecal evaluate --save"),
        ("count/height", lambda stored: stored.astype(float), "no result of posecal evaluate --save"),
        ("cell_of", lambda stored: stored.astype(float), "no result of posecal evaluate --save"),
        ("about", lambda stored: about(stored, n_hypotheses="seven"), "no result of posecal evaluate --save"),
        ("about", lambda stored: about(stored, n_hypotheses=0), "no result of posecal evaluate --save"),
        ("about", lambda stored: about(stored, joints=["Hip", 3]), "no result of posecal evaluate --save"),
        ("about", lambda stored: about(stored, joints=["Hip"] * 2), "no result of posecal evaluate --save"),
        ("about", lambda stored: about(stored, root=99), "no result of posecal evaluate --save"),
        ("about", lambda stored: about(stored, fps=-1), "no result of posecal evaluate --save"),
        ("about", lambda stored: about(stored, has_mask="yes"), "no result of posecal evaluate --save"),
        ("about", lambda stored: np.array("[" * 100_000), "no result of posecal evaluate --save"),
    ],
)
def test_a_result_that_was_edited_is_refused(name: str, values: Any, words: str, tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=rf"bad\.npz: {words}"):
        load_totals(changed(name, values, tmp_path))


def test_a_copy_of_a_result_is_the_result(tmp_path: Path) -> None:
    same = load_totals(changed("poses", lambda stored: stored, tmp_path))
    assert same.poses.sum() == keeping()[0].poses.sum()


def test_only_sums_are_saved_and_only_files_read(tmp_path: Path) -> None:
    with pytest.raises(PoseDataError, match=r"^totals: int; expected Totals\.$"):
        save_totals(5, tmp_path / "result.npz")  # type: ignore[arg-type]
    for use in (load_totals, partial(save_totals, totals())):
        with pytest.raises(PoseDataError, match=r"^path: int; expected the path of a saved result\.$"):
            use(5)  # type: ignore[operator]


def test_a_result_of_another_format_is_to_be_made_anew(tmp_path: Path) -> None:
    save_totals(totals(), tmp_path / "result.npz")
    with np.load(tmp_path / "result.npz") as stored:
        members: dict[str, npt.NDArray[np.generic]] = dict(stored)
    members["about"] = np.array(str(members["about"]).replace('"format": 4', '"format": 99'))
    np.savez(tmp_path / "later.npz", **members)
    with pytest.raises(PoseFileError, match=r"later\.npz: format 99 of posecal 1\.0; expected 4\. Evaluate again\."):
        load_totals(tmp_path / "later.npz")


def test_a_corrupted_member_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    save_totals(totals(), path)
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("sum/height.npy").header_offset
    whole = bytearray(path.read_bytes())
    whole[start + 60 : start + 90] = bytes(30)
    path.write_bytes(whole)
    with pytest.raises(PoseFileError, match=r"bad\.npz: sum/height: no \.npy header that can be read"):
        load_totals(path)


def test_a_result_is_not_written_into_a_folder_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"missing"):
        save_totals(totals(), tmp_path / "missing" / "result.npz")
    assert list(tmp_path.iterdir()) == []


def reshaped(path: Path, name: str, *, is_told: bool) -> None:
    """Give a member of a result another axis, and the file a right digest; perhaps say so in its description."""
    with np.load(path) as stored:
        members = {key: stored[key] for key in stored if key != "digest"}
    members[name] = members[name][..., None]
    if is_told:
        about = json.loads(str(members["about"]))
        about["shapes"][name] = [*members[name].shape]
        members["about"] = np.array(json.dumps(about))
    np.savez(path, **members, digest=np.array(digest_of(members)))


@pytest.mark.parametrize("is_told", [False, True])
@pytest.mark.parametrize("name", ["poses", "count/inside_exchangeable", "cell_of", "cell/sequence"])
def test_a_result_that_was_reshaped_with_its_digest_is_refused(name: str, is_told: bool, tmp_path: Path) -> None:
    path = tmp_path / "result.npz"
    save_totals(world(8).totals(Protocol()), path)
    reshaped(path, name, is_told=is_told)
    with pytest.raises(PoseFileError, match=r"^result.npz: no result of posecal evaluate --save, or not a whole one"):
        load_totals(path)


def test_sums_that_were_reshaped_with_their_digest_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "result.npz"
    save_totals(world(8).totals(Protocol()), path)
    reshaped(path, "sum/inside_exchangeable", is_told=False)
    with pytest.raises(PoseFileError, match=r"^result.npz: no result of posecal"):
        load_totals(path)
