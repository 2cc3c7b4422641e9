"""Is the step from N errors to one, and to the expected best of n, what the subsets say?"""

from __future__ import annotations

from fractions import Fraction
from math import comb

import numpy as np
import pytest

from posecal.metrics.best_of import OF_ERRORS, ROUND_SIZES, OfErrors, best_of, curve_sizes, subset_weights
from tests.helpers import oracles


@pytest.mark.parametrize("of", OF_ERRORS)
@pytest.mark.parametrize("n", [1, 2, 5])
def test_n_errors_become_one(of: OfErrors, n: int) -> None:
    errors = np.random.default_rng(n).gamma(2, 30, (4, 3, n))
    found = best_of(errors, of)
    for place in np.ndindex(4, 3):
        np.testing.assert_allclose(found[place], oracles.of_errors(list(errors[place]), of))


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
            (subset_weights(n_all, [n]) @ errors).entry(), oracles.best_of_subsets(list(errors), n)
        )


@pytest.mark.parametrize("n_all", [1, 2, 19, 200, 4096])
def test_the_curve_is_known_from_one_to_all_and_at_round_numbers(n_all: int) -> None:
    sizes = curve_sizes(n_all)
    assert sizes[0] == 1
    assert sizes[-1] == n_all
    assert (np.diff(sizes) > 0).all()
    assert {n for n in ROUND_SIZES if n <= n_all} <= set(sizes.tolist())
    assert len(sizes) <= 40 + len(ROUND_SIZES)
