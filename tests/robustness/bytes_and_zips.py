"""Damage to the bytes of a file, and to the headers and members of a zip archive."""

from __future__ import annotations

import io
import struct
import warnings
import zipfile
from collections.abc import Callable
from random import Random

import numpy as np

ODD = (0, 1, 2, 3, 7, 8, 9, 12, 63, 127, 255, 256, 0x7FFF, 0xFFFF, 10**6, 10**9, 2**31 - 1, 2**31, 2**32 - 1, 2**63)
"""Numbers at which readers go wrong."""


# --- bytes ----------------------------------------------------------------------------------------------------


def flipped(whole: bytes, chance: Random) -> bytes:
    """Change some bytes."""
    changed = bytearray(whole)
    for _ in range(chance.choice([1, 1, 1, 3, 20])):
        if changed:
            changed[chance.randrange(len(changed))] ^= chance.choice(
                [chance.randrange(1, 256), 1 << chance.randrange(8)]
            )
    return bytes(changed)


def cut(whole: bytes, chance: Random) -> bytes:
    """Leave the end out, or the beginning."""
    at = chance.choice([chance.randrange(len(whole) + 1), len(whole) - chance.randrange(1, 30)])
    return whole[max(0, at) :] if chance.random() < 0.1 else whole[: max(0, at)]


def moved(whole: bytes, chance: Random) -> bytes:
    """Repeat, leave out, insert or blank a piece."""
    start = chance.randrange(len(whole) + 1)
    piece = whole[start : start + chance.choice([1, 2, 8, 100, 1000])]
    before, after = whole[:start], whole[start + len(piece) :]
    kinds = (piece + piece, b"", chance.randbytes(chance.choice([1, 4, 64])) + piece, bytes(len(piece)))
    return before + chance.choice(kinds) + after


def with_odd_number(whole: bytes, chance: Random) -> bytes:
    """Write a number where readers go wrong over some bytes."""
    number, size = chance.choice(ODD), chance.choice([1, 2, 4, 8])
    start = chance.randrange(len(whole) + 1)
    order = chance.choice(["little", "big"])
    return whole[:start] + (number % 256**size).to_bytes(size, order) + whole[start + size :]  # type: ignore[arg-type]


BYTES = (flipped, flipped, cut, moved, with_odd_number)


# --- headers of zip archives ----------------------------------------------------------------------------------

_LOCAL, _CENTRAL, _END = b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"
_FIELDS = {
    _LOCAL: {"version": (4, 2), "flags": (6, 2), "method": (8, 2), "crc": (14, 4), "packed": (18, 4), "size": (22, 4)}
    | {"name": (26, 2), "extra": (28, 2), "letter": (30, 1)},
    _CENTRAL: {"version": (6, 2), "flags": (8, 2), "method": (10, 2), "crc": (16, 4), "packed": (20, 4)}
    | {"size": (24, 4), "name": (28, 2), "extra": (30, 2), "comment": (32, 2), "offset": (42, 4), "letter": (46, 1)},
    _END: {"disk": (4, 2), "here": (8, 2), "entries": (10, 2), "size": (12, 4), "offset": (16, 4), "comment": (20, 2)},
}
"""Where the fields of each header lie, and how long they are."""


def _headers(whole: bytes) -> dict[bytes, list[int]]:
    """Where the headers of each kind begin, as the directory has them."""
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        found = {_LOCAL: [info.header_offset for info in archive.infolist()], _CENTRAL: [], _END: [whole.rfind(_END)]}
        at = archive.start_dir
    while whole[at : at + 4] == _CENTRAL:
        found[_CENTRAL].append(at)
        at += 46 + sum(struct.unpack_from("<3H", whole, at + 28))
    return found


def _set(whole: bytearray, kind: bytes, at: int, field: str, number: int) -> None:
    offset, size = _FIELDS[kind][field]
    whole[at + offset : at + offset + size] = (number % 256**size).to_bytes(size, "little")


def with_odd_header(whole: bytes, chance: Random) -> bytes:
    """Set a field of a header, or the same field of a member's two headers."""
    changed, headers = bytearray(whole), _headers(whole)
    kind = chance.choice([_LOCAL, _CENTRAL, _CENTRAL, _END])
    number = chance.randrange(len(headers[kind]))
    field, value = chance.choice([*_FIELDS[kind]]), chance.choice([*ODD, chance.randrange(1 << 16)])
    _set(changed, kind, headers[kind][number], field, value)
    if kind != _END and field in _FIELDS[_LOCAL] and field != "letter" and chance.random() < 0.5:
        for both in (_LOCAL, _CENTRAL):
            _set(changed, both, headers[both][number], field, value)
    return bytes(changed)


