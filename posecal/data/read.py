"""How do poses come out of files? Never unpickled, and without memory of their size.

``.npz`` and ``.npy`` are read. A member that was stored uncompressed is read where it lies in the zip, some poses at
a time; a compressed one is unpacked into an unnamed temporary file first, so that neither needs memory of its size.
"""

from __future__ import annotations

import lzma
import math
import os
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import IO, Literal, cast

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.file_array import FileArray
from posecal.data.pose_data import COMMON_LABELS, StoredPoses
from posecal.errors import PosecalError, PoseDataError, PoseFileError, did_you_mean

__all__ = ["Role", "as_labels", "as_marks", "as_scores", "read_poses"]

Role = Literal["hypotheses", "truth"]

_NAMES: dict[Role, tuple[str, ...]] = {"hypotheses": ("hypotheses", "hyps"), "truth": ("truth", "gt")}
_WORDS = ("axes", "unit")
_MARKS = ("occluded", "visible")
_RESERVED = (*_WORDS, *_MARKS, "joints", "frame_id", "scores", "fps")
_LABELS = "USbiu"
"""Kinds of arrays that can be labels: text, bytes, yes/no, whole numbers."""


def read_poses(path: str | os.PathLike[str], role: Role) -> StoredPoses:
    """Open a file of hypotheses or of true poses.

    Parameters
    ----------
    path : path
        An ``.npz`` or ``.npy`` file.
    role : str
        ``hypotheses`` or ``truth``: which array is looked for.

    Returns
    -------
    StoredPoses
        The coordinates, in the file, and everything that it declares.

    Raises
    ------
    PoseFileError
        For files that can't be read: missing, a folder, empty, cut off, of another kind.
    PoseDataError
        For files that lack the array, or whose members have the wrong type.

    Notes
    -----
    Differs from the published code: none.
    """
    if role not in _NAMES:
        raise PoseDataError(f"role: {role!r} is not known. {did_you_mean(role, _NAMES)}")
    path = Path(path)
    with _opened(path) as file:
        start = file.read(6)
        if not start:
            raise PoseFileError(f"{path.name}: empty file; expected an .npz or .npy file.")
        if start == b"\x93NUMPY":
            return StoredPoses(path.name, _coordinates(file, 0, path.name))
        if not start.startswith(b"PK"):
            what = "looks like a pickle" if start.startswith(b"\x80") else "is neither an .npz nor an .npy file"
            raise PoseFileError(f"{path.name} {what}; expected numpy.savez or numpy.save. posecal never unpickles.")
        found, array = _read_archive(file, path.name, role)
        if array.file is not file:
            file.close()
        return found


@contextmanager
def _opened(path: Path) -> Iterator[FileIO]:
    """Open a file for reading, and leave it open where its contents are still to be read."""
    try:
        file = path.open("rb", buffering=0)
    except FileNotFoundError:
        raise PoseFileError(f"{path}: no such file.") from None
    except IsADirectoryError:
        raise PoseFileError(f"{path}: is a folder; expected an .npz or .npy file.") from None
    except OSError as error:
        raise PoseFileError(f"{path}: can't be read ({error.strerror}).") from None
    try:
        if not file.seekable():
            raise PoseFileError(f"{path}: is a stream; expected a file. Save it first.")
        yield file
    except BaseException as error:
        file.close()
        if isinstance(error, PosecalError):
            raise
        if isinstance(error, NotImplementedError):
            raise PoseFileError(f"{path.name}: {error}. Save it again with numpy.savez_compressed.") from None
        if isinstance(error, _BROKEN):
            raise PoseFileError(f"{path.name}: can't be read ({error}). Was it cut off? Copy it again.") from None
        raise


_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError)
"""What the standard library raises for a file that is not what its first bytes say."""


