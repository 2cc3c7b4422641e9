"""The cGNF against numbers of the released code, in every scenario (tests/fixtures/reference_models/README.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from posecal_models.data.standardizer import Standardizer
from posecal_models.estimators.cgnf.flow import FlowSize, GraphFlow
from posecal_models.estimators.cgnf.graph import human36m_graph
from posecal_models.estimators.cgnf.message_passing import EmbeddedContext
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.estimators.cgnf.released import from_released
from posecal_models.objectives import FlowLikelihood
from tests.models.random_flows import with_hip_keypoint

FOLDER = Path(__file__).parents[1] / "fixtures" / "reference_models"
TINY = FlowSize(blocks=2, hidden=8, context=4, embedding=16)
SCENARIOS = ("full", "part", "none", "prior", "part_root")
PRECISIONS = [(torch.float64, "_f64", 1e-10), (torch.float32, "", 5e-5)]


@pytest.fixture(scope="module")
def numbers() -> dict[str, np.ndarray]:
    with np.load(FOLDER / "tiny_io.npz") as file:
        return {name: file[name] for name in file.files}


@pytest.fixture(scope="module")
def state() -> dict[str, Tensor]:
    with np.load(FOLDER / "tiny_state.npz") as file:
        return {name: torch.from_numpy(file[name]) for name in file.files}


def flow_of(state: dict[str, Tensor], dtype: torch.dtype) -> GraphFlow:
    flow = GraphFlow(human36m_graph(), TINY, backward_weights=False, scale="sigmoid")
    flow.load_state_dict(from_released(state)[0])
    return flow.to(dtype)


def context_of(flow: GraphFlow, numbers: dict[str, np.ndarray], scenario: str, dtype: torch.dtype) -> EmbeddedContext:
    if scenario == "prior":
        return flow.empty_context()
    keypoints = torch.from_numpy(numbers["c"]).to(dtype)
    observed = torch.from_numpy(numbers[f"mask_{scenario.split('_')[0]}"])
    root = torch.from_numpy(numbers["r_nonzero"])[:, 0].to(dtype) if scenario == "part_root" else None
    return flow.embed(keypoints, observed, root)


def test_our_bones_are_the_reference_s_edges(numbers):
    graph = human36m_graph()
    parents, children = zip(*graph.bones, strict=True)
    assert sorted(zip(parents, children, strict=True)) == sorted(map(tuple, numbers["edges_xx_parent_child"].T))
    assert sorted(graph.next_to_root) == sorted(numbers["edges_root"][1])


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize(("dtype", "suffix", "tolerance"), PRECISIONS)
def test_density_latent_inverse_and_mode_equal_the_reference(numbers, state, scenario, dtype, suffix, tolerance):
    flow = flow_of(state, dtype)
    conditioned = flow.condition(context_of(flow, numbers, scenario, dtype))
    poses = torch.from_numpy(numbers["x"]).to(dtype)[:, None]
    latents = torch.from_numpy(numbers["z0"]).to(dtype).transpose(1, 2)
    z, log_determinant = conditioned.forward(poses)
    ours = {
        "z": z[:, 0],
        "logdet_node": log_determinant[:, 0],
        "logp_node": conditioned.log_prob_per_node(poses)[:, 0],
        "logp_pose": conditioned.log_prob_per_node(poses).sum((1, 2)),
        "samples": conditioned.inverse(latents).transpose(1, 2),
        "mode": conditioned.inverse(torch.zeros_like(poses))[:, 0],
    }
    for name, value in ours.items():
        expected = numbers[f"{scenario}/{name}{suffix}"]
        # the log density of a pose is a sum of 16 nodes and of size 75: 16 roundings more in single precision
        scale = 16 if name == "logp_pose" and dtype == torch.float32 else 1
        np.testing.assert_allclose(
            value.detach().numpy(), expected, rtol=0, atol=tolerance * scale, err_msg=f"{scenario}/{name}"
        )


@pytest.mark.parametrize("scenario", ["full", "part"])
@pytest.mark.parametrize(("dtype", "suffix", "tolerance"), PRECISIONS)
def test_the_embedding_of_observed_keypoints_equals_the_reference(numbers, state, scenario, dtype, suffix, tolerance):
    flow = flow_of(state, dtype)
    observed = torch.from_numpy(numbers[f"mask_{scenario}"])
    embedded = flow.embedding(torch.from_numpy(numbers["c"]).to(dtype), observed)
    expected = numbers[f"{scenario}/embedding{suffix}"]
    np.testing.assert_allclose(embedded[observed].detach().numpy(), expected[observed.numpy()], rtol=0, atol=tolerance)


def test_nothing_observed_equals_the_prior_bit_for_bit(numbers, state):
    flow = flow_of(state, torch.float64)
    poses = torch.from_numpy(numbers["x"]).double()[:, None]
    none, prior = (
        flow.condition(context_of(flow, numbers, scenario, torch.float64)).log_prob_per_node(poses)
        for scenario in ("none", "prior")
    )
    assert torch.equal(none, prior)


def test_the_actnorms_start_equals_the_reference(numbers, state):
    flow = flow_of(state, torch.float32)
    poses = torch.from_numpy(numbers["x"])[:, None]
    embedded = context_of(flow, numbers, "part", torch.float32)
    flow.initialise_actnorm(poses, embedded)
    for block in range(2):
        for name in ("log_scale", "shift"):
            ours = getattr(flow.couplings[block], name).detach()
            np.testing.assert_allclose(ours.numpy(), numbers[f"actnorm_init/{block}/{name}"], rtol=0, atol=5e-6)
    ours = flow.condition(embedded).log_prob_per_node(poses)[:, 0].detach()
    np.testing.assert_allclose(ours.numpy(), numbers["actnorm_init/logp_node"], rtol=0, atol=5e-5)


def training_losses(numbers, state, dtype, **options):
    """Losses and gradients of our objective on the reference's batch, by the names of our parameters."""
    estimator = CGNF(TINY, origin="root", backward_weights=False, scale="sigmoid")
    estimator.flow.load_state_dict(from_released(state)[0])
    estimator.standardizer = Standardizer.released(16)
    estimator = estimator.to(dtype)
    standardizer = estimator.standardizer
    standardizer.pose_scale.fill_(1 / 0.0036)
    keypoints = torch.from_numpy(numbers["c"]).to(dtype) * standardizer.keypoint_scale
    context = with_hip_keypoint(keypoints, torch.from_numpy(numbers["mask_part"]))
    truth = standardizer.millimetres(torch.from_numpy(numbers["x"]).to(dtype))
    losses = FlowLikelihood(estimator, per_node=True, **options)(context, truth)
    losses["loss"].backward()
    gradients = {name: p.grad for name, p in estimator.flow.named_parameters()}
    return {name: loss.detach() for name, loss in losses.items()}, gradients


