"""The conditional graph normalizing flow: L coupling blocks between poses and latents.

Everything here is unitless: standardised poses (P, n, K, D) on one side, standard normal latents of the same shape on
the other. Millimetres and pixels are converted in :mod:`posecal_models.estimators.cgnf.model`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from posecal.errors import PoseDataError
from posecal_models.estimators.cgnf.coupling import CouplingBlock, FoldedBlock, Scale
from posecal_models.estimators.cgnf.graph import PoseGraph
from posecal_models.estimators.cgnf.message_passing import ContextEmbedding, EmbeddedContext

__all__ = ["SIZES", "ConditionedFlow", "FlowSize", "GraphFlow"]

ROWS_AT_ONCE = {"cpu": 48}
"""Samples in one pass, by the device: a processor's activations stay in its cache. 2^17 on other devices."""


@dataclass(frozen=True)
class FlowSize:
    """Size of a flow: L blocks, H hidden features, C context features, E hidden features of the embedding."""

    blocks: int
    hidden: int
    context: int
    embedding: int


SIZES = {
    "tiny": FlowSize(blocks=6, hidden=24, context=8, embedding=32),
    "mini": FlowSize(blocks=8, hidden=50, context=10, embedding=64),
    "small": FlowSize(blocks=10, hidden=100, context=10, embedding=128),
    "large": FlowSize(blocks=10, hidden=200, context=10, embedding=128),
    "xlarge": FlowSize(blocks=14, hidden=262, context=68, embedding=177),
}
"""The paper's three sizes, and a tiny one for quick trials."""

Messages = list[tuple[Tensor, Tensor]]
"""What keypoints and root add in each block, see :meth:`CouplingBlock.context_messages`."""


