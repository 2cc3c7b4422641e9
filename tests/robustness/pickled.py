"""Edited pickles, weights and HDF5: operations, headers and arrays of other types."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import pickletools
import struct
from random import Random
from typing import Any

import numpy as np

from tests.robustness import arrays, texts

ODD_OPERATIONS = (
    *(b"\x96" + (2**31).to_bytes(8, "little"), b"\x8e" + b"\xff" * 8, b"\x8b" + b"\xff\xff\xff\x7f"),
    *(
        b"r\xff\xff\xff\x7f",
        b"\x95" + b"\xff" * 7 + b"\x00",
        b"]" * 5000,
        b"(" * 5000,
        b"2",
        b"0",
        b"1",
        b"a",
        b"R",
        b"b",
    ),
    *(
        b"cos\nsystem\n",
        b"cnumpy\nndarray\n",
        b"cnumpy\ndtype\n",
        b"c__builtin__\nbytes\n",
        b"\x93",
        b"\x81",
        b"Q",
        b"P0\n",
    ),
    *(
        b"I" + b"9" * 5000 + b"\n",
        b"L9L\n",
        b"F1e999\n",
        b"V\\ud800\n",
        b"S'a\n",
        b"N",
        b"\x88",
        b"h\x00",
        b"j\xff\xff\xff\x7f",
    ),
)


def operations(whole: bytes, chance: Random) -> bytes:
    """Leave out, repeat, exchange or insert operations of a pickle."""
    try:
        starts = [at for _, _, at in pickletools.genops(whole) if at is not None]
    except Exception:  # noqa: BLE001  of no pickle
        return chance.randbytes(30)
    pieces = [whole[a:b] for a, b in zip(starts, [*starts[1:], len(whole)], strict=True)]
    for _ in range(chance.choice([1, 1, 1, 3])):
        at, other = chance.randrange(len(pieces)), chance.randrange(len(pieces))
        kind = chance.randrange(6)
        if kind == 0:
            pieces[at] = b""
        elif kind == 1:
            pieces[at] = pieces[at] * 2
        elif kind == 2:
            pieces[at], pieces[other] = pieces[other], pieces[at]
        else:
            pieces.insert(at, chance.choice(ODD_OPERATIONS))
    return b"".join(pieces)


def objects(whole: bytes, chance: Random) -> bytes:
    """Pickle an edited object: arrays of other types, values of other kinds, deep lists, lists that share all."""
    content = pickle.loads(whole)  # of one's own making
    for _ in range(chance.choice([1, 1, 2])):
        content = _edited(content, chance)
    return pickle.dumps(content, protocol=chance.randrange(6))


def _shared(depth: int, each: int) -> Any:
    """Nested lists of each ** depth numbers in some bytes."""
    found: Any = [1.0] * each
    for _ in range(depth):
        found = [found] * each
    return found


def _deep() -> Any:
    found: Any = []
    for _ in range(150):
        found = [found]
    return found


def _edited(content: Any, chance: Random) -> Any:
    if isinstance(content, dict) and content and chance.random() < 0.9:
        key = chance.choice([*content])
        changed = {name: value for name, value in content.items() if name != key}
        kind = chance.randrange(10)
        if kind:
            changed[chance.choice([None, 5, (1, 2), "", key]) if kind == 1 else key] = _edited(content[key], chance)
        return changed
    if isinstance(content, list | tuple) and content and chance.random() < 0.7:
        found = list(content)
        found[chance.randrange(len(found))] = _edited(found[0], chance)
        return found
    if isinstance(content, np.ndarray) and chance.random() < 0.7:
        return arrays.edited(content, chance)
    odd = (None, 5, "x", [], {}, b"\xff", 10**400, np.nan, {"a": []}, [[1.0], [1.0, 2.0]], np.float64(1), {1, 2}, 1j)
    return chance.choice([*odd, _deep(), _shared(8, 10), _shared(40, 2), np.array(None, object), np.zeros((0, 3))])


# --- weights --------------------------------------------------------------------------------------------------


def safetensors(whole: bytes, chance: Random) -> bytes:
    """Edit the header of a safetensors file, that of posecal within it, or its numbers."""
    length = struct.unpack("<Q", whole[:8])[0]
    header, data = json.loads(whole[8 : 8 + length]), bytearray(whole[8 + length :])
    about, kind = header["__metadata__"], chance.randrange(7)
    if kind <= 2:
        about["posecal"] = texts.of_json(json.loads(about["posecal"]), chance)
    elif kind == 3:
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    elif kind == 4:
        names = [name for name in header if name != "__metadata__"]
        one, other = chance.choice(names), chance.choice(names)
        header[one], header[other] = header[other], header[one]
    elif kind == 5:
        entry = header[chance.choice([name for name in header if name != "__metadata__"])]
        entry["dtype"] = chance.choice(["F64", "I32", "F32", "BF16", "BOOL", "F8_E4M3", "U8", "C64"])
        entry["shape"] = chance.choice([entry["shape"][::-1], [1, *entry["shape"]], []])
    body = json.dumps(header) if kind != 6 else texts.of_json(header, chance)
    text = body.encode("utf-8", "surrogatepass")
    return struct.pack("<Q", chance.choice([len(text)] * 9 + [2**40])) + text + bytes(data)


# --- HDF5 -----------------------------------------------------------------------------------------------------


def hdf5(whole: bytes, chance: Random) -> bytes:
    """Put an edited array in the place of a dataset or an attribute, leave one out, or claim a huge one."""
    import h5py

    file = io.BytesIO(whole)
    with h5py.File(file, "r+") as stored:
        datasets: list[str] = []
        stored.visititems(lambda key, item: datasets.append(key) if isinstance(item, h5py.Dataset) else None)
        name, kind = chance.choice(datasets), chance.randrange(6)
        array = stored[name][()]
        parent, attributes = stored[name].parent, dict(stored[name].attrs)
        if kind == 5 and parent.attrs:
            key = chance.choice([*parent.attrs])
            parent.attrs[key] = chance.choice([0, -1, b"x", "x", np.zeros(3), 10**9, b"\x80\x04]."])
        else:
            del stored[name]
        if kind == 0:
            stored.create_dataset(name, shape=(10**6, 17, 3), dtype="f8", chunks=(1000, 17, 3))
        elif kind == 1:
            stored[name] = h5py.SoftLink(chance.choice(["/", "/nowhere", f"/{name}"]))
        elif kind in (3, 4):
            with contextlib.suppress(TypeError, ValueError):  # of types that HDF5 has not
                found = arrays.edited(np.asarray(array), chance)
                stored[name] = found.astype("S") if found.dtype.kind == "U" else found
                stored[name].attrs.update(attributes)
    return file.getvalue()
