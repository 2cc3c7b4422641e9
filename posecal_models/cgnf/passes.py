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

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from posecal.errors import PoseDataError
from posecal_models.cgnf.hearing import HeardBackward, Seats, Voices, hear
from posecal_models.cgnf.rooms import KEPT, Bones, Room, Workspace, parts_of

__all__ = ["Blocks", "Path", "Scale", "latents_of", "poses_of"]

Scale = Literal["sigmoid", "exp"]

_FLOOR = 1e-3


class Blocks(NamedTuple):
    """What the L blocks consist of, but for what they are told of the keypoints.

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
    behind_scale, behind_shift : Tensor
        a and b, (L,) each: the ActNorms that the moved coordinate has yet to pass.
    """

    first: Tensor
    second: Tensor
    pool: Tensor
    behind_scale: Tensor
    behind_shift: Tensor


class Path(NamedTuple):
    """What leads from the poses to their latents, and back.

    Attributes
    ----------
    blocks : Blocks
        The L blocks; block l moves coordinate l modulo D.
    voices : Voices
        What speaks to the P poses.
    seats : Seats or None
        Where keypoints speak; None where none was observed.
    bones : Bones
        Who speaks to whom.
    scale : str
        How the unconstrained scale becomes a positive one.
    workspace : Workspace or None
        Memory for the activations; fresh memory where it is None.
    """

    blocks: Blocks
    voices: Voices
    seats: Seats | None
    bones: Bones
    scale: Scale
    workspace: Workspace | None


class _Block:
    """What one block consists of but for what it is told of the keypoints, map by map."""

    def __init__(self, first: Tensor, second: Tensor, pool: Tensor, behind_scale: Tensor, behind_shift: Tensor) -> None:
        self.first, self.second, self.pool = first.unbind(), second.unbind(), pool
        self.behind_scale, self.behind_shift = behind_scale, behind_shift

    @classmethod
    def each(cls, blocks: Blocks) -> list[_Block]:
        """Take all blocks apart."""
        tensors = (blocks.first, blocks.second, blocks.pool, blocks.behind_scale, blocks.behind_shift)
        return [cls(*block) for block in zip(*(tensor.unbind() for tensor in tensors), strict=True)]


def _net(room: Room, block: _Block, evidence: Tensor, offset: Tensor, bones: Bones) -> None:
    """Leave a block's shift and unconstrained scale in the room, and the activations that lead to them."""
    for (heard, spoken), weights in zip(room.reading, block.first, strict=True):
        torch.mm(heard, weights, out=spoken)
    room.first.relu_()
    torch.add(room.own_grid, evidence, out=room.message_grid)
    room.message_each.addmm_(bones.between, room.others_each)
    for (heard, spoken), weights in zip(room.hearing, block.second, strict=True):
        torch.mm(heard, weights, out=spoken)
    room.second.relu_()
    torch.mm(block.pool, room.second_across, out=room.pooled)
    room.told.copy_(offset)
    room.told_each.addmm_(bones.twice, room.pooled_each)


def _net_backward(room: Room, block: _Block, bones: Bones, into: _Block, scratch: Room) -> None:
    """Leave the gradients of coordinates and sums in the scratch room, and add those of the block's tensors.

    The scratch room holds the gradients of shift and unconstrained scale.
    """
    silence = torch.ops.aten.threshold_backward.grad_input
    torch.mm(bones.twice.T, scratch.told_each, out=scratch.pooled_each)
    into.pool.addmm_(scratch.pooled, room.second)
    torch.mm(scratch.pooled.T, block.pool, out=scratch.second)
    silence(scratch.second, room.second, 0, grad_input=scratch.second)
    maps = zip(room.hearing, scratch.hearing, block.second, into.second, strict=True)
    for which, ((heard, _), (d_heard, d_spoken), weights, d_weights) in enumerate(maps):
        d_weights.addmm_(heard.T, d_spoken)
        if which:
            d_heard.addmm_(d_spoken, weights.T)
        else:  # all nodes speak to themselves
            torch.mm(d_spoken, weights.T, out=d_heard)
    torch.mm(bones.between.T, scratch.message_each, out=scratch.others_each)
    silence(scratch.others, room.others, 0, grad_input=scratch.others)
    silence(scratch.message, room.own, 0, grad_input=scratch.own)
    maps = zip(room.reading, scratch.reading, block.first, into.first, strict=True)
    for which, ((read, _), (d_read, d_spoken), weights, d_weights) in enumerate(maps):
        d_weights.addmm_(read.T, d_spoken)
        if which:
            d_read.T.addmm_(weights, d_spoken.T)
        else:
            torch.mm(weights, d_spoken.T, out=d_read.T)


