"""Preallocated activation buffers, reused across forward and backward passes.

Allocating memory costs more than the arithmetic on it, and so does making views of it for every small operation:
buffers are laid out once, with all the views that a block needs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["SAVED", "BlockBuffers", "MessageGraph", "Part", "Workspace", "parts_of"]


class MessageGraph(NamedTuple):
    """Senders and receivers of the messages between nodes.

    Attributes
    ----------
    spans : tuple of (int, int)
        For each map the nodes that send messages with it, (start, stop): all of them to themselves, some along edges.
    aggregation : Tensor
        (K, S): sums the S messages, the spans after one another, at their receivers. The first K are self messages.
    edges : Tensor
        (K, S - K): the same without self messages.
    two_features : Tensor
        (2 K, 2 S): the aggregation of two features at once.
    """

    spans: tuple[tuple[int, int], ...]
    aggregation: Tensor
    edges: Tensor
    two_features: Tensor

    @classmethod
    def of(cls, spans: tuple[tuple[int, int], ...], aggregation: Tensor) -> MessageGraph:
        """Derive the other matrices from spans and aggregation.

        Parameters
        ----------
        spans, aggregation
            The attributes of these names.

        Returns
        -------
        MessageGraph
            With all attributes.
        """
        nodes, messages = aggregation.shape
        two_features = aggregation.new_zeros(2, nodes, 2, messages)
        two_features[0, :, 0] = two_features[1, :, 1] = aggregation
        return cls(spans, aggregation, aggregation[:, nodes:], two_features.view(2 * nodes, 2 * messages))


Part = tuple[slice, slice]
"""Some poses and some of their samples, few enough for their activations to stay in the processor's cache."""

_ROWS_IN_CACHE = 1024