def _read_archive(file: FileIO, name: str, role: Role) -> tuple[StoredPoses, FileArray]:
    archive = zipfile.ZipFile(file)
    members = {
        info.filename.removesuffix(".npy"): info for info in archive.infolist() if info.filename.endswith(".npy")
    }
    arrays = {key: _member_header(archive, info, f"{name}: {key}") for key, info in members.items()}
    chosen = _choose(arrays, name, role)
    array = _member_array(archive, file, members[chosen], f"{name}: {chosen}")

    def small(key: str) -> npt.NDArray[np.generic] | None:
        return _load(archive, members[key], f"{name}: {key}") if key in members else None

    labels = {}
    for key, (shape, dtype) in arrays.items():
        wanted = dtype.kind in _LABELS or (dtype.hasobject and key in COMMON_LABELS)
        if key not in (*_RESERVED, chosen) and len(shape) == 1 and wanted:
            labels[key] = as_labels(cast(npt.NDArray[np.generic], small(key)), f"{name}: {key}")
    joints, frame_id, scores = small("joints"), small("frame_id"), small("scores")
    found = StoredPoses(
        name=name,
        array=array,
        axes=_word(small("axes"), f"{name}: axes"),
        unit=_word(small("unit"), f"{name}: unit"),
        joints=None if joints is None else tuple(_text(joints.ravel(), f"{name}: joints").tolist()),
        frame_id=None if frame_id is None else as_labels(frame_id.ravel(), f"{name}: frame_id"),
        labels=labels,
        marks={key: as_marks(found, f"{name}: {key}") for key in _MARKS if (found := small(key)) is not None},
        scores=None if scores is None else as_scores(scores, f"{name}: scores"),
        fps=_number(small("fps"), f"{name}: fps"),
    )
    return found, array


def _choose(arrays: dict[str, tuple[tuple[int, ...], np.dtype[np.generic]]], name: str, role: Role) -> str:
    """Find the member that holds the coordinates."""
    for key in _NAMES[role]:
        if key in arrays:
            return key
    other: Role = "truth" if role == "hypotheses" else "hypotheses"
    swapped = [key for key in _NAMES[other] if key in arrays]
    wanted = " or ".join(_NAMES[role])
    if swapped:
        shape = arrays[swapped[0]][0]
        raise PoseDataError(f"{name} holds {swapped[0]} {shape} and no {wanted}. The two files look swapped.")
    large = [key for key, (shape, _) in arrays.items() if key not in _RESERVED and len(shape) > 1]
    if len(large) == 1:
        return large[0]
    held = ", ".join(f"{key} {shape}" for key, (shape, _) in arrays.items()) or "nothing"
    raise PoseDataError(f"{name} holds {held}; expected an array named {wanted}, or just one array of coordinates.")


def _member_header(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str
) -> tuple[tuple[int, ...], np.dtype[np.generic]]:
    if info.flag_bits & 0x1:
        raise PoseFileError(f"{name} is encrypted; expected a plain .npz file.")
    with archive.open(info) as member:
        shape, _, dtype = _header(member, name)
    return shape, dtype


def _header(file: IO[bytes], name: str) -> tuple[tuple[int, ...], bool, np.dtype[np.generic]]:
    try:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's remark on files of Python 2, which are as good as any
            shape, fortran, dtype = read(file)
    except (ValueError, SyntaxError, RecursionError, MemoryError) as error:
        raise PoseFileError(f"{name}: no .npy header that can be read ({error}).") from None
    if any(length < 0 for length in shape):
        raise PoseFileError(f"{name}: its header says {shape}; expected lengths of 0 or more.")
    return shape, fortran, dtype


def _member_array(archive: zipfile.ZipFile, file: FileIO, info: zipfile.ZipInfo, name: str) -> FileArray:
    if info.compress_type == zipfile.ZIP_STORED:
        with archive.open(info) as member:
            while member.read(1 << 20):  # to its end, where zipfile compares the checksum
                pass
        file.seek(info.header_offset + 26)  # the lengths of the name and of the extra field, just before them
        lengths = np.frombuffer(file.read(4), dtype="<u2")
        return _coordinates(file, info.header_offset + 30 + int(lengths.sum()), name)
    unpacked = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 (it lives as long as the array)
    try:
        with archive.open(info) as member:
            while data := member.read(1 << 20):
                _written(unpacked, data, name)
        return _coordinates(unpacked, 0, name)
    except BaseException:
        unpacked.close()
        raise


