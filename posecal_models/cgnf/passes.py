r"""How does a pose become a latent, and a latent a pose? The two passes through all blocks, and their gradients.

A block moves one coordinate x of every node by the other coordinates of all nodes:

.. math:: z = s \, (a x + b) + t, \qquad (t, u) = \mathrm{net}(\text{kept coordinates}), \qquad s = \exp(u)
          \text{ or } \mathrm{sigmoid}(u + 2) + 0.001

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

__all__ = ["BlockTensors", "Bones", "Scale", "latents_of", "poses_of"]

Scale = Literal["sigmoid", "exp"]

_FLOOR = 1e-3


class BlockTensors(NamedTuple):
    """What a block consists of, once the keypoints are known.

    Attributes
    ----------
    first : Tensor
        Maps of the first layer: (maps, D + 1, H), the row of the moved coordinate 0, the last row the biases.
    second, second_bias : Tensor
        The first layer's update and the second layer's maps in one: (maps, H, H) and (maps, H).
    pool : Tensor
        The second layer's update: (2, H).
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


class Bones(NamedTuple):
    """Who speaks, and to whom.

    Attributes
    ----------
    spans : tuple of (int, int)
        For each map the nodes that speak by it, (start, stop): all of them to themselves, some along the bones.
    relations : Tensor
        (K, S): what all S messages, the spans after one another, add up to.
    """

    spans: tuple[tuple[int, int], ...]
    relations: Tensor


Part = tuple[slice, slice]
"""Some poses and some of their samples, few enough for their activations to stay in the processor's cache."""

_ROWS_IN_CACHE = 768


class _Heard(NamedTuple):
    """Activations of both layers for one part: after the first maps, after the sum over bones, after the second."""

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


def _places(bones: Bones, columns: int) -> list[tuple[slice, slice]]:
    """For each map, where its messages lie among all S * columns, and where those who speak among K * columns."""
    places, start = [], 0
    for first, last in bones.spans:
        stop = start + (last - first) * columns
        places.append((slice(start, stop), slice(first * columns, last * columns)))
        start = stop
    return places


def _speak(heard: Tensor, maps: Tensor, biases: Tensor | None, bones: Bones, columns: int) -> Tensor:
    """Apply each map with ReLU to the rows (K * columns, F) of the nodes that speak by it: (S * columns, H)."""
    spoken = heard.new_empty(bones.relations.shape[1] * columns, maps.shape[-1])
    for index, (said, rows) in enumerate(_places(bones, columns)):
        if biases is None:
            torch.mm(heard[rows], maps[index], out=spoken[said])
        else:
            torch.addmm(biases[index], heard[rows], maps[index], out=spoken[said])
    return spoken.relu_()


def _net(
    coordinates: Tensor, block: BlockTensors, bones: Bones, parts: list[Part], *, keep: bool
) -> tuple[Tensor, list[Tensor]]:
    """Give shift and unconstrained scale, (2, K, P, n), and the activations of each part if they are kept."""
    _, nodes, poses, samples = coordinates.shape
    messages, hidden = bones.relations.shape[1], block.pool.shape[1]
    pooled = coordinates.new_empty(2, messages, poses, samples)
    kept: list[Tensor] = []
    for part in parts:
        read = coordinates[:, :, *part]
        grid = read.shape[2:]
        first = _speak(read.flatten(1).T, block.first, None, bones, grid.numel())
        message = torch.mm(bones.relations, first.view(messages, -1))
        message.view(nodes, *grid, hidden).add_(_of_poses(block.evidence, part[0], 1))
        message = message.view(-1, hidden)
        second = _speak(message, block.second, block.second_bias, bones, grid.numel())
        pooled[:, :, *part] = torch.mm(block.pool, second.T).view(2, messages, *grid)
        if keep:
            kept += _Heard(first, message, second)
    told = torch.bmm(bones.relations.expand(2, -1, -1), pooled.view(2, messages, -1))
    return told.view(2, nodes, poses, samples).add_(block.offset), kept


