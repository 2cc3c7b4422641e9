"""Gaussians of true poses from sums, and the constraints that true poses obey."""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import multivariate_normal

from posecal.engine.truth_moments import Constraints, constraints, gaussian_log_density, moments, own_log_density

Array = npt.NDArray[np.float64]
D = 4


def poses(seed: int = 0, m: int = 90) -> tuple[Array, Array]:
    """Correlated poses (M, d) far from 0, and the sequence of each."""
    random = np.random.default_rng(seed)
    return 500 + random.normal(0, 1, (m, D)) @ random.normal(0, 100, (D, D)), np.arange(m) % 7


def summed(x: Array, cells: Array) -> tuple[Array, Array]:
    """Sums of moments of cells, and their counts."""
    codes = np.unique(cells, return_inverse=True)[1]
    sums = np.zeros((codes.max() + 1, D + D * (D + 1) // 2))
    np.add.at(sums, codes, moments(x))
    return sums, np.bincount(codes)


def naive(x: Array, sequence: Array) -> Array:
    """Log density of each pose under the Gaussian of all other sequences, by SciPy."""
    found = np.empty(len(x))
    for m, own in enumerate(sequence):
        others = x[sequence != own]
        found[m] = multivariate_normal(others.mean(axis=0), np.cov(others.T)).logpdf(x[m])
    return found


def test_moments_are_coordinates_and_products_of_pairs() -> None:
    assert moments(np.array([[2.0, 3.0]])).tolist() == [[2, 3, 4, 6, 9]]


def test_each_pose_is_judged_by_the_gaussian_of_the_other_sequences() -> None:
    x, sequence = poses()
    found = gaussian_log_density(moments(x), np.ones(len(x)), sequence, D)
    np.testing.assert_allclose(found, naive(x, sequence), rtol=1e-9)


def test_sums_of_cells_are_the_sums_of_their_poses() -> None:
    x, sequence = poses(1)
    cells = sequence * 2 + np.arange(len(x)) // 50  # two of most sequences
    sums, counts = summed(x, cells)
    of_cell = np.unique(cells) // 2
    expected = np.bincount(np.unique(cells, return_inverse=True)[1], naive(x, sequence))
    np.testing.assert_allclose(gaussian_log_density(sums, counts, of_cell, D), expected, rtol=1e-9)


def test_too_few_other_poses_have_no_gaussian() -> None:
    x, _ = poses(2, D + 2)
    assert np.isfinite(gaussian_log_density(moments(x), np.ones(D + 2), np.arange(D + 2), D)).all()
    assert np.isnan(gaussian_log_density(moments(x[1:]), np.ones(D + 1), np.arange(D + 1), D)).all()
    assert np.isnan(gaussian_log_density(moments(x), np.ones(D + 2), np.zeros(D + 2, dtype=int), D)).all()


def test_poses_that_do_not_vary_in_a_direction_have_no_gaussian() -> None:
    x, sequence = poses(3)
    x[:, 3] = x[:, 0] - 2 * x[:, 1]
    assert np.isnan(gaussian_log_density(moments(x), np.ones(len(x)), sequence, D)).all()
    x[:, 3] += np.random.default_rng(0).normal(0, 0.5, len(x))
    assert np.isfinite(gaussian_log_density(moments(x), np.ones(len(x)), sequence, D)).all()
    assert np.isnan(gaussian_log_density(moments(x), np.ones(len(x)), sequence, D, deviation=0.6)).all()


def found_in(x: Array, sequence: Array, lengths: Array | None = None, deviation: float = 0.0) -> Constraints | None:
    of_bones = np.zeros((len(x), 0)) if lengths is None else lengths
    sums = np.stack([of_bones, of_bones**2], axis=1)
    return constraints(moments(x), sums, np.ones(len(x)), sequence, D, deviation)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_coordinates_that_follow_from_others_are_counted(number: int) -> None:
    x, sequence = poses(4)
    for column in range(number):
        x[:, column] = x[:, 2] + x[:, 3] if column else 7.0
    assert found_in(x, sequence) == Constraints(number, 0, D, 0)


def test_directions_that_vary_less_than_a_deviation_are_counted() -> None:
    x, sequence = poses(5)
    x[:, 1] = 3 + np.random.default_rng(1).normal(0, 0.08, len(x))
    assert found_in(x, sequence, deviation=0.1) == Constraints(1, 0, D, 0)
    assert found_in(x, sequence, deviation=0.05) == Constraints(0, 0, D, 0)


@pytest.mark.parametrize("far", [1e4, 1e6])
def test_poses_far_apart_hide_no_constraint_and_make_none(far: float) -> None:
    x, sequence = poses(9)
    apart = far * np.random.default_rng(3).choice([-1, 1], len(x))
    x[:, 0] += apart
    lengths = 300 + np.random.default_rng(4).normal(0, [0.01, 1.0], (len(x), 2))
    assert found_in(x, sequence, lengths, deviation=0.1) == Constraints(0, 1, D, 2)
    found = gaussian_log_density(moments(x), np.ones(len(x)), sequence, D, deviation=0.1)
    np.testing.assert_allclose(found, naive(x, sequence), rtol=1e-4)
    x[:, 3] = x[:, 0] + x[:, 1]
    assert found_in(x, sequence, lengths, deviation=0.1) == Constraints(1, 1, D, 2)


def test_bones_of_one_length_within_each_sequence_are_counted() -> None:
    x, sequence = poses(6)
    random = np.random.default_rng(2)
    rigid = np.stack([400.0 + sequence, 250.0 - 3 * sequence], axis=1)  # of persons of different sizes
    loose = 300 + random.normal(0, 2, (len(x), 1))
    lengths = np.concatenate([rigid, loose], axis=1)
    assert found_in(x, sequence, lengths, deviation=0.1) == Constraints(0, 2, D, 3)
    assert found_in(x, np.zeros_like(sequence), lengths, deviation=0.1) == Constraints(0, 0, D, 3)


def test_of_too_few_poses_nothing_is_known() -> None:
    x, sequence = poses(7)
    assert found_in(x[:D], sequence[:D]) is None
    assert found_in(x[: D + 1], sequence[: D + 1]) is not None


def test_under_their_own_gaussian_poses_have_its_negative_entropy() -> None:
    x, _ = poses(8)
    expected = multivariate_normal(x.mean(axis=0), np.cov(x.T, bias=True)).logpdf(x).mean()
    assert own_log_density(moments(x).sum(axis=0), len(x), D) == pytest.approx(expected)
