r"""Affine coupling blocks whose shift and scale come from message passing.

For given keypoints everything is multiplied out that depends on no pose, which gives the same numbers with fewer
operations: messages from keypoints and root are summed once per pose; the first layer's update and the second layer's
maps are one matrix, because there is no activation between them; the second layer's update is linear, so it is applied
before the sum over edges, which then has 2 features and not H.

Coordinates are (P, n, K, D), n samples of each of P poses: what depends on the keypoints alone broadcasts over the
samples, and a sum over edges is one product with a small matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from posecal_models.estimators.cgnf.message_passing import EmbeddedContext, MessagePassing

__all__ = ["CouplingBlock", "FoldedBlock", "Scale"]

Scale = Literal["sigmoid", "exp"]

_FLOOR = 1e-3


@dataclass(frozen=True)
class FoldedBlock:
    r"""A block with its weights multiplied out: a map of the coordinates of P poses with n samples each.

    .. math:: y = e^{a} \odot x + b, \qquad z_i = y_i \, s(y_{\neq i}, c) + t(y_{\neq i}, c)

    Attributes
    ----------
    coordinate : int
        i, the coordinate that is transformed; the others stay as the ActNorm gives them.
    scale : str
        The function from the unconstrained to the positive scale.
    log_scale, shift : Tensor
        a and b of the ActNorm, (D,).
    aggregation : Tensor
        (K, K * maps), see :meth:`posecal_models.estimators.cgnf.graph.PoseGraph.aggregation`.
    first : Tensor
        The first layer's maps, (D, maps * H), the last row for a constant 1.
    second, second_bias : Tensor
        The first layer's update and the second layer's maps in one: (H, maps * H) and (maps * H,).
    pool : Tensor
        The second layer's update, (2, H).
    """

    coordinate: int
    scale: Scale
    log_scale: Tensor
    shift: Tensor
    aggregation: Tensor
    first: Tensor
    second: Tensor
    second_bias: Tensor
    pool: Tensor

    def forward(self, x: Tensor, message: Tensor, offset: Tensor) -> tuple[Tensor, Tensor]:
        """Transform coordinates in the direction of the latents.

        Parameters
        ----------
        x : Tensor
            (P, n, K, D).
        message, offset : Tensor
            From :meth:`CouplingBlock.context_messages`.

        Returns
        -------
        z : Tensor
            (P, n, K, D).
        log_determinant : Tensor
            (P, n, K): log of the volume change at each node, nats.
        """
        y, i = torch.addcmul(self.shift, x, self.log_scale.exp()), self.coordinate
        shift, unconstrained = self._shift_and_scale(y, message, offset)
        scale, log_scale = self._positive(unconstrained)
        transformed = torch.addcmul(shift, y[..., i], scale)
        z = torch.cat([y[..., :i], transformed[..., None], y[..., i + 1 :]], dim=-1)
        return z, log_scale + self.log_scale.sum()

    def inverse(self, z: Tensor, message: Tensor, offset: Tensor) -> Tensor:
        """Transform coordinates in the direction of the poses; the inverse of :meth:`forward`."""
        i = self.coordinate
        shift, unconstrained = self._shift_and_scale(z, message, offset)
        transformed = (z[..., i] - shift) / self._positive(unconstrained)[0]
        y = torch.cat([z[..., :i], transformed[..., None], z[..., i + 1 :]], dim=-1)
        return (y - self.shift) * (-self.log_scale).exp()

    def _shift_and_scale(self, y: Tensor, message: Tensor, offset: Tensor) -> Tensor:
        """Compute shift and unconstrained scale, (2, P, n, K), from the coordinates but the transformed one."""
        grid, rows, hidden = y.shape[:-1], y.shape[:2].numel(), self.pool.shape[1]
        others = torch.cat([y[..., : self.coordinate], y[..., self.coordinate + 1 :], torch.ones_like(y[..., :1])], -1)
        messages = self.aggregation.shape[1]
        first = (others.flatten(0, -2) @ self.first).relu_().view(rows, messages, hidden)
        received = torch.bmm(self.aggregation.expand(rows, -1, -1), first).view(*grid, hidden).add_(message)
        second = torch.addmm(self.second_bias, received.flatten(0, -2), self.second).relu_()
        pooled = (second.view(rows * messages, hidden) @ self.pool.mT).view(rows, messages, 2)
        return (pooled.movedim(-1, 0) @ self.aggregation.mT).view(2, *grid) + offset

    def _positive(self, unconstrained: Tensor) -> tuple[Tensor, Tensor]:
        """Return the positive scale and its log; the log is exact where the scale overflows."""
        if self.scale == "exp":
            return unconstrained.exp(), unconstrained
        scale = torch.sigmoid(unconstrained + 2) + _FLOOR
        return scale, scale.log()


class CouplingBlock(nn.Module):
    r"""An ActNorm shared by all nodes, and the affine coupling of one coordinate.

    Parameters
    ----------
    coordinate : int
        The coordinate that is transformed, below ``dimensions``.
    dimensions : int
        D, the coordinates of a node.
    hidden, context : int
        Features of a message and of an embedded keypoint.
    backward_weights : bool
        Whether messages from child to parent have their own map.
    scale : str
        ``exp``: s = exp(u). ``sigmoid``: s = sigmoid(u + 2) + 0.001, never above 1.001.

    Notes
    -----
    The second layer's update is initialised with zeros, so that an untrained flow is the identity but for its ActNorms;
    with an exponential scale and PyTorch's own initialisation, training diverged within ten steps.

    Differs from the published code: none with ``backward_weights=False`` and ``scale="sigmoid"``; the paper's text has
    a map for each direction and an exponential scale.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4, "Affine Coupling Layer". ActNorm: Kingma and Dhariwal 2018,
    arXiv:1807.03039.
    """

    def __init__(
        self, coordinate: int, dimensions: int, *, hidden: int, context: int, backward_weights: bool, scale: Scale
    ) -> None:
        super().__init__()
        self.coordinate = coordinate
        self.scale: Scale = scale
        self.log_scale = nn.Parameter(torch.zeros(dimensions))
        self.shift = nn.Parameter(torch.zeros(dimensions))
        self.first = MessagePassing(
            dimensions - 1,
            hidden,
            hidden,
            context=context,
            root=dimensions,
            last=False,
            backward_weights=backward_weights,
        )
        self.second = MessagePassing(
            hidden, hidden, 2, context=hidden, root=hidden, last=True, backward_weights=backward_weights
        )
        nn.init.zeros_(self.second.pool.weight)
        nn.init.zeros_(self.second.pool.bias)

    def fold(self, aggregation: Tensor) -> FoldedBlock:
        """Multiply out what depends on weights alone.

        Parameters
        ----------
        aggregation : Tensor
            (K, K * maps), see :meth:`posecal_models.estimators.cgnf.graph.PoseGraph.aggregation`.

        Returns
        -------
        FoldedBlock
            Without messages from keypoints and root.
        """
        first, first_bias = self.first.node_maps()
        second, second_bias = self.second.node_maps()
        update = self.first.pool
        return FoldedBlock(
            self.coordinate,
            self.scale,
            self.log_scale,
            self.shift,
            aggregation,
            torch.cat([first, first_bias[..., None]], dim=-1).flatten(0, 1).mT,
            (second.flatten(0, 1) @ update.weight).mT,
            second.flatten(0, 1) @ update.bias + second_bias.flatten(),
            self.second.pool.weight,
        )

    def context_messages(self, context: EmbeddedContext, next_to_root: Tensor) -> tuple[Tensor, Tensor]:
        """Sum what keypoints and root add after each layer.

        Parameters
        ----------
        context : EmbeddedContext
            Keypoints and root of P poses.
        next_to_root : Tensor
            (K, 1): 1 for the nodes whose parent is the root, 0 for the others.

        Returns
        -------
        message, offset : Tensor
            (P or 1, 1, K, H) and (2, P or 1, 1, K); the second with the bias of the second layer's update.
        """
        message = self.first.context_messages(context, next_to_root)
        offset = self.second.pool(self.second.context_messages(self.first.next_features(context), next_to_root))
        return message[:, None], offset.movedim(-1, 0)[:, :, None]