def parts_of(coordinates: Tensor) -> list[Part]:
    """Split the grid of poses and samples into parts; a GPU takes all of it at once.

    Parameters
    ----------
    coordinates : Tensor
        (D + 1, K, P, n).

    Returns
    -------
    list of (slice, slice)
        Pose by pose.
    """
    _, nodes, poses, samples = coordinates.shape
    if not poses * samples:
        return []
    at_once = max(1, _ROWS_IN_CACHE // nodes) if coordinates.device.type == "cpu" else poses * samples
    samples_each = -(-samples // -(-samples // at_once))
    poses_each = max(1, at_once // samples_each)
    return [
        (slice(p, min(p + poses_each, poses)), slice(n, min(n + samples_each, samples)))
        for p in range(0, poses, poses_each)
        for n in range(0, samples, samples_each)
    ]


class BlockBuffers:
    """Activations of one block and one part, and the views of them that message passing needs.

    Rows of activations are (node or message, pose, sample), flattened.

    Attributes
    ----------
    inputs, outputs : Tensor
        Coordinates before and after the block, (D + 1, K, p, n).
    first, message, second : Tensor
        After the first maps, after the sum over edges and after the second maps: (S p n, H), (K p n, H), (S p n, H).
        Without a backward pass the sums overwrite the self messages.
    self_messages, edge_messages : Tensor
        Of the first, the messages of nodes to themselves and to others: (K p n, H) and ((S - K) p n, H).
    pooled : Tensor
        The second layer's update before the sum over edges, (2, S p n).
    shift_scale : Tensor
        Shift and scale, (2, K, p, n).
    first_views, second_views : list of (Tensor, Tensor)
        For each map of the first and of the second layer the rows of the senders, and of their messages.
    """

    def __init__(
        self, inputs: Tensor, outputs: Tensor, activations: Tensor, graph: MessageGraph, features: int, *, keep: bool
    ) -> None:
        nodes, messages = graph.aggregation.shape
        grid = inputs.shape[1:]
        columns = grid[1:].numel()
        lengths = _lengths(grid, graph, features, keep=keep)
        first, second, shift_scale, pooled, sums = torch.split(activations, lengths)
        self.inputs, self.outputs = inputs, outputs
        self.first, self.second = first.view(-1, features), second.view(-1, features)
        self.self_messages, self.edge_messages = self.first[: nodes * columns], self.first[nodes * columns :]
        self.message = sums.view(-1, features) if keep else self.self_messages
        self.second_transposed = self.second.T
        self.self_grid = self.self_messages.view(*grid, features)
        self.message_grid = self.message.view(*grid, features)
        self.edge_matrix = self.edge_messages.view(messages - nodes, -1)
        self.message_matrix = self.message.view(nodes, -1)
        self.shift_scale, self.pooled = shift_scale.view(2, *grid), pooled.view(2, -1)
        self.shift, self.scale = self.shift_scale.unbind()
        self.shift_scale_matrix = shift_scale.view(2 * nodes, columns)
        self.pooled_matrix = pooled.view(2 * messages, columns)
        coordinates, row = inputs.view(len(inputs), -1).T, 0
        self.first_views, self.second_views = [], []
        for start, stop in graph.spans:
            length = (stop - start) * columns
            self.first_views.append((coordinates.narrow(0, start * columns, length), self.first.narrow(0, row, length)))
            self.second_views.append(
                (self.message.narrow(0, start * columns, length), self.second.narrow(0, row, length))
            )
            row += length


def _lengths(grid: torch.Size, graph: MessageGraph, features: int, *, keep: bool) -> list[int]:
    """Count the activations of one block for a (K, p, n) grid: first, second, shift and scale, pooled and sums."""
    nodes, messages = graph.aggregation.shape
    columns = grid[1:].numel()
    lengths = [messages * features, messages * features, 2 * nodes, 2 * messages, nodes * features if keep else 0]
    return [length * columns for length in lengths]


SAVED = "saved"
"""Prefix of the names of memory that the backward pass needs."""


class Workspace:
    """Memory for the activations of one pass after another.

    Gradients of a pass must be taken before the next one that has gradients begins in the same workspace: autograd
    raises an error otherwise. It is for one thread, and grows to the largest pass.

    Parameters
    ----------
    memory : mapping of str to Tensor, optional
        Memory to begin with, by use.

    Attributes
    ----------
    memory : dict of str to Tensor
        All memory, by use; flat.
    """

    def __init__(self, memory: Mapping[str, Tensor] = MappingProxyType({})) -> None:
        self.memory = dict(memory)
        self._buffers: dict[tuple[object, ...], list[BlockBuffers]] = {}

    def saved(self) -> dict[str, Tensor]:
        """Return the memory that the backward pass needs, by use."""
        return {use: memory for use, memory in self.memory.items() if use.startswith(SAVED)}

    def allocate(self, use: str, shape: tuple[int, ...], like: Tensor) -> Tensor:
        """Return memory of one shape, reusing that of the same use.

        Parameters
        ----------
        use : str
            What the memory is for.
        shape : tuple of int
            The shape.
        like : Tensor
            A tensor of the same type and on the same device.

        Returns
        -------
        Tensor
            Of this shape, with what was written there before.
        """
        length, memory = math.prod(shape), self.memory.get(use)
        if memory is None or len(memory) < length or _kind(memory) != _kind(like) or not _is_writable(memory):
            memory = self.memory[use] = like.new_empty(length)
            self._buffers = {layout: buffers for layout, buffers in self._buffers.items() if layout[0] != use}
        return memory[:length].view(shape)

    def block_buffers(
        self, use: str, count: int, like: Tensor, graph: MessageGraph, features: int, *, keep: bool
    ) -> list[BlockBuffers]:
        """Return the buffers of several blocks for coordinates of one shape.

        Parameters
        ----------
        use : str
            What the memory is for.
        count : int
            Number of blocks.
        like : Tensor
            Coordinates, (D + 1, K, p, n).
        graph : MessageGraph
            Senders and receivers of messages.
        features : int
            H.
        keep : bool
            Whether the backward pass needs them. The output of each block is then the input of the next, else its own.

        Returns
        -------
        list of BlockBuffers
            In the order in which a pass goes through the blocks.
        """
        length = like.numel() * (count + keep)
        activations = sum(_lengths(like.shape[1:], graph, features, keep=keep))
        flat = self.allocate(use, (length + count * activations,), like)
        layout = (use, count, like.shape, features, keep, graph.spans)
        if layout not in self._buffers:
            coordinates = flat[:length].view(-1, *like.shape).unbind()
            outputs = coordinates[1:] if keep else coordinates
            tensors = zip(coordinates, outputs, flat[length:].view(count, -1), strict=False)
            self._buffers[layout] = [BlockBuffers(*block, graph, features, keep=keep) for block in tensors]
        return self._buffers[layout]


def _kind(tensor: Tensor) -> tuple[torch.dtype, torch.device]:
    return tensor.dtype, tensor.device


def _is_writable(memory: Tensor) -> bool:
    """Whether autograd allows in-place writes: not to tensors of inference mode, outside of it."""
    return torch.is_inference_mode_enabled() or not memory.is_inference()
