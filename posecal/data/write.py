"""Writing of files, completely or not at all, and of ``.npz`` archives, member by member or piece by piece."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseFileError


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
    folder = _target(path).parent
    if not folder.is_dir():
        raise PoseFileError(f"{path}: the folder {folder} does not exist. Make it first.")
    if path.is_dir():
        raise PoseFileError(f"{path}: is a folder; expected the name of a file.")
    if path.exists() and not path.is_file():
        raise PoseFileError(f"{path}: is a device or a pipe; expected the name of a file.")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise PoseFileError(f"{path}: can't be written ({error.strerror}).") from None
    return path


def _target(path: Path) -> Path:
    """Follow links, so that what they point to is written and they stay; a plain name stays as it is."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def write_file(path: str | os.PathLike[str], write: Callable[[BinaryIO], object]) -> None:
    """Write a file completely or not at all: under another name or none, then renamed.

    Where the system can, the file has no name until it is complete, and vanishes with a process that is killed; else
    it has a temporary one in the same folder.

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
    target = _target(path)
    part = target.with_name(f".posecal-{secrets.token_hex(8)}")
    try:
        unnamed = _unnamed(target.parent)
        with unnamed or part.open("xb") as file:
            write(file)
            file.flush()
            if unnamed:
                _give_name(unnamed, part)
        part.replace(target)
    except OSError as error:
        raise PoseFileError(f"{path}: can't be written ({error.strerror or error}).") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def _unnamed(folder: Path) -> BinaryIO | None:
    """Open a file without a name; None where the system or the disk has no such thing."""
    if not hasattr(os, "O_TMPFILE") or not Path("/proc/self/fd").is_dir():
        return None
    try:
        return os.fdopen(os.open(folder, os.O_RDWR | os.O_TMPFILE, 0o666), "w+b")
    except OSError:
        return None


def _give_name(unnamed: BinaryIO, path: Path) -> None:
    """Link a file without a name to one; where the disk refuses that, copy it."""
    number = unnamed.fileno()
    try:  # any descriptor makes the system follow the link in /proc
        os.link(f"/proc/self/fd/{number}", path, src_dir_fd=number, follow_symlinks=True)
    except OSError:
        unnamed.seek(0)
        with path.open("xb") as copy:
            shutil.copyfileobj(unnamed, copy)


# --- archives -------------------------------------------------------------------------------------------------


class Archive(zipfile.ZipFile):
    """An .npz file that is being written.

    Parameters
    ----------
    file : binary file
        Where to.
    compressed : bool
        Whether members are compressed; those that are not can be memory-mapped later.
    """

    def __init__(self, file: BinaryIO, *, compressed: bool = False) -> None:
        super().__init__(file, "w", zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED)

    def add(self, name: str, array: npt.NDArray[Any]) -> None:
        """Write a member."""
        self.add_pieces(name, array.shape, array.dtype, [array])

    def add_pieces(
        self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any], pieces: Iterable[npt.NDArray[Any]]
    ) -> None:
        """Write a member of which only pieces along the first axis are at hand."""
        info = zipfile.ZipInfo(f"{name}.npy")  # of no date: the same arrays give the same bytes
        info.compress_type = self.compression
        with self.open(info, "w", force_zip64=True) as member:
            header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_2_0(member, header)
            for piece in pieces:
                member.write(np.ascontiguousarray(piece, dtype=dtype).tobytes())


def write_members(file: BinaryIO, members: Mapping[str, npt.NDArray[Any]], *, compressed: bool = False) -> None:
    """Write arrays as an .npz file."""
    with Archive(file, compressed=compressed) as archive:
        for name, array in members.items():
            archive.add(name, array)
