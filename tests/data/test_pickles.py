"""The safe reader of pickles: plain data of every protocol is read, anything else refused before it runs code."""

from __future__ import annotations

import os
import pickle
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.data.pickles import read_object_npz, read_pickle
from posecal.errors import PoseFileError

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)


def numbers(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=shape) * 100


class _CreatesFolder:
    """An object whose pickle creates a folder when it is loaded."""

    def __init__(self, proof: Path) -> None:
        self.proof = proof

    def __reduce__(self):
        return os.mkdir, (str(self.proof),)


def test_a_pickle_of_plain_data_is_read(tmp_path):
    held = {"S1": {"poses": numbers(3, 2), "name": "Directions", "list": [1, 2.5, None, True], "t": (1, "a")}}
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(held, protocol=protocol))
        read = read_pickle(tmp_path / "a.pkl")
        np.testing.assert_array_equal(read["S1"]["poses"], held["S1"]["poses"])
        assert {k: v for k, v in read["S1"].items() if k != "poses"} == {
            k: v for k, v in held["S1"].items() if k != "poses"
        }


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_a_hostile_pickle_is_refused_and_runs_nothing(tmp_path, protocol):
    proof = tmp_path / "it ran"
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"poses": _CreatesFolder(proof)}, protocol=protocol))
    with pytest.raises(PoseFileError, match=r"a\.pkl: asks for posix\.mkdir; expected a pickle of plain arrays"):
        read_pickle(tmp_path / "a.pkl")
    assert not proof.exists()
    pickle.loads((tmp_path / "a.pkl").read_bytes())
    assert proof.exists()  # Python's own reader would have run it: this test can fail


def test_a_hostile_array_in_an_npz_is_refused_and_runs_nothing(tmp_path):
    proof = tmp_path / "it ran"
    np.savez(tmp_path / "a.npz", positions_3d=np.array(_CreatesFolder(proof), dtype=object))
    with pytest.raises(PoseFileError, match=r"positions_3d: asks for posix\.mkdir"):
        read_object_npz(tmp_path / "a.npz")
    assert not proof.exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "a.pkl: it is cut off or damaged"),
        (b"garbage", "expected a pickle of plain arrays"),
        (b"cbuiltins\neval\n(S'1'\ntR.", r"asks for builtins\.eval"),
        (b"c_codecs\nencode\n(S'a'\nS'rot13'\ntR.", "asks for the codec rot13"),
    ],
)
def test_a_damaged_or_hostile_pickle_is_refused(tmp_path, content, words):
    (tmp_path / "a.pkl").write_bytes(content)
    with pytest.raises(PoseFileError, match=words):
        read_pickle(tmp_path / "a.pkl")


def test_a_missing_pickle_is_named(tmp_path):
    with pytest.raises(PoseFileError, match=r"none\.pkl: no such file"):
        read_pickle(tmp_path / "none.pkl")


# --- arrays, as NumPy 1 and 2 and Python 2 and 3 write them -------------------------------------------------------

OBJECTS = np.empty(3, object)
OBJECTS[:] = [np.arange(3.0), {"poses": [np.arange(4).reshape(2, 2)]}, None]

ARRAYS = {
    "by rows": numbers(3, 2),
    "by columns": np.asfortranarray(numbers(3, 2)),
    "axes turned": numbers(2, 3, 4).transpose(1, 0, 2),
    "with gaps": numbers(4, 6)[::2, ::3],
    "big endian": np.arange(6, dtype=">f4").reshape(2, 3),
    "half": np.arange(3, dtype=np.float16),
    "signed": np.arange(5, dtype=">i2"),
    "unsigned": np.arange(5, dtype=np.uint64),
    "bools": np.array([True, False]),
    "no axis": np.array(2.5),
    "empty": np.zeros((0, 3)),
    "empty, of objects": np.zeros((0, 3), object),
    "text": np.array([["S1", "S11"], ["ü", ""]]),
    "big endian text": np.array(["S1", "S11"], ">U5"),
    "bytes": np.array([b"S1", b"\xff"]),
    "objects without an axis": np.array({"S1": 1}, object),
    "a number": np.float64(2.5),
    "a small number": np.int16(-3),
    "a bool": np.bool_(True),
    "a word": np.str_("Walking"),
    "no word": np.str_(""),
}


def of_numpy_1(pickled: bytes) -> bytes:
    """What NumPy 1 would have written: names in numpy.core, and so other lengths."""
    changed = pickled
    for name in (b"multiarray", b"numeric"):
        new, old = b"numpy._core." + name, b"numpy.core." + name
        changed = changed.replace(b"\x8c" + bytes([len(new)]) + new, b"\x8c" + bytes([len(old)]) + old)
        changed = changed.replace(b"c" + new, b"c" + old)
    if changed[2:3] == b"\x95":  # one frame, whose length comes first
        changed = changed[:3] + struct.pack("<Q", len(changed) - 11) + changed[11:]
    return changed


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_and_numbers_come_back(tmp_path, name, protocol):
    held = ARRAYS[name]
    pickled = pickle.dumps({"S1": held, "again": [held]}, protocol=protocol)
    for written in (pickled, of_numpy_1(pickled)):
        (tmp_path / "a.pkl").write_bytes(written)
        read = read_pickle(tmp_path / "a.pkl")["S1"]
        assert type(read) is type(held)
        assert (read.dtype, read.shape) == (held.dtype, held.shape)
        np.testing.assert_array_equal(read, held)


