"""Where do activations lie? In rooms of memory that passes through the flow write over and over.

Fresh memory costs more than the arithmetic on it, and so does making views of it for every small operation: rooms are
laid out once, with all the views that a block needs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["KEPT", "Bones", "Part", "Room", "Workspace", "parts_of"]


class Bones(NamedTuple):
    """Who speaks, and to whom.

    Attributes
    ----------
    spans : tuple of (int, int)
        For each map the nodes that speak by it, (start, stop): all of them to themselves, some along the bones.
    relations : Tensor
        (K, S): what all S messages, the spans after one another, add up to. The first K are to the nodes themselves.
    between : Tensor
        (K, S - K): the same without those.
    twice : Tensor
        (2 K, 2 S): the relations for two features at once.
    """

    spans: tuple[tuple[int, int], ...]
    relations: Tensor
    between: Tensor
    twice: Tensor

    @classmethod
    def of(cls, spans: tuple[tuple[int, int], ...], relations: Tensor) -> Bones:
        """Derive what follows from spans and relations.

        Parameters
        ----------
        spans, relations
            The attributes of these names.

        Returns
        -------
        Bones
            With all of them.
        """
        nodes, messages = relations.shape
        twice = relations.new_zeros(2, nodes, 2, messages)
        twice[0, :, 0] = twice[1, :, 1] = relations
        return cls(spans, relations, relations[:, nodes:], twice.view(2 * nodes, 2 * messages))


Part = tuple[slice, slice]
"""Some poses and some of their samples, few enough for their activations to stay in the processor's cache."""

_ROWS_IN_CACHE = 1024


def parts_of(coordinates: Tensor) -> list[Part]:
    """Cut the grid of poses and samples into parts; a GPU takes all of it at once.

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


class Room:
    """Memory for one block and one part, and the views of it by which messages pass.

    Rows of activations are (node or message, pose, sample), flattened.

    Attributes
    ----------
    entering, leaving : Tensor
        The coordinates that the block reads and those that it gives, (D + 1, K, p, n).
    first, message, second : Tensor
        After the first maps, after the sum over bones and after the second maps: (S p n, H), (K p n, H), (S p n, H).
        Where nothing is kept, the sums take the place of what nodes say to themselves.
    own, others : Tensor
        Of the first, what nodes say to themselves and to others: (K p n, H) and ((S - K) p n, H).
    pooled : Tensor
        The second layer's update before the sum over bones, (2, S p n).
    told : Tensor
        Shift and scale, (2, K, p, n).
    reading, hearing : list of (Tensor, Tensor)
        For each map of the first and of the second layer the rows of the nodes that speak by it, and of what they say.
    """

    def __init__(
        self, entering: Tensor, leaving: Tensor, activations: Tensor, bones: Bones, features: int, *, keep: bool
    ) -> None:
        nodes, messages = bones.relations.shape
        grid = entering.shape[1:]
        columns = grid[1:].numel()
        first, second, told, pooled, sums = torch.split(activations, _lengths(grid, bones, features, keep=keep))
        self.entering, self.leaving = entering, leaving
        self.first, self.second = first.view(-1, features), second.view(-1, features)
        self.own, self.others = self.first[: nodes * columns], self.first[nodes * columns :]
        self.message = sums.view(-1, features) if keep else self.own
        self.second_across = self.second.T
        self.own_grid, self.message_grid = self.own.view(*grid, features), self.message.view(*grid, features)
        self.others_each, self.message_each = self.others.view(messages - nodes, -1), self.message.view(nodes, -1)
        self.told, self.pooled = told.view(2, *grid), pooled.view(2, -1)
        self.shift, self.stretch = self.told.unbind()
        self.told_each, self.pooled_each = told.view(2 * nodes, columns), pooled.view(2 * messages, columns)
        places, said = entering.view(len(entering), -1).T, 0
        self.reading, self.hearing = [], []
        for start, stop in bones.spans:
            speakers, spoken = (start * columns, (stop - start) * columns), (said, (stop - start) * columns)
            self.reading.append((places.narrow(0, *speakers), self.first.narrow(0, *spoken)))
            self.hearing.append((self.message.narrow(0, *speakers), self.second.narrow(0, *spoken)))
            said += spoken[1]


def _lengths(grid: torch.Size, bones: Bones, features: int, *, keep: bool) -> list[int]:
    """Count the numbers of a room's activations for a (K, p, n) grid: first, second, told, pooled and sums."""
    nodes, messages = bones.relations.shape
    columns = grid[1:].numel()
    lengths = [messages * features, messages * features, 2 * nodes, 2 * messages, nodes * features if keep else 0]
    return [length * columns for length in lengths]


