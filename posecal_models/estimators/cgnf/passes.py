r"""Forward and inverse pass through all coupling blocks, and their gradients.

A block transforms one coordinate x of every node, given the other coordinates of all nodes:

.. math:: z = s \, (a x + b) + t, \qquad (t, u) = \mathrm{net}(\text{other coordinates}), \qquad s = \exp(u)
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
from posecal_models.estimators.cgnf.buffers import SAVED, BlockBuffers, MessageGraph, Workspace, parts_of
from posecal_models.estimators.cgnf.context_messages import (
    ContextBackward,
    ContextMaps,
    NodeIndex,
    context_messages,
    relu_backward,
)

__all__ = ["BlockWeights", "PassInputs", "Scale", "forward_pass", "inverse_pass"]

Scale = Literal["sigmoid", "exp"]

_FLOOR = 1e-3


class BlockWeights(NamedTuple):
    """The weights of L blocks, without those of the context messages.

    H counts the hidden features and a last one that is 1, which carries the biases of the second layer, filled up with
    zeros to a multiple of 8, on which matrix products are fastest.

    Attributes
    ----------
    first : Tensor
        Maps of the first layer: (L, maps, D + 1, H), the row of the transformed coordinate 0, the last row the biases.
    second : Tensor
        The first layer's update and the second layer's maps in one: (L, maps, H, H).
    pool : Tensor
        The second layer's update: (L, 2, H).
    pending_scale, pending_shift : Tensor
        a and b, (L,) each: the ActNorms that the transformed coordinate has yet to pass.
    """

    first: Tensor
    second: Tensor
    pool: Tensor
    pending_scale: Tensor
    pending_shift: Tensor


class PassInputs(NamedTuple):
    """What a pass needs besides the coordinates.

    Attributes
    ----------
    blocks : BlockWeights
        The L blocks, first to last; block l transforms coordinate l modulo D.
    context : ContextMaps
        Keypoints and root of the P poses, with the maps of their messages.
    node_index : NodeIndex or None
        Targets of the keypoints; None where none was observed.
    graph : MessageGraph
        Senders and receivers of messages.
    scale : str
        The function from the unconstrained to the positive scale.
    workspace : Workspace or None
        Memory for the activations; newly allocated where it is None.
    """

    blocks: BlockWeights
    context: ContextMaps
    node_index: NodeIndex | None
    graph: MessageGraph
    scale: Scale
    workspace: Workspace | None


class _Block:
    """The weights of one block, map by map."""

    def __init__(
        self, first: Tensor, second: Tensor, pool: Tensor, pending_scale: Tensor, pending_shift: Tensor
    ) -> None:
        self.first, self.second, self.pool = first.unbind(), second.unbind(), pool
        self.pending_scale, self.pending_shift = pending_scale, pending_shift

    @classmethod
    def unbind(cls, blocks: BlockWeights) -> list[_Block]:
        """Split the stacked weights into blocks."""
        return [cls(*block) for block in zip(*(tensor.unbind() for tensor in blocks), strict=True)]


def _net(buffers: BlockBuffers, block: _Block, message: Tensor, offset: Tensor, graph: MessageGraph) -> None:
    """Compute one block's shift and unconstrained scale into ``buffers``, with the activations that lead to them."""
    for (senders, messages), weights in zip(buffers.first_views, block.first, strict=True):
        torch.mm(senders, weights, out=messages)
    buffers.first.relu_()
    torch.add(buffers.self_grid, message, out=buffers.message_grid)
    buffers.message_matrix.addmm_(graph.edges, buffers.edge_matrix)
    for (senders, messages), weights in zip(buffers.second_views, block.second, strict=True):
        torch.mm(senders, weights, out=messages)
    buffers.second.relu_()
    torch.mm(block.pool, buffers.second_transposed, out=buffers.pooled)
    buffers.shift_scale.copy_(offset)
    buffers.shift_scale_matrix.addmm_(graph.two_features, buffers.pooled_matrix)


def _net_backward(
    buffers: BlockBuffers, block: _Block, graph: MessageGraph, d_block: _Block, scratch: BlockBuffers
) -> None:
    """Compute the gradients of coordinates and sums into ``scratch``, and add those of the block's weights.

    Before, ``scratch`` holds the gradients of shift and unconstrained scale.
    """
    torch.mm(graph.two_features.T, scratch.shift_scale_matrix, out=scratch.pooled_matrix)
    d_block.pool.addmm_(scratch.pooled, buffers.second)
    torch.mm(scratch.pooled.T, block.pool, out=scratch.second)
    relu_backward(scratch.second, buffers.second, 0, grad_input=scratch.second)
    maps = zip(buffers.second_views, scratch.second_views, block.second, d_block.second, strict=True)
    for which, ((senders, _), (d_senders, d_messages), weights, d_weights) in enumerate(maps):
        d_weights.addmm_(senders.T, d_messages)
        if which:
            d_senders.addmm_(d_messages, weights.T)
        else:  # the first map has all nodes as senders
            torch.mm(d_messages, weights.T, out=d_senders)
    torch.mm(graph.edges.T, scratch.message_matrix, out=scratch.edge_matrix)
    relu_backward(scratch.edge_messages, buffers.edge_messages, 0, grad_input=scratch.edge_messages)
    relu_backward(scratch.message, buffers.self_messages, 0, grad_input=scratch.self_messages)
    maps = zip(buffers.first_views, scratch.first_views, block.first, d_block.first, strict=True)
    for which, ((senders, _), (d_senders, d_messages), weights, d_weights) in enumerate(maps):
        d_weights.addmm_(senders.T, d_messages)
        if which:
            d_senders.T.addmm_(weights, d_messages.T)
        else:
            torch.mm(weights, d_messages.T, out=d_senders.T)


