"""Mean distances between the points of a set, against loops over all pairs."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from posecal.geometry.distances import STRIP, half_mean_arcs, half_mean_distances, on_circle


@pytest.mark.parametrize("n", [2, 3, STRIP - 1, STRIP, STRIP + 1, 2 * STRIP + 3])
def test_in_space_they_are_those_of_all_pairs(n: int) -> None:
    points = np.random.default_rng(n).normal(300, 40, (2, 3, 2, n))
    found = half_mean_distances(points)
    for b, s in np.ndindex(2, 3):
        pairs = [math.dist(i, j) for i, j in itertools.combinations(points[b, s].T, 2)]
        assert found[b, s] == pytest.approx(sum(pairs) / len(pairs) / 2)


@pytest.mark.parametrize("n", [2, 3, 4, 9, 50])
@pytest.mark.parametrize("spread", [5.0, 100.0, 1000.0])
def test_on_a_circle_they_are_arcs(n: int, spread: float) -> None:
    points = np.random.default_rng(n).normal(170, spread, (2, 3, n))
    found = half_mean_arcs(points, 360)
    for b, k in np.ndindex(2, 3):
        pairs = [abs((i - j + 180) % 360 - 180) for i, j in itertools.combinations(points[b, k], 2)]
        assert found[b, k] == pytest.approx(sum(pairs) / len(pairs) / 2)


def test_points_that_coincide_or_lie_opposite() -> None:
    points = np.array([[0.0, 0, 360], [0, 180, 0], [90, -90, 270]])
    np.testing.assert_allclose(half_mean_arcs(points, 360), [0, 60, 60])


def test_places_on_a_circle_are_a_chord_from_the_point_of_nought() -> None:
    angles = np.array([[[0.0, 60, 180, -90]]])  # (K, D, N)
    placed = on_circle(angles, 360)
    radius = 180 / math.pi
    assert placed.shape == (1, 2, 4)
    np.testing.assert_allclose(np.linalg.norm(placed[0], axis=0), radius * np.array([0, 1, 2, math.sqrt(2)]))
    np.testing.assert_allclose(np.linalg.norm(placed[0] + np.array([[0], [radius]]), axis=0), radius)
