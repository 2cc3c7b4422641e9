"""How do poses come out of files, and results into them? Mapped, never unpickled; written whole or not at all.

``.npz`` and ``.npy`` are read. A member that was stored uncompressed is memory-mapped where it lies in the zip; a
compressed one is unpacked into an unnamed temporary file first and mapped there, so that neither needs memory of
its size. A mapping is opened anew for every piece that is read, so that the pages of the last piece are let go.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO, Literal, cast

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError, PoseFileError
from posecal.pairs import Poses

__all__ = ["MappedArray", "Role", "as_labels", "check_writable", "read_poses", "written_whole"]

Role = Literal["hypotheses", "truth"]

_NAMES: dict[Role, tuple[str, ...]] = {"hypotheses": ("hypotheses", "hyps"), "truth": ("truth", "gt")}
_WORDS = ("axes", "unit")
_MARKS = ("occluded", "visible")
_RESERVED = (*_WORDS, *_MARKS, "joints", "frame_id", "scores", "fps")


@dataclass(frozen=True)
class MappedArray:
    """An array that lies in an open file.

    Attributes
    ----------
    file : binary file
        Open for as long as the array is used.
    offset : int
        Where its first byte lies.
    shape : tuple of int
        The length of every axis.
    dtype : numpy.dtype
        The type of its numbers.
    fortran : bool
        Whether the first axis is the fastest.
    """

    file: IO[bytes]
    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    fortran: bool

    def open(self) -> npt.NDArray[np.generic]:
        """Map the array; its pages are let go with it."""
        order: Literal["F", "C"] = "F" if self.fortran else "C"
        return np.memmap(self.file, self.dtype, "r", self.offset, self.shape, order).view(np.ndarray)


def read_poses(path: str | os.PathLike[str], role: Role) -> Poses:
    """Open a file of hypotheses or of true poses.

    Parameters
    ----------
    path : path
        An ``.npz`` or ``.npy`` file.
    role : str
        ``hypotheses`` or ``truth``: which array is looked for.

    Returns
    -------
    Poses
        The coordinates, mapped, and everything that the file declares.

    Raises
    ------
    PoseFileError
        For files that can't be read: missing, a folder, empty, cut off, of another kind.
    PoseDataError
        For files that lack the array, or whose members have the wrong type.
    """
    path = Path(path)
    with _opened(path) as file:
        start = file.read(6)
        if not start:
            raise PoseFileError(f"{path.name}: empty file; expected an .npz or .npy file.")
        if start == b"\x93NUMPY":
            array = _mapped(file, 0, path.name)
            _check_numbers(array, path.name)
            return Poses(path.name, array)
        if not start.startswith(b"PK"):
            what = "looks like a pickle" if start.startswith(b"\x80") else "is neither an .npz nor an .npy file"
            raise PoseFileError(f"{path.name} {what}; expected numpy.savez or numpy.save. posecal never unpickles.")
        try:
            return _read_archive(file, path.name, role)
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as error:
            raise PoseFileError(
                f"{path.name}: no whole zip archive ({error}). Was it cut off? Copy it again."
            ) from None


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading, and leave it open where its contents are mapped."""
    try:
        file = path.open("rb")
    except FileNotFoundError:
        raise PoseFileError(f"{path}: no such file.") from None
    except IsADirectoryError:
        raise PoseFileError(f"{path}: is a folder; expected an .npz or .npy file.") from None
    except OSError as error:
        raise PoseFileError(f"{path}: can't be read ({error.strerror}).") from None
    try:
        yield file
    except BaseException:
        file.close()
        raise


def _read_archive(file: BinaryIO, name: str, role: Role) -> Poses:
    archive = zipfile.ZipFile(file)
    members = {
        info.filename.removesuffix(".npy"): info for info in archive.infolist() if info.filename.endswith(".npy")
    }
    arrays = {key: _member_header(archive, info, f"{name}: {key}") for key, info in members.items()}
    chosen = _choose(arrays, name, role)
    array = _member_array(archive, file, members[chosen], f"{name}: {chosen}")
    _check_numbers(array, f"{name}: {chosen}")

    def small(key: str) -> npt.NDArray[np.generic] | None:
        return _load(archive, members[key], f"{name}: {key}") if key in members else None

    labels = {}
    for key, (shape, dtype) in arrays.items():
        if key not in (*_RESERVED, chosen) and len(shape) == 1 and dtype.kind in "USbiu":
            labels[key] = _text(cast(npt.NDArray[np.generic], small(key)))
    joints, frame_id = small("joints"), small("frame_id")
    scores, fps = small("scores"), small("fps")
    return Poses(
        name=name,
        array=array,
        axes=_word(small("axes"), f"{name}: axes"),
        unit=_word(small("unit"), f"{name}: unit"),
        joints=None if joints is None else tuple(_text(joints.ravel()).tolist()),
        frame_id=None if frame_id is None else _text(frame_id.ravel()),
        labels=labels,
        marks={key: _yes_no(found, f"{name}: {key}") for key in _MARKS if (found := small(key)) is not None},
        scores=None if scores is None else scores.astype(np.float64),
        fps=None if fps is None else float(fps.astype(np.float64).ravel()[0]),
    )


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
        return read(file)
    except ValueError as error:
        raise PoseFileError(f"{name}: no .npy header that can be read ({error}).") from None


