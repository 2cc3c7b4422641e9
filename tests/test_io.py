"""Whatever form the files have, they are read as the same pairs; what can't be read is refused in one sentence."""

import io
import itertools
import os
import pickle
import stat
import struct
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from posecal.errors import PosecalError, PoseDataError, PoseFileError
from posecal.file_array import FileArray
from posecal.io import as_labels, as_marks, as_scores, check_writable, read_poses, written_whole
from posecal.joining import Join
from tests.small_files import (
    FRAMES,
    JOINTS,
    K,
    M,
    N,
    coordinates,
    hypotheses,
    hypotheses_file,
    member,
    opened,
    save,
    truth,
    truth_file,
)


def assert_plain(ours: Path, theirs: Path, how: Join | None = None) -> None:
    """Check that two files are read as the arrays that they were made from, named, in mm and with their root."""
    pairs = opened(ours, theirs, how)
    np.testing.assert_allclose(coordinates(pairs), hypotheses(), rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(pairs.truth, truth(), rtol=1e-6, atol=1e-3)
    assert pairs.joints == JOINTS
    assert pairs.root == 0
    assert pairs.shape == (N, M, K, 3)


def npy(folder: Path, name: str, array: Any) -> Path:
    np.save(folder / name, array)
    return folder / name


def everything(shape: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(slice(0, length) for length in shape)


# --- forms that mean the same ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["hypotheses", "hyps", "arr_0", "samples"])
def test_hypotheses_are_found_by_name_or_as_the_only_array(tmp_path: Path, name: str) -> None:
    assert_plain(save(tmp_path / "h.npz", **{name: hypotheses()}), truth_file(tmp_path))


@pytest.mark.parametrize("name", ["truth", "gt", "arr_0", "poses_3d"])
def test_the_truth_is_found_by_name_or_as_the_only_array(tmp_path: Path, name: str) -> None:
    assert_plain(hypotheses_file(tmp_path), save(tmp_path / "g.npz", **{name: truth(), "joints": JOINTS}))


def test_two_bare_arrays_in_the_papers_layout_need_no_flag(tmp_path: Path) -> None:
    pairs = opened(npy(tmp_path, "h.npy", hypotheses()), npy(tmp_path, "g.npy", truth()))
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
    pairs = opened(ours, truth_file(tmp_path, truth=(truth() + 2000).astype(np.uint16)))
    np.testing.assert_array_equal(coordinates(pairs), moved)


@pytest.mark.parametrize("single", ["<f2", ">f2", "<f4", ">f4"])
def test_single_precision_stays_single_and_everything_else_is_double(tmp_path: Path, single: str) -> None:
    plain = truth_file(tmp_path)
    ours = opened(hypotheses_file(tmp_path, hypotheses=hypotheses().astype(single)), plain)
    assert coordinates(ours).dtype == np.float32
    assert coordinates(opened(hypotheses_file(tmp_path, hypotheses=hypotheses().astype("i4")), plain)).dtype == "f8"


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("axes", ["".join(letters) for letters in itertools.permutations("NMKD")])
def test_every_order_of_the_axes_is_read_where_it_is_declared(tmp_path: Path, axes: str, order: str) -> None:
    stored = np.asarray(hypotheses().transpose(["NMKD".index(letter) for letter in axes]), order=order)  # type: ignore[call-overload]
    assert_plain(hypotheses_file(tmp_path, hypotheses=stored, axes=axes), truth_file(tmp_path, axes="MKD"))


@pytest.mark.parametrize("axes", ["MKD", "MDK", "KMD", "KDM", "DMK", "DKM"])
def test_every_order_of_the_truths_axes_is_read_by_file_and_by_flag(tmp_path: Path, axes: str) -> None:
    stored = truth().transpose(["MKD".index(letter) for letter in axes])
    assert_plain(hypotheses_file(tmp_path), truth_file(tmp_path, truth=stored, axes=axes))
    assert_plain(hypotheses_file(tmp_path), truth_file(tmp_path, truth=stored), Join(truth_axes=axes))


def test_coordinates_before_joints_are_split_from_one_axis(tmp_path: Path) -> None:
    flat = hypotheses().transpose(1, 0, 3, 2).reshape(M, N, 3 * K)
    assert_plain(hypotheses_file(tmp_path, hypotheses=flat, axes="MN(DK)"), truth_file(tmp_path))


def test_joints_before_coordinates_are_split_from_one_axis_of_both(tmp_path: Path) -> None:
    ours = hypotheses_file(tmp_path, hypotheses=hypotheses().reshape(N, M, K * 3))
    assert_plain(ours, truth_file(tmp_path, truth=truth().reshape(M, K * 3)), Join(axes="NM(KD)"))


def test_clips_and_their_frames_are_the_poses_and_each_clip_a_sequence(tmp_path: Path) -> None:
    six, pairs = hypotheses()[:, :6], (truth()[:6], "MTKD")
    ours = hypotheses_file(tmp_path, hypotheses=six.reshape(N, 2, 3, K, 3), axes="NMTKD")
    theirs = truth_file(tmp_path, truth=pairs[0].reshape(2, 3, K, 3), axes="MTKD")
    found = opened(ours, theirs)
    np.testing.assert_array_equal(coordinates(found), six)
    np.testing.assert_array_equal(found.truth, truth()[:6])
    assert found.labels["sequence"].tolist() == ["0", "0", "0", "1", "1", "1"]


def test_frames_may_lie_outside_their_clips(tmp_path: Path) -> None:
    clips = hypotheses()[:, :6].reshape(N, 2, 3, K, 3)  # N M T K D
    ours = hypotheses_file(tmp_path, hypotheses=clips.transpose(2, 3, 0, 1, 4), axes="TKNMD")
    found = opened(ours, truth_file(tmp_path, truth=truth()[:6]))
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
        hypotheses_file(tmp_path, hypotheses=ours), truth_file(tmp_path, truth=theirs), Join(unit=unit)
    )  # the same by flag


def test_the_two_may_have_different_units(tmp_path: Path) -> None:
    ours = hypotheses_file(tmp_path, hypotheses=hypotheses() / 1000)
    assert_plain(ours, truth_file(tmp_path), Join(unit="m", truth_unit="mm"))
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
    assert opened(hypotheses_file(tmp_path), truth_file(tmp_path, clip=values)).labels["clip"].tolist() == read


def test_a_label_of_the_hypotheses_counts_too(tmp_path: Path) -> None:
    pairs = opened(hypotheses_file(tmp_path, camera=["left"] * M), truth_file(tmp_path))
    assert pairs.labels["camera"].tolist() == ["left"] * M


def test_other_members_of_a_file_are_passed_over(tmp_path: Path) -> None:
    ours = hypotheses_file(
        tmp_path, keypoints_2d=np.zeros((M, K, 2)), image_size=[1000, 1002], focal=np.ones(4), note="a word"
    )
    assert_plain(ours, truth_file(tmp_path))
    assert opened(ours, truth_file(tmp_path)).labels == {}


def test_objects_beside_the_poses_are_passed_over_and_never_unpickled(tmp_path: Path) -> None:
    np.savez(tmp_path / "h.npz", hypotheses=hypotheses(), settings=np.array({"a": 1}), ragged=np.array([None, 2]))
    assert_plain(tmp_path / "h.npz", truth_file(tmp_path))


def test_visible_is_the_opposite_of_occluded(tmp_path: Path) -> None:
    occluded = np.random.default_rng(1).random((M, K)) < 0.3
    for name, marks in (("occluded", occluded), ("visible", ~occluded)):
        found = opened(hypotheses_file(tmp_path), truth_file(tmp_path, **{name: marks})).occluded
        np.testing.assert_array_equal(found, occluded)


def test_scores_follow_their_frames(tmp_path: Path) -> None:
    scores, order = np.arange(N * M, dtype=np.float32).reshape(N, M), np.arange(M)[::-1]
    ours = hypotheses_file(
        tmp_path, hypotheses=hypotheses()[:, order], scores=scores[:, order], frame_id=np.array(FRAMES)[order]
    )
    np.testing.assert_array_equal(opened(ours, truth_file(tmp_path, frame_id=FRAMES)).scores, scores)


@pytest.mark.parametrize("rate", [np.array(50), np.array([50.0]), np.array(50, dtype=">f4")])
def test_frames_per_second_are_one_number(tmp_path: Path, rate: Any) -> None:
    assert opened(hypotheses_file(tmp_path), truth_file(tmp_path, fps=rate)).fps == 50


def test_a_file_of_python_2_is_read_without_a_word(tmp_path: Path) -> None:
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({N}L, {M}L, {K}L, 3L), }}".encode()
    header = header.ljust(117) + b"\n"
    contents = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + hypotheses().tobytes()
    (tmp_path / "h.npy").write_bytes(contents)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_plain(tmp_path / "h.npy", truth_file(tmp_path))


