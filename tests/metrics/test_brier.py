"""The Brier score and its reliability, against loops and in cases that are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.engine.block import Block
from posecal.metrics import brier_score
from posecal.metrics.brier import brier_counts, fair_brier, reliability
from tests.helpers.random_worlds import skewed
from tests.helpers.score_oracles import isotonic, near_median


def test_the_brier_score_is_of_the_share_of_hypotheses_with_every_joint_near_the_median() -> None:
    x, y = skewed(15, 8, 40, 4)
    expected = []
    for m in range(40):
        inner, happened = near_median(x[:, m], y[m], 150)
        p = inner / 8
        expected.append((p - happened) ** 2 - p * (1 - p) / 7)
    assert len({round(value, 9) for value in expected}) > 5
    np.testing.assert_allclose(brier_score(x, y), expected, rtol=1e-9)


@pytest.mark.parametrize(("truth", "score"), [(150.0, 4 / 9 - 1 / 9), (0.0, 1 / 9 - 1 / 9), (300.0, 0.0)])
def test_a_joint_at_the_threshold_is_wrong(truth: float, score: float) -> None:
    """Hypotheses at 0, 150 and 300 mm: one of three lies within 150 mm of the median, p (1 - p) / (N - 1) = 1/9."""
    x = np.array([0.0, 150.0, 300.0]).reshape(3, 1, 1, 1)
    np.testing.assert_allclose(brier_score(x, np.full((1, 1, 1), truth)), score, atol=1e-15)


def test_of_two_hypotheses_there_is_a_score_and_of_one_there_is_none() -> None:
    x, y = np.array([0.0, 500.0]).reshape(2, 1, 1, 1), np.zeros((1, 1, 1))
    np.testing.assert_allclose(fair_brier(Block(x, y)), 0)  # none is near their median of 250, and it is wrong
    assert np.isnan(fair_brier(Block(x[:1], y)))


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
