"""Kinematic tree of a pose as a graph: edges between joints as index lists and matrices.

A pose that is relative to its root has no uncertainty at the root, so the root is no node: it is a neighbour of the
nodes whose parent it is. Nodes are the remaining joints, in the order of the poses' joint axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

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
    >>> chain.from_parent
    array([[0., 0., 0.],
           [1., 0., 0.],
           [0., 1., 0.]])
    >>> chain.spans  # all but the third have a child, all but the first a parent
    ((0, 2), (1, 3))
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

    @cached_property
    def order(self) -> tuple[int, ...]:
        """The nodes, those whose parent is the root first and those that have a parent and no children last.

        In this order the nodes with children are contiguous, and so are the nodes with a parent.
        """
        return tuple(sorted(range(len(self.joints)), key=lambda node: (self.parents[node] >= 0, self._is_leaf(node))))

    @property
    def spans(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Ranges of :attr:`order` with the nodes that have children, and with those that have a parent."""
        leaves = sum(map(self._is_leaf, range(len(self.joints))))
        return (0, len(self.joints) - leaves), (len(self.next_to_root), len(self.joints))

    def _is_leaf(self, node: int) -> bool:
        return self.parents[node] >= 0 and node not in self.parents

    @cached_property
    def from_parent(self) -> npt.NDArray[np.float64]:
        """The (K, K) matrix that maps the values of parents to their children."""
        matrix = np.zeros((len(self.joints), len(self.joints)))
        for parent, child in self.bones:
            matrix[child, parent] = 1
        return matrix


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