# --- parts of arrays in files ---------------------------------------------------------------------------------


@given(data=st.data(), shape=st.lists(st.integers(1, 5), min_size=1, max_size=5), fortran=st.booleans())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_part_of_an_array_in_a_file_is_that_part(
    tmp_path: Path, data: st.DataObject, shape: list[int], fortran: bool
) -> None:
    array = np.arange(np.prod(shape), dtype=data.draw(st.sampled_from(["<i2", ">f4", "<f8"]))).reshape(shape)
    where = []
    for length in shape:
        start = data.draw(st.integers(0, length - 1))
        where.append(slice(start, data.draw(st.integers(start + 1, length))))
    np.save(tmp_path / "a.npy", np.asarray(array, order="F" if fortran else "C"))
    with (tmp_path / "a.npy").open("rb", buffering=0) as file:
        np.lib.format.read_magic(file)
        _, stored_fortran, dtype = np.lib.format.read_array_header_1_0(file)
        stored = FileArray("a.npy", file, file.tell(), array.shape, dtype, stored_fortran)
        found = stored.part(tuple(where))
    assert found.dtype == array.dtype
    np.testing.assert_array_equal(found, array[tuple(where)])


def test_a_file_that_shrinks_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path = npy(tmp_path, "h.npy", hypotheses())
    array = read_poses(path, "hypotheses").array
    os.truncate(path, 1000)
    with pytest.raises(PoseFileError, match=r"^h\.npy: bytes .* can't be read .*Was it changed meanwhile\?$"):
        array.part(everything(array.shape))


