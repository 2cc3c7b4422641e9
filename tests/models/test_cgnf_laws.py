"""What must hold for a cGNF with any weights: against the naive twin, autograd, and itself."""

from __future__ import annotations

import gc
import math
import weakref

import numpy as np
import pytest
import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.cgnf import flow as flows
from posecal_models.cgnf import hearing, passes, rooms
from posecal_models.cgnf.flow import SIZES, FlowSize, GraphFlow
from posecal_models.cgnf.model import CGNF
from posecal_models.cgnf.parameters import PUBLISHED, parameter_table
from posecal_models.contract import Context
from posecal_models.graph import PoseGraph, human36m_graph
from tests.models import plain_cgnf

SIZE = FlowSize(blocks=4, hidden=6, context=3, embedding=5)
POSES, SAMPLES, NODES = 7, 5, 16


def random_flow(*, seed: int = 0, spread: float | None = None, **options) -> GraphFlow:
    """A flow with weights of size ``spread``, in double precision; an exponential scale takes smaller ones."""
    if spread is None:
        spread = 0.3 if options.get("scale") == "sigmoid" else 0.12
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        flow = GraphFlow(human36m_graph(), SIZE, **options).double()
        for parameter in flow.parameters():
            parameter.data = torch.randn_like(parameter) * spread
    return flow


def inputs(seed: int = 1) -> tuple[Tensor, Tensor, Tensor]:
    """Keypoints, observed and poses with samples."""
    generator = torch.Generator().manual_seed(seed)
    keypoints = torch.randn(POSES, NODES, 2, generator=generator, dtype=torch.float64)
    observed = torch.rand(POSES, NODES, generator=generator) < 0.6
    poses = torch.randn(POSES, SAMPLES, NODES, 3, generator=generator, dtype=torch.float64)
    return keypoints, observed, poses


def repeated(keypoints: Tensor, observed: Tensor) -> tuple[Tensor, Tensor]:
    """Keypoints and observed once for every sample, as the naive twin wants them."""
    return keypoints.repeat_interleave(SAMPLES, 0), observed.repeat_interleave(SAMPLES, 0)


OPTIONS = [{"backward_weights": backward, "scale": scale} for backward in (False, True) for scale in ("sigmoid", "exp")]


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("rows_in_cache", [16, 48, 100_000])
def test_density_and_gradients_equal_the_naive_twin_whatever_the_parts(monkeypatch, options, rows_in_cache):
    monkeypatch.setattr(rooms, "_ROWS_IN_CACHE", rows_in_cache)
    flow, (keypoints, observed, poses) = random_flow(**options), inputs()
    weights = dict(flow.named_parameters())
    root = torch.zeros(1, 3, dtype=torch.float64)
    plain = plain_cgnf.log_prob(
        weights,
        poses.flatten(0, 1),
        *repeated(keypoints, observed),
        root,
        human36m_graph().parents,
        scale=options["scale"],
    )
    ours = flow.ready(flow.evidence(keypoints, observed)).log_prob_per_node(poses).sum(-1).flatten()
    np.testing.assert_allclose(ours.detach(), plain.detach(), rtol=1e-12)

    weigh = torch.linspace(-1, 2, POSES * SAMPLES, dtype=torch.float64)
    expected = torch.autograd.grad((plain * weigh).sum(), list(weights.values()), materialize_grads=True)
    found = torch.autograd.grad((ours * weigh).sum(), list(weights.values()), materialize_grads=True)
    for name, one, other in zip(weights, found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("rows_in_cache", [32, 100_000])
def test_samples_and_their_gradients_equal_the_naive_twin(monkeypatch, options, rows_in_cache):
    monkeypatch.setattr(rooms, "_ROWS_IN_CACHE", rows_in_cache)
    flow, (keypoints, observed, latents) = random_flow(**options), inputs()
    weights = dict(flow.named_parameters())
    root = torch.zeros(1, 3, dtype=torch.float64)
    plain = plain_cgnf.inverse(
        weights,
        latents.flatten(0, 1),
        *repeated(keypoints, observed),
        root,
        human36m_graph().parents,
        scale=options["scale"],
    ).view_as(latents)
    ours = flow.ready(flow.evidence(keypoints, observed)).inverse(latents)
    np.testing.assert_allclose(ours.detach(), plain.detach(), rtol=1e-11, atol=1e-11)

    weigh = torch.linspace(-1, 2, latents.numel(), dtype=torch.float64).view_as(latents)
    expected = torch.autograd.grad((plain * weigh).sum(), list(weights.values()), materialize_grads=True)
    found = torch.autograd.grad((ours * weigh).sum(), list(weights.values()), materialize_grads=True)
    for name, one, other in zip(weights, found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8, err_msg=name)


@pytest.mark.parametrize("options", OPTIONS)
def test_the_log_determinant_is_that_of_autograd_s_jacobian(options):
    flow, (keypoints, observed, poses) = random_flow(**options), inputs()
    ready = flow.ready(flow.evidence(keypoints[:1], observed[:1]))
    pose = poses[:1, :1]
    _, log_determinant = ready.forward(pose)
    jacobian = torch.autograd.functional.jacobian(lambda p: ready.forward(p)[0], pose)
    expected = torch.linalg.slogdet(jacobian.view(48, 48)).logabsdet
    np.testing.assert_allclose(log_determinant.sum().detach(), expected.detach(), rtol=1e-12)


def test_gradients_of_the_pose_equal_finite_differences():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    ready = flow.ready(flow.evidence(keypoints[:2], observed[:2]))
    pose = poses[:2, :1].clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda p: ready.log_prob_per_node(p).sum(), pose)
    assert torch.autograd.gradcheck(lambda p: ready.inverse(p), pose)


