"""How is one coordinate of every joint moved, given the other two? One block of the flow.

A block is an ActNorm and an affine coupling whose shift and scale come from two message-passing layers.

The two layers are evaluated in an arithmetic order that gives the same numbers with fewer operations:
the first layer's linear update and the second layer's maps are one matrix, because nothing stands between them; and the
second layer's update, linear too, is applied before the sum over the bones, which then has 2 features instead of H.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from posecal_models.cgnf.message_passing import Evidence, MessagePassing
from posecal_models.graph import PoseGraph

__all__ = ["Block", "ReadyBlock", "Scale"]

Scale = Literal["sigmoid", "exp"]


class ReadyBlock(NamedTuple):
    """A block with its weights multiplied out and the messages of the context computed.

    Attributes
    ----------
    first : Tensor
        Maps of the first layer with their biases as last row, (maps, d + 1, H).
    second, second_bias : Tensor
        First update and second maps in one, (H, maps * H) and (maps * H,).
    pool : Tensor
        The second update, (2, H).
    relations : Tensor
        What each kind of message adds up to along the bones, (maps, K, K).
    evidence, offset : Tensor
        What context and root add after the first layer, (K, P, 1, H), and after the second, (K, P, 1, 2).
    actnorm_log_scale, actnorm_shift : Tensor
        The ActNorm, (D,) each.
    moved : int
        The coordinate that this block moves.
    kept : tuple of int
        The d = D - 1 coordinates that it reads.
    scale : str
        How the unconstrained scale becomes a positive one.
    """

    first: Tensor
    second: Tensor
    second_bias: Tensor
    pool: Tensor
    relations: Tensor
    evidence: Tensor
    offset: Tensor
    actnorm_log_scale: Tensor
    actnorm_shift: Tensor
    moved: int
    kept: tuple[int, ...]
    scale: Scale

    def of_poses(self, poses: slice) -> ReadyBlock:
        """Take the messages of some of the poses."""
        if self.evidence.shape[1] == 1:
            return self
        return self._replace(evidence=self.evidence[:, poses], offset=self.offset[:, poses])

    def shift_and_log_scale(self, coordinates: list[Tensor]) -> tuple[Tensor, Tensor]:
        """Evaluate both message-passing layers on the kept coordinates.

        Parameters
        ----------
        coordinates : list of Tensor
            D tensors (K, P, n), unitless, after the ActNorm; the moved one is not read.

        Returns
        -------
        shift, log_scale : Tensor
            (K, P, n) each, unitless.
        """
        kept = [coordinates[i] for i in self.kept]
        grid = kept[0].shape
        nodes, hidden = grid[0], self.pool.shape[1]
        read = torch.stack([*kept, torch.ones_like(kept[0])], dim=-1).flatten(0, -2)
        own, *along_bones = (torch.relu_(read @ weight) for weight in self.first)
        message = own.reshape(nodes, -1)
        for relation, heard in zip(self.relations[1:], along_bones, strict=True):
            message = torch.addmm(message, relation, heard.reshape(nodes, -1))
        message = message.reshape(*grid, hidden)
        message = message.add_(self.evidence) if len(along_bones) else message + self.evidence

        maps = len(self.relations)
        spoken = torch.relu_(torch.addmm(self.second_bias, message.reshape(-1, hidden), self.second))
        pooled = self.pool @ spoken.reshape(-1, hidden).T
        pooled = pooled.reshape(2, nodes, -1, maps).permute(0, 2, 3, 1).reshape(2, -1, maps * nodes)
        gathered = pooled @ self.relations.transpose(1, 2).reshape(maps * nodes, nodes)
        shift, unconstrained = gathered.transpose(1, 2).reshape(2, *grid) + self.offset.movedim(-1, 0)
        if self.scale == "exp":
            return shift, unconstrained
        return shift, torch.log(torch.sigmoid(unconstrained + 2) + 1e-3)

    def forward(self, coordinates: list[Tensor]) -> tuple[list[Tensor], Tensor]:
        """Move towards the latent, and say by how much volume shrinks.

        Parameters
        ----------
        coordinates : list of Tensor
            D tensors (K, P, n), unitless.

        Returns
        -------
        coordinates : list of Tensor
            The same shapes.
        log_determinant : Tensor
            (K, P, n), nats per node.
        """
        moved = [
            scale * x + shift
            for x, scale, shift in zip(coordinates, self.actnorm_log_scale.exp(), self.actnorm_shift, strict=True)
        ]
        shift, log_scale = self.shift_and_log_scale(moved)
        moved[self.moved] = moved[self.moved] * log_scale.exp() + shift
        return moved, log_scale + self.actnorm_log_scale.sum()

    def inverse(self, coordinates: list[Tensor]) -> list[Tensor]:
        """Move from the latent towards the pose.

        Parameters
        ----------
        coordinates : list of Tensor
            D tensors (K, P, n), unitless.

        Returns
        -------
        list of Tensor
            The same shapes.
        """
        shift, log_scale = self.shift_and_log_scale(coordinates)
        moved = list(coordinates)
        moved[self.moved] = (moved[self.moved] - shift) * torch.exp(-log_scale)
        return [
            (y - shift) * scale
            for y, scale, shift in zip(moved, (-self.actnorm_log_scale).exp(), self.actnorm_shift, strict=True)
        ]


class Block(nn.Module):
    """One block of the flow: an ActNorm shared by all nodes, then the affine coupling of one coordinate.

    .. math:: y = e^{a} \\odot x + b, \\qquad z_i = y_i \\, s(y_{\\neq i}, c) + t(y_{\\neq i}, c)

    Parameters
    ----------
    graph : PoseGraph
        The bones between the K nodes.
    dimensions : int
        D, the coordinates of a node.
    moved : int
        i, the coordinate that is moved.
    hidden, context : int
        Features of a message and of an embedded keypoint.
    backward_weights : bool
        Whether messages from child to parent have their own map.
    scale : str
        ``exp``: s = exp(u). ``sigmoid``: s = sigmoid(u + 2) + 0.001, never above 1.001.

    Notes
    -----
    Differs from the published code: none with ``scale="sigmoid"`` and ``backward_weights=False``; the paper's text
    has ``exp`` and its own map for each direction.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4, "Affine Coupling Layer". ActNorm: Kingma and Dhariwal 2018,
    arXiv:1807.03039.
    """

    def __init__(
        self,
        graph: PoseGraph,
        *,
        dimensions: int,
        moved: int,
        hidden: int,
        context: int,
        backward_weights: bool,
        scale: Scale,
    ) -> None:
        super().__init__()
        self.moved = moved
        self.kept = tuple(i for i in range(dimensions) if i != moved)
        self.scale: Scale = scale
        self.actnorm_log_scale = nn.Parameter(torch.zeros(dimensions))
        self.actnorm_shift = nn.Parameter(torch.zeros(dimensions))
        self.first = MessagePassing(
            graph,
            len(self.kept),
            hidden,
            hidden,
            context=context,
            root=dimensions,
            last=False,
            backward_weights=backward_weights,
        )
        self.second = MessagePassing(
            graph,
            hidden,
            hidden,
            2,
            context=hidden,
            root=hidden,
            last=True,
            backward_weights=backward_weights,
        )

    def ready(self, evidence: Evidence) -> ReadyBlock:
        """Multiply the weights out and compute what context and root say, once for all samples.

        Parameters
        ----------
        evidence : Evidence
            Embedded keypoints and root of P poses.

        Returns
        -------
        ReadyBlock
            The block as a function of coordinates alone.
        """
        first, second = self.first, self.second
        layers = [first.from_self, *first.bone_maps]
        maps = [second.from_self, *second.bone_maps]
        weights = torch.cat([layer.weight for layer in maps])
        biases = torch.cat([layer.bias for layer in maps])
        heard = second.evidence_messages(first.next_evidence(evidence))
        return ReadyBlock(
            first=torch.stack([torch.cat([layer.weight.T, layer.bias[None]]) for layer in layers]),
            second=(weights @ first.pool.weight).T,
            second_bias=weights @ first.pool.bias + biases,
            pool=second.pool.weight,
            relations=first.relations(),
            evidence=first.evidence_messages(evidence),
            offset=functional.linear(heard, second.pool.weight, second.pool.bias),
            actnorm_log_scale=self.actnorm_log_scale,
            actnorm_shift=self.actnorm_shift,
            moved=self.moved,
            kept=self.kept,
            scale=self.scale,
        )

    @torch.no_grad()
    def initialise_actnorm(self, coordinates: list[Tensor]) -> None:
        """Set the ActNorm so that each coordinate of these poses has mean 0 and standard deviation 1 after it.

        Parameters
        ----------
        coordinates : list of Tensor
            D tensors (K, P, n), unitless: what reaches this block for the first batch.
        """
        for i, x in enumerate(coordinates):
            spread, mean = torch.std_mean(x)
            self.actnorm_log_scale[i] = -torch.log(spread)
            self.actnorm_shift[i] = -mean / spread
