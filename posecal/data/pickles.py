"""Safe reader of pickles that hold arrays, dictionaries, lists and text only.

A pickle is a program: loading one from the network with :mod:`pickle` runs any code in it. Here every global that it
refers to is looked up in a short allow-list, and nothing in that list is NumPy's own: the constructor calls of arrays
are only recorded. NumPy would trust them: a dtype with object fields turns the bytes of a file into addresses. The
arrays are built afterwards, of numbers and text alone, once their lengths are checked.
"""

from __future__ import annotations

import io
import math
import pickle
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from posecal.data.archive import Member, open_archive, read_header
from posecal.errors import refuse_unreadable

__all__ = ["read_object_npz", "read_pickle", "read_pickled"]

_MAX_DEPTH = 100
"""Maximum nesting depth of plain data."""


class _Callable:
    """A replacement for an allowed global: it can be called, and has no attributes that a pickle could change."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)

    def __setstate__(self, state: object) -> None:
        raise pickle.UnpicklingError("changes the state of a global")


class _Dtype:
    """The recorded constructor call of a NumPy dtype of numbers or text."""

    def __init__(self, code: object, *_: object) -> None:
        if not (isinstance(code, str) and re.fullmatch(r"b1|[iu][1248]|f[248]|[SU]\d{1,9}|O[48]?", code)):
            raise pickle.UnpicklingError(f"asks for the dtype {str(code)[:40]!r}")
        self.code = code
        self.order = "="

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) >= 5 and isinstance(state[1], str) and state[1] in set("<>=|")):
            raise pickle.UnpicklingError(f"has an invalid state of the dtype {self.code}")
        if any(part is not None for part in state[2:5]):
            raise pickle.UnpicklingError(f"asks for records or subarrays, as the dtype {self.code}")
        self.order = state[1]

    def build(self) -> np.dtype[np.generic]:
        return np.dtype(self.code if self.order == "|" else self.order + self.code)


class _Scalar:
    """The recorded constructor call of a NumPy scalar."""

    def __init__(self, dtype: object, content: object = b"") -> None:
        self.dtype, self.content = dtype, content


class _Array:
    """The recorded constructor call and state of an array."""

    def __init__(self) -> None:
        self.shape: object = (0,)
        self.dtype: object = None
        self.content: object = b""
        self.order: object = "C"
        self.axes: object = None

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) == 5):
            raise pickle.UnpicklingError("has an invalid state of an array")
        _, self.shape, self.dtype, fortran, self.content = state
        self.order = "F" if fortran else "C"


def _encode(text: str, encoding: str = "latin1") -> bytes:
    """Encode text as bytes: pickles of protocol 2 store the bytes of an array as text."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"asks for the codec {encoding}")
    return text.encode("latin1")


def _empty_bytes() -> bytes:
    """Return empty bytes: pickles of protocol 2 store them as this call."""
    return b""


def _refuse_call(*_: object) -> None:
    raise pickle.UnpicklingError("makes an array without content")


_NDARRAY = _Callable(_refuse_call)


def _reconstruct(kind: object, *_: object) -> _Array:
    """Start an array, whose state follows in the pickle."""
    if kind is not _NDARRAY:
        raise pickle.UnpicklingError("asks for an array of another class")
    return _Array()


def _from_buffer(content: object, dtype: object, shape: object, order: object, axes: object = None) -> _Array:
    """Record an array of a pickle of protocol 5, which is a single call."""
    array = _Array()
    array.content, array.dtype, array.shape, array.order, array.axes = content, dtype, shape, order, axes
    return array


_ALLOWED: dict[tuple[str, str], _Callable] = {
    ("_codecs", "encode"): _Callable(_encode),
    ("__builtin__", "bytes"): _Callable(_empty_bytes),
    ("builtins", "bytes"): _Callable(_empty_bytes),
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _Callable(_Dtype),
    **{
        (f"numpy.{package}.multiarray", name): _Callable(replacement)
        for package in ("core", "_core")
        for name, replacement in (("_reconstruct", _reconstruct), ("scalar", _Scalar))
    },
    **{(f"numpy.{package}.numeric", "_frombuffer"): _Callable(_from_buffer) for package in ("core", "_core")},
}


class _PlainUnpickler(pickle._Unpickler):
    """Unpickler with an allow-list, in Python: that in C allocates memory for any memo index, GBs for six bytes."""

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content), encoding="latin1")
        self._size = len(content)

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _ALLOWED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"asks for {module}.{name}") from None

    def load_bytearray8(self: Any) -> None:
        """Refuse lengths beyond the end of the file before memory is allocated."""
        length = int.from_bytes(self.read(8), "little")
        if length > self._size:
            raise pickle.UnpicklingError(f"claims a bytearray of {length:,} bytes")
        content = self.read(length)
        if len(content) < length:
            raise EOFError("cut off")
        self.append(bytearray(content))

    dispatch: ClassVar = {**pickle._Unpickler.dispatch, pickle.BYTEARRAY8[0]: load_bytearray8}


# --- from recorded calls to arrays ----------------------------------------------------------------------------

_ATOMS = (str, int, float, bytes, bool, type(None))
_REPEATS = 16
"""How many values a pickle may hold for each of its bytes: more are lists that hold one list many times."""


class _Memo:
    """Arrays that were built, by the identity of their records, and how many values may still be."""

    def __init__(self, size: int) -> None:
        self.arrays: dict[int, Any] = {}
        self.left = _REPEATS * size + 1000

    def take(self, number: int) -> None:
        self.left -= number
        if self.left < 0:
            raise pickle.UnpicklingError("repeats its parts many times")


