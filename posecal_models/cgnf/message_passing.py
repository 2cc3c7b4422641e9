"""What do a joint's neighbours tell it? The learned maps of one message-passing layer, and the messages of the context.

Every message is ReLU(W h + b). What the context and the root say depends on the keypoints alone, never on the pose:
it is computed once per pose here, and shared among all samples of the pose.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from posecal_models.graph import PoseGraph

__all__ = ["Evidence", "MessagePassing"]


class Evidence(NamedTuple):
    """What is known beside the pose itself: the embedded keypoints that were observed, and the root.

    Attributes
    ----------
    context : Tensor
        Features of the observed keypoints only, (R, C): row i belongs to ``rows[i]``.
    rows : Tensor
        Where each observed keypoint stands in the (K, P) grid, flattened; (R,), integer.
    root : Tensor
        Features of the root, (P, D) or (1, D) where all poses share them. The root of a root-relative pose is 0.
    poses : int
        P, the number of poses; 1 where nothing is observed and all poses share the same messages.
    """

    context: Tensor
    rows: Tensor
    root: Tensor
    poses: int


class MessagePassing(nn.Module):
    r"""The maps of one layer, from ``features`` to ``hidden`` and, pooled, to ``features_out``.

    .. math:: m_v = \psi_x(h_v) + \sum_{u \to v} \psi_{x \to x}(h_u) + \sum_{u \leftarrow v} \psi_{x \leftarrow x}(h_u)
              + [v \text{ observed}]\, \psi_{c \to x}(c_v) + [v \text{ next to the root}]\, \psi_{r \to x}(r)

    with every :math:`\psi(h) = \mathrm{ReLU}(W h + b)`, and the update :math:`h'_v = W_{pool} m_v + b_{pool}`.

    Parameters
    ----------
    graph : PoseGraph
        The bones between the K nodes.
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
    ...     human36m_graph(), 2, 8, 8, context=4, root=3, last=False, backward_weights=False
    ... )
    >>> layer.relations().shape  # two kinds of messages, from node (16) to node (16)
    torch.Size([2, 16, 16])
    """

    def __init__(
        self,
        graph: PoseGraph,
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
        down = torch.from_numpy(graph.from_parent)
        self.register_buffer("from_parent_matrix", down.to(torch.get_default_dtype()), persistent=False)
        next_to_root = torch.zeros(len(graph.joints), dtype=torch.get_default_dtype())
        next_to_root[list(graph.next_to_root)] = 1
        self.register_buffer("next_to_root", next_to_root, persistent=False)

    from_parent_matrix: Tensor
    next_to_root: Tensor

    @property
    def bone_maps(self) -> list[nn.Linear]:
        """The maps along the bones: one for both directions, or parent to child and child to parent."""
        return [self.from_parent] if self.from_child is None else [self.from_parent, self.from_child]

    def relations(self) -> Tensor:
        """Give the matrices that carry the messages along the bones.

        Returns
        -------
        Tensor
            (1 + maps along bones, K, K): the identity, then one matrix for each of :attr:`bone_maps`.
        """
        down = self.from_parent_matrix
        own = torch.eye(len(down), dtype=down.dtype, device=down.device)
        return torch.stack([own, down + down.T] if self.from_child is None else [own, down, down.T])

    def evidence_messages(self, evidence: Evidence) -> Tensor:
        """Sum the messages of the observed keypoints and of the root.

        Parameters
        ----------
        evidence : Evidence
            Observed keypoints and root.

        Returns
        -------
        Tensor
            (K, P, 1, H), the same for every sample of a pose.
        """
        nodes, hidden = len(self.next_to_root), self.from_root.out_features
        root = torch.relu(self.from_root(evidence.root))
        messages = (self.next_to_root[:, None, None] * root).expand(nodes, evidence.poses, hidden)
        if len(evidence.rows):
            heard = torch.relu(self.from_context(evidence.context))
            messages = messages.reshape(-1, hidden).index_add(0, evidence.rows, heard)
        return messages.reshape(nodes, evidence.poses, 1, hidden)

    def next_evidence(self, evidence: Evidence) -> Evidence:
        """Carry context and root on to the next layer.

        Parameters
        ----------
        evidence : Evidence
            What this layer was told.

        Returns
        -------
        Evidence
            The same keypoints and root with ``hidden`` features each.
        """
        if self.next_context is None or self.next_root is None:
            return evidence
        return evidence._replace(
            context=torch.relu(self.next_context(evidence.context)), root=torch.relu(self.next_root(evidence.root))
        )
