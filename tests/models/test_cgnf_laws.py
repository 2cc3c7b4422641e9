"""Properties of a cGNF with random weights, against the naive twin, autograd, and itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.estimators.cgnf import flow as flows
from posecal_models.estimators.cgnf.flow import SIZES, FlowSize, GraphFlow
from posecal_models.estimators.cgnf.graph import PoseGraph, human36m_graph
from posecal_models.estimators.cgnf.model import CGNF
from tests.models import plain_cgnf
from tests.models.parameter_counts import PUBLISHED, parameter_table
from tests.models.random_flows import POSES, SAMPLES, SIZE, inputs, random_flow, repeat_per_sample

OPTIONS = [{"backward_weights": backward, "scale": scale} for backward in (False, True) for scale in ("sigmoid", "exp")]


@pytest.mark.parametrize("options", OPTIONS)
def test_density_and_gradients_equal_the_naive_twin(options):
    flow, (keypoints, observed, poses) = random_flow(**options), inputs()
    weights = dict(flow.named_parameters())
    root = torch.zeros(1, 3, dtype=torch.float64)
    plain = plain_cgnf.log_prob(
        weights,
        poses.flatten(0, 1),
        *repeat_per_sample(keypoints, observed),
        root,
        human36m_graph().parents,
        scale=options["scale"],
    )
    ours = flow.condition(flow.embed(keypoints, observed)).log_prob_per_node(poses).sum(-1).flatten()
    np.testing.assert_allclose(ours.detach(), plain.detach(), rtol=1e-12)

    weigh = torch.linspace(-1, 2, POSES * SAMPLES, dtype=torch.float64)
    expected = torch.autograd.grad((plain * weigh).sum(), list(weights.values()), materialize_grads=True)
    found = torch.autograd.grad((ours * weigh).sum(), list(weights.values()), materialize_grads=True)
    for name, one, other in zip(weights, found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("options", OPTIONS)
def test_samples_and_their_gradients_equal_the_naive_twin(options):
    flow, (keypoints, observed, latents) = random_flow(**options), inputs()
    weights = dict(flow.named_parameters())
    root = torch.zeros(1, 3, dtype=torch.float64)
    plain = plain_cgnf.inverse(
        weights,
        latents.flatten(0, 1),
        *repeat_per_sample(keypoints, observed),
        root,
        human36m_graph().parents,
        scale=options["scale"],
    ).view_as(latents)
    ours = flow.condition(flow.embed(keypoints, observed)).inverse(latents)
    np.testing.assert_allclose(ours.detach(), plain.detach(), rtol=1e-11, atol=1e-11)

    weigh = torch.linspace(-1, 2, latents.numel(), dtype=torch.float64).view_as(latents)
    expected = torch.autograd.grad((plain * weigh).sum(), list(weights.values()), materialize_grads=True)
    found = torch.autograd.grad((ours * weigh).sum(), list(weights.values()), materialize_grads=True)
    for name, one, other in zip(weights, found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8, err_msg=name)


@pytest.mark.parametrize("at_once", [1, 3, 5, 12, 100])
def test_parts_change_no_number(monkeypatch, at_once):
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    conditioned = flow.condition(flow.embed(keypoints, observed))
    whole = (*conditioned.forward(poses), conditioned.inverse(poses))  # with gradients there are no parts
    monkeypatch.setitem(flows.ROWS_AT_ONCE, "cpu", at_once)
    with torch.no_grad():
        parts = (*conditioned.forward(poses), conditioned.inverse(poses))
    for one, other in zip(parts, whole, strict=True):
        np.testing.assert_allclose(one, other.detach(), rtol=1e-12, atol=1e-12)


def test_no_samples_are_no_samples():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    with torch.no_grad():
        assert flow.condition(flow.embed(keypoints, observed)).inverse(poses[:, :0]).shape == (POSES, 0, 16, 3)


@pytest.mark.parametrize("back", [False, True])
def test_a_root_of_each_pose_and_its_gradients_equal_the_naive_twin(back):
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    observed[2] = False
    root = torch.randn(POSES, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64, requires_grad=True)
    conditioned = flow.condition(flow.embed(keypoints, observed, root))
    ours = conditioned.inverse(poses) if back else conditioned.log_prob_per_node(poses).sum(-1)
    twin = plain_cgnf.inverse if back else plain_cgnf.log_prob
    weights = dict(flow.named_parameters())
    every = poses.flatten(0, 1), *repeat_per_sample(keypoints, observed), root.repeat_interleave(SAMPLES, 0)
    naive = twin(weights, *every, human36m_graph().parents, scale="exp").view_as(ours)
    torch.testing.assert_close(ours, naive, rtol=1e-10, atol=1e-12)
    wanted = [root, *weights.values()]
    one, two = (
        torch.autograd.grad(found.square().sum(), wanted, retain_graph=True, materialize_grads=True)
        for found in (ours, naive)
    )
    torch.testing.assert_close(one, two, rtol=1e-9, atol=1e-11)


def test_many_poses_may_share_the_keypoints_of_one():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    found = []
    for of_all in (False, True):
        seen = (t[:1].expand(POSES, *t.shape[1:]) if of_all else t[:1] for t in (keypoints, observed))
        density = flow.condition(flow.embed(*seen)).log_prob_per_node(poses)
        found.append((density, *torch.autograd.grad(density.square().sum(), flow.parameters(), materialize_grads=True)))
    torch.testing.assert_close(*found, rtol=1e-9, atol=1e-11)


def test_keypoints_or_roots_of_another_number_of_poses_are_refused():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    with pytest.raises(PoseDataError, match=r"flow: keypoints of 7 poses and 3 poses; expected as many\."):
        flow.condition(flow.embed(keypoints, observed)).forward(poses[:3])
    with pytest.raises(PoseDataError, match=r"flow: roots of 9 poses, keypoints of 7; expected as many\."):
        flow.embed(keypoints, observed, torch.zeros(9, 3, dtype=torch.float64))


@pytest.mark.parametrize("options", OPTIONS)
def test_the_log_determinant_is_that_of_autograd_s_jacobian(options):
    flow, (keypoints, observed, poses) = random_flow(**options), inputs()
    conditioned = flow.condition(flow.embed(keypoints[:1], observed[:1]))
    pose = poses[:1, :1]
    _, log_determinant = conditioned.forward(pose)
    jacobian = torch.autograd.functional.jacobian(lambda p: conditioned.forward(p)[0], pose)
    expected = torch.linalg.slogdet(jacobian.view(48, 48)).logabsdet
    np.testing.assert_allclose(log_determinant.sum().detach(), expected.detach(), rtol=1e-12)


@pytest.mark.slow
def test_gradients_of_the_pose_equal_finite_differences():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    conditioned = flow.condition(flow.embed(keypoints[:2], observed[:2]))
    pose = poses[:2, :1].clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda p: conditioned.log_prob_per_node(p).sum(), pose)
    assert torch.autograd.gradcheck(lambda p: conditioned.inverse(p), pose)


@pytest.mark.parametrize("size", ["small", pytest.param("xlarge", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("scale", "reach"), [("sigmoid", 0.1), ("exp", 0.02)])
def test_inverse_of_forward_is_the_pose_within_1e_4_in_single_precision(size, scale, reach):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        flow = GraphFlow(human36m_graph(), SIZES[size], scale=scale)
        for block in flow.couplings:
            block.second.pool.weight.data.uniform_(-reach, reach)
    keypoints, observed, poses = (tensor if tensor.dtype == torch.bool else tensor.float() for tensor in inputs())
    with torch.no_grad():
        embedded = flow.embed(keypoints, observed)
        flow.initialise_actnorm(poses, embedded)
        conditioned = flow.condition(embedded)
        latents, log_determinant = conditioned.forward(poses)
        back = conditioned.inverse(latents)
    assert float(log_determinant.abs().mean()) > 0.05  # it does move
    np.testing.assert_allclose(back, poses, rtol=0, atol=1e-4)


@pytest.mark.parametrize("stored", [0.0, 1e9, math.nan, math.inf])
def test_what_is_stored_for_a_missing_keypoint_changes_nothing(stored):
    estimator = CGNF(SIZE).double()
    estimator.flow = random_flow()
    keypoints, observed, poses = inputs()
    other = torch.where(observed[..., None], keypoints, stored)
    one, two = (estimator(Context(k, observed)).log_prob(poses[:, 0]) for k in (keypoints, other))
    assert torch.equal(one, two)


def test_a_keypoint_that_is_observed_changes_the_density():
    estimator = CGNF(SIZE).double()
    estimator.flow = random_flow()
    keypoints, observed, poses = inputs()
    more = observed.clone()
    more[:, 3] = ~more[:, 3]
    one, two = (estimator(Context(keypoints, o)).log_prob(poses[:, 0]) for o in (observed, more))
    assert float((one - two).detach().abs().min()) > 1e-6


def test_the_prior_is_nothing_observed_bit_for_bit():
    estimator = CGNF(SIZE).double()
    estimator.flow = random_flow()
    keypoints, observed, poses = inputs()
    hidden = Context(keypoints, observed).without_keypoints()
    one, two = estimator(hidden).log_prob(poses[:, 0]), estimator.prior(POSES).log_prob(poses[:, 0])
    assert torch.equal(one, two)


def test_a_density_in_mm_integrates_to_one():
    """One joint, by importance sampling: E over samples of q of p/q with a broad Gaussian q; 4 standard errors."""
    graph = PoseGraph(("only",), (-1,))
    estimator = CGNF(FlowSize(blocks=3, hidden=6, context=3, embedding=5), graph).double()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for parameter in estimator.flow.parameters():
            parameter.data = torch.randn_like(parameter) * 0.12
    estimator.standardizer.pose_scale.fill_(200.0)
    estimator.standardizer.pose_mean.fill_(30.0)
    many, wide = 200_000, 700.0
    generator = torch.Generator().manual_seed(0)
    poses = torch.randn(many, 1, 3, generator=generator, dtype=torch.float64) * wide
    context = Context(torch.ones(many, 1, 2, dtype=torch.float64), torch.ones(many, 1, dtype=torch.bool))
    with torch.no_grad():
        log_density = estimator(context).log_prob(poses)
    log_proposal = -0.5 * (poses / wide).square().sum((1, 2)) - 3 * math.log(wide * math.sqrt(2 * math.pi))
    weights = (log_density - log_proposal).exp()
    assert abs(float(weights.mean()) - 1) < 4 * float(weights.std()) / math.sqrt(many)


def test_left_and_right_are_alike_to_the_prior():
    """The graph is symmetric and its nodes share their weights: exchanging the legs exchanges nothing else."""
    estimator = CGNF(SIZE).double()
    estimator.flow = random_flow()
    _, _, poses = inputs()
    mirrored = [3, 4, 5, 0, 1, 2, *range(6, 10), 13, 14, 15, 10, 11, 12]
    one, two = (estimator.prior(POSES).log_prob(p) for p in (poses[:, 0], poses[:, 0][:, mirrored]))
    np.testing.assert_allclose(one.detach(), two.detach(), rtol=1e-12)


def test_flows_of_two_dimensions_invert_too():
    chain = PoseGraph(("x1", "x2", "x3"), (-1, 0, 1))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        flow = GraphFlow(chain, SIZE, dimensions=2).double()
        for parameter in flow.parameters():
            parameter.data = torch.randn_like(parameter) * 0.12
    poses = torch.randn(4, 3, 3, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    conditioned = flow.condition(flow.empty_context())
    np.testing.assert_allclose(conditioned.inverse(conditioned.forward(poses)[0]).detach(), poses, atol=1e-12)


@pytest.mark.parametrize("size", PUBLISHED)
def test_used_and_unused_parameters_make_up_the_published_number(size):
    table = parameter_table(SIZES[size])
    assert table.published == PUBLISHED[size]
    flow = GraphFlow(human36m_graph(), SIZES[size], backward_weights=False)
    held = {name: parameter.numel() for name, parameter in flow.named_parameters()}
    times_zero = sum(n for name, n in held.items() if name.endswith(("first.from_root.weight", "next_root.weight")))
    assert times_zero == table.times_zero
    assert sum(held.values()) == table.used + table.times_zero


def test_the_small_model_s_parts_are_those_counted_by_hand():
    table = parameter_table(SIZES["small"])
    # 10 blocks: 2·100 + 100 and 100·100 + 100 from child to parent; 2 (100·100 + 100) last updates; 2·3·100 of the root
    assert table == (540_546, 6_000, 10 * (300 + 10_100), 10 * 2 * 10_100)
    assert table.backward + table.last_updates == 306_000


def test_every_used_parameter_gets_a_gradient_and_the_root_s_weights_get_zero():
    flow, (keypoints, observed, poses) = random_flow(spread=0.5, scale="sigmoid"), inputs()
    flow.condition(flow.embed(keypoints, observed)).log_prob_per_node(poses).sum().backward()
    for name, parameter in flow.named_parameters():
        if name.endswith(("from_root.weight", "next_root.weight")) and ".first." in name:
            assert not parameter.grad.any(), name
        else:
            assert parameter.grad.any(), name


def test_an_untrained_flow_is_the_standard_normal():
    estimator = CGNF(SIZES["tiny"], scale="sigmoid").double()
    keypoints, observed, poses = inputs()
    ours = estimator.flow.condition(estimator.flow.embed(keypoints, observed)).log_prob_per_node(poses).sum(-1)
    # the sigmoid scale starts at sigmoid(2) + 0.001, for each of 6 blocks and 16 nodes; each coordinate is moved twice
    stretch = 1 / (1 + math.exp(-2)) + 1e-3
    latents = poses * stretch**2
    expected = -0.5 * (latents.square() + math.log(2 * math.pi)).sum((2, 3)) + 6 * 16 * math.log(stretch)
    np.testing.assert_allclose(ours.detach(), expected, rtol=1e-9)


def test_a_graph_refuses_a_parent_that_is_not_there():
    with pytest.raises(PoseDataError, match="joint 1 has parent 5; expected another joint below 2"):
        PoseGraph(("a", "b"), (-1, 5))


def test_a_graph_refuses_its_root_as_a_node():
    with pytest.raises(PoseDataError, match="Hip is the root and no node"):
        PoseGraph.from_joints(("Hip", "RHip"))


def test_a_stretch_too_small_for_its_type_has_its_exact_log():
    """A last update that says u = -800 everywhere: exp(-800) is 0 in double, and its log is still -800 nats."""
    flow, (keypoints, observed, poses) = random_flow(scale="exp"), inputs()
    with torch.no_grad():
        for index, block in enumerate(flow.couplings):
            block.second.pool.weight.zero_()
            block.second.pool.bias.copy_(torch.tensor([0.0, -800.0 if index == 0 else 0.0]))
    poses = poses.requires_grad_()
    _, log_determinant = flow.condition(flow.embed(keypoints, observed)).forward(poses)
    expected = sum(block.log_scale.sum() for block in flow.couplings) - 800
    np.testing.assert_allclose(log_determinant.detach(), expected.expand_as(log_determinant).detach(), rtol=1e-12)
    (gradient,) = torch.autograd.grad(log_determinant.sum(), flow.couplings[0].second.pool.bias)
    assert float(gradient[1]) == log_determinant.numel()
