"""E ω(q) = q, exactly, for a perfect sampler of any distribution, at any N; the other two are off as tabulated.

Truth and hypotheses are drawn exchangeably; the truth is the last of N + 1 points. Every tolerance is five standard
errors of a mean of M independent weights in [0, 1] with the mean q: at most √(q (1 - q) / M) each. Of the some
2,000 comparisons of this file one in a thousand runs would fail by chance, and the seeds are fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from posecal.calibration import LEVELS, CalibrationCurve, calibration_curve
from posecal.calibration.ranks import nearness
from posecal.engine.block import Block

Array = npt.NDArray[np.floating]
Pool = Callable[[np.random.Generator, int, int, int], Array]

SIZES = (2, 3, 5, 10, 20, 50, 200)
BUDGET = 1_500_000
"""Coordinates drawn for one N and D."""


def gaussian(random: np.random.Generator, n: int, M: int, D: int) -> Array:
    return random.standard_normal((n, M, D))


def skewed(random: np.random.Generator, n: int, M: int, D: int) -> Array:
    """Heavy to one side, and axes that depend on each other."""
    common = random.standard_exponential((n, M, 1))
    return common * np.exp(random.standard_normal((n, M, D)))


def dependent(random: np.random.Generator, n: int, M: int, D: int) -> Array:
    """Points about a centre of their own with a width of their own: exchangeable, not independent."""
    return random.standard_gamma(0.5, (1, M, 1)) * random.standard_normal((n, M, D)) + random.normal(0, 9, (1, M, D))


def lattice(random: np.random.Generator, n: int, M: int, D: int) -> Array:
    """Whole numbers: many distances tie."""
    return random.poisson(1.5, (n, M, D)).astype(float)


def repeated(random: np.random.Generator, n: int, M: int, D: int) -> Array:
    """Each point is one of four, drawn anew for every pose: most stand there several times, the truth among them."""
    few = random.standard_normal((4, M, D))
    chosen = random.integers(0, 4, (n, M))
    return np.take_along_axis(few, chosen[..., None], axis=0)


POOLS: tuple[Pool, ...] = (gaussian, skewed, dependent, lattice, repeated)


@cache
def arrays(N: int, D: int) -> tuple[Array, Array]:
    """One joint for each distribution."""
    random = np.random.default_rng([N, D])
    M = BUDGET // (N * D * len(POOLS))
    points = np.stack([pool(random, N + 1, M, D) for pool in POOLS], axis=2)
    return points[:-1], points[-1]


def tolerance(mean: Array, M: int) -> Array:
    """Five standard errors."""
    return 5 * np.sqrt(mean * (1 - mean) / M)


@pytest.mark.slow
@pytest.mark.parametrize("D", [1, 2, 3])
@pytest.mark.parametrize("N", SIZES)
def test_the_exchangeable_curve_of_a_perfect_sampler_is_the_diagonal(N: int, D: int) -> None:
    x, y = arrays(N, D)
    found = calibration_curve(x, y).joints
    allowed = tolerance(LEVELS, len(y)) + 1e-12
    for pool, curve in zip(POOLS, found, strict=True):
        np.testing.assert_array_less(np.abs(curve - LEVELS), allowed + 1e-15, err_msg=pool.__name__)


@pytest.mark.parametrize("D", [1, 3])
@pytest.mark.parametrize("N", SIZES[:5])
def test_exchangeable_ranks_are_uniform(N: int, D: int) -> None:
    """A truth that ties with others has each of their ranks by an equal part."""
    x, y = arrays(N, D)
    near = nearness(Block(x, y))
    less, at_most = near.less, near.at_most[..., 0]
    ranks = np.arange(N + 1)
    mine = (less[..., None] <= ranks) & (ranks <= at_most[..., None])
    shares = (mine / mine.sum(axis=-1, keepdims=True)).mean(axis=0)
    uniform = np.full(N + 1, 1 / (N + 1))
    for pool, found in zip(POOLS, shares, strict=True):
        np.testing.assert_array_less(np.abs(found - uniform), tolerance(uniform, len(y)), err_msg=pool.__name__)


@pytest.mark.parametrize("definition", ["paper", "reference"])
@pytest.mark.parametrize("N", SIZES[:4])
def test_this_test_would_see_the_bias_of_the_other_definitions(N: int, definition: str) -> None:
    x, y = arrays(N, 3)
    found = calibration_curve(x, y, definition=definition).joints[0]  # type: ignore[arg-type]
    assert (np.abs(found - LEVELS) > tolerance(LEVELS, len(y)) + 1e-12).any()


@pytest.mark.parametrize("N", [2, 3, 7])
def test_hypotheses_and_truth_may_be_swapped_in_the_pool(N: int) -> None:
    """Over all N + 1 choices of the truth among the same points the weights average to q, exactly."""
    points = np.random.default_rng(N).normal(0, 100, (N + 1, 40, 4, 3))
    weights = []
    for truth in range(N + 1):
        others = np.delete(points, truth, axis=0)
        weights.append(calibration_curve(others, points[truth]).joints)
    np.testing.assert_allclose(np.mean(weights, axis=0), np.broadcast_to(LEVELS, (4, 21)), atol=1e-12)


@pytest.mark.parametrize("N", [4, 5])
def test_the_same_holds_exactly_where_points_tie(N: int) -> None:
    points = np.random.default_rng(N).integers(-1, 2, (N + 1, 60, 3, 2)).astype(float)
    weights = [calibration_curve(np.delete(points, t, axis=0), points[t]).joints for t in range(N + 1)]
    np.testing.assert_allclose(np.mean(weights, axis=0), np.broadcast_to(LEVELS, (3, 21)), atol=1e-12)


@pytest.mark.parametrize("N", [5, 20, 100])
@pytest.mark.parametrize(("width", "sign"), [(0.6, -1), (0.8, -1), (1.3, 1), (2.0, 1)])
def test_too_narrow_is_overconfident_and_too_wide_is_underconfident(N: int, width: float, sign: int) -> None:
    random = np.random.default_rng([N, int(10 * width)])
    M, K = 2000, 6
    y = random.standard_normal((M, K, 3))
    curve = calibration_curve(width * random.standard_normal((N, M, K, 3)), y)
    # The area is a mean over M poses of a number in [-1/2, 1/2], so its standard error is at most 1/(2 √M).
    assert (sign * curve.joint_signed_area() > 5 / (2 * np.sqrt(M))).all()
    assert sign * curve.signed_area() > 0
    assert curve.ece() > CalibrationCurve("exchangeable", LEVELS[None], LEVELS).ece()
