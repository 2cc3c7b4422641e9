"""Folds of whole sequences, on which recalibrations are fitted and judged."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, as_array
from posecal.data.pose_data import PoseData
from posecal.data.stored_poses import Rows
from posecal.errors import PoseDataError


def folds_of(data: PoseData, folds: int = 5) -> Rows:
    """Give the part of each pose, (M,), cutting between sequences, the parts alike in poses.

    Poses without sequences are cut into runs of consecutive frames.

    Raises
    ------
    PoseDataError
        For fewer than two parts, or fewer sequences (or poses) than parts.
    """
    poses, sequence = len(data.truth), data.labels.get("sequence")
    names, place, sizes = np.unique(
        np.arange(poses) if sequence is None else sequence, return_inverse=True, return_counts=True
    )
    if not 2 <= folds <= len(names):
        units = "poses" if sequence is None else "sequences"
        raise PoseDataError(f"folds: {folds}; expected 2 to {len(names)}, the number of {units} of {data.names[1]}.")
    if sequence is None:
        return np.arange(poses) * folds // poses
    load = np.zeros(folds, dtype=np.intp)
    of_name = np.zeros(len(names), dtype=np.intp)
    for name in np.argsort(-sizes, kind="stable"):
        of_name[name] = load.argmin()
        load[of_name[name]] += sizes[name]
    return of_name[place]


def movable_joints(data: PoseData) -> BoolArray:
    """Give the joints that are recalibrated, (K,): all but the root."""
    mask = np.ones(len(data.joints), dtype=bool)
    if data.root is not None:
        mask[data.root] = False
    return mask


def values_for_joints(names: tuple[str, ...], values: FloatArray, joints: tuple[str, ...], whose: str) -> FloatArray:
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


def number_of_sequences(data: PoseData) -> int:
    """Give the number of labelled sequences."""
    return len(np.unique(data.labels["sequence"])) if "sequence" in data.labels else 0


def refuse_one_hypothesis(data: PoseData) -> None:
    """Refuse one hypothesis, which has no spread.

    Raises
    ------
    PoseDataError
        For N = 1.
    """
    if data.shape[0] < 2:
        raise PoseDataError(f"{data.names[0]}: 1 hypothesis; recalibration needs at least 2.")


def checked_for_map(hypotheses: npt.ArrayLike, joints: tuple[str, ...]) -> FloatArray:
    """Check hypotheses (N, M, K, D) that a map with K joints is applied to.

    Raises
    ------
    PoseDataError
        For another number of joints, and arrays of another shape or type.
    """
    x = as_array(hypotheses, "hypotheses")
    if x.ndim != 4 or x.shape[2] != len(joints) or x.dtype.kind not in "fiu":
        raise PoseDataError(
            f"hypotheses: {x.dtype} {x.shape}; expected (N, M, K, D) with the K = {len(joints)} joints of the map."
        )
    return x if x.dtype.kind == "f" else x.astype(np.float64)