class ConditionedFlow(NamedTuple):
    """The flow for the keypoints of P poses: a map between poses and latents.

    Attributes
    ----------
    blocks : list of FoldedBlock
        The L blocks with their weights multiplied out.
    messages : Messages
        Of P poses, or of one where all share it, as for the prior.
    """

    blocks: list[FoldedBlock]
    messages: Messages

    def forward(self, poses: Tensor) -> tuple[Tensor, Tensor]:
        """Transform poses into latents.

        Parameters
        ----------
        poses : Tensor
            (P, n, K, D), standardised, unitless.

        Returns
        -------
        latents : Tensor
            (P, n, K, D), unitless.
        log_determinant : Tensor
            (P, n, K): log of the volume change at each node, nats.
        """

        def part(coordinates: Tensor, messages: Messages) -> Tensor:
            log_determinant = torch.zeros_like(coordinates[..., 0])
            for block, sums in zip(self.blocks, messages, strict=True):
                coordinates, change = block.forward(coordinates, *sums)
                log_determinant = log_determinant + change
            return torch.cat([coordinates, log_determinant[..., None]], dim=-1)

        result = self._in_parts(part, poses)
        return result[..., :-1], result[..., -1]

    def inverse(self, latents: Tensor) -> Tensor:
        """Transform latents into poses.

        Parameters
        ----------
        latents : Tensor
            (P, n, K, D), unitless.

        Returns
        -------
        Tensor
            (P, n, K, D), standardised poses, unitless.
        """

        def part(coordinates: Tensor, messages: Messages) -> Tensor:
            for block, sums in zip(reversed(self.blocks), reversed(messages), strict=True):
                coordinates = block.inverse(coordinates, *sums)
            return coordinates

        return self._in_parts(part, latents)

    def log_prob_per_node(self, poses: Tensor) -> Tensor:
        """Compute each node's term of the log density; the terms sum to the log density of the pose.

        Parameters
        ----------
        poses : Tensor
            (P, n, K, D), standardised, unitless.

        Returns
        -------
        Tensor
            (P, n, K), nats.
        """
        latents, log_determinant = self.forward(poses)
        dimensions = latents.shape[-1]
        return log_determinant - 0.5 * (latents.square().sum(-1) + dimensions * math.log(2 * math.pi))

    def _in_parts(self, transform: Callable[[Tensor, Messages], Tensor], values: Tensor) -> Tensor:
        """Transform (P, n, K, D) values; without gradients, by parts whose activations fit the processor's cache."""
        poses, samples = values.shape[:2]
        own = max([1, *(len(message) for message, _ in self.messages)])
        if own not in (1, poses):
            raise PoseDataError(f"flow: keypoints of {own} poses and {poses} poses; expected as many.")
        if torch.is_grad_enabled() or not poses * samples:
            return transform(values, self.messages)
        at_once = ROWS_AT_ONCE.get(values.device.type, 2**17)
        samples_each = math.ceil(samples / math.ceil(samples / at_once))
        poses_each = max(1, at_once // samples_each)
        rows = []
        for first in range(0, poses, poses_each):
            chosen = slice(first, first + poses_each)
            messages = self.messages if own == 1 else [(m[chosen], offset[:, chosen]) for m, offset in self.messages]
            parts = torch.split(values[chosen], samples_each, dim=1)
            rows.append(torch.cat([transform(part, messages) for part in parts], dim=1))
        return torch.cat(rows)


class GraphFlow(nn.Module):
    """The conditional graph normalizing flow: an embedding of the keypoints and L blocks.

    Block l transforms coordinate l modulo D.

    Parameters
    ----------
    graph : PoseGraph
        The bones between the K nodes.
    size : FlowSize
        Blocks and features.
    dimensions : int
        D, coordinates of a node.
    keypoint_features : int
        Coordinates of a keypoint.
    backward_weights : bool
        Whether messages from child to parent have their own map.
    scale : str
        ``exp``: s = exp(u). ``sigmoid``: s = sigmoid(u + 2) + 0.001, never above 1.001.

    Notes
    -----
    Differs from the published code: none with ``scale="sigmoid"`` and ``backward_weights=False``, without the
    parameters that are unused there. The defaults are the paper's text; docs/models-results.md measures all four
    combinations.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4.
    """

    aggregation: Tensor
    next_to_root: Tensor

    def __init__(
        self,
        graph: PoseGraph,
        size: FlowSize,
        *,
        dimensions: int = 3,
        keypoint_features: int = 2,
        backward_weights: bool = True,
        scale: Scale = "exp",
    ) -> None:
        super().__init__()
        self.dimensions = dimensions
        self.backward_weights = backward_weights
        self.scale: Scale = scale
        self.embedding = ContextEmbedding(
            nodes=len(graph.joints),
            features=keypoint_features,
            hidden=size.embedding,
            context=size.context,
        )
        self.blocks = nn.ModuleList(
            CouplingBlock(
                index % dimensions,
                dimensions,
                hidden=size.hidden,
                context=size.context,
                backward_weights=backward_weights,
                scale=scale,
            )
            for index in range(size.blocks)
        )
        next_to_root = torch.tensor([[float(parent < 0)] for parent in graph.parents])
        self.register_buffer("aggregation", graph.aggregation(3 if backward_weights else 2), persistent=False)
        self.register_buffer("next_to_root", next_to_root, persistent=False)

    @property
    def couplings(self) -> list[CouplingBlock]:
        """The L blocks, from the pose to the latent."""
        return cast(list[CouplingBlock], list(self.blocks))

    def embed(self, keypoints: Tensor, observed: Tensor, root: Tensor | None = None) -> EmbeddedContext:
        """Embed the observed keypoints.

        Parameters
        ----------
        keypoints : Tensor
            (P, K, features), standardised, unitless.
        observed : Tensor
            (P, K), bool.
        root : Tensor, optional
            (P, D), the root's features; the origin where not given, as of root-relative poses.

        Returns
        -------
        EmbeddedContext
            The keypoints' features and the root's.
        """
        nothing = self.empty_context()
        if root is not None and len(root) not in (1, len(keypoints)):
            raise PoseDataError(f"flow: roots of {len(root)} poses, keypoints of {len(keypoints)}; expected as many.")
        mask = observed[..., None].to(nothing.root.dtype)
        features = self.embedding(keypoints, observed) * mask
        return EmbeddedContext(features, mask, nothing.root if root is None else root)

    def empty_context(self) -> EmbeddedContext:
        """Return the context without keypoints, with the root at the origin: that of the prior."""
        nothing = self.next_to_root.new_zeros
        return EmbeddedContext(None, nothing(1, len(self.next_to_root), 1), nothing(1, self.dimensions))

    def condition(self, context: EmbeddedContext, *, folded: list[FoldedBlock] | None = None) -> ConditionedFlow:
        """Fold the weights and condition the flow on keypoints.

        Parameters
        ----------
        context : EmbeddedContext
            From :meth:`embed` or :meth:`empty_context`.
        folded : list of FoldedBlock, optional
            The blocks of a conditioned flow with the same weights, to share them.

        Returns
        -------
        ConditionedFlow
            The map between poses and latents.
        """
        if folded is None:
            folded = [block.fold(self.aggregation) for block in self.couplings]
        return ConditionedFlow(folded, [block.context_messages(context, self.next_to_root) for block in self.couplings])

    @torch.no_grad()
    def initialise_actnorm(self, poses: Tensor, context: EmbeddedContext) -> None:
        """Set every ActNorm from a first batch, block after block, to give coordinates mean 0 and deviation 1.

        Parameters
        ----------
        poses : Tensor
            (P, n, K, D), standardised, unitless.
        context : EmbeddedContext
            Their keypoints.
        """
        for block in self.couplings:
            deviation, mean = torch.std_mean(poses, dim=(0, 1, 2))
            block.log_scale.copy_(-torch.log(deviation))
            block.shift.copy_(-mean / deviation)
            messages = block.context_messages(context, self.next_to_root)
            poses, _ = ConditionedFlow([block.fold(self.aggregation)], [messages]).forward(poses)
