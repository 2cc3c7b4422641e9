"""Members that nothing reads, and names of frames that one file alone has, are remarked on."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.conversion import convert
from tests.situations.people import JOINTS, about, people

M, K = 12, len(JOINTS)
RANDOM = np.random.default_rng(0)
TRUTH = people(RANDOM, M)
HYPOTHESES = about(RANDOM, TRUTH, 5)
SEEN = RANDOM.random((M, K)) < 0.8


def remarks(folder: Path, truth: dict[str, Any], hypotheses: dict[str, Any] | None = None) -> list[str]:
    np.savez(folder / "hyps.npz", hypotheses=HYPOTHESES, unit="mm", joints=JOINTS, **hypotheses or {})
    np.savez(folder / "gt.npz", truth=TRUTH, unit="mm", joints=JOINTS, **truth)
    return [*posecal.PoseData(folder / "hyps.npz", folder / "gt.npz").remarks]


@pytest.mark.parametrize("name", ["mask", "joint_valid", "confidence", "visibility"])
def test_masks_of_unknown_names_are_named(tmp_path: Path, name: str) -> None:
    said = "not read: {} (M, K); of that shape, valid, occluded and visible are. Rename what is meant."
    assert remarks(tmp_path, {name: SEEN}) == [f"gt.npz: {said.format(name)}"]
    assert remarks(tmp_path, {}, {name: SEEN[..., None] * 0.5}) == [f"hyps.npz: {said.format(name)}"]


def test_masks_of_coordinates_and_of_hypotheses_are_named(tmp_path: Path) -> None:
    """As mmpose and padded batches have them."""
    said = " may mark what does not count. Joints are marked by valid (M, K), absent hypotheses by weights of 0."
    of_all = np.repeat(SEEN[..., None], 3, axis=2)
    (of_truth,) = remarks(tmp_path, {"joints_3d_visible": of_all, "other": of_all})
    assert of_truth == f"gt.npz: not read: joints_3d_visible {of_all.shape}{said}"
    assert remarks(tmp_path, {}, {"mask": np.ones((5, M))}) == [f"hyps.npz: not read: mask (5, {M}){said}"]
    assert "keypoints_visible (M, K)" in remarks(tmp_path, {"keypoints_visible": SEEN})[0]


def test_labels_that_look_like_masks_of_poses_are_named(tmp_path: Path) -> None:
    (said,) = remarks(tmp_path, {"mask": SEEN[:, 0], "hard": SEEN[:, 1], "is_valid": np.ones(M)})
    assert said == (
        "gt.npz: mask (M,) is a label; the poses that count are marked by valid (M,). Rename what is meant."
    )


def test_masks_of_unknown_names_are_named_in_hdf5(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    np.savez(tmp_path / "hyps.npz", hypotheses=HYPOTHESES, unit="mm", joints=JOINTS)
    with h5py.File(tmp_path / "gt.h5", "w") as file:
        file["truth"], file["mask"], file["sequence"] = TRUTH, SEEN, np.arange(M)
        file.attrs.update({"unit": "mm", "seed": 3})
    (said,) = posecal.PoseData(tmp_path / "hyps.npz", tmp_path / "gt.h5").remarks
    assert said.startswith("gt.h5: not read: mask (M, K); of that shape, valid")


def test_what_is_read_and_what_has_other_shapes_gets_no_remark(tmp_path: Path) -> None:
    more = {"occluded": ~SEEN, "sequence": np.arange(M), "take": ["a"] * M, "seed": 3, "camera_matrix": np.eye(3)}
    pairs = {"keypoints_2d": np.ones((M, K, 2)), "keypoints_observed": SEEN, "keypoints_sigma": SEEN * 2.0}
    assert remarks(tmp_path, {**more, **pairs, "colours": np.ones((M, 40, 3))}, {"scores": np.ones((5, M))}) == []


def test_what_convert_writes_gets_no_remark(tmp_path: Path) -> None:
    for seen in (np.full((M, K), 0.5), SEEN * 1.0):
        np.save(tmp_path / "a.npy", np.concatenate([TRUTH, seen[..., None]], axis=2))
        convert(tmp_path / "a.npy", tmp_path / "gt.npz", axes="MKC", unit="mm", joints=JOINTS)
        data = posecal.PoseData(HYPOTHESES, tmp_path / "gt.npz", unit="mm")
        assert not any("not read" in text for text in data.remarks)


@pytest.mark.parametrize(
    ("names", "ends"),
    [
        (np.arange(M), "place."),
        ([f"S{s}/{m}" for s in (1, 9) for m in range(8, 14)], "place."),
        ([*range(6), *range(6)], "place."),  # numbers that begin again with each sequence
        ([*"lkjihgfedcba"], "place."),
        (np.arange(M)[::-1], "place; its numbers are not in order: are the others in the same?"),
        (
            [f"cam1_{m:02}.png" for m in (3, 1, 2, 0, *range(4, 12))],
            "place; its numbers are not in order: are the others",
        ),
    ],
)
def test_names_of_frames_in_one_file_alone_are_remarked_on(tmp_path: Path, names: Any, ends: str) -> None:
    for which, pair in (("hyps.npz", ({}, {"frame_id": names})), ("gt.npz", ({"frame_id": names}, {}))):
        (said,) = [text for text in remarks(tmp_path, *pair) if text.startswith("frame_id")]
        assert said.startswith(f"frame_id: only {which} has it, so frames are matched by their {ends}")
    ids = np.arange(M)
    assert remarks(tmp_path, {"frame_id": ids}, {"frame_id": ids}) == [] == remarks(tmp_path, {})


@pytest.mark.parametrize(("spelt", "words"), [("RKneee", "RKneee (like RKnee)"), ("RKnee", "")])
def test_names_of_the_truth_alone_are_looked_at(tmp_path: Path, spelt: str, words: str) -> None:
    names = [spelt if name == "RKnee" else name for name in JOINTS]
    np.savez(tmp_path / "gt.npz", truth=TRUTH, unit="mm", joints=names)
    said = posecal.PoseData(HYPOTHESES, tmp_path / "gt.npz", unit="mm").remarks
    assert [words in text for text in said] == [True] * bool(words)
    assert said == posecal.PoseData(HYPOTHESES, TRUTH, unit="mm", joints=names).remarks


def test_names_beside_those_of_both_files_are_refused_where_they_differ(tmp_path: Path) -> None:
    remarks(tmp_path, {})
    paths = tmp_path / "hyps.npz", tmp_path / "gt.npz"
    words = r'^hyps\.npz and gt\.npz name joints \(Hip, RHip, RKnee and 14 more\); expected no joints="coco-17"'
    with pytest.raises(posecal.PoseDataError, match=words):
        posecal.PoseData(*paths, joints="coco-17")
    assert posecal.PoseData(*paths, joints="h36m-17").joints == tuple(JOINTS)
    assert posecal.PoseData(paths[0], TRUTH, truth_unit="mm", joints=JOINTS).shape[2] == K
    few = [k for k, name in enumerate(JOINTS) if name != "Spine"]
    np.savez(paths[1], truth=TRUTH[:, few], unit="mm", joints=[JOINTS[k] for k in few])
    assert posecal.PoseData(HYPOTHESES, paths[1], unit="mm", joints="h36m-17", shared_joints="common").shape[2] == 16


def labels(folder: Path, truth: dict[str, Any]) -> dict[str, Any]:
    remarks(folder, truth)
    return dict(posecal.PoseData(folder / "hyps.npz", folder / "gt.npz").labels)


@pytest.mark.parametrize("shape", [(M, 15), (M, 9), (2, 1)])
def test_tables_that_are_no_label_of_poses_are_not_read_as_one(tmp_path: Path, shape: tuple[int, int]) -> None:
    assert "action" not in labels(tmp_path, {"action": np.ones(shape, dtype=np.uint16)})


def test_a_number_in_brackets_is_a_label_of_all_poses_and_a_column_one_of_each(tmp_path: Path) -> None:
    """As MATLAB writes them."""
    found = labels(tmp_path, {"subject": [[9]], "action": np.arange(M)[:, None]})
    assert found["subject"].tolist() == ["9"] * M
    assert found["action"].tolist() == [str(number) for number in range(M)]
