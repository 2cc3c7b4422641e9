"""How is a pickle read that somebody else made? With a reader that knows arrays, dictionaries, lists and text only.

A pickle is a program: loading one from the network with :mod:`pickle` runs whatever it says. Here every name that it
asks for is looked up in a short table, and nothing in that table is NumPy's own: what a pickle says of an array is only
noted down. NumPy would believe it: a type whose fields are objects turns the bytes of a file into addresses. The arrays
are built afterwards, of numbers and text alone, once their lengths agree.
"""

from __future__ import annotations

import io
import math
import pickle
import re
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from posecal.errors import PoseFileError
from posecal_models.data.npz import BROKEN, in_words

__all__ = ["read_object_npz", "read_pickle"]

_DEEPEST = 100
"""How deep plain data may be nested."""


class _Named:
    """What stands for a name: it can be called, and not changed as a function could."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)

    def __setstate__(self, state: object) -> None:
        raise pickle.UnpicklingError("changes the names that it asks for")


class _Dtype:
    """What a pickle says of a type of numbers or text."""

    def __init__(self, code: object, *_: object) -> None:
        if not (isinstance(code, str) and re.fullmatch(r"b1|[iu][1248]|f[248]|[SU]\d{1,9}|O[48]?", code)):
            raise pickle.UnpicklingError(f"asks for the type {str(code)[:40]!r}")
        self.code = code
        self.order = "="

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) >= 5 and isinstance(state[1], str) and state[1] in set("<>=|")):
            raise pickle.UnpicklingError(f"says too little of the type {self.code}")
        if any(part is not None for part in state[2:5]):
            raise pickle.UnpicklingError(f"asks for records or subarrays, as the type {self.code}")
        self.order = state[1]

    def built(self) -> np.dtype[np.generic]:
        return np.dtype(self.code if self.order == "|" else self.order + self.code)


class _Scalar:
    """What a pickle says of one number or word of NumPy."""

    def __init__(self, dtype: object, content: object = b"") -> None:
        self.dtype, self.content = dtype, content


class _Array:
    """What a pickle says of an array."""

    def __init__(self) -> None:
        self.shape: object = (0,)
        self.dtype: object = None
        self.content: object = b""
        self.order: object = "C"
        self.axes: object = None

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) == 5):
            raise pickle.UnpicklingError("says too little of an array")
        _, self.shape, self.dtype, fortran, self.content = state
        self.order = "F" if fortran else "C"


def _encode(text: str, encoding: str = "latin1") -> bytes:
    """Turn text into bytes, as pickles of protocol 2 store the bytes of an array."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"asks for the codec {encoding}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    """Give what pickles of protocol 2 store for empty bytes."""
    return b""


def _never(*_: object) -> None:
    raise pickle.UnpicklingError("makes an array that it does not fill")


_NDARRAY = _Named(_never)


def _begun(kind: object, *_: object) -> _Array:
    """Begin an array, of which the pickle says more later."""
    if kind is not _NDARRAY:
        raise pickle.UnpicklingError("asks for an array of another class")
    return _Array()


def _of_buffer(content: object, dtype: object, shape: object, order: object, axes: object = None) -> _Array:
    """Note an array that a pickle of protocol 5 says in one go."""
    array = _Array()
    array.content, array.dtype, array.shape, array.order, array.axes = content, dtype, shape, order, axes
    return array


_ADMITTED: dict[tuple[str, str], _Named] = {
    ("_codecs", "encode"): _Named(_encode),
    ("__builtin__", "bytes"): _Named(_no_bytes),
    ("builtins", "bytes"): _Named(_no_bytes),
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _Named(_Dtype),
    **{
        (f"numpy.{package}.multiarray", name): _Named(known)
        for package in ("core", "_core")
        for name, known in (("_reconstruct", _begun), ("scalar", _Scalar))
    },
    **{(f"numpy.{package}.numeric", "_frombuffer"): _Named(_of_buffer) for package in ("core", "_core")},
}


class _PlainUnpickler(pickle._Unpickler):
    """Python's own in Python: the one in C takes memory for any place that a pickle names, gigabytes for six bytes."""

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _ADMITTED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"asks for {module}.{name}") from None


# --- from what was said to what it is -------------------------------------------------------------------------

_ATOMS = (str, int, float, bytes, bool, type(None))
_UNFINISHED = object()


def _plain(value: Any, known: dict[int, Any], depth: int = 0) -> Any:
    """Build the arrays within what was loaded, and refuse what is neither plain nor an array."""
    kind = type(value)
    if kind in _ATOMS:
        return value
    if depth > _DEEPEST:
        raise pickle.UnpicklingError(f"is nested more than {_DEEPEST} deep")
    if id(value) in known:
        if known[id(value)] is _UNFINISHED:
            raise pickle.UnpicklingError("holds something that holds itself")
        return known[id(value)]
    known[id(value)] = _UNFINISHED
    found: Any
    if kind is dict:
        found = {_plain(key, known, depth + 1): _plain(held, known, depth + 1) for key, held in value.items()}
    elif kind is list:
        found = [_plain(held, known, depth + 1) for held in value]
    elif kind is tuple:
        found = tuple([_plain(held, known, depth + 1) for held in value])
    elif kind is _Array:
        found = _array(value, known, depth)
    elif kind is _Scalar:
        found = _scalar(value)
    else:
        raise pickle.UnpicklingError(f"holds a {kind.__name__.lstrip('_').lower()}")
    known[id(value)] = found
    return found


