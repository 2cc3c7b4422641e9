"""Differences of two models in one metric: sign, p-value, and what is better."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from posecal.engine.metric import Direction
from posecal.stats.pairs import Pair, pairs

Array = np.ndarray


def of_means(a: Array, b: Array, direction: Direction = "lower", present: Array | None = None) -> Pair:
    """Two models whose numbers are means over sequences."""
    values = {"a": float(a.mean()), "b": float(b.mean())}
    without = {name: (each.sum() - each) / (len(each) - 1) for name, each in {"a": a, "b": b}.items()}
    (pair,) = pairs(direction, values, without, np.ones(len(a), dtype=bool) if present is None else present)
    return pair


def test_the_p_value_of_means_is_that_of_the_paired_t_test() -> None:
    a, b = np.random.default_rng(0).normal([[5.0], [6.0]], 1, (2, 9))
    expected = stats.ttest_rel(a, b)
    found = of_means(a, b)
    interval = expected.confidence_interval(0.95)
    assert found.value == pytest.approx(a.mean() - b.mean())
    assert found.p == pytest.approx(expected.pvalue)
    assert (found.interval.low, found.interval.high) == pytest.approx((interval.low, interval.high))


@pytest.mark.parametrize(("sequences", "tested"), [(2, False), (5, False), (6, True)])
def test_below_six_sequences_there_is_no_p_value(sequences: int, tested: bool) -> None:
    a = np.arange(float(sequences))
    assert math.isnan(of_means(a, 2 * a + 1).p) is not tested


def test_sequences_without_a_pose_that_counts_are_not_counted() -> None:
    present = np.arange(7) < 5
    a = np.random.default_rng(0).normal(size=7)
    assert math.isnan(of_means(a, a + 1 + 0.1 * a**2, present=present).p)


@pytest.mark.parametrize("sequences", [6, 8, 40, 3000])
def test_no_p_value_is_zero(sequences: int) -> None:
    """Without any scatter p is that of as many signs that all agree."""
    values, without = {"a": 2.0, "b": 1.0}, {"a": np.full(sequences, 2.0), "b": np.full(sequences, 1.0)}
    (pair,) = pairs("lower", values, without, np.ones(sequences, dtype=bool))
    assert pair.interval.error == 0
    assert pair.p == (2 * 0.5**sequences if sequences < 1000 else np.finfo(float).tiny)
    without["a"] = 2 + 1e-12 * np.arange(sequences)
    (pair,) = pairs("lower", values, without, np.ones(sequences, dtype=bool))
    assert pair.p > 0


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 1e-10), (1000.0, 0.9e-3), (0.0, 0.9e-9)])
def test_rounding_is_no_difference(scale: float, shift: float) -> None:
    a = scale * np.linspace(0.9, 1.1, 8)
    assert of_means(a, a + shift).p == 1
    assert of_means(a, a + 1e3 * (shift + 1e-8)).p < 0.05


@pytest.mark.parametrize(
    ("values", "is_rounding"),
    [((1e6, 1e6 - 1), True), ((1e6, 1e6 - 1.001), False), ((-1e6, 1 - 1e6), True), ((1e-9, 0.0), True)],
)
def test_a_millionth_of_the_larger_number_is_rounding(values: tuple[float, float], is_rounding: bool) -> None:
    a, b = values
    without = {"a": np.full(8, a), "b": b + (a - b) * np.linspace(-0.01, 0.01, 8)}
    (pair,) = pairs("lower", {"a": a, "b": b}, without, np.ones(8))
    assert (pair.p == 1) is is_rounding


def test_small_differences_have_a_better_model_too() -> None:
    pair = of_means(np.linspace(0.50, 0.51, 8), np.linspace(0.90, 0.92, 8))
    assert -1 < pair.value < 0
    assert pair.difference("m", "lower", 0.01, primary=True).better == "a"
    assert pair.difference("m", "higher", 0.01, primary=True).better == "b"


def test_a_pair_without_a_difference_keeps_its_models_and_sequences() -> None:
    found = of_means(np.linspace(1, 2, 8), np.linspace(3, 4.5, 8)).unknown()
    assert (found.first, found.second, found.interval.sequences) == ("a", "b", 8)
    interval = found.interval
    assert np.isnan([found.value, found.p, interval.low, interval.high, interval.error, interval.freedom]).all()


@pytest.mark.parametrize(
    ("direction", "better"), [("lower", "a"), ("higher", "b"), ("none", None), ("zero", "b")], ids=str
)
def test_the_better_model_is_the_one_in_the_direction(direction: Direction, better: str | None) -> None:
    pair = of_means(-np.linspace(3, 3.1, 8), -np.linspace(1, 1.2, 8), direction)
    assert (pair.value > 0) == (direction == "zero")
    found = pair.difference("m", direction, 0.049, primary=True)
    assert found.better == better
    assert found.compared == ("distance from 0" if direction == "zero" else "value")
    swapped = of_means(-np.linspace(1, 1.2, 8), -np.linspace(3, 3.1, 8), direction)
    assert swapped.difference("m", direction, 0.049, primary=True).better == ({"a": "b", "b": "a"}.get(str(better)))


def test_better_follows_the_adjusted_p_value() -> None:
    pair = of_means(np.linspace(1, 2, 8), np.linspace(3, 4.5, 8))
    assert pair.p < 0.001
    for adjusted in (0.02, 0.05, 1.0, math.nan):
        found = pair.difference("m", "lower", adjusted, primary=False)
        assert found.better is None
        assert (found.p, found.primary) == (pair.p, False)
    assert pair.difference("m", "lower", 0.0199, primary=False).better == "a"
    assert pair.difference("m", "lower", 0.02, primary=True).better == "a"
    assert pair.difference("m", "lower", 0.05, primary=True).better is None
