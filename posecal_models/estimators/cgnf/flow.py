"""The conditional graph normalizing flow: L coupling blocks between poses and latents.

Everything here is unitless: standardised poses (P, n, K, D) on one side, standard normal latents of the same shape on
the other. Millimetres and pixels are converted in :mod:`posecal_models.estimators.cgnf.model`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from posecal_models.estimators.cgnf.buffers import MessageGraph, Workspace
from posecal_models.estimators.cgnf.context_messages import ContextMaps, NodeIndex
from posecal_models.estimators.cgnf.coupling import Couplings, FoldedCouplings
from posecal_models.estimators.cgnf.embedding import ContextEmbedding
from posecal_models.estimators.cgnf.graph import PoseGraph
from posecal_models.estimators.cgnf.passes import BlockWeights, PassInputs, Scale, forward_pass, inverse_pass

__all__ = ["SIZES", "ConditionedFlow", "EmbeddedContext", "FlowSize", "GraphFlow"]


@dataclass(frozen=True)
class FlowSize:
    """Size of a flow: L blocks, H hidden features, C context features, E hidden features of the embedding."""

    blocks: int
    hidden: int
    context: int
    embedding: int


SIZES = {
    "tiny": FlowSize(blocks=6, hidden=24, context=8, embedding=32),
    "small": FlowSize(blocks=10, hidden=100, context=10, embedding=128),
    "large": FlowSize(blocks=10, hidden=200, context=10, embedding=128),
    "xlarge": FlowSize(blocks=14, hidden=262, context=68, embedding=177),
}
"""The paper's three sizes, and a tiny one for quick trials."""


class EmbeddedContext(NamedTuple):
    """The context of P poses: the embedded keypoints that were observed, and the root.

    Attributes
    ----------
    keypoints : Tensor or None
        Features of R keypoints with a 1 at the end, (R, C + 1), zeros where one was not observed; None where none was.
    node_index : NodeIndex or None
        Target node and pose of each of them.
    root : Tensor or None
        Features of the root, (P, D); None where it is the origin, as of root-relative poses.
    """

    keypoints: Tensor | None
    node_index: NodeIndex | None
    root: Tensor | None

    def select(self, poses: slice) -> EmbeddedContext:
        """Select the context of some poses.

        Parameters
        ----------
        poses : slice
            p consecutive poses.

        Returns
        -------
        EmbeddedContext
            Of p poses.
        """
        root = None if self.root is None else self.root[poses]
        if self.keypoints is None or self.node_index is None:
            return EmbeddedContext(None, None, root)
        rows, node_index = self.node_index.select(poses)
        return EmbeddedContext(self.keypoints[rows], node_index, root)


class ConditionedFlow(NamedTuple):
    """The flow for given keypoints: a map between poses and latents.

    Attributes
    ----------
    folded : FoldedCouplings
        The L blocks with their weights multiplied out.
    context : ContextMaps
        Keypoints and root with the maps of their messages.
    node_index : NodeIndex or None
        Targets of the keypoints.
    graph : MessageGraph
        Senders and receivers of messages, in the flow's own order of the nodes.
    order : Tensor
        The flow's order of a pose's nodes, (K,), and its inverse, (K,): (2, K), integer.
    scale : str
        The function from the unconstrained to the positive scale.
    workspace : Workspace or None
        Memory for activations, reused by every pass.
    """

    folded: FoldedCouplings
    context: ContextMaps
    node_index: NodeIndex | None
    graph: MessageGraph
    order: Tensor
    scale: Scale
    workspace: Workspace | None = None

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
        coordinates, log_scale = forward_pass(self._coordinates(poses), self._pass_inputs())
        latents = self._poses(coordinates) * self.folded.pending_scale[-1] + self.folded.pending_shift[-1]
        log_determinant = log_scale[self.order[1]] + self.folded.log_determinant
        return latents, log_determinant.permute(1, 2, 0)

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
        latents = (latents - self.folded.pending_shift[-1]) / self.folded.pending_scale[-1]
        return self._poses(inverse_pass(self._coordinates(latents), self._pass_inputs()))

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

    def _pass_inputs(self) -> PassInputs:
        folded = self.folded
        transformed = torch.arange(len(folded.pool), device=folded.pool.device) % folded.pending_scale.shape[1]
        actnorms = (folded.pending_scale, folded.pending_shift)
        pending = (actnorm[:-1].gather(1, transformed[:, None]).squeeze(1) for actnorm in actnorms)
        blocks = BlockWeights(folded.first, folded.second, folded.pool, *pending)
        return PassInputs(blocks, self.context, self.node_index, self.graph, self.scale, self.workspace)

    def _coordinates(self, poses: Tensor) -> Tensor:
        """Turn (P, n, K, D) into (D + 1, K, P, n), the last row ones."""
        coordinates = poses.permute(3, 2, 0, 1)[:, self.order[0]]
        return torch.cat([coordinates, torch.ones_like(coordinates[:1])])

    def _poses(self, coordinates: Tensor) -> Tensor:
        """Turn (D + 1, K, P, n) into (P, n, K, D)."""
        return coordinates[:-1, self.order[1]].permute(2, 3, 1, 0)