def test_pickles_of_numpy_1_use_its_names():
    written = [of_numpy_1(pickle.dumps(numbers(2), protocol=protocol)) for protocol in PROTOCOLS]
    assert all(b"numpy.core." in one and b"_core" not in one for one in written)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_arrays_of_objects_hold_arrays(tmp_path, protocol):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(OBJECTS, protocol=protocol))
    first, second, third = read_pickle(tmp_path / "a.pkl")
    np.testing.assert_array_equal(first, OBJECTS[0])
    np.testing.assert_array_equal(second["poses"][0], OBJECTS[1]["poses"][0])
    assert third is None


def test_shared_objects_stay_shared(tmp_path):
    held = numbers(2)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps([held, held, (held,)]))
    first, second, (third,) = read_pickle(tmp_path / "a.pkl")
    assert first is second is third


def test_a_pickle_of_python_2_is_read(tmp_path):
    begun = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
    dtype = b"cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
    content = struct.pack("<2d", 1.5, -np.pi)
    array = begun + b"(K\x01K\x02\x85" + dtype + b"\x89U" + bytes([len(content)]) + content + b"tb"
    (tmp_path / "a.pkl").write_bytes(b"\x80\x02}U\x05poses" + array + b"s.")
    np.testing.assert_array_equal(read_pickle(tmp_path / "a.pkl")["poses"], [1.5, -np.pi])


# --- arrays in hostile pickles ----------------------------------------------------------------------------------------


class Call:
    """An object whose pickle calls a global with arguments, and then sets a state."""

    def __init__(self, call: Callable[..., Any], *arguments: object, state: object = None) -> None:
        self.reduced = (call, arguments) if state is None else (call, arguments, state)

    def __reduce__(self):
        return self.reduced


RECONSTRUCT, SCALAR = np.zeros(0).__reduce__()[0], np.float64(0).__reduce__()[0]
FROM_BUFFER = np.zeros(0).__reduce_ex__(5)[0]
ADDRESS = struct.pack("<Q", 0x4141414141414141)


def array_of(shape: object, dtype: object, content: object, *, fortran: bool = False, kind: type = np.ndarray) -> Call:
    return Call(RECONSTRUCT, kind, (0,), b"b", state=(1, shape, dtype, fortran, content))


def dtype_of(code: str, order: str = "<", *parts: object, flags: int = 0) -> Call:
    subarray, names, fields = parts or (None, None, None)
    return Call(np.dtype, code, False, True, state=(3, order, subarray, names, fields, 8, 1, flags))


FORGED = ("|", None, ("a",), {"a": (np.dtype(object), 0)})
F8 = np.dtype("f8")
CYCLE: list[Any] = []
CYCLE.append(CYCLE)


