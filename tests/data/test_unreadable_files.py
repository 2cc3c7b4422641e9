"""Files that can't be read, or hold something else, are refused in one sentence that names them."""

import io
import os
import pickle
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from posecal.data.arrays import as_labels, as_marks, as_scores
from posecal.data.file_array import FileArray, Source
from posecal.data.read import read_poses
from posecal.errors import PosecalError, PoseDataError, PoseFileError
from tests.helpers.small_files import (
    FRAMES,
    JOINTS,
    K,
    M,
    N,
    hypotheses,
    hypotheses_file,
    member,
    npy,
    save,
    truth,
    truth_file,
)


def everything(shape: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(slice(0, length) for length in shape)


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
        source = Source.of(tmp_path / "a.npy", file)
        stored = FileArray("a.npy", file, file.tell(), array.shape, dtype, source, stored_fortran)
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
        (broken_header("(2, 2, 2, 3)", b"0" * 96), None),
        (broken_header("(2, 2, 2, 3)"), r"h\.npz: 100 bytes, of which \(2, 2, 2, 3\) float32 are 96\. Was it edited\?"),
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
        *(
            "empty",
            "text",
            "pickle",
            "zip cut off",
            "npy of 6 bytes",
            "npy header cut off",
            "whole",
            "more",
            "npy cut off",
        ),
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


@pytest.mark.slow
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
    with pytest.raises(PoseFileError, match=r"^hyps\.npz: can't be read \(That compression method is not supported\)"):
        read_poses(tmp_path / "hyps.npz", "hypotheses")


def test_a_disk_too_full_to_unpack_is_said(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "h.npz", hypotheses=np.zeros((50, 50, 17, 3)))
    code = (
        "import resource, sys; from posecal.data.read import read_poses\n"
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
        (
            {"occluded": np.full((M, K), 0.5)},
            r"hyps\.npz: occluded: dtype float64, values 0\.5; expected bool \(M, K\), or ",
        ),
        ({"visible": np.full((M, K), 2)}, r"hyps\.npz: visible: dtype int64, values 2; expected bool \(M, K\), or "),
        ({"scores": [["a"] * M] * N}, r"hyps\.npz: scores: dtype <U1; expected real numbers such as float32\."),
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
    with pytest.raises(PoseDataError, match=rf"^h\.npz: {name}: can't be read \(Objects .*\)\. Save text and numbers"):
        read_poses(tmp_path / "h.npz", "hypotheses")


def test_a_member_of_more_than_memory_is_refused(tmp_path: Path) -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("hypotheses.npy", npy(tmp_path, "h.npy", hypotheses()).read_bytes())
        archive.writestr("frame_id.npy", broken_header("(4000000000000000,)"))
    (tmp_path / "h.npz").write_bytes(file.getvalue())
    with pytest.raises(PoseFileError, match=r"^h\.npz: frame_id: 100 of 16,000,000,000,000,000 bytes are there\."):
        read_poses(tmp_path / "h.npz", "hypotheses")


def test_arrays_are_checked_as_members_are() -> None:
    assert as_labels(["a", "b"], "action").tolist() == ["a", "b"]
    with pytest.raises(PoseDataError, match=r"^action: float64 \(2,\); expected one word or whole number per pose"):
        as_labels([0.5, 1.5], "action")
    with pytest.raises(PoseDataError, match=r"^action: <U1 \(1, 2\); expected"):
        as_labels([["a", "b"]], "action")
    with pytest.raises(
        PoseDataError, match=r"^occluded: dtype int64, values 0, 2; expected bool \(M, K\), or numbers 0 and 1\.$"
    ):
        as_marks([[0, 2]], "occluded")
    assert as_scores([[1, 2]], "scores").dtype == np.float64
    with pytest.raises(PoseDataError, match=r"^scores: 1 of 2 are NaN"):
        as_scores([[np.nan, 2]], "scores")


def dropped(path: Path, name: str) -> Path:
    """Take a member out of an archive's directory, and leave it in the file."""
    with zipfile.ZipFile(path, "a") as archive:
        archive.filelist = [info for info in archive.filelist if info.filename != f"{name}.npy"]
        archive._didModify = True  # type: ignore[attr-defined]
    return path


@pytest.mark.parametrize("name", ["truth", "joints", "sequence"])
def test_a_directory_that_lacks_a_member_is_refused(name: str, tmp_path: Path) -> None:
    """Without ``sequence``, intervals would be too narrow by half."""
    path = save(tmp_path / "gt.npz", truth=truth(), joints=JOINTS, sequence=np.arange(M))
    read_poses(path, "truth")
    with pytest.raises(PoseFileError, match=r"^gt\.npz: its directory (does not fit|lacks members)"):
        read_poses(dropped(path, name), "truth")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_member_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "gt.npz", truth=truth())
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("truth.npy", archive.read("truth.npy"))
    with pytest.raises(PoseFileError, match=r"^gt\.npz names members more than once\. Save it again\.$"):
        read_poses(path, "truth")


def test_compressed_and_stored_archives_are_whole(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "gt.npz", truth=truth(), joints=JOINTS)
    assert read_poses(tmp_path / "gt.npz", "truth").joints == tuple(JOINTS)


def test_a_member_whose_name_was_damaged_is_not_dropped(tmp_path: Path) -> None:
    path = save(tmp_path / "gt.npz", truth=truth(), sequence=np.arange(M))
    contents = path.read_bytes()
    at = contents.rindex(b"sequence.npy")
    path.write_bytes(contents[:at] + b"sequence.npx" + contents[at + 12 :])
    with pytest.raises(
        PoseFileError, match=r"^gt\.npz: holds sequence\.npx beside arrays; expected \.npy members alone\.$"
    ):
        read_poses(path, "truth")
