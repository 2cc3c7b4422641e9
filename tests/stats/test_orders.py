"""Orders over poses without each sequence in turn: against the order of the poses that are left."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.metrics import uncertainty
from posecal.metrics.uncertainty import (
    ause,
    ause_without,
    rank_correlation,
    rank_correlation_without,
)
from posecal.stats.jackknife import jackknife

Array = np.ndarray
Number = Callable[[Array, Array], float]

PAIRS = {
    "rank correlation": (rank_correlation, rank_correlation_without),
    "AUSE": (ause, ause_without),
}


def recomputed(number: Number, spread: Array, error: Array, sequence: Array) -> Array:
    """The number of the poses that are left without each sequence."""
    left = [sequence != s for s in range(sequence.max() + 1)]
    return np.array([number(spread[rest], error[rest]) if rest.any() else math.nan for rest in left])


def lengths(random: np.random.Generator, M: int, S: int) -> Array:
    """Poses of S sequences in disorder, of which some are long and some short."""
    share = random.dirichlet(np.full(S, 1.5))
    return random.permutation(np.concatenate([np.arange(S), random.choice(S, M - S, p=share)]))


poses = st.lists(st.tuples(st.integers(0, 5), st.integers(1, 5), st.integers(0, 3)), min_size=1, max_size=25)


@pytest.mark.parametrize("kind", PAIRS)
@given(rows=poses)
def test_with_ties_an_order_without_a_sequence_is_that_of_the_other_poses(
    kind: str, rows: list[tuple[int, int, int]]
) -> None:
    spread, error, sequence = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    sequence = np.unique(sequence, return_inverse=True)[1]
    number, without = PAIRS[kind]
    expected = recomputed(number, spread, error, sequence)
    np.testing.assert_allclose(without(spread, error, sequence), expected, atol=1e-11)


@pytest.mark.parametrize("kind", PAIRS)
@pytest.mark.parametrize("levels", [None, 12], ids=["no ties", "ties"])
def test_an_order_without_a_sequence_is_that_of_the_other_poses(kind: str, levels: int | None) -> None:
    number, without = PAIRS[kind]
    for seed in range(30):
        random = np.random.default_rng(seed)
        S = int(random.integers(2, 14))
        sequence = lengths(random, int(random.integers(S + 1, 400)), S)
        spread = random.gamma(2, 20, len(sequence)) * random.lognormal(0, 1, S)[sequence]
        error = spread * np.abs(random.normal(1, 0.6, len(sequence)))
        if levels is not None:
            spread, error = (np.ceil(levels * values / values.max()) for values in (spread, error))
        expected = recomputed(number, spread, error, sequence)
        np.testing.assert_allclose(without(spread, error, sequence), expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("S", [10, 40])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("noise", "tolerance"), [(0.03, 0.05), (0.2, 0.01), (0.6, 0.01), (5.0, 0.01)])
def test_with_more_poses_than_classes_an_interval_is_nearly_as_wide(
    S: int, sign: int, noise: float, tolerance: float
) -> None:
    ratios = []
    for seed in range(4):
        random = np.random.default_rng(seed)
        sequence = lengths(random, 3000, S)
        spread = random.gamma(2, 20, 3000) * random.lognormal(0, 0.5, S)[sequence]
        error = spread**sign * random.lognormal(0, noise, 3000) * random.lognormal(0, noise / 3, S)[sequence]
        found = jackknife(0.5, rank_correlation_without(spread, error, sequence)).error
        ratios.append(found / jackknife(0.5, recomputed(rank_correlation, spread, error, sequence)).error)
    np.testing.assert_allclose(ratios, 1, rtol=tolerance)
    assert max(ratios) != min(ratios)
    assert len(sequence) > uncertainty.MAX_BINS


def test_values_in_single_precision_are_summed_in_double() -> None:
    random = np.random.default_rng(3)
    sequence = np.repeat(np.arange(20), 1000)
    spread, error = random.gamma(2, 20, (2, 20_000)).astype(np.float32)
    expected = recomputed(ause, spread, error, sequence)
    np.testing.assert_allclose(ause_without(spread, error, sequence), expected, rtol=1e-10)


@pytest.mark.parametrize("kind", PAIRS)
def test_no_number_where_nothing_is_left_or_all_are_alike(kind: str) -> None:
    _, without = PAIRS[kind]
    alike, one = np.ones(4), np.zeros(4, dtype=int)
    assert np.isnan(without(np.arange(4.0), np.arange(1, 5.0), one)).all()
    for seed in range(20):  # sums of the same numbers in another order, whose difference is not 0
        spread, error = np.random.default_rng(seed).gamma(2, 20, (2, 999))
        assert np.isnan(without(spread, error, np.zeros(999, dtype=int))).all()
    assert without(np.zeros(0), np.zeros(0), np.zeros(0, dtype=int)).shape == (0,)
    if kind == "rank correlation":
        assert np.isnan(without(alike, np.arange(4.0), np.arange(4))).all()
        assert np.isnan(without(np.array([1.0, 1, 1, 2]), np.arange(4.0), np.arange(4))).tolist() == [False] * 3 + [
            True
        ]
    else:
        assert np.isnan(without(np.arange(4.0), np.zeros(4), np.arange(4))).all()
