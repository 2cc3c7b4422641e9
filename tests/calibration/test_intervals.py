"""Coverage and width of central intervals: the exact share that a perfect sampler shows, and plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest

import posecal
from posecal.calibration import interval_coverage, interval_width
from posecal.calibration.intervals import attained, ends
from posecal.errors import PoseDataError
from tests.helpers import calibration_oracles, oracles
from tests.helpers.random_worlds import skewed


def pool(n: int, poses: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Hypotheses and truth that can be exchanged, from a skewed distribution."""
    points = np.random.default_rng(n).gamma(1.5, 40, (n + 1, poses, 1, 1))
    return points[1:], points[0]


@pytest.mark.parametrize(
    ("n", "level", "share"), [(50, 0.9, 0.9), (19, 0.9, 0.9), (18, 0.9, 17 / 19), (10, 0.9, 9 / 11)]
)
def test_a_perfect_sampler_shows_the_level_or_what_n_hypotheses_span(n: int, level: float, share: float) -> None:
    assert attained(n, level) == pytest.approx(share)
    found = interval_coverage(*pool(n), level=level)
    assert found.mean() == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / len(found)))


@pytest.mark.parametrize("n", [2, 3, 7, 10, 19, 20, 21, 50, 200])
@pytest.mark.parametrize("level", [0.5, 0.8, 0.9])
def test_the_shares_of_all_ranks_average_to_the_level_exactly(n: int, level: float) -> None:
    x = np.arange(1.0, n + 1).reshape(n, 1, 1, 1) * np.ones((1, n + 1, 1, 1))
    y = np.arange(n + 1).reshape(n + 1, 1, 1) + 0.5
    assert interval_coverage(x, y, level=level, axes="NMKD", unit="none").mean() == pytest.approx(attained(n, level))


@pytest.mark.parametrize("n", [2, 9, 10, 19, 50, 199])
@pytest.mark.parametrize("level", [0.25, 0.5, 0.9])
def test_widths_are_those_of_weibulls_quantiles(n: int, level: float) -> None:
    x, y = pool(n, 30)
    low, high = np.quantile(x, [(1 - level) / 2, (1 + level) / 2], axis=0, method="weibull")
    np.testing.assert_allclose(interval_width(x, y, level=level), (high - low)[:, 0, 0], rtol=1e-12)
    found = ends(np.sort(x, axis=0)[:, :, 0, 0].T, level)
    np.testing.assert_allclose(found, (low[:, 0, 0], high[:, 0, 0]), rtol=1e-12)


@pytest.mark.parametrize("level", [0.5, 0.9])
def test_they_are_what_the_naive_formulas_give_with_ties_and_masks(level: float) -> None:
    x, y = (np.round(array / 60) for array in skewed(3, 21, 9, 4))
    where = np.random.default_rng(3).random(y.shape[:2]) < 0.7
    where[4] = False
    percent = round(100 * level)
    held = calibration_oracles.over_axes(x, y, lambda values, truth: calibration_oracles.held(values, truth, percent))
    width = calibration_oracles.over_axes(
        x, y, lambda values, _: float(np.ptp(calibration_oracles.interval(values, percent)))
    )
    for function, values in ((interval_coverage, held), (interval_width, width)):
        expected = [oracles.mean(list(row[kept])) for row, kept in zip(values, where, strict=True)]
        np.testing.assert_allclose(function(x, y, level=level, where=where, unit="mm"), expected, atol=1e-12)


def test_where_the_ranks_are_whole_it_is_whether_the_truth_lies_between_two_hypotheses() -> None:
    x, y = pool(59, 500)  # 3 and 57
    rising = np.sort(x, axis=0)
    inside = (rising[2] < y) & (y < rising[56])
    np.testing.assert_allclose(interval_coverage(x, y), inside[:, 0, 0], atol=1e-12)


@pytest.mark.parametrize("level", [0, 1, -0.5, 90, None, "a"])
def test_a_level_is_a_share(level: object) -> None:
    for function in (interval_coverage, interval_width):
        with pytest.raises(PoseDataError, match=r"level: .*above 0 and below 1"):
            function(*pool(9, 5), level=level)  # type: ignore[arg-type]


# --- in a report --------------------------------------------------------------------------------------------------


def test_a_report_of_one_coordinate_shows_intervals_in_place_of_balls() -> None:
    x, y = pool(50, 120)
    labels = {"sequence": np.repeat(np.arange(12), 10).astype(str)}
    report = posecal.evaluate(x, y, unit="deg", labels=labels, by=["sequence"])
    text = report.render("text", joints=True)
    for name, row in (
        ("interval_coverage_90", "coverage of the 90 % interval"),
        ("interval_width_90", "width of the 90"),
    ):
        assert name in report.headline_metrics
        assert row in text
        assert not np.isnan(report.interval(name)).any()
    assert "coverage at 90 %" not in text
    assert "radius" not in text
    assert report["radius_90"] > 0
    assert 0 < report["coverage_90"] < 1
    assert report.metrics["interval_width_90"].unit == "deg"
    assert "90\N{NO-BREAK SPACE}% intervals hold" in report.summary[0]


def test_a_report_of_three_coordinates_has_them_only_by_name() -> None:
    x, y = skewed(1, 20, 12, 4)
    report = posecal.evaluate(x, y, unit="mm")
    assert "interval_coverage_90" not in report.metrics
    named = posecal.evaluate(x, y, unit="mm", metrics="interval_coverage_90, interval_width_50")
    assert named["interval_coverage_90"] == pytest.approx(interval_coverage(x, y, unit="mm").mean())
    assert "then over axes and the 4 joints" in named.metrics["interval_width_50"].definition


def test_ten_hypotheses_say_what_their_widest_interval_holds() -> None:
    x, y = pool(10, 60)
    report = posecal.evaluate(x, y, unit="deg", metrics="interval_coverage_90, interval_coverage_50, interval_width_90")
    assert report.metrics["interval_coverage_90"].brief == "a perfect sampler's holds 0.818"
    assert "from the least to the largest of the N=10" in report.metrics["interval_coverage_90"].definition
    assert report.metrics["interval_width_90"].brief == "all N=10, a perfect sampler's holds 0.818"
    assert report.metrics["interval_coverage_50"].brief == "a perfect sampler's holds 0.5"
    assert "0.25 (N + 1) and 0.75 (N + 1)" in report.metrics["interval_coverage_50"].definition
    assert report["interval_width_90"] == pytest.approx(np.ptp(x % 360, axis=0).mean(), rel=0.2)
