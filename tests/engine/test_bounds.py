"""Possible ranges, and intervals that stay within them."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from posecal import Metric
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.bounds import (
    CORRELATION,
    POSITIVE,
    SHARE,
    UNBOUNDED,
    Bounds,
    checked_bounds,
    ends_at_edges,
    from_scale,
    to_scale,
)
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError
from posecal.registry import any_metrics

RANGES = [UNBOUNDED, POSITIVE, SHARE, CORRELATION, (-0.5, 0.5), (0.0, 299.0), (-math.inf, 1.0)]


def test_the_scales_are_the_log_the_logit_and_fisher_s_z() -> None:
    values = np.array([0.2, 0.5, 0.9])
    np.testing.assert_allclose(to_scale(values, POSITIVE), np.log(values))
    np.testing.assert_allclose(to_scale(values, SHARE), special.logit(values))
    np.testing.assert_allclose(to_scale(values, CORRELATION), 2 * np.arctanh(values))
    np.testing.assert_allclose(to_scale(values, (-math.inf, 1.0)), -np.log(1 - values))
    np.testing.assert_array_equal(to_scale(values, UNBOUNDED), values)


@given(scaled=st.floats(-12, 12), bounds=st.sampled_from(RANGES))
def test_each_scale_is_undone(scaled: float, bounds: Bounds) -> None:
    there = from_scale(np.array([scaled]), bounds)
    np.testing.assert_allclose(to_scale(there, bounds), [scaled], rtol=1e-6, atol=1e-9)


@given(scaled=st.floats(-1e9, 1e9), bounds=st.sampled_from(RANGES))
def test_whatever_comes_from_a_scale_lies_in_the_range(scaled: float, bounds: Bounds) -> None:
    (value,) = from_scale(np.array([scaled]), bounds)
    assert bounds[0] <= value <= bounds[1]
    assert math.isfinite(value)


def test_at_the_edge_and_beyond_a_number_is_at_infinity() -> None:
    assert to_scale(np.array([1.0, 1 - 1e-12, 1.1, 0.0, -2.0]), SHARE).tolist() == [math.inf] * 3 + [-math.inf] * 2
    assert to_scale(np.array([0.0, -1.0]), POSITIVE).tolist() == [-math.inf, -math.inf]
    assert np.isnan(to_scale(np.array([math.nan]), SHARE)).all()


def test_intervals_of_shares_at_the_edge_are_the_rule_of_three_s() -> None:
    values, number = np.array([1.0, 0.0, 0.5]), np.array([10.0, 100.0, 10.0])
    low, high = ends_at_edges(values, number, SHARE)
    np.testing.assert_allclose(low, [0.05**0.1, 0.0, math.nan])
    np.testing.assert_allclose(high, [1.0, 1 - 0.05**0.01, math.nan])
    assert high[1] == pytest.approx(3 / 100, rel=0.02)
    low, high = ends_at_edges(values[:1], number[:1], CORRELATION)
    np.testing.assert_allclose([low[0], high[0]], [2 * 0.05**0.1 - 1, 1.0])
    assert np.isnan(ends_at_edges(np.zeros(1), number[:1], POSITIVE)).all()
    near = np.array([1e-9, 3e-9])
    np.testing.assert_array_equal(np.isnan(ends_at_edges(near, number[:2], SHARE)[0]), [False, True])
    np.testing.assert_array_equal(np.isnan(ends_at_edges(2e3 * near, number[:2], (0.0, 2e3))[0]), [False, True])


@pytest.mark.parametrize("bounds", [(1.0, 0.0), (0.0, 0.0), (0.0,), 3.0, ("0", "1"), (math.nan, 1.0), None])
def test_bounds_are_two_numbers_the_smaller_first(bounds: object) -> None:
    with pytest.raises(PoseDataError, match="expected the smallest and the largest possible value"):
        checked_bounds(bounds)


@pytest.mark.parametrize("bounds", [UNBOUNDED, POSITIVE, SHARE, (-math.inf, 1.0)])
def test_a_metric_of_one_s_own_keeps_its_bounds(bounds: Bounds) -> None:
    metric = Metric.from_function(lambda x, y: np.abs(x - y)[..., 2].mean(axis=(0, 2)), name="own", bounds=bounds)
    assert metric.bounds == bounds
    assert Metric.from_description(metric.description).bounds == bounds
    assert pickle.loads(pickle.dumps(metric)).bounds == bounds


def test_descriptions_of_older_results_have_no_bounds() -> None:
    metric = Metric.from_function(lambda x, y: np.abs(x - y)[..., 2].mean(axis=(0, 2)), name="own", bounds=SHARE)
    older = {key: value for key, value in metric.description.items() if key != "bounds"}
    assert Metric.from_description(older).bounds == UNBOUNDED


def test_every_metric_with_an_interval_has_the_bounds_that_its_range_tells() -> None:
    spec = DataSpec(7, JOINT_SETS["h36m-17"], 0, ("sequence",), 25.0, True, reference="another", n_reference=7)
    for metric in any_metrics(Protocol(), spec).values():
        if metric.deviation is not None:
            expected = UNBOUNDED
        elif metric.range.startswith(("0 to 1", "0 to about 1")):
            expected = SHARE
        elif metric.range.startswith("−"):
            expected = CORRELATION if "−1 to 1" in metric.range else (-0.5, 0.5)
        elif metric.range == "0 to 0.25":
            expected = (0.0, 0.25)
        elif metric.name.endswith("skill"):
            expected = (-math.inf, 1.0)
        else:
            expected = (0.0, 299.0) if metric.name == "cps" else POSITIVE
        assert metric.bounds == expected, metric.name