class GraphFlow(nn.Module):
    """The conditional graph normalizing flow: an embedding of the keypoints and L blocks.

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
    parameters that are unused there. The defaults are the paper's text; docs/models.md measures all four combinations.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4.
    """

    order: Tensor

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
        order = torch.tensor(graph.order)
        self.register_buffer("order", torch.stack([order, order.argsort()]), persistent=False)
        self.scale: Scale = scale
        self.embedding = ContextEmbedding(
            nodes=len(graph.joints),
            features=keypoint_features,
            hidden=size.embedding,
            context=size.context,
        )
        self.couplings = Couplings(
            graph,
            blocks=size.blocks,
            dimensions=dimensions,
            hidden=size.hidden,
            context=size.context,
            backward_weights=backward_weights,
        )

    def embed(self, keypoints: Tensor, observed: Tensor, root: Tensor | None = None) -> EmbeddedContext:
        """Embed the observed keypoints.

        Parameters
        ----------
        keypoints : Tensor
            (P, K, features), standardised, unitless.
        observed : Tensor
            (P, K), bool.
        root : Tensor, optional
            (P, D), the root's features; the origin where not given.

        Returns
        -------
        EmbeddedContext
            The keypoints' features and the root's.
        """
        features = torch.cat([self.embedding(keypoints, observed), torch.ones_like(keypoints[..., :1])], dim=-1)
        features = features[:, self.order[0]].flatten(0, 1)
        mask = observed[:, self.order[0]].flatten()
        nodes = observed.shape[1]
        rows = torch.arange(len(mask), device=mask.device)
        starts: Sequence[int] = range(0, len(mask) + 1, nodes)
        if _drops_missing_rows(mask.device):
            rows, starts = rows[mask], [0, *observed.sum(1).cumsum(0).tolist()]
            features = features[rows]
        else:
            features = features * mask[:, None]
        return EmbeddedContext(features, NodeIndex(rows // nodes, rows % nodes, starts), root)

    def empty_context(self) -> EmbeddedContext:
        """Return the context without keypoints, with the root at the origin: that of the prior."""
        return EmbeddedContext(None, None, None)

    def condition(
        self,
        context: EmbeddedContext,
        *,
        folded: FoldedCouplings | None = None,
        blocks: int | None = None,
        workspace: Workspace | None = None,
    ) -> ConditionedFlow:
        """Fold the weights and condition the flow on keypoints.

        Parameters
        ----------
        context : EmbeddedContext
            From :meth:`embed` or :meth:`empty_context`.
        folded : FoldedCouplings, optional
            The folded weights, where they were computed before.
        blocks : int, optional
            Only the first blocks; all of them where not given.
        workspace : Workspace, optional
            Memory to reuse. Gradients of one pass must then be taken before the next one begins.

        Returns
        -------
        ConditionedFlow
            The map between poses and latents.
        """
        folded = self.couplings.fold(blocks) if folded is None else folded
        root = folded.root, folded.root_offset
        if context.root is not None:
            root = self.couplings.root_messages(context.root, blocks)
        keypoints = context.keypoints
        if keypoints is None:
            keypoints = folded.context_first.new_empty(0, folded.context_first.shape[2])
        maps = ContextMaps(keypoints, folded.context_first, folded.context_second, folded.pool, *root)
        graph = MessageGraph.of(self.couplings.first.spans, self.couplings.first.aggregation)
        return ConditionedFlow(folded, maps, context.node_index, graph, self.order, self.scale, workspace)

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
        for block in range(len(self.couplings.actnorm_shift)):
            inputs, _ = self.condition(context, blocks=block).forward(poses)
            deviation, mean = torch.std_mean(inputs, dim=(0, 1, 2))
            self.couplings.actnorm_log_scale[block] = -torch.log(deviation)
            self.couplings.actnorm_shift[block] = -mean / deviation


def _drops_missing_rows(device: torch.device) -> bool:
    """Whether rows of missing keypoints are dropped: on a GPU their number would need a synchronisation."""
    return device.type == "cpu"
