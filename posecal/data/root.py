"""Roots: what is subtracted from every pose, a joint, the midpoint of several, or one of these for each part."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import find_joint, joint_keys, side_of
from posecal.data.skeleton import Skeleton, known_set
from posecal.errors import PoseDataError, did_you_mean, first_few, option

Names = tuple[str, ...]

NEAR = 0.3
"""Poses whose hips' midpoint lies nearer to the origin, in parts of their size, are about it already."""


@dataclass(frozen=True)
class Root:
    """A root that is no single joint.

    Attributes
    ----------
    parts : tuple of tuples of int
        The joints of each part's root; several joints stand for their midpoint.
    members : tuple of int
        The part of each of K joints; empty where there is one part.
    """

    parts: tuple[tuple[int, ...], ...]
    members: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(map(tuple, self.parts)))  # lists, as JSON has them
        object.__setattr__(self, "members", tuple(self.members))


AnyRoot = int | Root | None
"""One joint's number, a :class:`Root`, or None for positions as they are."""


def origin(poses: FloatArray, root: int | Root, axis: int = -2) -> FloatArray:
    """Give the root of poses, as an array to subtract from them.

    Parameters
    ----------
    poses : array (..., K, D)
        Poses; K is along ``axis``.
    root : int or Root
        The root.
    axis : int
        The axis of joints.

    Returns
    -------
    array (..., 1, D) or (..., K, D)
        The position of the root: of all joints, or of each joint's part.

    Examples
    --------
    >>> poses = np.array([[[0.0], [2.0], [9.0]]])
    >>> origin(poses, Root(((0, 1),))).tolist(), origin(poses, Root(((0,), (2,)), (0, 0, 1))).ravel().tolist()
    ([[[1.0]]], [0.0, 0.0, 9.0])
    """
    if not isinstance(root, Root):
        return np.take(poses, [root], axis=axis)
    centres = [np.take(poses, part, axis=axis).mean(axis=axis, keepdims=True) for part in root.parts]
    if len(centres) == 1:
        return np.asarray(centres[0])
    return np.take(np.concatenate(centres, axis=axis), root.members, axis=axis)


def root_joints(root: AnyRoot) -> list[int]:
    """Give the numbers of all joints that a root is made of."""
    if root is None:
        return []
    return [joint for part in root.parts for joint in part] if isinstance(root, Root) else [root]


def resting_joints(root: AnyRoot) -> list[int]:
    """Give the numbers of the joints that are 0 in every pose relative to the root: not those of midpoints."""
    return [part[0] for part in root.parts if len(part) == 1] if isinstance(root, Root) else root_joints(root)


def root_name(root: AnyRoot, names: Sequence[str]) -> str:
    """Write a root as options take it: ``Hip``, ``LHip+RHip``, ``RWrist,LWrist`` or ``none``."""
    if root is None:
        return "none"
    parts = root.parts if isinstance(root, Root) else ((root,),)
    return ",".join("+".join(names[joint] for joint in part) for part in parts)


def part_of_root(root: AnyRoot, columns: Sequence[int]) -> AnyRoot:
    """Give the root of some of the joints, by their numbers; None where they lack a joint that it is made of."""
    place = {int(column): k for k, column in enumerate(columns)}
    if root is None or not place.keys() >= {*root_joints(root)}:
        return None
    if not isinstance(root, Root):
        return place[root]
    members = tuple(root.members[column] for column in columns) if root.members else ()
    return Root(tuple(tuple(place[joint] for joint in part) for part in root.parts), members)


def parse_root(declared: str | int, names: Names, parents: Sequence[int] = ()) -> AnyRoot:
    """Read a root as options write it.

    Parameters
    ----------
    declared : str or int
        A joint by name or number, a midpoint (``LHip+RHip``), one of these for each part (``RWrist,LWrist``), or
        ``none``.
    names : tuple of str
        K joints.
    parents : sequence of int, optional
        The parent of each joint, which tell the parts apart; those of the names by default.

    Returns
    -------
    int, Root or None
        With several parts each joint belongs to that of its nearest ancestor among the roots, or, where it has none,
        to that of the roots which is on its side (left or right, by name).

    Raises
    ------
    PoseDataError
        For joints that are not there or repeat, and joints that belong to no part.
    """
    text = str(declared)
    if text == "none":
        return None
    index = find_joint(text, names)
    if index is not None:
        return index
    parts = tuple(tuple(_joint(word.strip(), declared, names) for word in part.split("+")) for part in text.split(","))
    joints = [joint for part in parts for joint in part]
    if len(set(joints)) < len(joints):
        raise PoseDataError(f"{option('root_joint')}: {text!r} names a joint more than once; expected each once.")
    if len(parts) == 1:
        return Root(parts) if len(joints) > 1 else joints[0]
    return Root(parts, _members(parts, text, names, parents or Skeleton(names).parents))


