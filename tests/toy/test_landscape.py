"""The surfaces of Figure 1d against direct formulas, and the paper's conclusions from them."""

import math
from statistics import NormalDist

import numpy as np
import pytest
from scipy import special

from toy.landscape import Landscape, landscape, valley_spread

N = 10


@pytest.fixture(scope="module")
def paper() -> Landscape:
    return landscape(np.linspace(-2, 2, 40), np.linspace(3, 7, 40), N=N)


@pytest.mark.slow
def test_min_mpjpe_is_the_double_integral(paper: Landscape) -> None:
    # Trapezoids over the truth x and the distance r, with P(|x̂ − x| > r) from the normal distribution function
    column, row = 30, 12
    mu, sigma = paper.mu[column], paper.sigma[row]
    x, r = np.linspace(-30, 30, 601), np.linspace(0, 40, 20_001)
    inner = []
    for point in x:
        farther = 1 - special.ndtr((point - mu + r) / sigma) + special.ndtr((point - mu - r) / sigma)
        inner.append(np.trapezoid(farther**N, r))
    density = np.exp(-(x**2) / 32) / (4 * math.sqrt(2 * math.pi))
    expected = np.trapezoid(density * np.array(inner), x)
    np.testing.assert_allclose(paper.min_mpjpe[row, column], expected, rtol=1e-5)


@pytest.mark.slow
def test_ece_is_the_mean_gap_of_21_levels(paper: Landscape) -> None:
    column, row, normal = 5, 25, NormalDist(0, 4)
    mu, sigma = paper.mu[column], paper.sigma[row]
    gaps = [0.0, 0.0]  # the levels 0 and 1
    for i in range(1, 20):
        radius = sigma * NormalDist().inv_cdf((1 + i / 20) / 2)
        gaps.append(abs(normal.cdf(mu + radius) - normal.cdf(mu - radius) - i / 20))
    np.testing.assert_allclose(paper.ece[row, column], sum(gaps) / 21, rtol=1e-9)


@pytest.mark.slow
def test_both_surfaces_are_even_in_the_mean(paper: Landscape) -> None:
    np.testing.assert_allclose(paper.min_mpjpe, paper.min_mpjpe[:, ::-1], rtol=1e-10)
    np.testing.assert_allclose(paper.ece, paper.ece[:, ::-1], rtol=1e-10)


def test_min_mpjpe_finds_the_mean_and_misses_the_spread(paper: Landscape) -> None:
    step = paper.mu[1] - paper.mu[0]
    mu, sigma = paper.lowest_min_mpjpe
    assert abs(mu) < step
    assert sigma - 4 > 4 * step


def test_ece_has_a_valley_with_one_spread_for_every_mean(paper: Landscape) -> None:
    lowest = paper.sigma[paper.ece.argmin(axis=0)]
    step = paper.sigma[1] - paper.sigma[0]
    np.testing.assert_array_less(np.abs(lowest - paper.valley), step)
    assert paper.valley_ece.max() < 0.002


def test_lowest_min_mpjpe_along_the_valley_is_the_truth(paper: Landscape) -> None:
    mu, sigma = paper.lowest_in_valley
    assert abs(mu) < paper.mu[1] - paper.mu[0]
    assert abs(sigma - 4) < paper.sigma[1] - paper.sigma[0]


def test_valley_is_a_minimum_of_the_ece() -> None:
    found = valley_spread(1.5)
    at = landscape([1.5], [found - 0.02, found, found + 0.02]).ece[:, 0]
    assert at.argmin() == 1


def test_follows_the_truth_wherever_it_is() -> None:
    moved = landscape([9, 10, 11], [1.5, 2, 2.5], truth_mu=10, truth_sigma=2)
    assert moved.lowest_in_valley[0] == 10
    np.testing.assert_allclose(moved.lowest_in_valley[1], 2, rtol=1e-4)
