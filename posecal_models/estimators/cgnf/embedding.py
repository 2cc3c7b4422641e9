"""Embedding of 2D keypoints by two graph convolutions."""

from __future__ import annotations

import torch
from torch import Tensor, nn

__all__ = ["ContextEmbedding"]


class ContextEmbedding(nn.Module):
    r"""Two dense GraphSAGE layers over one learnable adjacency, ReLU between them.

    .. math:: h_v = W_{rel} \frac{\sum_u A_{vu} c_u}{\max(\sum_u A_{vu}, 1)} + W_{root}\, c_v + b

    where rows and columns of A that belong to missing keypoints are zero.

    Parameters
    ----------
    nodes : int
        K, the keypoints.
    features, hidden, context : int
        Features of a keypoint, after the first layer and after the second.

    Notes
    -----
    Differs from the published code: the value stored for a missing keypoint is never read (there it is multiplied by
    zero, so that a NaN propagates).

    References
    ----------
    Hamilton, Ying and Leskovec 2017, arXiv:1706.02216. Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4,
    "Occlusion Representation".

    Examples
    --------
    >>> embed = ContextEmbedding(nodes=16, features=2, hidden=128, context=10)
    >>> sum(p.numel() for p in embed.parameters())  # (256 + 384) + (1,280 + 1,290) + 256
    3466
    """

    def __init__(self, *, nodes: int, features: int, hidden: int, context: int) -> None:
        super().__init__()
        self.adjacency = nn.Parameter(torch.ones(nodes, nodes))
        self.first_neighbours = nn.Linear(features, hidden, bias=False)
        self.first_own = nn.Linear(features, hidden)
        self.second_neighbours = nn.Linear(hidden, context, bias=False)
        self.second_own = nn.Linear(hidden, context)

    def forward(self, keypoints: Tensor, observed: Tensor) -> Tensor:
        """Embed the observed keypoints of P poses.

        Parameters
        ----------
        keypoints : Tensor
            (P, K, features), standardised, unitless. Values of missing keypoints are not read.
        observed : Tensor
            (P, K), bool.

        Returns
        -------
        Tensor
            (P, K, context), unitless. Rows of missing keypoints are arbitrary.
        """
        features = torch.where(observed[..., None], keypoints, 0)
        mask = observed.to(features.dtype)
        adjacency = self.adjacency * mask[:, :, None] * mask[:, None, :]
        adjacency = adjacency / adjacency.sum(dim=-1, keepdim=True).clamp(min=1)
        hidden = torch.relu(self.first_neighbours(adjacency @ features) + self.first_own(features))
        embedded: Tensor = self.second_neighbours(adjacency @ hidden) + self.second_own(hidden)
        return embedded