def _plain(value: Any, memo: _Memo, depth: int = 0) -> Any:
    """Build the arrays of a loaded value, and raise an error for anything that is neither plain nor an array."""
    kind = type(value)
    if kind in _ATOMS:
        return value
    if depth > _MAX_DEPTH:
        raise pickle.UnpicklingError(f"is nested more than {_MAX_DEPTH} deep, or contains itself")
    if kind is dict:
        memo.take(len(value))
        return {_plain(key, memo, depth + 1): _plain(member, memo, depth + 1) for key, member in value.items()}
    if kind in (list, tuple):
        memo.take(len(value))
        return kind([_plain(element, memo, depth + 1) for element in value])
    if kind is _Array:
        if id(value) not in memo.arrays:
            memo.arrays[id(value)] = _array(value, memo, depth)
        return memo.arrays[id(value)]
    if kind is _Scalar:
        return _scalar(value)
    raise pickle.UnpicklingError(f"holds a {kind.__name__.lstrip('_').lower()}")


def _dtype(record: object) -> np.dtype[np.generic]:
    if type(record) is not _Dtype:
        raise pickle.UnpicklingError("asks for an array without a dtype")
    return record.build()


def _array(record: _Array, memo: _Memo, depth: int) -> npt.NDArray[Any]:
    shape, order, axes = record.shape, record.order, record.axes
    if not (isinstance(shape, tuple) and all(type(length) is int and length >= 0 for length in shape)):
        raise pickle.UnpicklingError(f"asks for an array of shape {str(shape)[:40]}")
    if order not in ("C", "F", "K") or not (axes is None or isinstance(axes, tuple)):
        raise pickle.UnpicklingError(f"asks for an array in the order {str(order)[:40]}")
    dtype, count = _dtype(record.dtype), math.prod(shape)
    if dtype.hasobject:
        content = record.content
        if not isinstance(content, list) or len(content) != count:
            actual = f"{len(content):,} objects" if isinstance(content, list) else type(content).__name__
            raise pickle.UnpicklingError(f"has {actual} for an array of {shape} objects")
        objects = np.empty(count, object)
        for index, element in enumerate(content):
            objects[index] = _plain(element, memo, depth + 1)
        return objects.reshape(shape)
    flat = _numbers(record.content, dtype, count, shape)
    if order == "K" and axes is not None:
        return flat.reshape(shape).transpose(axes)
    return flat.reshape(shape, order="F" if order == "F" else "C")


def _scalar(record: _Scalar) -> Any:
    dtype = _dtype(record.dtype)
    if dtype.hasobject:
        raise pickle.UnpicklingError("asks for an object as a number")
    if not dtype.itemsize and not record.content:
        return dtype.type()
    return _numbers(record.content, dtype, 1, ())[0]


def _numbers(content: object, dtype: np.dtype[np.generic], count: int, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    if isinstance(content, str):
        content = content.encode("latin1")  # Python 2 has no bytes
    if not isinstance(content, bytes | bytearray) or len(content) != count * dtype.itemsize:
        actual = f"{len(content):,} bytes" if isinstance(content, bytes | bytearray) else type(content).__name__
        raise pickle.UnpicklingError(f"has {actual} for an array of {shape} {dtype}")
    if dtype.kind == "U":
        code_points = np.frombuffer(content, np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if code_points.max(initial=0) > sys.maxunicode:
            raise pickle.UnpicklingError("has text with invalid code points")
    return np.frombuffer(content, dtype) if count else np.zeros(0, dtype)


# --- files ----------------------------------------------------------------------------------------------------


def _load(content: bytes, which: str | Path) -> Any:
    sentence = (
        "{}; expected a pickle of plain arrays, dictionaries, lists and text. It was not loaded: a pickle with "
        "anything else can run code."
    )
    with refuse_unreadable(which, sentence, str(which)):
        try:
            loaded = _PlainUnpickler(content).load()
        except KeyError:
            raise pickle.UnpicklingError("is no pickle") from None
        return _plain(loaded, _Memo(len(content)))


def read_pickle(path: str | Path) -> Any:
    """Read a pickle of plain arrays, dictionaries, lists and text.

    Parameters
    ----------
    path : str or Path
        The file, of any protocol, written by Python 2 or 3.

    Returns
    -------
    object
        Its content. Arrays are of booleans, integers, floats, text and bytes, or of objects of these, and may be
        read-only.

    Raises
    ------
    PoseFileError
        Where the file can't be read, holds anything else, or the content of an array does not fit its shape.
    """
    with refuse_unreadable(path):
        content = Path(path).read_bytes()
    return _load(content, path)


def read_pickled(content: bytes, which: str) -> Any:
    """Read a pickle in memory, as :func:`read_pickle` does a file."""
    return _load(content, which)


def read_object_npz(path: str | Path) -> dict[str, Any]:
    """Read an ``.npz`` whose members may be pickled objects, with the safe reader.

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
        Where the file can't be read, or a pickle holds anything but plain data.
    """
    path = Path(path)
    with refuse_unreadable(path, "can't be read as .npz ({})."), path.open("rb") as file:
        return {key: _read_member(member) for key, member in open_archive(file, path.name).items()}


def _read_member(member: Member) -> Any:
    shape, _, dtype = member.header
    if not dtype.hasobject:
        return member.read()
    file = io.BytesIO(member.contents())
    read_header(file, member.name)
    loaded = _load(file.read(), member.name)
    return loaded.item() if isinstance(loaded, np.ndarray) and shape == () and loaded.size == 1 else loaded
