"""Do these numbers look like people in millimetres?"""

from __future__ import annotations

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.pose_data import PoseData
from posecal.data.skeleton import Skeleton
from posecal.errors import PoseDataError

__all__ = ["TINY", "check_units", "like_metres", "size_of"]

BONES = (50.0, 700.0)
"""A median bone length outside this range, in mm, is remarked on."""

TINY = 10.0
"""Poses of this size, in what should be mm, must be metres: a person's joints lie some 400 mm from their centre."""


def check_units(pairs: PoseData, declared: bool, true_declared: bool, *, each: bool) -> list[str]:
    """Look for wrong units.

    Parameters
    ----------
    pairs : PoseData
        What was joined.
    declared, true_declared : bool
        Whether the hypotheses' and the truth's units were said, by a file or by the user.
    each : bool
        Whether each was said on its own, not one for both.

    Returns
    -------
    list of str
        Remarks, where numbers may still be right.

    Raises
    ------
    PoseDataError
        Where an undeclared unit can't be millimetres, or the two are in different units.
    """
    n, m, _, _ = pairs.shape
    few = min(m, 8)
    size = size_of(pairs.truth)
    ours = size_of(pairs.hypotheses.read(0, few)[: min(n, 50)].reshape(-1, *pairs.truth.shape[1:]))
    name, true_name = pairs.names
    sides = (true_name, size, true_declared), (name, ours, declared)
    tiny = [(like_metres(of, length), said) for of, length, said in sides if 0 < length < TINY]
    undeclared = [words for words, said in tiny if not said]
    if undeclared:
        raise PoseDataError(
            " ".join(undeclared) + " Pass --unit m, or store unit in the files; --unit mm if it is right."
        )
    remarks = [f"{words} Is its unit right?" for words, _ in tiny]
    if size > 0 and ours > 0 and not 0.05 < ours / size < 20:
        differ = f"{name} and {true_name} differ in size by a factor of {max(ours / size, size / ours):,.0f}"
        if not each:
            raise PoseDataError(
                f"{differ}; expected one unit. Store unit in both, or pass --unit for the one and --truth-unit for the "
                "other."
            )
        remarks.append(f"{differ}. Are their units right?")
    return remarks or _bones(pairs)


def like_metres(name: str, size: float) -> str:
    """Say that poses of a size below :data:`TINY` must be in metres.

    Parameters
    ----------
    name : str
        Where they are from.
    size : float
        Of :func:`size_of`.

    Returns
    -------
    str
        A sentence.
    """
    return f"{name} looks like metres: joints lie {size:.2g} from the middle of the pose; expected some 400 (mm)."


def size_of(poses: FloatArray) -> float:
    """Measure how large poses are: the median of their joints' root mean square distance from their mean.

    Parameters
    ----------
    poses : array (M, K, D)
        In any unit; poses with joints that are not finite don't count.

    Returns
    -------
    float
        In that unit; 0 where no pose is finite.
    """
    some = poses[:: max(1, len(poses) // 500)].astype(np.float64)
    whole = some[np.isfinite(some).all(axis=(1, 2))]
    if not len(whole):
        return 0.0
    return float(np.median(np.sqrt(((whole - whole.mean(axis=1, keepdims=True)) ** 2).sum(axis=2).mean(axis=1))))


def _bones(pairs: PoseData) -> list[str]:
    bones = Skeleton(pairs.joints).bones
    if not bones:
        return []
    parents, children = np.array(bones).T
    some = pairs.truth[:: max(1, len(pairs.truth) // 500)].astype(np.float64)
    with np.errstate(invalid="ignore"):  # joints that don't count may hold anything
        lengths = np.linalg.norm(some[:, children] - some[:, parents], axis=-1)
    lengths = lengths[np.isfinite(lengths)]
    if not lengths.size or BONES[0] <= np.median(lengths) <= BONES[1]:
        return []
    return [
        f"the median bone of {pairs.names[1]} is {np.median(lengths):,.1f} mm long; expected {BONES[0]:g} to "
        f"{BONES[1]:g}. Is its unit right?"
    ]