def _joint(word: str, declared: str | int, names: Names) -> int:
    index = find_joint(word, names)
    if index is None:
        shown = declared if word == str(declared) else f"{declared}: {word}"
        raise PoseDataError(f"{option('root_joint')}: {shown!r} is not among the joints. {did_you_mean(word, names)}")
    return index


def _members(parts: tuple[tuple[int, ...], ...], text: str, names: Names, parents: Sequence[int]) -> tuple[int, ...]:
    """Give the part of each joint."""
    own = {joint: number for number, part in enumerate(parts) for joint in part}
    sides = [{side_of(names[joint]) for joint in part} for part in parts]
    members, without = [], []
    for joint, name in enumerate(names):
        ancestor = joint
        while ancestor >= 0 and ancestor not in own:
            ancestor = parents[ancestor]
        beside = [number for number, side in enumerate(sides) if side == {side_of(name)}]
        if ancestor < 0 and len(beside) != 1:
            without.append(name)
        members.append(own[ancestor] if ancestor >= 0 else beside[0] if beside else 0)
    if without:
        raise PoseDataError(
            f"{option('root_joint')}: {text!r} leaves {len(without)} joints without a root ({first_few(without)}); "
            "expected each joint below one of the roots, or on the side of one by its name."
        )
    return tuple(members)


def choose_root(
    declared: str | int | None,
    names: Names,
    truth: FloatArray,
    parents: Sequence[int] = (),
    own: str | None = None,
) -> tuple[AnyRoot, str]:
    """Choose the root: as declared, or as the joints have it.

    Parameters
    ----------
    declared : str, int or None
        What the user declares.
    names : tuple of str
        K joints.
    truth : array (M, K, D)
        True poses.
    parents : sequence of int, optional
        The user's own skeleton.
    own : str, optional
        Its root.

    Returns
    -------
    root : int, Root or None
        By default that of the user's own skeleton; the hip; the one joint whose truth is 0 throughout; the root of the
        joint set; or the midpoint of the hips, unless the truth is about it already.
    remark : str
        What was taken, where that is not plain; else empty.

    Raises
    ------
    PoseDataError
        For a joint that is not there.
    """
    which = option("root_joint")
    if declared is not None:
        return parse_root(declared, names, parents), ""
    if own is not None:
        return parse_root(own, names, parents), ""
    keys = joint_keys(names)
    if not parents and "Hip" in keys:
        return keys.index("Hip"), ""
    resting = np.flatnonzero(~truth.any(axis=(0, 2)))
    if len(resting) == 1 and len(names) > 1:
        return int(resting[0]), ""
    roots = [k for k, parent in enumerate(parents) if parent < 0]
    if parents and {*roots} <= {*parents}:  # each has joints below it
        return parse_root(",".join(map(str, roots)), names, parents), ""
    if "Hip" in keys:
        return keys.index("Hip"), ""
    found = known_set(names)
    text = found.root if found is not None and len(found.names) == len(names) else "LHip+RHip"
    if "+" in text:
        text = "LHip+RHip"
    try:
        is_there = all(find_joint(name, names) is not None for name in re.split("[+,]", text))
        root = parse_root(text, names) if is_there else None
    except PoseDataError:
        root = None
    if root is None or _is_about(truth, root):
        return None, f"no root joint is known, so positions are taken as they stand; {which} names one."
    shown = root_name(root, names)
    what = f"no pelvis is named, so poses are relative to the midpoint {shown}" if "+" in shown else ""
    what = what or f"poses are relative to {shown}, the root of the joint set"
    return root, f"{what}; {option('root_joint', 'none')} leaves positions as they stand."


def _is_about(truth: FloatArray, root: int | Root) -> bool:
    """Whether true poses lie about a midpoint already, as poses relative to a pelvis that is not among the joints."""
    if not isinstance(root, Root) or len(root.parts) > 1:
        return False
    with np.errstate(invalid="ignore", over="ignore"):  # joints that don't count may hold anything
        some = truth[:: max(1, len(truth) // 500)].astype(np.float64)
        middle = origin(some, root)
        size = np.sqrt(((some - middle) ** 2).sum(axis=-1))
        away = np.sqrt((middle**2).sum(axis=-1))
    away, size = away[np.isfinite(away)], size[np.isfinite(size)]
    return not away.size or not size.size or bool(np.median(away) < NEAR * np.median(size))
