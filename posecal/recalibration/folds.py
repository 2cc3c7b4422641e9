"""On which poses is a recalibration fitted, and on which is it judged? On disjoint sequences."""

from __future__ import annotations

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.pose_data import PoseData, Rows
from posecal.errors import PoseDataError

__all__ = ["at_least_two", "folds_of", "for_joints", "moving", "sequences"]


def folds_of(pairs: PoseData, folds: int = 5) -> Rows:
    """Give the part of each pose, (M,), cutting between sequences, the parts alike in poses.

    Poses without sequences are cut into runs of consecutive frames.

    Raises
    ------
    PoseDataError
        For fewer than two parts, or fewer sequences (or poses) than parts.
    """
    poses, sequence = len(pairs.truth), pairs.labels.get("sequence")
    names, place, sizes = np.unique(
        np.arange(poses) if sequence is None else sequence, return_inverse=True, return_counts=True
    )
    if not 2 <= folds <= len(names):
        units = "poses" if sequence is None else "sequences"
        raise PoseDataError(f"folds: {folds}; expected 2 to {len(names)}, the number of {units} of {pairs.names[1]}.")
    if sequence is None:
        return np.arange(poses) * folds // poses
    load = np.zeros(folds, dtype=np.intp)
    of_name = np.zeros(len(names), dtype=np.intp)
    for name in np.argsort(-sizes, kind="stable"):
        of_name[name] = load.argmin()
        load[of_name[name]] += sizes[name]
    return of_name[place]


def moving(pairs: PoseData) -> BoolArray:
    """Give the joints that are recalibrated, (K,): all but the root."""
    mask = np.ones(len(pairs.joints), dtype=bool)
    if pairs.root is not None:
        mask[pairs.root] = False
    return mask


def for_joints(names: tuple[str, ...], values: FloatArray, joints: tuple[str, ...], whose: str) -> FloatArray:
    """Give a map's values, which it has by name, in the order of some joints.

    Raises
    ------
    PoseDataError
        Where the map lacks one of them.
    """
    missing = [joint for joint in joints if joint not in names]
    if missing:
        raise PoseDataError(f"{whose} has joints that the map lacks: {', '.join(missing)}. Fit a map on these joints.")
    return values[[names.index(joint) for joint in joints]]


def sequences(pairs: PoseData) -> int:
    """Give the number of labelled sequences."""
    return len(np.unique(pairs.labels["sequence"])) if "sequence" in pairs.labels else 0


def at_least_two(pairs: PoseData) -> None:
    """Refuse one hypothesis, which has no spread.

    Raises
    ------
    PoseDataError
        For N = 1.
    """
    if pairs.shape[0] < 2:
        raise PoseDataError(f"{pairs.names[0]}: 1 hypothesis; recalibration needs at least 2.")