@pytest.mark.parametrize("size", ["small", "xlarge"])
@pytest.mark.parametrize(("scale", "reach"), [("sigmoid", 0.1), ("exp", 0.02)])
def test_inverse_of_forward_is_the_pose_within_1e_4_in_single_precision(size, scale, reach):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        flow = GraphFlow(human36m_graph(), SIZES[size], scale=scale)
        flow.couplings.second.pool.weight.data.uniform_(-reach, reach)
    keypoints, observed, poses = (tensor if tensor.dtype == torch.bool else tensor.float() for tensor in inputs())
    with torch.no_grad():
        evidence = flow.evidence(keypoints, observed)
        flow.initialise_actnorm(poses, evidence)
        ready = flow.ready(evidence)
        latents, log_determinant = ready.forward(poses)
        back = ready.inverse(latents)
    assert float(log_determinant.abs().mean()) > 0.1  # it does move
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
    hidden = Context(keypoints, observed).hidden()
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
    ready = flow.ready(flow.no_evidence())
    np.testing.assert_allclose(ready.inverse(ready.forward(poses)[0]).detach(), poses, atol=1e-12)


@pytest.mark.parametrize("size", PUBLISHED)
def test_live_and_dead_parameters_make_up_the_published_number(size):
    table = parameter_table(SIZES[size])
    assert table.published == PUBLISHED[size]
    flow = GraphFlow(human36m_graph(), SIZES[size], backward_weights=False)
    held = {name: parameter.numel() for name, parameter in flow.named_parameters()}
    times_zero = sum(held[f"couplings.first.{name}.weight"] for name in ("from_root", "next_root"))
    assert times_zero == table.times_zero
    assert sum(held.values()) == table.live + table.times_zero


def test_the_small_model_s_parts_are_those_counted_by_hand():
    table = parameter_table(SIZES["small"])
    # 10 blocks: 2·100 + 100 and 100·100 + 100 from child to parent; 2 (100·100 + 100) last updates; 2·3·100 of the root
    assert table == (540_546, 6_000, 10 * (300 + 10_100), 10 * 2 * 10_100)
    assert table.backward + table.last_updates == 306_000


def test_every_live_parameter_gets_a_gradient_and_the_root_s_weights_get_zero():
    flow, (keypoints, observed, poses) = random_flow(spread=0.5, scale="sigmoid"), inputs()
    flow.ready(flow.evidence(keypoints, observed)).log_prob_per_node(poses).sum().backward()
    for name, parameter in flow.named_parameters():
        if name.endswith(("from_root.weight", "next_root.weight")) and ".first." in name:
            assert not parameter.grad.any(), name
        else:
            assert parameter.grad.any(), name


def test_an_untrained_flow_is_the_standard_normal():
    estimator = CGNF(SIZES["tiny"], scale="sigmoid").double()
    keypoints, observed, poses = inputs()
    ours = estimator.flow.ready(estimator.flow.evidence(keypoints, observed)).log_prob_per_node(poses).sum(-1)
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
        PoseGraph.of_joints(("Hip", "RHip"))


def test_activations_are_let_go_after_the_way_back():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    loss = flow.ready(flow.evidence(keypoints, observed)).log_prob_per_node(poses).sum()
    step = next(node for node in nodes_of(loss.grad_fn) if "_Pass" in type(node).__name__)
    place = len(passes.Blocks._fields) + len(hearing.Voices._fields) + step.uses.index("kept of part 0")
    activations = weakref.ref(step.saved_tensors[place].untyped_storage())
    del step
    loss.backward()
    gc.collect()
    assert activations() is None


