"""Which latent belongs to a pose, and how dense is it there? The whole flow, L blocks between pose and latent.

Everything here is unitless: standardised poses (P, n, K, D) on one side, standard normal latents of the same shape on
the other. Millimetres and pixels come in at :mod:`posecal_models.cgnf.model`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from posecal_models.cgnf.coupling import Block, ReadyBlock, Scale
from posecal_models.cgnf.embedding import ContextEmbedding
from posecal_models.cgnf.message_passing import Evidence
from posecal_models.graph import PoseGraph

__all__ = ["SIZES", "FlowSize", "GraphFlow", "ReadyFlow"]


@dataclass(frozen=True)
class FlowSize:
    """How large a flow is: L blocks, H hidden features, C context features, E hidden features of the embedding."""

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
"""The paper's three sizes, and a tiny one for trying things out."""

_ROWS_IN_CACHE = 512


class ReadyFlow:
    """The flow for given keypoints: a map between poses and latents, with the messages of the context in place.

    Parameters
    ----------
    blocks : list of ReadyBlock
        The L blocks.
    """

    def __init__(self, blocks: list[ReadyBlock]) -> None:
        self._blocks = blocks

    def _of_poses(self, poses: slice) -> ReadyFlow:
        return ReadyFlow([block.of_poses(poses) for block in self._blocks])

    def forward(self, poses: Tensor) -> tuple[Tensor, Tensor]:
        """Give the latents of poses.

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
        if (chunks := _chunks(poses)) is not None:
            latents, log_determinant = torch.empty_like(poses), poses.new_empty(poses.shape[:-1])
            for chunk in chunks:
                latents[chunk], log_determinant[chunk] = self._of_poses(chunk[0]).forward(poses[chunk])
            return latents, log_determinant
        coordinates = list(poses.permute(3, 2, 0, 1).contiguous())
        log_determinant = torch.zeros_like(coordinates[0])
        for block in self._blocks:
            coordinates, change = block.forward(coordinates)
            log_determinant = log_determinant + change
        return torch.stack(coordinates, dim=-1).permute(1, 2, 0, 3), log_determinant.permute(1, 2, 0)

    def inverse(self, latents: Tensor) -> Tensor:
        """Give the poses of latents.

        Parameters
        ----------
        latents : Tensor
            (P, n, K, D), unitless.

        Returns
        -------
        Tensor
            (P, n, K, D), standardised poses, unitless.
        """
        if (chunks := _chunks(latents)) is not None:
            poses = torch.empty_like(latents)
            for chunk in chunks:
                poses[chunk] = self._of_poses(chunk[0]).inverse(latents[chunk])
            return poses
        coordinates = list(latents.permute(3, 2, 0, 1).contiguous())
        for block in reversed(self._blocks):
            coordinates = block.inverse(coordinates)
        return torch.stack(coordinates, dim=-1).permute(1, 2, 0, 3)

    def log_prob_per_node(self, poses: Tensor) -> Tensor:
        """Give each node's share of the log density; they sum to the log density of the pose.

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


def _chunks(poses: Tensor) -> list[tuple[slice, slice]] | None:
    """Cut (P, n) into pieces whose activations stay in the processor's cache; None where cutting gains nothing."""
    many, samples, nodes, _ = poses.shape
    at_once = max(1, _ROWS_IN_CACHE // nodes)
    if torch.is_grad_enabled() or poses.device.type != "cpu" or many * samples <= at_once:
        return None
    pieces = -(-samples // at_once)
    samples_each = -(-samples // pieces)
    poses_each = max(1, at_once // samples_each)
    return [
        (slice(p, p + poses_each), slice(n, n + samples_each))
        for p in range(0, many, poses_each)
        for n in range(0, samples, samples_each)
    ]


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
        ``exp`` or ``sigmoid``, as in :class:`posecal_models.cgnf.coupling.Block`.

    Notes
    -----
    Differs from the published code: none with ``scale="sigmoid"`` and ``backward_weights=False``, less the parameters
    that it never uses.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4.
    """

    def __init__(
        self,
        graph: PoseGraph,
        size: FlowSize,
        *,
        dimensions: int = 3,
        keypoint_features: int = 2,
        backward_weights: bool = False,
        scale: Scale = "sigmoid",
    ) -> None:
        super().__init__()
        self.dimensions = dimensions
        self.embedding = ContextEmbedding(
            nodes=len(graph.joints),
            features=keypoint_features,
            hidden=size.embedding,
            context=size.context,
        )
        self.blocks = nn.ModuleList(
            Block(
                graph,
                dimensions=dimensions,
                moved=index % dimensions,
                hidden=size.hidden,
                context=size.context,
                backward_weights=backward_weights,
                scale=scale,
            )
            for index in range(size.blocks)
        )

    def evidence(self, keypoints: Tensor, observed: Tensor, root: Tensor | None = None) -> Evidence:
        """Embed what was observed.

        Parameters
        ----------
        keypoints : Tensor
            (P, K, features), standardised, unitless.
        observed : Tensor
            (P, K), bool.
        root : Tensor, optional
            (P, D), the root's features; 0 where not given.

        Returns
        -------
        Evidence
            The observed keypoints' features and the root's.
        """
        embedded = self.embedding(keypoints, observed).transpose(0, 1).flatten(0, 1)
        rows = observed.T.flatten().nonzero().squeeze(1)
        if root is None:
            root = keypoints.new_zeros(1, self.dimensions)
        return Evidence(embedded[rows], rows, root, len(keypoints))

    def no_evidence(self) -> Evidence:
        """Give what is known of a pose of which nothing was observed: that its root is the origin."""
        weight = self.embedding.second_own.weight
        nothing = weight.new_zeros(0, weight.shape[0])
        rows = torch.zeros(0, dtype=torch.long, device=weight.device)
        return Evidence(nothing, rows, weight.new_zeros(1, self.dimensions), 1)

    def ready(self, evidence: Evidence) -> ReadyFlow:
        """Compute everything that the samples of a pose share.

        Parameters
        ----------
        evidence : Evidence
            From :meth:`evidence` or :meth:`no_evidence`.

        Returns
        -------
        ReadyFlow
            The map between poses and latents.
        """
        return ReadyFlow([block.ready(evidence) for block in self._blocks()])

    @torch.no_grad()
    def initialise_actnorm(self, poses: Tensor, evidence: Evidence) -> None:
        """Set every ActNorm from a first batch, block after block.

        Parameters
        ----------
        poses : Tensor
            (P, n, K, D), standardised, unitless.
        evidence : Evidence
            Their keypoints.
        """
        coordinates = list(poses.permute(3, 2, 0, 1).contiguous())
        for block in self._blocks():
            block.initialise_actnorm(coordinates)
            coordinates, _ = block.ready(evidence).forward(coordinates)

    def _blocks(self) -> list[Block]:
        return [block for block in self.blocks if isinstance(block, Block)]
