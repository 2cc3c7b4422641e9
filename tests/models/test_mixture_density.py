"""The mixture density network: counts, density against SciPy, draws, bounded weights, and its training."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import integrate, stats

from posecal.errors import PoseDataError
from posecal_models.checkpoint import load_estimator, save_estimator
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.data.standardizer import CoordinateStandardizer
from posecal_models.estimators.mixture_density import MixtureDensityNetwork, PoseMixture
from posecal_models.preparation import prepare
from posecal_models.published_losses import MixtureLikelihood

MEANS = torch.tensor([[[[0.5, -1, 2]], [[1.5, 0, -2]]], [[[0.0, 1, 0]], [[3.0, 3, 3]]]]).double()
SIGMA = torch.tensor([[0.5, 1.25], [0.75, 2.0]]).double()
WEIGHTS = torch.tensor([[0.25, 0.75], [0.9, 0.1]]).double()


def standardizer() -> CoordinateStandardizer:
    units = CoordinateStandardizer(1, 1).double()
    units.pose_mean.copy_(torch.tensor([[10.0, 20, 30]]))
    units.pose_scale.copy_(torch.tensor([[2.0, 3, 5]]))
    return units


def mixture() -> PoseMixture:
    """Two mixtures of two Gaussians of one joint."""
    return PoseMixture(MEANS, SIGMA, WEIGHTS.log(), standardizer())


def small(variant: str = "repaired") -> MixtureDensityNetwork:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return MixtureDensityNetwork(("a", "b"), ("a", "b", "c"), components=3, width=16, variant=variant)


def context(poses: int = 9) -> Context:
    generator = torch.Generator().manual_seed(1)
    return Context(300 + 50 * torch.randn(poses, 3, 2, generator=generator), torch.ones(poses, 3, dtype=torch.bool))


def test_it_has_the_published_number_of_parameters():
    model = MixtureDensityNetwork()
    assert sum(p.numel() for p in model.parameters()) == 4_498_682
    assert model.keypoints[0] == "Hip"
    assert "Neck/Nose" in model.joints
    assert "Neck/Nose" not in model.keypoints


def test_the_log_density_is_scipy_s():
    truth = torch.tensor([[[11.0, 18, 40]], [[12.0, 26, 20]]]).double()
    centre, scale = np.array([10.0, 20, 30]), np.array([2.0, 3, 5])
    expected = [
        sum(
            float(w) * stats.norm.pdf(truth[m, 0], centre + scale * mean[0].numpy(), float(s) * scale).prod()
            for w, mean, s in zip(WEIGHTS[m], MEANS[m], SIGMA[m], strict=True)
        )
        for m in range(2)
    ]
    np.testing.assert_allclose(mixture().log_prob(truth), np.log(expected), rtol=1e-12)


def test_the_density_of_one_coordinate_integrates_to_one():
    """The other two coordinates are at the common mean of both components, whose densities there are known."""
    means = torch.tensor([[[[-1.0, 0, 0]], [[2.0, 0, 0]]]]).double()
    pair = PoseMixture(means, torch.full((1, 2), 0.5).double(), WEIGHTS[:1].log(), standardizer())

    def density(x: float) -> float:
        return float(pair.log_prob(torch.tensor([[[x, 20, 30]]]).double()).exp())

    total = integrate.quad(density, -20, 40, points=(8, 14), epsabs=1e-12)[0]
    np.testing.assert_allclose(total, stats.norm.pdf(0, 0, 1.5) * stats.norm.pdf(0, 0, 2.5), rtol=1e-9)


def test_draws_have_the_moments_of_the_mixture():
    many = 60_000
    drawn = mixture().sample(many, generator=torch.Generator().manual_seed(0))
    assert drawn.shape == (many, 2, 1, 3)
    weights, means = WEIGHTS[..., None], MEANS[:, :, 0]
    mean = (weights * means).sum(1)
    variance = (weights * (SIGMA[..., None] ** 2 + means**2)).sum(1) - mean**2
    error = (standardizer().poses(drawn.mean(0))[:, 0] - mean) / (variance / many).sqrt()
    assert float(error.abs().max()) < 4
    np.testing.assert_allclose(standardizer().poses(drawn)[:, :, 0].var(0), variance, rtol=0.03)


def test_components_are_drawn_by_their_weights():
    narrow = PoseMixture(MEANS, torch.full_like(SIGMA, 1e-6), WEIGHTS.log(), standardizer())
    drawn = narrow.sample(20_000, generator=torch.Generator().manual_seed(0))
    of_first = (drawn - narrow.means()[0]).norm(dim=-1)[..., 0] < 1e-3
    np.testing.assert_allclose(of_first.double().mean(0), WEIGHTS[:, 0], atol=4 * math.sqrt(0.25 / 20_000))
    cold = mixture().sample(7, generator=torch.Generator().manual_seed(0), temperature=0.0)
    assert ((cold[:, None] - mixture().means()).abs().amax((-1, -2)).amin(1) < 1e-12).all()


def test_the_published_hypotheses_are_the_means_in_mm():
    means = mixture().means()
    assert means.shape == (2, 2, 1, 3)
    np.testing.assert_allclose(means[1, 0, 0], [10 + 2 * 1.5, 20, 30 + 5 * -2])


def test_the_mode_is_the_mean_with_the_highest_peak():
    # 0.25 / 0.5**3 against 0.75 / 1.25**3, and 0.9 / 0.75**3 against 0.1 / 2**3
    np.testing.assert_allclose(mixture().mode(), standardizer().millimetres(MEANS[:, 0]))


def test_weights_above_norm_1_are_divided_by_it_but_for_those_of_the_components():
    model = small().eval()
    before = model(context()).means().clone()
    with torch.no_grad():
        assert model.means.weight.norm() > 1
        model.means.weight /= model.means.weight.norm()
        model.first.linear.weight *= 7
    torch.testing.assert_close(model(context()).means(), before)
    weights = model(context()).log_weights.clone()
    with torch.no_grad():
        model.weights.weight *= 7
    assert not torch.allclose(model(context()).log_weights, weights)


@torch.no_grad()
def test_the_released_loss_adds_the_logarithms_of_the_weights():
    model, some = small(), context()
    truth = torch.randn(9, 2, 3, generator=torch.Generator().manual_seed(2))
    model.eval()
    likelihood = MixtureLikelihood(model)(some, truth)
    assert set(likelihood) == {"loss"}
    np.testing.assert_allclose(float(likelihood["loss"]), -float(model(some).log_prob(truth).mean()), rtol=1e-5)
    model.variant = "released"
    losses = MixtureLikelihood(model)(some, truth)
    prior = float(model(some).log_weights.sum(-1).mean())
    np.testing.assert_allclose(float(losses["loss"]), float(likelihood["loss"]) - prior, rtol=1e-6)
    nearest = (model(some).means() - truth).norm(dim=-1).mean(-1).amin(0).mean()
    np.testing.assert_allclose(float(losses["selection"]), float(nearest), rtol=1e-6)
    assert "selection" not in MixtureLikelihood(model.train())(some, truth)


def test_a_keypoint_that_is_not_a_number_is_refused():
    broken = context()
    broken.keypoints[2, 1, 0] = torch.nan
    with pytest.raises(PoseDataError, match="1 of 27 are not finite; A mixture density network reads every keypoint"):
        small().eval()(broken)


@pytest.mark.parametrize("variant", ["released", "repaired"])
def test_a_training_lowers_its_loss_and_its_weights_come_back(motion_file, tmp_path, variant):
    settings = [f"model.variant={variant}", "model.width=32", "data.views=1", "train.batch=16", "train.epochs=4"]
    settings += ["train.learning_rate=0.01", "model.dropout=0", 'data.validation_subjects=["S3"]']
    run = prepare(Config.load("mdn").with_changes(settings), motion_file, tmp_path / "run")
    run.run()
    assert np.mean(run.step_losses[-5:]) < np.mean(run.step_losses[:5]) - 2
    assert "Neck/Nose" in run.estimator.keypoints  # the motion has no keypoint of the hip
    back = load_estimator(tmp_path / "run/weights.safetensors")
    save_estimator(tmp_path / "again.safetensors", back)
    images = run.validation.batch(torch.arange(3), torch.Generator().manual_seed(1))[0]
    one, two = (
        e(images).sample(4, generator=torch.Generator().manual_seed(3))
        for e in (back, load_estimator(tmp_path / "again.safetensors"))
    )
    assert torch.equal(one, two)
    assert back.variant == variant


def test_released_weights_are_selected_by_the_best_mean(motion_file, tmp_path):
    settings = ["model.width=16", "data.views=1", "train.epochs=2", 'data.validation_subjects=["S3"]']
    run = prepare(Config.load("mdn").with_changes(settings), motion_file, tmp_path / "run")
    run.run()
    rows = np.genfromtxt(tmp_path / "run/losses.csv", delimiter=",", names=True)
    assert (rows["validation_loss"] > 50).all()  # mm
    assert (rows["training_loss"] < 500).all()  # nats
