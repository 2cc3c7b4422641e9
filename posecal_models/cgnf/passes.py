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

from posecal.errors import PoseDataError

__all__ = ["Blocks", "Bones", "Scale", "latents_of", "poses_of"]

Scale = Literal["sigmoid", "exp"]

_FLOOR = 1e-3


class Blocks(NamedTuple):
    """What the L blocks consist of, once the keypoints are known.

    H counts the hidden features and a last one that is 1, which carries the biases of the second layer, filled up with
    zeros to a multiple of 8, on which matrix products are fastest.

    Attributes
    ----------
    first : Tensor
        Maps of the first layer: (L, maps, D + 1, H), the row of the moved coordinate 0, the last row the biases.
    second : Tensor
        The first layer's update and the second layer's maps in one: (L, maps, H, H).
    pool : Tensor
        The second layer's update: (L, 2, H).
    evidence : Tensor
        What context and root add after the first layer: (L, K, P or 1, 1, H).
    offset : Tensor
        What context and root add after the second layer: (L, 2, K, P or 1, 1).
    behind_scale, behind_shift : Tensor
        a and b, (L,) each: the ActNorms that the moved coordinate has yet to pass.
    """

    first: Tensor
    second: Tensor
    pool: Tensor
    evidence: Tensor
    offset: Tensor
    behind_scale: Tensor
    behind_shift: Tensor

    def of_poses(self, poses: slice) -> list[Blocks]:
        """Give the blocks one by one, with what is said to some poses."""
        evidence, offset = _of_poses(self.evidence, poses, 2), _of_poses(self.offset, poses, 3)
        every = self._replace(evidence=evidence, offset=offset)
        return [Blocks(*block) for block in zip(*(tensor.unbind() for tensor in every), strict=True)]


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

_ROWS_IN_CACHE = 2048


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


class _Room:
    """Memory for one block and one part, written over and over, and views of it by which messages pass.

    Rows of activations are (node or message, pose, sample), flattened.

    Attributes
    ----------
    coordinates : Tensor
        What the block reads, (D + 1, K, p, n).
    first, message, second : Tensor
        After the first maps, after the sum over bones and after the second maps: (S p n, H), (K p n, H), (S p n, H).
    to_add, added : Tensor
        The same rows before and after that sum, one for each message (S, p n H) and for each node (K, p n H).
    grid : Tensor
        The sums once more, (K, p, n, H).
    reading, hearing : list of (Tensor, Tensor)
        For each map of the first and of the second layer the rows of the nodes that speak by it, and of what they say.
    """

    def __init__(self, coordinates: Tensor, memory: Tensor, bones: Bones) -> None:
        self.coordinates, self.shape = coordinates, coordinates.shape[2:]
        nodes, messages = bones.relations.shape
        columns = self.shape.numel()
        lengths = [count * columns for count in (messages, nodes, messages)]
        self.first, self.message, self.second = torch.split(memory, lengths)
        self.grid = self.message.view(nodes, *self.shape, -1)
        self.to_add, self.added = self.first.view(messages, -1), self.message.view(nodes, -1)
        rows, said = coordinates.view(len(coordinates), -1).T, 0
        self.reading, self.hearing = [], []
        for start, stop in bones.spans:
            speakers, spoken = (start * columns, (stop - start) * columns), (said, (stop - start) * columns)
            self.reading.append((rows.narrow(0, *speakers), self.first.narrow(0, *spoken)))
            self.hearing.append((self.message.narrow(0, *speakers), self.second.narrow(0, *spoken)))
            said += spoken[1]


class _Memory(NamedTuple):
    """Memory of R rooms, the room first: activations (R, rows, H) and coordinates (R + 1, D + 1, K, p, n).

    The last coordinates are those that leave the last room.
    """

    coordinates: Tensor
    activations: Tensor

    @classmethod
    def empty(cls, rooms: int, like: Tensor, bones: Bones, features: int) -> _Memory:
        """Make room for coordinates of one shape."""
        rows = like[0, 0].numel() * (bones.relations.shape[0] + 2 * bones.relations.shape[1])
        return cls(like.new_empty(rooms + 1, *like.shape), like.new_empty(rooms, rows, features))

    def rooms(self, bones: Bones) -> list[_Room]:
        """Give the rooms."""
        pairs = zip(self.coordinates[:-1].unbind(), self.activations.unbind(), strict=True)
        return [_Room(coordinates, activations, bones) for coordinates, activations in pairs]


