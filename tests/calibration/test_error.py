"""Are the numbers that are read off a curve the ones that the loops read, and those that were published?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import numpy as np
import numpy.typing as npt
import pytest

from posecal.calibration import (
    LEVELS,
    OVER_JOINTS,
    CalibrationCurve,
    OverJoints,
    coverage_at,
    ece,
    joint_ece,
    signed_area,
)
from posecal.calibration.entries import curve_of, summary
from posecal.errors import PoseDataError
from tests.helpers import oracles

Array = npt.NDArray[np.floating]

NEVER, ALWAYS = np.zeros(21), np.ones(21)


@pytest.fixture
def curve() -> CalibrationCurve:
    """Five joints, of which one never counts."""
    random = np.random.default_rng(0)
    coverage = np.sort(random.random((5, 21)), axis=1)
    coverage[2] = np.nan
    return CalibrationCurve("exchangeable", coverage, np.sort(random.random(21)))


# --- against the loops -----------------------------------------------------------------------------------------------


def test_the_ece_of_a_joint_is_its_mean_distance_from_the_diagonal(curve: CalibrationCurve) -> None:
    np.testing.assert_allclose(joint_ece(curve.coverage), [oracles.curve_ece(row) for row in curve.coverage])


@pytest.mark.parametrize("over", OVER_JOINTS)
def test_the_ece_over_joints_is_the_summary_s(curve: CalibrationCurve, over: OverJoints) -> None:
    np.testing.assert_allclose(ece(curve, over), oracles.ece(curve.coverage, curve.pooled, over))


@pytest.mark.parametrize("over", OVER_JOINTS)
def test_the_summary_curve_is_the_loops(curve: CalibrationCurve, over: OverJoints) -> None:
    mean = np.concatenate([curve.coverage, curve.pooled[None]])
    np.testing.assert_allclose(summary(mean, over), oracles.over_joints(curve.coverage, curve.pooled, over))
    np.testing.assert_array_equal(curve_of(mean, "paper").coverage, curve.coverage)
    np.testing.assert_array_equal(curve_of(mean, "paper").pooled, curve.pooled)


def test_the_ece_is_of_the_median_unless_it_is_said(curve: CalibrationCurve) -> None:
    assert ece(curve) == ece(curve, "median")


def test_the_signed_area_is_the_trapezoid(curve: CalibrationCurve) -> None:
    np.testing.assert_allclose(signed_area(curve.coverage), [oracles.curve_area(row) for row in curve.coverage])


@pytest.mark.parametrize("level", [0, 0.5, 0.8, 0.9, 0.95, 1.0, 0.33, 0.999, 1e-3])
def test_coverage_at_a_level_is_interpolated(curve: CalibrationCurve, level: float) -> None:
    expected = [np.interp(level, LEVELS, row) for row in curve.coverage]
    np.testing.assert_allclose(coverage_at(curve.coverage, level), expected)


# --- extremes --------------------------------------------------------------------------------------------------------


def test_the_diagonal_has_no_error() -> None:
    assert joint_ece(LEVELS) == 0
    np.testing.assert_allclose(signed_area(LEVELS), 0, atol=1e-15)


@pytest.mark.parametrize(("coverage", "area"), [(NEVER, -0.5), (ALWAYS, 0.5)])
def test_the_largest_error_is_one_half(coverage: Array, area: float) -> None:
    np.testing.assert_allclose(joint_ece(coverage), 0.5)
    np.testing.assert_allclose(signed_area(coverage), area)


def test_below_the_diagonal_is_overconfident_and_negative() -> None:
    # ∫ q² - q = 1/3 - 1/2, and the trapezoid over 20 steps of a parabola adds 1/(6 · 20²).
    np.testing.assert_allclose(signed_area(LEVELS**2), 1 / 3 - 1 / 2 + 1 / 2400)


def test_joints_that_err_in_opposite_ways_cancel_in_the_median_and_not_in_the_mean() -> None:
    coverage = np.stack([LEVELS - 0.5 * LEVELS * (1 - LEVELS), LEVELS + 0.5 * LEVELS * (1 - LEVELS)])
    found = CalibrationCurve("exchangeable", coverage, LEVELS)
    np.testing.assert_allclose(ece(found), 0, atol=1e-15)
    # the mean of q (1 - q) over 21 levels is 133/840 = 19/120
    np.testing.assert_allclose([ece(found, "mean"), ece(found, "worst")], 0.5 * 19 / 120)


@pytest.mark.parametrize("over", OVER_JOINTS)
def test_where_nothing_counts_there_is_no_number(over: OverJoints) -> None:
    nothing = CalibrationCurve("paper", np.full((3, 21), np.nan), np.full(21, np.nan))
    assert np.isnan(ece(nothing, over))
    assert np.isnan(summary(np.full((4, 21), np.nan), over)).all()


# --- published numbers -----------------------------------------------------------------------------------------------


PUBLISHED = json.loads((Path(__file__).parents[1] / "fixtures" / "published_calibration_curves.json").read_text())[
    "curves"
]


@pytest.mark.parametrize(
    ("model", "number"),
    [
        ("Sharma et al.", 0.3588),
        ("Wehrbein et al.", 0.1785),
        ("Wehrbein et al., occluded joints", 0.2586),
        ("cGNF", 0.0825),
        ("cGNF, shipped array", 0.0627),
    ],
)
def test_published_curves_have_their_published_ece(model: str, number: float) -> None:
    median = np.array(PUBLISHED[model])
    found = ece(CalibrationCurve("reference", median[None], median))
    np.testing.assert_allclose(found, number, atol=5e-5)
    np.testing.assert_allclose(found, np.mean([abs(w - i / 20) for i, w in enumerate(PUBLISHED[model])]))


@pytest.mark.parametrize(("model", "table"), [("Sharma et al.", 0.36), ("Wehrbein et al.", 0.18), ("cGNF", 0.08)])
def test_published_ece_round_to_the_paper_s_table(model: str, table: float) -> None:
    assert round(float(joint_ece(np.array(PUBLISHED[model]))), 2) == table


def test_all_published_models_are_overconfident() -> None:
    assert all(signed_area(np.array(curve)) < 0 for curve in PUBLISHED.values())


# --- words -----------------------------------------------------------------------------------------------------------


def test_the_summaries_are_those_of_the_type() -> None:
    assert get_args(OverJoints) == OVER_JOINTS


def test_an_unknown_summary_is_refused_with_the_nearest(curve: CalibrationCurve) -> None:
    with pytest.raises(PoseDataError, match=r"over: 'medain' is not known\. Did you mean median\?"):
        ece(curve, "medain")  # type: ignore[arg-type]


@pytest.mark.parametrize("level", [-0.01, 1.01, float("nan")])
def test_a_level_is_a_share(level: float) -> None:
    with pytest.raises(PoseDataError, match=r"level: .*; expected a share from 0 to 1\."):
        coverage_at(LEVELS, level)
