"""Supplement A.1 and A.2: closed forms against numerical integrals, known constants and simulations."""

import math

import numpy as np
import pytest
from scipy import integrate, stats

from posecal.errors import PoseDataError
from toy import collapse, mean
from toy.nearest import gauss_legendre


class TestCollapse:
    def test_mean_mpjpe_in_one_dimension_is_the_mean_of_a_folded_normal(self) -> None:
        exact = stats.foldnorm.mean(2.0 / 5, scale=5)  # |N(2, 3² + 4²)|
        np.testing.assert_allclose(collapse.mean_mpjpe(4, D=1, truth_sigma=3, offset=2), exact, rtol=1e-9)

    def test_mean_mpjpe_in_three_dimensions_is_the_mean_of_a_noncentral_chi(self) -> None:
        # E√w for w ~ ncx2(3, (2/5)²), by integration of the survival function of the root
        exact = 5 * integrate.quad(lambda r: stats.ncx2.sf(r**2, 3, 0.16), 0, 12)[0]
        np.testing.assert_allclose(collapse.mean_mpjpe(4, D=3, truth_sigma=3, offset=2), exact, rtol=1e-7)

    def test_oracle_is_sqrt_2_times_worse_than_the_collapsed_model_in_every_dimension(self) -> None:
        for D in (1, 3, 45):
            oracle, collapsed = collapse.mean_mpjpe([0.5, 0.0], D=D, truth_sigma=0.5)
            np.testing.assert_allclose(oracle / collapsed, math.sqrt(2))

    def test_both_errors_grow_with_spread_and_with_offset(self) -> None:
        grid = np.linspace(0, 3, 30)
        for error in (collapse.mean_mpjpe, collapse.mean_squared_error):
            assert (np.diff(error(grid, D=3, offset=0.5)) > 0).all()
            assert (np.diff(error(0.7, D=3, offset=grid)) > 0).all()

    def test_squared_error_is_the_sum_of_variances_and_bias(self) -> None:
        # Gauss-Hermite is exact for a square: x − x̂ ~ N(0.5, 3² + 4²) in one of two dimensions
        nodes, weights = np.polynomial.hermite_e.hermegauss(4)
        one = (weights @ (0.5 + 5 * nodes) ** 2) / weights.sum()
        other = (weights @ (5 * nodes) ** 2) / weights.sum()
        found = collapse.mean_squared_error(4, D=2, truth_sigma=3, offset=0.5)
        np.testing.assert_allclose(found, one + other)

    def test_mpjpe_of_an_exponential_truth_is_least_at_its_median(self) -> None:
        point = np.linspace(0, 3, 3001)
        np.testing.assert_allclose(point[collapse.exponential_mpjpe(point).argmin()], math.log(2), atol=1e-3)

    def test_squared_error_of_an_exponential_truth_is_least_at_its_mean(self) -> None:
        point = np.linspace(0, 3, 3001)
        np.testing.assert_allclose(point[collapse.exponential_squared_error(point).argmin()], 1, atol=1e-3)

    @pytest.mark.parametrize("point", [0.0, 0.4, 2.2])
    def test_errors_of_an_exponential_truth_are_integrals(self, point: float) -> None:
        near = integrate.quad(lambda x: (point - x) * math.exp(-x), 0, point)[0]
        far = integrate.quad(lambda x: (x - point) * math.exp(-x), point, 60)[0]
        np.testing.assert_allclose(collapse.exponential_mpjpe(point), near + far, rtol=1e-7)
        squared = integrate.quad(lambda x: (x - point) ** 2 * math.exp(-x), 0, 60)[0]
        np.testing.assert_allclose(collapse.exponential_squared_error(point), squared, rtol=1e-7)

    def test_refuses_a_truth_without_spread(self) -> None:
        with pytest.raises(PoseDataError, match="truth_sigma 0; expected at least 1, and a length above 0"):
            collapse.mean_mpjpe(1.0, D=3, truth_sigma=0)


class TestNearestZ:
    @pytest.mark.parametrize(("N", "largest"), [(2, math.pi**-0.5), (3, 1.5 * math.pi**-0.5), (10, 1.5387527308)])
    def test_far_away_is_the_largest(self, N: int, largest: float) -> None:
        # The expected largest of 2, 3 (closed forms) and 10 (Teichroew 1956, ten digits) standard normals
        np.testing.assert_allclose(mean.largest_of(N), largest, rtol=1e-9)
        np.testing.assert_allclose(mean.nearest_z([-40.0, 40.0], N=N), [-largest, largest], rtol=1e-6)

    def test_of_one_is_its_mean(self) -> None:
        np.testing.assert_allclose(mean.nearest_z([-2.0, 0.3, 5.0], N=1), 0, atol=1e-10)

    @pytest.mark.slow
    def test_of_two_is_a_plain_double_integral(self) -> None:
        u, z = 0.8, np.linspace(-9, 9, 3601)
        pair = np.where(np.abs(z[:, None] - u) < np.abs(z - u), z[:, None], z)
        density = stats.norm.pdf(z)
        expected = np.trapezoid(np.trapezoid(pair * density, z) * density, z)
        np.testing.assert_allclose(mean.nearest_z(u, N=2), expected, atol=1e-4)

    def test_is_odd(self) -> None:
        u = np.array([0.0, 0.5, 1.7, 6.0])
        np.testing.assert_allclose(mean.nearest_z(-u, N=7), -mean.nearest_z(u, N=7), atol=1e-12)

    def test_refuses_no_hypotheses(self) -> None:
        with pytest.raises(PoseDataError, match="N = 0 hypotheses; expected at least 1"):
            mean.nearest_z(0.0, N=0)


