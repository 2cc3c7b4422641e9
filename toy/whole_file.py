"""How does a file come to be whole or not at all?

It is written under a temporary name in its own folder and then takes its name in one step.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from posecal.errors import PoseFileError

__all__ = ["make_folder", "whole_file"]


def make_folder(path: Path) -> None:
    """Make a folder, in a folder that is there; do nothing where it is there itself.

    Parameters
    ----------
    path : Path
        The folder.

    Raises
    ------
    PoseFileError
        Where it can't be made.
    """
    try:
        path.mkdir(exist_ok=True)
    except OSError as error:
        raise PoseFileError(
            f"{path}: can't be made ({error.strerror}). Make the folder above it first."
        ) from error


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, which becomes ``path`` when all has gone well.

    Parameters
    ----------
    path : Path
        What the file is to be called.

    Yields
    ------
    Path
        A name with the same ending in the same folder.

    Raises
    ------
    PoseFileError
        Where the folder is not there or can't be written to.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with whole_file(Path(folder) / "a.txt") as part:
    ...         _ = part.write_text("all of it")
    ...     print([file.name for file in Path(folder).iterdir()])
    ['a.txt']
    """
    part = path.with_name(f".{path.stem}.part{os.getpid()}{path.suffix}")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise PoseFileError(f"{path}: can't be written ({reason}). Choose a folder that is there.") from error
    finally:
        part.unlink(missing_ok=True)
