"""Proper scores against an independent library, and where they are at their edges."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scoringrules as sr

from posecal.engine.block import Block
from posecal.errors import PoseDataError
from posecal.geometry.distances import STRIP
from posecal.metrics import brier_score, crps, energy_score, variogram_score
from posecal.metrics.proper import joint_crps, joint_energies, variograms
from tests.helpers.random_worlds import skewed

Array = np.ndarray
SCORES: dict[str, Callable[..., Array]] = {
    "energy": energy_score,
    "crps": crps,
    "variogram": variogram_score,
    "brier": brier_score,
}
AGREE = {"rtol": 1e-6, "atol": 1e-9}


def flat(x: Array, y: Array) -> tuple[Array, Array]:
    """As the other library wants them: observations (M, KD) and ensembles (M, N, KD)."""
    return y.reshape(len(y), -1), x.swapaxes(0, 1).reshape(len(y), len(x), -1)


# --- an independent implementation ------------------------------------------------------------------------------------


@pytest.mark.parametrize("N", [2, 3, STRIP - 1, STRIP, STRIP + 1, 2 * STRIP + 7])
def test_the_energy_score_is_scoringrules(N: int) -> None:
    x, y = skewed(1, N, 5, 4)
    obs, ensemble = flat(x, y)
    np.testing.assert_allclose(
        energy_score(x, y), sr.es_ensemble(obs, ensemble, estimator="fair", backend="numpy"), **AGREE
    )


@pytest.mark.parametrize("N", [2, 9, STRIP + 3])
def test_the_energy_score_of_each_joint_is_scoringrules(N: int) -> None:
    x, y = skewed(2, N, 5, 3)
    found = joint_energies(Block(x, y))[:, :-1]
    for k in range(3):
        obs, ensemble = flat(x[:, :, [k]], y[:, [k]])
        expected = sr.es_ensemble(obs, ensemble, estimator="fair", backend="numpy")
        np.testing.assert_allclose(found[:, k], expected, **AGREE)


@pytest.mark.parametrize("N", [2, 5, 30])
def test_the_crps_is_scoringrules(N: int) -> None:
    x, y = skewed(3, N, 6, 4)
    expected = sr.crps_ensemble(y, np.moveaxis(x, 0, -1), estimator="fair", backend="numpy")
    np.testing.assert_allclose(crps(x, y), expected.mean(axis=(1, 2)), **AGREE)


@pytest.mark.parametrize("N", [2, 5, 30])
def test_the_variogram_score_on_a_line_is_scoringrules(N: int) -> None:
    # On a line the distance of two joints is the difference of two numbers, as there. The library sums over ordered
    # pairs and takes the mean over members of (√d(y) - √d(x))² minus half the mean over different members of
    # (√d(x) - √d(x'))², which is the variance: together (√d(y) - mean)² + (1 - 1/N) s² - s², ours.
    K = 5
    x, y = skewed(4, N, 6, K, D=1)
    obs, ensemble = flat(x, y)
    expected = sr.vs_ensemble(obs, ensemble, p=0.5, estimator="fair", backend="numpy") / (K * (K - 1))
    np.testing.assert_allclose(variogram_score(x, y), expected, **AGREE)


@pytest.mark.parametrize("name", SCORES)
def test_single_precision_agrees_to_a_millionth_of_the_size(name: str) -> None:
    x, y = skewed(5, 60, 8, 4)
    x, y = x.astype("f4"), y.astype("f4")
    score = SCORES[name]
    found, expected = score(x, y), score(x.astype("f8"), y.astype("f8"))
    size = 1.0 if name == "brier" else np.abs(x - y).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * size)


# --- what fair and proper mean ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["energy", "crps", "variogram"])  # the Brier score's event is about their median
def test_scores_do_not_depend_on_the_number_of_hypotheses_but_for_chance(name: str) -> None:
    M = 800
    means, errors = [], []
    for N in (2, 12):
        random = np.random.default_rng(N)
        y = random.normal(0, 60, (M, 3, 2))
        x = random.normal(10, 80, (N, M, 3, 2))
        found = SCORES[name](x, y)
        means.append(found.mean())
        errors.append(found.std() / np.sqrt(M))
    assert abs(means[0] - means[1]) < 4 * np.hypot(*errors)


@pytest.mark.parametrize("name", ["energy", "crps"])
@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_a_sampler_of_a_wrong_spread_scores_worse(name: str, factor: float) -> None:
    random = np.random.default_rng(7)
    y, x = random.normal(0, 50, (400, 4, 3)), random.normal(0, 50, (20, 400, 4, 3))
    differences = SCORES[name](factor * x, y) - SCORES[name](x, y)
    assert differences.mean() > 4 * differences.std() / np.sqrt(len(differences))


def test_the_energy_score_of_a_perfect_sampler_is_half_the_mean_distance_of_two_samples() -> None:
    random = np.random.default_rng(8)
    y, x = random.normal(0, 50, (800, 2, 3)), random.normal(0, 50, (10, 800, 2, 3))
    found = energy_score(x, y)
    # ‖x - x'‖ of two draws in 6 dimensions: 50 √2 times the mean of χ₆, √2 Γ(3.5) / Γ(3) = 2.350
    half = 50 * np.sqrt(2) * 2.3499640 / 2
    assert abs(found.mean() - half) < 4 * found.std() / np.sqrt(len(found))


# --- edges ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["energy", "crps", "variogram"])
def test_hypotheses_that_all_agree_have_the_score_of_their_error(name: str) -> None:
    x, y = skewed(9, 1, 6, 4)
    same = np.repeat(x, 7, axis=0)
    if name == "energy":
        expected = np.sqrt(((x[0] - y) ** 2).sum(axis=(1, 2)))
    elif name == "crps":
        expected = np.abs(x[0] - y).mean(axis=(1, 2))
    else:
        pairs = [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)]
        roots = [[np.sqrt(np.linalg.norm(p[:, k] - p[:, j], axis=-1)) for k, j in pairs] for p in (x[0], y)]
        expected = ((np.array(roots[0]) - np.array(roots[1])) ** 2).mean(axis=0)
    np.testing.assert_allclose(SCORES[name](same, y), expected, rtol=1e-9)


def test_a_constant_far_from_the_origin_costs_no_precision() -> None:
    x, y = skewed(10, 60, 5, 4)
    far = np.float32(1e5)
    for name in ("energy", "crps"):
        near = SCORES[name](x.astype("f4"), y.astype("f4"))
        moved = SCORES[name](x.astype("f4") + far, y.astype("f4") + far)
        np.testing.assert_allclose(moved, near, rtol=1e-3)  # coordinates of 1e5 are known to 0.004 mm


@pytest.mark.parametrize("name", SCORES)
def test_joints_that_do_not_count_change_nothing_and_a_pose_without_any_has_no_score(name: str) -> None:
    x, y = skewed(11, 6, 4, 5)
    where = np.random.default_rng(0).random((4, 5)) < 0.7
    where[0], where[1, :3] = False, True
    found = SCORES[name](x, y, where=where)
    assert np.isnan(found[0])
    for m in range(1, 4):
        alone = SCORES[name](x[:, [m]][:, :, where[m]], y[[m]][:, where[m]])
        np.testing.assert_allclose(found[m], alone[0], rtol=1e-9)


def test_a_variogram_needs_two_joints() -> None:
    x, y = skewed(12, 4, 3, 1)
    assert np.isnan(variogram_score(x, y)).all()


@pytest.mark.parametrize("name", SCORES)
def test_the_root_is_subtracted_where_it_is_asked_for(name: str) -> None:
    x, y = skewed(13, 5, 6, 4)
    relative = SCORES[name](x - x[:, :, [1]], y - y[:, [1]])
    np.testing.assert_allclose(SCORES[name](x, y, root=1), relative, rtol=1e-9)


@pytest.mark.parametrize("name", SCORES)
def test_one_hypothesis_has_no_fair_score(name: str) -> None:
    x, y = skewed(14, 1, 5, 4)
    with pytest.raises(PoseDataError, match=r"hypotheses: N = 1; fair scores need at least [23]"):
        SCORES[name](x, y)


def test_of_one_hypothesis_a_block_s_scores_are_not_numbers() -> None:
    block = Block(*skewed(14, 1, 5, 4))
    for found, shape in ((joint_energies(block), (5, 5)), (joint_crps(block), (5, 4)), (variograms(block), (5,))):
        assert found.shape == shape
        assert np.isnan(found).all()


@pytest.mark.parametrize("name", ["energy", "crps", "variogram"])  # the Brier score needs three
def test_of_two_hypotheses_every_score_is_a_number(name: str) -> None:
    assert np.isfinite(SCORES[name](*skewed(14, 2, 5, 4))).all()


@pytest.mark.parametrize("name", ["energy", "crps", "variogram"])
@pytest.mark.parametrize("absent", [0, 1, 3])
def test_a_joint_that_does_not_count_is_as_if_it_were_not_there(name: str, absent: int) -> None:
    x, y = skewed(9, 7, 6, 5)
    where = np.ones((6, 5), dtype=bool)
    where[:, absent] = False
    others = np.delete(x, absent, axis=2), np.delete(y, absent, axis=1)
    np.testing.assert_allclose(SCORES[name](x, y, where=where), SCORES[name](*others), **AGREE)


def test_one_pair_of_joints_has_its_own_variogram() -> None:
    """Distances of 4 in both hypotheses and of 1 in the truth: (√4 - √1)²."""
    x, y = np.zeros((2, 3, 2, 3)), np.zeros((3, 2, 3))
    x[:, :, 1, 0], y[:, 1, 0] = 4, 1
    x[1] += 1
    np.testing.assert_allclose(variogram_score(x, y, unit="mm", axes="NMKD"), 1, rtol=1e-6)