def _net(room: _Room, block: Blocks, bones: Bones) -> Tensor:
    """Give shift and unconstrained scale of a block, (2, K, p, n), and leave the activations in the room."""
    for (heard, spoken), weights in zip(room.reading, block.first.unbind(), strict=True):
        torch.mm(heard, weights, out=spoken)
    room.first.relu_()
    torch.mm(bones.relations, room.to_add, out=room.added)
    room.grid.add_(block.evidence)
    for (heard, spoken), weights in zip(room.hearing, block.second.unbind(), strict=True):
        torch.mm(heard, weights, out=spoken)
    room.second.relu_()
    pooled = torch.mm(block.pool, room.second.T)
    told = torch.matmul(bones.relations, pooled.view(2, len(room.to_add), -1))
    return told.view(2, -1, *room.shape).add_(block.offset)


def _net_backward(gradient: Tensor, room: _Room, block: Blocks, bones: Bones, into: Blocks, scratch: _Room) -> Tensor:
    """Give the gradient of the coordinates, (D + 1, K, p, n), and add those of the block's tensors.

    ``gradient`` is of shift and unconstrained scale; the scratch room takes the gradients of the activations.
    """
    silence = torch.ops.aten.threshold_backward.grad_input
    pooled = torch.matmul(bones.relations.T, gradient.view(2, len(room.added), -1)).view(2, -1)
    into.pool.addmm_(pooled, room.second)
    torch.mm(pooled.T, block.pool, out=scratch.second)
    silence(scratch.second, room.second, 0, grad_input=scratch.second)
    maps = zip(room.hearing, scratch.hearing, block.second.unbind(), into.second.unbind(), strict=True)
    for which, ((heard, _), (d_heard, d_spoken), weights, d_weights) in enumerate(maps):
        d_weights.addmm_(heard.T, d_spoken)
        if which:
            d_heard.addmm_(d_spoken, weights.T)
        else:  # all nodes speak to themselves
            torch.mm(d_spoken, weights.T, out=d_heard)
    if scratch.grid.shape == into.evidence.shape:
        into.evidence.add_(scratch.grid)
    else:
        over = (1, 2) if into.evidence.shape[1] == 1 else 2
        into.evidence.add_(scratch.grid.sum(over, keepdim=True))
    torch.mm(bones.relations.T, scratch.added, out=scratch.to_add)
    silence(scratch.first, room.first, 0, grad_input=scratch.first)
    maps = zip(room.reading, scratch.reading, block.first.unbind(), into.first.unbind(), strict=True)
    for which, ((read, _), (d_read, d_spoken), weights, d_weights) in enumerate(maps):
        d_weights.addmm_(read.T, d_spoken)
        if which:
            d_read.T.addmm_(weights, d_spoken.T)
        else:
            torch.mm(weights, d_spoken.T, out=d_read.T)
    into.offset.add_(gradient.sum((2, 3) if into.offset.shape[2] == 1 else 3, keepdim=True))
    return scratch.coordinates


def _stretch(unconstrained: Tensor, scale: Scale) -> Tensor:
    """Turn the unconstrained scale into the positive one, in place."""
    return unconstrained.exp_() if scale == "exp" else unconstrained.add_(2).sigmoid_().add_(_FLOOR)


def _stretch_backward(gradient: Tensor, stretch: Tensor, scale: Scale) -> Tensor:
    """Give the gradient of the unconstrained scale."""
    if scale == "exp":
        return gradient * stretch
    share = stretch - _FLOOR
    return gradient * share * (1 - share)


