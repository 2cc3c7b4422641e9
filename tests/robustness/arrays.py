"""Arrays in ``.npy`` files with odd headers, of foreign types, of other shapes and values."""

from __future__ import annotations

import io
import struct
import warnings
from random import Random
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

SHAPES = ("(2,)", "()", "(0,)", "(-1, 3)", "(3L, 4L", "(10**12,)", "(4, 4, 3.0)", "(True,)", "('a',)", "[4]", "None")
SHAPES += (
    "(4, 1000000000000)",
    "(15700000,)",
    "(2147483648, 2147483648)",
    "(9223372036854775807,)",
    "(18446744073709551616,)",
)
DTYPES = ("'<f4'", "'>f8'", "'|O'", "'<c16'", "'<f2'", "'<M8[s]'", "'<m8'", "'|V24'", "'<U1000000'", "'<f16'", "'|S0'")
DTYPES += ("[('x', '<f4'), ('y', '|O')]", "('<f4', (3,))", "'<U0'", "'f'", "'|b1'", "[('a', [('a', '<i2')])]", "'<i8'")
DTYPES += ("'O' * 9", "''", "7", "('<f8', (10000, 10000, 10000))", "{'names': ['a'], 'formats': ['<f4']}", "'<M8[99Y]'")


def with_odd_header(whole: bytes, chance: Random) -> bytes:
    """Change the text of the header, its length or its version."""
    if whole[:6] != b"\x93NUMPY" or len(whole) < 12:
        return whole[: chance.randrange(len(whole) + 1)]
    length = struct.unpack("<H", whole[8:10])[0] if whole[6] == 1 else struct.unpack("<I", whole[8:12])[0]
    start = 10 if whole[6] == 1 else 12
    text, data = whole[start : start + length].decode("latin1"), whole[start + length :]
    before, _, rest = text.partition("'shape':")
    shape, _, after = rest.partition("}")
    version = 1
    kind = chance.randrange(8)
    if kind <= 1:
        numbers = shape.strip(" ,()").replace(" ", "").split(",")
        edited = chance.choice(["0", "1", "2", "5", "4096", "-4", "10000000", str(2**62), "4L", "1.0", "0x4", "4_4"])
        numbers[chance.randrange(len(numbers))] = edited
        other = f"({','.join(numbers)},)" if kind else chance.choice(SHAPES)
        text = f"{before}'shape': {other}, }}{after}"
    elif kind == 2:
        text = f"{{'descr': {chance.choice(DTYPES)}, 'fortran_order': False, 'shape':{shape}}}{after}"
    elif kind == 3:
        text = text.replace("False", chance.choice(["True", "0", "None", "''", "Fals"]))
    elif kind == 4:
        depth = chance.choice([50, 3000])
        text = f"{before}'shape': {'(' * depth}{',)' * chance.choice([0, depth])}, }}"
    elif kind == 5:
        text = text[: chance.randrange(len(text))]
    elif kind == 6:
        at = chance.randrange(len(text))
        text = text[:at] + chance.choice("'\"(){}[],:\\\0\n#é0Lx") + text[at + 1 :]
    else:
        version = chance.choice([1, 2, 3, 4, 9])
        text += " " * chance.choice([0, 70, 20000])
    body = text.encode("latin1") + b"\n"
    size = struct.pack("<H", min(len(body), 65535)) if version == 1 else struct.pack("<I", len(body))
    return b"\x93NUMPY" + bytes([version, 0]) + size + body + data


FOREIGN = (
    ">f4",
    ">f8",
    "<f2",
    "<f4",
    "<f8",
    "<g",
    ">i8",
    "<i2",
    "|u1",
    "<c16",
    "|b1",
    "<M8[s]",
    "<m8[ms]",
    "|O",
    "<U9",
)
FOREIGN += ("|S9", ">U9", "|V8", "record", "subarray")


def foreign(array: Array, chance: Random) -> Array:
    """Store the same values as another type, of records, of dates, of objects, of another order of bytes."""
    kind = chance.choice(FOREIGN)
    try:
        if kind == "record":
            found = np.zeros(array.shape, [("x", "<f4"), ("y", "<i4")])
            found["x"] = array
            return found
        if kind == "subarray":
            return np.repeat(array[..., None], 2, axis=-1)
        if kind == "|O":
            return np.array([*array.ravel(), None], dtype=object)
        return array.astype(kind)
    except (ValueError, TypeError, OverflowError):
        return np.zeros(array.shape, "<M8[D]" if array.dtype.kind in "US" else "<U3")


def reshaped(array: Array, chance: Random) -> Array:
    """Take entries away, repeat them, turn axes, or add and drop some."""
    kind = chance.randrange(9)
    if not array.size or not array.ndim or kind == 0:
        return np.stack([array] * chance.choice([1, 2, 5]))
    axis = chance.randrange(array.ndim)
    if kind == 1:
        return np.delete(array, 0, axis=axis)
    if kind == 2:
        return np.repeat(array, 2, axis=axis)
    if kind == 3:
        return array.ravel()
    if kind == 4:
        return array.T
    if kind == 5:
        return array.take([], axis=axis)
    if kind == 6:
        return array[(0,) * array.ndim]
    return np.flip(array, axis) if kind == 7 else array[..., None].repeat(60, axis=axis)


NUMBERS = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e20, 1e7, 1e-320, 0.0, -1.0, 0.5, 2.0, 2**63, -(2**31), 1e38)
WORDS = (
    "",
    " ",
    "\x1b[31m",
    "a\nb",
    "\u202e",
    "ünï",
    "x" * 3000,
    "Hip",
    "NaN",
    "\0",
    "-1",
    "MNKD",
    "m",
    "\ud800",
    "{}",
)


def revalued(array: Array, chance: Random) -> Array:
    """Set one entry, some, or all of them to an odd number or word."""
    found = np.array(array)
    if not found.size:
        return found
    chosen = chance.choice([slice(None), slice(0, 1), slice(0, None, 2), chance.randrange(found.size)])
    flat = found.reshape(-1)
    if found.dtype.kind in "fc":
        with np.errstate(all="ignore"):
            flat[chosen] = chance.choice(NUMBERS) * chance.choice([1, 1, flat.dtype.type(2)])
    elif found.dtype.kind == "U":
        flat = flat.astype("<U3000")
        flat[chosen] = chance.choice(WORDS)
    elif found.dtype.kind in "iub":
        flat[chosen] = np.array(chance.choice([-1, 0, 1, 2, 255, 2**31 - 1])).astype(found.dtype)
    return flat.reshape(found.shape)


def edited(array: Array, chance: Random) -> Array:
    """Change an array's type, shape or values."""
    return chance.choice([foreign, reshaped, revalued])(array, chance)


def with_other_array(whole: bytes, chance: Random) -> bytes:
    """Store an edited array in the place of one."""
    try:
        array = np.load(io.BytesIO(whole), allow_pickle=True)  # of one's own making
    except ValueError:
        return b""
    file = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers that need a later version
        np.save(file, edited(array, chance), allow_pickle=True)
    return file.getvalue()


NPY = (with_odd_header, with_odd_header, with_other_array, with_other_array)