# --- files that can't be read ---------------------------------------------------------------------------------


def broken_header(shape: str, tail: bytes = b"0" * 100) -> bytes:
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + tail


@pytest.mark.parametrize(
    ("contents", "words"),
    [
        (b"", r"h\.npz: empty file; expected an \.npz or \.npy file\."),
        (b"these are words", r"h\.npz is neither an \.npz nor an \.npy file; expected numpy\.savez or numpy\.save\."),
        (pickle.dumps([1, 2]), r"h\.npz looks like a pickle; expected .*posecal never unpickles\."),
        (b"PK\x03\x04 and no more", r"h\.npz: can't be read \(File is not a zip file\)\. Was it cut off\? Copy it"),
        (b"\x93NUMPY", r"h\.npz: no \.npy header that can be read"),
        (b"\x93NUMPY\x01\x00v\x00{'descr'", r"h\.npz: no \.npy header that can be read"),
        (broken_header("(2, 2, 2, 3)"), None),
        (
            broken_header("(2, 7, 17, 3)"),
            r"h\.npz: 100 of 2,856 bytes are there\. Was the file cut off\? Copy",
        ),
        (broken_header("(10**12, 7)"), r"h\.npz: no \.npy header that can be read"),
        (broken_header("(1000000000000, 7000000000000, 17, 3)"), r"h\.npz: 100 of 1,428,000,000,000,000,\S+ bytes"),
        (broken_header("(-5, 7, 17, 3)"), r"h\.npz: its header says \(-5, 7, 17, 3\); expected lengths of 0 or more"),
        (broken_header("__import__('os')"), r"h\.npz: no \.npy header that can be read"),
    ],
    ids=[
        *("empty", "text", "pickle", "zip cut off", "npy of 6 bytes", "npy header cut off", "whole", "npy cut off"),
        *("a sum as shape", "petabytes", "negative shape", "code as shape"),
    ],
)
def test_a_file_that_is_no_array_is_named_with_what_it_is(tmp_path: Path, contents: bytes, words: str | None) -> None:
    (tmp_path / "h.npz").write_bytes(contents)
    if words is None:
        assert read_poses(tmp_path / "h.npz", "hypotheses").array.shape == (2, 2, 2, 3)
        return
    with pytest.raises(PoseFileError, match=f"^{words}"):
        read_poses(tmp_path / "h.npz", "hypotheses")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"hyps\.npz: no such file\.$"):
        read_poses(tmp_path / "hyps.npz", "hypotheses")


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r": is a folder; expected an \.npz or \.npy file\.$"):
        read_poses(tmp_path, "hypotheses")


