"""Which latent belongs to a pose, and how dense is it there? The whole flow, L blocks between pose and latent.

Everything here is unitless: standardised poses (P, n, K, D) on one side, standard normal latents of the same shape on
the other. Millimetres and pixels come in at :mod:`posecal_models.cgnf.model`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from posecal_models.cgnf.coupling import Couplings, FoldedCouplings
from posecal_models.cgnf.embedding import ContextEmbedding
from posecal_models.cgnf.hearing import Seats, Voices
from posecal_models.cgnf.passes import Blocks, Path, Scale, latents_of, poses_of
from posecal_models.cgnf.rooms import Bones, Workspace
from posecal_models.graph import PoseGraph

__all__ = ["SIZES", "Evidence", "FlowSize", "GraphFlow", "ReadyFlow"]


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


class Evidence(NamedTuple):
    """What is known of P poses beforehand: the embedded keypoints that were observed, and the root.

    Attributes
    ----------
    keypoints : Tensor or None
        Features of R keypoints with a 1 at the end, (R, C + 1), zeros where one was not observed; None where none was.
    seats : Seats or None
        Which node of which pose each of them speaks to.
    root : Tensor or None
        Features of the root, (P, D); None where it is the origin, as of root-relative poses.
    """

    keypoints: Tensor | None
    seats: Seats | None
    root: Tensor | None

    def of_poses(self, poses: slice) -> Evidence:
        """Take what is known of some poses.

        Parameters
        ----------
        poses : slice
            p poses that stand together.

        Returns
        -------
        Evidence
            Of p poses.
        """
        root = None if self.root is None else self.root[poses]
        if self.keypoints is None or self.seats is None:
            return Evidence(None, None, root)
        rows, seats = self.seats.of_poses(poses)
        return Evidence(self.keypoints[rows], seats, root)


class ReadyFlow(NamedTuple):
    """The flow for given keypoints: a map between poses and latents.

    Attributes
    ----------
    folded : FoldedCouplings
        The L blocks with their weights multiplied out.
    voices : Voices
        What speaks to the poses.
    seats : Seats or None
        Where the keypoints speak.
    bones : Bones
        Who speaks to whom, in the flow's own order of the nodes.
    order : Tensor
        Which node of a pose is which of the flow's, (K,), and back, (K,): (2, K), integer.
    scale : str
        How an unconstrained scale becomes a positive one.
    workspace : Workspace or None
        Memory for activations that is used again and again.
    """

    folded: FoldedCouplings
    voices: Voices
    seats: Seats | None
    bones: Bones
    order: Tensor
    scale: Scale
    workspace: Workspace | None = None

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
        coordinates, log_stretch = latents_of(self._coordinates(poses), self._path())
        latents = self._poses(coordinates) * self.folded.behind_scale[-1] + self.folded.behind_shift[-1]
        log_determinant = log_stretch[self.order[1]] + self.folded.log_determinant
        return latents, log_determinant.permute(1, 2, 0)

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
        latents = (latents - self.folded.behind_shift[-1]) / self.folded.behind_scale[-1]
        return self._poses(poses_of(self._coordinates(latents), self._path()))

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

    def _path(self) -> Path:
        folded = self.folded
        moved = torch.arange(len(folded.pool), device=folded.pool.device) % folded.behind_scale.shape[1]
        both = (folded.behind_scale, folded.behind_shift)
        behind = (behind[:-1].gather(1, moved[:, None]).squeeze(1) for behind in both)
        blocks = Blocks(folded.first, folded.second, folded.pool, *behind)
        return Path(blocks, self.voices, self.seats, self.bones, self.scale, self.workspace)

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
    Differs from the published code: none with ``scale="sigmoid"`` and ``backward_weights=False``, less the parameters
    that it never uses. The defaults are the paper's text; docs/models.md measures all four combinations.

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

    def evidence(self, keypoints: Tensor, observed: Tensor, root: Tensor | None = None) -> Evidence:
        """Embed what was observed.

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
        Evidence
            The keypoints' features and the root's.
        """
        features = torch.cat([self.embedding(keypoints, observed), torch.ones_like(keypoints[..., :1])], dim=-1)
        features = features[:, self.order[0]].flatten(0, 1)
        seen = observed[:, self.order[0]].flatten()
        nodes = observed.shape[1]
        rows = torch.arange(len(seen), device=seen.device)
        starts: Sequence[int] = range(0, len(seen) + 1, nodes)
        if _chooses_rows(seen.device):
            rows, starts = rows[seen], [0, *observed.sum(1).cumsum(0).tolist()]
            features = features[rows]
        else:
            features = features * seen[:, None]
        return Evidence(features, Seats(rows // nodes, rows % nodes, starts), root)

    def no_evidence(self) -> Evidence:
        """Give what is known of a pose of which nothing was observed: that its root is the origin."""
        return Evidence(None, None, None)

    def ready(
        self,
        evidence: Evidence,
        *,
        folded: FoldedCouplings | None = None,
        blocks: int | None = None,
        workspace: Workspace | None = None,
    ) -> ReadyFlow:
        """Compute what the weights alone decide, and bring the keypoints in.

        Parameters
        ----------
        evidence : Evidence
            From :meth:`evidence` or :meth:`no_evidence`.
        folded : FoldedCouplings, optional
            The multiplied weights, where they are at hand.
        blocks : int, optional
            Only the first blocks; all of them where not given.
        workspace : Workspace, optional
            Memory to use again and again. Gradients of one pass must then be taken before the next one begins.

        Returns
        -------
        ReadyFlow
            The map between poses and latents.
        """
        folded = self.couplings.folded(blocks) if folded is None else folded
        nobody = folded.hear_first.new_empty(0, folded.hear_first.shape[2])
        root = folded.root, folded.root_offset
        if evidence.root is not None:
            root = self.couplings.told_by_root(evidence.root, blocks)
        keypoints = nobody if evidence.keypoints is None else evidence.keypoints
        voices = Voices(keypoints, folded.hear_first, folded.hear_second, folded.pool, *root)
        bones = Bones.of(self.couplings.first.spans, self.couplings.first.relations)
        return ReadyFlow(folded, voices, evidence.seats, bones, self.order, self.scale, workspace)

    @torch.no_grad()
    def initialise_actnorm(self, poses: Tensor, evidence: Evidence) -> None:
        """Set every ActNorm from a first batch, block after block, to give coordinates mean 0 and deviation 1.

        Parameters
        ----------
        poses : Tensor
            (P, n, K, D), standardised, unitless.
        evidence : Evidence
            Their keypoints.
        """
        for block in range(len(self.couplings.actnorm_shift)):
            reaching, _ = self.ready(evidence, blocks=block).forward(poses)
            spread, mean = torch.std_mean(reaching, dim=(0, 1, 2))
            self.couplings.actnorm_log_scale[block] = -torch.log(spread)
            self.couplings.actnorm_shift[block] = -mean / spread


def _chooses_rows(device: torch.device) -> bool:
    """Whether missing keypoints are left out: a GPU would have to wait for their number."""
    return device.type == "cpu"
