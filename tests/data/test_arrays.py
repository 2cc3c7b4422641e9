"""Arrays are checked before anything is measured, and lists, types and layouts are measured alike."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from posecal.data.arguments import checked
from posecal.data.arrays import (
    as_array,
    as_labels,
    checked_choice,
    checked_number,
    checked_root,
    working_dtype,
)
from posecal.errors import PoseDataError
from posecal.metrics import min_mpjpe
from tests.helpers.random_worlds import Array, mostly, skewed

N, M, K, D = 5, 7, 4, 3


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K, D)


@pytest.mark.parametrize(
    ("hypotheses", "truth", "words"),
    [
        (
            (5, 17, 3),
            (7, 5, 17, 3),
            "hypotheses (5, 17, 3) and truth (7, 5, 17, 3): expected (N, M, K, D) and (M, K, D). The two look swapped.",
        ),
        ((5, 17, 3), (17, 3), "hypotheses (5, 17, 3) and truth (17, 3): expected (N, M, K, D) and (M, K, D)."),
        ((2, 5, 4, 3), (6, 4, 3), "but M is 5 and 6."),
        ((2, 5, 4, 3), (6, 9, 2), "but M is 5 and 6, K is 4 and 9, D is 3 and 2."),
        (
            (0, 5, 4, 3),
            (5, 4, 3),
            "hypotheses (0, 5, 4, 3) and truth (5, 4, 3): N is 0; expected at least one of each.",
        ),
        ((2, 0, 4, 0), (0, 4, 0), "M, D is 0; expected at least one of each."),
    ],
)
def test_shapes_that_do_not_fit_are_named_by_their_letters(
    hypotheses: tuple[int, ...], truth: tuple[int, ...], words: str
) -> None:
    with pytest.raises(PoseDataError, match=re.escape(words)):
        checked(np.zeros(hypotheses), np.zeros(truth))


@pytest.mark.parametrize("dtype", ["bool", "complex128", "U3", "O"])
def test_what_are_no_real_numbers_is_refused(dtype: str) -> None:
    good, bad = np.zeros((2, 3, 4, 3)), np.zeros((3, 4, 3)).astype(dtype)
    with pytest.raises(PoseDataError, match=r"truth: dtype .*; expected real numbers such as float32"):
        checked(good, bad)


@pytest.mark.parametrize(
    ("where", "found"),
    [
        (np.full((3, 4), 0.5), r"float64 \(3, 4\)"),
        (np.ones((4, 3), dtype=bool), r"bool \(4, 3\)"),
        ([1, 0], r"int64 \(2,\)"),
    ],
)
def test_a_mask_of_another_type_or_shape_is_refused(where: npt.ArrayLike, found: str) -> None:
    with pytest.raises(PoseDataError, match=rf"where: {found}; expected bool \(M, K\) = \(3, 4\)"):
        checked(np.zeros((2, 3, 4, 3)), np.zeros((3, 4, 3)), where)


@pytest.mark.parametrize("root", [4, -5, 99, "Hip", 1.5, 1.0, True, np.True_, [0], "0", np.array([1])])
def test_a_root_that_is_no_index_of_a_joint_is_refused(root: Any, arrays: tuple[Array, Array]) -> None:
    words = re.escape(f"root: {root!r}; expected the index of one of 4 joints.")
    with pytest.raises(PoseDataError, match=f"^{words}$"):
        min_mpjpe(*arrays, root=root)


@pytest.mark.parametrize("root", [-1, np.int64(3), np.array(3)])
def test_a_root_is_any_whole_number_and_may_be_counted_from_the_end(root: Any, arrays: tuple[Array, Array]) -> None:
    np.testing.assert_array_equal(min_mpjpe(*arrays, root=root), min_mpjpe(*arrays, root=K - 1))
    assert checked_root(root, K) == K - 1
    assert type(checked_root(root, K)) is int
    assert checked_root(None, K) is None


@pytest.mark.parametrize(
    ("dtype", "working"),
    [("f2", "f4"), ("f4", "f4"), (">f4", "f4"), ("f8", "f8"), ("g", "f8"), ("i2", "f8"), ("u1", "f8")],
)
def test_single_precision_stays_single_and_all_else_is_double(dtype: str, working: str) -> None:
    assert working_dtype(dtype) == np.dtype(working)


@pytest.mark.parametrize("dtype", ["f2", "f4", ">f4", ">f8", "g", "i2", "i8"])
@pytest.mark.parametrize("root", [None, 1])
@pytest.mark.parametrize("align", ["none", "similarity", "scale"])
def test_every_type_of_number_gives_what_double_gives(dtype: str, root: int | None, align: str) -> None:
    x, y = (array.astype(dtype) for array in skewed(3, N, M, K))
    expected = min_mpjpe(x.astype("f8"), y.astype("f8"), root=root, align=align)  # type: ignore[arg-type]
    found = min_mpjpe(x, y, root=root, align=align)  # type: ignore[arg-type]
    assert found.dtype == np.float64
    # Coordinates reach 1,200 mm; in single precision a dozen roundings make about 1e-3 mm.
    np.testing.assert_allclose(found, expected, atol=12 * 1200 * 2.0 ** -(24 if dtype[-2:] in {"f2", "f4"} else 49))


# --- lists and other arrays ----------------------------------------------------------------------------------------


class Exchanged:
    """An array of another library that offers nothing but the exchange protocol."""

    def __init__(self, array: Array) -> None:
        self.array = array

    def __dlpack__(self, **options: Any) -> Any:
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self.array.__dlpack_device__()


class Arrayed:
    """An array of another library that NumPy can read, such as one of JAX."""

    def __init__(self, array: Array) -> None:
        self.array = array

    def __array__(self, *_: Any, **__: Any) -> Array:
        return self.array


@pytest.mark.parametrize(
    "convert",
    [
        lambda x: tuple(x),
        lambda x: x.tolist(),
        Exchanged,
        Arrayed,
        lambda x: [Arrayed(part) for part in x],
    ],
    ids=["arrays", "numbers", "dlpack", "array", "parts"],
)
def test_lists_and_arrays_of_other_libraries_are_measured_as_arrays(convert: Any, arrays: tuple[Array, Array]) -> None:
    where = mostly(M, K)
    expected = min_mpjpe(*arrays, where=where, root=1)
    np.testing.assert_array_equal(min_mpjpe(*map(convert, arrays), where=where, root=1), expected)
    np.testing.assert_array_equal(min_mpjpe(*arrays, where=where.tolist(), root=1), expected)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([[1.0, 2.0], [3.0]], "truth: lists of unequal lengths; expected an array. Pad the shorter ones, and mask"),
        (None, "truth: NoneType; expected real numbers such as float32."),
        ("gt.npz", "truth: str; expected real numbers such as float32."),
        ([None, 1], "truth: dtype object; expected real numbers such as float32."),
        (np.ma.masked_equal([1.0, 2.0], 2.0), "truth: masked numbers; expected an array without."),
    ],
    ids=str,
)
def test_what_can_not_be_read_is_one_clear_error(values: Any, words: str) -> None:
    with pytest.raises(PoseDataError, match=f"^{re.escape(words)}"):
        checked(np.zeros((2, 3, 4, 3)), values)


def test_a_masked_array_without_masked_numbers_is_an_array() -> None:
    assert as_array(np.ma.masked_equal([1.0, 2.0], 5.0), "truth").tolist() == [1.0, 2.0]


def test_an_array_in_memory_is_not_copied(arrays: tuple[Array, Array]) -> None:
    assert np.shares_memory(as_array(arrays[0], "hypotheses"), arrays[0])


# --- single values --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [2.5, np.float32(2.5), np.array(2.5)])
def test_a_number_is_any_real_number(value: Any) -> None:
    assert checked_number(value, "threshold", lambda length: length > 0, "a length above 0") == 2.5


@pytest.mark.parametrize("value", [0, -1.0, "wide", None, True, [1.0], 2j, np.nan])
def test_a_number_that_is_none_or_not_valid_is_refused(value: Any) -> None:
    with pytest.raises(PoseDataError, match=rf"^threshold: {re.escape(repr(value))}; expected a length above 0\.$"):
        checked_number(value, "threshold", lambda length: length > 0, "a length above 0")


@pytest.mark.parametrize("value", ["medain", None, 3, ["median"], ("median",)])
def test_a_word_that_is_not_known_is_refused(value: Any) -> None:
    assert checked_choice("median", "over", ("median", "mean")) == "median"
    with pytest.raises(PoseDataError, match=rf"^over: {re.escape(repr(value))} is not known\. (Did you|Known: median)"):
        checked_choice(value, "over", ("median", "mean"))


def test_text_is_read_from_any_kind_of_array() -> None:
    for values in (["a", "b"], [b"a", b"b"], np.array(["a", "b"], dtype=object), pd.Series(["a", "b"])):
        assert as_labels(values, "action").tolist() == ["a", "b"]
    assert as_labels(pd.Categorical(["a", "b"]), "action").tolist() == ["a", "b"]
    assert as_labels([3, 1], "take").tolist() == ["3", "1"]
    assert as_labels("walk", "action", or_one=True).tolist() == "walk"
    with pytest.raises(
        PoseDataError, match=r"^action: <U4 \(\); expected one word or whole number per pose, \(M,\)\.$"
    ):
        as_labels("walk", "action")
    with pytest.raises(PoseDataError, match=r"^action: object \(2,\); expected one word or whole number per pose"):
        as_labels(["a", None], "action")


def layouts(x: Array) -> Iterator[Array]:
    """The same numbers, in memory in other ways."""
    yield np.asfortranarray(x)
    yield x[::-1].copy()[::-1]
    yield np.repeat(x, 2, axis=-2)[..., ::2, :]
    yield np.flip(np.flip(x, -1).copy(), -1)
    yield np.moveaxis(np.ascontiguousarray(np.moveaxis(x, 0, -1)), -1, 0)


def test_numbers_do_not_depend_on_the_layout_in_memory(arrays: tuple[Array, Array]) -> None:
    expected = min_mpjpe(*arrays)
    for x, y in zip(layouts(arrays[0]), layouts(arrays[1]), strict=True):
        assert min_mpjpe(x, y).tobytes() == expected.tobytes()


def test_arrays_stay_as_they_were_and_may_be_read_only(arrays: tuple[Array, Array]) -> None:
    x, y, where = *arrays, np.random.default_rng(0).random((M, K)) < 0.7
    before = [array.tobytes() for array in (x, y, where)]
    for array in (x, y, where):
        array.flags.writeable = False
    min_mpjpe(x, y, where=where, root=0, align="similarity")
    assert [array.tobytes() for array in (x, y, where)] == before
