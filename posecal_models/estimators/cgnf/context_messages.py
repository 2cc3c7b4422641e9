"""Messages from observed 2D keypoints to joints, and their gradients.

They depend on the keypoints alone, never on the pose, so the samples of a pose share them. Missing keypoints contribute
no message and are not computed: keypoints are rows, as many as were observed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from posecal_models.estimators.cgnf.buffers import SAVED, Workspace

__all__ = ["ContextBackward", "ContextMaps", "ContextMessages", "NodeIndex", "context_messages", "relu_backward"]

relu_backward = torch.ops.aten.threshold_backward.grad_input
"""The gradient of ReLU: (gradient, output, 0, grad_input=out)."""


class NodeIndex(NamedTuple):
    """Target node and pose of each of R observed keypoints.

    Attributes
    ----------
    pose, node : Tensor
        The pose and the node that receive each keypoint's message, (R,) each, integer; poses in order.
    starts : sequence of int
        The first keypoint of each of P poses, and R.
    """

    pose: Tensor
    node: Tensor
    starts: Sequence[int]

    @property
    def poses(self) -> int:
        """P, the number of poses."""
        return len(self.starts) - 1

    def select(self, poses: slice) -> tuple[slice, NodeIndex]:
        """Select the keypoints of some poses.

        Parameters
        ----------
        poses : slice
            p consecutive poses.

        Returns
        -------
        rows : slice
            Which r of the R keypoints.
        node_index : NodeIndex
            Their targets among the p poses.
        """
        if poses == slice(0, self.poses):
            return slice(0, len(self.pose)), self
        first, last = self.starts[poses.start], self.starts[poses.stop]
        rows = slice(first, last)
        starts = [start - first for start in self.starts[poses.start : poses.stop + 1]]
        return rows, NodeIndex(self.pose[rows] - poses.start, self.node[rows], starts)

    def flat(self) -> Tensor:
        """Return the indices of the targets in the flattened (K, P) grid; (R,), integer."""
        return self.node * self.poses + self.pose


class ContextMaps(NamedTuple):
    """R observed keypoints of P poses with the maps of their messages, and the messages of the root.

    Attributes
    ----------
    keypoints : Tensor
        Features of the keypoints, and a 1 that carries biases: (R, C + 1). The messages of a row of zeros are 0.
    first : Tensor
        The first layer's maps, to the nodes and to the features of the second layer, which end with a 1 again:
        (2, L, C + 1, H).
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


class ContextMessages(NamedTuple):
    """Sums of the messages from keypoints and root to the nodes of p poses.

    Attributes
    ----------
    message, offset : Tensor
        What is added after the first layer, (L, K, p or 1, 1, H), and after the second, (L, 2, K, p or 1, 1).
    """

    message: Tensor
    offset: Tensor


def context_messages(
    maps: ContextMaps, node_index: NodeIndex | None, poses: slice, workspace: Workspace, *, keep: bool
) -> ContextMessages:
    """Compute the messages from keypoints and root to some poses.

    Parameters
    ----------
    maps : ContextMaps
        Keypoints, maps and root of P poses.
    node_index : NodeIndex or None
        Targets of the keypoints; None where none was observed.
    poses : slice
        p of the P poses.
    workspace : Workspace
        Memory.
    keep : bool
        Whether the backward pass follows, so that the keypoints' activations are left in the workspace.

    Returns
    -------
    ContextMessages
        In memory that the next call overwrites. Where all P poses share the keypoints of one, p is 1.
    """
    from_root = ContextMessages(_select_poses(maps.root, 2, poses), _select_poses(maps.root_offset, 3, poses))
    if node_index is None:
        return from_root
    rows, node_index, use = _select_keypoints(node_index, poses)
    blocks, _, features = maps.pool.shape
    shape = (3, blocks, len(node_index.pose), features)
    activations = workspace.allocate(use if keep else "context messages", shape, maps.pool)
    to_nodes, next_features, second = activations.unbind()
    keypoints = maps.keypoints[rows].expand(2 * blocks, -1, -1)
    torch.bmm(keypoints, maps.first.flatten(0, 1), out=activations[:2].flatten(0, 1)).relu_()
    torch.bmm(next_features, maps.second, out=second).relu_()
    grid = (from_root.message.shape[1], node_index.poses, 1)
    message = workspace.allocate("message", (blocks, *grid, features), second).copy_(from_root.message)
    message.view(blocks, -1, features).index_add_(1, node_index.flat(), to_nodes)
    offset = workspace.allocate("offset", (blocks, 2, *grid), second).copy_(from_root.offset)
    offset.view(blocks, 2, -1).index_add_(2, node_index.flat(), torch.bmm(maps.pool, second.mT))
    return ContextMessages(message, offset)


