"""Forward and inverse passes of the flow: roots, context messages, and reuse of activation buffers."""

from __future__ import annotations

import gc
import weakref

import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models.estimators.cgnf import buffers, context_messages, passes
from posecal_models.estimators.cgnf import flow as flows
from posecal_models.estimators.cgnf.flow import GraphFlow
from posecal_models.estimators.cgnf.graph import PoseGraph, human36m_graph
from tests.models import plain_cgnf
from tests.models.random_flows import NODES, POSES, SAMPLES, SIZE, inputs, random_flow, repeat_per_sample


def test_activations_are_freed_after_the_backward_pass():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    loss = flow.condition(flow.embed(keypoints, observed)).log_prob_per_node(poses).sum()
    step = next(node for node in nodes_of(loss.grad_fn) if "_Pass" in type(node).__name__)
    tensors = len(passes.BlockWeights._fields) + len(context_messages.ContextMaps._fields)
    activations = weakref.ref(step.saved_tensors[tensors + step.uses.index("saved part 0")].untyped_storage())
    del step
    loss.backward()
    gc.collect()
    assert activations() is None


def test_gradients_that_come_after_the_next_pass_in_the_same_memory_are_refused():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    conditioned = flow.condition(flow.embed(keypoints, observed), workspace=buffers.Workspace())
    first, second = (conditioned.log_prob_per_node(poses).sum() for _ in range(2))
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        first.backward(retain_graph=True)
    with torch.no_grad():
        conditioned.log_prob_per_node(poses)  # saves nothing, so overwrites nothing
    second.backward(retain_graph=True)
    second.backward()