def _dtype(said: object) -> np.dtype[np.generic]:
    if type(said) is not _Dtype:
        raise pickle.UnpicklingError("asks for an array without a type")
    return said.built()


def _array(said: _Array, known: dict[int, Any], depth: int) -> npt.NDArray[Any]:
    shape, order, axes = said.shape, said.order, said.axes
    if not (isinstance(shape, tuple) and all(type(length) is int and length >= 0 for length in shape)):
        raise pickle.UnpicklingError(f"asks for an array of shape {str(shape)[:40]}")
    if order not in ("C", "F", "K") or not (axes is None or isinstance(axes, tuple)):
        raise pickle.UnpicklingError(f"asks for an array in the order {str(order)[:40]}")
    dtype, count = _dtype(said.dtype), math.prod(shape)
    if dtype.hasobject:
        held = said.content
        if not isinstance(held, list) or len(held) != count:
            there = f"{len(held):,} objects" if isinstance(held, list) else type(held).__name__
            raise pickle.UnpicklingError(f"has {there} for an array of {shape} objects")
        objects = np.empty(count, object)
        for index, item in enumerate(held):
            objects[index] = _plain(item, known, depth + 1)
        return objects.reshape(shape)
    flat = _numbers(said.content, dtype, count, shape)
    if order == "K" and axes is not None:
        return flat.reshape(shape).transpose(axes)
    return flat.reshape(shape, order="F" if order == "F" else "C")


def _scalar(said: _Scalar) -> Any:
    dtype = _dtype(said.dtype)
    if dtype.hasobject:
        raise pickle.UnpicklingError("asks for an object as a number")
    if not dtype.itemsize and not said.content:
        return dtype.type()
    return _numbers(said.content, dtype, 1, ())[0]


def _numbers(content: object, dtype: np.dtype[np.generic], count: int, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    if isinstance(content, str):
        content = content.encode("latin1")  # Python 2 knew no bytes
    if not isinstance(content, bytes | bytearray) or len(content) != count * dtype.itemsize:
        there = f"{len(content):,} bytes" if isinstance(content, bytes | bytearray) else type(content).__name__
        raise pickle.UnpicklingError(f"has {there} for an array of {shape} {dtype}")
    if dtype.kind == "U":
        letters = np.frombuffer(content, np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if letters.max(initial=0) > sys.maxunicode:
            raise pickle.UnpicklingError("has text with letters that are none")
    return np.frombuffer(content, dtype) if count else np.zeros(0, dtype)


# --- files ----------------------------------------------------------------------------------------------------


def _load(file: io.BufferedIOBase, which: str) -> Any:
    try:
        return _plain(_PlainUnpickler(file, encoding="latin1").load(), {})
    except (pickle.UnpicklingError, *BROKEN) as problem:
        raise PoseFileError(
            f"{which}: {in_words(problem)}; expected a pickle of plain arrays, dictionaries, lists "
            "and text. It was not loaded: a pickle that asks for more can run programs."
        ) from problem


def read_pickle(path: str | Path) -> Any:
    """Read a pickle of plain arrays, dictionaries, lists and text.

    Parameters
    ----------
    path : str or Path
        The file, of any protocol, written by Python 2 or 3.

    Returns
    -------
    object
        What it holds. Its arrays are of yes/no, whole and real numbers, text and bytes, or of such objects, and may be
        read-only.

    Raises
    ------
    PoseFileError
        Where the file can't be read, asks for anything else, or says of an array what its bytes don't bear out.
    """
    try:
        with open(path, "rb") as file:
            return _load(file, str(path))
    except PoseFileError:
        raise
    except OSError as problem:
        raise PoseFileError(f"{path}: can't be read ({problem.strerror}).") from problem


def read_object_npz(path: str | Path) -> dict[str, Any]:
    """Read an ``.npz`` whose members may be pickled objects, without trusting the pickles.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    dict of str to object
        Members: arrays as arrays, a single pickled object as the object.

    Raises
    ------
    PoseFileError
        Where the file can't be read, or a pickle asks for more than plain data.
    """
    members: dict[str, Any] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                with archive.open(name) as file:
                    members[name.removesuffix(".npy")] = _read_npy(io.BytesIO(file.read()), f"{path}: {name}")
    except PoseFileError:
        raise
    except BROKEN as problem:
        raise PoseFileError(f"{path}: can't be read as .npz ({in_words(problem)}).") from problem
    return members


def _read_npy(file: io.BytesIO, which: str) -> Any:
    version = npy.read_magic(file)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy's remark on files of Python 2, which are as good as any
        shape, _, dtype = read_header(file)
        if not dtype.hasobject:
            file.seek(0)
            return npy.read_array(file, allow_pickle=False)
    loaded = _load(file, which)
    return loaded.item() if isinstance(loaded, np.ndarray) and shape == () and loaded.size == 1 else loaded