def test_gradients_that_come_after_the_next_pass_in_the_same_memory_are_refused():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    ready = flow.ready(flow.evidence(keypoints, observed), workspace=rooms.Workspace())
    first, second = (ready.log_prob_per_node(poses).sum() for _ in range(2))
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        first.backward(retain_graph=True)
    with torch.no_grad():
        ready.log_prob_per_node(poses)  # keeps nothing, so writes over nothing
    second.backward(retain_graph=True)
    second.backward()


def test_gradients_survive_a_later_pass_that_needed_more_memory():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    evidence, workspace = flow.evidence(keypoints, observed), rooms.Workspace()

    def loss(count, workspace):
        return (
            flow.ready(evidence.of_poses(slice(0, count)), workspace=workspace).log_prob_per_node(poses[:count]).sum()
        )

    weights = list(flow.parameters())
    expected = torch.autograd.grad(loss(3, None), weights, retain_graph=True, materialize_grads=True)
    few, many = loss(3, workspace), loss(7, workspace)
    found = torch.autograd.grad(few, weights, retain_graph=True, materialize_grads=True)
    assert all(torch.equal(one, two) for one, two in zip(expected, found, strict=True))
    many.backward()


@pytest.mark.parametrize("rows_in_cache", [48, 100_000])
@pytest.mark.parametrize("back", [False, True])
def test_a_root_of_each_pose_and_its_gradients_equal_the_naive_twin_whatever_the_parts(
    monkeypatch, back, rows_in_cache
):
    monkeypatch.setattr(rooms, "_ROWS_IN_CACHE", rows_in_cache)
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    observed[2] = False
    root = torch.randn(POSES, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64, requires_grad=True)
    evidence = flow.evidence(keypoints, observed, root)
    pieces = [slice(0, 3), slice(3, 7)]
    ours = torch.cat([of_ready(flow.ready(evidence.of_poses(p)), poses[p], back=back) for p in pieces])
    twin = plain_cgnf.inverse if back else plain_cgnf.log_prob
    weights = dict(flow.named_parameters())
    every = poses.flatten(0, 1), *repeated(keypoints, observed), root.repeat_interleave(SAMPLES, 0)
    naive = twin(weights, *every, human36m_graph().parents, scale="exp").view_as(ours)
    torch.testing.assert_close(ours, naive, rtol=1e-10, atol=1e-12)
    wanted = [root, *weights.values()]
    one, two = (
        torch.autograd.grad(found.square().sum(), wanted, retain_graph=True, materialize_grads=True)
        for found in (ours, naive)
    )
    torch.testing.assert_close(one, two, rtol=1e-9, atol=1e-11)


def of_ready(ready, poses, *, back):
    """Poses of latents, or log densities of poses."""
    return ready.inverse(poses) if back else ready.log_prob_per_node(poses).sum(-1)


@pytest.mark.parametrize("rows_in_cache", [48, 100_000])
def test_many_poses_may_share_the_keypoints_of_one(monkeypatch, rows_in_cache):
    monkeypatch.setattr(rooms, "_ROWS_IN_CACHE", rows_in_cache)
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    weights = list(flow.parameters())
    found = []
    for of_all in (False, True):
        seen = (t[:1].expand(POSES, *t.shape[1:]) if of_all else t[:1] for t in (keypoints, observed))
        density = flow.ready(flow.evidence(*seen)).log_prob_per_node(poses)
        found.append((density, *torch.autograd.grad(density.square().sum(), weights, materialize_grads=True)))
    torch.testing.assert_close(*found, rtol=1e-9, atol=1e-11)


