"""Kinematic tree of a pose as a graph: edges between joints as index lists and a matrix.

A pose that is relative to its root has no uncertainty at the root, so the root is no node: it is a neighbour of the
nodes whose parent it is. Nodes are the remaining joints, in the order of the poses' joint axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from posecal.data.skeleton import Skeleton, joint_set
from posecal.errors import PoseDataError

__all__ = ["PoseGraph", "human36m_graph"]


@dataclass(frozen=True)
class PoseGraph:
    """The tree of K joints below a fixed root.

    Attributes
    ----------
    joints : tuple of str
        K names, the order of the poses' joint axis.
    parents : tuple of int
        The index of each joint's parent, -1 where the parent is the root.
    root : str
        The name of the fixed joint that poses are relative to.

    Examples
    --------
    >>> chain = PoseGraph(("first", "second", "third"), (-1, 0, 1))
    >>> chain.bones, chain.next_to_root
    (((0, 1), (1, 2)), (0,))
    >>> chain.aggregation(2)  # from each node its message to itself, and that to its neighbours
    tensor([[1., 0., 0., 1., 0., 0.],
            [0., 1., 1., 0., 0., 1.],
            [0., 0., 0., 1., 1., 0.]])
    """

    joints: tuple[str, ...]
    parents: tuple[int, ...]
    root: str = "Hip"

    def __post_init__(self) -> None:
        if len(self.joints) != len(self.parents):
            raise PoseDataError(
                f"graph: {len(self.joints)} joints and {len(self.parents)} parents; expected one parent per joint."
            )
        for child, parent in enumerate(self.parents):
            if not -1 <= parent < len(self.joints) or parent == child:
                raise PoseDataError(
                    f"graph: joint {child} has parent {parent}; "
                    f"expected another joint below {len(self.joints)}, or -1 for the root."
                )

    @classmethod
    def from_joints(cls, joints: tuple[str, ...], root: str = "Hip") -> PoseGraph:
        """Build the tree of named joints from the human skeleton.

        Parameters
        ----------
        joints : tuple of str
            K names that :mod:`posecal.data.skeleton` knows, without the root.
        root : str
            The joint that poses are relative to.

        Returns
        -------
        PoseGraph
            The tree of these joints.

        Raises
        ------
        PoseDataError
            Where a joint is unknown or is the root itself.

        Examples
        --------
        >>> PoseGraph.from_joints(("RHip", "RKnee", "RFoot")).parents
        (-1, 0, 1)
        """
        skeleton = Skeleton((root, *joints))
        if not skeleton.is_known:
            raise PoseDataError(f"joints: {', '.join(joints)} are not all in the human skeleton. Give their parents.")
        if root in joints:
            raise PoseDataError(f"joints: {root} is the root and no node of the graph. Leave it out.")
        return cls(joints, tuple(parent - 1 for parent in skeleton.parents[1:]), root)

    @property
    def bones(self) -> tuple[tuple[int, int], ...]:
        """Pairs (parent, child) of nodes."""
        return tuple((parent, child) for child, parent in enumerate(self.parents) if parent >= 0)

    @property
    def next_to_root(self) -> tuple[int, ...]:
        """The nodes whose parent is the root."""
        return tuple(child for child, parent in enumerate(self.parents) if parent < 0)

    def aggregation(self, maps: int) -> Tensor:
        """Build the matrix that sums the messages between nodes at those that receive them.

        Parameters
        ----------
        maps : int
            3: messages of a node to itself, from parent to child and from child to parent. 2: one map for both
            directions of an edge.

        Returns
        -------
        Tensor
            (K, K * maps): column ``u * maps + m`` holds 1 at the nodes that receive the message of node u by map m.
        """
        nodes = len(self.joints)
        from_parent = torch.zeros(nodes, nodes)
        for parent, child in self.bones:
            from_parent[child, parent] = 1
        edges = [from_parent, from_parent.T] if maps == 3 else [from_parent + from_parent.T]
        return torch.stack([torch.eye(nodes), *edges], dim=-1).flatten(1)


def human36m_graph() -> PoseGraph:
    """Return the graph of the paper: Human3.6M's 17 joints without the hip.

    Returns
    -------
    PoseGraph
        16 nodes, 13 bones, three neighbours of the root.

    Notes
    -----
    Differs from the published code: none.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4.

    Examples
    --------
    >>> graph = human36m_graph()
    >>> len(graph.joints), len(graph.bones), [graph.joints[k] for k in graph.next_to_root]
    (16, 13, ['RHip', 'LHip', 'Spine'])
    """
    return PoseGraph.from_joints(joint_set("h36m-16"))