def reference_gradients(numbers, prefix):
    """The reference's gradients by our names."""
    found = {
        n.removeprefix(f"{prefix}/"): torch.from_numpy(a) for n, a in numbers.items() if n.startswith(f"{prefix}/")
    }
    return from_released(found)[0]


@pytest.mark.parametrize(("dtype", "suffix", "tolerance"), PRECISIONS)
def test_losses_equal_the_reference(numbers, state, dtype, suffix, tolerance):
    losses, _ = training_losses(numbers, state, dtype, sample_weight=0.1)
    nodes = 16
    np.testing.assert_allclose(losses["posterior"] / nodes, numbers[f"train/post{suffix}"], rtol=0, atol=tolerance)
    np.testing.assert_allclose(losses["prior"] / nodes, numbers[f"train/prior{suffix}"], rtol=0, atol=tolerance)
    # 511 mm from coordinates of size 1: seven digits in single precision are 1e-4 mm
    millimetres = 1e-10 * 1000 if dtype == torch.float64 else 5e-4
    np.testing.assert_allclose(losses["mode"], numbers[f"train/mode_err_3d_mm{suffix}"], rtol=0, atol=millimetres)
    expected = numbers[f"train/loss_nll{suffix}"] + 0.1 * numbers[f"train/mode_err_3d_mm{suffix}"]
    np.testing.assert_allclose(losses["loss"], expected, rtol=0, atol=max(tolerance, millimetres))


def test_the_released_sample_loss_is_named_pairs(numbers, state):
    losses, _ = training_losses(numbers, state, torch.float64, sample_weight=0.1, sample_loss="pairs")
    np.testing.assert_allclose(losses["mode"], numbers["train/mode_err_published_pairs_mm_f64"], rtol=0, atol=1e-7)
    np.testing.assert_allclose(losses["loss"], numbers["train/loss_published_f64"], rtol=0, atol=1e-7)


@pytest.mark.parametrize(("prefix", "options"), [("grad_nll", {}), ("grad_full3d", {"sample_weight": 0.1})])
@pytest.mark.parametrize(("dtype", "suffix", "tolerance"), PRECISIONS)
def test_gradients_equal_the_reference(numbers, state, prefix, options, dtype, suffix, tolerance):
    _, gradients = training_losses(numbers, state, dtype, **options)
    expected = reference_gradients(numbers, f"{prefix}{suffix}")
    assert sorted(expected) == sorted(gradients)
    whole = float(numbers[f"{prefix}{suffix}_norm"])
    for name, gradient in gradients.items():
        # entries are compared on the scale of the whole gradient's norm, as rounding acts on sums of such entries
        np.testing.assert_allclose(
            gradient.numpy(), expected[name].numpy(), rtol=0, atol=tolerance * max(1.0, whole), err_msg=name
        )
    norm = torch.sqrt(sum(g.double().square().sum() for g in gradients.values()))
    np.testing.assert_allclose(norm, whole, rtol=tolerance)
