"""How does a pose become a latent, and a latent a pose? The two passes through all blocks, and their gradients.

A block moves one coordinate x of every node by the other coordinates of all nodes:

.. math:: z = s \\, (a x + b) + t, \\qquad (t, u) = \\mathrm{net}(\\text{kept coordinates}), \\qquad s = \\exp(u)
          \\text{ or } \\mathrm{sigmoid}(u + 2) + 0.001

Gradients are written out by hand, because activations are then overwritten in place, not copied, and small operations
need no bookkeeping: a training step takes half of the time. Tests compare them with finite differences and with
autograd on the plain formulas.

Coordinates are rows of (D + 1, K, P, n), the last row all ones, which carries the biases.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

__all__ = ["BlockTensors", "Scale", "latents_of", "poses_of"]

Scale = Literal["sigmoid", "exp"]

_FLOOR = 1e-3


class BlockTensors(NamedTuple):
    """What a block consists of, once the keypoints are known.

    Attributes
    ----------
    first : Tensor
        Maps of the first layer: (maps, D + 1, H), the row of the moved coordinate 0, the last row the biases.
    second, second_bias : Tensor
        The first layer's update and the second layer's maps in one: (H, maps * H) and (maps * H,).
    pool : Tensor
        The second layer's update for every kind of message: (2 * maps, maps * H).
    evidence : Tensor
        What context and root add after the first layer: (K, P or 1, 1, H).
    offset : Tensor
        What context and root add after the second layer: (2, K, P or 1, 1).
    behind_scale, behind_shift : Tensor
        a and b, scalars: the ActNorms that the moved coordinate has yet to pass.
    """

    first: Tensor
    second: Tensor
    second_bias: Tensor
    pool: Tensor
    evidence: Tensor
    offset: Tensor
    behind_scale: Tensor
    behind_shift: Tensor


Part = tuple[slice, slice]
"""Some poses and some of their samples, few enough for their activations to stay in the processor's cache."""

_ROWS_IN_CACHE = 768


class _Heard(NamedTuple):
    """Activations of both layers, for one part: after the first maps, after the sum over the bones, after the second."""

    first: Tensor
    message: Tensor
    second: Tensor


