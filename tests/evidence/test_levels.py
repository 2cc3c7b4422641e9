"""Error rates of tests on perfect samplers whose frames are correlated, with few replicates."""

from __future__ import annotations

import pytest
from scipy import stats

from tests.evidence.levels import BAND, Design, rejection_rates


@pytest.fixture(scope="module")
def rates() -> dict[str, int]:
    return rejection_rates(Design(20, 100), 200, draws=500).rejected


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["sign-flips, ECE (median over joints)", "sign-flips, mean of the joints' ECEs", "sign-flips, worst joint", BAND],
)
def test_a_perfect_sampler_on_correlated_frames_is_rejected_3_to_7_percent_of_the_time(
    rates: dict[str, int], name: str
) -> None:
    low, high = stats.binom(200, 0.03).ppf(5e-4), stats.binom(200, 0.07).ppf(1 - 5e-4)
    assert low <= rates[name] <= high


@pytest.mark.slow
@pytest.mark.parametrize("test", ["Kolmogorov–Smirnov", "simultaneous ECDF envelope", "χ², 20 bins"])
def test_tests_that_assume_independent_frames_reject_it_80_percent_of_the_time(
    rates: dict[str, int], test: str
) -> None:
    assert rates[f"{test}, all joints"] >= stats.binom(200, 0.8).ppf(5e-4)


@pytest.mark.slow
def test_those_tests_keep_their_level_where_frames_are_independent() -> None:
    found = rejection_rates(Design(20, 20, frame_correlation=0.0, joint_correlation=0.0), 200, draws=20).rejected
    low, high = stats.binom(200, 0.05).interval(0.999)
    for test in ("Kolmogorov–Smirnov", "simultaneous ECDF envelope", "χ², 20 bins"):
        assert low <= found[f"{test}, one joint"] <= high


@pytest.mark.slow
def test_a_spread_that_is_a_tenth_too_narrow_is_found_more_often_with_more_sequences() -> None:
    few, many = (
        rejection_rates(Design(S, 20, spread=0.9), 60, independent=False, draws=500).rejected[
            "sign-flips, ECE (median over joints)"
        ]
        for S in (10, 60)
    )
    assert many > few
    assert many >= stats.binom(60, 0.7).ppf(5e-4)
