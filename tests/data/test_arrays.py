"""Are two arrays checked before anything is measured, and measured alike in every type and layout?"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest

from posecal.data.arrays import checked, working_dtype
from posecal.errors import PoseDataError
from posecal.metrics import min_mpjpe
from tests.helpers.random_worlds import Array, skewed

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
        (np.ones((3, 4)), r"float64 \(3, 4\)"),
        (np.ones((4, 3), dtype=bool), r"bool \(4, 3\)"),
        ([1, 0], r"int64 \(2,\)"),
    ],
)
def test_a_mask_of_another_type_or_shape_is_refused(where: npt.ArrayLike, found: str) -> None:
    with pytest.raises(PoseDataError, match=rf"where: {found}; expected bool \(M, K\) = \(3, 4\)"):
        checked(np.zeros((2, 3, 4, 3)), np.zeros((3, 4, 3)), where)


@pytest.mark.parametrize("root", [4, -5, 99])
def test_a_root_beyond_the_joints_is_refused(root: int, arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=rf"root: {root}; expected the index of one of 4 joints"):
        min_mpjpe(*arrays, root=root)


def test_a_root_may_be_counted_from_the_end(arrays: tuple[Array, Array]) -> None:
    np.testing.assert_allclose(min_mpjpe(*arrays, root=-1), min_mpjpe(*arrays, root=K - 1))


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


def test_lists_are_taken_as_arrays() -> None:
    assert min_mpjpe([[[[3, 4, 0]]]], [[[0, 0, 0]]]).tolist() == [5.0]


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