def test_gradients_survive_a_later_pass_that_needed_more_memory():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    embedded, workspace = flow.embed(keypoints, observed), buffers.Workspace()

    def loss(count, workspace):
        return (
            flow.condition(embedded.select(slice(0, count)), workspace=workspace).log_prob_per_node(poses[:count]).sum()
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
    monkeypatch.setattr(buffers, "_ROWS_IN_CACHE", rows_in_cache)
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    observed[2] = False
    root = torch.randn(POSES, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64, requires_grad=True)
    embedded = flow.embed(keypoints, observed, root)
    pieces = [slice(0, 3), slice(3, 7)]
    ours = torch.cat([of_conditioned(flow.condition(embedded.select(p)), poses[p], back=back) for p in pieces])
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


def of_conditioned(conditioned, poses, *, back):
    """Poses of latents, or log densities of poses."""
    return conditioned.inverse(poses) if back else conditioned.log_prob_per_node(poses).sum(-1)


@pytest.mark.parametrize("rows_in_cache", [48, 100_000])
def test_many_poses_may_share_the_keypoints_of_one(monkeypatch, rows_in_cache):
    monkeypatch.setattr(buffers, "_ROWS_IN_CACHE", rows_in_cache)
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    weights = list(flow.parameters())
    found = []
    for of_all in (False, True):
        seen = (t[:1].expand(POSES, *t.shape[1:]) if of_all else t[:1] for t in (keypoints, observed))
        density = flow.condition(flow.embed(*seen)).log_prob_per_node(poses)
        found.append((density, *torch.autograd.grad(density.square().sum(), weights, materialize_grads=True)))
    torch.testing.assert_close(*found, rtol=1e-9, atol=1e-11)


def test_the_first_blocks_alone_equal_the_naive_twin_s():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    root = torch.randn(POSES, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    latents, log_determinant = flow.condition(flow.embed(keypoints, observed, root), blocks=2).forward(poses)
    weights = {name: tensor[:2] if name.startswith("couplings") else tensor for name, tensor in flow.named_parameters()}
    every = poses.flatten(0, 1), *repeat_per_sample(keypoints, observed), root.repeat_interleave(SAMPLES, 0)
    naive = plain_cgnf.forward(weights, *every, human36m_graph().parents, scale="exp")
    torch.testing.assert_close(latents.flatten(0, 1), naive[0])
    torch.testing.assert_close(log_determinant.flatten(0, 1), naive[1])


def test_roots_of_another_number_of_poses_are_refused():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    embedded = flow.embed(keypoints, observed, torch.zeros(9, 3, dtype=torch.float64))
    with pytest.raises(PoseDataError, match=r"flow: roots of 9 poses and keypoints of 7; expected as many\."):
        flow.condition(embedded).forward(poses)


def test_memory_of_another_graph_kind_or_mode_is_not_used_again():
    workspace, (keypoints, observed, poses) = buffers.Workspace(), inputs()
    for graph in (human36m_graph(), PoseGraph(tuple("abcdefghijklmnop"), (-1, *range(15)))):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            flow = GraphFlow(graph, SIZE).double()
        with torch.inference_mode():
            flow.condition(flow.embed(keypoints, observed), workspace=workspace).log_prob_per_node(poses)
        for kind in (torch.float64, torch.float32):
            conditioned = flow.to(kind).condition(flow.embed(keypoints.to(kind), observed), workspace=workspace)
            fresh = conditioned._replace(workspace=None)
            assert torch.equal(*(r.log_prob_per_node(poses.to(kind)) for r in (conditioned, fresh)))


def test_no_samples_are_no_samples():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    assert flow.condition(flow.embed(keypoints, observed)).inverse(poses[:, :0]).shape == (POSES, 0, NODES, 3)


@pytest.mark.parametrize("back", [False, True])
def test_memory_that_is_used_again_changes_no_gradient(back):
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    workspace = buffers.Workspace()

    def gradients(count, workspace):
        flow.zero_grad()
        conditioned = flow.condition(flow.embed(keypoints[:count], observed[:count]), workspace=workspace)
        found = conditioned.inverse(poses[:count]) if back else conditioned.log_prob_per_node(poses[:count])
        found.square().sum().backward()
        return [weights.grad.clone() for weights in flow.parameters() if weights.grad is not None]

    first: dict[str, int] = {}
    for count in (7, 3, 5):
        fresh, again = gradients(count, None), gradients(count, workspace)
        assert all(torch.equal(one, two) for one, two in zip(fresh, again, strict=True))
        memory = {use: tensor.data_ptr() for use, tensor in workspace.memory.items()}
        assert memory == (first := first or memory)  # the memory of seven poses is enough for fewer


def test_missing_keypoints_may_be_dropped_or_zeroed(monkeypatch):
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    observed[2] = False

    def density_and_gradients():
        flow.zero_grad()
        embedded = flow.embed(keypoints, observed)
        density = flow.condition(embedded).log_prob_per_node(poses)
        density.sum().backward()
        return (
            len(embedded.keypoints),
            density.detach(),
            [w.grad.clone() for w in flow.parameters() if w.grad is not None],
        )

    dropped, one, gradients = density_and_gradients()
    monkeypatch.setattr(flows, "_drops_missing_rows", lambda device: False)
    zeroed, two, others = density_and_gradients()
    assert dropped == observed.sum() < zeroed == observed.numel()
    torch.testing.assert_close(one, two, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(gradients, others, rtol=1e-10, atol=1e-12)


def test_keypoints_of_some_poses_are_selected_with_their_targets():
    pose, node = torch.tensor([0, 0, 2, 3, 3]), torch.tensor([1, 4, 0, 2, 5])
    node_index = context_messages.NodeIndex(pose, node, starts=[0, 2, 2, 3, 5])
    assert node_index.flat().tolist() == [4, 16, 2, 11, 23]
    rows, last = node_index.select(slice(2, 4))
    assert (rows, last.poses, last.starts) == (slice(2, 5), 2, [0, 1, 3])
    assert last.flat().tolist() == [0 * 2 + 0, 2 * 2 + 1, 5 * 2 + 1]
    assert node_index.select(slice(1, 2))[1].flat().tolist() == []


def test_memory_that_became_too_small_is_freed():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    embedded, workspace = flow.embed(keypoints, observed), buffers.Workspace()
    with torch.no_grad():
        flow.condition(embedded.select(slice(0, 3)), workspace=workspace).log_prob_per_node(poses[:3])
        small = weakref.ref(workspace.memory["part"].untyped_storage())
        flow.condition(embedded, workspace=workspace).log_prob_per_node(poses)
    gc.collect()
    assert small() is None


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
    latents, _ = flow.condition(flow.embed(keypoints, observed), blocks=0).forward(poses)
    torch.testing.assert_close(latents, poses)
    latents.sum().backward()
    torch.testing.assert_close(poses.grad, torch.ones_like(poses))


def test_poses_without_keypoints_of_their_own_are_refused():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    with pytest.raises(PoseDataError, match=r"flow: keypoints of 7 poses and 3 poses; expected as many\."):
        flow.condition(flow.embed(keypoints, observed)).forward(poses[:3])
