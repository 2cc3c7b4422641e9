"""Risk–coverage and failures: against loops, in closed form, and without each sequence in turn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal import Protocol, evaluate
from posecal.metrics import aurc, ause, excess_aurc, failure_auroc, risk_coverage
from posecal.metrics.risk_coverage import (
    MAX_PARTS,
    aurc_without,
    excess_aurc_without,
)
from posecal.stats.jackknife import jackknife
from tests.helpers import score_oracles
from tests.stats.test_orders import lengths, recomputed

Array = np.ndarray

PAIRS = {
    "AURC": (aurc, aurc_without),
    "excess AURC": (excess_aurc, excess_aurc_without),
}
values = st.lists(st.tuples(st.integers(0, 6), st.integers(1, 9)), min_size=1, max_size=30)
poses = st.lists(st.tuples(st.integers(0, 5), st.integers(1, 5), st.integers(0, 3)), min_size=1, max_size=25)


@given(values)
def test_the_numbers_are_those_of_loops(pairs: list[tuple[int, int]]) -> None:
    spread, error = np.array(pairs, dtype=float).T
    np.testing.assert_allclose(aurc(spread, error), score_oracles.aurc(spread, error))
    np.testing.assert_allclose(excess_aurc(spread, error), score_oracles.excess_aurc(spread, error), atol=1e-12)
    coverage, by_spread, by_error = risk_coverage(spread, error)
    assert coverage.tolist() == [n / len(pairs) for n in range(1, len(pairs) + 1)]
    np.testing.assert_allclose([by_spread[-1], by_error[-1]], error.mean())
    np.testing.assert_allclose(by_error, [np.sort(error)[:n].mean() for n in range(1, len(pairs) + 1)])


def test_equal_spreads_are_kept_in_random_order() -> None:
    """So a spread that is always the same leaves the mean error at every coverage, in whatever order poses come."""
    error = np.array([1.0, 2, 3, 10])
    assert risk_coverage(np.ones(4), error)[1].tolist() == [4, 4, 4, 4]
    assert aurc(np.ones(4), error) == aurc(np.ones(4), error[::-1]) == 4


def test_poses_without_a_number_are_left_out() -> None:
    spread, error = [1.0, 2.0, math.nan, 4.0, 3.0], [2.0, 5.0, 900.0, 200.0, math.nan]
    assert aurc(spread, error) == aurc([1, 2, 4], [2, 5, 200])
    assert math.isnan(aurc([math.nan], [1.0]))
    assert math.isnan(excess_aurc([], []))
    assert [len(part) for part in risk_coverage([], [])] == [0, 0, 0]


def test_ause_is_the_excess_area_in_mean_errors() -> None:
    """Both are of the same two curves; of 20 shares and of all they differ by the grid alone."""
    random = np.random.default_rng(2)
    spread = random.gamma(2, 20, 20_000)
    error = spread * random.lognormal(0, 0.8, 20_000)
    np.testing.assert_allclose(ause(spread, error) * error.mean(), excess_aurc(spread, error), rtol=0.03)


@pytest.mark.parametrize("kind", PAIRS)
@given(rows=poses)
def test_with_ties_a_number_without_a_sequence_is_that_of_the_other_poses(
    kind: str, rows: list[tuple[int, int, int]]
) -> None:
    spread, error, sequence = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    sequence = np.unique(sequence, return_inverse=True)[1]
    number, without = PAIRS[kind]
    expected = recomputed(number, spread, error, sequence)
    np.testing.assert_allclose(without(spread, error, sequence), expected, atol=1e-11)


@pytest.mark.parametrize("kind", PAIRS)
def test_a_number_without_a_sequence_is_that_of_the_other_poses(kind: str) -> None:
    number, without = PAIRS[kind]
    for seed in range(20):
        random = np.random.default_rng(seed)
        S = int(random.integers(2, 14))
        sequence = lengths(random, int(random.integers(S + 1, MAX_PARTS)), S)
        spread = random.gamma(2, 2, len(sequence)) * random.lognormal(0, 1, S)[sequence]
        error = spread * np.abs(random.normal(1, 0.6, len(sequence)))
        expected = recomputed(number, spread, error, sequence)
        np.testing.assert_allclose(without(spread, error, sequence), expected, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("S", [5, 40])
@pytest.mark.parametrize("kind", ["AURC", "excess AURC"])
def test_with_more_poses_than_parts_a_standard_error_is_nearly_the_same(kind: str, S: int) -> None:
    number, without = PAIRS[kind]
    ratios = []
    for seed in range(4):
        random = np.random.default_rng(seed)
        sequence = lengths(random, 3000, S)
        spread = random.gamma(2, 20, 3000) * random.lognormal(0, 0.5, S)[sequence]
        error = spread * random.lognormal(0, 0.6, 3000) * random.lognormal(0, 0.2, S)[sequence]
        found = jackknife(0.5, without(spread, error, sequence)).error
        ratios.append(found / jackknife(0.5, recomputed(number, spread, error, sequence)).error)
    np.testing.assert_allclose(ratios, 1, rtol=0.02)
    assert max(ratios) != min(ratios)


def test_a_report_has_the_numbers_of_its_single_pose() -> None:
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (60, 4, 3))
    x = y + random.gamma(2, 1, (60, 1, 1)) * (random.gamma(1, 30, (9, 60, 4, 3)) - 30)
    spread = x.std(axis=0, ddof=1).mean(axis=(1, 2))
    for pose in ("mean_pose", "median_pose"):
        centre = x.mean(axis=0) if pose == "mean_pose" else np.median(x, axis=0)
        error = np.linalg.norm(centre - y, axis=-1).mean(axis=-1)
        report = evaluate(x, y, unit="mm", protocol=Protocol(single_pose=pose, failure_threshold=25))
        np.testing.assert_allclose(report["aurc"], aurc(spread, error), rtol=1e-9)
        np.testing.assert_allclose(report["excess_aurc"], excess_aurc(spread, error), rtol=1e-9)
        np.testing.assert_allclose(report["failure_auroc"], failure_auroc(spread, error, 25), rtol=1e-9)
        assert 0 < report["failure_rate"] == (error > 25).mean() < 1
        assert "aurc" not in report.scalars()
        low, high = report.interval("failure_auroc")
        assert low < report["failure_auroc"] < high


def test_the_mode_is_the_hypothesis_of_the_highest_score_or_of_an_index() -> None:
    random = np.random.default_rng(3)
    y = random.normal(0, 300, (30, 4, 3))
    x, scores = y + random.normal(0, 40, (5, 30, 4, 3)), random.random((5, 30))
    spread = x.std(axis=0, ddof=1).mean(axis=(1, 2))
    for mode, index in (("score", scores.argmax(axis=0)), ("2", np.full(30, 2))):
        error = np.linalg.norm(x[index, np.arange(30)] - y, axis=-1).mean(axis=-1)
        report = evaluate(x, y, unit="mm", scores=scores, protocol=Protocol(single_pose="mode", mode=mode))
        np.testing.assert_allclose(report["aurc"], aurc(spread, error), rtol=1e-9)
