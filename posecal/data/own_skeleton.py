"""Skeletons of the user's own: parents of joints in a file of poses, or names, parents and root in a small file."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from posecal.data.joint_names import match_joints, repeated_names
from posecal.data.skeleton import JOINT_SET_TABLE, Skeleton
from posecal.errors import PoseDataError, PoseFileError, did_you_mean, first_few, refuse_unreadable

Names = tuple[str, ...]


@dataclass(frozen=True)
class OwnSkeleton:
    """Names of joints, their parents (-1 for none), and the root as options take it, None where it follows."""

    names: Names
    parents: tuple[int, ...]
    root: str | None = None

    def of(self, joints: Names) -> OwnSkeleton:
        """Give the skeleton of some of the joints, in their order.

        Raises
        ------
        PoseDataError
            For joints that it lacks.
        """
        matched, ambiguous = match_joints(joints, self.names)
        lacking = [name for k, name in enumerate(joints) if k not in matched]
        if lacking or ambiguous:
            raise PoseDataError(
                f"skeleton: lacks {len(lacking)} of the poses' joints ({first_few(ambiguous or lacking)}); expected "
                "each of them, by name."
            )
        return OwnSkeleton(joints, parents_among(self.parents, [matched[k] for k in range(len(joints))]), self.root)


def as_skeleton(source: object) -> OwnSkeleton:
    """Read a skeleton from a small file, a mapping, or the name of a joint set.

    Parameters
    ----------
    source : path, str, mapping or Skeleton
        A ``.json`` or ``.toml`` file, or a mapping, with ``names``, ``parents`` (a number or a name for each joint, -1
        or an empty name for none) and perhaps ``root``; or the name of a joint set, such as ``mano-21``.

    Returns
    -------
    OwnSkeleton
        Checked.

    Raises
    ------
    PoseDataError
        For members that are missing or don't fit, parents that are no joints, and parents in a circle.
    PoseFileError
        For a file that can't be read.
    """
    if isinstance(source, OwnSkeleton):
        return source
    if isinstance(source, str) and source in JOINT_SET_TABLE:
        entry = JOINT_SET_TABLE[source]
        return OwnSkeleton(entry.names, Skeleton(entry.names).parents, entry.root)
    if not isinstance(source, str | os.PathLike):
        return _of_members(source, "skeleton")
    path = Path(source)
    if not path.exists():
        sets = ", ".join(JOINT_SET_TABLE)
        raise PoseFileError(f"{path}: no such file; expected a skeleton, .json or .toml, or one of {sets}.")
    with refuse_unreadable(path, "neither JSON nor TOML; expected names, parents and perhaps root."):
        text = path.read_text(encoding="utf-8")
        return _of_members(tomllib.loads(text) if path.suffix == ".toml" else json.loads(text), path.name)


def _of_members(members: object, name: str) -> OwnSkeleton:
    if not isinstance(members, Mapping):
        raise PoseDataError(f"{name}: {type(members).__name__}; expected names, parents and perhaps root.")
    if unknown := sorted({*map(str, members)} - {"names", "parents", "root"}):
        raise PoseDataError(
            f"{name}: {unknown[0]!r} is not known. {did_you_mean(unknown[0], ('names', 'parents', 'root'))}"
        )
    names, parents, root = members.get("names"), members.get("parents"), members.get("root")
    if not isinstance(names, Sequence) or isinstance(names, str) or not all(isinstance(word, str) for word in names):
        raise PoseDataError(f"{name}: names {names!r}; expected a list of K names.")
    if repeated := repeated_names(tuple(names)):
        raise PoseDataError(f"{name} names joints more than once: {first_few(repeated)}.")
    if not isinstance(root, str | None):
        raise PoseDataError(f"{name}: root {root!r}; expected a name, such as {names[0]}.")
    return OwnSkeleton(tuple(names), checked_parents(parents, name, tuple(names)), root)


def checked_parents(parents: object, name: str, names: Names) -> tuple[int, ...]:
    """Check the parents of joints.

    Parameters
    ----------
    parents : sequence of int or str
        The number or name of each joint's parent; -1 or an empty name for none.
    name : str
        What messages call where they stand.
    names : tuple of str
        K joints.

    Returns
    -------
    tuple of int
        Numbers.

    Raises
    ------
    PoseDataError
        For another number of parents, parents that are no joints, and parents in a circle.
    """
    if not isinstance(parents, Sequence) or isinstance(parents, str) or len(parents) != len(names):
        what = f"{len(parents)} parents" if isinstance(parents, Sequence) else f"parents {parents!r}"
        raise PoseDataError(f"{name}: {what} for K = {len(names)} joints; expected one each, -1 for a root.")
    place = {"": -1, **{joint: k for k, joint in enumerate(names)}}
    found: list[int] = []
    for joint, parent in zip(names, parents, strict=True):
        number = place.get(parent, -2) if isinstance(parent, str) else parent
        if not isinstance(number, int) or isinstance(number, bool) or not -1 <= number < len(names):
            raise PoseDataError(
                f"{name}: parent {parent!r} of {joint}; expected a name, or -1 to {len(names) - 1}: -1 for a root."
            )
        found.append(number)
    leads = [parent < 0 for parent in found]
    for start in range(len(names)):
        walked = [start]
        while not leads[walked[-1]] and found[walked[-1]] not in walked:
            walked.append(found[walked[-1]])
        if not leads[walked[-1]]:
            first = walked.index(found[walked[-1]])
            circle = " → ".join(names[k] for k in (*walked[first:], walked[first]))
            raise PoseDataError(f"{name}: parents in a circle ({circle}); expected each joint to lead to a root.")
        for k in walked:
            leads[k] = True
    return tuple(found)


def parents_among(parents: Sequence[int], chosen: Sequence[int]) -> tuple[int, ...]:
    """Give the nearest ancestors of chosen joints that are chosen too, numbered as they are; -1 where none is.

    Examples
    --------
    >>> parents_among((-1, 0, 1, 2), (3, 0, 1))
    (2, -1, 1)
    """
    place = {int(joint): k for k, joint in enumerate(chosen)}
    nearest = []
    for joint in chosen:
        ancestor = parents[joint]
        while ancestor >= 0 and ancestor not in place:
            ancestor = parents[ancestor]
        nearest.append(place.get(ancestor, -1))
    return tuple(nearest)