class ContextBackward:
    """The backward pass of :func:`context_messages`, accumulated block by block.

    Parameters
    ----------
    maps, gradients : ContextMaps
        The inputs of the forward pass, and their gradients, which are added to.
    node_index : NodeIndex or None
        Targets of the keypoints.
    poses : slice
        The p poses.
    workspace : Workspace
        That of the forward pass.
    """

    def __init__(
        self,
        maps: ContextMaps,
        gradients: ContextMaps,
        node_index: NodeIndex | None,
        poses: slice,
        workspace: Workspace,
    ) -> None:
        self._maps, self._gradients = maps, gradients
        d_root = _select_poses(gradients.root, 2, poses)
        d_root_offset = _select_poses(gradients.root_offset, 3, poses)
        self._d_root = list(zip(d_root, d_root_offset, strict=True))
        self._node_index = None
        if node_index is None:
            return
        self._rows, self._node_index, use = _select_keypoints(node_index, poses)
        self._targets = self._node_index.flat()
        blocks, _, features = maps.pool.shape
        self._activations = workspace.allocate(use, (3, blocks, len(self._targets), features), maps.pool)
        shape = self._activations.shape
        self._d_activations = workspace.allocate("gradients of context messages", shape, maps.pool)
        self._d_pooled = workspace.allocate("gradients of pooled", (blocks, 2, len(self._targets)), maps.pool)

    def add(self, block: int, d_message: Tensor, d_shift_scale: Tensor) -> None:
        """Accumulate the gradients at one block.

        Parameters
        ----------
        block : int
            Index of the block.
        d_message, d_shift_scale : Tensor
            Of the sums after the first layer, (K, p, n, H), and after the second, (2, K, p, n).
        """
        for d_root, gradient in zip(self._d_root[block], (d_message, d_shift_scale), strict=True):
            d_root.add_(gradient.sum_to_size(d_root.shape))
        if self._node_index is not None:
            nodes, poses = len(d_message), self._node_index.poses
            d_message, d_shift_scale = (
                d_message.sum_to_size(nodes, poses, 1, d_message.shape[-1]),
                d_shift_scale.sum_to_size(2, nodes, poses, 1),
            )
            torch.index_select(d_message.flatten(0, -2), 0, self._targets, out=self._d_activations[0, block])
            torch.index_select(d_shift_scale.flatten(1), 1, self._targets, out=self._d_pooled[block])

    def finish(self) -> None:
        """Propagate the accumulated gradients to the keypoints and their maps."""
        if self._node_index is None:
            return
        maps, gradients = self._maps, self._gradients
        _, next_features, second = self._activations.unbind()
        _, d_next_features, d_second = self._d_activations.unbind()
        gradients.pool.baddbmm_(self._d_pooled, second)
        torch.bmm(self._d_pooled.mT, maps.pool, out=d_second)
        relu_backward(d_second, second, 0, grad_input=d_second)
        gradients.second.baddbmm_(next_features.mT, d_second)
        torch.bmm(d_second, maps.second.mT, out=d_next_features)
        d_first, first = self._d_activations[:2].flatten(0, 1), self._activations[:2].flatten(0, 1)
        relu_backward(d_first, first, 0, grad_input=d_first)
        keypoints = maps.keypoints[self._rows].mT.expand(len(first), -1, -1)
        gradients.first.flatten(0, 1).baddbmm_(keypoints, d_first)
        gradients.keypoints[self._rows] += torch.bmm(d_first, maps.first.flatten(0, 1).mT).sum(0)


def _select_keypoints(node_index: NodeIndex, poses: slice) -> tuple[slice, NodeIndex, str]:
    """Select the keypoints of some poses: rows, targets, and the name of the memory for their activations."""
    selected = slice(0, 1) if node_index.poses == 1 else poses  # all poses may share the keypoints of one
    return *node_index.select(selected), f"{SAVED} context messages from pose {selected.start}"


def _select_poses(messages: Tensor, dim: int, poses: slice) -> Tensor:
    """Select the messages to some poses, unless all poses share them."""
    return messages if messages.shape[dim] == 1 else messages.narrow(dim, poses.start, poses.stop - poses.start)
