"""Tests and comparisons of weighted hypotheses: none where weights move the numbers of a calibrated model."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.metric import Deviation
from posecal.errors import PoseDataError
from posecal.stats.resampling import sign_flips, sign_flips_of_each
from posecal.stats.uncertainty import BIAS, joint_p_values
from tests.evidence.weights import importance_draws
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
    assert math.isnan(report["ece_p"])
    assert math.isnan(report["ece_null_95"])
    assert all(math.isnan(test.p) and math.isnan(p) for test, p in report.rank_tests().values())
    assert np.isnan(joint_p_values(report.totals, report.metrics["ece"])).all()
    assert any("up to about 0.6 / effective N" in remark for remark in report.remarks)


def test_a_large_effective_number_is_tested() -> None:
    x = gaussian(0, 60, M, K)[0]
    report = posecal.evaluate(data_of(weights_of(4.0, 60), x), metrics="default", threads=1)
    assert report["effective_hypotheses"] > 20
    assert 0.05 < report.test("ece").p <= 1
    assert not any("0.6 /" in remark for remark in report.remarks)


def proposal(width: float, spread: float, seed: int = 0) -> posecal.Report:
    """2,000 poses of draws of a proposal so many times as wide as what the weights turn them to, and of its spread."""
    x, y, w = importance_draws(seed, 60, 2000, width)
    centre = x.mean(axis=0)
    labels = {"sequence": np.arange(2000) // 50}
    return posecal.evaluate(
        centre + spread * (x - centre),
        y,
        weights=w,
        unit="mm",
        axes="NMKD",
        root_joint="none",
        labels=labels,
        metrics="default, rank_tests",
        threads=1,
    )


def test_what_weights_add_to_the_ece_of_a_calibrated_model_is_not_taken_for_an_error() -> None:
    """Without the allowance p of the ECE is below 0.05 in about half of such data sets."""
    for seed in range(2):
        report = proposal(1.4, 1.0, seed)
        assert 20 < report["effective_hypotheses"] < 40
        assert report["ece"] < BIAS / report["effective_hypotheses"]
        assert report["ece_p"] == 1
        assert BIAS / report["effective_hypotheses"] < report["ece_null_95"] != report["ece"]
        assert "chance and unequal weights give" in report.summary[0]
        assert min(p for _, p in report.rank_tests().values()) > 0.05
        assert not any("beyond chance" in line or line.startswith("Yet") for line in report.summary)


def test_a_wrong_spread_of_weighted_hypotheses_is_found_all_the_same() -> None:
    report = proposal(1.4, 0.7)
    assert report["ece_p"] < 0.01
    assert report.summary[0].startswith("Overconfident, beyond chance")
    assert all(p < 0.05 for _, p in report.joint_tests().values())


def test_an_allowance_counts_sign_patterns_that_come_within_it() -> None:
    deviations = np.random.default_rng(0).normal(0.1, 0.3, (8, 2, 21))
    counts = np.ones((8, 2), dtype=int)
    signs = np.array(list(itertools.product([1], *[[1, -1]] * 7)))
    means = np.einsum("bs,sjq->bjq", signs, deviations) / 8
    errors = np.abs(np.median(means, axis=1)).mean(axis=1)
    of_each = np.abs(means).mean(axis=2)
    for slack in (0.0, 0.02, 0.05):
        test = sign_flips(deviations, counts, Deviation(over="median"), slack=slack)
        assert test.p == pytest.approx((errors >= errors[0] - slack - 1e-9).mean())
        assert test.observed == pytest.approx(errors[0], rel=1e-5)
        alone = sign_flips_of_each(deviations, counts, slack=slack)
        np.testing.assert_allclose(alone, (of_each >= of_each[0] - slack - 1e-9).mean(axis=0))


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
        assert math.isnan(difference.p)
        assert math.isnan(difference.p_adjusted)
        assert difference.better is None
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


# --- levels that no ball resolves ----------------------------------------------------------------------------------


def carriers(n: int, others: float) -> tuple[Array, Array]:
    """Hypotheses of which the first three have all weight, or all but that of the others, and their weights."""
    x = gaussian(0, n, M, K)[0]
    weights = np.full((n, M), others)
    weights[:3] = 1 / 3
    return x, weights / weights.sum(axis=0)


@pytest.mark.parametrize("others", [0.0, 1e-6])
def test_coverage_is_not_known_where_those_with_a_weight_are_too_few(others: float) -> None:
    """Three of 40: balls of 90 % can't be told from larger ones, as of three without weights."""
    x, weights = carriers(40, others)
    report = posecal.evaluate(data_of(weights, x), metrics="default", threads=1)
    plain = posecal.evaluate(data_of(None, x[:3]), metrics="default", threads=1)
    for percent in (80, 90, 95):
        assert math.isnan(report[f"coverage_{percent}"])
        assert math.isnan(plain[f"coverage_{percent}"])
    assert not math.isnan(report["coverage_50"])
    assert math.isnan(report.calibration().coverage(0.9))
    assert "N=3 hypotheses" in report.definition("coverage_90")
    assert any("no ball holds 80, 90 or 95 % of them" in remark for remark in report.remarks)
    curve = posecal.calibration_curve(x, Y, weights=weights, unit="mm", axes="NMKD")
    assert math.isnan(curve.coverage(0.9))
    assert not math.isnan(curve.coverage(0.5))


def test_more_hypotheses_of_no_weight_change_no_coverage() -> None:
    weights = np.random.default_rng(1).dirichlet(np.ones(12), M).T
    values = []
    for more in (0, 30):
        x = np.concatenate([gaussian(0, 12, M, K)[0], np.full((more, M, K, 3), np.nan)])
        padded = np.concatenate([weights, np.zeros((more, M))])
        report = posecal.evaluate(data_of(padded, x), metrics="default", threads=1)
        values.append([report[f"coverage_{percent}"] for percent in (50, 80, 90, 95)])
    np.testing.assert_allclose(*values)


def test_a_comparison_knows_the_coverages_that_all_its_models_know() -> None:
    x, weights = carriers(40, 0.0)
    found = compared(plain=data_of(None, x), weighted=data_of(weights, x))
    assert all(math.isnan(found.value("coverage_90", name)) for name in ("plain", "weighted"))
    assert not math.isnan(found.value("coverage_50", "plain"))