def _member_array(archive: zipfile.ZipFile, file: BinaryIO, info: zipfile.ZipInfo, name: str) -> MappedArray:
    if info.compress_type == zipfile.ZIP_STORED:
        file.seek(info.header_offset + 26)  # the lengths of the name and of the extra field, just before them
        lengths = np.frombuffer(file.read(4), dtype="<u2")
        return _mapped(file, info.header_offset + 30 + int(lengths.sum()), name)
    unpacked = cast(BinaryIO, tempfile.TemporaryFile())  # noqa: SIM115 (it lives as long as the array)
    try:
        with archive.open(info) as member:
            shutil.copyfileobj(member, unpacked, 1 << 20)
        unpacked.flush()
    except OSError as error:
        unpacked.close()
        raise PoseFileError(f"{name}: can't be unpacked into {tempfile.gettempdir()} ({error.strerror}).") from None
    return _mapped(unpacked, 0, name)


def _mapped(file: BinaryIO, offset: int, name: str) -> MappedArray:
    file.seek(offset)
    shape, fortran, dtype = _header(file, name)
    start = file.tell()
    if dtype.hasobject:
        raise PoseDataError(
            f"{name} is an array of Python objects, and posecal never unpickles. Save numbers: "
            "numpy.stack(list_of_arrays).astype(numpy.float32)."
        )
    length = file.seek(0, os.SEEK_END) - start
    needed = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
    if length < needed:
        raise PoseFileError(f"{name}: {length:,} of {needed:,} bytes are there. Was the file cut off? Copy it again.")
    return MappedArray(file, start, shape, dtype, fortran)


def _check_numbers(array: MappedArray, name: str) -> None:
    if array.dtype.kind not in "fiu":
        raise PoseDataError(f"{name}: dtype {array.dtype}; expected real numbers such as float32.")


def _load(archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str) -> npt.NDArray[np.generic]:
    with archive.open(info) as member:
        try:
            return cast(npt.NDArray[np.generic], np.lib.format.read_array(member, allow_pickle=False))
        except ValueError as error:
            raise PoseDataError(f"{name}: can't be read ({error}). Save text and numbers, not objects.") from None


def as_labels(values: npt.ArrayLike, name: str) -> npt.NDArray[np.str_]:
    """Give a label of every pose as text.

    Raises
    ------
    PoseDataError
        Where it is not one word, number or yes/no per pose.
    """
    array = np.asarray(values)
    if array.ndim != 1 or array.dtype.kind not in "USbiu":
        raise PoseDataError(f"{name}: {array.dtype} {array.shape}; expected one word or whole number per pose, (M,).")
    return _text(array)


def _text(array: npt.NDArray[np.generic]) -> npt.NDArray[np.str_]:
    if array.dtype.kind == "S":
        return np.char.decode(array.astype(np.bytes_), "utf-8")
    if array.dtype.kind == "b":
        return np.where(array, "yes", "no")
    return array.astype(np.str_)


def _word(array: npt.NDArray[np.generic] | None, name: str) -> str | None:
    if array is None:
        return None
    if array.size != 1:
        raise PoseDataError(f"{name}: {array.size} values; expected one word.")
    return str(_text(array.ravel())[0])


def _yes_no(array: npt.NDArray[np.generic], name: str) -> npt.NDArray[np.bool_]:
    if array.dtype.kind != "b":
        raise PoseDataError(f"{name}: dtype {array.dtype}; expected bool (M, K).")
    return cast(npt.NDArray[np.bool_], array)


# --- writing --------------------------------------------------------------------------------------------------


def check_writable(path: str | os.PathLike[str]) -> Path:
    """Check, before the work is done, that a file can be written.

    Parameters
    ----------
    path : path
        The file to be written.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    PoseFileError
        Where its folder does not exist, or nothing can be written into it.
    """
    path = Path(path)
    folder = path.parent
    if not folder.is_dir():
        raise PoseFileError(f"{path}: the folder {folder} does not exist. Make it first.")
    if path.is_dir():
        raise PoseFileError(f"{path}: is a folder; expected the name of a file.")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise PoseFileError(f"{path}: can't be written ({error.strerror}).") from None
    return path


def written_whole(path: str | os.PathLike[str], write: Callable[[BinaryIO], object]) -> None:
    """Write a file whole or not at all: under a temporary name beside it, then renamed.

    Parameters
    ----------
    path : path
        The file.
    write : callable
        Writes the contents into an open binary file.

    Raises
    ------
    PoseFileError
        Where it can't be written. What was there before stays.
    """
    path = check_writable(path)
    part = None
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            part = Path(file.name)
            write(cast(BinaryIO, file))
        part.chmod(0o666 & ~_umask())
        part.replace(path)
        part = None
    except OSError as error:
        raise PoseFileError(f"{path}: can't be written ({error.strerror or error}).") from None
    finally:
        if part is not None:
            part.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
