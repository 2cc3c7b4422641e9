"""Embedding of 2D keypoints, and message passing between the joints of a pose.

Every message is ReLU(W h + b). Messages from keypoints and from the root depend on no pose: they are computed once, and
the samples of a pose share them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

__all__ = ["ContextEmbedding", "EmbeddedContext", "MessagePassing"]


class EmbeddedContext(NamedTuple):
    """Features of the keypoints and the root of P poses.

    Attributes
    ----------
    keypoints : Tensor or None
        (P, K, C), 0 where a keypoint is missing. None where no pose has any, as for the prior.
    observed : Tensor
        (P, K, 1): 1 where the keypoint was observed, else 0.
    root : Tensor
        (P or 1, features).
    """

    keypoints: Tensor | None
    observed: Tensor
    root: Tensor


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


class MessagePassing(nn.Module):
    r"""The maps of one layer, from ``features`` to ``hidden`` and, by its update, to ``features_out``.

    .. math:: m_v = \psi_x(h_v) + \sum_{u \to v} \psi_{x \to x}(h_u) + \sum_{u \leftarrow v} \psi_{x \leftarrow x}(h_u)
              + [v \text{ observed}]\, \psi_{c \to x}(c_v) + [v \text{ next to the root}]\, \psi_{r \to x}(r)

    with every :math:`\psi(h) = \mathrm{ReLU}(W h + b)`, and the update :math:`h'_v = W_{pool} m_v + b_{pool}`.

    Parameters
    ----------
    features, hidden, features_out : int
        Features of a node before, within and after the layer.
    context, root : int
        Features of an observed keypoint and of the root.
    last : bool
        Whether no layer follows, so that context and root need no features in a next one.
    backward_weights : bool
        Whether messages from child to parent have their own map, or share that of messages from parent to child.

    Notes
    -----
    Differs from the published code: its unused maps (child to parent, and the last layer's maps of context and root)
    are left out.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4, "Graph Neural Network Layers".

    Examples
    --------
    >>> layer = MessagePassing(2, 8, 8, context=4, root=3, last=False, backward_weights=True)
    >>> weight, bias = layer.node_maps()
    >>> weight.shape, bias.shape  # to itself, from parent to child, from child to parent
    (torch.Size([3, 8, 2]), torch.Size([3, 8]))
    """

    def __init__(
        self,
        features: int,
        hidden: int,
        features_out: int,
        *,
        context: int,
        root: int,
        last: bool,
        backward_weights: bool,
    ) -> None:
        super().__init__()
        self.from_self = nn.Linear(features, hidden)
        self.from_parent = nn.Linear(features, hidden)
        self.from_child = nn.Linear(features, hidden) if backward_weights else None
        self.from_context = nn.Linear(context, hidden)
        self.from_root = nn.Linear(root, hidden)
        self.next_context = None if last else nn.Linear(context, hidden)
        self.next_root = None if last else nn.Linear(root, hidden)
        self.pool = nn.Linear(hidden, features_out)

    def node_maps(self) -> tuple[Tensor, Tensor]:
        """Stack the maps of messages between nodes.

        Returns
        -------
        weight, bias : Tensor
            (maps, hidden, features) and (maps, hidden), in the order of
            :meth:`posecal_models.estimators.cgnf.graph.PoseGraph.aggregation`.
        """
        maps = [layer for layer in (self.from_self, self.from_parent, self.from_child) if layer is not None]
        return torch.stack([layer.weight for layer in maps]), torch.stack([layer.bias for layer in maps])

    def context_messages(self, context: EmbeddedContext, next_to_root: Tensor) -> Tensor:
        """Sum the messages from keypoints and root to the nodes.

        Parameters
        ----------
        context : EmbeddedContext
            Keypoints and root of P poses.
        next_to_root : Tensor
            (K, 1): 1 for the nodes whose parent is the root, 0 for the others.

        Returns
        -------
        Tensor
            (P or 1, K, hidden).
        """
        messages: Tensor = torch.relu(self.from_root(context.root))[:, None] * next_to_root
        if context.keypoints is None:
            return messages
        return messages + _observed_messages(self.from_context, context.keypoints, context.observed)

    def next_features(self, context: EmbeddedContext) -> EmbeddedContext:
        """Map keypoints and root to their features in the next layer.

        Parameters
        ----------
        context : EmbeddedContext
            Keypoints and root of P poses.

        Returns
        -------
        EmbeddedContext
            With ``hidden`` features; the same where no layer follows.
        """
        if self.next_context is None or self.next_root is None:
            return context
        keypoints = context.keypoints
        if keypoints is not None:
            keypoints = _observed_messages(self.next_context, keypoints, context.observed)
        return EmbeddedContext(keypoints, context.observed, torch.relu(self.next_root(context.root)))


def _observed_messages(layer: nn.Linear, keypoints: Tensor, observed: Tensor) -> Tensor:
    """Apply a map and its ReLU to features that are 0 where a keypoint is missing; so is the result."""
    return torch.addcmul(keypoints @ layer.weight.mT, observed, layer.bias).relu_()
