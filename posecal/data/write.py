"""How do results come into files? Whole or not at all, and what can't be written is said before any work."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from posecal.errors import PoseFileError

__all__ = ["check_writable", "write_file"]


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
    """Write a file whole or not at all: without its name, then renamed.

    Where the system can, the file has no name at all until it is whole, and vanishes with a process that is killed;
    else it has a temporary one beside it.

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
    """Let a file without a name appear under one; where the disk refuses that, copy it."""
    number = unnamed.fileno()
    try:  # any descriptor makes the system follow the link in /proc
        os.link(f"/proc/self/fd/{number}", path, src_dir_fd=number, follow_symlinks=True)
    except OSError:
        unnamed.seek(0)
        with path.open("xb") as copy:
            shutil.copyfileobj(unnamed, copy)