KEPT = "kept"
"""How the names of uses begin whose memory the gradients need."""


class Workspace:
    """Memory that passes lay their activations in, one pass after another.

    Gradients of a pass must be taken before the next one that has gradients begins in the same workspace: autograd
    refuses what comes late. It is for one thread, and grows to the largest pass.

    Parameters
    ----------
    memory : mapping of str to Tensor, optional
        What is there already, by use.

    Attributes
    ----------
    memory : dict of str to Tensor
        What is there, by use; flat.
    """

    def __init__(self, memory: Mapping[str, Tensor] = MappingProxyType({})) -> None:
        self.memory = dict(memory)
        self._rooms: dict[tuple[object, ...], list[Room]] = {}

    def kept(self) -> dict[str, Tensor]:
        """Give the memory that the gradients need, by use."""
        return {use: memory for use, memory in self.memory.items() if use.startswith(KEPT)}

    def stack(self, use: str, shape: tuple[int, ...], like: Tensor) -> Tensor:
        """Give memory of one shape.

        Parameters
        ----------
        use : str
            What for.
        shape : tuple of int
            The shape.
        like : Tensor
            Of the same kind and on the same device.

        Returns
        -------
        Tensor
            Of this shape, with what was written there before.
        """
        length, known = math.prod(shape), self.memory.get(use)
        if known is None or len(known) < length or _kind(known) != _kind(like) or not _may_be_written(known):
            known = self.memory[use] = like.new_empty(length)
            self._rooms = {layout: rooms for layout, rooms in self._rooms.items() if layout[0] != use}
        return known[:length].view(shape)

    def rooms(self, use: str, count: int, like: Tensor, bones: Bones, features: int, *, keep: bool) -> list[Room]:
        """Give rooms for coordinates of one shape.

        Parameters
        ----------
        use : str
            What for.
        count : int
            How many.
        like : Tensor
            Coordinates, (D + 1, K, p, n).
        bones : Bones
            Who speaks to whom.
        features : int
            H.
        keep : bool
            Whether gradients need what is in them. The coordinates of one then leave into the next, else into its own.

        Returns
        -------
        list of Room
            In the order in which a pass goes through them.
        """
        places, each = like.numel() * (count + keep), sum(_lengths(like.shape[1:], bones, features, keep=keep))
        flat = self.stack(use, (places + count * each,), like)
        layout = (use, count, like.shape, features, keep, bones.spans)
        if layout not in self._rooms:
            coordinates = flat[:places].view(-1, *like.shape).unbind()
            leaving = coordinates[1:] if keep else coordinates
            tensors = zip(coordinates, leaving, flat[places:].view(count, -1), strict=False)
            self._rooms[layout] = [Room(*room, bones, features, keep=keep) for room in tensors]
        return self._rooms[layout]


def _kind(tensor: Tensor) -> tuple[torch.dtype, torch.device]:
    return tensor.dtype, tensor.device


def _may_be_written(memory: Tensor) -> bool:
    """Whether autograd allows writing: not to what was made in inference mode, outside of it."""
    return torch.is_inference_mode_enabled() or not memory.is_inference()
