"""The Brier score and its reliability, against loops and in cases that are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal import evaluate
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from posecal.metrics import brier_score
from posecal.metrics.brier import brier_counts, fair_brier, reliability
from tests.helpers import score_oracles
from tests.helpers.random_worlds import skewed
from tests.helpers.score_oracles import isotonic, near_median


@pytest.mark.parametrize("N", [3, 4, 7, 8])
def test_the_probability_is_the_share_of_hypotheses_with_every_joint_near_the_median_of_the_others(N: int) -> None:
    x, y = skewed(15, N, 60, 4)
    expected = []
    for m in range(60):
        inner, happened = near_median(x[:, m], y[m], 150)
        p = inner / N
        expected.append((p - happened) ** 2 - p * (1 - p) / (N - 1))
    assert len({round(value, 9) for value in expected}) > (2 if N < 5 else 5)
    np.testing.assert_allclose(brier_score(x, y), expected, rtol=1e-9)


@pytest.mark.parametrize(("truth", "score"), [(100.0, 4 / 9 - 1 / 9), (-50.0, 1 / 9 - 1 / 9), (250.0, 0.0)])
def test_a_joint_at_the_threshold_is_wrong(truth: float, score: float) -> None:
    """Hypotheses at 0, 100 and 200 mm, at 150, 0 and 150 from the median of the others: p (1 - p) / (N - 1) = 1/9."""
    x = np.array([0.0, 100.0, 200.0]).reshape(3, 1, 1, 1)
    np.testing.assert_allclose(brier_score(x, np.full((1, 1, 1), truth)), score, atol=1e-15)


@pytest.mark.parametrize("N", [1, 2])
def test_of_fewer_than_three_hypotheses_there_is_no_score(N: int) -> None:
    x, y = np.zeros((N, 2, 1, 3)), np.zeros((2, 1, 3))
    assert np.isnan(fair_brier(Block(x, y))).all()
    with pytest.raises(PoseDataError, match=rf"^hypotheses: N = {N}; fair scores need at least 3"):
        brier_score(x, y, axes="NMKD")


def test_a_report_of_two_hypotheses_says_that_three_are_needed() -> None:
    x, y = skewed(18, 2, 9, 4)
    report = evaluate(x, y, unit="mm", metrics="scores")
    assert "brier" not in report.metrics
    assert any("brier" in remark and "at least 3 hypotheses" in remark for remark in report.remarks)
    with pytest.raises(PoseDataError, match=r"^metrics: brier needs at least 3 hypotheses"):
        evaluate(x, y, unit="mm", metrics="brier")


@pytest.mark.parametrize("N", [3, 4, 5, 6])
def test_equal_hypotheses_have_one_median_of_the_others(N: int) -> None:
    """With ties at the middle it does not matter which of the equal ones is left out."""
    x = np.random.default_rng(N).integers(0, 3, (N, 200, 2, 1)) * 120.0
    y = np.zeros((200, 2, 1))
    expected = [score_oracles.brier(*near_median(x[:, m], y[m], 150), N) for m in range(200)]
    np.testing.assert_allclose(brier_score(x, y), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("shift", [0.0, 70.0])
@pytest.mark.parametrize("N", [5, 9, 20])
def test_the_score_is_that_of_fresh_hypotheses_for_the_same_event(N: int, shift: float) -> None:
    random = np.random.default_rng(N)
    scale = random.lognormal(0, 0.6, (1500, 1, 1))
    y = scale * random.normal(0, 60, (1500, 4, 3)) + shift
    x, fresh = (scale * random.normal(0, 60, (n, 1500, 4, 3)) for n in (N, 60))
    difference = fair_brier(Block(x, y)) - fair_brier(Block(x, y), forecast=Block(fresh, y))
    assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(1500) + 0.01  # which the median of N - 1 may cost


def test_poses_are_counted_by_the_hypotheses_near_the_median_and_by_the_outcome() -> None:
    x, y = skewed(17, 6, 30, 4)
    where = np.random.default_rng(17).random((30, 4)) < 0.8
    joints = np.array([True, True, False, True])
    where[7] = ~joints  # no joint that counts
    table = brier_counts(Block(x, y, where), joints, 150.0)
    assert table.shape == (30, 7, 2)
    assert np.flatnonzero(np.isnan(table).all(axis=(1, 2))).tolist() == [7]
    outcomes = set()
    for m in set(range(30)) - {7}:
        scored = where[m] & joints
        inner, happened = near_median(x[:, m][:, scored], y[m, scored], 150)
        assert np.argwhere(table[m]).tolist() == [[inner, int(happened)]]
        assert table[m].sum() == 1
        outcomes.add((inner, happened))
    assert len(outcomes) > 4


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=2, max_size=9))
def test_reliability_pools_adjacent_violators(table: list[tuple[int, int]]) -> None:
    counts = np.array(table, dtype=float)
    found = reliability(counts)
    present = [row for row in range(len(table)) if sum(table[row])]
    if not present:
        assert np.isnan(found.parts).all()
        return
    weights = [float(sum(table[row])) for row in present]
    frequency = [table[row][1] / sum(table[row]) for row in present]
    np.testing.assert_allclose(found.observed, isotonic(frequency, weights), atol=1e-12)
    np.testing.assert_allclose(found.weight, np.array(weights) / sum(weights))


def test_the_parts_of_the_brier_score_sum_to_it() -> None:
    random = np.random.default_rng(16)
    counts = random.integers(1, 30, (11, 2)).astype(float)
    miscalibration, discrimination = reliability(counts).parts
    share, total = counts[:, 1].sum() / counts.sum(), counts.sum()
    p = np.arange(11) / 10
    score = (counts[:, 1] * (p - 1) ** 2 + counts[:, 0] * p**2).sum() / total
    np.testing.assert_allclose(miscalibration - discrimination + share * (1 - share), score, rtol=1e-12)
    assert miscalibration >= 0
    assert discrimination >= 0


def test_probabilities_that_are_right_have_no_miscalibration() -> None:
    counts = np.array([[8.0, 0], [6, 2], [4, 4], [2, 6], [0, 8]])  # the event happens in 0, 1/4, … of the poses
    miscalibration, discrimination = reliability(counts).parts
    assert miscalibration == pytest.approx(0, abs=1e-12)
    # variance of 0, 1/4, … 1: (4 + 1 + 0 + 1 + 4) / 16 / 5
    assert discrimination == pytest.approx(10 / 80)