class _Pass(torch.autograd.Function):
    """All blocks: from poses to latents with the log of the stretch, or, ``back``, from latents to poses.

    A block moves its coordinate by ``z = t + s (b + a x)``; x is the pose's side of it, z the latent's. Where gradients
    are wanted every block on the way has a room of its own, else all have the same.
    """

    @staticmethod
    def forward(
        ctx: Any, back: bool, scale: Scale, keep: bool, bones: Bones, coordinates: Tensor, *tensors: Tensor
    ) -> tuple[Tensor, Tensor]:
        blocks = Blocks(*tensors)
        dimensions, count = len(coordinates) - 1, len(blocks.pool)
        way = range(count)[::-1] if back else range(count)
        if blocks.evidence.shape[2] not in (1, poses := coordinates.shape[2]):
            raise PoseDataError(
                f"flow: keypoints of {blocks.evidence.shape[2]} poses and {poses} poses; expected as many."
            )
        found, log_stretch = torch.empty_like(coordinates), torch.zeros_like(coordinates[0])
        kept: list[Tensor] = []
        memory: _Memory | None = None
        rooms: list[_Room] = []
        parts = _parts(coordinates)
        for part in parts:
            here = coordinates[:, :, *part]
            if keep or memory is None or memory.coordinates.shape[1:] != here.shape:
                memory = _Memory.empty(count if keep else 1, here, bones, blocks.pool.shape[-1])
                rooms = memory.rooms(bones)
            here = memory.coordinates[0].copy_(here)
            stretches: list[Tensor] = []
            some = blocks.of_poses(part[0])
            for place, index in enumerate(way):
                block, room = some[index], rooms[place if keep else 0]
                shift, unconstrained = _net(room, block, bones).unbind()
                stretch = _stretch(unconstrained, scale)
                if keep:
                    here = memory.coordinates[place + 1].copy_(here)
                moved = here[index % dimensions]
                if back:
                    torch.sub(moved, shift, out=moved).div_(stretch).sub_(block.behind_shift).div_(block.behind_scale)
                else:
                    caught_up = torch.addcmul(block.behind_shift, moved, block.behind_scale)
                    torch.addcmul(shift, caught_up, stretch, out=moved)
                    log_stretch[:, *part] += stretch.log()
                stretches.append(stretch)
            found[:, :, *part] = here
            if keep and count:
                kept += [*memory, torch.stack(stretches)]
        ctx.back, ctx.scale, ctx.bones, ctx.way, ctx.parts = back, scale, bones, way, parts
        ctx.save_for_backward(*tensors, *kept)
        return found, log_stretch

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        width = len(Blocks._fields)
        blocks, kept = Blocks(*ctx.saved_tensors[:width]), ctx.saved_tensors[width:]
        into = Blocks(*(torch.zeros_like(tensor) for tensor in blocks))
        d_coordinates = gradients[0].clone()
        dimensions = len(d_coordinates) - 1
        for number, part in enumerate(ctx.parts if kept else []):
            coordinates, activations, stretches = kept[3 * number : 3 * number + 3]
            rooms = _Memory(coordinates, activations).rooms(ctx.bones)
            d_here = d_coordinates[:, :, *part].clone(memory_format=torch.contiguous_format)
            d_log_stretch = gradients[1][:, *part]
            (scratch,) = _Memory.empty(1, d_here, ctx.bones, activations.shape[-1]).rooms(ctx.bones)
            some, into_some = blocks.of_poses(part[0]), into.of_poses(part[0])
            for place, index in reversed(list(enumerate(ctx.way))):
                block, into_block, room, stretch = some[index], into_some[index], rooms[place], stretches[place]
                uncaught = coordinates[place + ctx.back, index % dimensions]
                caught_up = torch.addcmul(block.behind_shift, uncaught, block.behind_scale)
                d_moved = d_here[index % dimensions]
                if ctx.back:
                    d_caught_up = d_moved / -block.behind_scale
                    torch.div(d_caught_up, stretch, out=d_moved)
                    told = torch.stack([d_moved, d_moved * caught_up])
                    d_moved.neg_()
                else:
                    d_stretch = torch.addcdiv(d_moved * caught_up, d_log_stretch, stretch)
                    told = torch.stack([d_moved, d_stretch])
                    d_caught_up = d_moved * stretch
                    torch.mul(d_caught_up, block.behind_scale, out=d_moved)
                told[1] = _stretch_backward(told[1], stretch, ctx.scale)
                into_block.behind_scale.add_((d_caught_up * uncaught).sum())
                into_block.behind_shift.add_(d_caught_up.sum())
                d_here += _net_backward(told, room, block, ctx.bones, into_block, scratch)
            d_coordinates[:, :, *part] = d_here
        return None, None, None, None, d_coordinates, *into


def latents_of(coordinates: Tensor, blocks: Blocks, bones: Bones, scale: Scale) -> tuple[Tensor, Tensor]:
    """Pass poses through all blocks.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    blocks : Blocks
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
    keep = torch.is_grad_enabled()
    latents, log_stretch = _Pass.apply(False, scale, keep, bones, coordinates, *blocks)  # type: ignore[no-untyped-call]
    return latents, log_stretch


def poses_of(coordinates: Tensor, blocks: Blocks, bones: Bones, scale: Scale) -> Tensor:
    """Pass latents back through all blocks.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    blocks : Blocks
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
    keep = torch.is_grad_enabled()
    poses: Tensor = _Pass.apply(True, scale, keep, bones, coordinates, *blocks)[0]  # type: ignore[no-untyped-call]
    return poses
