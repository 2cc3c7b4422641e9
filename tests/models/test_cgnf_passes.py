"""What poses are told and where activations lie: roots, shared keypoints, and memory that is used again."""

from __future__ import annotations

import gc
import weakref

import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models.cgnf import flow as flows
from posecal_models.cgnf import hearing, passes, rooms
from posecal_models.cgnf.flow import GraphFlow
from posecal_models.graph import PoseGraph, human36m_graph
from tests.models import plain_cgnf
from tests.models.some_flows import NODES, POSES, SAMPLES, SIZE, inputs, random_flow, repeated


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


def test_memory_that_became_too_small_is_let_go():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    evidence, workspace = flow.evidence(keypoints, observed), rooms.Workspace()
    with torch.no_grad():
        flow.ready(evidence.of_poses(slice(0, 3)), workspace=workspace).log_prob_per_node(poses[:3])
        small = weakref.ref(workspace.memory["part"].untyped_storage())
        flow.ready(evidence, workspace=workspace).log_prob_per_node(poses)
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
    latents, _ = flow.ready(flow.evidence(keypoints, observed), blocks=0).forward(poses)
    torch.testing.assert_close(latents, poses)
    latents.sum().backward()
    torch.testing.assert_close(poses.grad, torch.ones_like(poses))


def test_poses_without_keypoints_of_their_own_are_refused():
    flow, (keypoints, observed, poses) = random_flow(), inputs()
    with pytest.raises(PoseDataError, match=r"flow: keypoints of 7 poses and 3 poses; expected as many\."):
        flow.ready(flow.evidence(keypoints, observed)).forward(poses[:3])
