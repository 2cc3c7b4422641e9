"""Arrays in files, read some poses at a time without memory of their size, and never unpickled.

An array that lies uncompressed in its file is mapped where it lies; a compressed member of an ``.npz`` is unpacked into
an unnamed temporary file first. A map of the complete array would not do: its pages count as memory of the process, and
the kernel brings up to two megabytes around each byte that is touched, so that some poses of each of 200 hypotheses
would hold half a gigabyte. So each run of bytes that lie together has a map of its own while it is copied.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
import weakref
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from io import FileIO
from itertools import product
from pathlib import Path
from typing import IO, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from posecal.data.archive import Member, check_length, read_header
from posecal.errors import PoseDataError, PoseFileError, refuse_unreadable


class Source(NamedTuple):
    """A file that an array is from, its size and time of change, and the member that was unpacked, None for none."""

    path: Path
    size: int
    modified: int
    member: str | None = None

    @classmethod
    def of(cls, path: Path, file: FileIO, member: str | None = None) -> Source:
        """Describe an open file."""
        status = os.fstat(file.fileno())
        return cls(path.absolute(), status.st_size, status.st_mtime_ns, member)


@dataclass(frozen=True)
class FileArray:
    """An array that lies in an open file, as a :class:`posecal.data.layout.LazyArray`.

    Pickled, it holds the path of its file, which is opened again, and unpacked again if need be.

    Attributes
    ----------
    name : str
        What messages call it.
    file : FileIO
        Unbuffered; closed when the array is no longer used.
    offset : int
        Where its first byte lies.
    shape : tuple of int
        The length of every axis.
    dtype : numpy.dtype
        The type of its numbers.
    source : Source
        What the file is.
    fortran : bool
        Whether the first axis is the fastest.
    """

    name: str
    file: FileIO
    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    source: Source
    fortran: bool = False

    def __post_init__(self) -> None:
        weakref.finalize(self, self.file.close)

    def __reduce__(self) -> tuple[object, ...]:
        return _open_again, (self.name, self.offset, self.shape, self.dtype, self.source, self.fortran)

    def part(self, where: tuple[slice, ...]) -> npt.NDArray[np.generic]:
        """Read a range of every axis.

        Parameters
        ----------
        where : tuple of slice
            ``slice(start, stop)`` for each axis, within its length.

        Returns
        -------
        array
            In memory.

        Raises
        ------
        PoseFileError
            Where the file ends before the array does, or can't be mapped.
        """
        shape, ranges = (self.shape[::-1], where[::-1]) if self.fortran else (self.shape, where)
        part = np.empty([one.stop - one.start for one in ranges], dtype=self.dtype)
        cut = max((axis for axis, length in enumerate(part.shape) if length < shape[axis]), default=0)
        runs = part.view(np.uint8).reshape(math.prod(part.shape[:cut]), -1)
        for run, start in zip(runs, _starts(shape, ranges, cut), strict=True):
            self._fill(run.data, self.offset + start * self.dtype.itemsize)
        return part.T if self.fortran else part

    def _fill(self, run: memoryview, offset: int) -> None:
        if not run:
            return
        before = offset % mmap.ALLOCATIONGRANULARITY
        try:
            pages = mmap.mmap(self.file.fileno(), before + len(run), access=mmap.ACCESS_READ, offset=offset - before)
        except (ValueError, OSError) as error:
            where = f"bytes {offset:,} to {offset + len(run):,}"
            raise PoseFileError(f"{self.name}: {where} can't be read ({error}). Was it changed meanwhile?") from None
        with pages, memoryview(pages) as view:
            run[:] = view[before:]


def _starts(shape: tuple[int, ...], ranges: tuple[slice, ...], cut: int) -> Iterator[int]:
    """Give the index of the first number of each run, which holds all of the axes after ``cut``."""
    step = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    for outer in product(*(range(one.start, one.stop) for one in ranges[:cut])):
        yield sum(index * length for index, length in zip(outer, step, strict=False)) + ranges[cut].start * step[cut]


# --- opening --------------------------------------------------------------------------------------------------


_is_checked = ContextVar("_is_checked", default=True)


@contextmanager
def without_checksums() -> Iterator[None]:
    """Open arrays without reading all of them, where they are opened once more to be read."""
    before = _is_checked.set(False)
    try:
        yield
    finally:
        _is_checked.reset(before)


@contextmanager
def opened(path: Path) -> Iterator[FileIO]:
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
        with refuse_unreadable(path):
            if not file.seekable():
                raise PoseFileError(f"{path}: is a stream; expected a file. Save it first.")
            yield file
    except BaseException:
        file.close()
        raise


def _open_again(
    name: str, offset: int, shape: tuple[int, ...], dtype: np.dtype[np.generic], source: Source, fortran: bool
) -> FileArray:
    with opened(source.path) as file:
        if Source.of(source.path, file, source.member) != source:
            raise PoseFileError(f"{name}: has changed since it was opened. Open it again.")
        if source.member is None:
            return FileArray(name, file, offset, shape, dtype, source, fortran)
        archive = zipfile.ZipFile(file)
        array = open_member(Member(archive, archive.getinfo(source.member), name), file, source.path)
        file.close()
        return array


def open_array(file: FileIO, offset: int, name: str, source: Source, length: int | None = None) -> FileArray:
    """Find an array of real numbers, with its header, in an open file, of which it takes ``length`` bytes or the rest.

    Raises
    ------
    PoseDataError
        For an array of something else.
    PoseFileError
        Where the header can't be read, or does not fit the bytes that are there.
    """
    file.seek(offset)
    shape, fortran, dtype = read_header(cast(IO[bytes], file), name)
    if dtype.hasobject:
        raise PoseDataError(
            f"{name} is an array of Python objects, and posecal never unpickles. Save numbers: "
            "numpy.stack(list_of_arrays).astype(numpy.float32)."
        )
    if dtype.kind not in "fiu":
        raise PoseDataError(f"{name}: dtype {dtype}; expected real numbers such as float32.")
    start = file.tell()
    end = file.seek(0, 2) if length is None else offset + length
    check_length(name, shape, dtype, end - start)
    return FileArray(name, file, start, shape, dtype, source, fortran)


def open_member(member: Member, file: FileIO, path: Path) -> FileArray:
    """Find the array that is a member of an open ``.npz`` file, or unpack it.

    Raises
    ------
    PoseDataError, PoseFileError
        As :func:`open_array`, and where there is no space to unpack.
    """
    archive, info, name = member.archive, member.info, member.name
    if info.compress_type == zipfile.ZIP_STORED:
        if _is_checked.get():
            with archive.open(info) as stored:
                while stored.read(1 << 20):  # to its end, where zipfile compares the checksum
                    pass
        file.seek(info.header_offset + 26)  # the lengths of the name and of the extra field, just before them
        lengths = np.frombuffer(file.read(4), dtype="<u2")
        start = info.header_offset + 30 + int(lengths.sum())
        return open_array(file, start, name, Source.of(path, file), info.file_size)
    unpacked = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 (it lives as long as the array)
    try:
        with archive.open(info) as packed:
            while data := packed.read(1 << 20):
                _write(unpacked, data, name)
        return open_array(unpacked, 0, name, Source.of(path, file, info.filename))
    except BaseException:
        unpacked.close()
        raise


def _write(unpacked: FileIO, data: bytes, name: str) -> None:
    try:
        while data:
            data = data[unpacked.write(data) :]
    except OSError as error:
        raise PoseFileError(f"{name}: can't be unpacked into {tempfile.gettempdir()} ({error.strerror}).") from None