def test_a_file_that_the_system_does_not_give_is_refused(tmp_path: Path) -> None:
    (tmp_path / "round").symlink_to(tmp_path / "round")
    with pytest.raises(PoseFileError, match=r"round: can't be read \(Too many levels of symbolic links\)\.$"):
        read_poses(tmp_path / "round", "hypotheses")


def test_a_file_that_fails_while_it_is_read_is_refused() -> None:
    with pytest.raises(PoseFileError, match=r"mem: can't be read \(.*Input/output error\)"):
        read_poses("/proc/self/mem", "hypotheses")


def test_a_stream_is_refused_before_it_is_waited_for() -> None:
    reader, writer = os.pipe()
    os.close(writer)
    with pytest.raises(PoseFileError, match=r": is a stream; expected a file\. Save it first\.$"):
        read_poses(f"/dev/fd/{reader}", "hypotheses")
    os.close(reader)


def test_an_unknown_role_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PoseDataError, match=r"^role: 'hyps' is not known"):
        read_poses(tmp_path, "hyps")  # type: ignore[arg-type]


@pytest.mark.parametrize("share", [0.02, 0.3, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("write", [np.savez, np.savez_compressed])
def test_a_zip_cut_off_anywhere_is_refused(tmp_path: Path, write: Callable[..., None], share: float) -> None:
    write(tmp_path / "h.npz", hypotheses=hypotheses(), frame_id=FRAMES)
    whole = (tmp_path / "h.npz").read_bytes()
    (tmp_path / "h.npz").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(PoseFileError, match=r"^h\.npz: can't be read \(.*\)\. Was it cut off\? Copy it again\.$"):
        read_poses(tmp_path / "h.npz", "hypotheses")


@pytest.mark.parametrize("lost", [1, 5, 22])
def test_a_zip_that_lacks_its_last_bytes_is_refused(tmp_path: Path, lost: int) -> None:
    path = hypotheses_file(tmp_path)
    os.truncate(path, path.stat().st_size - lost)
    with pytest.raises(PoseFileError, match=r"Was it cut off\?"):
        read_poses(path, "hypotheses")


@pytest.mark.parametrize("write", [np.savez, np.savez_compressed])
@given(data=st.data())
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_zip_is_refused_or_read_right(
    tmp_path: Path, write: Callable[..., None], data: st.DataObject
) -> None:
    file = io.BytesIO()
    write(file, hypotheses=hypotheses()[:2, :2], frame_id=FRAMES[:2], unit="mm", scores=np.ones((2, 2)))
    contents = bytearray(file.getvalue())
    for _ in range(data.draw(st.integers(1, 3))):
        contents[data.draw(st.integers(0, len(contents) - 1))] ^= data.draw(st.integers(1, 255))
    (tmp_path / "h.npz").write_bytes(contents)
    try:
        found = read_poses(tmp_path / "h.npz", "hypotheses").array
    except PosecalError:
        return
    np.testing.assert_array_equal(found.part(everything(found.shape)), hypotheses()[:2, :2])


@pytest.mark.parametrize("dtype", ["c16", "b1", "U5", "S3", "M8[s]", [("x", "f4"), ("y", "f4")]])
def test_an_array_of_no_real_numbers_is_named_with_its_type(tmp_path: Path, dtype: Any) -> None:
    array = np.zeros((2, 3, 4, 3), dtype=dtype)
    with pytest.raises(PoseDataError, match=r"^h\.npy: dtype .*; expected real numbers such as float32\.$"):
        read_poses(npy(tmp_path, "h.npy", array), "hypotheses")
    with pytest.raises(PoseDataError, match=r"^h\.npz: hypotheses: dtype .*; expected real numbers"):
        read_poses(save(tmp_path / "h.npz", hypotheses=array), "hypotheses")


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_an_array_of_objects_is_refused_with_what_to_save(tmp_path: Path, suffix: str) -> None:
    array = np.empty(2, dtype=object)
    array[:] = [np.zeros(3), np.zeros(4)]
    path = tmp_path / f"h{suffix}"
    if suffix == ".npy":
        np.save(path, array, allow_pickle=True)
    else:
        np.savez(path, hypotheses=array)
    with pytest.raises(PoseDataError, match=r"is an array of Python objects, and posecal never unpickles\. Save num"):
        read_poses(path, "hypotheses")


def test_an_encrypted_member_is_refused(tmp_path: Path) -> None:
    contents = bytearray(hypotheses_file(tmp_path).read_bytes())
    contents[6] |= 1
    contents[contents.rfind(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "hyps.npz").write_bytes(contents)
    with pytest.raises(PoseFileError, match=r"^hyps\.npz: hypotheses is encrypted; expected a plain \.npz file\.$"):
        read_poses(tmp_path / "hyps.npz", "hypotheses")


def test_a_wrong_number_in_an_uncompressed_member_is_caught_by_its_checksum(tmp_path: Path) -> None:
    contents = bytearray(hypotheses_file(tmp_path).read_bytes())
    contents[3000] ^= 0x40  # one bit of one coordinate
    (tmp_path / "hyps.npz").write_bytes(contents)
    with pytest.raises(PoseFileError, match=r"^hyps\.npz: can't be read \(Bad CRC-32 for file 'hypotheses\.npy'\)"):
        read_poses(tmp_path / "hyps.npz", "hypotheses")


def test_a_compression_that_python_lacks_is_named(tmp_path: Path) -> None:
    contents = bytearray(hypotheses_file(tmp_path).read_bytes())
    contents[8] = contents[contents.rfind(b"PK\x01\x02") + 10] = 97
    (tmp_path / "hyps.npz").write_bytes(contents)
    with pytest.raises(PoseFileError, match=r"^hyps\.npz: That compression method.*Save it again with numpy"):
        read_poses(tmp_path / "hyps.npz", "hypotheses")


def test_a_disk_too_full_to_unpack_is_said(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "h.npz", hypotheses=np.zeros((50, 50, 17, 3)))
    code = (
        "import resource, sys; from posecal.io import read_poses\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "try: read_poses(sys.argv[1], 'hypotheses')\nexcept OSError as error: print(type(error).__name__, error)"
    )
    said = subprocess.run([sys.executable, "-c", code, tmp_path / "h.npz"], capture_output=True, text=True, check=True)
    assert said.stdout.startswith("PoseFileError h.npz: hypotheses: can't be unpacked into ")
    assert said.stdout.endswith("(File too large).\n")


# --- files that hold something else ---------------------------------------------------------------------------


def test_a_zip_without_arrays_holds_nothing(tmp_path: Path) -> None:
    with pytest.raises(PoseDataError, match=r"^h\.npz holds nothing; expected an array named hypotheses or hyps, or"):
        read_poses(member(tmp_path / "h.npz", "word/document.xml", b"<x/>"), "hypotheses")


def test_two_unnamed_arrays_are_listed(tmp_path: Path) -> None:
    path = save(tmp_path / "h.npz", a=np.zeros((2, 3, 4, 3)), b=np.zeros((3, 3)))
    with pytest.raises(PoseDataError, match=r"^h\.npz holds a \(2, 3, 4, 3\), b \(3, 3\); expected an array named hyp"):
        read_poses(path, "hypotheses")


def test_files_in_the_wrong_order_look_swapped(tmp_path: Path) -> None:
    with pytest.raises(PoseDataError, match=r"^gt\.npz holds truth \(7, 17, 3\) and no hypotheses or hyps\. The two f"):
        read_poses(truth_file(tmp_path), "hypotheses")
    with pytest.raises(PoseDataError, match=r"^hyps\.npz holds hypotheses \(5, 7, 17, 3\) and no truth or gt\. The tw"):
        read_poses(hypotheses_file(tmp_path), "truth")


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"axes": ["N", "M"]}, r"hyps\.npz: axes: 2 values; expected one word\."),
        ({"unit": np.array([], dtype="U2")}, r"hyps\.npz: unit: 0 values; expected one word\."),
        ({"frame_id": np.arange(M) / 2}, r"hyps\.npz: frame_id: float64 \(7,\); expected one word or whole number per"),
        ({"occluded": np.zeros((M, K))}, r"hyps\.npz: occluded: dtype float64; expected bool \(M, K\)\."),
        ({"visible": np.ones((M, K), dtype=int)}, r"hyps\.npz: visible: dtype int64; expected bool \(M, K\)\."),
        ({"scores": [["a"] * M] * N}, r"hyps\.npz: scores: dtype <U1; expected real numbers \(N, M\)\."),
        ({"scores": np.zeros((N, M), dtype=complex)}, r"hyps\.npz: scores: dtype complex128; expected real numbers"),
        ({"scores": np.full((N, M), np.nan)}, r"hyps\.npz: scores: 35 of 35 are NaN; expected numbers \(N, M\)\."),
        ({"fps": "fast"}, r"hyps\.npz: fps: <U4 \(\); expected one number\."),
        ({"fps": []}, r"hyps\.npz: fps: float64 \(0,\); expected one number\."),
        ({"fps": [25, 50]}, r"hyps\.npz: fps: int64 \(2,\); expected one number\."),
        ({"action": [b"\xe9"] * M}, r"hyps\.npz: action: 'utf-8' codec can't decode .*\. Save text, not bytes of ano"),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, dict) else "",
)
def test_a_member_of_the_wrong_kind_is_named(tmp_path: Path, members: dict[str, Any], words: str) -> None:
    with pytest.raises(PoseDataError, match=f"^{words}"):
        read_poses(hypotheses_file(tmp_path, **members), "hypotheses")


