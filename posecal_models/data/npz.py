"""Readers of plain arrays in ``.npz`` files, without unpickling, and checks of their types and shapes."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.archive import read_archive
from posecal.data.joint_names import repeated_names
from posecal.data.layout import TRUTH, Layout, MemoryArray
from posecal.errors import PoseDataError, PoseFileError, first_few, reason

__all__ = [
    "boolean_array",
    "joint_names",
    "numeric_array",
    "pose_array",
    "read_npz",
    "text_array",
    "text_value",
]

_MOST_JOINTS = 100_000
"""More than the vertices of any mesh of a body."""

Members = Mapping[str, npt.NDArray[np.generic]]


def read_npz(path: str | Path, *, required: Sequence[str] = ()) -> dict[str, npt.NDArray[np.generic]]:
    """Read the members of an ``.npz`` file, without unpickling.

    Parameters
    ----------
    path : str or Path
        The file.
    required : sequence of str
        Names of required members.

    Returns
    -------
    dict of str to ndarray
        All members.

    Raises
    ------
    PoseFileError
        Where the file is missing, damaged, pickled or lacks a member.
    """
    members = read_archive(path)
    missing = [name for name in required if name not in members]
    if missing:
        raise PoseFileError(f"{path}: lacks {', '.join(missing)}; it holds {', '.join(sorted(members)) or 'nothing'}.")
    return members


def numeric_array(value: object, which: str) -> npt.NDArray[Any]:
    """Convert to an array of real numbers.

    Parameters
    ----------
    value : object
        An array, or lists.
    which : str
        Its name in messages.

    Returns
    -------
    ndarray
        Integers or floats, as stored.

    Raises
    ------
    PoseDataError
        Where it holds anything else.
    """
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, RuntimeError) as problem:
        raise PoseDataError(f"{which}: {reason(problem)}; expected an array of real numbers.") from problem
    if array.dtype.kind not in "fiu" and array.size:
        raise PoseDataError(f"{which}: dtype {array.dtype}; expected real numbers such as float32.")
    return array


def text_array(
    value: npt.NDArray[np.generic], which: str, shape: tuple[int, ...] | None = None
) -> npt.NDArray[np.str_]:
    """Convert labels to text.

    Parameters
    ----------
    value : ndarray
        (M,), text, bytes or numbers.
    which : str
        Its name in messages.
    shape : tuple of int, optional
        The expected shape; (M,) with any M where not given.

    Returns
    -------
    ndarray of str
        The labels.

    Raises
    ------
    PoseDataError
        Where the shape is wrong, or an element is no text.
    """
    if value.shape != shape if shape is not None else value.ndim != 1:
        raise PoseDataError(f"{which} {value.shape}; expected {shape or '(M,)'}, one for each.")
    if value.dtype.kind not in "USbiuf":
        raise PoseDataError(f"{which}: dtype {value.dtype}; expected text.")
    try:
        text = np.char.decode(value.astype(np.bytes_), "utf-8") if value.dtype.kind == "S" else value.astype(np.str_)
        if text.dtype.itemsize and np.frombuffer(text.tobytes(), np.uint32).max(initial=0) > sys.maxunicode:
            raise ValueError("it holds code points that are no characters")
        "".join(text.ravel().tolist()).encode()
    except ValueError as problem:
        raise PoseDataError(f"{which}: {reason(problem)}; expected text.") from problem
    return text


def boolean_array(array: npt.NDArray[np.generic], which: str) -> npt.NDArray[np.bool_]:
    """Convert to an array of booleans.

    Parameters
    ----------
    array : ndarray
        Of any shape, bool, or 1 and 0.
    which : str
        Its name in messages.

    Returns
    -------
    ndarray of bool
        Of the same shape.

    Raises
    ------
    PoseDataError
        Where it holds anything else, such as a detector's confidence.
    """
    if array.dtype.kind not in "biuf" or not np.isin(array, (0, 1)).all():
        raise PoseDataError(f"{which}: dtype {array.dtype}; expected bool, or 1 and 0.")
    return np.asarray(array, bool)


def joint_names(value: npt.NDArray[np.generic], which: str) -> tuple[str, ...]:
    """Convert to names of joints.

    Parameters
    ----------
    value : ndarray
        (K,), text.
    which : str
        Its name in messages.

    Returns
    -------
    tuple of str
        Names as spelled in the file.

    Raises
    ------
    PoseDataError
        Where it is no text, or a joint is named twice, in any spelling.
    """
    if value.size > _MOST_JOINTS:  # before they take memory as texts
        raise PoseDataError(f"{which} {value.shape}; expected one for each joint.")
    names = tuple(text_array(value, which).tolist())
    if repeated := repeated_names(names):
        raise PoseDataError(f"{which} name {first_few(repeated)} more than once; expected each joint once.")
    return names


def text_value(members: Members, name: str, path: str | Path, default: str) -> str:
    """Read a member that holds a single text.

    Parameters
    ----------
    members : mapping of str to ndarray
        Members of the file.
    name : str
        Name of the member.
    path : str or Path
        The file, for messages.
    default : str
        The value where there is no such member.

    Returns
    -------
    str
        The text.

    Raises
    ------
    PoseDataError
        Where the member has several values.
    """
    if name not in members:
        return default
    if members[name].size != 1:
        raise PoseDataError(f"{path}: {name} has {members[name].size} values; expected one word.")
    return str(text_array(members[name].ravel(), f"{path}: {name}")[0])


def pose_array(members: Members, name: str, joints: Sequence[str], path: str | Path) -> npt.NDArray[np.float64]:
    """Read poses in the layout that the member ``axes`` declares.

    Parameters
    ----------
    members : mapping of str to ndarray
        Members of the file.
    name : str
        Name of the member with the poses.
    joints : sequence of str
        K names.
    path : str or Path
        The file, for messages.

    Returns
    -------
    ndarray
        (M, K, 3), in the file's unit.

    Raises
    ------
    PoseDataError
        Where the layout is unknown, or the shape does not fit it.
    """
    array = numeric_array(members[name], f"{path}: {name}")
    axes = text_value(members, "axes", path, TRUTH)
    try:
        layout = Layout(axes, TRUTH)
        shape = layout.shape(array.shape)
    except PoseDataError as problem:
        raise PoseDataError(f"{path}: {name}: {problem}") from None
    if shape[1:] != (len(joints), 3):
        in_layout = "" if axes == TRUTH else f" in the layout {axes}, so (M, K, D) = {shape}"
        raise PoseDataError(
            f"{path}: {name} {array.shape}{in_layout}; expected (M, {len(joints)}, 3), a row for each of its joints."
        )
    if not shape[0]:
        return np.zeros(shape)
    return layout.read(MemoryArray(array), np.arange(shape[0])).astype(np.float64)
