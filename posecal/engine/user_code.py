"""Functions and metrics of the user's own, loaded from Python files."""

from __future__ import annotations

import runpy
from typing import Any

from posecal.errors import PoseDataError


def load_function(entry: str, what: str, *kinds: type) -> tuple[str, Any]:
    """Load a function from a Python file.

    Parameters
    ----------
    entry : str
        ``FILE.py:NAME``.
    what : str
        What it is, for messages: ``metric`` or ``prerank``.
    *kinds : type
        Classes whose instances do as well as a function, such as ``Metric``.

    Returns
    -------
    name : str
        Its name.
    function : callable or instance of ``kinds``
        What the file gives that name.

    Raises
    ------
    PoseDataError
        Where there is no such file or name, or the file fails.
    """
    path, _, name = entry.rpartition(":")
    if not path.endswith(".py") or not name.isidentifier():
        raise PoseDataError(f"{what}: {entry!r}; expected FILE.py:NAME.")
    try:
        loaded = runpy.run_path(path).get(name)
    except OSError as error:
        raise PoseDataError(f"{what}: {path} can't be read ({error.strerror}).") from None
    except (Exception, SystemExit) as error:  # the user's code fails in any way
        raise PoseDataError(f"{what}: {path} can't be run ({type(error).__name__}: {error}).") from error
    if not callable(loaded) and not isinstance(loaded, kinds):
        raise PoseDataError(f"{what}: {path} has no function {name!r}; expected one that takes poses.")
    return name, loaded
