"""minMPJPE against the number of hypotheses, against all subsets of them."""

from __future__ import annotations

from fractions import Fraction
from math import comb

import numpy as np
import pytest

from posecal.errors import PoseDataError
from posecal.metrics import min_mpjpe, min_mpjpe_curve, mpjpe
from posecal.metrics.best_of import ROUND_SIZES, curve_sizes, subset_weights
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 6, 11, 5


@pytest.mark.parametrize("n_all", [1, 2, 7, 200])
def test_the_weights_are_ratios_of_binomials(n_all: int) -> None:
    sizes = sorted({1, min(2, n_all), (n_all + 1) // 2, n_all})
    expected = [[float(Fraction(comb(n_all - i, n - 1), comb(n_all, n))) for i in range(1, n_all + 1)] for n in sizes]
    np.testing.assert_allclose(subset_weights(n_all, sizes), expected, rtol=1e-11, atol=1e-300)


def test_the_weights_sum_to_one_at_ten_thousand() -> None:
    sizes = curve_sizes(10_000)
    # Logarithms of factorials reach 8e4; their rounding of 2**-53 becomes 1e-11 of each chance.
    np.testing.assert_allclose(subset_weights(10_000, sizes).sum(axis=1), 1, rtol=1e-10)


@pytest.mark.parametrize("n_all", [1, 3, 6])
def test_the_expected_best_is_the_mean_over_all_subsets(n_all: int) -> None:
    errors = np.sort(np.random.default_rng(0).gamma(2, 30, n_all))
    for n in range(1, n_all + 1):
        np.testing.assert_allclose(
            (subset_weights(n_all, [n]) @ errors).item(), oracles.best_of_subsets(list(errors), n)
        )


@pytest.mark.parametrize("n_all", [1, 2, 19, 200, 4096])
def test_the_curve_is_known_from_one_to_all_and_at_round_numbers(n_all: int) -> None:
    sizes = curve_sizes(n_all)
    assert sizes[0] == 1
    assert sizes[-1] == n_all
    assert (np.diff(sizes) > 0).all()
    assert {n for n in ROUND_SIZES if n <= n_all} <= set(sizes.tolist())
    assert len(sizes) <= 40 + len(ROUND_SIZES)


@pytest.mark.parametrize("power", [6, 12])
def test_the_curve_s_sizes_rise_at_equal_ratios(power: int) -> None:
    n_all, round_sizes = 2**power, {d * 10**k for d in (1, 2, 5) for k in range(3)} | {1000}
    assert set(curve_sizes(n_all, power + 1).tolist()) == {2**i for i in range(power + 1)} | {
        n for n in round_sizes if n <= n_all
    }


def test_the_curve_has_forty_sizes_beside_the_round_ones() -> None:
    sizes = set(curve_sizes(10**9).tolist())
    assert {round(10 ** (9 * i / 39)) for i in range(40)} <= sizes
    assert len(sizes - set(ROUND_SIZES)) == 40 - 4  # 1, 2, 5 and 1000 are round


# --- of arrays --------------------------------------------------------------------------------------------------------


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def where() -> Mask:
    """Some joints that count; in pose 4, none."""
    return mostly(M, K)


def test_the_curve_is_the_mean_over_all_subsets(arrays: tuple[Array, Array], where: Mask) -> None:
    sizes = [1, 2, 3, 4, 5, 6]
    found = min_mpjpe_curve(*arrays, sizes, where=where, align="similarity")
    e = oracles.pose_errors(oracles.aligned(*arrays, where, "similarity"), arrays[1], where)
    subsets = [[oracles.best_of_subsets(list(column), n) for n in sizes] for column in e.T]
    np.testing.assert_allclose(found, subsets, rtol=1e-9)


def test_the_curve_goes_from_the_mean_to_the_minimum(arrays: tuple[Array, Array]) -> None:
    found = min_mpjpe_curve(*arrays, np.array([N, 1]), root=0)
    np.testing.assert_allclose(found[:, 1], mpjpe(*arrays, root=0))
    np.testing.assert_allclose(found[:, 0], min_mpjpe(*arrays, root=0))


def test_the_curve_falls() -> None:
    x, y = skewed(7, 300, 4, 5)
    assert (np.diff(min_mpjpe_curve(x, y, np.arange(1, 301))) < 0).all()


@pytest.mark.parametrize("sizes", [[0, 1], [7], [1.5], [], 3, [[1, 2]], [True]])
def test_sizes_that_are_no_numbers_of_hypotheses_are_refused(arrays: tuple[Array, Array], sizes: object) -> None:
    with pytest.raises(PoseDataError, match=r"sizes: .*; expected whole numbers from 1 to N = 6\."):
        min_mpjpe_curve(*arrays, sizes)  # type: ignore[arg-type]
