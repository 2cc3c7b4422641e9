"""The reference estimator: an exact linear part, a mixture's density and samples, and keypoints that are missing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from posecal.errors import PoseDataError
from posecal_models.checkpoint import load_estimator, save_estimator
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.estimators.amortized_posterior import AmortizedPosterior
from posecal_models.estimators.registry import build, describe
from posecal_models.preparation import prepare
from posecal_models.settings import TrainConfig
from posecal_models.validation import TEMPERATURES, validation_losses
from toy.pose_world import PoseWorld

K = 4
NAMES = tuple(f"joint {k}" for k in range(K))


def images(M: int, seed: int = 0) -> tuple[torch.Tensor, Context]:
    """Poses of independent coordinates, and their first two coordinates in pixels with noise of 3."""
    generator = torch.Generator().manual_seed(seed)
    poses = 100 * torch.randn((M, K, 3), generator=generator)
    keypoints = 500 + 0.2 * poses[..., :2] + 3 * torch.randn((M, K, 2), generator=generator)
    return poses, Context(keypoints, torch.ones(M, K, dtype=torch.bool), torch.full((M, K), 3.0))


def estimator(*, trained: bool = True, **options) -> AmortizedPosterior:
    """A small estimator whose network gives a correction of its own for every image, where it is trained."""
    torch.manual_seed(0)
    built = AmortizedPosterior(NAMES, NAMES, width=16, residuals=1, **options)
    built.fit(*images(500))
    if trained:
        torch.nn.init.normal_(built.last.weight, std=0.3)
    return built.double().eval()


def double(context: Context) -> Context:
    return context.to("cpu", torch.float64)


def test_before_training_it_is_the_true_posterior_of_a_linear_world():
    """The closed form alone, of 20,000 poses: nats above the true posterior for any number of keypoints."""
    world = PoseWorld.person("h36m-16")
    rng = np.random.default_rng(0)
    factor = np.linalg.cholesky(world.covariance)

    def draw(M: int) -> tuple[torch.Tensor, torch.Tensor]:
        x = world.mean + (rng.standard_normal((M, 48)) @ factor.T).reshape(M, 16, 3)
        c = x[..., :2] + world.keypoint_sigma * rng.standard_normal((M, 16, 2))
        return torch.from_numpy(x), torch.from_numpy(c)

    x, c = draw(20_000)
    everything = torch.ones(x.shape[:2], dtype=torch.bool)
    fitted = AmortizedPosterior(world.joints, world.joints, components=1, width=8, origin="none").double()
    sigma = torch.full(x.shape[:2], float(world.keypoint_sigma), dtype=torch.float64)
    fitted.fit(x, Context(c, everything, sigma))
    x, c = draw(1000)
    for count in (0, 1, 4, 8, 12, 16):
        order = torch.from_numpy(rng.random((len(x), 16)).argsort(1).argsort(1))
        observed = order < count
        context = Context(c, observed, torch.where(observed, sigma[: len(x)], torch.inf))
        true = world.posterior(c.numpy(), observed.numpy()).log_prob(x.numpy())
        gap = true - fitted(context).log_prob(x).detach().numpy()
        assert abs(gap.mean()) < 0.15 + 3 * gap.std() / math.sqrt(len(x)), count


@pytest.mark.parametrize("components", [1, 3])
@torch.inference_mode()
def test_the_density_is_that_of_the_mixture(components):
    model = estimator(components=components)
    truth, context = images(5, seed=1)
    found = model(double(context))
    density = []
    for m in range(5):
        parts = []
        for c in range(components):
            to_normal = found.factors[m, c] @ found.factor[m]
            mean = found.centre[m] + torch.linalg.solve(found.factor[m], found.means[m, c])
            covariance = torch.linalg.inv(to_normal.T @ to_normal)
            z = model.coordinates(model.standardizer.poses(truth[m, None].double()))[0]
            normal = multivariate_normal(mean.numpy(), covariance.numpy())
            parts.append(float(found.log_weights[m, c]) + normal.logpdf(z.numpy()))
        scale = model.coordinates.scale * model.standardizer.pose_scale
        density.append(np.logaddexp.reduce(parts) - float(scale.log().sum()))
    np.testing.assert_allclose(found.log_prob(truth.double()).numpy(), density, rtol=1e-8)


def test_samples_have_the_moments_of_the_mixture():
    model = estimator(components=3)
    _, context = images(2, seed=2)
    with torch.inference_mode():
        found = model(double(context))
        drawn = found.sample(40_000, generator=torch.Generator().manual_seed(0))
        z = model.coordinates(model.standardizer.poses(drawn.flatten(0, 1))).view(40_000, 2, -1)
        inverse = torch.linalg.inv(found.factor)[:, None]
        means = found.centre[:, None] + (inverse @ found.means[..., None])[..., 0]
        factors = inverse @ torch.linalg.inv(found.factors)
        weights = found.log_weights.exp()[..., None]
        mean = (weights * means).sum(1)
        second = (weights[..., None] * (factors @ factors.mT + means[..., None] * means[..., None, :])).sum(1)
    error = (second.diagonal(dim1=-2, dim2=-1) - mean.square()).sqrt() / 200
    assert ((z.mean(0) - mean).abs() < 4.5 * error).all()
    covariance = second - mean[..., None] * mean[..., None, :]
    for m in range(2):
        np.testing.assert_allclose(
            np.cov(z[:, m].T.numpy()), covariance[m].numpy(), atol=0.05 * float(covariance.max())
        )


def test_a_temperature_multiplies_the_spread_about_each_mean():
    model = estimator(components=1)
    _, context = images(3, seed=3)
    with torch.inference_mode():
        found = model(double(context))
        one, two = (found.sample(50, generator=torch.Generator().manual_seed(0), temperature=t) for t in (1.0, 2.0))
        torch.testing.assert_close(two - found.mode(), 2 * (one - found.mode()))
        model.temperature.fill_(2.0)
        torch.testing.assert_close(model(double(context)).sample(50, generator=torch.Generator().manual_seed(0)), two)


def test_what_is_missing_is_never_read_and_what_is_hidden_counts_by_its_sigma():
    model = estimator(components=2)
    _, context = images(4, seed=4)
    missing = context.observed.clone()
    missing[:, 1] = False
    nothing = torch.where(missing, 3.0, torch.inf)
    keypoints = torch.where(missing[..., None], context.keypoints, torch.nan)
    truth = images(4, seed=4)[0].double()
    with torch.inference_mode():
        without = model(double(Context(context.keypoints, missing, nothing))).log_prob(truth)
        assert torch.equal(model(double(Context(keypoints, missing, nothing))).log_prob(truth), without)
        assert torch.equal(model(double(Context(context.keypoints, missing))).log_prob(truth), without)
        hidden = model(double(Context(context.keypoints, missing, torch.where(missing, 3.0, 25.0)))).log_prob(truth)
        assert (hidden != without).all()


def test_with_no_keypoint_it_is_the_prior_whatever_the_image():
    model = estimator(components=2)
    _, context = images(6, seed=5)
    blind = Context(context.keypoints, torch.zeros_like(context.observed))
    with torch.inference_mode():
        found = model(double(blind))
    torch.testing.assert_close(found.centre, torch.zeros_like(found.centre))
    torch.testing.assert_close(found.factor, torch.eye(found.factor.shape[-1]).double().expand_as(found.factor))
    torch.testing.assert_close(found.factors, found.factors[:1].expand_as(found.factors))


def test_a_person_may_stand_anywhere_in_the_image_for_the_linear_part():
    model = estimator(trained=False)
    _, context = images(3, seed=6)
    moved = Context(context.keypoints + torch.tensor([40.0, -70.0]), context.observed, context.sigma)
    with torch.inference_mode():
        torch.testing.assert_close(model(double(context)).centre, model(double(moved)).centre, atol=1e-5, rtol=0)


def test_weights_in_half_precision_give_nearly_the_same_hypotheses(tmp_path):
    model = estimator(components=2).float()
    _, context = images(3, seed=7)
    for half in (False, True):
        save_estimator(tmp_path / f"{half}.safetensors", model, half=half)
    sizes = [(tmp_path / f"{half}.safetensors").stat().st_size for half in (True, False)]
    assert sizes[0] < 0.75 * sizes[1]
    with torch.inference_mode():
        expected = model(context).sample(4, generator=torch.Generator().manual_seed(0))
        for half, tolerance in ((False, 0), (True, 2.0)):
            loaded = load_estimator(tmp_path / f"{half}.safetensors")
            drawn = loaded(context).sample(4, generator=torch.Generator().manual_seed(0))
            torch.testing.assert_close(drawn, expected, atol=tolerance, rtol=0)


def test_a_description_builds_the_same_estimator():
    model = estimator(components=3, dimensions=12, position=False, origin="none")
    assert describe(build(describe(model))) == describe(model)


def test_directions_in_which_poses_do_not_vary_are_left_out_when_asked_for():
    poses, context = images(300)
    poses[:, 1] = -poses[:, 0]
    with pytest.raises(PoseDataError, match=r"along 9 principal directions .* expected 12 \(model\.dimensions\)\.$"):
        AmortizedPosterior(NAMES, NAMES, width=4).fit(poses, context)
    model = AmortizedPosterior(NAMES, NAMES, width=4, dimensions=9)
    model.fit(poses, context)
    drawn = model(context).sample(5).detach()
    torch.testing.assert_close(drawn[:, :, 1], -drawn[:, :, 0], atol=0.1, rtol=0)
    with pytest.raises(PoseDataError, match=r"along 12 .* expected 9"):
        model.fit(*images(300))


def test_a_keypoint_that_few_images_have_is_named():
    poses, context = images(300)
    context.observed[12:, 2] = False
    with pytest.raises(PoseDataError, match=r"^keypoints: joint 2 is observed in 12 of 300 images; expected 13"):
        AmortizedPosterior(NAMES, NAMES, width=4).fit(poses, context)


def test_keypoints_relative_to_a_root_are_refused():
    with pytest.raises(PoseDataError, match=r"^model\.origin: root of an amortised posterior; expected observed or"):
        AmortizedPosterior(NAMES, NAMES, origin="root")


# --- training ---------------------------------------------------------------------------------------------------------

SMALL = {
    "model": {"kind": "amortized-posterior", "dimensions": 0, "width": 16, "residuals": 1, "components": 2},
    "data": {
        "validation_subjects": ["S3"],
        "views": 0,
        "mirror": True,
        "limb_exchange": 0.5,
        "missing_share": 0.25,
        "body_variation": 0.06,
    },
    "train": {
        "truth_noise": 5.0,
        "batch": 16,
        "average": 0.9,
        "weight_decay": 1e-4,
        "selection": "energy-score",
        "schedule": "cosine",
        "steps_per_epoch": 6,
        "epochs": 3,
        "precision": "half",
    },
}


def training(motion_file, folder, **how):
    return prepare(Config.from_table(SMALL), motion_file, folder, **how)


def test_a_training_that_was_stopped_goes_on_to_the_same_weights(motion_file, tmp_path):
    whole = training(motion_file, tmp_path / "whole")
    whole.run()
    first = training(motion_file, tmp_path / "parts")
    first.run(max_steps=8)
    second = training(motion_file, tmp_path / "parts", resume=True)
    second.run()
    assert second.step_losses == whole.step_losses
    for file in ("weights.safetensors", "losses.csv"):
        assert (tmp_path / "parts" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()


def test_what_is_saved_is_the_moving_average_that_was_validated(motion_file, tmp_path):
    run = training(motion_file, tmp_path / "run")
    average = None
    while not run.finished:
        run.run(max_steps=run.step + 1)
        weights = run.estimator.first.weight.detach()
        average = weights.clone() if average is None else 0.9 * average + 0.1 * weights
    torch.testing.assert_close(run.estimate.first.weight, average)
    assert not torch.equal(average, weights)
    saved = load_estimator(tmp_path / "run/weights.safetensors")
    assert round(float(saved.temperature), 6) in TEMPERATURES
    best = run.best["first.weight"]
    torch.testing.assert_close(saved.first.weight, best, atol=1e-3, rtol=1e-3)


@pytest.mark.slow
def test_training_lowers_the_loss_below_that_of_the_linear_part(motion_file, tmp_path):
    table = {**SMALL, "train": {**SMALL["train"], "steps_per_epoch": 150, "epochs": 1}}
    run = prepare(Config.from_table(table), motion_file, tmp_path / "run")
    run.run()
    losses = run.step_losses
    assert np.mean(losses[-20:]) < np.mean(losses[:5]) - 10


def test_a_hypothesis_does_not_depend_on_the_other_images():
    model = estimator(components=2)
    _, context = images(6, seed=8)
    with torch.inference_mode():
        whole, part = model(double(context)), model(double(context)[:2])
    torch.testing.assert_close(part.factors, whole.factors[:2])


class HeldOut:
    """Poses that deviate from the most probable ones so many times as much as the estimator says."""

    device = torch.device("cpu")

    def __init__(self, model: AmortizedPosterior, factor: float) -> None:
        truth, self.context = images(200, seed=9)
        with torch.inference_mode():
            mode = model(self.context).mode()
        self.truth = mode + factor * (truth - mode)

    def __len__(self) -> int:
        return len(self.truth)

    def batch(self, rows, generator):
        return self.context[rows], self.truth[rows]


@pytest.mark.parametrize("factor", [1.0, 1.4])
def test_validation_fits_the_temperature_that_the_held_out_poses_ask_for(factor):
    model = estimator(components=1, trained=False).float()
    losses = validation_losses(model, HeldOut(model, factor), TrainConfig(selection="energy-score"))
    assert abs(float(model.temperature) - factor) < 0.11
    assert set(losses) == {"loss"}
