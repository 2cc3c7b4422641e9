"""Addresses of files that fsspec reads, such as ``s3://bucket/hyps.npz``."""

from __future__ import annotations

import glob
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from posecal.errors import PosecalError, PoseDataError, PoseFileError


def is_address(source: object) -> bool:
    """Whether this is the address of a file, and not its path."""
    return isinstance(source, str) and "://" in source


def name_of(source: str | os.PathLike[str]) -> str:
    """Give the name of a file, of an address or a path."""
    return os.fspath(source).rpartition("/")[2] if is_address(source) else Path(source).name


@contextmanager
def local_copy(address: str) -> Iterator[Path]:
    """Copy a file into a temporary folder, which is deleted at the end.

    Raises
    ------
    PoseFileError
        Where it can't be read.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name_of(address) or "file")
        with _refusing(address):
            files, place = _files_of(address)
            files.get_file(place, str(path))
        yield path


def files_of_pattern(pattern: str) -> list[str]:
    """Give the paths or addresses that a pattern with stars stands for, in the order of their names."""
    if not is_address(pattern):
        return sorted(glob.glob(re.sub(r"([?[])", r"[\1]", pattern), recursive=True))
    with _refusing(pattern):
        files, place = _files_of(pattern)
        return sorted(files.unstrip_protocol(path) for path in files.glob(place))


def identity_of(source: str | os.PathLike[str]) -> str:
    """Give what changes when a file does: where it lies, its size and its time of change, or what its protocol has."""
    if is_address(source):
        with _refusing(str(source)):
            files, place = _files_of(str(source))
            return f"{source} {files.ukey(place)}"
    path = Path(source).absolute()
    try:
        status = path.stat()
    except OSError as error:
        raise PoseFileError(f"{path}: can't be read ({error.strerror}).") from None
    return f"{path} {status.st_size} {status.st_mtime_ns}"


@contextmanager
def _refusing(address: str) -> Iterator[None]:
    """Refuse what can't be read, whatever the protocol of an address raises."""
    try:
        yield
    except PosecalError:
        raise
    except FileNotFoundError:
        raise PoseFileError(f"{address}: no such file.") from None
    except Exception as error:
        raise PoseFileError(f"{address}: can't be read ({type(error).__name__}: {error}).") from error


def _files_of(address: str) -> tuple[Any, str]:
    """Give the file system of an address, and the place in it."""
    try:
        import fsspec
    except ImportError:
        raise PoseDataError(
            f"{address}: an address; expected a path, or fsspec to read it by: pip install 'posecal[remote]'."
        ) from None
    try:
        files, place = fsspec.core.url_to_fs(address)
    except (ValueError, ImportError) as error:
        raise PoseDataError(f"{address}: can't be opened ({error}).") from None
    return files, str(place)