def _parts(coordinates: Tensor) -> list[Part]:
    """Cut the (P, n) grid of poses and samples into parts."""
    _, nodes, poses, samples = coordinates.shape
    at_once = max(1, _ROWS_IN_CACHE // nodes) if coordinates.device.type == "cpu" else poses * samples
    samples_each = -(-samples // -(-samples // at_once))
    poses_each = max(1, at_once // samples_each)
    return [
        (slice(p, min(p + poses_each, poses)), slice(n, min(n + samples_each, samples)))
        for p in range(0, poses, poses_each)
        for n in range(0, samples, samples_each)
    ]


def _of_poses(shared: Tensor, poses: slice, dim: int) -> Tensor:
    """Take some poses out of messages, unless all poses share them."""
    if shared.shape[dim] == 1:
        return shared
    return shared.narrow(dim, poses.start, poses.stop - poses.start)


def _net(
    coordinates: Tensor, block: BlockTensors, relations: Tensor, parts: list[Part], *, keep: bool
) -> tuple[Tensor, list[Tensor]]:
    """Give shift and unconstrained scale, (2, K, P, n), and the activations of each part if they are kept."""
    _, nodes, poses, samples = coordinates.shape
    maps, _, hidden = block.first.shape
    pooled = coordinates.new_empty(2 * maps, nodes, poses, samples)
    kept: list[Tensor] = []
    for part in parts:
        read = coordinates[:, :, *part]
        grid = read.shape[1:]
        first = torch.bmm(read.flatten(1).T.expand(maps, -1, -1), block.first).relu_()
        message = torch.mm(relations, first.view(maps * nodes, -1))
        message.view(*grid, hidden).add_(_of_poses(block.evidence, part[0], 1))
        message = message.view(-1, hidden)
        second = torch.addmm(block.second_bias, message, block.second).relu_()
        pooled[:, :, *part] = torch.mm(block.pool, second.T).view(2 * maps, *grid)
        if keep:
            kept += _Heard(first, message, second)
    told = torch.bmm(relations.expand(2, -1, -1), pooled.view(2, maps * nodes, -1))
    return told.view(2, nodes, poses, samples).add_(block.offset), kept


def _net_backward(
    gradient: Tensor,
    coordinates: Tensor,
    block: BlockTensors,
    relations: Tensor,
    parts: list[Part],
    kept: list[Tensor],
) -> tuple[Tensor, list[Tensor]]:
    """Give the gradients of the coordinates and of the block's first six tensors."""
    _, nodes, poses, samples = coordinates.shape
    maps, _, hidden = block.first.shape
    silence = torch.ops.aten.threshold_backward.grad_input
    pooled = torch.bmm(relations.T.expand(2, -1, -1), gradient.view(2, nodes, -1))
    pooled = pooled.view(2 * maps, nodes, poses, samples)
    d_coordinates = torch.empty_like(coordinates)
    d_first, d_second, d_bias, d_pool, d_evidence = (torch.zeros_like(tensor) for tensor in block[:5])
    for index, part in enumerate(parts):
        heard = _Heard(*kept[3 * index : 3 * index + 3])
        d_pooled = pooled[:, :, *part].flatten(1)
        d_pool.addmm_(d_pooled, heard.second)
        second = torch.mm(d_pooled.T, block.pool)
        silence(second, heard.second, 0, grad_input=second)
        d_second.addmm_(heard.message.T, second)
        d_bias += second.sum(0)
        message = torch.mm(second, block.second.T)
        said = message.view(nodes, -1, part[1].stop - part[1].start, hidden)
        into = _of_poses(d_evidence, part[0], 1)
        into += said.sum((1, 2) if len(into[0]) == 1 else 2, keepdim=True) if said.shape != into.shape else said
        first = torch.mm(relations.T, message.view(nodes, -1)).view_as(heard.first)
        silence(first, heard.first, 0, grad_input=first)
        read = coordinates[:, :, *part]
        rows = read.flatten(1)
        d_first.baddbmm_(rows.expand(maps, -1, -1), first)
        d_coordinates[:, :, *part] = torch.bmm(block.first, first.transpose(1, 2)).sum(0).view_as(read)
    d_offset = gradient.sum((2, 3) if block.offset.shape[2] == 1 else 3, keepdim=True)
    return d_coordinates, [d_first, d_second, d_bias, d_pool, d_evidence, d_offset]


def _stretch(unconstrained: Tensor, scale: Scale) -> Tensor:
    """Turn the unconstrained scale into the positive one, in place."""
    return unconstrained.exp_() if scale == "exp" else unconstrained.add_(2).sigmoid_().add_(_FLOOR)


def _stretch_backward(gradient: Tensor, stretch: Tensor, scale: Scale) -> Tensor:
    """Give the gradient of the unconstrained scale."""
    if scale == "exp":
        return gradient * stretch
    share = stretch - _FLOOR
    return gradient * share * (1 - share)


class _Latents(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, scale: Scale, keep: bool, coordinates: Tensor, relations: Tensor, *tensors: Tensor
    ) -> tuple[Tensor, Tensor]:
        dimensions, width = len(coordinates) - 1, len(BlockTensors._fields)
        parts = _parts(coordinates)
        log_stretch = torch.zeros_like(coordinates[0])
        saved: list[Tensor] = []
        for index in range(len(tensors) // width):
            block, moved = BlockTensors(*tensors[index * width :][:width]), index % dimensions
            told, heard = _net(coordinates, block, relations, parts, keep=keep)
            stretch = _stretch(told[1], scale)
            caught_up = torch.addcmul(block.behind_shift, coordinates[moved], block.behind_scale)
            if keep:
                saved += [coordinates, stretch, *heard]
            coordinates = coordinates.clone()
            torch.addcmul(told[0], caught_up, stretch, out=coordinates[moved])
            log_stretch += stretch.log()
        ctx.scale, ctx.blocks, ctx.parts = scale, len(tensors) // width, parts
        ctx.save_for_backward(relations, *tensors, *saved)
        return coordinates, log_stretch

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        relations, *stored = ctx.saved_tensors
        width, per_block = len(BlockTensors._fields), 2 + len(_Heard._fields) * len(ctx.parts)
        saved = stored[ctx.blocks * width :]
        d_coordinates, d_log_stretch = gradients[0].clone(), gradients[1]
        dimensions = len(d_coordinates) - 1
        found: list[Tensor] = []
        for index in reversed(range(ctx.blocks)):
            block, moved = BlockTensors(*stored[index * width :][:width]), index % dimensions
            coordinates, stretch, *activations = saved[index * per_block :][:per_block]
            d_moved = d_coordinates[moved]
            caught_up = torch.addcmul(block.behind_shift, coordinates[moved], block.behind_scale)
            d_stretch = torch.addcdiv(d_moved * caught_up, d_log_stretch, stretch)
            told = torch.stack([d_moved, _stretch_backward(d_stretch, stretch, ctx.scale)])
            d_caught_up = d_moved * stretch
            d_behind = [(d_caught_up * coordinates[moved]).sum(), d_caught_up.sum()]
            torch.mul(d_caught_up, block.behind_scale, out=d_moved)
            d_kept, d_block = _net_backward(told, coordinates, block, relations, ctx.parts, activations)
            d_coordinates += d_kept
            found[:0] = [*d_block, *d_behind]
        return None, None, d_coordinates, None, *found


class _Poses(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, scale: Scale, keep: bool, coordinates: Tensor, relations: Tensor, *tensors: Tensor) -> Tensor:
        dimensions, width, parts = len(coordinates) - 1, len(BlockTensors._fields), _parts(coordinates)
        saved: list[Tensor] = []
        for index in reversed(range(len(tensors) // width)):
            block, moved = BlockTensors(*tensors[index * width :][:width]), index % dimensions
            told, heard = _net(coordinates, block, relations, parts, keep=keep)
            stretch = _stretch(told[1], scale)
            caught_up = torch.sub(coordinates[moved], told[0]).div_(stretch)
            coordinates = coordinates.clone()
            torch.sub(caught_up, block.behind_shift, out=coordinates[moved])
            coordinates[moved] /= block.behind_scale
            if keep:
                saved += [coordinates, stretch, caught_up, *heard]
        ctx.scale, ctx.blocks, ctx.parts = scale, len(tensors) // width, parts
        ctx.save_for_backward(relations, *tensors, *saved)
        return coordinates

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        relations, *stored = ctx.saved_tensors
        width, per_block = len(BlockTensors._fields), 3 + len(_Heard._fields) * len(ctx.parts)
        saved = stored[ctx.blocks * width :]
        d_coordinates = gradients[0].clone()
        dimensions = len(d_coordinates) - 1
        found: list[Tensor] = []
        for index in range(ctx.blocks):
            block, moved = BlockTensors(*stored[index * width :][:width]), index % dimensions
            at = (ctx.blocks - 1 - index) * per_block
            coordinates, stretch, caught_up, *activations = saved[at:][:per_block]
            d_moved = d_coordinates[moved]
            d_caught_up = d_moved / block.behind_scale
            d_behind = [-(d_caught_up * coordinates[moved]).sum(), -d_caught_up.sum()]
            torch.div(d_caught_up, stretch, out=d_moved)
            d_stretch = -d_moved * caught_up
            told = torch.stack([-d_moved, _stretch_backward(d_stretch, stretch, ctx.scale)])
            d_kept, d_block = _net_backward(told, coordinates, block, relations, ctx.parts, activations)
            d_coordinates += d_kept
            found += [*d_block, *d_behind]
        return None, None, d_coordinates, None, *found


def latents_of(
    coordinates: Tensor, blocks: list[BlockTensors], relations: Tensor, scale: Scale
) -> tuple[Tensor, Tensor]:
    """Pass poses through all blocks.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    blocks : list of BlockTensors
        The L blocks; block l moves coordinate l modulo D.
    relations : Tensor
        (K, maps * K): what each kind of message adds up to along the bones.
    scale : str
        How the unconstrained scale becomes a positive one.

    Returns
    -------
    coordinates : Tensor
        The same shape.
    log_stretch : Tensor
        (K, P, n), nats: the sum of log s over the blocks.
    """
    tensors = [tensor for block in blocks for tensor in block]
    latents, log_stretch = _Latents.apply(scale, torch.is_grad_enabled(), coordinates, relations, *tensors)
    return latents, log_stretch


def poses_of(coordinates: Tensor, blocks: list[BlockTensors], relations: Tensor, scale: Scale) -> Tensor:
    """Pass latents back through all blocks.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    blocks : list of BlockTensors
        The L blocks, first to last.
    relations : Tensor
        (K, maps * K).
    scale : str
        How the unconstrained scale becomes a positive one.

    Returns
    -------
    Tensor
        The same shape.
    """
    tensors = [tensor for block in blocks for tensor in block]
    poses: Tensor = _Poses.apply(scale, torch.is_grad_enabled(), coordinates, relations, *tensors)
    return poses
