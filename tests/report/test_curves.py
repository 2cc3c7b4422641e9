"""Curves of a report: those of its sums, summarized as the protocol says."""

from __future__ import annotations

import numpy as np
import pytest

import posecal
from posecal.calibration import LEVELS, calibration_curve
from posecal.demo import sample
from posecal.errors import PoseDataError
from tests.helpers.reports import N, report_of, world


def test_the_calibration_curves_are_those_of_the_arrays() -> None:
    here = world()
    sitting = here.action == "sitting"
    arrays = sample(here, N)[:, sitting], here.truth[sitting]
    expected = calibration_curve(*arrays, definition="paper", root=0, axes="NMKD")
    curves = report_of(by=("action",)).calibration("paper", "action=sitting")
    np.testing.assert_allclose(curves.joints[1:], expected.joints[1:], atol=1e-12)
    assert curves.definition == "paper"


@pytest.mark.parametrize("over", ["median", "mean", "worst", "pooled"])
def test_the_summary_curve_is_what_the_ece_is_made_of(over: str) -> None:
    here = world()
    report = posecal.evaluate(
        sample(here, 5),
        here.truth,
        joints="h36m-17",
        protocol=posecal.Protocol(ece_over=over),  # type: ignore[arg-type]
        axes="NMKD",
        unit="mm",
    )
    curve = report.summary_curve()
    np.testing.assert_array_equal(curve, report.calibration().summary(over))  # type: ignore[arg-type]
    if over != "mean":
        np.testing.assert_allclose(np.abs(curve - LEVELS).mean(), report["ece"])


def test_a_curve_comes_with_where_it_is_known() -> None:
    curve, values = report_of().curve("errors_by_n")
    assert curve.at[0] == 1
    assert curve.at[-1] == N
    np.testing.assert_allclose(values[[0, -1]], [report_of()["mpjpe"], report_of()["min_mpjpe"]])


def test_a_curve_that_was_not_evaluated_is_refused() -> None:
    with pytest.raises(PoseDataError, match=r"^curve: the report has no pck_curve; it is among the default metrics\.$"):
        report_of(metrics="mpjpe").curve("pck_curve")


def test_rank_curves_are_one_or_one_per_coordinate() -> None:
    report = report_of(metrics="rank_tests")
    assert report.rank_curves("tarp").shape == (1, LEVELS.size)
    assert report.rank_curves("coordinate_pit").shape == (16 * 3, LEVELS.size)
    gaps = np.abs(report.rank_curves("coordinate_pit") - LEVELS).mean(axis=1)
    np.testing.assert_allclose(gaps.mean(), report["coordinate_pit"])


def test_sparsification_begins_with_the_mean_error_of_all() -> None:
    by_spread, by_error = report_of().sparsification()
    assert by_spread[0] == by_error[0] == 1
    np.testing.assert_allclose((by_spread - by_error).mean(), report_of()["ause"])


def test_risk_coverage_ends_with_the_mean_error_of_all() -> None:
    report = report_of()
    coverage, by_spread, by_error = report.risk_coverage()
    assert coverage[-1] == 1
    np.testing.assert_allclose([by_spread[-1], by_error[-1]], report["mean_pose_mpjpe"], rtol=1e-6)
    np.testing.assert_allclose(by_spread.mean(), report["aurc"])
    np.testing.assert_allclose((by_spread - by_error).mean(), report["excess_aurc"])


def test_the_reliability_of_the_event_is_that_of_the_brier_score() -> None:
    report = report_of(metrics="scores")
    reliability = report.event_reliability()
    assert (np.diff(reliability.observed) >= 0).all()
    assert ((reliability.predicted >= 0) & (reliability.predicted <= 1)).all()
    np.testing.assert_allclose(reliability.parts[0], report["brier_miscalibration"])
