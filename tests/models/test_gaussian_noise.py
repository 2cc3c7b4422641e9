"""The Gaussian noise model: density against SciPy, trainings against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import stats
from scipy.optimize import minimize_scalar

from posecal_models.contract import Context
from posecal_models.estimators.gaussian_noise import GaussianDistribution, GaussianNoise, likelihood_optimum
from posecal_models.estimators.simple_baseline import SimpleBaseline
from posecal_models.objectives import BestOfN, Likelihood

JOINTS = ("a", "b")


def noise_model(spread: str = "joint") -> GaussianNoise:
    """Gaussian noise around a network whose output is always 0 mm."""
    mean = SimpleBaseline(JOINTS, JOINTS, width=4, origin="none")
    mean.last.weight.data.zero_()
    mean.last.bias.data.zero_()
    return GaussianNoise(mean, spread=spread)


def context(poses: int) -> Context:
    return Context(torch.zeros(poses, 2, 2), torch.ones(poses, 2, dtype=torch.bool))


def truth(poses: int, sigma: tuple[float, float]) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.randn(poses, 2, 3, generator=generator) * torch.tensor(sigma)[:, None]


def minimise(objective, poses: torch.Tensor, steps: int) -> None:
    optimizer = torch.optim.Adam([objective.estimator.log_sigma], 0.05)
    generator = torch.Generator().manual_seed(2)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = 0.05 * (1 - step / steps)
        optimizer.zero_grad()
        objective(context(len(poses)), poses, objective.noise(poses, generator))["loss"].backward()
        optimizer.step()


@pytest.mark.parametrize("spread", ["joint", "coordinate"])
def test_the_log_density_is_scipy_s(spread):
    model = noise_model(spread)
    model.log_sigma.data = torch.linspace(3, 5, model.log_sigma.numel()).view_as(model.log_sigma)
    poses = truth(5, (60.0, 90.0))
    sigma = model.log_sigma.detach().exp().expand(2, 3).double().numpy()
    expected = stats.norm.logpdf(poses.double().numpy(), 0, sigma).sum((1, 2))
    np.testing.assert_allclose(model(context(5)).log_prob(poses).detach(), expected, rtol=1e-5)


@pytest.mark.parametrize("spread", ["joint", pytest.param("coordinate", marks=pytest.mark.slow)])
def test_likelihood_training_finds_the_closed_form(spread):
    model, poses = noise_model(spread), truth(400, (60.0, 140.0))
    minimise(Likelihood(model), poses, 300)
    np.testing.assert_allclose(model.log_sigma.detach().exp(), likelihood_optimum(poses, spread=spread), rtol=1e-3)


@pytest.mark.slow
def test_min_mpjpe_training_finds_the_sigma_of_the_quadrature():
    """One joint in 3D with N = 20: the best σ follows from the noncentral chi-squared law (paper section 3.2)."""
    many, hypotheses, true_sigma = 4000, 20, 100.0

    def expected_error(sigma: float) -> float:
        inner, outer = (np.polynomial.legendre.leggauss(count) for count in (200, 24))
        radius, length = 6 * (inner[0] + 1), 2.75 * (outer[0] + 1)[:, None]  # up to 12 and 5.5 standard deviations
        none_nearer = (1 - stats.ncx2.cdf((radius / sigma) ** 2, 3, (length / sigma) ** 2)) ** hypotheses
        return outer[1] * 2.75 * stats.chi.pdf(length[:, 0], 3) @ (none_nearer @ (6 * inner[1]))

    best = true_sigma * minimize_scalar(expected_error, bounds=(0.4, 1.6), method="bounded").x
    mean = SimpleBaseline(("only",), ("only",), width=4, origin="none")
    mean.last.weight.data.zero_()
    mean.last.bias.data.zero_()
    model = GaussianNoise(mean)
    poses = true_sigma * torch.randn(many, 1, 3, generator=torch.Generator().manual_seed(1))
    objective = BestOfN(model, hypotheses)
    optimizer = torch.optim.Adam([model.log_sigma], 0.05)
    generator = torch.Generator().manual_seed(2)
    empty = Context(torch.zeros(many, 1, 2), torch.ones(many, 1, dtype=torch.bool))
    sigmas = []
    for step in range(120):
        for group in optimizer.param_groups:
            group["lr"] = 0.05 * (1 - step / 120)
        optimizer.zero_grad()
        objective(empty, poses, objective.noise(poses, generator))["loss"].backward()
        optimizer.step()
        sigmas.append(float(model.log_sigma.detach().exp()))
    # the minimum is flat: within 4 % of σ the expected error changes by less than the standard error of 4,000 poses
    standard_error = 100 * 0.3 / math.sqrt(many)
    assert true_sigma * (expected_error(sigmas[-1] / true_sigma) - expected_error(best / true_sigma)) < standard_error
    np.testing.assert_allclose(sigmas[-1], best, rtol=0.04)


def test_samples_have_the_mean_and_the_sigma():
    mean = torch.tensor([[[10.0, 20, 30], [40, 50, 60]]])
    distribution = GaussianDistribution(mean, torch.tensor([[5.0], [9.0]]))
    many = 40_000
    samples = distribution.sample(many, generator=torch.Generator().manual_seed(0))[:, 0]
    assert samples.shape == (many, 2, 3)
    spread = torch.tensor([[5.0], [9.0]])
    assert float(((samples.mean(0) - mean[0]).abs() / (spread / math.sqrt(many))).max()) < 4
    assert float(((samples.std(0) / spread - 1).abs() * math.sqrt(2 * many)).max()) < 4


def test_the_paper_s_size_has_the_paper_s_number_of_parameters():
    sixteen = tuple(f"joint {k}" for k in range(16))
    model = GaussianNoise(SimpleBaseline(sixteen[1:], sixteen))
    assert sum(p.numel() for p in model.parameters()) == 4_288_572


def test_training_leaves_the_mean_as_it_is():
    model = noise_model()
    before = {name: t.clone() for name, t in model.mean.state_dict().items()}
    model.train()
    minimise(Likelihood(model), truth(50, (60.0, 60.0)), 3)
    assert all(torch.equal(before[name], t) for name, t in model.mean.state_dict().items())
