"""Rank correlation and sparsification of spread and error, against scipy, loops, and worlds of a known answer."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from posecal import evaluate
from posecal.errors import PoseDataError
from posecal.metrics.uncertainty import DROPPED, ause, rank_correlation, sparsification

values = st.lists(st.tuples(st.integers(0, 6), st.integers(1, 9)), min_size=2, max_size=30)


@given(values)
def test_the_rank_correlation_is_scipys_ties_and_all(pairs: list[tuple[int, int]]) -> None:
    spread, error = np.array(pairs, dtype=float).T
    found = rank_correlation(spread, error)
    if len(set(spread)) < 2 or len(set(error)) < 2:
        assert math.isnan(found)
    else:
        np.testing.assert_allclose(found, stats.spearmanr(spread, error).statistic, atol=1e-9)


@given(values)
def test_sparsification_drops_the_widest_first(pairs: list[tuple[int, int]]) -> None:
    spread, error = np.array(pairs, dtype=float).T
    by_spread, by_error = sparsification(spread, error)
    for place, share in enumerate(DROPPED):
        kept = max(round((1 - share) * len(pairs)), 1)
        order = sorted(range(len(pairs)), key=lambda m: spread[m])[:kept]  # equal spreads in the order of the poses
        np.testing.assert_allclose(by_spread[place], np.mean(error[order]) / np.mean(error))
        np.testing.assert_allclose(by_error[place], np.mean(np.sort(error)[:kept]) / np.mean(error))
    np.testing.assert_allclose(ause(spread, error), np.mean(by_spread - by_error))
    assert ause(spread, error) >= -1e-12


def test_poses_without_a_number_are_left_out() -> None:
    spread, error = [1.0, 2.0, math.nan, 4.0, 3.0], [2.0, 5.0, 9.0, 7.0, math.nan]
    assert rank_correlation(spread, error) == rank_correlation([1, 2, 4], [2, 5, 7]) == 1
    np.testing.assert_array_equal(sparsification(spread, error), sparsification([1, 2, 4], [2, 5, 7]))


def test_nothing_left_has_no_curve() -> None:
    assert np.isnan(sparsification([math.nan], [1.0])).all()
    assert math.isnan(ause([], []))


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(PoseDataError, match=r"spread \(2,\) and error \(3,\): expected \(M,\) both"):
        rank_correlation([1, 2], [1, 2, 3])


def test_a_spread_that_goes_with_the_error_correlates_and_another_does_not() -> None:
    random = np.random.default_rng(0)
    N, M, K = 20, 400, 4
    of_error, of_nothing = random.lognormal(0, 1, (2, M, 1, 1))
    y, noise = of_error * random.normal(0, 30, (M, K, 3)), random.normal(0, 30, (N, M, K, 3))
    related, unrelated = (
        evaluate(x, y, unit="mm", threads=1) for x in (of_error * noise, 0.9 * y + 1e-3 * of_nothing * noise)
    )
    assert related["spread_error_correlation"] > 0.8
    # Without any relation the correlation's standard error is 1/√(M - 1).
    assert abs(unrelated["spread_error_correlation"]) < 4 / math.sqrt(M - 1)
    assert related["ause"] < unrelated["ause"]


def test_without_errors_there_is_nothing_to_drop() -> None:
    assert np.isnan(sparsification([1, 2, 3], [0, 0, 0])).all()
