"""What do a joint's neighbours tell it? The learned maps of one message-passing layer, and the messages of the context.

Every message is ReLU(W h + b). What the context and the root say depends on the keypoints alone, never on the pose:
it is computed once per pose here, and shared among all samples of the pose.

The weights of all L blocks of a flow lie in one tensor, the block first, so that what is computed from weights alone is
computed for all blocks at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from posecal_models.graph import PoseGraph

__all__ = ["Evidence", "Linears", "MessagePassing"]


class Evidence(NamedTuple):
    """What is known beside the pose itself: the embedded keypoints that were observed, and the root.

    Attributes
    ----------
    context : Tensor or None
        Features of keypoints, (1 or L, R, C); None where nothing is observed.
    rows : Tensor or None
        Where each of them stands in the (K, P) grid, flattened; (R,), integer.
    counts : Tensor or None
        How much each of them says, (R, 1): 1 if observed, 0 if not. None where all of them are observed.
    root : Tensor
        Features of the root, (1 or L, P, D), P = 1 where all poses share them. The root of a root-relative pose is 0.
    poses : int
        P; 1 where nothing is observed and all poses share the same messages.
    """

    context: Tensor | None
    rows: Tensor | None
    counts: Tensor | None
    root: Tensor
    poses: int


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
    Drawn uniformly within 1/sqrt(features), as :class:`torch.nn.Linear` does.

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
        Whether no layer follows, so that context and root need not be carried on.
    backward_weights : bool
        Whether messages from child to parent have their own map, or share that of messages from parent to child.

    Notes
    -----
    Differs from the published code: it holds maps that nothing uses (child to parent, and the last layer's maps of
    context and root); they are not here.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4, "Graph Neural Network Layers".

    Examples
    --------
    >>> from posecal_models.graph import human36m_graph
    >>> layer = MessagePassing(
    ...     human36m_graph(), 10, 2, 8, 8, context=4, root=3, last=False, backward_weights=False
    ... )
    >>> layer.relations.shape  # 16 nodes speak to themselves and 16 to their neighbours
    torch.Size([16, 32])
    """

    relations: Tensor
    """What every message adds up to: (K, S), for the S messages that nodes say, :attr:`spans` after one another."""
    next_to_root: Tensor

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
        whole = (0, len(order))
        to_child, to_parent = graph.spans
        along = [(down, to_child), (down.T, to_parent)] if backward_weights else [(down + down.T, whole)]
        self.spans: tuple[tuple[int, int], ...] = (whole, *(span for _, span in along))
        matrices = [torch.eye(len(order)), *(matrix[:, slice(*span)] for matrix, span in along)]
        self.register_buffer("relations", torch.cat(matrices, dim=1), persistent=False)
        next_to_root = torch.zeros(len(order))
        next_to_root[: len(graph.next_to_root)] = 1
        self.register_buffer("next_to_root", next_to_root, persistent=False)

    def weights_and_biases(self) -> tuple[Tensor, Tensor]:
        """Stack the maps between nodes.

        Returns
        -------
        weights, biases : Tensor
            (L, maps, H, features) and (L, maps, H), in the order of :attr:`relations`.
        """
        maps = [self.from_self, self.from_parent, *([] if self.from_child is None else [self.from_child])]
        return torch.stack([m.weight for m in maps], dim=1), torch.stack([m.bias for m in maps], dim=1)

    def hear(self, evidence: Evidence, width: int | None = None) -> tuple[Tensor | None, Tensor, Evidence]:
        """Give what context and root say to this layer, and carry them on to the next.

        Parameters
        ----------
        evidence : Evidence
            Keypoints and root.
        width : int, optional
            Features of a message, those above H being 0; H where not given.

        Returns
        -------
        from_context, from_root : Tensor
            The messages of the keypoints (L, R, width), None where nothing is observed, and of the root
            (L, P or 1, width).
        evidence : Evidence
            For the next layer, H features each; unchanged where this is the last.
        """
        from_root, root = _said(self.from_root, self.next_root, evidence.root, width)
        if evidence.context is None:
            return None, from_root, evidence._replace(root=root)
        from_context, context = _said(self.from_context, self.next_context, evidence.context, width)
        return from_context, from_root, evidence._replace(context=context, root=root)

    def place(self, from_context: Tensor | None, from_root: Tensor, evidence: Evidence) -> Tensor:
        """Bring the messages to the nodes that they are for, and add them up.

        Parameters
        ----------
        from_context, from_root : Tensor
            (L, R, features) and (L, P or 1, features), as of :meth:`hear` or linear in it.
        evidence : Evidence
            Which node each keypoint speaks to.

        Returns
        -------
        Tensor
            (L, K, P or 1, features), the same for every sample of a pose.
        """
        messages = self.next_to_root[:, None, None] * from_root[:, None]
        if from_context is None or evidence.rows is None:
            return messages
        if evidence.counts is not None:
            from_context = from_context * evidence.counts
        blocks, nodes, _, features = messages.shape
        everywhere = messages.expand(-1, -1, evidence.poses, -1).reshape(blocks, -1, features).contiguous()
        return everywhere.index_add_(1, evidence.rows, from_context).view(blocks, nodes, -1, features)


def _said(said: Linears, carried: Linears | None, features: Tensor, width: int | None) -> tuple[Tensor, Tensor]:
    """Apply L maps with ReLU, and L more where a layer follows, to features (1 or L, R, F), in one product.

    What the first maps say is filled up with zeros to the width.
    """
    maps = [said] if carried is None else [said, carried]
    more = 0 if width is None else width - said.bias.shape[1]
    weights = torch.cat([pad(said.weight, (0, 0, 0, more)), *(m.weight for m in maps[1:])], dim=1)
    biases = torch.cat([pad(said.bias, (0, more)), *(m.bias for m in maps[1:])], dim=1)
    spoken = torch.relu_(torch.baddbmm(biases[:, None], features.expand(len(weights), -1, -1), weights.mT))
    if carried is None:
        return spoken, features
    first, second = torch.split(spoken, [said.bias.shape[1] + more, carried.bias.shape[1]], dim=-1)
    return first, second
