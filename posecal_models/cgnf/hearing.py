"""What do the observed keypoints tell the joints? Their messages to all blocks, and the gradients of these.

They depend on the keypoints alone, never on the pose, so the samples of a pose share them. What is missing says nothing
and is not computed: keypoints are rows, as many as were observed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from posecal_models.cgnf.rooms import KEPT, Workspace

__all__ = ["Heard", "HeardBackward", "Seats", "Voices", "hear"]


class Seats(NamedTuple):
    """Where each of R keypoints speaks.

    Attributes
    ----------
    pose, node : Tensor
        To which node of which pose, (R,) each, integer; poses in order.
    starts : sequence of int
        Where the keypoints of each of P poses begin, and R.
    """

    pose: Tensor
    node: Tensor
    starts: Sequence[int]

    @property
    def poses(self) -> int:
        """P."""
        return len(self.starts) - 1

    def of_poses(self, poses: slice) -> tuple[slice, Seats]:
        """Take the keypoints of some poses.

        Parameters
        ----------
        poses : slice
            p poses that stand together.

        Returns
        -------
        rows : slice
            Which r of the R keypoints.
        seats : Seats
            Where they speak, among the p poses.
        """
        if poses == slice(0, self.poses):
            return slice(0, len(self.pose)), self
        first, last = self.starts[poses.start], self.starts[poses.stop]
        rows = slice(first, last)
        starts = [start - first for start in self.starts[poses.start : poses.stop + 1]]
        return rows, Seats(self.pose[rows] - poses.start, self.node[rows], starts)

    def places(self) -> Tensor:
        """Give the places of the keypoints in the flattened (K, P) grid; (R,), integer."""
        return self.node * self.poses + self.pose


class Voices(NamedTuple):
    """What speaks to the nodes of P poses beside the nodes themselves: R observed keypoints, and the root.

    Attributes
    ----------
    keypoints : Tensor
        Features of the keypoints, and a 1 that carries biases: (R, C + 1). A row of zeros says nothing.
    first : Tensor
        The first layer's maps to the nodes and on to the second layer, which has a 1 again: (2, L, C + 1, H).
    second : Tensor
        The second layer's map to the nodes: (L, H, H).
    pool : Tensor
        The second layer's update: (L, 2, H).
    root, root_offset : Tensor
        What the root adds after the first layer, (L, K, P or 1, 1, H), and after the second, (L, 2, K, P or 1, 1).
    """

    keypoints: Tensor
    first: Tensor
    second: Tensor
    pool: Tensor
    root: Tensor
    root_offset: Tensor


class Heard(NamedTuple):
    """What p poses are told.

    Attributes
    ----------
    evidence, offset : Tensor
        What is added after the first layer, (L, K, p or 1, 1, H), and after the second, (L, 2, K, p or 1, 1).
    """

    evidence: Tensor
    offset: Tensor


def hear(voices: Voices, seats: Seats | None, poses: slice, space: Workspace, *, keep: bool) -> Heard:
    """Compute what some poses are told.

    Parameters
    ----------
    voices : Voices
        What speaks to P poses.
    seats : Seats or None
        To whom; None where no keypoint speaks.
    poses : slice
        p of the P poses.
    space : Workspace
        Memory.
    keep : bool
        Whether gradients follow, so that what the keypoints say is left in the workspace.

    Returns
    -------
    Heard
        In memory that the next call overwrites. Where all P poses share the keypoints of one, p is 1.
    """
    heard = Heard(_of_poses(voices.root, 2, poses), _of_poses(voices.root_offset, 3, poses))
    if seats is None:
        return heard
    rows, seats, use = _spoken_to(seats, poses)
    blocks, _, features = voices.pool.shape
    shape = (3, blocks, len(seats.pose), features)
    said = space.stack(use if keep else "said", shape, voices.pool)
    to_nodes, on, second = said.unbind()
    keypoints = voices.keypoints[rows].expand(2 * blocks, -1, -1)
    torch.bmm(keypoints, voices.first.flatten(0, 1), out=said[:2].flatten(0, 1)).relu_()
    torch.bmm(on, voices.second, out=second).relu_()
    grid = (heard.evidence.shape[1], seats.poses, 1)
    evidence = space.stack("evidence", (blocks, *grid, features), second).copy_(heard.evidence)
    evidence.view(blocks, -1, features).index_add_(1, seats.places(), to_nodes)
    offset = space.stack("offset", (blocks, 2, *grid), second).copy_(heard.offset)
    offset.view(blocks, 2, -1).index_add_(2, seats.places(), torch.bmm(voices.pool, second.mT))
    return Heard(evidence, offset)


class HeardBackward:
    """The gradients of what p poses are told, gathered block by block.

    Parameters
    ----------
    voices, into : Voices
        What spoke, and its gradients, which are added to.
    seats : Seats or None
        To whom.
    poses : slice
        The p poses.
    space : Workspace
        The one in which they were told.
    """

    def __init__(self, voices: Voices, into: Voices, seats: Seats | None, poses: slice, space: Workspace) -> None:
        self._voices, self._into = voices, into
        self._root = list(zip(_of_poses(into.root, 2, poses), _of_poses(into.root_offset, 3, poses), strict=True))
        self._seats = None
        if seats is None:
            return
        self._rows, self._seats, use = _spoken_to(seats, poses)
        self._places = self._seats.places()
        blocks, _, features = voices.pool.shape
        self._said = space.stack(use, (3, blocks, len(self._places), features), voices.pool)
        self._d_said = space.stack("gradients of said", self._said.shape, voices.pool)
        self._d_pooled = space.stack("gradients of pooled", (blocks, 2, len(self._places)), voices.pool)

    def add(self, block: int, d_message: Tensor, d_told: Tensor) -> None:
        """Take the gradients at one block.

        Parameters
        ----------
        block : int
            Which.
        d_message, d_told : Tensor
            Of the sums after the first layer, (K, p, n, H), and after the second, (2, K, p, n).
        """
        for d_root, gradient in zip(self._root[block], (d_message, d_told), strict=True):
            d_root.add_(gradient.sum_to_size(d_root.shape))
        if self._seats is not None:
            nodes, poses = len(d_message), self._seats.poses
            d_message, d_told = (
                d_message.sum_to_size(nodes, poses, 1, d_message.shape[-1]),
                d_told.sum_to_size(2, nodes, poses, 1),
            )
            torch.index_select(d_message.flatten(0, -2), 0, self._places, out=self._d_said[0, block])
            torch.index_select(d_told.flatten(1), 1, self._places, out=self._d_pooled[block])

    def finish(self) -> None:
        """Pass what was gathered on to the keypoints and their maps."""
        if self._seats is None:
            return
        voices, into = self._voices, self._into
        silence = torch.ops.aten.threshold_backward.grad_input
        _, on, second = self._said.unbind()
        _, d_on, d_second = self._d_said.unbind()
        into.pool.baddbmm_(self._d_pooled, second)
        torch.bmm(self._d_pooled.mT, voices.pool, out=d_second)
        silence(d_second, second, 0, grad_input=d_second)
        into.second.baddbmm_(on.mT, d_second)
        torch.bmm(d_second, voices.second.mT, out=d_on)
        d_first, first = self._d_said[:2].flatten(0, 1), self._said[:2].flatten(0, 1)
        silence(d_first, first, 0, grad_input=d_first)
        keypoints = voices.keypoints[self._rows].mT.expand(len(first), -1, -1)
        into.first.flatten(0, 1).baddbmm_(keypoints, d_first)
        into.keypoints[self._rows] += torch.bmm(d_first, voices.first.flatten(0, 1).mT).sum(0)


def _spoken_to(seats: Seats, poses: slice) -> tuple[slice, Seats, str]:
    """Find the keypoints that speak to some poses: which, where, and the use of memory for what they say."""
    own = slice(0, 1) if seats.poses == 1 else poses  # all poses may share the keypoints of one
    return *seats.of_poses(own), f"{KEPT} of what is said to poses from {own.start}"


def _of_poses(said: Tensor, dim: int, poses: slice) -> Tensor:
    """Take some poses out of messages, unless all poses share them."""
    return said if said.shape[dim] == 1 else said.narrow(dim, poses.start, poses.stop - poses.start)
