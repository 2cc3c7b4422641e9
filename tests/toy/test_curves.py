"""Closed-form calibration curves against those of one, two and three dimensions, and simulations."""

import math
from statistics import NormalDist

import numpy as np
import pytest

from posecal.errors import PoseDataError
from toy import curves

Q = curves.LEVELS
INNER = slice(1, -1)


def test_a_right_sampler_lies_on_the_diagonal_in_every_dimension() -> None:
    for D in (1, 2, 3, 45):
        np.testing.assert_allclose(curves.coverage(D=D), Q, atol=1e-12)
        assert curves.ece(D=D) < 1e-12


def test_a_wrong_spread_in_one_dimension_is_a_normal_of_a_normal() -> None:
    # |x| ≤ Φ⁻¹((1+q)/2) σ for a share q, and the truth lies within r for a share 2Φ(r/σ*) − 1
    normal = NormalDist()
    expected = [2 * normal.cdf(0.4 * normal.inv_cdf((1 + q) / 2)) - 1 for q in Q[INNER]]
    np.testing.assert_allclose(curves.coverage(spread=0.4, D=1)[INNER], expected, rtol=1e-9)


def test_a_wrong_spread_in_two_dimensions_is_a_power() -> None:
    # F(r²) = 1 − exp(−r²/2), so ω = 1 − (1 − q)^(s²)
    np.testing.assert_allclose(curves.coverage(spread=1.5, D=2), 1 - (1 - Q) ** 2.25, rtol=1e-9)


def test_a_wrong_mean_in_one_dimension_is_a_difference_of_normals() -> None:
    normal = NormalDist()
    radius = [1.3 * normal.inv_cdf((1 + q) / 2) for q in Q[INNER]]
    expected = [normal.cdf(r - 0.8) - normal.cdf(-r - 0.8) for r in radius]
    np.testing.assert_allclose(curves.coverage(spread=1.3, offset=0.8, D=1)[INNER], expected, rtol=1e-9)


def test_a_truth_on_a_line_in_a_plane_is_an_error_function() -> None:
    # The model's radius: r² = −2 ln(1 − q). A share erf(r/√2) of a one-dimensional truth lies within.
    expected = [math.erf(math.sqrt(-math.log(1 - q))) for q in Q[INNER]]
    np.testing.assert_allclose(curves.coverage(D=2, truth_D=1)[INNER], expected, rtol=1e-9)


def test_spread_offset_and_dimension_together_agree_with_draws() -> None:
    rng = np.random.default_rng(0)
    wrong = {"spread": 1.4, "offset": 0.9, "D": 3, "truth_D": 2}
    truth = rng.normal([0.9, 0], 1, (200_000, 2))
    # The model's quantiles by rank of a large sample: 200,000 draws of each, so √2 the error of one share
    model = np.sort(1.4 * np.linalg.norm(rng.standard_normal((200_000, 3)), axis=1))
    drawn = np.searchsorted(np.sort(np.linalg.norm(truth, axis=1)), model[(Q[INNER] * 200_000).astype(int)]) / 200_000
    exact = curves.coverage(**wrong)[INNER]
    slope = np.gradient(exact, Q[INNER])
    error = np.sqrt((exact * (1 - exact) + slope**2 * Q[INNER] * (1 - Q[INNER])) / 200_000)
    np.testing.assert_array_less(np.abs(drawn - exact), 4.5 * error)


def test_overconfident_curves_lie_below_the_diagonal_and_underconfident_ones_above() -> None:
    for D in (1, 3, 10):
        assert (curves.coverage(spread=0.7, D=D)[INNER] < Q[INNER]).all()
        assert (curves.coverage(spread=1.4, D=D)[INNER] > Q[INNER]).all()


def test_a_collapsed_model_has_the_largest_ece_of_21_levels() -> None:
    np.testing.assert_array_equal(curves.coverage(spread=0.0), [0.0] * 20 + [1.0])
    np.testing.assert_allclose(curves.ece(spread=0.0), 9.5 / 21)


def test_a_shift_and_a_wider_spread_cancel() -> None:
    # E‖y‖² = 3 + 1.2² = 4.44 and E‖x‖² = 3 · 1.23² = 4.54: the distances are all but alike
    assert curves.ece(spread=1.23, offset=1.2) < 0.007
    assert curves.ece(offset=1.2) > 0.12


@pytest.mark.slow
def test_few_hypotheses_bend_the_curve_as_the_expansion_says() -> None:
    # One dimension, the median of N and its ranks drawn: 1.2 million poses, N = 30
    rng = np.random.default_rng(0)
    N, spread, M = 30, 0.6, 200_000
    counts = np.zeros(Q.size)
    for _ in range(6):
        truth = rng.standard_normal(M)
        pool = np.sort(np.concatenate([spread * rng.standard_normal((N, M)), truth[None]]), axis=0)
        distance = np.abs(pool - pool[N // 2])
        less = (distance < np.abs(truth - pool[N // 2])).sum(axis=0)
        counts += np.clip((N + 1) * Q[:, None] - less, 0, 1).sum(axis=1)
    drawn, error = counts / (6 * M), 0.5 / math.sqrt(6 * M)
    exact, first = curves.coverage(spread=spread, D=1), curves.coverage_of(N, spread=spread, D=1)
    assert np.abs(drawn - exact).max() > 0.02
    np.testing.assert_array_less(np.abs(drawn - first), 4.5 * error + 0.1 * np.abs(first - exact))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"spread": -1.0}, r"spread -1.0 and offset 0.0: expected ratios, 0 or more"),
        ({"offset": math.inf}, r"offset inf"),
        ({"D": 2, "truth_D": 3}, r"truth_D = 3 of D = 2 coordinates; expected 1 to D"),
        ({"levels": [0.5, 1.5]}, r"levels: 0.5 to 1.5; expected shares between 0 and 1"),
    ],
)
def test_refuses_what_is_no_curve(wrong: dict[str, float], words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        curves.coverage(**wrong)  # type: ignore[arg-type]
