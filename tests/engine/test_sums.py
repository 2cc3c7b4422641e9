"""Sums and means of rows by codes, against loops."""

from __future__ import annotations

import math

import numpy as np
import pytest

from posecal.engine.sums import add_rows, compact, mean_of, mean_of_known, slices, split_by, sum_by


@pytest.mark.parametrize(
    ("length", "row_bytes", "most", "expected"),
    [
        (7, 8, 24, [(0, 3), (3, 6), (6, 9)]),
        (6, 8, 24, [(0, 3), (3, 6)]),
        (3, 8, 7, [(0, 1), (1, 2), (2, 3)]),  # a single row, however large
        (2, 0, 10, [(0, 10)]),
        (0, 8, 24, []),
    ],
)
def test_slices_cover_the_rows(length: int, row_bytes: int, most: int, expected: list[tuple[int, int]]) -> None:
    assert [(some.start, some.stop) for some in slices(length, row_bytes, most)] == expected


def test_slices_hold_64_mib_by_default() -> None:
    assert [some.stop for some in slices(130, 1 << 20)] == [64, 128, 192]


def test_codes_are_numbered_as_they_occur() -> None:
    codes = np.array([3, 0, 3, 1, 2])
    for cells, numbers, n in ((None, [3, 0, 3, 1, 2], 4), (np.array([0, 2, 4]), [1, 1, 0], 2)):
        found, number = compact(codes, cells)
        assert (found.tolist(), number) == (numbers, n)
    nobody = np.zeros(0, dtype=np.intp)
    assert compact(nobody, None)[1] == compact(codes, nobody)[1] == 0


def test_rows_of_each_code_keep_their_order() -> None:
    parts = split_by(np.array([2, 0, 2, 0, 3]), 4)
    assert [part.tolist() for part in parts] == [[1, 3], [], [0, 2], [4]]
    assert split_by(np.zeros(0, dtype=np.intp), 0) == []


@pytest.mark.parametrize("codes", [[0, 1, 2, 3], [2, 0, 3, 1], [1, 0, 1, 0], [0, 0, 1, 2], [0, 1, 1, 2], [0, 0, 0, 0]])
def test_rows_are_summed_by_their_codes(codes: list[int]) -> None:
    values = np.array([[1, 10], [2, 20], [4, 40], [8, 80]])
    expected = np.zeros((max(codes) + 1, 2), dtype=int)
    for code, row in zip(codes, values, strict=True):
        expected[code] += row
    before = values.copy()
    found = sum_by(np.array(codes), max(codes) + 1, values)
    np.testing.assert_array_equal(found, expected)
    assert found.dtype == values.dtype
    np.testing.assert_array_equal(values, before)


@pytest.mark.parametrize(
    "codes", [[*range(3, 12)], [*range(0, 20, 2)], [*range(10), *range(4, 12)], [3, 1, 3, 0], [7] * 9, []]
)
@pytest.mark.parametrize("shape", [(), (3, 2)])
def test_rows_are_added_to_a_total_as_numpy_adds_them(codes: list[int], shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(0)
    found, values = random.normal(size=(20, *shape)), random.normal(size=(len(codes), *shape))
    expected = found.copy()
    np.add.at(expected, np.array(codes, dtype=np.intp), values)
    add_rows(found, np.array(codes, dtype=np.intp), values)
    np.testing.assert_array_equal(found, expected)


def test_many_rows_in_a_row_of_one_code_are_summed() -> None:
    values = np.arange(24.0).reshape(12, 2)
    found = sum_by(np.repeat([2, 0, 1, 2], 3), 3, values)
    np.testing.assert_array_equal(found, [values[3:6].sum(0), values[6:9].sum(0), (values[:3] + values[9:]).sum(0)])


def test_a_mean_is_the_sum_over_the_number_and_unknown_without_one() -> None:
    sums = np.array([[[2.0, 4.0], [9.0, 3.0]], [[0.0, 0.0], [5.0, 7.0]]])
    np.testing.assert_array_equal(
        mean_of(sums, np.array([[2, 3], [0, 1]])), [[[1, 2], [3, 1]], [[math.nan, math.nan], [5, 7]]]
    )
    np.testing.assert_array_equal(mean_of(sums, np.array([2, 0]))[0], sums[0] / 2)
    assert np.isnan(mean_of(sums, np.array([2, 0]))[1]).all()
    assert mean_of(np.array(3.0), np.array(2)) == 1.5
    np.testing.assert_array_equal(mean_of(np.array([1.0, 0.2]), np.array([0.5, 0.4])), [2, 0.5])  # weights


def test_the_mean_of_what_is_known_leaves_the_rest_out() -> None:
    assert mean_of_known(np.array([1.0, math.nan, 4.0])) == 2.5
    assert math.isnan(mean_of_known(np.array([math.nan])))
