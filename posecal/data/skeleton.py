"""Joint sets and skeletons: named joints on one human tree.

The field numbers the same joints in different orders, so posecal joins by name and keeps no table of indices.
There is one tree of joints; a *joint set* such as ``h36m-17`` is a tuple of names on it, and the bones of any
named selection follow from the tree: a joint's parent is its nearest ancestor that is present.

Names are Human3.6M's. Other spellings (``right_ankle``, ``RAnkle``, ``Pelvis``) mean the same joint; joints that
only lie near each other (MPII's upper neck, Human3.6M's neck/nose) stay different.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import numpy.typing as npt

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
    "Neck/Nose": ("Thorax", (0, -60, 600)),
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

_H36M_17 = (
    *("Hip", "RHip", "RKnee", "RFoot", "LHip", "LKnee", "LFoot", "Spine", "Thorax"),
    *("Neck/Nose", "Head", "LShoulder", "LElbow", "LWrist", "RShoulder", "RElbow", "RWrist"),
)

JOINT_SETS: dict[str, tuple[str, ...]] = {
    "h36m-17": _H36M_17,
    "h36m-16": _H36M_17[1:],
    "h36m-14": tuple(name for name in _H36M_17 if name not in {"Hip", "Spine", "Neck/Nose"}),
    "lsp-14": (
        *("RFoot", "RKnee", "RHip", "LHip", "LKnee", "LFoot", "RWrist", "RElbow", "RShoulder"),
        *("LShoulder", "LElbow", "LWrist", "Thorax", "Head"),
    ),
    "3dhp-14": (
        *("Head", "Thorax", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist"),
        *("RHip", "RKnee", "RFoot", "LHip", "LKnee", "LFoot"),
    ),
    "mpii-16": (
        *("RFoot", "RKnee", "RHip", "LHip", "LKnee", "LFoot", "Hip", "Thorax", "UpperNeck", "Head"),
        *("RWrist", "RElbow", "RShoulder", "LShoulder", "LElbow", "LWrist"),
    ),
}
"""Joint sets by name, each in its data set's own order."""

_SPELLINGS = {
    **{re.sub(r"[^a-z]", "", name.lower()): name for name in _TREE},
    **dict.fromkeys(("pelvis", "root", "hips", "midhip"), "Hip"),
    **dict.fromkeys(("neck",), "Thorax"),
    **dict.fromkeys(("nose", "necknose"), "Neck/Nose"),
    **dict.fromkeys(("headtop",), "Head"),
    **{f"{side}ankle": f"{side.upper()}Foot" for side in "lr"},
}


@cache
def canonical_name(name: str) -> str:
    """Give posecal's name for a joint, whatever its spelling; a name it doesn't know stays as it is.

    Parameters
    ----------
    name : str
        A joint's name, in any case, with any separators, sides written out or as a letter.

    Returns
    -------
    str
        The name in ``REST_POSE``, or ``name``.

    Notes
    -----
    Differs from the published code: none.

    Examples
    --------
    >>> canonical_name("right_ankle"), canonical_name("Pelvis"), canonical_name("antenna 3")
    ('RFoot', 'Hip', 'antenna 3')
    """
    letters = re.sub(r"[^a-z0-9]", "", name.lower())
    letters = re.sub(r"^(right|left)", lambda side: side[0][0], letters)
    letters = re.sub(r"^(.+)(right|left)$", lambda word: word[2][0] + word[1], letters)
    return _SPELLINGS.get(letters, name)


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

    Examples
    --------
    >>> arm = Skeleton(("Thorax", "LElbow", "LWrist"))
    >>> arm.parents
    (-1, 0, 1)
    >>> arm.root is None
    True
    """

    joints: tuple[str, ...]

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """The index of each joint's nearest ancestor that is present, -1 where none is."""
        index = {canonical_name(name): k for k, name in enumerate(self.joints)}

        def parent(name: str) -> int:
            ancestor = _TREE.get(canonical_name(name), (None, None))[0]
            while ancestor is not None and ancestor not in index:
                ancestor = _TREE[ancestor][0]
            return -1 if ancestor is None else index[ancestor]

        return tuple(parent(name) for name in self.joints)

    @property
    def bones(self) -> tuple[tuple[int, int], ...]:
        """Pairs (parent, child) of joint indices."""
        return tuple((parent, child) for child, parent in enumerate(self.parents) if parent >= 0)

    @property
    def root(self) -> int | None:
        """The index of the hip, the origin of root-relative poses; None where it is not among the joints."""
        return next((k for k, name in enumerate(self.joints) if canonical_name(name) == "Hip"), None)

    @property
    def is_known(self) -> bool:
        """Whether every joint is on the human tree."""
        return all(canonical_name(name) in _TREE for name in self.joints)

    @property
    def rest_pose(self) -> npt.NDArray[np.float64]:
        """A standing person, (K, 3) in mm, for pictures and toy worlds.

        Raises
        ------
        PoseDataError
            Where a joint is not on the human tree.
        """
        unknown = [name for name in self.joints if canonical_name(name) not in _TREE]
        if unknown:
            raise PoseDataError(f"joints: {', '.join(unknown)} not known; expected names such as {_H36M_17[3]}.")
        return np.array([REST_POSE[canonical_name(name)] for name in self.joints])

    @property
    def side(self) -> tuple[str, ...]:
        """``left``, ``right`` or ``middle`` for each joint."""
        sides = {"L": "left", "R": "right"}
        known = (canonical_name(name) for name in self.joints)
        return tuple(sides.get(name[0], "middle") if name in _TREE else "middle" for name in known)
