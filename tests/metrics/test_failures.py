"""Failures: the AUROC against loops, without each sequence in turn, and in reports."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal import Protocol, evaluate
from posecal.errors import PoseDataError
from posecal.metrics import failure_auroc
from posecal.metrics.failures import failure_auroc_without
from tests.helpers import score_oracles
from tests.stats.test_orders import lengths, recomputed

auroc, auroc_without = partial(failure_auroc, threshold=3.0), partial(failure_auroc_without, threshold=3.0)
poses = st.lists(st.tuples(st.integers(0, 5), st.integers(1, 5), st.integers(0, 3)), min_size=1, max_size=25)


@given(rows=poses)
def test_with_ties_the_auroc_is_that_of_loops_with_and_without_a_sequence(rows: list[tuple[int, int, int]]) -> None:
    spread, error, sequence = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    sequence = np.unique(sequence, return_inverse=True)[1]
    np.testing.assert_allclose(auroc(spread, error), score_oracles.failure_auroc(spread, error, 3.0))
    expected = recomputed(auroc, spread, error, sequence)
    np.testing.assert_allclose(auroc_without(spread, error, sequence), expected, atol=1e-12)


def test_the_auroc_without_a_sequence_is_that_of_the_other_poses() -> None:
    for seed in range(20):
        random = np.random.default_rng(seed)
        S = int(random.integers(2, 14))
        sequence = lengths(random, int(random.integers(S + 1, 900)), S)
        spread = random.gamma(2, 2, len(sequence)) * random.lognormal(0, 1, S)[sequence]
        error = spread * np.abs(random.normal(1, 0.6, len(sequence)))
        expected = recomputed(auroc, spread, error, sequence)
        np.testing.assert_allclose(auroc_without(spread, error, sequence), expected, rtol=1e-10)


def test_equal_spreads_count_half_and_poses_without_a_number_do_not_count() -> None:
    assert failure_auroc(np.ones(4), [1, 2, 3, 10], 5.0) == 0.5
    assert failure_auroc([1.0, 2, math.nan, 4, 3], [2.0, 5, 900, 200, math.nan]) == 1


def test_a_pose_at_the_threshold_is_no_failure() -> None:
    assert math.isnan(failure_auroc([1, 2], [150, 150]))
    assert failure_auroc([1, 2], [150, 150.1]) == 1
    assert failure_auroc([2, 1], [150, 150.1]) == 0


@pytest.mark.parametrize("error", [[10, 20], [200, 300]])
def test_without_failures_or_without_successes_there_is_no_auroc(error: list[float]) -> None:
    assert math.isnan(failure_auroc([1, 2], error))


@pytest.mark.parametrize("threshold", [0, -1, math.nan, math.inf])
def test_a_threshold_is_a_length(threshold: float) -> None:
    with pytest.raises(PoseDataError, match=r"^threshold: .*; expected a length above 0"):
        failure_auroc([1, 2], [10, 200], threshold)


def test_with_no_failure_the_report_says_so_by_the_rate() -> None:
    random = np.random.default_rng(1)
    y = random.normal(0, 300, (20, 4, 3))
    report = evaluate(y + random.normal(0, 5, (6, 20, 4, 3)), y, unit="mm")
    assert math.isnan(report["failure_auroc"])
    assert np.isnan(report.interval("failure_auroc")).all()
    assert report["failure_rate"] == 0


def test_the_rate_and_the_auroc_are_of_the_threshold_of_the_protocol() -> None:
    random = np.random.default_rng(4)
    y = random.normal(0, 300, (60, 4, 3))
    x = y + random.gamma(2, 1, (60, 1, 1)) * random.normal(0, 40, (9, 60, 4, 3)) + 30
    error, spread = np.linalg.norm(x.mean(axis=0) - y, axis=-1).mean(axis=-1), x.std(axis=0, ddof=1).mean(axis=(1, 2))
    labels = {"sequence": np.repeat(np.arange(6), 10)}
    for threshold in (60.0, 75.0):
        report = evaluate(x, y, unit="mm", labels=labels, protocol=Protocol(failure_threshold=threshold))
        assert report["failure_rate"] == pytest.approx((error > threshold).mean())
        assert report["failure_auroc"] == pytest.approx(failure_auroc(spread, error, threshold))
        assert f"error above {threshold:g} mm" in report.definition("failure_auroc")
        shares = [(error > threshold)[np.arange(60) // 10 != s].mean() for s in range(6)]
        low, high = report.interval("failure_rate")
        assert low < min(shares) <= report["failure_rate"] <= max(shares) < high


@pytest.mark.parametrize("unit", ["deg", "px"])
def test_other_units_have_failures_above_a_threshold_of_their_own(unit: str) -> None:
    random = np.random.default_rng(5)
    x, y = random.normal(0, 10, (6, 20, 4, 1)), random.normal(0, 10, (20, 4, 1))
    assert "failure_auroc" not in evaluate(x, y, unit=unit).metrics
    report = evaluate(x, y, unit=unit, protocol=Protocol(failure_threshold=8))
    assert 0 < report["failure_rate"] < 1
    assert f"error above 8 {unit}" in report.definition("failure_rate")