def encrypted_or_packed_otherwise(whole: bytes, chance: Random) -> bytes:
    """Say of a member that it is encrypted, packed by another method, of another version, or has another checksum."""
    changed, headers = bytearray(whole), _headers(whole)
    number = chance.randrange(len(headers[_LOCAL]))
    odd = {"flags": (1, 0x41, 0x20, 0x2000, 0x800), "method": (1, 6, 8, 0, 9, 12, 14, 93, 97, 99)}
    field = chance.choice(["flags", "method", "version", "crc"])
    value = chance.choice(odd.get(field, ODD))
    for kind in (_LOCAL, _CENTRAL):
        _set(changed, kind, headers[kind][number], field, value)
    return bytes(changed)


def overlapping(whole: bytes, chance: Random) -> bytes:
    """Let two entries of the directory name the same bytes."""
    changed, headers = bytearray(whole), _headers(whole)
    one, other = chance.choice(headers[_CENTRAL]), chance.choice(headers[_CENTRAL])
    for field in ("crc", "packed", "size", "offset"):
        offset, size = _FIELDS[_CENTRAL][field]
        changed[one + offset : one + offset + size] = whole[other + offset : other + offset + size]
    return bytes(changed)


def without_entry(whole: bytes, chance: Random) -> bytes:
    """Leave an entry out of the directory, or name it twice; the member stays where it lies."""
    headers = _headers(whole)
    number = chance.randrange(len(headers[_CENTRAL]))
    start = headers[_CENTRAL][number]
    stop = start + 46 + sum(struct.unpack_from("<3H", whole, start + 28))
    twice = chance.random() < 0.3
    changed = bytearray(whole[:start] + (whole[start:stop] * 2 if twice else b"") + whole[stop:])
    end, (entries, length) = changed.rfind(_END), struct.unpack_from("<HI", whole, headers[_END][0] + 10)
    for field in ("here", "entries"):
        _set(changed, _END, end, field, entries + (1 if twice else -1))
    _set(changed, _END, end, "size", length + (stop - start) * (1 if twice else -1))
    return bytes(changed)


RAW_ZIP = (*BYTES, with_odd_header, with_odd_header, encrypted_or_packed_otherwise, overlapping, without_entry)
"""Damage of which checksums, or the directory, must tell."""


# --- members of zip archives ----------------------------------------------------------------------------------

Change = Callable[[bytes, Random], bytes]


def repacked(change: Change, names: str = "") -> Change:
    """Make a change of one member, with a right checksum.

    Parameters
    ----------
    change : callable
        Of the member's contents.
    names : str
        What the member's name must contain.
    """

    def changed(whole: bytes, chance: Random) -> bytes:
        packed = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(whole)) as stored, zipfile.ZipFile(packed, "w") as archive:
            chosen = chance.choice([name for name in stored.namelist() if names in name])
            for info in stored.infolist():
                contents = stored.read(info)
                _add(archive, info, change(contents, chance) if info.filename == chosen else contents)
        return packed.getvalue()

    changed.__name__ = f"repacked_{change.__name__}"
    return changed


def _add(archive: zipfile.ZipFile, info: zipfile.ZipInfo, contents: bytes, name: str = "") -> None:
    written = zipfile.ZipInfo(name or info.filename)
    written.compress_type = zipfile.ZIP_DEFLATED if len(contents) > 10**6 else info.compress_type
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a name that is there already, on purpose
        archive.writestr(written, contents, compresslevel=1)


def with_other_members(whole: bytes, chance: Random) -> bytes:
    """Write an archive anew without a member, with one twice, renamed, exchanged with another, or beside others."""
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(whole)) as stored, zipfile.ZipFile(packed, "w") as archive:
        infos = stored.infolist()
        chosen, other, kind = chance.choice(infos), chance.choice(infos), chance.randrange(6)
        for info in infos:
            swapped = {chosen.filename: other, other.filename: chosen}.get(info.filename, info) if kind == 0 else info
            if kind == 1 and info is chosen:
                continue
            odd = ("../x.npy", "", "ünï.npy", "a\x1b[31m.npy", "sequence", "truth.npy", "x" * 5000)
            _add(archive, info, stored.read(swapped), chance.choice(odd) if kind == 2 and info is chosen else "")
            if kind == 3 and info is chosen:
                _add(archive, info, stored.read(other))
        if kind == 4:
            _add(archive, chosen, b"words", chance.choice(["notes.txt", "notes.npy", "notes"]))
        if kind == 5:
            for number in range(2000):
                _add(archive, chosen, b"", f"{number}.npy")
    return packed.getvalue()


def bomb(whole: bytes, chance: Random) -> bytes:
    """Put an array of millions of zeros in the place of a member: some ten megabytes that pack into kilobytes."""
    dtype, count = chance.choice([("<U1", 4 * 10**6), ("<f8", 2 * 10**6), ("|b1", 16 * 10**6), ("<U4000000", 1)])
    array = np.zeros(count, dtype=dtype)
    if dtype == "<f8" and chance.random() < 0.5:
        array = array.reshape(chance.choice([(2, 10**5, 5, 2), (10**6, 1, 2), (1, 1, 10**6, 2)]))
    file = io.BytesIO()
    np.save(file, array)
    return repacked(lambda _whole, _chance: file.getvalue())(whole, chance)
