"""The CVAE: counts, draws of a known case, both losses against their formulas, and its training."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import stats

from posecal.errors import PoseDataError
from posecal_models.checkpoint import load_estimator
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.estimators.cvae import CVAE
from posecal_models.estimators.latent import LatentPoses
from posecal_models.preparation import prepare
from posecal_models.published_losses import AveragedDraws, EvidenceBound


def small(variant: str) -> CVAE:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = CVAE(("a", "b"), ("a", "b", "c"), width=16, residuals=1, variant=variant)
    model.standardizer.pose_scale.fill_(100.0)
    return model.eval()


def inputs(poses: int = 9) -> tuple[Context, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    context = Context(torch.randn(poses, 3, 2, generator=generator), torch.ones(poses, 3, dtype=torch.bool))
    return context, 100 * torch.randn(poses, 2, 3, generator=generator)


@pytest.mark.parametrize(("variant", "count"), [("released", 9_100_080), ("repaired", 9_100_080 - 1024 + 48)])
def test_it_has_the_published_number_of_parameters(variant, count):
    assert sum(p.numel() for p in CVAE(variant=variant).parameters()) == count


def test_what_is_drawn_has_the_moments_of_its_decoder():
    """A linear decoder: two latents with a known matrix, of two images with known offsets."""
    matrix = torch.tensor([[3.0, 0, 1], [0, 2, -1]])
    offset = torch.tensor([[10.0, 20, 30], [-5, 0, 5]])
    poses = LatentPoses(lambda z: (z @ matrix + offset)[:, :, None], 2, offset, "none.")
    many = 40_000
    drawn = poses.sample(many, generator=torch.Generator().manual_seed(0))[:, :, 0]
    deviation = matrix.norm(dim=0)
    assert float(((drawn.mean(0) - offset) / deviation * math.sqrt(many)).abs().max()) < 4
    np.testing.assert_allclose(torch.cov(drawn[:, 1].T), matrix.T @ matrix, atol=0.25)
    torch.testing.assert_close(poses.mode()[:, 0], offset)
    half = poses.sample(many, generator=torch.Generator().manual_seed(0), temperature=0.5)[:, :, 0]
    torch.testing.assert_close(half - offset, (drawn - offset) / 2, rtol=1e-4, atol=1e-4)


def test_many_draws_pass_in_parts_and_are_those_of_one_pass():
    seen = []

    def decode(latents):
        seen.append(len(latents))
        return latents[..., None]

    drawn = LatentPoses(decode, 3, torch.zeros(100, 1), "none.").sample(400, generator=torch.Generator().manual_seed(2))
    assert seen == [163, 163, 74]
    whole = torch.randn(400, 100, 3, generator=torch.Generator().manual_seed(2))
    assert torch.equal(drawn[..., 0], whole)


def test_the_repaired_one_adds_noise_of_each_coordinate_to_what_it_decodes():
    model, (context, _) = small("repaired"), inputs(1)
    with torch.no_grad():
        model.log_sigma.copy_(torch.linspace(-1, 1, 6))
        model.decoder[-1].weight.zero_()
        drawn = model(context).sample(20_000, generator=torch.Generator().manual_seed(0))
    expected = 100 * torch.linspace(-1, 1, 6).exp().view(2, 3)
    np.testing.assert_allclose(drawn.std(0)[0], expected, rtol=0.03)


def test_the_density_is_refused_with_the_reason():
    context, truth = inputs()
    with pytest.raises(PoseDataError, match=r"log_prob of 9 poses: the density of a CVAE is an integral over"):
        small("released")(context).log_prob(truth)


@torch.no_grad()
def test_released_latents_are_rectified_and_repaired_ones_are_not():
    context, truth = inputs(40)
    for variant, negative in (("released", False), ("repaired", True)):
        model = small(variant)
        mean, log_variance = model.encode(model.standardised_keypoints(context), truth.flatten(1) / 100)
        assert mean.shape == log_variance.shape == (40, 4)
        assert bool((mean < 0).any()) is bool((log_variance < 0).any()) is negative


@torch.no_grad()
def test_the_released_loss_takes_the_error_of_the_averaged_draws():
    model, (context, truth) = small("released"), inputs()
    objective = AveragedDraws(model, draws=3)
    noise = objective.noise(truth, torch.Generator().manual_seed(4))
    assert noise.shape == (6, 9, 4)
    losses = objective(context, truth, noise)
    keypoints, poses = model.standardised_keypoints(context), truth.flatten(1) / 100
    mean, log_variance = model.encode(keypoints, poses)
    of_encoder = sum(model.decode((mean + (log_variance / 2).exp() * z)[None], keypoints)[0] for z in noise[:3]) / 3
    of_prior = [model.decode(z[None], keypoints)[0] for z in noise[3:]]
    error = ((of_encoder - poses) ** 2).mean() / 2 + ((sum(of_prior) / 3 - poses) ** 2).mean() / 2
    divergence = torch.distributions.kl_divergence(
        torch.distributions.Normal(mean, (log_variance / 2).exp()), torch.distributions.Normal(0.0, 1.0)
    )
    np.testing.assert_allclose(losses["loss"], 100 * error + 10 * divergence.mean(), rtol=1e-5)
    nearest = torch.stack([(100 * (y - poses)).view(9, 2, 3).norm(dim=-1).mean(-1) for y in of_prior]).amin(0).mean()
    np.testing.assert_allclose(losses["selection"], nearest, rtol=1e-5)
    model.train()
    assert "selection" not in objective(context, truth, noise)


@torch.no_grad()
def test_the_repaired_loss_is_the_evidence_bound_in_nats():
    model, (context, truth) = small("repaired"), inputs()
    model.log_sigma.fill_(0.3)
    objective = EvidenceBound(model, draws=3)
    noise = objective.noise(truth, torch.Generator().manual_seed(4))
    keypoints, poses = model.standardised_keypoints(context), truth.flatten(1) / 100
    mean, log_variance = model.encode(keypoints, poses)
    decoded = [model.decode((mean + (log_variance / 2).exp() * z)[None], keypoints)[0] for z in noise[:3]]
    nats = [-stats.norm.logpdf(poses, y, math.exp(0.3)) for y in decoded]
    divergence = 0.5 * (mean**2 + log_variance.exp() - 1 - log_variance).sum(1).mean()
    expected = np.mean(nats, axis=(0, 1)).sum() + float(divergence)
    np.testing.assert_allclose(objective(context, truth, noise)["loss"], expected, rtol=1e-5)


@pytest.mark.parametrize("variant", ["released", "repaired"])
def test_a_training_lowers_its_loss_and_its_weights_come_back(motion_file, tmp_path, variant):
    settings = [f"model.variant={variant}", "model.width=32", "data.views=1", "train.batch=16", "train.epochs=4"]
    settings += ["train.learning_rate=0.01", "train.hypotheses=3", 'data.validation_subjects=["S3"]']
    run = prepare(Config.load("sharma-cvae").with_changes(settings), motion_file, tmp_path / "run")
    run.run()
    assert np.mean(run.step_losses[-5:]) < 0.95 * np.mean(run.step_losses[:5])
    images = run.validation.batch(torch.arange(3), torch.Generator().manual_seed(1))[0]
    back = load_estimator(tmp_path / "run/weights.safetensors")
    run.estimator.load_state_dict(run.best)
    one, two = (e(images).sample(4, generator=torch.Generator().manual_seed(3)) for e in (run.estimator.eval(), back))
    assert torch.equal(one, two)
    assert back.variant == variant
