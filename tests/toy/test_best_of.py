"""Expected minMPJPE by quadrature against closed forms, an independent quadrature and simulation."""

import math

import numpy as np
import pytest
from scipy import stats

from posecal.errors import PoseDataError
from toy import best_of, collapse
from toy.nearest import expected_nearest, gauss_legendre, nearest_points


def trapezoid_min_mpjpe(sigma: float, N: int, D: int, truth_sigma: float) -> float:
    """Naive twin: trapezoids on a dense grid, and scipy.stats' (Boost's) noncentral chi-square."""
    radius = np.linspace(1e-9, math.sqrt(D) + 8, 500)
    reach = (truth_sigma * radius[-1] + sigma * (math.sqrt(D) + 8)) / sigma
    distance = np.linspace(0, reach, 3000)
    inner = []
    for r in truth_sigma * radius:
        farther = 1 - stats.ncx2.cdf(distance[1:] ** 2, D, (r / sigma) ** 2)
        inner.append(sigma * np.trapezoid(np.concatenate([[1.0], farther]) ** N, distance))
    return float(np.trapezoid(stats.chi.pdf(radius, D) * np.array(inner), radius))


class TestNearest:
    def test_of_one_from_the_centre_is_the_mean_of_a_chi_variable(self) -> None:
        # E‖z‖ = √2 Γ((D+1)/2)/Γ(D/2); for D = 2: √2 Γ(3/2) = √(π/2)
        found = expected_nearest(0.0, sigma=2, N=1, D=2)
        np.testing.assert_allclose(found, 2 * math.sqrt(math.pi / 2), rtol=1e-9)

    def test_of_two_in_one_dimension_is_the_smaller_of_two_half_normals(self) -> None:
        # E max(|z1|,|z2|) = 2/√π and E(|z1|+|z2|) = 2√(2/π), so the smaller has mean 2(√2 − 1)/√π
        found = expected_nearest(0.0, sigma=1, N=2, D=1)
        np.testing.assert_allclose(found, 2 * (math.sqrt(2) - 1) / math.sqrt(math.pi), rtol=1e-9)

    def test_of_many_in_one_dimension_falls_as_one_over_their_number(self) -> None:
        # Near 0 the density of |z| is 2 φ(0), so the least of N is exponential with mean 1/(2 N φ(0))
        N = 1_000_000
        found = expected_nearest(0.0, sigma=1, N=N, D=1, nodes=200)
        np.testing.assert_allclose(found, math.sqrt(2 * math.pi) / (2 * N), rtol=1e-5)

    def test_without_spread_is_the_distance_of_the_centre(self) -> None:
        np.testing.assert_allclose(expected_nearest([0, 1.5, 7], sigma=0, N=10, D=3), [0, 1.5, 7])

    def test_points_cover_all_but_the_cut_tails(self) -> None:
        N, D, noncentrality = 200, 45, np.array(160.0)
        t, _ = nearest_points(noncentrality, N=N, D=D)
        outside = stats.ncx2.cdf(t.min() ** 2, D, noncentrality), stats.ncx2.sf(t.max() ** 2, D, noncentrality)
        assert N * outside[0] < 1e-10
        assert outside[1] ** N < 1e-10

    def test_gauss_legendre_integrates_a_polynomial_of_degree_2n_minus_1_exactly(self) -> None:
        points, weights = gauss_legendre([0, 1], [2, 3], nodes=3)
        np.testing.assert_allclose((weights * points**5).sum(axis=-1), [64 / 6, (729 - 1) / 6])