def _stretch(unconstrained: Tensor, scale: Scale) -> None:
    """Turn the unconstrained scale into the positive one, in place."""
    if scale == "exp":
        unconstrained.exp_()
    else:
        unconstrained.add_(2).sigmoid_().add_(_FLOOR)


def _add_log_stretch(unconstrained: Tensor, total: Tensor, scale: Scale) -> None:
    """Add the log of the positive scale, in nats; that of the exponential one is exact where it overflows."""
    if scale == "exp":
        total += unconstrained
    else:
        total += (unconstrained + 2).sigmoid_().add_(_FLOOR).log_()


def _stretch_backward(gradient: Tensor, d_log: Tensor | None, stretch: Tensor, scale: Scale) -> None:
    """Turn the gradient of the scale into that of the unconstrained one, in place, and add that of its log."""
    if scale == "exp":
        gradient.mul_(stretch)
        if d_log is not None:
            gradient.add_(d_log)
        return
    if d_log is not None:
        gradient.addcdiv_(d_log, stretch)
    share = stretch - _FLOOR
    gradient.mul_(share).mul_(1 - share)


class _Pass(torch.autograd.Function):
    """All blocks: from poses to latents with the log of the stretch, or, ``back``, from latents to poses.

    A block moves its coordinate by ``z = t + s (b + a x)``; x is the pose's side of it, z the latent's. Where gradients
    are wanted every block on the way has a room of its own, else all have the same.
    """

    @staticmethod
    def forward(
        ctx: Any,
        back: bool,
        scale: Scale,
        keep: bool,
        workspace: Workspace | None,
        bones: Bones,
        seats: Seats | None,
        coordinates: Tensor,
        *tensors: Tensor,
    ) -> tuple[Tensor, Tensor]:
        blocks, voices = _sorted(tensors)
        space = Workspace() if workspace is None else workspace
        dimensions, features = len(coordinates) - 1, blocks.pool.shape[-1]
        each = _Block.each(blocks)
        way = range(len(each))[::-1] if back else range(len(each))
        found, log_stretch = coordinates.clone(), torch.zeros_like(coordinates[0])
        parts = parts_of(coordinates) if each else []
        told: list[tuple[Tensor, Tensor]] = []
        for number, part in enumerate(parts):
            if part[1].start == 0:  # the first samples of these poses
                told = list(zip(*hear(voices, seats, part[0], space, keep=keep), strict=True))
            here = found[:, :, *part]
            use, count = (_use(number), len(each)) if keep else ("part", 1)
            rooms = space.rooms(use, count, here, bones, features, keep=keep)
            rooms[0].entering.copy_(here)
            for index, room in zip(way, rooms * (len(each) // count), strict=True):
                block = each[index]
                _net(room, block, *told[index], bones)
                if not back:
                    _add_log_stretch(room.stretch, log_stretch[:, *part], scale)
                _stretch(room.stretch, scale)
                if keep:
                    room.leaving.copy_(room.entering)
                moved = room.leaving[index % dimensions]
                if back:
                    moved.sub_(room.shift).div_(room.stretch).sub_(block.behind_shift).div_(block.behind_scale)
                else:
                    caught_up = torch.addcmul(block.behind_shift, moved, block.behind_scale)
                    torch.addcmul(room.shift, caught_up, room.stretch, out=moved)
            here.copy_(rooms[-1].leaving)
        kept = space.kept() if keep else {}
        ctx.back, ctx.scale, ctx.workspace, ctx.bones, ctx.seats = back, scale, workspace, bones, seats
        ctx.parts, ctx.uses = parts, tuple(kept)
        ctx.save_for_backward(*tensors, *kept.values())
        return found, log_stretch

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        width, saved = len(Blocks._fields) + len(Voices._fields), ctx.saved_tensors
        tensors, kept = saved[:width], dict(zip(ctx.uses, saved[width:], strict=True))
        space: Workspace | None = ctx.workspace
        if space is None or any(space.memory[use].data_ptr() != memory.data_ptr() for use, memory in kept.items()):
            space = Workspace(kept)  # a later pass needed more memory, or somebody else has kept it
        into_tensors = [torch.zeros_like(tensor) for tensor in tensors]
        (blocks, voices), (into, into_voices) = _sorted(tensors), _sorted(into_tensors)
        d_coordinates = gradients[0].clone()
        dimensions, features = len(d_coordinates) - 1, blocks.pool.shape[-1]
        each, into_each = _Block.each(blocks), _Block.each(into)
        way = range(len(each)) if ctx.back else range(len(each))[::-1]
        for number, part in enumerate(ctx.parts):
            d_here, d_log_stretch = d_coordinates[:, :, *part], gradients[1][:, *part]
            rooms = space.rooms(_use(number), len(each), d_here, ctx.bones, features, keep=True)
            (scratch,) = space.rooms("gradients", 1, d_here, ctx.bones, features, keep=True)
            heard = HeardBackward(voices, into_voices, ctx.seats, part[0], space)
            d_flow = scratch.leaving.copy_(d_here)
            for index, room in zip(way, reversed(rooms), strict=True):
                block, into_block = each[index], into_each[index]
                uncaught = (room.leaving if ctx.back else room.entering)[index % dimensions]
                caught_up = torch.addcmul(block.behind_shift, uncaught, block.behind_scale)
                d_moved = d_flow[index % dimensions]
                if ctx.back:
                    d_caught_up = d_moved / -block.behind_scale
                    torch.div(d_caught_up, room.stretch, out=d_moved)
                    torch.mul(d_moved, caught_up, out=scratch.stretch)
                    scratch.shift.copy_(d_moved)
                    d_moved.neg_()
                else:
                    torch.mul(d_moved, caught_up, out=scratch.stretch)
                    scratch.shift.copy_(d_moved)
                    d_caught_up = d_moved * room.stretch
                    torch.mul(d_caught_up, block.behind_scale, out=d_moved)
                d_log = None if ctx.back else d_log_stretch
                _stretch_backward(scratch.stretch, d_log, room.stretch, ctx.scale)
                into_block.behind_scale.add_((d_caught_up * uncaught).sum())
                into_block.behind_shift.add_(d_caught_up.sum())
                _net_backward(room, block, ctx.bones, into_block, scratch)
                d_flow += scratch.entering
                heard.add(index, scratch.message_grid, scratch.told)
            heard.finish()
            d_here.copy_(d_flow)
        return None, None, None, None, None, None, d_coordinates, *into_tensors


def _use(part: int) -> str:
    return f"{KEPT} of part {part}"


def _sorted(tensors: Sequence[Tensor]) -> tuple[Blocks, Voices]:
    """Tell the tensors of blocks and voices apart."""
    return Blocks(*tensors[: len(Blocks._fields)]), Voices(*tensors[len(Blocks._fields) :])


def latents_of(coordinates: Tensor, path: Path) -> tuple[Tensor, Tensor]:
    """Pass poses through all blocks.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    path : Path
        The blocks, and what they are told.

    Returns
    -------
    coordinates : Tensor
        The same shape.
    log_stretch : Tensor
        (K, P, n), nats: the sum of log s over the blocks.

    Raises
    ------
    PoseDataError
        Where the keypoints, or the roots, are those of another number of poses.
    """
    return _walk(coordinates, path, back=False)


def poses_of(coordinates: Tensor, path: Path) -> Tensor:
    """Pass latents back through all blocks.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    path : Path
        The blocks, first to last, and what they are told.

    Returns
    -------
    Tensor
        The same shape.

    Raises
    ------
    PoseDataError
        As :func:`latents_of`.
    """
    return _walk(coordinates, path, back=True)[0]


def _walk(coordinates: Tensor, path: Path, *, back: bool) -> tuple[Tensor, Tensor]:
    """Pass through all blocks, one way or the other."""
    blocks, voices, seats, bones, scale, workspace = path
    root, poses = voices.root.shape[2], coordinates.shape[2]
    said_to = root if seats is None else seats.poses
    if said_to not in (1, poses):
        raise PoseDataError(f"flow: keypoints of {said_to} poses and {poses} poses; expected as many.")
    if root not in (1, said_to):
        raise PoseDataError(f"flow: roots of {root} poses and keypoints of {said_to}; expected as many.")
    keep = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in (coordinates, *blocks, *voices))
    found: tuple[Tensor, Tensor] = _Pass.apply(  # type: ignore[no-untyped-call]
        back, scale, keep, workspace, bones, seats, coordinates, *blocks, *voices
    )
    return found
