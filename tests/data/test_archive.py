"""Members of archives are measured before they are read, none is dropped, and every checksum is compared."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posecal.data.archive import read_archive
from posecal.data.read import read_poses
from posecal.errors import PosecalError, PoseDataError, PoseFileError
from tests.helpers.small_files import FRAMES, JOINTS, M, hypotheses, save
from tests.helpers.small_files import hypotheses_file as whole_file


def everything(shape: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(slice(0, length) for length in shape)


def archive(path: Path, **contents: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as written:
        for name, data in contents.items():
            written.writestr(f"{name}.npy", data)
    return path


def npy(array: object, shape: str | None = None) -> bytes:
    """An array as .npy, with another shape in its header."""
    file = io.BytesIO()
    np.save(file, np.asarray(array))
    contents = file.getvalue()
    if shape is not None:
        stored = str(np.shape(array))
        padding = " " * (len(stored) - len(shape))
        contents = contents.replace(f"'shape': {stored}, }}".encode(), f"'shape': {shape}, }}{padding}".encode())
    return contents


def test_all_members_are_read(tmp_path: Path) -> None:
    found = read_archive(save(tmp_path / "a.npz", numbers=np.arange(6.0).reshape(2, 3), names=["a", "b"]))
    np.testing.assert_array_equal(found["numbers"], [[0, 1, 2], [3, 4, 5]])
    assert found["names"].tolist() == ["a", "b"]


def test_a_header_that_hides_numbers_is_refused_although_its_checksum_is_never_reached(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", hypotheses=npy(hypotheses(), "(4, 7, 17, 3)"))
    with pytest.raises(
        PoseFileError, match=r"^a\.npz: hypotheses: 7,140 bytes, of which \(4, 7, 17, 3\) float32 are 5,712"
    ):
        read_poses(path, "hypotheses")


def test_an_entry_that_the_directory_lost_is_missed(tmp_path: Path) -> None:
    path = whole_file(tmp_path, frame_id=FRAMES)
    contents = path.read_bytes()
    start = contents.rindex(b"PK\x01\x02")
    stop = contents.rindex(b"PK\x05\x06")
    end = bytearray(contents[stop:])
    end[8:12] = struct.pack("<HH", 1, 1)
    end[12:16] = struct.pack("<I", start - contents.index(b"PK\x01\x02"))
    path.write_bytes(contents[:start] + end)
    assert zipfile.ZipFile(path).namelist() == ["hypotheses.npy"]
    for read in (read_archive, lambda lost: read_poses(lost, "hypotheses")):
        with pytest.raises(PoseFileError, match=r"^hyps\.npz: its directory lacks members that lie in it\."):
            read(path)


@pytest.mark.parametrize("name", ["joints", "frame_id", "sequence", "scores", "occluded", "valid", "axes"])
def test_millions_of_values_beside_few_coordinates_are_refused_without_memory(tmp_path: Path, name: str) -> None:
    number = 4_000_000
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as written:
        written.writestr("hypotheses.npy", npy(hypotheses()))
        with written.open(f"{name}.npy", "w") as member:
            kind = {"scores": "f8", "occluded": "b1", "valid": "b1"}.get(name, "U1")
            header = {"descr": np.dtype(kind).str, "fortran_order": False, "shape": (number,)}
            np.lib.format.write_array_header_1_0(member, header)
            member.write(bytes(number * np.dtype(kind).itemsize))
    assert (tmp_path / "a.npz").stat().st_size < 100_000
    tracemalloc.start()
    with pytest.raises(PosecalError, match=rf"^a\.npz: {name} \(4000000,\) for coordinates \(5, 7, 17, 3\); expected"):
        read_poses(tmp_path / "a.npz", "hypotheses")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5_000_000


def test_labels_of_other_lengths_under_other_names_are_passed_over_however_many(tmp_path: Path) -> None:
    path = save(tmp_path / "a.npz", hypotheses=hypotheses(), joints=JOINTS, notes=np.zeros(3000, "U1"))
    assert "notes" not in read_poses(path, "hypotheses").labels


def test_bytes_that_claim_to_hold_more_than_can_be_packed_are_refused(tmp_path: Path) -> None:
    path = archive(tmp_path / "a.npz", hypotheses=npy(hypotheses()))
    contents = bytearray(path.read_bytes())
    for header, offset in ((0, 22), (contents.rindex(b"PK\x01\x02"), 24)):
        contents[header + offset : header + offset + 4] = struct.pack("<I", 10**9)
    path.write_bytes(contents)
    with pytest.raises(
        PoseFileError, match=r"^a\.npz: hypotheses: \S+ bytes claim to hold 1,000,000,000\. Copy it again"
    ):
        read_poses(path, "hypotheses")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda header: header.replace(b"(5, 7, 17, 3)", b"((((((((((((("),
        lambda header: header.replace(b"'fortran_order'", b"'fortran\\_rder'"),
        lambda header: header.replace(b"<f4", b"O*9"),
    ],
    ids=["open brackets", "another key", "no type"],
)
def test_headers_that_python_can_not_parse_are_refused_in_one_sentence(
    tmp_path: Path, spoil: Callable[[bytes], bytes]
) -> None:
    path = archive(tmp_path / "a.npz", hypotheses=spoil(npy(hypotheses())))
    with pytest.raises(PoseFileError, match=r"^a\.npz: hypotheses: no \.npy header that can be read \([^\n]*\)\.$"):
        read_poses(path, "hypotheses")


def test_objects_are_not_unpickled(tmp_path: Path) -> None:
    with pytest.raises(PoseDataError, match=r"^a\.npz: a: can't be read \(Objects are never unpickled\)"):
        read_archive(save(tmp_path / "a.npz", a=np.array([{}], object)))


def test_more_texts_than_numbers_are_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "a.npz", poses=np.zeros((M, 2)), names=np.zeros(2000, "U1"))
    with pytest.raises(PoseFileError, match=r"^a\.npz: names \(2000,\): more texts than numbers in any array\.$"):
        read_archive(path)