@pytest.mark.parametrize(
    ("held", "words"),
    [
        (array_of((1,), dtype_of("V8", *FORGED), ADDRESS), "asks for the dtype 'V8'"),
        (array_of((1,), dtype_of("f8", *FORGED), ADDRESS), "asks for records or subarrays, as the dtype f8"),
        (array_of((1,), dtype_of("O8", "|"), ADDRESS), r"has bytes for an array of \(1,\) objects"),
        (Call(FROM_BUFFER, ADDRESS, dtype_of("V8", *FORGED), (1,), "C"), "asks for the dtype 'V8'"),
        (Call(SCALAR, dtype_of("V8", *FORGED), ADDRESS), "asks for the dtype 'V8'"),
        (Call(SCALAR, np.dtype(object), [1]), "asks for an object as a number"),
        (np.zeros(2, [("x", "f8")]), "asks for the dtype 'V8'"),
        (np.zeros(2, "V3"), "asks for the dtype 'V3'"),
        (np.zeros(2, "M8[s]"), "asks for the dtype 'M8'"),
        (np.zeros(2, complex), "asks for the dtype 'c16'"),
        (array_of((2,), dtype_of("f8", "<", (F8, (2,)), None, None), bytes(32)), "asks for records or subarrays"),
        (array_of((1,), dtype_of("f8", "<O"), bytes(8)), "has an invalid state of the dtype f8"),
        (array_of((1,), Call(np.dtype, "f8,f8"), bytes(16)), "asks for the dtype 'f8,f8'"),
        (array_of((10**15,), F8, bytes(8)), r"has 8 bytes for an array of \(1000000000000000,\) float64"),
        (array_of((10**15,), np.dtype("U0"), b""), "."),
        (array_of((1,), np.dtype("U1"), b"\xff" * 4), "invalid code points"),
        (array_of((-1,), F8, bytes(8)), r"asks for an array of shape \(-1,\)"),
        (array_of((-1, -1), F8, bytes(8)), r"asks for an array of shape \(-1, -1\)"),
        (array_of((True,), F8, bytes(8)), r"asks for an array of shape \(True,\)"),
        (array_of((1.0,), F8, bytes(8)), r"asks for an array of shape \(1\.0,\)"),
        (array_of([1], F8, bytes(8)), r"asks for an array of shape \[1\]"),
        (array_of((1,), F8, [1.0]), r"has list for an array of \(1,\) float64"),
        (array_of((1,), "f8", bytes(8)), "asks for an array without a dtype"),
        (array_of((3,), np.dtype(object), [1, 2]), r"has 2 objects for an array of \(3,\)"),
        (array_of((1,), F8, bytes(8), kind=np.matrix), r"asks for numpy\.matrix|asks for numpy\.matrixlib"),
        (Call(RECONSTRUCT, np.dtype, (0,), b"b"), "asks for an array of another class"),
        (Call(np.ndarray, (10**15,), "f8"), "makes an array without content"),
        (Call(FROM_BUFFER, bytes(8), F8, (1,), "A"), "asks for an array in the order A"),
        (Call(FROM_BUFFER, bytes(8), F8, (1,), "K", (3,)), "."),
        (np.dtype("f8"), "holds a dtype"),
        (np.ndarray, "holds a callable"),
        ({1, 2}, "holds a set|asks for"),
        (bytearray(3), "holds a bytearray|asks for"),
        (CYCLE, "contains itself"),
        (array_of((1,), np.dtype(object), [{"deep": array_of((1,), dtype_of("V8", *FORGED), ADDRESS)}]), "dtype 'V8'"),
    ],
)
@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_a_pickle_that_forges_arrays_is_refused(tmp_path, protocol, held, words):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"S1": held}, protocol=protocol))
    with pytest.raises(PoseFileError, match=rf"(?s)^[^\n]*a\.pkl: [^\n]*({words})[^\n]*; expected a pickle of plain"):
        read_pickle(tmp_path / "a.pkl")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x80\x02" + b"]" * 500 + b"a" * 499 + b".", "is nested more than 100 deep"),
        (b"\x80\x02c_codecs\nencode\n}U\x0c__defaults__K\x01sb.", "changes the state of a global"),
        (b"\x80\x02c_codecs\nencode\nN}U\x0c__defaults__K\x01s\x86b.", "changes the state of a global"),
        (b"\x80\x02cnumpy\ndtype\n)\x81.", "is not a type"),
        (b"\x80\x04\x8e" + b"\xff" * 8 + b".", "exceeds system's maximum size"),
        (b"\x80\x04\x8e" + b"\xff" * 7 + b"\x0f.", "."),
        (b"\x80\x03B\xff\xff\xff\x7f.", "cut off"),
    ],
    ids=["deep", "changed", "changed by slots", "made anew", "too long", "too large", "cut off"],
)
def test_a_pickle_that_changes_globals_or_has_wrong_lengths_is_refused(tmp_path, content, words):
    (tmp_path / "a.pkl").write_bytes(content)
    with pytest.raises(PoseFileError, match=rf"a\.pkl: .*({words}).*; expected a pickle of plain"):
        read_pickle(tmp_path / "a.pkl")


def test_a_large_memo_index_allocates_no_memory(tmp_path):
    (tmp_path / "a.pkl").write_bytes(b"\x80\x02]r\xff\xff\xff\x00.")  # an empty list, with memo index 2^24
    tracemalloc.start()
    try:
        assert read_pickle(tmp_path / "a.pkl") == []
        assert tracemalloc.get_traced_memory()[1] < 1e7
    finally:
        tracemalloc.stop()


# --- sizes that are only claimed ----------------------------------------------------------------------------------


def test_lists_that_hold_one_list_many_times_are_refused_before_they_are_spread_out(tmp_path):
    held = [1.0] * 10
    for _ in range(9):
        held = [held] * 10  # ten thousand million numbers in some hundred bytes
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"poses": held}))
    with pytest.raises(PoseFileError, match=r"a\.pkl: repeats its parts many times; expected a pickle of plain arrays"):
        read_pickle(tmp_path / "a.pkl")


def test_a_list_that_two_keys_share_is_read_for_both(tmp_path):
    names = ["Hip", "Head"]
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"one": names, "two": names}))
    assert read_pickle(tmp_path / "a.pkl") == {"one": names, "two": names}


def test_two_gibibytes_that_twelve_bytes_claim_are_refused_without_memory(tmp_path):
    (tmp_path / "a.pkl").write_bytes(b"\x80\x05\x96" + (2**31).to_bytes(8, "little") + b".")
    tracemalloc.start()
    with pytest.raises(PoseFileError, match=r"a\.pkl: claims a bytearray of 2,147,483,648 bytes"):
        read_pickle(tmp_path / "a.pkl")
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()