@pytest.mark.parametrize("name", ["frame_id", "joints", "action", "sequence", "subject", "camera", "scores"])
def test_a_known_member_of_objects_is_refused_with_what_to_save(tmp_path: Path, name: str) -> None:
    np.savez(tmp_path / "h.npz", hypotheses=hypotheses(), **{name: np.array(["a"] * M, dtype=object)})
    with pytest.raises(PoseDataError, match=rf"^h\.npz: {name}: can't be read \(Object .*\)\. Save text and numbers"):
        read_poses(tmp_path / "h.npz", "hypotheses")


def test_a_member_of_more_than_memory_is_refused(tmp_path: Path) -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("hypotheses.npy", npy(tmp_path, "h.npy", hypotheses()).read_bytes())
        archive.writestr("frame_id.npy", broken_header("(4000000000000000,)"))
    (tmp_path / "h.npz").write_bytes(file.getvalue())
    with pytest.raises(PoseDataError, match=r"^h\.npz: frame_id: can't be read \(Unable to allocate"):
        read_poses(tmp_path / "h.npz", "hypotheses")


def test_arrays_are_checked_as_members_are() -> None:
    assert as_labels(["a", "b"], "action").tolist() == ["a", "b"]
    with pytest.raises(PoseDataError, match=r"^action: float64 \(2,\); expected one word or whole number per pose"):
        as_labels([0.5, 1.5], "action")
    with pytest.raises(PoseDataError, match=r"^action: <U1 \(1, 2\); expected"):
        as_labels([["a", "b"]], "action")
    with pytest.raises(PoseDataError, match=r"^occluded: dtype int64; expected bool \(M, K\)\.$"):
        as_marks([[0, 1]], "occluded")
    assert as_scores([[1, 2]], "scores").dtype == np.float64
    with pytest.raises(PoseDataError, match=r"^scores: 1 of 2 are NaN"):
        as_scores([[np.nan, 2]], "scores")


