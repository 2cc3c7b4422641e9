"""Archives of arrays, ``.npz``: every member is measured by its header before it takes memory, and read to its end.

NumPy's own reader believes the directory: a member that it does not name is not missed, a header that says less than
there is hides the rest, and no checksum is compared where the end is not reached.
"""

from __future__ import annotations

import io
import math
import os
import warnings
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError, PoseFileError, first_few, refuse_unreadable

Header = tuple[tuple[int, ...], bool, np.dtype[np.generic]]

_DESCRIPTOR = 24
"""The most bytes that may follow the contents of a member: its checksum and sizes."""
_RATIO = 1100
"""What zip's own compression can save at most."""
_ALWAYS_READ = 1000
"""Texts that are read whatever there are of numbers."""


@dataclass(frozen=True)
class Member:
    """An array in an open archive.

    Attributes
    ----------
    archive : zipfile.ZipFile
        The archive.
    info : zipfile.ZipInfo
        Its entry in the directory.
    name : str
        What messages call it.
    """

    archive: zipfile.ZipFile
    info: zipfile.ZipInfo
    name: str

    @cached_property
    def header(self) -> Header:
        """Shape, order and dtype.

        Raises
        ------
        PoseFileError
            Where they can't be read, or fit another number of bytes than the archive holds.
        """
        with self.archive.open(self.info) as member:
            shape, fortran, dtype = read_header(member, self.name)
            if not dtype.hasobject:
                check_length(self.name, shape, dtype, self.info.file_size - member.tell())
        return shape, fortran, dtype

    def contents(self) -> bytes:
        """Read all bytes, to the end, where the checksum is compared."""
        return self.archive.read(self.info)

    def read(self) -> npt.NDArray[Any]:
        """Read the array; objects are not unpickled.

        Raises
        ------
        PoseDataError
            Where it holds objects.
        PoseFileError
            Where it can't be read.
        """
        _, _, dtype = self.header
        if dtype.hasobject:
            raise PoseDataError(
                f"{self.name}: can't be read (Objects are never unpickled). Save text and numbers, not objects."
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's remark on files of Python 2, which are as good as any
            array: npt.NDArray[Any] = np.lib.format.read_array(io.BytesIO(self.contents()), allow_pickle=False)
        return array


def open_archive(file: IO[bytes], name: str) -> dict[str, Member]:
    """Find the arrays of an archive whose directory names what lies in the file, each member once, one after another.

    Parameters
    ----------
    file : binary file
        It stays open.
    name : str
        What messages call it.

    Returns
    -------
    dict of str to Member
        By name, without ``.npy``; none where the archive holds something else altogether.

    Raises
    ------
    PoseFileError
        Where a member is named twice or is no array, is encrypted, claims more than can be packed into its bytes, or
        there are bytes between members that no member accounts for.
    """
    archive = zipfile.ZipFile(file)
    infos = sorted(archive.infolist(), key=lambda info: info.header_offset)
    if len({info.filename for info in infos}) < len(infos):
        raise PoseFileError(f"{name} names members more than once. Save it again.")
    end = 0
    for info in infos:
        if not end <= info.header_offset <= end + _DESCRIPTOR:
            raise PoseFileError(
                f"{name}: its directory does not fit its contents. Was it cut off or edited? Copy it again."
            )
        file.seek(info.header_offset + 26)
        lengths = file.read(4)
        names = sum(int.from_bytes(lengths[at : at + 2], "little") for at in (0, 2))
        end = info.header_offset + 30 + names + info.compress_size
    if infos and not end <= archive.start_dir <= end + _DESCRIPTOR:
        raise PoseFileError(f"{name}: its directory lacks members that lie in it. Was it edited? Copy it again.")
    members = {
        info.filename.removesuffix(".npy"): Member(archive, info, f"{name}: {info.filename.removesuffix('.npy')}")
        for info in archive.infolist()
        if info.filename.endswith(".npy")
    }
    others = [info.filename for info in infos if not info.filename.endswith(".npy")]
    if members and others:  # one changed letter of a name would drop a member
        raise PoseFileError(f"{name}: holds {first_few(others)} beside arrays; expected .npy members alone.")
    for member in members.values():
        if member.info.flag_bits & 0x1:
            raise PoseFileError(f"{member.name} is encrypted; expected a plain .npz file.")
        packed, size = member.info.compress_size, member.info.file_size
        known = member.info.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        if known and size > _RATIO * packed:
            raise PoseFileError(f"{member.name}: {packed:,} bytes claim to hold {size:,}. Copy it again.")
    return members


def read_archive(
    path: str | os.PathLike[str], sentence: str = "can't be read as .npz ({})."
) -> dict[str, npt.NDArray[Any]]:
    """Read all arrays of an ``.npz`` file.

    Parameters
    ----------
    path : path
        The file.
    sentence : str
        What the message says of one that can't be read, as for :func:`posecal.errors.refuse_unreadable`.

    Returns
    -------
    dict of str to array
        By name.

    Raises
    ------
    PoseFileError
        Where the file can't be read, or holds anything else.
    """
    path = Path(path)
    with refuse_unreadable(path, sentence), path.open("rb") as file:
        if file.read(6) == b"\x93NUMPY":
            raise ValueError("it holds one array without a name; expected numpy.savez(file, name=array)")
        members = open_archive(file, path.name)
        headers = {key: member.header for key, member in members.items()}
        most = max((math.prod(shape) for shape, _, dtype in headers.values() if dtype.kind in "fiu"), default=0)
        for key, (shape, _, dtype) in headers.items():
            if dtype.kind in "US" and math.prod(shape) > max(most, _ALWAYS_READ):
                raise PoseFileError(f"{path.name}: {key} {shape}: more texts than numbers in any array.")
        return {key: member.read() for key, member in members.items()}


def read_header(file: IO[bytes], name: str) -> Header:
    """Read shape, order and dtype of an array.

    Raises
    ------
    PoseFileError
        Where they can't be read.
    """
    sentence = "no .npy header that can be read ({})."
    with refuse_unreadable(name, sentence, name), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files of Python 2, and of what Python's parser finds in other text
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(file)
    if any(length < 0 for length in shape):
        raise PoseFileError(f"{name}: its header says {shape}; expected lengths of 0 or more.")
    return shape, fortran, dtype


def check_length(name: str, shape: tuple[int, ...], dtype: np.dtype[np.generic], there: int) -> None:
    """Refuse an array of which there are fewer bytes, or more, than its header says.

    Raises
    ------
    PoseFileError
        With both numbers.
    """
    needed = dtype.itemsize * math.prod(shape)
    if there < needed:
        raise PoseFileError(
            f"{name}: {max(0, there):,} of {needed:,} bytes are there. Was the file cut off? Copy it again."
        )
    if there > needed:
        raise PoseFileError(
            f"{name}: {there:,} bytes, of which {shape} {dtype} are {needed:,}. Was it edited? Save one array alone."
        )
