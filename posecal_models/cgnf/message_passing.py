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

from posecal_models.graph import PoseGraph

__all__ = ["Evidence", "Linears", "MessagePassing"]


class Evidence(NamedTuple):
    """What is known beside the pose itself: the embedded keypoints that were observed, and the root.

    Attributes
    ----------
    context : Tensor or None
        Features of the keypoints, (1 or L, K, P, C); None where nothing is observed.
    observed : Tensor or None
        1 for an observed keypoint and 0 for a missing one, (K, P, 1); None where nothing is observed.
    root : Tensor
        Features of the root, (1 or L, P, D), P = 1 where all poses share them. The root of a root-relative pose is 0.
    """

    context: Tensor | None
    observed: Tensor | None
    root: Tensor


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
    >>> layer.relations.shape  # a node's own message and those of its neighbours, 2 * 16 columns
    torch.Size([16, 32])
    """

    relations: Tensor
    """What each kind of message adds up to: (K, maps * K), a node's own message and those along the bones."""
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
        down = torch.from_numpy(graph.from_parent).to(torch.get_default_dtype())
        along = [down, down.T] if backward_weights else [down + down.T]
        self.register_buffer("relations", torch.cat([torch.eye(len(down)), *along], dim=1), persistent=False)
        next_to_root = torch.zeros(len(down))
        next_to_root[list(graph.next_to_root)] = 1
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

    def hear(self, evidence: Evidence) -> tuple[Tensor | None, Tensor, Evidence]:
        """Give what context and root say to this layer, and carry them on to the next.

        Parameters
        ----------
        evidence : Evidence
            Keypoints and root.

        Returns
        -------
        from_context, from_root : Tensor
            The messages of the keypoints (L, K, P, H), None where nothing is observed, and of the root (L, P or 1, H).
        evidence : Evidence
            For the next layer, H features each; unchanged where this is the last.
        """
        from_context, context = _said(self.from_context, self.next_context, evidence.context)
        from_root, root = _said(self.from_root, self.next_root, evidence.root)
        if from_root is None or root is None:
            raise ValueError("evidence.root: None; expected the root's features.")
        return from_context, from_root, Evidence(context, evidence.observed, root)

    def place(self, from_context: Tensor | None, from_root: Tensor, observed: Tensor | None) -> Tensor:
        """Bring the messages to the nodes that they are for, and add them up.

        Parameters
        ----------
        from_context, from_root : Tensor
            (L, K, P, features) and (L, P or 1, features), as of :meth:`hear` or linear in it.
        observed : Tensor or None
            Which keypoints are there to say something, (K, P, 1).

        Returns
        -------
        Tensor
            (L, K, P or 1, features), the same for every sample of a pose.
        """
        messages = self.next_to_root[:, None, None] * from_root[:, None]
        if from_context is None or observed is None:
            return messages
        return torch.addcmul(messages, from_context, observed)


def _said(said: Linears, carried: Linears | None, features: Tensor | None) -> tuple[Tensor | None, Tensor | None]:
    """Apply L maps with ReLU, and L more where a layer follows, to features (1 or L, ..., F), in one product."""
    if features is None:
        return None, None
    maps = [said] if carried is None else [said, carried]
    weights = torch.cat([m.weight for m in maps], dim=1)
    biases = torch.cat([m.bias for m in maps], dim=1)
    rows = features.flatten(1, -2).expand(len(weights), -1, -1)
    spoken = torch.relu_(torch.baddbmm(biases[:, None], rows, weights.mT))
    spoken = spoken.view(len(weights), *features.shape[1:-1], -1)
    if carried is None:
        return spoken, features
    first, second = spoken.split([said.bias.shape[1], carried.bias.shape[1]], dim=-1)
    return first, second
