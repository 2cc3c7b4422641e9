"""Numbers as text: units, digits and what is missing."""

from __future__ import annotations

import math

import pytest

from posecal.report.format import counted, number, p_value, short_number, short_p, span


@pytest.mark.parametrize(
    ("value", "unit", "long", "short"),
    [
        (77.91234, "mm", "77.912 mm", "77.9"),
        (0.0312346, "", "0.03123", "0.031"),
        (-0.000001, "", "0.00000", "0.000"),
        (math.nan, "mm", "–", "–"),
        (math.nan, "", "–", "–"),
    ],
)
def test_a_number_has_three_digits_with_a_unit_and_five_without(value: float, unit: str, long: str, short: str) -> None:
    assert (number(value, unit), short_number(value, unit)) == (long, short)


@pytest.mark.parametrize(
    ("low", "high", "unit", "words"),
    [
        (77.01, 78.99, "mm", "77.0 to 79.0"),
        (0.03, 0.04, "mm", "0.030 to 0.040"),
        (0.03, 1.0, "mm", "0.03 to 1.00"),
        (0.03, 0.999, "mm", "0.03 to 1.00"),
        (-1.5, 0.2, "mm", "-1.5 to 0.2"),
        (0.5, 1.5, "mm", "0.5 to 1.5"),
        (0.5, 1.5, "", "0.5 to 1.5"),
        (64.2, 76.3, "mm", "64 to 76"),
        (64.2, 1176.3, "mm", "64 to 1176"),
        (0.5, 0.5 + 1e-9, "mm", "0.500 to 0.500"),
        (0.5, 0.5, "", "0.50000 to 0.50000"),
        (math.nan, math.nan, "mm", ""),
    ],
)
def test_an_interval_has_two_digits_of_its_width(low: float, high: float, unit: str, words: str) -> None:
    assert span(low, high, unit) == words


def test_a_number_has_as_many_digits_as_the_ends_of_its_interval() -> None:
    assert number(70.3333, "mm", (64.2, 76.3)) == "70 mm"
    assert number(70.3333, "mm", (70.1, 70.6)) == "70.33 mm"
    assert number(0.91234, "", (0.87, 0.95)) == "0.912"
    assert number(70.3333, "mm", (70.3333, 70.3333)) == "70.333 mm"


@pytest.mark.parametrize(
    ("p", "sentence", "cell"),
    [
        (0.0009, "p < 0.001", "< 0.001"),
        (0.001, "p = 0.001", "0.001"),
        (0.0015, "p = 0.002", "0.002"),
        (1.0, "p = 1.000", "1.000"),
    ],
)
def test_a_p_value_is_never_zero(p: float, sentence: str, cell: str) -> None:
    assert (p_value(p), short_p(p)) == (sentence, cell)


def test_things_are_counted_in_singular_and_plural() -> None:
    assert [counted(n, "pose") for n in (0, 1, 2000)] == ["0 poses", "1 pose", "2,000 poses"]
    assert [counted(n, "hypothesis", "hypotheses") for n in (1, 2)] == ["1 hypothesis", "2 hypotheses"]
