"""Joint sets and skeletons: named joints and their parents.

The field numbers the same joints in different orders, so posecal joins by name and keeps no table of indices.
A *joint set* such as ``h36m-17`` is a tuple of names, with parents and a root. Those of persons are on one tree, and
the bones of any named selection follow from it: a joint's parent is its nearest ancestor that is present.
:mod:`posecal.data.joint_names` tells which names mean the same joint.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files

import numpy as np
import numpy.typing as npt

from posecal.data.joint_names import joint_keys, side_of
from posecal.errors import PoseDataError, did_you_mean

# name: (parent, rest position in mm; x to the person's left, y backwards, z up, the hip at the origin)
_TREE: dict[str, tuple[str | None, tuple[float, float, float]]] = {
    "Hip": (None, (0, 0, 0)),
    "RHip": ("Hip", (-130, 0, 0)),
    "RKnee": ("RHip", (-140, -20, -450)),
    "RFoot": ("RKnee", (-150, 20, -900)),
    "LHip": ("Hip", (130, 0, 0)),
    "LKnee": ("LHip", (140, -20, -450)),
    "LFoot": ("LKnee", (150, 20, -900)),
    "Spine": ("Hip", (0, 10, 240)),
    "Thorax": ("Spine", (0, 0, 490)),
    "UpperNeck": ("Thorax", (0, -10, 590)),
    "Neck/Nose": ("UpperNeck", (0, -60, 600)),
    "Head": ("Neck/Nose", (0, -20, 710)),
    "LShoulder": ("Thorax", (150, 0, 460)),
    "LElbow": ("LShoulder", (260, 30, 210)),
    "LWrist": ("LElbow", (330, -60, -20)),
    "RShoulder": ("Thorax", (-150, 0, 460)),
    "RElbow": ("RShoulder", (-260, 30, 210)),
    "RWrist": ("RElbow", (-330, -60, -20)),
}

REST_POSE: dict[str, tuple[float, float, float]] = {name: rest for name, (_, rest) in _TREE.items()}
"""A standing person in round millimetres: x to the person's left, y backwards, z up, hip at the origin."""


@dataclass(frozen=True)
class JointSet:
    """The joints of a data set.

    Attributes
    ----------
    names : tuple of str
        K names, in the data set's order.
    root : str
        The joint that poses are relative to, a midpoint (``LHip+RHip``), or one for each part, with commas.
    source : str
        Who defined it.
    parents : tuple of int
        The number of each joint's parent, -1 where it has none; empty where the joints are on the human tree.
    rest : tuple of pairs of float
        Where a picture puts the joints of what is no person, across and up; else empty.
    """

    names: tuple[str, ...]
    root: str
    source: str
    parents: tuple[int, ...] = ()
    rest: tuple[tuple[float, float], ...] = ()


_TABLE = tomllib.loads(files(__package__).joinpath("joint_sets.toml").read_text(encoding="utf-8"))

JOINT_SET_TABLE: dict[str, JointSet] = {
    name: JointSet(
        tuple(entry["names"]),
        entry["root"],
        entry["source"],
        tuple(entry.get("parents", ())),
        tuple(map(tuple, entry.get("rest", ()))),
    )
    for name, entry in _TABLE.items()
}
"""Joint sets by name, with parents, roots and sources; they stand in ``joint_sets.toml``."""

JOINT_SETS: dict[str, tuple[str, ...]] = {name: entry.names for name, entry in JOINT_SET_TABLE.items()}
"""Joint sets by name, each in its data set's own order."""


ALL_NAMES = tuple(dict.fromkeys(name for names in JOINT_SETS.values() for name in names))
"""The names of all joint sets."""


@cache
def known_set(joints: tuple[str, ...]) -> JointSet | None:
    """Give the smallest joint set that has all these joints, in any order and spelling; None where none has."""
    keys = set(joint_keys(joints))
    fitting = [entry for entry in JOINT_SET_TABLE.values() if keys <= set(joint_keys(entry.names))]
    return min(fitting, key=lambda entry: len(entry.names), default=None)


def joint_set(name: str) -> tuple[str, ...]:
    """Give the joints of a named set, in its data set's order.

    Parameters
    ----------
    name : str
        A key of :data:`JOINT_SETS`.

    Returns
    -------
    tuple of str
        The joints' names.

    Raises
    ------
    PoseDataError
        Where no set has this name.

    Notes
    -----
    Differs from the published code: none.

    Examples
    --------
    >>> len(joint_set("h36m-16"))
    16
    """
    if name not in JOINT_SETS:
        raise PoseDataError(f"joint set: {name!r} is not known. {did_you_mean(name, JOINT_SETS)}")
    return JOINT_SETS[name]


@dataclass(frozen=True)
class Skeleton:
    """The bones between a selection of named joints.

    Attributes
    ----------
    joints : tuple of str
        K names, in the order of the poses' joint axis. Names that posecal does not know have no bones.
    own_parents : tuple of int
        The number of each joint's parent, where the user gives them.

    Examples
    --------
    >>> arm = Skeleton(("Thorax", "LElbow", "LWrist"))
    >>> arm.parents
    (-1, 0, 1)
    >>> arm.root is None
    True
    """

    joints: tuple[str, ...]
    own_parents: tuple[int, ...] = ()

    @cached_property
    def _tree(self) -> Mapping[str, str | None]:
        """The parent of each joint by their keys: of a data set that has all these joints, or of a person."""
        found = None if set(joint_keys(self.joints)) <= _TREE.keys() else known_set(self.joints)
        if found is None or not found.parents:
            return {name: parent for name, (parent, _) in _TREE.items()}
        keys = joint_keys(found.names)
        return {key: keys[p] if p >= 0 else None for key, p in zip(keys, found.parents, strict=True)}

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """The index of each joint's nearest ancestor that is present, -1 where none is."""
        if self.own_parents:
            return self.own_parents
        keys, tree = joint_keys(self.joints), self._tree
        index = {key: k for k, key in enumerate(keys)}

        def parent(key: str) -> int:
            ancestor = tree.get(key)
            while ancestor is not None and ancestor not in index:
                ancestor = tree[ancestor]
            return -1 if ancestor is None else index[ancestor]

        return tuple(map(parent, keys))

    @property
    def bones(self) -> tuple[tuple[int, int], ...]:
        """Pairs (parent, child) of joint indices."""
        return tuple((parent, child) for child, parent in enumerate(self.parents) if parent >= 0)

    @property
    def root(self) -> int | None:
        """The index of the hip, the origin of root-relative poses; None where it is not among the joints."""
        return next((k for k, key in enumerate(joint_keys(self.joints)) if key == "Hip"), None)

    @property
    def is_known(self) -> bool:
        """Whether every joint is on the human tree."""
        return set(joint_keys(self.joints)) <= _TREE.keys()

    @property
    def rest_pose(self) -> npt.NDArray[np.float64]:
        """A standing person, (K, 3) in mm, for pictures and toy worlds.

        Raises
        ------
        PoseDataError
            Where a joint is not on the human tree.
        """
        keys = joint_keys(self.joints)
        unknown = [name for name, key in zip(self.joints, keys, strict=True) if key not in _TREE]
        if unknown:
            raise PoseDataError(f"joints: {', '.join(unknown)} not known; expected names such as RFoot.")
        return np.array([REST_POSE[key] for key in keys])

    @property
    def side(self) -> tuple[str, ...]:
        """``left``, ``right`` or ``middle`` for each joint."""
        return tuple(map(side_of, self.joints))
