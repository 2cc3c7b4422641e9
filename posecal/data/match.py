"""Matching of hypotheses with the truth: frames by id, joints by name, labels that must agree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.declarations import Declarations, resolve, unit_factor
from posecal.data.layout import HYPOTHESES, Layout
from posecal.data.skeleton import Skeleton, canonical_name
from posecal.data.stored_poses import ArrayHypotheses, Labels, Rows, StoredPoses
from posecal.errors import PosecalError, PoseDataError, attempt, did_you_mean, first_few, option, raise_all

Problems = list[str | PosecalError]

# --- frames ---------------------------------------------------------------------------------------------------


def match_frames(
    hypotheses: StoredPoses,
    truth: StoredPoses,
    sizes: tuple[int, int],
    declarations: Declarations,
    hint: str,
    problems: Problems,
    remarks: list[str],
) -> tuple[Rows, Rows]:
    """Match frames by id, or by their order where one of the two has no ids.

    Parameters
    ----------
    hypotheses, truth : StoredPoses
        As stored or passed.
    sizes : tuple of int
        M of the two.
    declarations : Declarations
        What the user declares.
    hint : str
        A sentence on other layouts that would fit.
    problems, remarks : list
        What does not fit, and what is to be known, is added to them.

    Returns
    -------
    rows, true_rows : arrays of int
        The poses of the two that belong together, in the order of the truth.
    """
    before = len(problems)
    for poses, number in zip((hypotheses, truth), sizes, strict=True):
        if poses.frame_id is not None and len(poses.frame_id) != number:
            problem = f"{poses.name}: {len(poses.frame_id):,} frame_id for {number:,} poses; expected one each. {hint}"
            problems.append(problem.strip())
    if hypotheses.frame_id is None or truth.frame_id is None:
        if sizes[0] != sizes[1]:
            without = [poses.name for poses in (hypotheses, truth) if poses.frame_id is None]
            problems.append(
                f"{hypotheses.name} has M = {sizes[0]:,} poses and {truth.name} {sizes[1]:,}; expected as many. "
                f"{hint}Give both a frame_id to match them by ({' and '.join(without)} without)."
            )
        return np.arange(sizes[0]), np.arange(sizes[1])
    ids, true_ids = hypotheses.frame_id.tolist(), truth.frame_id.tolist()
    for poses, names in ((hypotheses, ids), (truth, true_ids)):
        repeated = [name for name, count in Counter(names).items() if count > 1]
        if repeated:
            problems.append(
                f"{poses.name} has {len(repeated):,} of {len(names):,} frame_id more than once "
                f"(first: {first_few(repeated)}). Give each frame once."
            )
    row = {name: number for number, name in enumerate(ids)}
    known = set(true_ids)
    shared = [number for number, name in enumerate(true_ids) if name in row]
    if not shared and len(problems) == before:
        problems.append(_nothing_shared(hypotheses, truth, "frame_id", ids, true_ids))
    for poses, other, names, number in (
        (hypotheses, truth, [name for name in true_ids if name not in row], len(true_ids)),
        (truth, hypotheses, [name for name in ids if name not in known], len(ids)),
    ):
        lacks = f"{poses.name} lacks {len(names):,} of the {number:,} frames of {other.name}"
        if names and declarations.missing == "skip":
            remarks.append(f"{lacks}: skipped.")
        elif names and shared:
            problems.append(f"{lacks} (first: {first_few(names)}). Pass {option('missing', 'skip')} to score the rest.")
    return np.array([row[true_ids[m]] for m in shared], dtype=np.intp), np.array(shared, dtype=np.intp)


def _nothing_shared(
    hypotheses: StoredPoses, truth: StoredPoses, what: str, names: Sequence[str], true_names: Sequence[str]
) -> str:
    return (
        f"{hypotheses.name} and {truth.name} have no {what} in common ({first_few(names)} against "
        f"{first_few(true_names)}); expected the same names."
    )


# --- joints ---------------------------------------------------------------------------------------------------


def joint_names(
    poses: StoredPoses, size: int, declarations: Declarations, problems: Problems
) -> tuple[str, ...] | None:
    """Give posecal's names of K joints, as stored or else as declared; None where there are none."""
    names = declarations.joint_names if poses.joints is None else poses.joints
    if names is None:
        return None
    if len(names) != size:
        of_set = poses.joints is None and isinstance(declarations.joints, str)
        what = f"{declarations.joints} has {len(names)} joints" if of_set else f"{len(names)} joints named"
        problems.append(f"{poses.name}: {what} for K = {size}; expected one name each.")
        return None
    names = tuple(canonical_name(name) for name in names)
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        problems.append(f"{poses.name} names joints more than once: {first_few(repeated)}.")
    return names


def numbered(size: int) -> tuple[str, ...]:
    """Name K joints by their numbers."""
    return tuple(f"joint {k}" for k in range(size))