class TestExpectedMinMpjpe:
    @pytest.mark.parametrize(("D", "sigma", "truth_sigma"), [(1, 4, 3), (3, 0.1, 0.5), (45, 0.2, 0.5), (100, 1, 0.5)])
    def test_of_one_hypothesis_has_a_closed_form(self, D: int, sigma: float, truth_sigma: float) -> None:
        exact = collapse.mean_mpjpe(sigma, D=D, truth_sigma=truth_sigma)
        found = best_of.expected_min_mpjpe(sigma, N=1, D=D, truth_sigma=truth_sigma)
        np.testing.assert_allclose(found, exact, rtol=1e-5)

    @pytest.mark.parametrize("D", [1, 2, 7])
    def test_of_one_hypothesis_with_a_wrong_mean_has_a_closed_form(self, D: int) -> None:
        offset = np.array([0, 0.3, 2.0, 6.0])
        exact = collapse.mean_mpjpe(2.0, D=D, truth_sigma=1.5, offset=offset)
        found = best_of.expected_min_mpjpe(2.0, N=1, D=D, truth_sigma=1.5, offset=offset)
        np.testing.assert_allclose(found, exact, rtol=1e-6)

    @pytest.mark.parametrize(
        ("D", "N", "sigma"),
        [
            pytest.param(45, 200, 0.1973, marks=pytest.mark.slow),
            pytest.param(45, 200, 0.5, marks=pytest.mark.slow),
            pytest.param(10, 200, 0.37, marks=pytest.mark.slow),
            pytest.param(2, 50, 0.55, marks=pytest.mark.slow),
            pytest.param(100, 500, 0.15, marks=pytest.mark.slow),
        ],
    )
    def test_agrees_with_an_independent_quadrature_to_1e_4(self, D: int, N: int, sigma: float) -> None:
        found = best_of.expected_min_mpjpe(sigma, N=N, D=D)
        np.testing.assert_allclose(found, trapezoid_min_mpjpe(sigma, N, D, 0.5), rtol=1e-4)

    @pytest.mark.parametrize("D", [1, 4, *(pytest.param(D, marks=pytest.mark.slow) for D in (45, 100))])
    @pytest.mark.parametrize("N", [2, pytest.param(30, marks=pytest.mark.slow), 500])
    def test_agrees_with_a_quadrature_of_higher_order_to_3e_5(self, D: int, N: int) -> None:
        for sigma in (0.05, 0.2, 0.5, 1.0):
            coarse = best_of.expected_min_mpjpe(sigma, N=N, D=D)
            fine = best_of.expected_min_mpjpe(sigma, N=N, D=D, nodes=144)
            np.testing.assert_allclose(coarse, fine, rtol=3e-5)

    @pytest.mark.parametrize(("D", "N", "sigma", "offset"), [(1, 10, 6.0, 1.0), (3, 5, 2.0, 0.0), (6, 20, 1.0, 3.0)])
    def test_agrees_with_plain_draws(self, D: int, N: int, sigma: float, offset: float) -> None:
        rng = np.random.default_rng(1)
        truth = 2.0 * rng.standard_normal((40_000, D))
        truth[:, 0] += offset
        drawn = np.linalg.norm(truth - sigma * rng.standard_normal((N, 40_000, D)), axis=-1).min(axis=0)
        error = drawn.std() / 200
        found = best_of.expected_min_mpjpe(sigma, N=N, D=D, truth_sigma=2.0, offset=offset)
        np.testing.assert_allclose(found, drawn.mean(), rtol=0, atol=4 * error)

    @pytest.mark.slow
    def test_at_the_pose_like_point_agrees_with_a_large_simulation(self) -> None:
        rng = np.random.default_rng(2)
        for sigma in (0.1973, 0.5):
            mean, error = best_of.simulated_min_mpjpe(sigma, N=200, D=45, poses=60_000, rng=rng)
            assert error < 1e-3 * mean / 2
            np.testing.assert_allclose(best_of.expected_min_mpjpe(sigma, N=200, D=45), mean, rtol=0, atol=4 * error)

    def test_scales_with_the_unit_of_length(self) -> None:
        metres = best_of.expected_min_mpjpe(0.2, N=20, D=5, truth_sigma=0.5, offset=0.3)
        millimetres = best_of.expected_min_mpjpe(200, N=20, D=5, truth_sigma=500, offset=300)
        np.testing.assert_allclose(millimetres, 1000 * metres)

    def test_falls_with_every_further_hypothesis(self) -> None:
        found = [float(best_of.expected_min_mpjpe(0.5, N=N, D=3)) for N in (1, 2, 3, 10, 50, 500)]
        assert (np.diff(found) < 0).all()

    def test_of_a_truth_without_spread_is_the_nearest_to_a_point(self) -> None:
        found = best_of.expected_min_mpjpe(1.0, N=9, D=2, truth_sigma=0, offset=0.7)
        np.testing.assert_allclose(found, expected_nearest(0.7, sigma=1.0, N=9, D=2))

    @pytest.mark.parametrize(
        ("N", "D", "sigma", "words"),
        [
            (0, 3, 1.0, r"N = 0 hypotheses of D = 3 coordinates; expected at least 1"),
            (5, 0, 1.0, r"D = 0"),
            (5, 3, -1.0, r"sigma: -1.0; expected a length, 0 or more"),
            (5, 3, math.nan, r"sigma: nan"),
        ],
    )
    def test_refuses_what_is_no_sampler(self, N: int, D: int, sigma: float, words: str) -> None:
        with pytest.raises(PoseDataError, match=words):
            best_of.expected_min_mpjpe(sigma, N=N, D=D)


