"""What the page claims of the null, of degenerate data, of few hypotheses and of floors, with few replicates."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.calibration import perfect_sampler
from tests.evidence.null import DATA, calibrated, degenerate_rows, few_rows, nulls, ratio_to_calibrated, simulated_floor
from tests.helpers.sequences import Ranks

REPLICATES = 6
SPREAD_OF_ONE = 0.3
"""Relative standard deviation of one replicate's null mean at 12 correlated sequences; of more data it is less."""


@pytest.mark.slow
@pytest.mark.parametrize("ranks", DATA, ids=str)
@pytest.mark.parametrize(
    ("model", "factor"),
    [
        ("spread × 0.5", 1.5),
        ("spread × 1", 1.5),
        ("spread × 2", 1.5),
        ("spread × 0.1", 2.5),
        ("spread × 10", 2.5),
        ("shifted by 1.5 sd", 2.5),
        ("one mode for two at ± 2 sd", 2.5),
    ],
)
def test_any_model_is_compared_with_what_a_calibrated_sampler_shows(ranks: Ranks, model: str, factor: float) -> None:
    mean, high = calibrated(ranks, 40)
    found, _ = nulls(ranks, model, REPLICATES)
    allowed = factor * (1 + 3 * SPREAD_OF_ONE / np.sqrt(REPLICATES) * (ranks.correlation > 0) + 0.1)
    for number, expected in (("mean", mean), ("high", high)):
        ratio = np.mean([getattr(null, number) for null in found]) / expected
        assert 1 / allowed < ratio < allowed, number


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.1, 0.5, 2.0, 10.0])
@pytest.mark.parametrize("correlation", [0.0, 0.95])
@pytest.mark.parametrize("n", [2, 30])
def test_so_is_a_model_of_any_number_of_hypotheses(n: int, correlation: float, spread: float) -> None:
    factor = 2.5 if spread in {0.1, 10.0} else 1.5
    allowed = factor * (1 + 3 * SPREAD_OF_ONE / np.sqrt(REPLICATES) * (correlation > 0) + 0.1)
    _, now = ratio_to_calibrated(Ranks(12, 100, 8, correlation, hypotheses=n), spread, REPLICATES)
    assert np.isnan(now) if (n, spread) == (2, 10.0) else 1 / allowed < now < allowed


def test_of_few_hypotheses_that_are_much_too_wide_it_is_not_known() -> None:
    """Of ten the median's noise is 100/10 · π/2 = 16 times as large as the squared errors, whose share is 0.06."""
    ranks = [Ranks(40, 50, 8, 0.95, hypotheses=n) for n in (10, 20, 30)]
    known = [ratio_to_calibrated(each, 10, 2)[1] for each in ranks]
    assert np.isnan(known[0])
    assert known[2] > 1 / 2.5


@pytest.mark.slow
def test_flips_of_a_models_own_deviations_gave_twenty_times_as_much() -> None:
    _, before = nulls(DATA[0], "spread × 0.5", 2)
    assert np.mean(before) > 15 * calibrated(DATA[0], 10)[0]


def test_nothing_is_said_of_calibration_where_it_can_not_be_computed() -> None:
    for _, _, now, remark in degenerate_rows(3):
        assert "(p: none)" in now
        assert remark


def test_few_hypotheses_have_no_coverage_that_they_can_not_show() -> None:
    rows = {row[0]: row[1:3] for row in few_rows(50)}
    assert rows == {
        "2": ("0.70", "not reported"),
        "5": ("0.40", "not reported"),
        "8": ("0.10", "not reported"),
        **dict.fromkeys(("9", "20", "200"), ("0.00", "0.00")),
    }


@pytest.mark.slow
@pytest.mark.parametrize(("n", "M", "K"), [(50, 300, 1), (20, 60, 3), (20, 40, 16), (50, 1200, 60)])
def test_floors_are_those_of_a_long_simulation_to_two_digits(n: int, M: int, K: int) -> None:
    """Four standard errors of the quantiles of 4000 and of at least 1488 test sets, and 2 % of the normal curves."""
    mean, high = simulated_floor(n, M, K, 4000)
    floor, deviation = perfect_sampler(n, M, K), (high - mean) / 1.645
    error = 4 * deviation * np.sqrt(1 / 4000 + 1 / 1488)
    assert abs(floor.mean - mean) < error + 0.02 * mean
    assert abs(floor.high - high) < 2.2 * error + 0.02 * high
