"""Weighted scores against scoringrules' weighted ensembles, and weighted distances against plain loops."""

from inspect import signature

import numpy as np
import pytest
import scoringrules

from posecal.geometry.distances import STRIP, half_mean_arcs, half_mean_distances
from posecal.metrics import crps, energy_score

RANDOM = np.random.default_rng(0)
N, M, K = 12, 30, 4
X, Y = RANDOM.normal(0, 50, (N, M, K, 3)), RANDOM.normal(0, 50, (M, K, 3))
W = RANDOM.dirichlet(np.ones(N), M).T


@pytest.mark.skipif("ens_w" not in signature(scoringrules.es_ensemble).parameters, reason="an older scoringrules")
def test_the_part_of_the_spread_is_that_of_scoringrules_made_fair() -> None:
    """Theirs is not fair: its spread is over all pairs, of which Σ w² are no two draws."""
    x, y, w = X.reshape(N, M, -1).swapaxes(0, 1), Y.reshape(M, -1), W.T
    error = (w * np.linalg.norm(x - y[:, None], axis=2)).sum(axis=1)
    spread = error - scoringrules.es_ensemble(y, x, ens_w=w)
    found = energy_score(X, Y, weights=W, unit="mm", axes="NMKD")
    np.testing.assert_allclose(found, error - spread / (1 - (w**2).sum(axis=1)), rtol=1e-9)
    columns, every = x.swapaxes(1, 2), np.broadcast_to(w[:, None], (M, K * 3, N))
    error = (every * np.abs(columns - y[..., None])).sum(axis=2)
    spread = error - scoringrules.crps_ensemble(y, columns, ens_w=every, estimator="nrg")
    right = (error - spread / (1 - (w**2).sum(axis=1))[:, None]).mean(axis=1)
    np.testing.assert_allclose(crps(X, Y, weights=W, unit="mm", axes="NMKD"), right, rtol=1e-9)


@pytest.mark.parametrize("n", [2, 7, STRIP + 3])
def test_half_mean_distances_of_weighted_points(n: int) -> None:
    points, w = RANDOM.normal(0, 1, (3, 2, 4, n)), RANDOM.dirichlet(np.ones(n), 3)
    apart = np.linalg.norm(points[..., :, None] - points[..., None, :], axis=2)
    right = np.einsum("bsij,bi,bj->bs", apart, w, w) / 2 / (1 - (w**2).sum(axis=1))[:, None]
    np.testing.assert_allclose(half_mean_distances(points, w), right, rtol=1e-9)
    np.testing.assert_allclose(half_mean_distances(points, np.full((3, n), 1 / n)), half_mean_distances(points))


@pytest.mark.parametrize("n", [2, 5, 20])
def test_half_mean_arcs_of_weighted_points(n: int) -> None:
    points, w = RANDOM.uniform(-400, 400, (3, 2, n)), RANDOM.dirichlet(np.ones(n), 3)
    apart = np.abs(points[..., :, None] - points[..., None, :]) % 360
    right = np.einsum("bsij,bi,bj->bs", np.minimum(apart, 360 - apart), w, w) / 2 / (1 - (w**2).sum(axis=1))[:, None]
    np.testing.assert_allclose(half_mean_arcs(points, 360, w), right, rtol=1e-9)


def test_of_one_hypothesis_with_all_weight_there_is_no_fair_score() -> None:
    assert np.isnan(energy_score(X, Y, weights=np.eye(N)[:, :1] * np.ones(M), unit="mm", axes="NMKD")).all()
    almost = np.where(np.arange(N)[:, None] == 0, 1 - 1e-12, 1e-12 / (N - 1)) * np.ones((N, M))
    assert np.isnan(energy_score(X, Y, weights=almost, unit="mm", axes="NMKD")).all()  # rounding is no second one
