"""Affine coupling blocks with message-passing conditioners, and their folded weights.

A block is an ActNorm and an affine coupling whose shift and scale come from two message-passing layers. For given
keypoints everything is multiplied out that does not depend on the pose, in an arithmetic order that gives the same
numbers with fewer operations:

- the ActNorms are absorbed into the maps that read the coordinates;
- the first layer's update and the second layer's maps are one matrix, because there is no activation between them;
- the second layer's update is linear, so it is applied before the sum over edges, which then has 2 features, not H.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from posecal_models.estimators.cgnf.graph import PoseGraph
from posecal_models.estimators.cgnf.message_passing import MessagePassing

__all__ = ["Couplings", "FoldedCouplings"]


class FoldedCouplings(NamedTuple):
    """The blocks of a flow with their weights multiplied out.

    Attributes
    ----------
    first, second, pool : Tensor
        Of :class:`posecal_models.estimators.cgnf.passes.BlockWeights`.
    context_first, context_second : Tensor
        The maps of :class:`posecal_models.estimators.cgnf.context_messages.ContextMaps`.
    root, root_offset : Tensor
        The messages of a root at the origin, of the same.
    pending_scale, pending_shift : Tensor
        (L + 1, D) each: the ActNorms that a coordinate has yet to pass in each block, and after all blocks.
    log_determinant : Tensor
        Log of the volume change of all ActNorms at one node, nats; a scalar.
    """

    first: Tensor
    second: Tensor
    pool: Tensor
    context_first: Tensor
    context_second: Tensor
    root: Tensor
    root_offset: Tensor
    pending_scale: Tensor
    pending_shift: Tensor
    log_determinant: Tensor


class Couplings(nn.Module):
    r"""The L blocks of a flow: an ActNorm shared by all nodes, then the affine coupling of one coordinate.

    .. math:: y = e^{a} \odot x + b, \qquad z_i = y_i \, s(y_{\neq i}, c) + t(y_{\neq i}, c), \qquad i = l \bmod D

    Parameters
    ----------
    graph : PoseGraph
        The bones between the K nodes.
    blocks : int
        L.
    dimensions : int
        D, the coordinates of a node.
    hidden, context : int
        Features of a message and of an embedded keypoint.
    backward_weights : bool
        Whether messages from child to parent have their own map.

    Notes
    -----
    The second layer's update is initialised with zeros, so that an untrained flow is the identity but for its ActNorms;
    with an exponential scale and PyTorch's own initialisation, training diverged within ten steps.

    Differs from the published code: none with ``backward_weights=False``; the paper's text has a map for each
    direction.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4, "Affine Coupling Layer". ActNorm: Kingma and Dhariwal 2018,
    arXiv:1807.03039.
    """

    identity_coordinates: Tensor
    """The D - 1 coordinates that each block reads and leaves as they are, (L, D - 1), integer."""

    def __init__(
        self,
        graph: PoseGraph,
        *,
        blocks: int,
        dimensions: int,
        hidden: int,
        context: int,
        backward_weights: bool,
    ) -> None:
        super().__init__()
        self.actnorm_log_scale = nn.Parameter(torch.zeros(blocks, dimensions))
        self.actnorm_shift = nn.Parameter(torch.zeros(blocks, dimensions))
        self.first = MessagePassing(
            graph,
            blocks,
            dimensions - 1,
            hidden,
            hidden,
            context=context,
            root=dimensions,
            last=False,
            backward_weights=backward_weights,
        )
        self.second = MessagePassing(
            graph,
            blocks,
            hidden,
            hidden,
            2,
            context=hidden,
            root=hidden,
            last=True,
            backward_weights=backward_weights,
        )
        transformed = torch.arange(blocks) % dimensions
        coordinates = torch.arange(dimensions).expand(blocks, -1)
        identity = coordinates[coordinates != transformed[:, None]].view(blocks, dimensions - 1)
        self.register_buffer("identity_coordinates", identity, persistent=False)
        nn.init.zeros_(self.second.pool.weight)
        nn.init.zeros_(self.second.pool.bias)

    @property
    def width(self) -> int:
        """Features of a message with one that carries biases, filled up to a multiple of 8."""
        return 8 * math.ceil((self.second.pool.weight.shape[-1] + 1) / 8)

    def fold(self, blocks: int | None = None) -> FoldedCouplings:
        """Multiply out all weights that do not depend on poses and keypoints.

        Parameters
        ----------
        blocks : int, optional
            Only the first blocks; all of them where not given.

        Returns
        -------
        FoldedCouplings
            The blocks, without the keypoints' messages.
        """
        log_scale, shift = self.actnorm_log_scale[:blocks], self.actnorm_shift[:blocks]
        pending_scale, pending_shift = _pending_actnorms(log_scale, shift)
        dimensions, identity = log_scale.shape[1], self.identity_coordinates[:blocks]

        weights, biases = (stacked[:blocks] for stacked in self.first.weights_and_biases())
        scaled = weights * pending_scale[:-1].gather(1, identity)[:, None, None]
        biases = biases + (weights @ pending_shift[:-1].gather(1, identity)[:, None, :, None]).squeeze(-1)
        columns = identity[:, None, None].expand_as(scaled)
        first = weights.new_zeros(*biases.shape, dimensions).scatter(3, columns, scaled)

        update = self.first.pool
        weights, second_biases = (stacked[:blocks] for stacked in self.second.weights_and_biases())
        second_biases = (weights @ update.bias[:blocks, None, :, None]).squeeze(-1) + second_biases
        second = torch.cat([weights @ update.weight[:blocks, None], second_biases[..., None]], dim=-1).mT
        padding = self.width - second.shape[-1]
        carrier = first.new_zeros(*biases.shape[:2], dimensions + 1, padding)
        carrier[:, 0, -1, 0] = 1  # in the self messages only: once for every node
        to_nodes = self.first.from_context.homogeneous(self.width)[:blocks]
        to_features = self.first.next_maps()[0].homogeneous(self.width, carry=True)[:blocks]
        root, root_offset = self.root_messages(log_scale.new_zeros(1, dimensions), blocks)
        return FoldedCouplings(
            first=torch.cat([torch.cat([first, biases[..., None]], dim=-1).mT, carrier], dim=-1),
            second=pad(second, (0, padding, 0, padding - 1)),
            pool=pad(self.second.pool.weight[:blocks], (0, padding)),
            context_first=torch.stack([to_nodes, to_features]),
            context_second=pad(self.second.from_context.homogeneous(self.width)[:blocks], (0, 0, 0, padding - 1)),
            root=root,
            root_offset=root_offset,
            pending_scale=pending_scale,
            pending_shift=pending_shift,
            log_determinant=log_scale.sum(),
        )

    def root_messages(self, root: Tensor, blocks: int | None = None) -> tuple[Tensor, Tensor]:
        """Compute what the root adds after each layer.

        Parameters
        ----------
        root : Tensor
            Features of the root, (P or 1, D).
        blocks : int, optional
            Only the first blocks; all of them where not given.

        Returns
        -------
        root, root_offset : Tensor
            Of :class:`posecal_models.estimators.cgnf.context_messages.ContextMaps`; the second with the biases of the
            second layer's update.
        """
        first = pad(self.first.from_root(root), (0, self.width - self.first.from_root.bias.shape[1]))
        second = self.second.from_root(self.first.next_maps()[1](root)) @ self.second.pool.weight.mT
        receivers = self.first.next_to_root[:, None, None]
        offset = receivers * second[:, None] + self.second.pool.bias[:, None, None]
        return (receivers * first[:, None])[:blocks].unsqueeze(3), offset[:blocks].movedim(3, 1).unsqueeze(4)


def _pending_actnorms(log_scale: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
    """Compose the ActNorms that each coordinate has yet to pass when it reaches a block, that block's own included.

    The ActNorms of a coordinate are applied when a block transforms it. Row l is for block l, the last row for after
    all blocks: scale and shift, (L + 1, D) each, of (L, D) log scales and shifts.
    """
    blocks, dimensions = log_scale.shape
    cumulative = torch.cat([log_scale, log_scale.new_zeros(1, dimensions)]).cumsum(0)
    block = torch.arange(blocks + 1, device=shift.device)[:, None, None]
    actnorm = torch.arange(blocks, device=shift.device)[:, None]
    coordinate = torch.arange(dimensions, device=shift.device)
    last_transform = block - 1 - (block - 1 - coordinate) % dimensions
    pending = (actnorm <= block) & (actnorm > last_transform)
    log_scales = torch.where(pending, log_scale, 0).sum(1)
    later_scales = torch.where(pending, cumulative[:, None] - cumulative[:-1], 0).exp()
    return log_scales.exp(), torch.where(pending, later_scales * shift, 0).sum(1)
