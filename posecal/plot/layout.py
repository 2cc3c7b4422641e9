"""Where a picture of a skeleton puts its joints, seen from the front, for persons, hands, animals and others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import joint_keys
from posecal.data.skeleton import REST_POSE, Skeleton, known_set

_FACE = {"leye": (70, 670), "reye": (-70, 670), "lear": (190, 640), "rear": (-190, 640), "nose": (0, 600)}
_FACE |= {"lmouth": (50, 550), "rmouth": (-50, 550)}
"""Where eyes, ears, nose and mouth stand on a person's face, broader than they are."""

TALL = 1600.0
"""The height of a picture, as that of a standing person in mm."""


def joint_places(skeleton: Skeleton) -> tuple[FloatArray, bool]:
    """Place the joints of a skeleton in a picture.

    Parameters
    ----------
    skeleton : Skeleton
        K joints.

    Returns
    -------
    places : array (K, 2)
        Across and up: a standing person, broad, so that no numbers overlap; the rest pose of the joint set; else the
        tree from its roots downwards, or rows of points where there is no tree.
    is_person : bool
        Whether they are those of a person.
    """
    keys, parents = joint_keys(skeleton.joints), skeleton.parents
    found = known_set(skeleton.joints)
    if found is not None and found.rest:
        rest = dict(zip(joint_keys(found.names), found.rest, strict=True))
        return _fitted(np.array([rest[key] for key in keys])), False
    placed = {k: np.array(REST_POSE[key])[[0, 2]] * [2.2, 1.0] for k, key in enumerate(keys) if key in REST_POSE}
    placed |= {k: np.array(_FACE[key], dtype=np.float64) for k, key in enumerate(keys) if key in _FACE}
    if 2 * len(placed) < len(keys):
        return _fitted(_tree(parents) if skeleton.bones else _rows(len(keys))), False
    _between(placed, parents)
    return np.array([placed[k] for k in range(len(keys))]), True


def free_sides(places: FloatArray) -> FloatArray:
    """Give the side, -1 or 1, on which each place (K, 2) has more room: away from its nearest neighbour in height."""
    away = places[None] - places[:, None]
    distance = np.hypot(away[..., 0], 3 * away[..., 1])
    np.fill_diagonal(distance, np.inf)
    nearest = np.take_along_axis(away[..., 0], distance.argmin(axis=1)[:, None], axis=1)[:, 0]
    return np.where(nearest == 0, np.where(places[:, 0] < 0, -1.0, 1.0), -np.sign(nearest))


def _between(placed: dict[int, FloatArray], parents: Sequence[int]) -> None:
    """Place the other joints: evenly between those that are placed, and beyond the last ones, spread out."""
    for start in [*placed]:
        chain, joint = [], parents[start]
        while joint >= 0 and joint not in placed:
            chain.append(joint)
            joint = parents[joint]
        for step, k in enumerate(chain, 1):
            if joint >= 0:
                placed[k] = placed[start] + (placed[joint] - placed[start]) * step / (len(chain) + 1)
    while len(placed) < len(parents):
        beyond = [k for k in range(len(parents)) if k not in placed and parents[k] in placed]
        if not beyond:  # without a parent that is placed: above all
            k = next(k for k in range(len(parents)) if k not in placed)
            placed[k] = np.array([0.0, max(place[1] for place in placed.values()) + 80])
            continue
        for k in beyond:
            siblings = [j for j in beyond if parents[j] == parents[k]]
            parent, before = placed[parents[k]], parents[parents[k]]
            away = parent - placed[before] if before in placed else np.array([0.0, 1.0])
            angle = 0.9 * (siblings.index(k) - (len(siblings) - 1) / 2)
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            placed[k] = parent + 120 * turn @ away / max(float(np.linalg.norm(away)), 1e-9)


def _tree(parents: Sequence[int]) -> FloatArray:
    """Place a tree: leaves side by side, parents above the middle of their children."""
    across = np.full(len(parents), np.nan)
    up = np.zeros(len(parents))
    leaves = 0

    def place(joint: int, depth: int) -> None:
        nonlocal leaves
        children = [k for k, parent in enumerate(parents) if parent == joint]
        for child in children:
            place(child, depth + 1)
        across[joint] = np.mean(across[children]) if children else leaves
        up[joint] = -depth
        leaves += not children

    for joint, parent in enumerate(parents):
        if parent < 0:
            place(joint, 0)
    return np.stack([across, up], axis=1)


def _rows(number: int) -> FloatArray:
    columns = int(np.ceil(np.sqrt(number)))
    k = np.arange(number)
    return np.stack([k % columns, -(k // columns)], axis=1).astype(np.float64)


def _fitted(places: FloatArray) -> FloatArray:
    """Make a picture as tall as a person, and as broad."""
    low, high = places.min(axis=0), places.max(axis=0)
    return np.asarray((places - (low + high) / 2) * np.where(high > low, TALL / np.maximum(high - low, 1e-9), 1.0))