class TestExpectedZ:
    @pytest.mark.parametrize(("N", "sigma", "offset"), [(2, 1.0, 0.5), (10, 0.5, -1.2), (60, 2.0, 2.0)])
    def test_agrees_with_draws(self, N: int, sigma: float, offset: float) -> None:
        rng = np.random.default_rng(4)
        drawn, error = mean.simulated_z(offset, sigma=sigma, truth_sigma=1.0, N=N, poses=50_000, rng=rng)
        exact = mean.expected_z(offset, sigma=sigma, truth_sigma=1.0, N=N)
        np.testing.assert_allclose(exact, drawn, rtol=0, atol=4 * error)

    def test_gives_the_slope_of_squared_min_mpjpe(self) -> None:
        # d/da E min (a + v − σz)² = 2 (a − σ E[z*]); the left side from E min² = ∫ 2t P(min > t) dt
        sigma, N, a, step = 0.7, 10, 0.6, 1e-3
        v, weights = gauss_legendre(-8, 8, 200)
        t, t_weights = gauss_legendre(0, 14, 400)

        def min_squared(offset: float) -> float:
            u = (offset + v)[:, None] / sigma
            farther = stats.norm.sf(u + t) + stats.norm.cdf(u - t)
            inner = sigma**2 * (2 * t * farther**N) @ t_weights
            return float(np.sum(weights * stats.norm.pdf(v) * inner))

        slope = (min_squared(a + step) - min_squared(a - step)) / (2 * step)
        exact = 2 * (a - sigma * mean.expected_z(a, sigma=sigma, truth_sigma=1.0, N=N))
        np.testing.assert_allclose(slope, exact, rtol=1e-5)

    @pytest.mark.slow
    def test_slope_vanishes_at_the_mean_of_a_gaussian_truth_alone(self) -> None:
        offset = np.linspace(-5, 5, 101)
        for N in (2, 10, 200):
            for sigma in (0.3, 1.0, 2.0):
                slope = offset - sigma * mean.expected_z(offset, sigma=sigma, truth_sigma=1.0, N=N)
                np.testing.assert_array_equal(np.sign(slope[offset > 0.01]), 1)
                np.testing.assert_array_equal(np.sign(slope[offset < -0.01]), -1)

    def test_min_mpjpe_leaves_the_mean_of_a_skewed_truth(self) -> None:
        # Draws: the squared minMPJPE of 10 hypotheses is lower at the root than at the mean, by many errors
        root = mean.best_offset_skewed(sigma=1.0, N=10)
        assert -0.52 < root < -0.47
        rng = np.random.default_rng(5)
        truth, z = rng.exponential(size=60_000) - 1, rng.standard_normal((10, 60_000))
        at_mean = (np.abs(truth - z).min(axis=0)) ** 2
        at_root = (np.abs(truth + root - z).min(axis=0)) ** 2
        gain = at_mean - at_root
        assert gain.mean() > 4 * gain.std() / math.sqrt(gain.size)

    def test_of_a_skewed_truth_agrees_with_draws(self) -> None:
        rng = np.random.default_rng(6)
        truth, z = 0.4 + rng.exponential(size=50_000) - 1, rng.standard_normal((10, 50_000))
        chosen = z[np.abs(truth - 1.5 * z).argmin(axis=0), np.arange(50_000)]
        exact = mean.expected_z_skewed(0.4, sigma=1.5, N=10)
        np.testing.assert_allclose(exact, chosen.mean(), rtol=0, atol=4 * chosen.std() / math.sqrt(50_000))


class TestSigmoid:
    def test_is_close_but_not_exact(self) -> None:
        offset = np.linspace(-6, 6, 121)
        z = mean.expected_z(offset, sigma=1.0, truth_sigma=1.0, N=10)
        fit = mean.fit_sigmoid(offset, z)
        np.testing.assert_allclose(fit(offset) - z, 0, atol=fit.largest_error + 1e-12)
        assert 0.01 < fit.largest_error < 0.03

    def test_reports_the_error_of_a_curve_that_is_no_sigmoid(self) -> None:
        offset = np.linspace(-4, 4, 200)
        fit = mean.fit_sigmoid(offset, np.arctan(2 * offset))
        error = fit(offset) - np.arctan(2 * offset)
        assert fit.largest_error > 0.02
        np.testing.assert_allclose(fit.rms_error, math.sqrt(np.mean(error**2)))
        np.testing.assert_allclose(fit.largest_error, np.abs(error).max())