def match_joints(
    hypotheses: StoredPoses,
    truth: StoredPoses,
    names: tuple[str, ...] | None,
    true_names: tuple[str, ...],
    size: int,
    declarations: Declarations,
    problems: Problems,
    remarks: list[str],
) -> tuple[Rows, Rows]:
    """Match joints by name, or by their order where the hypotheses' have none.

    Parameters
    ----------
    hypotheses, truth : StoredPoses
        As stored or passed.
    names, true_names : tuple of str
        Of their joints.
    size : int
        K of the hypotheses.
    declarations : Declarations
        What the user declares.
    problems, remarks : list
        What does not fit, and what is to be known, is added to them.

    Returns
    -------
    columns, true_columns : arrays of int
        The joints of the two that belong together, in the order of the truth.
    """
    if names is None:
        if size != len(true_names):
            problems.append(
                f"{hypotheses.name} has K = {size} joints and {truth.name} {len(true_names)}; expected as many, or "
                f"joints named in both and {option('shared_joints', 'common')}."
            )
        return np.arange(size), np.arange(size)
    lacking = [name for name in true_names if name not in names]
    beyond = [name for name in names if name not in true_names]
    shared = [k for k, name in enumerate(true_names) if name in names]
    for poses, missing in ((hypotheses, lacking), (truth, beyond)):
        if missing and shared and declarations.shared_joints == "same":
            problems.append(
                f"{poses.name} lacks {len(missing)} of the other's joints ({first_few(missing)}). "
                f"Pass {option('shared_joints', 'common')} to score the shared ones."
            )
    if not shared:
        problems.append(_nothing_shared(hypotheses, truth, "joint", names, true_names))
    elif (lacking or beyond) and declarations.shared_joints == "common":
        remarks.append(f"{len(shared)} joints are in both; left out: {first_few([*lacking, *beyond], 5)}.")
    return np.array([names.index(true_names[k]) for k in shared], dtype=np.intp), np.array(shared, dtype=np.intp)


def root_index(declared: str | int | None, names: tuple[str, ...], truth: FloatArray) -> int | None:
    """Give the joint to subtract: as declared, the hip, or the one unnamed joint whose truth is 0 throughout.

    Raises
    ------
    PoseDataError
        For a joint that is not there.
    """
    root = None if declared is None else str(declared)
    if root == "none":
        return None
    if root is not None:
        index = (
            int(root) if root.isdecimal() else next((k for k, n in enumerate(names) if n == canonical_name(root)), -1)
        )
        if not 0 <= index < len(names):
            raise PoseDataError(
                f"{option('root_joint')}: {declared!r} is not among the joints. {did_you_mean(root, names)}"
            )
        return index
    hip = Skeleton(names).root
    if hip is not None:
        return hip
    resting = np.flatnonzero(~truth.any(axis=(0, 2)))
    return int(resting[0]) if len(resting) == 1 and len(names) > 1 else None


# --- labels and marks -----------------------------------------------------------------------------------------


def labels_of(poses: StoredPoses, number: int, problems: Problems) -> Labels:
    """Give the labels that have a value for each of so many poses; all of those must that can only be labels."""
    labels = {name: values if values.ndim else np.full(number, values) for name, values in poses.labels.items()}
    problems += [
        f"{poses.name}: {name} has {len(values):,} values for {number:,} poses; expected one each."
        for name, values in labels.items()
        if len(values) != number and name in poses.required_labels
    ]
    return {name: values for name, values in labels.items() if len(values) == number}


def occluded_of(poses: StoredPoses, shape: tuple[int, ...], problems: Problems) -> BoolArray | None:
    """Give the joints, (M, K), that are marked as occluded, or not as visible; None without marks."""
    if len(poses.marks) > 1:
        problems.append(f"{poses.name} has both occluded and visible; expected one of them.")
    for name, marks in poses.marks.items():
        if marks.shape != shape:
            problems.append(f"{poses.name}: {name} {marks.shape}; expected (M, K) = {shape}.")
            return None
        return ~marks if name == "visible" else marks
    return None


def match_labels(hypotheses: StoredPoses, truth: StoredPoses, labels: Labels, true_labels: Labels) -> Labels:
    """Put the labels of matched frames together.

    Raises
    ------
    PoseDataError
        Where the two differ.
    """
    differing = {
        name: int((labels[name] != values).sum())
        for name, values in true_labels.items()
        if name in labels and not np.array_equal(labels[name], values)
    }
    raise_all(
        f"{hypotheses.name} and {truth.name} differ in {name} of {number:,} of {len(labels[name]):,} frames. "
        "Are they in the same order? A frame_id of both matches them."
        for name, number in differing.items()
    )
    return {**true_labels, **{name: values for name, values in labels.items() if name not in true_labels}}


# --- hypotheses without a truth -------------------------------------------------------------------------------


def resolve_hypotheses(
    poses: StoredPoses, declarations: Declarations | None = None
) -> tuple[ArrayHypotheses, tuple[str, ...], int | None]:
    """Read hypotheses without a truth.

    Parameters
    ----------
    poses : StoredPoses
        Hypotheses, as stored or passed; undeclared they are (N, M, K, D) in mm.
    declarations : Declarations, optional
        What the user declares about them.

    Returns
    -------
    hypotheses : ArrayHypotheses
        Read some poses at a time.
    joints : tuple of str
        Their joints, numbered where they have no names.
    root : int or None
        The joint that positions are relative to.

    Raises
    ------
    PoseDataError
        For a layout, a unit or names that don't fit.
    """
    declared = declarations or Declarations()
    layout = Layout(resolve(poses, "axes", poses.axes, declared.axes) or HYPOTHESES, HYPOTHESES)
    n, m, k, _ = layout.shape(poses.array.shape)
    problems: Problems = []
    if 0 in poses.array.shape:
        problems.append(f"{poses.name}: nothing in it; its shape is {poses.array.shape}.")
    factor = attempt(problems, unit_factor, poses, "unit", declared.unit) or 1.0
    joints = joint_names(poses, k, declared, problems) or numbered(k)
    raise_all(problems)
    hypotheses = ArrayHypotheses(poses.array, layout, np.arange(m), np.arange(k), factor, n)
    return hypotheses, joints, root_index(declared.root_joint, joints, hypotheses.read(0, 1)[0])