class TestOptimalSigma:
    def test_reaches_the_published_point(self) -> None:
        # The target of the toy problem: σ = 0.1973 ± 0.0005, minMPJPE 3.065 against 3.559
        sigma = best_of.optimal_sigma(N=200, D=45)
        assert abs(sigma - 0.1973) < 0.0005
        errors = [float(best_of.expected_min_mpjpe(s, N=200, D=45)) for s in (sigma, 0.5)]
        np.testing.assert_allclose(errors, [3.065, 3.559], rtol=0, atol=5e-4)

    def test_of_one_hypothesis_is_none(self) -> None:
        assert best_of.optimal_sigma(N=1, D=45) == 0

    @pytest.mark.slow
    def test_of_two_in_high_dimensions_follows_from_the_expansion_for_small_spreads(self) -> None:
        # ‖x − σz‖ ≈ ρ − σ z₁ + σ²(D−1)/(2ρ), the best of two gains σ/√π, so σ = ρ/(√π (D−1)) with ρ ≈ √D σ*
        D = 2_000
        sigma = best_of.optimal_sigma(N=2, D=D)
        np.testing.assert_allclose(sigma, 0.5 * math.sqrt(D) / (math.sqrt(math.pi) * (D - 1)), rtol=3e-3)

    def test_of_many_tends_to_zadors_density_from_below(self) -> None:
        # p^(D/(D+1)) of a Gaussian is a Gaussian √(1 + 1/D) times as wide: √2 · 0.5 in one dimension
        sigma = best_of.optimal_sigma(N=20_000, D=1)
        limit = math.sqrt(2) * 0.5
        assert limit * 0.999 < sigma < limit

    def test_is_a_minimum(self) -> None:
        sigma = best_of.optimal_sigma(N=50, D=10)
        here, *beside = (float(best_of.expected_min_mpjpe(s, N=50, D=10)) for s in (sigma, 0.99 * sigma, 1.01 * sigma))
        assert here < min(beside)

    def test_scales_with_the_truth(self) -> None:
        np.testing.assert_allclose(
            best_of.optimal_sigma(N=20, D=3, truth_sigma=80), 160 * best_of.optimal_sigma(N=20, D=3), rtol=1e-4
        )

    def test_rises_with_hypotheses_and_falls_with_dimensions(self) -> None:
        over_hypotheses = [best_of.optimal_sigma(N=N, D=5) for N in (2, 5, 20, 100)]
        over_dimensions = [best_of.optimal_sigma(N=50, D=D) for D in (1, 3, 10, 40)]
        assert (np.diff(over_hypotheses) > 0).all()
        assert (np.diff(over_dimensions) < 0).all()


class TestNll:
    def test_of_the_oracle_is_the_entropy(self) -> None:
        # 45 (ln(0.5 √(2π)) + 1/2) = 45 · 0.72579 = 32.66: the published 7.43 does not reproduce
        np.testing.assert_allclose(best_of.nll(0.5, D=45), 32.66, atol=0.005)
        np.testing.assert_allclose(best_of.nll(0.5, D=45), 45 * stats.norm(0, 0.5).entropy())

    def test_is_the_mean_of_minus_the_log_density(self) -> None:
        # E[−ln p] over the truth by Gauss-Hermite, which is exact for a quadratic
        nodes, weights = np.polynomial.hermite_e.hermegauss(5)
        density = stats.norm(0, 0.2).logpdf(0.5 * nodes)
        np.testing.assert_allclose(best_of.nll(0.2, D=7), -7 * (weights @ density) / weights.sum())

    def test_of_a_point_is_infinite(self) -> None:
        assert best_of.nll(0.0, D=3) == math.inf


class TestSimulation:
    def test_draws_distances_of_the_correct_distribution(self) -> None:
        rng = np.random.default_rng(3)
        mean, error = best_of.simulated_min_mpjpe(0.4, N=1, D=45, poses=50_000, rng=rng, offset=2.0)
        exact = collapse.mean_mpjpe(0.4, D=45, truth_sigma=0.5, offset=2.0)
        np.testing.assert_allclose(mean, exact, rtol=0, atol=4 * error)

    def test_needs_two_poses_for_an_error(self) -> None:
        with pytest.raises(PoseDataError, match="poses: 1; expected at least 2"):
            best_of.simulated_min_mpjpe(1.0, N=2, D=3, poses=1, rng=np.random.default_rng(0))
