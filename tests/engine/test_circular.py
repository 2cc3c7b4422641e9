"""Angles: the shorter way round, circular means, and unwrapping about them."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.engine.circular import circular_mean, unwrapped, wrapped


def test_the_shorter_way_round_is_at_most_half_a_period() -> None:
    given = np.array([0.0, 179, 181, -181, 359, 540.5, -1000])
    np.testing.assert_allclose(wrapped(given, 360), [0, 179, -179, 179, -1, -179.5, 80])


def test_hypotheses_are_unwrapped_about_their_circular_mean() -> None:
    given = np.array([[170.0, -170.0, 178.0], [-10, 350, 0]])
    centred = unwrapped(given, 360)
    np.testing.assert_allclose(np.ptp(centred, axis=1), [20, 10], atol=1e-9)
    np.testing.assert_allclose(wrapped(centred - given, 360), 0, atol=1e-9)
    assert np.abs(centred.mean(axis=1)).max() <= 180


def test_what_is_unwrapped_moves_by_whole_turns_only() -> None:
    given = np.array([[0.1 + 360, 0.1, 0.3]])
    assert unwrapped(given, 360).tolist() == [[0.1 + 360 - 360, 0.1, 0.3]]
    assert unwrapped(np.array([[360.0, 0, 720]]), 360).tolist() == [[0.0, 0, 0]]


@pytest.mark.parametrize("period", [360.0, 24.0])
def test_the_mean_is_the_direction_of_the_sum_of_unit_vectors(period: float) -> None:
    given = np.random.default_rng(0).uniform(-900, 900, (4, 7))
    weights = np.random.default_rng(1).random((4, 7))
    vectors = np.exp(2j * np.pi * given / period)
    expected = np.angle(vectors.mean(axis=1)) * period / (2 * np.pi)
    np.testing.assert_allclose(circular_mean(given, period), expected)
    weighted = np.angle((weights * vectors).sum(axis=1)) * period / (2 * np.pi)
    np.testing.assert_allclose(circular_mean(given, period, weights), weighted)


def test_single_precision_stays_single() -> None:
    given = np.array([[350.0, 20]], dtype=np.float32)
    for found in (wrapped(given, 360), unwrapped(given, 360), circular_mean(given, 360)):
        assert found.dtype == np.float32
    np.testing.assert_allclose(unwrapped(given, 360), [[-10, 20]], atol=1e-4)