def _to_positive(scale: Tensor, kind: Scale) -> None:
    """Turn the unconstrained scale into the positive one, in place."""
    if kind == "exp":
        scale.exp_()
    else:
        scale.add_(2).sigmoid_().add_(_FLOOR)


def _add_log_scale(unconstrained: Tensor, total: Tensor, kind: Scale) -> None:
    """Add the log of the positive scale, in nats; that of the exponential one is exact where it overflows."""
    if kind == "exp":
        total += unconstrained
    else:
        total += (unconstrained + 2).sigmoid_().add_(_FLOOR).log_()


def _scale_backward(gradient: Tensor, d_log: Tensor | None, scale: Tensor, kind: Scale) -> None:
    """Turn the gradient of the scale into that of the unconstrained one, in place, and add that of its log."""
    if kind == "exp":
        gradient.mul_(scale)
        if d_log is not None:
            gradient.add_(d_log)
        return
    if d_log is not None:
        gradient.addcdiv_(d_log, scale)
    sigmoid = scale - _FLOOR
    gradient.mul_(sigmoid).mul_(1 - sigmoid)


class _Pass(torch.autograd.Function):
    """All blocks: from poses to latents with the sum of log scales, or, ``inverse``, from latents to poses.

    A block transforms its coordinate by ``z = t + s (b + a x)``, with x on the side of the pose and z on that of the
    latent. With a backward pass to come every block has buffers of its own, else all share the same.
    """

    @staticmethod
    def forward(
        ctx: Any,
        inverse: bool,
        kind: Scale,
        keep: bool,
        workspace: Workspace | None,
        graph: MessageGraph,
        node_index: NodeIndex | None,
        coordinates: Tensor,
        *tensors: Tensor,
    ) -> tuple[Tensor, Tensor]:
        weights, context = _split_tensors(tensors)
        memory = Workspace() if workspace is None else workspace
        dimensions, features = len(coordinates) - 1, weights.pool.shape[-1]
        blocks = _Block.unbind(weights)
        order = range(len(blocks))[::-1] if inverse else range(len(blocks))
        result, log_scale = coordinates.clone(), torch.zeros_like(coordinates[0])
        parts = parts_of(coordinates) if blocks else []
        messages: list[tuple[Tensor, Tensor]] = []
        for number, part in enumerate(parts):
            if part[1].start == 0:  # the first samples of these poses
                sums = context_messages(context, node_index, part[0], memory, keep=keep)
                messages = list(zip(*sums, strict=True))
            part_of_result = result[:, :, *part]
            use, count = (_saved_part(number), len(blocks)) if keep else ("part", 1)
            all_buffers = memory.block_buffers(use, count, part_of_result, graph, features, keep=keep)
            all_buffers[0].inputs.copy_(part_of_result)
            for index, buffers in zip(order, all_buffers * (len(blocks) // count), strict=True):
                block = blocks[index]
                _net(buffers, block, *messages[index], graph)
                if not inverse:
                    _add_log_scale(buffers.scale, log_scale[:, *part], kind)
                _to_positive(buffers.scale, kind)
                if keep:
                    buffers.outputs.copy_(buffers.inputs)
                coordinate = buffers.outputs[index % dimensions]
                if inverse:
                    coordinate.sub_(buffers.shift).div_(buffers.scale)
                    coordinate.sub_(block.pending_shift).div_(block.pending_scale)
                else:
                    normalized = torch.addcmul(block.pending_shift, coordinate, block.pending_scale)
                    torch.addcmul(buffers.shift, normalized, buffers.scale, out=coordinate)
            part_of_result.copy_(all_buffers[-1].outputs)
        saved = memory.saved() if keep else {}
        ctx.inverse, ctx.kind, ctx.workspace, ctx.graph, ctx.node_index = inverse, kind, workspace, graph, node_index
        ctx.parts, ctx.uses = parts, tuple(saved)
        ctx.save_for_backward(*tensors, *saved.values())
        return result, log_scale

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        count, saved_tensors = len(BlockWeights._fields) + len(ContextMaps._fields), ctx.saved_tensors
        tensors, saved = saved_tensors[:count], dict(zip(ctx.uses, saved_tensors[count:], strict=True))
        memory: Workspace | None = ctx.workspace
        if memory is None or any(memory.memory[use].data_ptr() != tensor.data_ptr() for use, tensor in saved.items()):
            memory = Workspace(saved)  # no workspace was given, or a later pass needed more memory
        d_tensors = [torch.zeros_like(tensor) for tensor in tensors]
        (weights, context), (d_weights, d_context) = _split_tensors(tensors), _split_tensors(d_tensors)
        d_coordinates = gradients[0].clone()
        dimensions, features = len(d_coordinates) - 1, weights.pool.shape[-1]
        blocks, d_blocks = _Block.unbind(weights), _Block.unbind(d_weights)
        order = range(len(blocks)) if ctx.inverse else range(len(blocks))[::-1]
        for number, part in enumerate(ctx.parts):
            d_part, d_log_scale = d_coordinates[:, :, *part], gradients[1][:, *part]
            all_buffers = memory.block_buffers(_saved_part(number), len(blocks), d_part, ctx.graph, features, keep=True)
            (scratch,) = memory.block_buffers("gradients", 1, d_part, ctx.graph, features, keep=True)
            context_backward = ContextBackward(context, d_context, ctx.node_index, part[0], memory)
            d_flow = scratch.outputs.copy_(d_part)
            for index, buffers in zip(order, reversed(all_buffers), strict=True):
                block, d_block = blocks[index], d_blocks[index]
                pose_side = (buffers.outputs if ctx.inverse else buffers.inputs)[index % dimensions]
                normalized = torch.addcmul(block.pending_shift, pose_side, block.pending_scale)
                d_coordinate = d_flow[index % dimensions]
                if ctx.inverse:
                    d_normalized = d_coordinate / -block.pending_scale
                    torch.div(d_normalized, buffers.scale, out=d_coordinate)
                    torch.mul(d_coordinate, normalized, out=scratch.scale)
                    scratch.shift.copy_(d_coordinate)
                    d_coordinate.neg_()
                else:
                    torch.mul(d_coordinate, normalized, out=scratch.scale)
                    scratch.shift.copy_(d_coordinate)
                    d_normalized = d_coordinate * buffers.scale
                    torch.mul(d_normalized, block.pending_scale, out=d_coordinate)
                d_log = None if ctx.inverse else d_log_scale
                _scale_backward(scratch.scale, d_log, buffers.scale, ctx.kind)
                d_block.pending_scale.add_((d_normalized * pose_side).sum())
                d_block.pending_shift.add_(d_normalized.sum())
                _net_backward(buffers, block, ctx.graph, d_block, scratch)
                d_flow += scratch.inputs
                context_backward.add(index, scratch.message_grid, scratch.shift_scale)
            context_backward.finish()
            d_part.copy_(d_flow)
        return None, None, None, None, None, None, d_coordinates, *d_tensors


def _saved_part(number: int) -> str:
    return f"{SAVED} part {number}"


def _split_tensors(tensors: Sequence[Tensor]) -> tuple[BlockWeights, ContextMaps]:
    """Split a flat sequence into the tensors of the blocks and those of the context."""
    count = len(BlockWeights._fields)
    return BlockWeights(*tensors[:count]), ContextMaps(*tensors[count:])


def forward_pass(coordinates: Tensor, inputs: PassInputs) -> tuple[Tensor, Tensor]:
    """Transform poses into latents.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    inputs : PassInputs
        Weights and context of the blocks.

    Returns
    -------
    coordinates : Tensor
        The same shape.
    log_scale : Tensor
        (K, P, n), nats: the sum of log s over the blocks.

    Raises
    ------
    PoseDataError
        Where the keypoints, or the roots, are those of another number of poses.
    """
    return _apply(coordinates, inputs, inverse=False)


def inverse_pass(coordinates: Tensor, inputs: PassInputs) -> Tensor:
    """Transform latents into poses.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n), unitless, the last row ones.
    inputs : PassInputs
        Weights and context of the blocks.

    Returns
    -------
    Tensor
        The same shape.

    Raises
    ------
    PoseDataError
        As :func:`forward_pass`.
    """
    return _apply(coordinates, inputs, inverse=True)[0]


def _apply(coordinates: Tensor, inputs: PassInputs, *, inverse: bool) -> tuple[Tensor, Tensor]:
    """Check the numbers of poses and run the pass."""
    blocks, context, node_index, graph, kind, workspace = inputs
    roots, poses = context.root.shape[2], coordinates.shape[2]
    context_poses = roots if node_index is None else node_index.poses
    if context_poses not in (1, poses):
        raise PoseDataError(f"flow: keypoints of {context_poses} poses and {poses} poses; expected as many.")
    if roots not in (1, context_poses):
        raise PoseDataError(f"flow: roots of {roots} poses and keypoints of {context_poses}; expected as many.")
    keep = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in (coordinates, *blocks, *context))
    result: tuple[Tensor, Tensor] = _Pass.apply(  # type: ignore[no-untyped-call]
        inverse, kind, keep, workspace, graph, node_index, coordinates, *blocks, *context
    )
    return result
