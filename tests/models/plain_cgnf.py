"""Naive reference implementation of the cGNF: the formulas as written, one node, one relation, one sample at a time.

Weights are a dictionary by the names of :class:`posecal_models.estimators.cgnf.flow.GraphFlow`. Nothing is shared,
folded or reordered: messages of the context are recomputed for every sample, and those along edges one relation at a
time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

Weights = Mapping[str, Tensor]


def linear(weights: Weights, name: str, features: Tensor) -> Tensor:
    return features @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]


def embedding(weights: Weights, keypoints: Tensor, observed: Tensor) -> Tensor:
    """Embed keypoints (M, K, 2) of which some are observed (M, K)."""
    mask = observed.to(keypoints.dtype)
    keypoints = torch.where(observed[..., None], keypoints, 0)
    adjacency = weights["embedding.adjacency"] * mask[:, :, None] * mask[:, None, :]
    weight = adjacency / adjacency.sum(-1, keepdim=True).clamp(min=1)

    def layer(order: str, features: Tensor) -> Tensor:
        neighbours = weight @ features
        return neighbours @ weights[f"embedding.{order}_neighbours.weight"].T + linear(
            weights, f"embedding.{order}_own", features
        )

    return layer("second", torch.relu(layer("first", keypoints)))


def message_passing(
    weights: Weights,
    block: int,
    layer: str,
    nodes: Tensor,
    context: Tensor,
    observed: Tensor,
    root: Tensor,
    parents: tuple[int, ...],
) -> Tensor:
    """One layer for M graphs: nodes (M, K, F), context (M, K, C), observed (M, K), root (M, R)."""

    def map_of(name: str, features: Tensor) -> Tensor:
        return linear(weights, f"blocks.{block}.{layer}.{name}", features)

    message = torch.relu(map_of("from_self", nodes))
    child_map = "from_child" if f"blocks.{block}.{layer}.from_child.weight" in weights else "from_parent"
    from_parents = torch.relu(map_of("from_parent", nodes))
    from_children = torch.relu(map_of(child_map, nodes))
    children = [v for v, parent in enumerate(parents) if parent >= 0]
    parents_of_children = [parents[v] for v in children]
    message = message.index_add(1, torch.tensor(children), from_parents[:, parents_of_children])
    message = message.index_add(1, torch.tensor(parents_of_children), from_children[:, children])
    message = message + torch.relu(map_of("from_context", context)) * observed[..., None]
    next_to_root = torch.tensor([parent < 0 for parent in parents])
    message = message + torch.relu(map_of("from_root", root))[:, None] * next_to_root[:, None]
    return map_of("pool", message)


def shift_and_scale(
    weights: Weights,
    block: int,
    inputs: Tensor,
    context: Tensor,
    observed: Tensor,
    root: Tensor,
    parents: tuple[int, ...],
    scale: str,
) -> tuple[Tensor, Tensor]:
    """Both layers of one block's coupling net."""
    nodes = message_passing(weights, block, "first", inputs, context, observed, root, parents)
    context = torch.relu(linear(weights, f"blocks.{block}.first.next_context", context))
    root = torch.relu(linear(weights, f"blocks.{block}.first.next_root", root))
    nodes = message_passing(weights, block, "second", nodes, context, observed, root, parents)
    shift, unconstrained = nodes[..., 0], nodes[..., 1]
    return shift, unconstrained.exp() if scale == "exp" else torch.sigmoid(unconstrained + 2) + 1e-3


def forward(
    weights: Weights,
    poses: Tensor,
    keypoints: Tensor,
    observed: Tensor,
    root: Tensor,
    parents: tuple[int, ...],
    *,
    scale: str = "sigmoid",
) -> tuple[Tensor, Tensor]:
    """Latents (M, K, D) and log determinants (M, K) of poses (M, K, D)."""
    context = embedding(weights, keypoints, observed)
    dimensions = poses.shape[-1]
    log_determinant = torch.zeros_like(poses[..., 0])
    for block in range(_blocks(weights)):
        log_scale = weights[f"blocks.{block}.log_scale"]
        shift = weights[f"blocks.{block}.shift"]
        poses = poses * log_scale.exp() + shift
        target = block % dimensions
        others = poses[..., [i for i in range(dimensions) if i != target]]
        t, s = shift_and_scale(weights, block, others, context, observed, root, parents, scale)
        poses = torch.stack([poses[..., i] * s + t if i == target else poses[..., i] for i in range(dimensions)], -1)
        log_determinant = log_determinant + log_scale.sum() + s.log()
    return poses, log_determinant


def inverse(
    weights: Weights,
    latents: Tensor,
    keypoints: Tensor,
    observed: Tensor,
    root: Tensor,
    parents: tuple[int, ...],
    *,
    scale: str = "sigmoid",
) -> Tensor:
    """Poses (M, K, D) of latents (M, K, D)."""
    context = embedding(weights, keypoints, observed)
    dimensions = latents.shape[-1]
    for block in reversed(range(_blocks(weights))):
        target = block % dimensions
        others = latents[..., [i for i in range(dimensions) if i != target]]
        t, s = shift_and_scale(weights, block, others, context, observed, root, parents, scale)
        latents = torch.stack(
            [(latents[..., i] - t) / s if i == target else latents[..., i] for i in range(dimensions)], -1
        )
        log_scale = weights[f"blocks.{block}.log_scale"]
        shift = weights[f"blocks.{block}.shift"]
        latents = (latents - shift) * torch.exp(-log_scale)
    return latents


def log_prob(
    weights: Weights,
    poses: Tensor,
    keypoints: Tensor,
    observed: Tensor,
    root: Tensor,
    parents: tuple[int, ...],
    *,
    scale: str = "sigmoid",
) -> Tensor:
    """Log densities (M,) of poses (M, K, D), nats per pose."""
    latents, log_determinant = forward(weights, poses, keypoints, observed, root, parents, scale=scale)
    base = -0.5 * (latents.square() + math.log(2 * math.pi)).sum(-1)
    return (base + log_determinant).sum(-1)


def _blocks(weights: Weights) -> int:
    return sum(name.endswith(".log_scale") for name in weights)