def _written(unpacked: FileIO, data: bytes, name: str) -> None:
    try:
        while data:
            data = data[unpacked.write(data) :]
    except OSError as error:
        raise PoseFileError(f"{name}: can't be unpacked into {tempfile.gettempdir()} ({error.strerror}).") from None


def _coordinates(file: FileIO, offset: int, name: str) -> FileArray:
    """Find an array of real numbers in a file."""
    file.seek(offset)
    shape, fortran, dtype = _header(cast(IO[bytes], file), name)
    if dtype.hasobject:
        raise PoseDataError(
            f"{name} is an array of Python objects, and posecal never unpickles. Save numbers: "
            "numpy.stack(list_of_arrays).astype(numpy.float32)."
        )
    if dtype.kind not in "fiu":
        raise PoseDataError(f"{name}: dtype {dtype}; expected real numbers such as float32.")
    found = FileArray(name, file, file.tell(), shape, dtype, fortran)
    missing, needed = found.bytes_missing, dtype.itemsize * math.prod(shape)
    if missing:
        raise PoseFileError(
            f"{name}: {needed - missing:,} of {needed:,} bytes are there. Was the file cut off? Copy it again."
        )
    return found


def _load(archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str) -> npt.NDArray[np.generic]:
    with archive.open(info) as member:
        try:
            return cast(npt.NDArray[np.generic], np.lib.format.read_array(member, allow_pickle=False))
        except (ValueError, SyntaxError, RecursionError, MemoryError) as error:
            raise PoseDataError(f"{name}: can't be read ({error}). Save text and numbers, not objects.") from None


def as_labels(values: npt.ArrayLike, name: str) -> npt.NDArray[np.str_]:
    """Give a label of every pose as text.

    Raises
    ------
    PoseDataError
        Where it is not one word, number or yes/no per pose.
    """
    array = np.asarray(values)
    if array.ndim != 1 or array.dtype.kind not in _LABELS:
        raise PoseDataError(f"{name}: {array.dtype} {array.shape}; expected one word or whole number per pose, (M,).")
    return _text(array, name)


def as_marks(values: npt.ArrayLike, name: str) -> BoolArray:
    """Give a mask of joints.

    Raises
    ------
    PoseDataError
        Where it is not boolean.
    """
    array = np.asarray(values)
    if array.dtype.kind != "b":
        raise PoseDataError(f"{name}: dtype {array.dtype}; expected bool (M, K).")
    return cast(BoolArray, array)


def as_scores(values: npt.ArrayLike, name: str) -> FloatArray:
    """Give the score of every hypothesis.

    Raises
    ------
    PoseDataError
        Where one is not a real number.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise PoseDataError(f"{name}: dtype {array.dtype}; expected real numbers (N, M).")
    unknown = int(np.isnan(array).sum())
    if unknown:
        raise PoseDataError(f"{name}: {unknown:,} of {array.size:,} are NaN; expected numbers (N, M).")
    return array.astype(np.float64)


def _text(array: npt.NDArray[np.generic], name: str) -> npt.NDArray[np.str_]:
    if array.dtype.kind == "S":
        try:
            return np.char.decode(array.astype(np.bytes_), "utf-8")
        except UnicodeDecodeError as error:
            raise PoseDataError(f"{name}: {error}. Save text, not bytes of another encoding.") from None
    if array.dtype.kind == "b":
        return np.where(array, "yes", "no")
    return array.astype(np.str_)


def _word(array: npt.NDArray[np.generic] | None, name: str) -> str | None:
    if array is None:
        return None
    if array.size != 1:
        raise PoseDataError(f"{name}: {array.size} values; expected one word.")
    return str(_text(array.ravel(), name)[0])


def _number(array: npt.NDArray[np.generic] | None, name: str) -> float | None:
    if array is None:
        return None
    if array.size != 1 or array.dtype.kind not in "fiu":
        raise PoseDataError(f"{name}: {array.dtype} {array.shape}; expected one number.")
    return float(array.astype(np.float64).ravel()[0])


# --- writing --------------------------------------------------------------------------------------------------