def _net_backward(
    gradient: Tensor,
    coordinates: Tensor,
    block: BlockTensors,
    bones: Bones,
    parts: list[Part],
    kept: list[Tensor],
) -> tuple[Tensor, list[Tensor]]:
    """Give the gradients of the coordinates and of the block's first six tensors."""
    _, nodes, poses, samples = coordinates.shape
    messages, hidden = bones.relations.shape[1], block.pool.shape[1]
    silence = torch.ops.aten.threshold_backward.grad_input
    pooled = torch.bmm(bones.relations.T.expand(2, -1, -1), gradient.view(2, nodes, -1))
    pooled = pooled.view(2, messages, poses, samples)
    d_coordinates = torch.empty_like(coordinates)
    d_first, d_second, d_bias, d_pool, d_evidence = (torch.zeros_like(tensor) for tensor in block[:5])
    for index, part in enumerate(parts):
        heard = _Heard(*kept[3 * index : 3 * index + 3])
        read = coordinates[:, :, *part]
        grid, rows_read = read.shape[2:], read.flatten(1)
        places = _places(bones, grid.numel())
        d_pooled = pooled[:, :, *part].flatten(1)
        d_pool.addmm_(d_pooled, heard.second)
        second = torch.mm(d_pooled.T, block.pool)
        silence(second, heard.second, 0, grad_input=second)
        message = torch.mm(second[places[0][0]], block.second[0].T)
        for which, (said, rows) in enumerate(places):
            d_second[which].addmm_(heard.message[rows].T, second[said])
            d_bias[which] += second[said].sum(0)
            if which:
                message[rows].addmm_(second[said], block.second[which].T)
        into = _of_poses(d_evidence, part[0], 1)
        spread = message.view(nodes, *grid, hidden)
        into += spread if spread.shape == into.shape else spread.sum((1, 2) if into.shape[1] == 1 else 2, keepdim=True)
        first = torch.mm(bones.relations.T, message.view(nodes, -1)).view_as(heard.first)
        silence(first, heard.first, 0, grad_input=first)
        d_rows = torch.mm(block.first[0], first[places[0][0]].T)
        for which, (said, rows) in enumerate(places):
            d_first[which].addmm_(rows_read[:, rows], first[said])
            if which:
                d_rows[:, rows].addmm_(block.first[which], first[said].T)
        d_coordinates[:, :, *part] = d_rows.view_as(read)
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
        ctx: Any, scale: Scale, keep: bool, bones: Bones, coordinates: Tensor, *tensors: Tensor
    ) -> tuple[Tensor, Tensor]:
        dimensions, width = len(coordinates) - 1, len(BlockTensors._fields)
        parts = _parts(coordinates)
        log_stretch = torch.zeros_like(coordinates[0])
        saved: list[Tensor] = []
        for index in range(len(tensors) // width):
            block, moved = BlockTensors(*tensors[index * width :][:width]), index % dimensions
            told, heard = _net(coordinates, block, bones, parts, keep=keep)
            stretch = _stretch(told[1], scale)
            caught_up = torch.addcmul(block.behind_shift, coordinates[moved], block.behind_scale)
            if keep:
                saved += [coordinates, stretch, *heard]
            coordinates = coordinates.clone()
            torch.addcmul(told[0], caught_up, stretch, out=coordinates[moved])
            log_stretch += stretch.log()
        ctx.scale, ctx.bones, ctx.blocks, ctx.parts = scale, bones, len(tensors) // width, parts
        ctx.save_for_backward(*tensors, *saved)
        return coordinates, log_stretch

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        stored = ctx.saved_tensors
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
            d_kept, d_block = _net_backward(told, coordinates, block, ctx.bones, ctx.parts, activations)
            d_coordinates += d_kept
            found[:0] = [*d_block, *d_behind]
        return None, None, None, d_coordinates, *found


class _Poses(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, scale: Scale, keep: bool, bones: Bones, coordinates: Tensor, *tensors: Tensor) -> Tensor:
        dimensions, width, parts = len(coordinates) - 1, len(BlockTensors._fields), _parts(coordinates)
        saved: list[Tensor] = []
        for index in reversed(range(len(tensors) // width)):
            block, moved = BlockTensors(*tensors[index * width :][:width]), index % dimensions
            told, heard = _net(coordinates, block, bones, parts, keep=keep)
            stretch = _stretch(told[1], scale)
            caught_up = torch.sub(coordinates[moved], told[0]).div_(stretch)
            coordinates = coordinates.clone()
            torch.sub(caught_up, block.behind_shift, out=coordinates[moved])
            coordinates[moved] /= block.behind_scale
            if keep:
                saved += [coordinates, stretch, caught_up, *heard]
        ctx.scale, ctx.bones, ctx.blocks, ctx.parts = scale, bones, len(tensors) // width, parts
        ctx.save_for_backward(*tensors, *saved)
        return coordinates

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        stored = ctx.saved_tensors
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
            d_kept, d_block = _net_backward(told, coordinates, block, ctx.bones, ctx.parts, activations)
            d_coordinates += d_kept
            found += [*d_block, *d_behind]
        return None, None, None, d_coordinates, *found


def latents_of(coordinates: Tensor, blocks: list[BlockTensors], bones: Bones, scale: Scale) -> tuple[Tensor, Tensor]:
    """Pass poses through all blocks.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    blocks : list of BlockTensors
        The L blocks; block l moves coordinate l modulo D.
    bones : Bones
        Who speaks to whom.
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
    latents, log_stretch = _Latents.apply(  # type: ignore[no-untyped-call]
        scale, torch.is_grad_enabled(), bones, coordinates, *tensors
    )
    return latents, log_stretch


def poses_of(coordinates: Tensor, blocks: list[BlockTensors], bones: Bones, scale: Scale) -> Tensor:
    """Pass latents back through all blocks.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    blocks : list of BlockTensors
        The L blocks, first to last.
    bones : Bones
        Who speaks to whom.
    scale : str
        How the unconstrained scale becomes a positive one.

    Returns
    -------
    Tensor
        The same shape.
    """
    tensors = [tensor for block in blocks for tensor in block]
    poses: Tensor = _Poses.apply(  # type: ignore[no-untyped-call]
        scale, torch.is_grad_enabled(), bones, coordinates, *tensors
    )
    return poses
