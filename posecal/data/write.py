"""Writing of files, completely or not at all, and of ``.npz`` archives, member by member or piece by piece."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from posecal.errors import PosecalError, PoseFileError


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


_outputs: ContextVar[list[_Output] | None] = ContextVar("outputs", default=None)
"""What is written together, within :func:`written_together`."""


class _Output:
    """A file under another name or none, until it is complete.

    Where the system can, it has no name and vanishes with a process that is killed; else it has a temporary one in the
    folder of its target. A file that it replaces gives it its rights.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.target = path, _target(path)
        self.part = self.target.with_name(f".posecal-{secrets.token_hex(8)}")
        unnamed = _unnamed(self.target.parent)
        self.is_named = unnamed is None
        self.file: BinaryIO = unnamed or self.part.open("xb")
        self._keep_rights(self.file)

    def _keep_rights(self, file: BinaryIO) -> None:
        with contextlib.suppress(OSError):  # there is no target, or its disk knows no rights
            rights = stat.S_IMODE(self.target.stat().st_mode)
            os.chmod(file.fileno() if os.chmod in os.supports_fd else self.part, rights)

    def store(self) -> None:
        """Wait until the contents are on the disk."""
        self.file.flush()
        os.fsync(self.file.fileno())

    def give_name(self) -> None:
        """Link a file without a name to the temporary one; where the disk refuses that, copy it."""
        if not self.is_named:
            number = self.file.fileno()
            try:  # any descriptor makes the system follow the link in /proc
                os.link(f"/proc/self/fd/{number}", self.part, src_dir_fd=number, follow_symlinks=True)
            except OSError:
                unnamed = self.file
                unnamed.seek(0)
                with unnamed, self.part.open("xb") as self.file:
                    self._keep_rights(self.file)
                    shutil.copyfileobj(unnamed, self.file)
                    self.store()
        self.file.close()

    def discard(self) -> None:
        """Close the file, and remove what has not become the target."""
        with contextlib.suppress(OSError):
            self.file.close()
        with contextlib.suppress(OSError):
            self.part.unlink(missing_ok=True)


@contextlib.contextmanager
def written_together() -> Iterator[list[_Output]]:
    """Make the files that :func:`write_file` writes within appear together at the end, or none of them.

    Raises
    ------
    PoseFileError
        Where one can't be written. What was there before stays, unless it is the renaming of complete files that fails
        part way: then those before it are new.
    """
    if (outer := _outputs.get()) is not None:
        yield outer
        return
    outputs: list[_Output] = []
    token = _outputs.set(outputs)
    try:
        yield outputs
        for output in outputs:
            with _refusing(output.path):
                output.give_name()
        for output in outputs:
            with _refusing(output.path):
                output.part.replace(output.target)
        for folder in {output.target.parent for output in outputs}:
            _store_names(folder)
    finally:
        _outputs.reset(token)
        for output in outputs:
            output.discard()


def write_file(path: str | os.PathLike[str], write: Callable[[BinaryIO], object]) -> None:
    """Write a file completely or not at all, with the rights of the one that it replaces.

    Parameters
    ----------
    path : path
        The file. It is there when this returns, or within :func:`written_together` at the end of that.
    write : callable
        Writes the contents into an open binary file.

    Raises
    ------
    PoseFileError
        Where it can't be written. What was there before stays.
    """
    path = check_writable(path)
    with written_together() as outputs, _refusing(path):
        output = _Output(path)
        outputs.append(output)
        write(output.file)
        output.store()


@contextlib.contextmanager
def _refusing(path: Path) -> Iterator[None]:
    try:
        yield
    except PosecalError:
        raise
    except OSError as error:
        raise PoseFileError(f"{path}: can't be written ({error.strerror or error}).") from None


def _unnamed(folder: Path) -> BinaryIO | None:
    """Open a file without a name; None where the system or the disk has no such thing."""
    if not hasattr(os, "O_TMPFILE") or not Path("/proc/self/fd").is_dir():
        return None
    try:
        return os.fdopen(os.open(folder, os.O_RDWR | os.O_TMPFILE, 0o666), "w+b")
    except OSError:
        return None


def _store_names(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where the system can."""
    with contextlib.suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


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
