"""Learned maps of one message-passing layer between the joints of a pose.

Every message is ReLU(W h + b). The weights of all L blocks of a flow are stacked in one tensor, the block first, so
that whatever depends on weights alone is computed for all blocks at once.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from posecal_models.estimators.cgnf.graph import PoseGraph

__all__ = ["Linears", "MessagePassing"]


class Linears(nn.Module):
    """L linear maps with biases, one for each block of a flow.

    Parameters
    ----------
    blocks : int
        L.
    features, features_out : int
        Features before and after.

    Notes
    -----
    Initialised uniformly within 1/sqrt(features), as :class:`torch.nn.Linear`.

    Examples
    --------
    >>> maps = Linears(10, 2, 100)
    >>> maps.weight.shape, maps.bias.shape
    (torch.Size([10, 100, 2]), torch.Size([10, 100]))
    """

    def __init__(self, blocks: int, features: int, features_out: int) -> None:
        super().__init__()
        bound = 1 / math.sqrt(features)
        self.weight = nn.Parameter(torch.empty(blocks, features_out, features).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(blocks, features_out).uniform_(-bound, bound))

    def forward(self, features: Tensor) -> Tensor:
        """Apply the maps, each with its ReLU.

        Parameters
        ----------
        features : Tensor
            (1 or L, P, features).

        Returns
        -------
        Tensor
            (L, P, features_out).
        """
        return torch.relu(features @ self.weight.mT + self.bias[:, None])

    def homogeneous(self, width: int, *, carry: bool = False) -> Tensor:
        """Return weights and biases as one matrix, for features that end with a 1.

        Parameters
        ----------
        width : int
            Features after the maps: more than ``features_out``, filled up with zeros.
        carry : bool
            Whether the first of these is 1 instead, to carry the next biases.

        Returns
        -------
        Tensor
            (L, features + 1, width).
        """
        maps = pad(torch.cat([self.weight.mT, self.bias[:, None]], dim=1), (0, width - self.bias.shape[1]))
        if not carry:
            return maps
        carrier = torch.zeros_like(maps[0])
        carrier[-1, self.bias.shape[1]] = 1
        return maps + carrier


class MessagePassing(nn.Module):
    r"""The maps of one layer, from ``features`` to ``hidden`` and, pooled, to ``features_out``.

    .. math:: m_v = \psi_x(h_v) + \sum_{u \to v} \psi_{x \to x}(h_u) + \sum_{u \leftarrow v} \psi_{x \leftarrow x}(h_u)
              + [v \text{ observed}]\, \psi_{c \to x}(c_v) + [v \text{ next to the root}]\, \psi_{r \to x}(r)

    with every :math:`\psi(h) = \mathrm{ReLU}(W h + b)`, and the update :math:`h'_v = W_{pool} m_v + b_{pool}`.

    Parameters
    ----------
    graph : PoseGraph
        The bones between the K nodes.
    blocks : int
        L.
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
    >>> from posecal_models.estimators.cgnf.graph import human36m_graph
    >>> layer = MessagePassing(
    ...     human36m_graph(), 10, 2, 8, 8, context=4, root=3, last=False, backward_weights=False
    ... )
    >>> layer.aggregation.shape  # 16 self messages and 16 along the edges
    torch.Size([16, 32])
    """

    aggregation: Tensor
    """(K, S): sums S messages at the K nodes that receive them; messages are ordered as in :attr:`spans`."""
    next_to_root: Tensor
    """(K,): 1 for the nodes whose parent is the root, 0 for the others."""

    def __init__(
        self,
        graph: PoseGraph,
        blocks: int,
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
        self.from_self = Linears(blocks, features, hidden)
        self.from_parent = Linears(blocks, features, hidden)
        self.from_child = Linears(blocks, features, hidden) if backward_weights else None
        self.from_context = Linears(blocks, context, hidden)
        self.from_root = Linears(blocks, root, hidden)
        self.next_context = None if last else Linears(blocks, context, hidden)
        self.next_root = None if last else Linears(blocks, root, hidden)
        self.pool = Linears(blocks, hidden, features_out)
        order = list(graph.order)
        down = torch.from_numpy(graph.from_parent[order][:, order]).to(torch.get_default_dtype())
        all_nodes = (0, len(order))
        to_child, to_parent = graph.spans
        edges = [(down, to_child), (down.T, to_parent)] if backward_weights else [(down + down.T, all_nodes)]
        self.spans: tuple[tuple[int, int], ...] = (all_nodes, *(span for _, span in edges))
        matrices = [torch.eye(len(order)), *(matrix[:, slice(*span)] for matrix, span in edges)]
        self.register_buffer("aggregation", torch.cat(matrices, dim=1), persistent=False)
        next_to_root = torch.zeros(len(order))
        next_to_root[: len(graph.next_to_root)] = 1
        self.register_buffer("next_to_root", next_to_root, persistent=False)

    def next_maps(self) -> tuple[Linears, Linears]:
        """Return the maps from keypoints and root to their features in the next layer.

        Returns
        -------
        context, root : Linears
            The two.

        Raises
        ------
        RuntimeError
            Where no layer follows.
        """
        if self.next_context is None or self.next_root is None:
            raise RuntimeError("the last layer has no maps to a next one")
        return self.next_context, self.next_root

    def weights_and_biases(self) -> tuple[Tensor, Tensor]:
        """Stack the maps between nodes.

        Returns
        -------
        weights, biases : Tensor
            (L, maps, H, features) and (L, maps, H), in the order of :attr:`spans`.
        """
        maps = [self.from_self, self.from_parent, *([] if self.from_child is None else [self.from_child])]
        return torch.stack([m.weight for m in maps], dim=1), torch.stack([m.bias for m in maps], dim=1)