def test_the_first_blocks_alone_equal_the_naive_twin_s():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    root = torch.randn(POSES, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    latents, log_determinant = flow.ready(flow.evidence(keypoints, observed, root), blocks=2).forward(poses)
    weights = {name: tensor[:2] if name.startswith("couplings") else tensor for name, tensor in flow.named_parameters()}
    every = poses.flatten(0, 1), *repeated(keypoints, observed), root.repeat_interleave(SAMPLES, 0)
    naive = plain_cgnf.forward(weights, *every, human36m_graph().parents, scale="exp")
    torch.testing.assert_close(latents.flatten(0, 1), naive[0])
    torch.testing.assert_close(log_determinant.flatten(0, 1), naive[1])


def test_roots_of_another_number_of_poses_are_refused():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    evidence = flow.evidence(keypoints, observed, torch.zeros(9, 3, dtype=torch.float64))
    with pytest.raises(PoseDataError, match=r"flow: roots of 9 poses and keypoints of 7; expected as many\."):
        flow.ready(evidence).forward(poses)


def test_memory_of_another_graph_kind_or_mode_is_not_used_again():
    workspace, (keypoints, observed, poses) = rooms.Workspace(), inputs()
    for graph in (human36m_graph(), PoseGraph(tuple("abcdefghijklmnop"), (-1, *range(15)))):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            flow = GraphFlow(graph, SIZE).double()
        with torch.inference_mode():
            flow.ready(flow.evidence(keypoints, observed), workspace=workspace).log_prob_per_node(poses)
        for kind in (torch.float64, torch.float32):
            ready = flow.to(kind).ready(flow.evidence(keypoints.to(kind), observed), workspace=workspace)
            fresh = ready._replace(workspace=None)
            assert torch.equal(*(r.log_prob_per_node(poses.to(kind)) for r in (ready, fresh)))


def test_no_samples_are_no_samples():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    assert flow.ready(flow.evidence(keypoints, observed)).inverse(poses[:, :0]).shape == (POSES, 0, NODES, 3)


@pytest.mark.parametrize("back", [False, True])
def test_memory_that_is_used_again_changes_no_gradient(back):
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    workspace = rooms.Workspace()

    def gradients(count, workspace):
        flow.zero_grad()
        ready = flow.ready(flow.evidence(keypoints[:count], observed[:count]), workspace=workspace)
        found = ready.inverse(poses[:count]) if back else ready.log_prob_per_node(poses[:count])
        found.square().sum().backward()
        return [weights.grad.clone() for weights in flow.parameters() if weights.grad is not None]

    lay: dict[str, int] = {}
    for count in (7, 3, 5):
        fresh, again = gradients(count, None), gradients(count, workspace)
        assert all(torch.equal(one, two) for one, two in zip(fresh, again, strict=True))
        memory = {use: tensor.data_ptr() for use, tensor in workspace.memory.items()}
        assert memory == (lay := lay or memory)  # what was enough for seven is enough for fewer


def test_missing_keypoints_may_be_left_out_or_silenced(monkeypatch):
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    observed[2] = False

    def density_and_gradients():
        flow.zero_grad()
        evidence = flow.evidence(keypoints, observed)
        density = flow.ready(evidence).log_prob_per_node(poses)
        density.sum().backward()
        return (
            len(evidence.keypoints),
            density.detach(),
            [w.grad.clone() for w in flow.parameters() if w.grad is not None],
        )

    chosen, one, gradients = density_and_gradients()
    monkeypatch.setattr(flows, "_chooses_rows", lambda device: False)
    every, two, others = density_and_gradients()
    assert chosen == observed.sum() < every == observed.numel()
    torch.testing.assert_close(one, two, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(gradients, others, rtol=1e-10, atol=1e-12)


def test_keypoints_of_some_poses_are_found_and_placed():
    pose, node = torch.tensor([0, 0, 2, 3, 3]), torch.tensor([1, 4, 0, 2, 5])
    seats = hearing.Seats(pose, node, starts=[0, 2, 2, 3, 5])
    assert seats.places().tolist() == [4, 16, 2, 11, 23]
    rows, last = seats.of_poses(slice(2, 4))
    assert (rows, last.poses, last.starts) == (slice(2, 5), 2, [0, 1, 3])
    assert last.places().tolist() == [0 * 2 + 0, 2 * 2 + 1, 5 * 2 + 1]
    assert seats.of_poses(slice(1, 2))[1].places().tolist() == []


def nodes_of(node):
    """All nodes of a graph of gradients."""
    found, left = set(), [node]
    while left:
        if (node := left.pop()) is not None and node not in found:
            found.add(node)
            left += [before for before, _ in node.next_functions]
    return found


def test_without_blocks_poses_are_their_latents_and_have_gradients():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    poses.requires_grad_()
    latents, _ = flow.ready(flow.evidence(keypoints, observed), blocks=0).forward(poses)
    torch.testing.assert_close(latents, poses)
    latents.sum().backward()
    torch.testing.assert_close(poses.grad, torch.ones_like(poses))


def test_poses_without_keypoints_of_their_own_are_refused():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    with pytest.raises(PoseDataError, match=r"flow: keypoints of 7 poses and 3 poses; expected as many\."):
        flow.ready(flow.evidence(keypoints, observed)).forward(poses[:3])