# --- writing --------------------------------------------------------------------------------------------------


def test_a_file_is_written_whole_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    written_whole(tmp_path / "a.txt", lambda file: file.write(b"words"))
    assert (tmp_path / "a.txt").read_bytes() == b"words"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_what_was_there_stays_where_writing_fails(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"before")

    def fail(file: Any) -> None:
        file.write(b"half of it")
        raise OSError(28, "No space left on device")

    with pytest.raises(PoseFileError, match=r"a\.txt: can't be written \(No space left on device\)\.$"):
        written_whole(tmp_path / "a.txt", fail)
    assert (tmp_path / "a.txt").read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, RuntimeError])
def test_an_interruption_leaves_nothing_behind(tmp_path: Path, interruption: type[BaseException]) -> None:
    def stop(file: Any) -> None:
        file.write(b"half of it")
        raise interruption

    with pytest.raises(interruption):
        written_whole(tmp_path / "a.txt", stop)
    assert list(tmp_path.iterdir()) == []


def test_a_written_file_has_the_rights_that_the_user_gives_new_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        written_whole(tmp_path / "a.txt", lambda file: file.write(b""))
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


def test_a_link_stays_a_link_and_what_it_points_to_is_written(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "result.npz").symlink_to(tmp_path / "disk" / "result.npz")
    written_whole(tmp_path / "result.npz", lambda file: file.write(b"words"))
    assert (tmp_path / "result.npz").is_symlink()
    assert (tmp_path / "disk" / "result.npz").read_bytes() == b"words"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere/a.txt", r"nowhere/a\.txt: the folder .*nowhere does not exist\. Make it first\."),
        ("file/a.txt", r"file/a\.txt: the folder .*file does not exist\. Make it first\."),
        ("folder", r"folder: is a folder; expected the name of a file\."),
        ("pipe", r"pipe: is a device or a pipe; expected the name of a file\."),
        ("lost", r"lost: the folder .*gone does not exist\. Make it first\."),
    ],
)
def test_what_can_not_be_written_is_said_before_any_work(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "file").write_text("here")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "lost").symlink_to(tmp_path / "gone" / "a.txt")
    with pytest.raises(PoseFileError, match=f"{words}$"):
        check_writable(tmp_path / name)


def test_a_folder_that_takes_no_files_is_said() -> None:
    with pytest.raises(PoseFileError, match=r"^/proc/a\.txt: can't be written \(No such file or directory\)\.$"):
        check_writable("/proc/a.txt")


def test_a_device_is_never_replaced() -> None:
    with pytest.raises(PoseFileError, match=r"^/dev/null: is a device or a pipe; expected the name of a file\.$"):
        written_whole("/dev/null", lambda file: file.write(b""))
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
