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
from posecal.engine.bounds import CORRELATION, POSITIVE, SHARE, UNBOUNDED, Bounds, checked_bounds, ends_within
from posecal.errors import PoseDataError


def ends(value: float, reach: float, bounds: Bounds, number: float = 5.0) -> tuple[float, float]:
    low, high = ends_within(np.array([value]), np.array([reach]), np.array([number]), bounds)
    return low.item(), high.item()


def test_ends_are_those_of_the_log_the_logit_and_fisher_s_z() -> None:
    assert ends(80.0, 30.0, POSITIVE) == pytest.approx([80 * math.exp(s * 30 / 80) for s in (-1, 1)])
    logit = [special.expit(special.logit(0.9) + s * 0.1 / (0.9 * 0.1)) for s in (-1, 1)]
    assert ends(0.9, 0.1, SHARE) == pytest.approx(logit)
    fisher = [math.tanh(math.atanh(0.6) + s * 0.5 / (1 - 0.6**2)) for s in (-1, 1)]
    assert ends(0.6, 0.5, CORRELATION) == pytest.approx(fisher)
    assert ends(-3.0, 5.0, UNBOUNDED) == (-8.0, 2.0)
    assert ends(-0.5, 0.6, (-math.inf, 1.0)) == pytest.approx([1 - 1.5 * math.exp(s * 0.6 / 1.5) for s in (1, -1)])


@given(
    share=st.floats(0, 1),
    reach=st.floats(0, 1e6),
    bounds=st.sampled_from([SHARE, CORRELATION, (-0.5, 0.5), (0.0, 299.0)]),
)
def test_ends_hold_the_value_and_never_leave_a_finite_range(share: float, reach: float, bounds: Bounds) -> None:
    value = bounds[0] + share * (bounds[1] - bounds[0])
    low, high = ends(value, reach, bounds)
    assert bounds[0] <= low <= value + 1e-9 * abs(value)
    assert value - 1e-9 * abs(value) <= high <= bounds[1] + 1e-9


@given(value=st.floats(1e-6, 1e6), reach=st.floats(0, 1e9))
def test_ends_of_a_positive_number_are_positive(value: float, reach: float) -> None:
    low, high = ends(value, reach, POSITIVE)
    assert 0 <= low <= value * (1 + 1e-12)
    assert math.isfinite(high)
    assert high >= value * (1 - 1e-12)


def test_small_intervals_are_the_plain_ones_on_every_scale() -> None:
    for value, bounds in ((80.0, POSITIVE), (0.3, SHARE), (0.3, CORRELATION), (0.3, (-math.inf, 1.0))):
        assert ends(value, 1e-6, bounds) == pytest.approx((value - 1e-6, value + 1e-6), abs=1e-10)


def test_of_a_share_that_every_sequence_has_at_the_edge_the_other_end_is_the_rule_of_three_s() -> None:
    assert ends(1.0, 0.0, SHARE, number=10) == pytest.approx((0.05**0.1, 1.0))
    assert ends(0.0, 0.0, SHARE, number=10) == pytest.approx((0.0, 1 - 0.05**0.1))
    assert 1 - ends(1.0, 0.0, SHARE, number=100)[0] == pytest.approx(3 / 100, rel=0.02)
    assert ends(1.0, 0.0, CORRELATION, number=10) == pytest.approx((2 * 0.05**0.1 - 1, 1.0))


def test_outside_of_the_range_and_where_nothing_bounds_an_end_the_interval_is_plain() -> None:
    assert ends(-1.0, 3.0, POSITIVE) == (-4.0, 2.0)
    assert ends(0.0, 0.0, POSITIVE) == (0.0, 0.0)
    assert np.isnan(ends(0.5, math.nan, SHARE)).all()
    assert np.isnan(ends(1.0, math.nan, SHARE)).all()
    assert np.isnan(ends(math.nan, 0.1, SHARE)).all()


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
