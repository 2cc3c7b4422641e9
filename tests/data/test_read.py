"""Whatever form the files have, they are read as the same pairs."""

import itertools
import struct
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.data.declarations import Declarations
from tests.helpers.small_files import (
    FRAMES,
    JOINTS,
    K,
    M,
    N,
    coordinates,
    hypotheses,
    hypotheses_file,
    member,
    npy,
    read_data,
    save,
    truth,
    truth_file,
)


def assert_plain(ours: Path, theirs: Path, how: Declarations | None = None) -> None:
    """Check that two files are read as the arrays that they were made from, named, in mm and with their root."""
    pairs = read_data(ours, theirs, how)
    np.testing.assert_allclose(coordinates(pairs), hypotheses(), rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(pairs.truth, truth(), rtol=1e-6, atol=1e-3)
    assert pairs.joints == JOINTS
    assert pairs.root == 0
    assert pairs.shape == (N, M, K, 3)


@pytest.mark.parametrize("name", ["hypotheses", "hyps", "arr_0", "samples"])
def test_hypotheses_are_found_by_name_or_as_the_only_array(tmp_path: Path, name: str) -> None:
    assert_plain(save(tmp_path / "h.npz", **{name: hypotheses()}), truth_file(tmp_path))


@pytest.mark.parametrize("name", ["truth", "gt", "arr_0", "poses_3d"])
def test_the_truth_is_found_by_name_or_as_the_only_array(tmp_path: Path, name: str) -> None:
    assert_plain(hypotheses_file(tmp_path), save(tmp_path / "g.npz", **{name: truth(), "joints": JOINTS}))


def test_two_bare_arrays_in_the_papers_layout_need_no_flag(tmp_path: Path) -> None:
    pairs = read_data(npy(tmp_path, "h.npy", hypotheses()), npy(tmp_path, "g.npy", truth()))
    np.testing.assert_array_equal(coordinates(pairs), hypotheses())
    np.testing.assert_array_equal(pairs.truth, truth())
    assert pairs.root == 0  # the one joint whose truth is 0 throughout


def test_a_suffix_is_not_asked_for(tmp_path: Path) -> None:
    ours, theirs = hypotheses_file(tmp_path), truth_file(tmp_path)
    assert_plain(ours.rename(tmp_path / "hyps"), theirs.rename(tmp_path / "gt.data"))


def test_a_compressed_file_is_read_as_a_plain_one(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "h.npz", hypotheses=hypotheses())
    assert_plain(tmp_path / "h.npz", truth_file(tmp_path))


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions_of_zip_are_read(tmp_path: Path, method: int) -> None:
    contents = npy(tmp_path, "h.npy", hypotheses()).read_bytes()
    assert_plain(member(tmp_path / "h.npz", "hypotheses.npy", contents, method), truth_file(tmp_path))


@pytest.mark.parametrize("dtype", ["<f2", ">f2", ">f4", "<f8", ">f8", "g", "<i2", ">i4", "i8"])
def test_any_type_of_real_number_is_read(tmp_path: Path, dtype: str) -> None:
    theirs = truth_file(tmp_path, truth=truth().astype(dtype))
    assert_plain(hypotheses_file(tmp_path, hypotheses=hypotheses().astype(dtype)), theirs)


def test_unsigned_numbers_are_read(tmp_path: Path) -> None:
    moved = hypotheses() + 2000
    ours = hypotheses_file(tmp_path, hypotheses=moved.astype(np.uint16))
    pairs = read_data(ours, truth_file(tmp_path, truth=(truth() + 2000).astype(np.uint16)))
    np.testing.assert_array_equal(coordinates(pairs), moved)


@pytest.mark.parametrize("single", ["<f2", ">f2", "<f4", ">f4"])
def test_single_precision_stays_single_and_everything_else_is_double(tmp_path: Path, single: str) -> None:
    plain = truth_file(tmp_path)
    ours = read_data(hypotheses_file(tmp_path, hypotheses=hypotheses().astype(single)), plain)
    assert coordinates(ours).dtype == np.float32
    assert coordinates(read_data(hypotheses_file(tmp_path, hypotheses=hypotheses().astype("i4")), plain)).dtype == "f8"


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("axes", ["".join(letters) for letters in itertools.permutations("NMKD")])
def test_every_order_of_the_axes_is_read_where_it_is_declared(tmp_path: Path, axes: str, order: str) -> None:
    stored = np.asarray(hypotheses().transpose(["NMKD".index(letter) for letter in axes]), order=order)  # type: ignore[call-overload]
    assert_plain(hypotheses_file(tmp_path, hypotheses=stored, axes=axes), truth_file(tmp_path, axes="MKD"))


@pytest.mark.parametrize("axes", ["MKD", "MDK", "KMD", "KDM", "DMK", "DKM"])
def test_every_order_of_the_truths_axes_is_read_by_file_and_by_flag(tmp_path: Path, axes: str) -> None:
    stored = truth().transpose(["MKD".index(letter) for letter in axes])
    assert_plain(hypotheses_file(tmp_path), truth_file(tmp_path, truth=stored, axes=axes))
    assert_plain(hypotheses_file(tmp_path), truth_file(tmp_path, truth=stored), Declarations(truth_axes=axes))


def test_coordinates_before_joints_are_split_from_one_axis(tmp_path: Path) -> None:
    flat = hypotheses().transpose(1, 0, 3, 2).reshape(M, N, 3 * K)
    assert_plain(hypotheses_file(tmp_path, hypotheses=flat, axes="MN(DK)"), truth_file(tmp_path))


def test_joints_before_coordinates_are_split_from_one_axis_of_both(tmp_path: Path) -> None:
    ours = hypotheses_file(tmp_path, hypotheses=hypotheses().reshape(N, M, K * 3))
    assert_plain(ours, truth_file(tmp_path, truth=truth().reshape(M, K * 3)), Declarations(axes="NM(KD)"))


def test_clips_and_their_frames_are_the_poses_and_each_clip_a_sequence(tmp_path: Path) -> None:
    six, pairs = hypotheses()[:, :6], (truth()[:6], "MTKD")
    ours = hypotheses_file(tmp_path, hypotheses=six.reshape(N, 2, 3, K, 3), axes="NMTKD")
    theirs = truth_file(tmp_path, truth=pairs[0].reshape(2, 3, K, 3), axes="MTKD")
    found = read_data(ours, theirs)
    np.testing.assert_array_equal(coordinates(found), six)
    np.testing.assert_array_equal(found.truth, truth()[:6])
    assert found.labels["sequence"].tolist() == ["0", "0", "0", "1", "1", "1"]


def test_frames_may_lie_outside_their_clips(tmp_path: Path) -> None:
    clips = hypotheses()[:, :6].reshape(N, 2, 3, K, 3)  # N M T K D
    ours = hypotheses_file(tmp_path, hypotheses=clips.transpose(2, 3, 0, 1, 4), axes="TKNMD")
    found = read_data(ours, truth_file(tmp_path, truth=truth()[:6]))
    np.testing.assert_array_equal(coordinates(found), hypotheses()[:, :6])


def test_the_last_iteration_of_a_sampler_counts(tmp_path: Path) -> None:
    iterations = np.stack([hypotheses() * 0, hypotheses() + 50, hypotheses()], axis=2)
    assert_plain(hypotheses_file(tmp_path, hypotheses=iterations, axes="NMIKD"), truth_file(tmp_path))


@pytest.mark.parametrize(
    ("unit", "millimetres"),
    [("mm", 1), ("cm", 10), ("m", 1000), ("M", 1000), (" cm ", 10), ("2", 2), ("25.4", 25.4), ("1/0.0036", 1 / 0.0036)],
)
def test_lengths_of_every_unit_become_millimetres(tmp_path: Path, unit: str, millimetres: float) -> None:
    ours, theirs = hypotheses().astype("f8") / millimetres, truth().astype("f8") / millimetres
    declared = hypotheses_file(tmp_path, hypotheses=ours, unit=unit), truth_file(tmp_path, truth=theirs, unit=unit)
    assert_plain(*declared)
    assert_plain(
        hypotheses_file(tmp_path, hypotheses=ours), truth_file(tmp_path, truth=theirs), Declarations(unit=unit)
    )  # the same by flag


def test_the_two_may_have_different_units(tmp_path: Path) -> None:
    ours = hypotheses_file(tmp_path, hypotheses=hypotheses() / 1000)
    assert_plain(ours, truth_file(tmp_path), Declarations(unit="m", truth_unit="mm"))
    assert_plain(hypotheses_file(tmp_path, hypotheses=hypotheses() / 10, unit="cm"), truth_file(tmp_path))


def test_joints_of_other_spellings_in_another_order_are_joined_by_name(tmp_path: Path) -> None:
    spelt = ["pelvis", "right_hip", "R Knee", "right-ankle", "LeftHip", "l_knee", "LANKLE", "Spine", "neck"]
    spelt += ["nose", "head_top", "left_shoulder", "ElbowLeft", "l.wrist", "RightShoulder", "right elbow", "rwrist"]
    order = np.random.default_rng(3).permutation(K)
    ours = hypotheses_file(tmp_path, hypotheses=hypotheses()[:, :, order], joints=np.array(spelt)[order])
    assert_plain(ours, truth_file(tmp_path))


def test_joints_may_be_bytes(tmp_path: Path) -> None:
    assert_plain(hypotheses_file(tmp_path), truth_file(tmp_path, joints=np.array(JOINTS, dtype=np.bytes_)))


@pytest.mark.parametrize(
    "ids",
    [np.array(FRAMES), np.array(FRAMES, dtype=np.bytes_), np.array([5, 3, 9, 1, 0, 12, 7]), np.arange(M)[:, None] + 2],
    ids=["text", "bytes", "numbers", "a column"],
)
def test_frames_in_another_order_are_joined_by_id(tmp_path: Path, ids: Any) -> None:
    order = np.array([6, 2, 0, 5, 1, 4, 3])
    ours = hypotheses_file(tmp_path, hypotheses=hypotheses()[:, order], frame_id=ids[order])
    assert_plain(ours, truth_file(tmp_path, frame_id=ids))


def test_a_frame_id_in_one_file_alone_joins_nothing(tmp_path: Path) -> None:
    assert_plain(hypotheses_file(tmp_path), truth_file(tmp_path, frame_id=np.array(FRAMES)))


@pytest.mark.parametrize(
    ("values", "read"),
    [
        (np.array(["a", "b"] * 3 + ["a"]), ["a", "b", "a", "b", "a", "b", "a"]),
        (np.array([b"\xc3\xa4"] * M), ["ä"] * M),
        (np.arange(M, dtype=">i8"), ["0", "1", "2", "3", "4", "5", "6"]),
        (np.arange(M) % 2 == 0, ["yes", "no", "yes", "no", "yes", "no", "yes"]),
    ],
    ids=["text", "bytes", "numbers", "yes or no"],
)
def test_a_label_is_read_as_text(tmp_path: Path, values: Any, read: list[str]) -> None:
    assert read_data(hypotheses_file(tmp_path), truth_file(tmp_path, clip=values)).labels["clip"].tolist() == read


def test_a_label_of_the_hypotheses_counts_too(tmp_path: Path) -> None:
    pairs = read_data(hypotheses_file(tmp_path, camera=["left"] * M), truth_file(tmp_path))
    assert pairs.labels["camera"].tolist() == ["left"] * M


def test_other_members_of_a_file_are_passed_over(tmp_path: Path) -> None:
    ours = hypotheses_file(
        tmp_path, keypoints_2d=np.zeros((M, K, 2)), image_size=[1000, 1002], focal=np.ones(4), note="a word"
    )
    assert_plain(ours, truth_file(tmp_path))
    assert read_data(ours, truth_file(tmp_path)).labels == {}


def test_objects_beside_the_poses_are_passed_over_and_never_unpickled(tmp_path: Path) -> None:
    np.savez(tmp_path / "h.npz", hypotheses=hypotheses(), settings=np.array({"a": 1}), ragged=np.array([None, 2]))
    assert_plain(tmp_path / "h.npz", truth_file(tmp_path))


def test_visible_is_the_opposite_of_occluded(tmp_path: Path) -> None:
    occluded = np.random.default_rng(1).random((M, K)) < 0.3
    for name, marks in (("occluded", occluded), ("visible", ~occluded)):
        found = read_data(hypotheses_file(tmp_path), truth_file(tmp_path, **{name: marks})).occluded
        np.testing.assert_array_equal(found, occluded)


def test_scores_follow_their_frames(tmp_path: Path) -> None:
    scores, order = np.arange(N * M, dtype=np.float32).reshape(N, M), np.arange(M)[::-1]
    ours = hypotheses_file(
        tmp_path, hypotheses=hypotheses()[:, order], scores=scores[:, order], frame_id=np.array(FRAMES)[order]
    )
    np.testing.assert_array_equal(read_data(ours, truth_file(tmp_path, frame_id=FRAMES)).scores, scores)


@pytest.mark.parametrize("rate", [np.array(50), np.array([50.0]), np.array(50, dtype=">f4")])
def test_frames_per_second_are_one_number(tmp_path: Path, rate: Any) -> None:
    assert read_data(hypotheses_file(tmp_path), truth_file(tmp_path, fps=rate)).fps == 50


def test_a_file_of_python_2_is_read_without_a_word(tmp_path: Path) -> None:
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({N}L, {M}L, {K}L, 3L), }}".encode()
    header = header.ljust(117) + b"\n"
    contents = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + hypotheses().tobytes()
    (tmp_path / "h.npy").write_bytes(contents)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_plain(tmp_path / "h.npy", truth_file(tmp_path))
