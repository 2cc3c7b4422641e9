"""Tests and comparisons of weighted hypotheses: none where weights move the numbers of a calibrated model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.stats.uncertainty import joint_p_values
from tests.helpers.samplers import gaussian

Array = np.ndarray[Any, Any]
N, M, K = 8, 400, 3
X, Y = gaussian(0, N, M, K)
LABELS = {"sequence": np.repeat(np.arange(20), 20).astype(str)}


def data_of(weights: Array | None, x: Array = X) -> posecal.PoseData:
    return posecal.PoseData(x, Y, unit="mm", axes="NMKD", root_joint="none", weights=weights, labels=LABELS)


def weights_of(concentration: float, n: int = N) -> Array:
    return np.random.default_rng(0).dirichlet(np.full(n, concentration), M).T


def compared(**models: posecal.PoseData) -> Any:
    return posecal.compare(models, metrics="default, scores, rank_tests", threads=1)


def test_calibrated_hypotheses_of_a_small_effective_number_are_not_called_miscalibrated() -> None:
    """Their ECE is above that of the same hypotheses without weights by more than chance would do."""
    report = posecal.evaluate(data_of(weights_of(0.5)), metrics="default, rank_tests", threads=1)
    assert report["effective_hypotheses"] < 4
    assert report["ece"] > 0.02
    assert [line.partition(":")[0] for line in report.summary] == ["Not judged"]
    assert math.isnan(report["ece_p"]) and math.isnan(report["ece_null_95"])
    assert all(math.isnan(test.p) and math.isnan(p) for test, p in report.rank_tests().values())
    assert np.isnan(joint_p_values(report.totals, report.metrics["ece"])).all()
    assert any("up to about 0.6 / effective N" in remark for remark in report.remarks)


def test_a_large_effective_number_is_tested() -> None:
    x = gaussian(0, 60, M, K)[0]
    report = posecal.evaluate(data_of(weights_of(4.0, 60), x), metrics="default", threads=1)
    assert report["effective_hypotheses"] > 20
    assert report.test("ece").p > 0
    assert not any("0.6 /" in remark for remark in report.remarks)


def test_a_comparison_of_few_weighted_hypotheses_names_none_better_but_by_accuracy() -> None:
    """Hypotheses of twice the spread would be worse beyond chance in ECE and scores; errors stay compared."""
    wide = X.mean(axis=0) + 2 * (X - X.mean(axis=0))
    plain = compared(right=data_of(None), wide=data_of(None, wide))
    found = compared(right=data_of(weights_of(0.5)), wide=data_of(None, wide))
    assert not any("no p-values of calibration" in remark for remark in plain.remarks)
    assert [
        remark for remark in found.remarks if remark.startswith("no p-values of calibration, rank tests and scores")
    ]
    for name in ("ece", "energy_score", "crps"):
        (difference,) = found.differences_of(name)
        assert plain.differences_of(name)[0].better == "right"
        assert math.isnan(difference.p) and math.isnan(difference.p_adjusted) and difference.better is None
        assert found.rank(name, "wide") == 1
    assert found.differences_of("mpjpe")[0].better == "right"
    with pytest.raises(PoseDataError, match="weighted hypotheses of so small an effective N; expected at least 20"):
        found.calibrated()


@pytest.mark.parametrize(("concentration", "is_tested"), [(100.0, True), (4.0, False)])
def test_effective_numbers_that_differ_by_a_tenth_are_not_compared(concentration: float, is_tested: bool) -> None:
    x = gaussian(0, 60, M, K)[0]
    found = compared(weighted=data_of(weights_of(concentration, 60), x), plain=data_of(None, 1.5 * x))
    assert all(posecal.Report(totals)["ece_p"] > 0 for totals in found.totals)
    assert math.isnan(found.differences_of("energy_score")[0].p) is not is_tested
    assert not math.isnan(found.differences_of("mpjpe")[0].p)
