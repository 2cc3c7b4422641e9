"""Functions and metrics of the user's own, loaded from Python files."""

from __future__ import annotations

import inspect
import os
import runpy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import declared
from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.errors import PoseDataError, option


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
        text = Path(path).read_bytes()
    except OSError as error:
        raise PoseDataError(f"{what}: {path} can't be read ({error.strerror}).") from None
    try:
        names = _names_of(os.path.abspath(path), text)
    except (Exception, SystemExit) as error:  # the user's code fails in any way
        raise PoseDataError(f"{what}: {path} can't be run ({type(error).__name__}: {error}).") from error
    expected = " or ".join(["a function that takes poses", *(f"a {kind.__name__}" for kind in kinds)])
    if name not in names:
        raise PoseDataError(f"{what}: {path} has no function {name!r}; expected one that takes poses.")
    if not callable(names[name]) and not isinstance(names[name], kinds):
        raise PoseDataError(f"{what}: {name!r} in {path} is of type {type(names[name]).__name__}; expected {expected}.")
    return name, names[name]


@dataclass(frozen=True)
class FileFunction:
    """A function of a Python file, which other processes load again.

    Attributes
    ----------
    entry, what : str
        As for :func:`load_function`.
    """

    entry: str
    what: str

    def __call__(self, *arguments: Any) -> Any:
        """Call the function."""
        return load_function(self.entry, self.what)[1](*arguments)


@cache
def _names_of(path: str, _text: bytes) -> dict[str, Any]:
    """Run a file once, whatever number of its names are loaded, since it may register metrics."""
    return runpy.run_path(path)


def values_of_arrays(function: Callable[..., npt.ArrayLike], name: str, block: Block, *, by_joint: bool) -> FloatArray:
    """Apply a function of arrays to a block, and check what it gives."""
    truth, where = block.truth, block.where
    hypotheses = np.moveaxis(block.offsets + truth[..., None], -1, 0)
    expected = where.shape if by_joint else where.shape[:1]
    try:
        takes_mask = _takes_mask(function)
        with declared("mm" if block.period is None else "deg"):
            values = np.asarray(function(hypotheses, truth, **({"where": where} if takes_mask else {})))
        if np.iscomplexobj(values):
            raise PoseDataError(f"metric: {name} gave {values.dtype}; expected real numbers.")
        values = values.astype(np.float64)
    except PoseDataError:
        raise
    except Exception as error:  # the user's code fails in any way
        raise PoseDataError(
            f"metric: {name} fails on hypotheses {hypotheses.shape} ({type(error).__name__}: {error})."
        ) from error
    if values.shape != expected:
        hint = f", or {option('by_joint', True)}" if values.shape == where.shape else ""
        raise PoseDataError(f"metric: {name} gave {values.shape} for {len(truth)} poses; expected {expected}{hint}.")
    if by_joint:
        return np.where(where, values, np.nan)
    return values if takes_mask else np.where(where.all(axis=1), values, np.nan)


def _takes_mask(function: Callable[..., npt.ArrayLike]) -> bool:
    """Whether a function has a parameter ``where``; built-in ones without a signature are taken to have none."""
    try:
        return "where" in inspect.signature(function).parameters
    except ValueError:
        return False
