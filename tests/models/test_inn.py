"""The invertible network: counts, units, inversion, losses against their formulas, its critic, and its training."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models import adversarial
from posecal_models.adversarial import Critic, InvertibleLosses, energy_score, kernel_discrepancy
from posecal_models.checkpoint import load_estimator
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.distributed import ProcessGroup
from posecal_models.estimators.inn import INN, PoseUnits
from posecal_models.preparation import prepare

JOINTS = ("RHip", "RKnee", "LHip", "Neck/Nose", "Thorax", "Head")
SETTINGS = ["model.width=16", "data.views=1", "train.batch=44", "train.hypotheses=6", "train.learning_rate=0.003"]


@pytest.fixture
def _small_critic(monkeypatch):
    monkeypatch.setattr(adversarial, "_CRITIC_WIDTHS", (10, 20))


def small(variant: str = "released") -> INN:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return INN(JOINTS, JOINTS, width=16, variant=variant).double()


def inputs(poses: int = 9) -> tuple[Context, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    keypoints = 500 + 80 * torch.randn(poses, 6, 2, generator=generator).double()
    sigma = torch.full((poses, 6), 3.0).double()
    sigma[::2, 4] = 25
    return Context(keypoints, sigma < 5, sigma), 200 * torch.randn(poses, 6, 3, generator=generator).double()


def test_it_and_its_critic_have_the_published_numbers_of_parameters():
    model = INN()
    assert sum(p.numel() for p in model.parameters()) == 2_157_176
    assert sum(p.numel() for p in Critic(model.joints, model.standardizer).parameters()) == 2_404_401
    assert len(model.conditioned) == 13
    assert not {"Hip", "RHip", "LHip"} & set(model.conditioned)
    neck = INN(keypoints=model.joints)  # where the data have no keypoint of the hip
    assert sum(p.numel() for p in neck.parameters()) == 2_157_176


@torch.no_grad()
def test_the_map_is_inverted_to_rounding():
    model, (context, truth) = INN().double(), inputs(5)
    keypoints = 300 + 50 * torch.randn(5, 16, 2, generator=torch.Generator().manual_seed(0)).double()
    context = Context(keypoints, torch.ones(5, 16, dtype=torch.bool))
    truth = 300 * torch.randn(5, 16, 3, generator=torch.Generator().manual_seed(1)).double()
    _, condition = model.inputs(context)
    poses = model.standardizer.poses(truth)
    latents, projected = model.transform(poses, condition)
    assert (latents.shape, projected.shape) == ((5, 16), (5, 32))
    assert float((latents - poses[:, :16]).abs().min()) > 0
    torch.testing.assert_close(model.inverse(latents, projected, condition), poses, rtol=0, atol=1e-6)


@torch.no_grad()
def test_hypotheses_map_to_the_detected_keypoints_and_normal_latents():
    model, (context, _) = small().eval(), inputs()
    drawn = model(context).sample(7, generator=torch.Generator().manual_seed(3))
    assert drawn.shape == (7, 9, 6, 3)
    torch.testing.assert_close(drawn[:, :, 0] + drawn[:, :, 2], torch.zeros(7, 9, 3).double())  # hips about the root
    keypoints, condition = model.inputs(context)
    latents = torch.randn(7, 9, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    numbers = model.inverse(latents, keypoints, condition)
    torch.testing.assert_close(drawn, 1000 * model.standardizer.metres(numbers))
    back, projected = model.transform(numbers, condition)
    torch.testing.assert_close(projected, keypoints.expand(7, -1, -1), rtol=0, atol=1e-9)
    torch.testing.assert_close(back, latents, rtol=0, atol=1e-9)
    middle = model.inverse(torch.zeros(1, 9, 6).double(), keypoints, condition)
    torch.testing.assert_close(model(context).mode(), 1000 * model.standardizer.metres(middle)[0])


def test_permutations_are_numpy_s_of_the_seeds_0_to_7():
    for seed, block in enumerate(INN(width=4).blocks):
        np.testing.assert_array_equal(block.order, np.random.RandomState(seed).permutation(48))


@torch.no_grad()
def test_a_coupling_scales_and_shifts_each_half_by_the_other():
    block, x = small().blocks[3], torch.linspace(-1, 1, 36).view(2, 18).double()
    condition = torch.linspace(0, 1, 112).view(2, 56).double()

    def net(part, half):
        hidden = torch.relu(half @ part.first.weight.T + part.first.bias + condition @ part.condition.weight.T)
        numbers = hidden @ part.last.weight.T + part.last.bias
        return torch.exp(2 * 0.636 * torch.atan(numbers[:, :9] / 2)), numbers[:, 9:]

    scale, shift = net(block.second, x[:, 9:])
    one = scale * x[:, :9] + shift
    scale, shift = net(block.first, one)
    whole = torch.cat([one, scale * x[:, 9:] + shift], dim=1)
    torch.testing.assert_close(block(x, condition), whole[:, block.order])


def test_poses_are_in_metres_with_y_up_and_all_x_first():
    units = PoseUnits(("RHip", "LHip", "Head")).double()
    pose = torch.tensor([[[-100.0, 0, 0], [100, 30, 0], [0, -630, 60]]]).double()
    numbers = units.poses(pose)
    expected = [[-0.1, 0.1, 0, -0.2, -0.23, 0.43, 0.02, 0.02, -0.04]]
    torch.testing.assert_close(numbers, torch.tensor(expected).double())
    torch.testing.assert_close(1000 * units.metres(numbers), pose - torch.tensor([0.0, 15, 0]).double())


def test_keypoints_are_centred_and_divided_by_their_deviation():
    units = PoseUnits(("RHip", "LHip")).double()
    context = Context(torch.tensor([[[100.0, 50], [300, 250]]]).double(), torch.ones(1, 2, dtype=torch.bool))
    torch.testing.assert_close(units.keypoints(context), torch.tensor([[-1.0, 1, 1, -1]]).double())


def test_a_heatmap_s_deviation_is_that_of_the_crop_and_doubled_where_it_is_large():
    model = small()
    keypoints = torch.zeros(1, 6, 2).double()
    keypoints[0, 0] = torch.tensor([256.0, 100])  # a crop of 320 pixels: 5 of them are one of the heatmap
    sigma = torch.tensor([[9.0, 0.5, 9.0, 9.0, 15, 100]]).double()
    assert model.conditioned == ["RKnee", "Thorax", "Head"]
    found = model.heatmap_sigma(Context(keypoints, sigma < 5, sigma))
    torch.testing.assert_close(found, torch.tensor([[0.2, 6.0, 20.0]]).double())


@torch.no_grad()
def test_the_detector_s_sigma_changes_what_is_drawn():
    model, (context, _) = small(), inputs()
    other = Context(context.keypoints, context.observed, 2 * context.sigma)
    drawn = [model(c).sample(2, generator=torch.Generator().manual_seed(0)) for c in (context, other)]
    assert not torch.allclose(*drawn)


def test_the_density_is_refused_with_the_reason():
    context, truth = inputs()
    with pytest.raises(PoseDataError, match=r"log_prob of 9 poses: poses of an INN project exactly onto the keypoints"):
        small()(context).log_prob(truth)


def test_too_many_keypoints_are_refused():
    with pytest.raises(PoseDataError, match="INN: 6 coordinates of poses and 6 of keypoints"):
        INN(("RHip", "LHip"), ("RHip", "LHip", "Head"))


@torch.no_grad()
@pytest.mark.usefixtures("_small_critic")
def test_the_losses_are_those_of_their_formulas():
    model, (context, truth) = small().eval(), inputs()
    for block in model.blocks:
        block.first.last.weight.mul_(20)
    objective = InvertibleLosses(model, 8)
    noise = objective.noise(truth, torch.Generator().manual_seed(5))
    assert noise.shape == (10, 9, 6)
    losses = objective(context, truth, noise)
    keypoints, condition = model.inputs(context)
    poses = model.standardizer.poses(truth)
    latents, projected = model.transform(poses, condition)
    drawn = torch.stack([model.inverse(z, keypoints, condition) for z in noise[:8]])
    metres, target = model.standardizer.metres(drawn), model.standardizer.metres(poses)
    parts = [(projected - keypoints).abs().mean(), (model.inverse(latents, keypoints, condition) - poses).abs().mean()]
    parts.append(kernel_discrepancy(torch.cat([latents, projected], 1), torch.cat([noise[8], keypoints], 1)))
    best = []
    for m in range(9):
        errors = (metres[:, m] - target[m]).norm(dim=-1).sum(-1)
        mean = metres[errors.argsort()[:5], m].mean(0)
        best.append((mean - target[m]).abs().sum() / (3 * 7))
    spread, sigma = [], 0.005 * model.heatmap_sigma(context)
    for k, joint in enumerate((1, 4, 5)):
        xy = metres[:, :, joint, :2].permute(1, 2, 0).numpy()
        for m in range(9):
            found = np.cov(xy[m], bias=True)
            less = np.maximum(float(sigma[m, k]) ** 2 - np.diag(found), 0)
            root = np.sqrt((less**2).sum() + found[0, 1] ** 2)
            spread.append(root if sigma[m, k] > 2.1 * 0.005 else 0)
    assert np.mean(spread) > 0
    np.testing.assert_allclose(losses["best"], np.mean(best), rtol=1e-9)
    np.testing.assert_allclose(losses["spread"], np.mean(spread), rtol=1e-6)
    judged = -objective.critic(drawn[0]).mean()
    total = parts[0] + 4 * parts[1] + 10 * parts[2] + 4 * np.mean(best) + 750 * np.mean(spread) + judged
    np.testing.assert_allclose(losses["loss"], total, rtol=1e-6)
    nearest = 1000 * (metres - target).norm(dim=-1).mean(-1).amin(0).mean()
    np.testing.assert_allclose(losses["selection"], nearest, rtol=1e-9)
    model.variant = "repaired"
    repaired = InvertibleLosses(model, 8)(context, truth, noise)
    energy = energy_score(metres.flatten(2), target.flatten(1)).mean()
    np.testing.assert_allclose(repaired["loss"], parts[0] + 4 * parts[1] + 10 * parts[2] + energy, rtol=1e-6)
    assert "selection" not in repaired


def test_the_energy_score_is_that_of_its_formula():
    generator = torch.Generator().manual_seed(0)
    hypotheses, truth = (
        torch.randn(7, 4, 6, generator=generator).double(),
        torch.randn(4, 6, generator=generator).double(),
    )
    within = (hypotheses[:, None] - hypotheses).norm(dim=-1).sum((0, 1)) / (2 * 7 * 6)
    expected = (hypotheses - truth).norm(dim=-1).mean(0) - within
    torch.testing.assert_close(energy_score(hypotheses, truth), expected)


@pytest.mark.usefixtures("_small_critic")
def test_the_critic_learns_to_tell_true_poses_from_made_ones():
    model = small()
    context, truth = inputs(11 * 11)
    truth = truth.abs()
    objective = InvertibleLosses(model, 2)
    noise = objective.noise(truth, torch.Generator().manual_seed(0))
    before = {name: p.detach().clone() for name, p in model.named_parameters()}
    for _ in range(10):
        objective.before_step(context, truth, noise, 1e-3)
    with torch.no_grad():
        made = model.inverse(noise[0], *model.inputs(context))
        difference = objective.critic(model.standardizer.poses(truth)).mean() - objective.critic(made).mean()
    assert float(difference) > 0.1
    assert all(torch.equal(before[name], p) for name, p in model.named_parameters())


def test_a_batch_that_has_no_eleven_parts_is_refused():
    context, truth = inputs(20)
    objective = InvertibleLosses(small(), 2)
    with pytest.raises(PoseDataError, match=r"train\.batch: 20 of an INN with a critic; expected a multiple of 11"):
        objective.before_step(context, truth, objective.noise(truth, torch.Generator()), 1e-4)


@pytest.mark.usefixtures("_small_critic")
@pytest.mark.parametrize("variant", [pytest.param("released", marks=pytest.mark.slow), "repaired"])
def test_a_training_lowers_its_loss_and_its_weights_come_back(motion_file, tmp_path, variant):
    settings = [*SETTINGS, f"model.variant={variant}", "train.epochs=5", 'data.validation_subjects=["S3"]']
    run = prepare(Config.load("wehrbein-inn").with_changes(settings), motion_file, tmp_path / "run")
    run.run()
    rows = np.genfromtxt(tmp_path / "run/losses.csv", delimiter=",", names=True)
    assert rows["validation_loss"][-1] < rows["validation_loss"][0]
    images = run.validation.batch(torch.arange(3), torch.Generator().manual_seed(1))[0]
    back = load_estimator(tmp_path / "run/weights.safetensors")
    run.estimator.load_state_dict(run.best)
    one, two = (e(images).sample(4, generator=torch.Generator().manual_seed(3)) for e in (run.estimator.eval(), back))
    assert torch.equal(one, two)
    assert back.variant == variant


@pytest.mark.slow
@pytest.mark.usefixtures("_small_critic")
def test_a_training_that_was_stopped_goes_on_with_its_critic(motion_file, tmp_path):
    def training(folder, resume=False):
        config = Config.load("wehrbein-inn").with_changes([*SETTINGS, "train.epochs=2"])
        return prepare(config, motion_file, tmp_path / folder, resume=resume)

    whole = training("whole")
    whole.run()
    training("parts").run(max_steps=3)
    second = training("parts", resume=True)
    second.run()
    assert second.step_losses == whole.step_losses
    for name, tensor in whole.objective.state().items():
        assert torch.equal(second.objective.state()[name], tensor), name


@pytest.mark.usefixtures("_small_critic")
def test_a_step_bounds_each_number_of_the_gradient_and_gives_the_loss_the_detector_s_sigma(motion_file, tmp_path):
    config = Config.load("wehrbein-inn").with_changes([*SETTINGS, "train.clip=1e-4"])
    run = prepare(config, motion_file, tmp_path / "run")
    seen = []
    run.objective.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0].sigma))
    run.one_step()
    largest = [float(p.grad.abs().max()) for p in run.parameters.values()]
    np.testing.assert_allclose(max(largest), 1e-4, rtol=1e-6)
    assert min(largest) > 0
    assert seen[0].unique().tolist() == [3.0, 25.0]
    assert run.optimizer.defaults["betas"] == (0.5, 0.9)


def test_a_critic_is_of_one_process(motion_file, tmp_path):
    config = Config.load("wehrbein-inn").with_changes(SETTINGS)
    with pytest.raises(PoseDataError, match="processes: 2 of a training with a critic; expected one"):
        prepare(config, motion_file, tmp_path / "run", processes=ProcessGroup(0, 2))
