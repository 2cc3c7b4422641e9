"""How are plain arrays read out of an ``.npz``? Never unpickled, and each looked at before it is used."""

from __future__ import annotations

import lzma
import struct
import sys
import tokenize
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.layout import TRUTH, Layout, MemoryArray
from posecal.data.skeleton import canonical_name
from posecal.errors import PoseDataError, PoseFileError, first_few

__all__ = [
    "BROKEN",
    "flags_of",
    "in_words",
    "joint_names",
    "labels",
    "read_npz",
    "real_numbers",
    "stored_poses",
    "word",
]

Members = Mapping[str, npt.NDArray[np.generic]]

BROKEN = (
    *(OSError, EOFError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RuntimeError),
    *(MemoryError, SyntaxError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, tokenize.TokenError),
)
"""What the standard library and NumPy raise for a file that is not what its first bytes say."""


def in_words(problem: BaseException) -> str:
    """Give one line of words for something that :data:`BROKEN` lists.

    Parameters
    ----------
    problem : exception
        What was raised.

    Returns
    -------
    str
        Its own words where it has any.
    """
    if isinstance(problem, MemoryError):
        return "it asks for more memory than there is"
    return " ".join(str(problem).split()) or "it is cut off or damaged"


def read_npz(path: str | Path, *, required: Sequence[str] = ()) -> dict[str, npt.NDArray[np.generic]]:
    """Read the members of an ``.npz`` file without ever unpickling.

    Parameters
    ----------
    path : str or Path
        The file.
    required : sequence of str
        Members that must be there.

    Returns
    -------
    dict of str to ndarray
        All members.

    Raises
    ------
    PoseFileError
        Where the file is missing, damaged, pickled or lacks a member.
    """
    path = Path(path)
    try:
        with open(path, "rb") as stored, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's remark on files of Python 2, which are as good as any
            file = np.load(stored, allow_pickle=False)
            if isinstance(file, np.ndarray):
                raise PoseFileError(
                    f"{path}: holds one array without a name; expected an .npz of plain arrays. Save it with "
                    "numpy.savez(file, name=array)."
                )
            with file:
                members = {name: file[name] for name in file.files}
    except PoseFileError:
        raise
    except BROKEN as problem:
        what = f"can't be read as .npz ({in_words(problem)})" if path.exists() else "is not there"
        raise PoseFileError(f"{path}: {what}; expected an .npz of plain arrays.") from problem
    if foreign := [name for name, array in members.items() if not isinstance(array, np.ndarray)]:
        raise PoseFileError(f"{path}: {foreign[0]} can't be read as .npy; expected an .npz of plain arrays.")
    missing = [name for name in required if name not in members]
    if missing:
        raise PoseFileError(f"{path}: lacks {', '.join(missing)}; it holds {', '.join(sorted(members)) or 'nothing'}.")
    return members


def real_numbers(value: object, which: str) -> npt.NDArray[Any]:
    """Give an array of real numbers.

    Parameters
    ----------
    value : object
        As it was stored: an array, or lists.
    which : str
        How a message calls it.

    Returns
    -------
    ndarray
        Of whole or real numbers, as stored.

    Raises
    ------
    PoseDataError
        Where it holds anything else.
    """
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, RuntimeError) as problem:
        raise PoseDataError(f"{which}: {in_words(problem)}; expected an array of real numbers.") from problem
    if array.dtype.kind not in "fiu" and array.size:
        raise PoseDataError(f"{which}: dtype {array.dtype}; expected real numbers such as float32.")
    return array


def labels(value: npt.NDArray[np.generic], which: str, shape: tuple[int, ...] | None = None) -> npt.NDArray[np.str_]:
    """Give labels as text.

    Parameters
    ----------
    value : ndarray
        (M,), text, bytes or numbers.
    which : str
        How a message calls it.
    shape : tuple of int, optional
        What is expected; any one axis where it is not given.

    Returns
    -------
    ndarray of str
        The same as text.

    Raises
    ------
    PoseDataError
        Where the shape is another, or something is no text.
    """
    if value.shape != shape if shape is not None else value.ndim != 1:
        raise PoseDataError(f"{which} {value.shape}; expected {shape or '(M,)'}, one for each.")
    if value.dtype.kind not in "USbiuf":
        raise PoseDataError(f"{which}: dtype {value.dtype}; expected text.")
    try:
        text = np.char.decode(value.astype(np.bytes_), "utf-8") if value.dtype.kind == "S" else value.astype(np.str_)
        if text.dtype.itemsize and np.frombuffer(text.tobytes(), np.uint32).max(initial=0) > sys.maxunicode:
            raise ValueError("it holds numbers that are no characters")
        "".join(text.ravel().tolist()).encode()
    except ValueError as problem:
        raise PoseDataError(f"{which}: {in_words(problem)}; expected text.") from problem
    return text


def flags_of(array: npt.NDArray[np.generic], which: str) -> npt.NDArray[np.bool_]:
    """Give yes and no.

    Parameters
    ----------
    array : ndarray
        Of any shape, stored as such or as 1 and 0.
    which : str
        How a message calls it.

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
    """Give the names of joints.

    Parameters
    ----------
    value : ndarray
        (K,), text.
    which : str
        How a message calls it.

    Returns
    -------
    tuple of str
        As they are spelled there.

    Raises
    ------
    PoseDataError
        Where it is no text, or a joint is named twice, whatever the spelling.
    """
    names = tuple(labels(value, which).tolist())
    twice = [name for name, count in Counter(map(canonical_name, names)).items() if count > 1]
    if twice:
        raise PoseDataError(f"{which} name {first_few(twice)} more than once; expected each joint once.")
    return names


def word(members: Members, name: str, path: str | Path, default: str) -> str:
    """Give one word that a file declares.

    Parameters
    ----------
    members : mapping of str to ndarray
        What was read.
    name : str
        Which.
    path : str or Path
        The file, for messages.
    default : str
        What it is where the file doesn't say.

    Returns
    -------
    str
        The word.

    Raises
    ------
    PoseDataError
        Where it is not one word.
    """
    if name not in members:
        return default
    if members[name].size != 1:
        raise PoseDataError(f"{path}: {name} has {members[name].size} values; expected one word.")
    return str(labels(members[name].ravel(), f"{path}: {name}")[0])


def stored_poses(members: Members, name: str, joints: Sequence[str], path: str | Path) -> npt.NDArray[np.float64]:
    """Give the poses of a file in the paper's layout, whatever layout its member ``axes`` declares.

    Parameters
    ----------
    members : mapping of str to ndarray
        What was read.
    name : str
        Which of them holds poses.
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
        Where the layout is none, or the shape does not fit it.
    """
    array = real_numbers(members[name], f"{path}: {name}")
    axes = word(members, "axes", path, TRUTH)
    try:
        layout = Layout(axes, TRUTH)
        shape = layout.shape(array.shape)
    except PoseDataError as problem:
        raise PoseDataError(f"{path}: {name}: {problem}") from None
    if shape[1:] != (len(joints), 3):
        stored = "" if axes == TRUTH else f" in the layout {axes}, so (M, K, D) = {shape}"
        raise PoseDataError(
            f"{path}: {name} {array.shape}{stored}; expected (M, {len(joints)}, 3), a row for each of its joints."
        )
    if not shape[0]:
        return np.zeros(shape)
    return layout.read(MemoryArray(array), np.arange(shape[0])).astype(np.float64)
