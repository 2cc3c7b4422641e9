"""Which hypotheses belong to which truth? Frames joined by id, joints by name, lengths in millimetres.

Everything that is wrong with the two is said at once.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.checks import check_units
from posecal.data.declarations import declared, layouts, unit_factor
from posecal.data.layout import HYPOTHESES, TRUTH, Layout, plausible_layouts
from posecal.data.pose_data import COMMON_LABELS, Labels, PoseData, Rows, Stored, StoredPoses, in_millimetres
from posecal.data.skeleton import Skeleton, canonical_name, joint_set
from posecal.data.units import millimetres_per
from posecal.errors import PoseDataError, did_you_mean, first_few, raise_all

__all__ = ["Declarations", "alone", "join"]


@dataclass(frozen=True)
class Declarations:
    """What the user says beside the data.

    Attributes
    ----------
    axes, truth_axes : str or None
        Layouts of arrays that don't declare theirs. The truth's is (M, K, D) by default, or follows from the
        hypotheses' where only that fits.
    unit, truth_unit : str or None
        Units of arrays that don't declare theirs; ``unit`` is for both unless ``truth_unit`` is given.
    joint_names : str or None
        A joint set that names unnamed joints.
    root_joint : str or None
        The joint to subtract: a name, an index, or ``none``. By default the hip, or the one unnamed joint whose
        truth is 0 throughout.
    missing : str
        ``error``, or ``skip`` to score the frames that both have.
    joints : str
        ``same``, or ``common`` to score the joints that both have.

    Raises
    ------
    PoseDataError
        For a layout, a unit or a joint set that can't be, whatever the data; all at once.
    """

    axes: str | None = None
    truth_axes: str | None = None
    unit: str | None = None
    truth_unit: str | None = None
    joint_names: str | None = None
    root_joint: str | None = None
    missing: Literal["error", "skip"] = "error"
    joints: Literal["same", "common"] = "same"

    def __post_init__(self) -> None:
        checks: tuple[tuple[str | None, Callable[[str], object]], ...] = (
            (self.axes, lambda text: Layout(text, HYPOTHESES)),
            (self.truth_axes, lambda text: Layout(text, TRUTH)),
            (self.unit, millimetres_per),
            (self.truth_unit, millimetres_per),
            (self.joint_names, joint_set),
        )
        problems = []
        for said, check in checks:
            try:
                if said is not None:
                    check(said)
            except PoseDataError as error:
                problems.append(str(error))
        raise_all(problems)


def join(hypotheses: StoredPoses, truth: StoredPoses, how: Declarations | None = None) -> PoseData:
    """Declarations hypotheses with the truth.

    Parameters
    ----------
    hypotheses, truth : Poses
        As stored or passed.
    how : Declarations, optional
        What the user says beside the data.

    Returns
    -------
    PoseData
        In the order of the truth's frames and joints.

    Raises
    ------
    PoseDataError
        For everything that does not fit, all at once.
    """
    how = how or Declarations()
    layout, true_layout = layouts(hypotheses, truth, how.axes, how.truth_axes)
    shape, true_shape = layout.shape(hypotheses.array.shape), true_layout.shape(truth.array.shape)
    problems = [
        f"{poses.name}: nothing in it; its shape is {poses.array.shape}."
        for poses in (hypotheses, truth)
        if 0 in poses.array.shape
    ]
    raise_all(problems)
    remarks: list[str] = []

    factor = unit_factor(hypotheses, "unit", how.unit, problems)
    true_factor = unit_factor(truth, "truth-unit", how.truth_unit or how.unit, problems)
    fitting = [text for text in plausible_layouts(hypotheses.array.shape, true_shape) if text != layout.text]
    hint = f"The shapes fit the axes {fitting[0]}. " if fitting else ""
    rows, true_rows = _join_frames(hypotheses, truth, (shape[1], true_shape[0]), how, hint, problems, remarks)
    names, true_names = _names(hypotheses, truth, (shape[2], true_shape[1]), how, problems)
    columns, true_columns = _join_joints(hypotheses, truth, names, true_names, shape[2], how, problems, remarks)
    if shape[3] != true_shape[2]:
        problems.append(f"{hypotheses.name} has D = {shape[3]} and {truth.name} {true_shape[2]}; expected as many.")
    raise_all(problems)

    y = in_millimetres(true_layout.read(truth.array, np.arange(true_shape[0])), true_factor)
    root = _root(how.root_joint, true_names, y)
    if root is not None and root not in true_columns:
        with np.errstate(invalid="ignore"):  # joints that don't count may hold anything
            y = y - y[:, root, None]
        remarks.append(f"{hypotheses.name} lacks the root {true_names[root]}; taken as relative to it.")
    occluded = _occluded(truth, true_rows, true_columns, true_shape[:2], problems)
    if occluded is None:
        occluded = _occluded(hypotheses, rows, columns, shape[1:3], problems)
    labels = _labels(hypotheses, truth, (shape[1], true_shape[0]), rows, true_rows, problems)
    clip = true_layout.clip_length(truth.array.shape) or layout.clip_length(hypotheses.array.shape)
    if clip and "sequence" not in labels:
        labels = {"sequence": (true_rows // clip).astype(str), **labels}
    scores = hypotheses.scores
    if scores is not None and scores.shape != shape[:2]:
        problems.append(f"{hypotheses.name}: scores {scores.shape}; expected (N, M) = {shape[:2]}.")
    fps = truth.fps if truth.fps is not None else hypotheses.fps
    if fps is not None and not 0 < fps < math.inf:
        problems.append(f"fps: {fps:g}; expected frames per second, above 0.")
    raise_all(problems)

    pairs = PoseData(
        hypotheses=Stored(hypotheses.array, layout, rows, columns, factor),
        truth=np.ascontiguousarray(y[true_rows][:, true_columns]),
        joints=tuple(true_names[k] for k in true_columns),
        root=None if root is None else next((k for k, at in enumerate(true_columns) if at == root), None),
        frame_id=true_rows.astype(str) if truth.frame_id is None else truth.frame_id[true_rows],
        place=true_rows,
        labels=labels,
        occluded=occluded,
        scores=None if scores is None else scores[:, rows],
        fps=fps,
        names=(hypotheses.name, truth.name),
    )
    said = (hypotheses.unit or how.unit) is not None, (truth.unit or how.truth_unit or how.unit) is not None
    each = (hypotheses.unit is not None and truth.unit is not None) or how.truth_unit is not None
    remarks += check_units(pairs, *said, each=each)
    if root is None and how.root_joint != "none":
        remarks.append("no root joint is known, so positions are taken as they stand; --root-joint names one.")
    return replace(pairs, remarks=tuple(remarks))


def alone(poses: StoredPoses, how: Declarations | None = None) -> tuple[Stored, tuple[str, ...], int | None]:
    """Read hypotheses without a truth.

    Parameters
    ----------
    poses : Poses
        Hypotheses, as stored or passed; undeclared they are (N, M, K, D) in mm.
    how : Declarations, optional
        What the user says beside the data.

    Returns
    -------
    stored : Stored
        The hypotheses.
    joints : tuple of str
        Their joints, numbered where they have no names.
    root : int or None
        The joint that positions are relative to.

    Raises
    ------
    PoseDataError
        For a layout, a unit or names that don't fit.
    """
    how = how or Declarations()
    layout = Layout(declared(poses, "axes", poses.axes, how.axes) or HYPOTHESES, HYPOTHESES)
    shape = layout.shape(poses.array.shape)
    problems = [f"{poses.name}: nothing in it; its shape is {poses.array.shape}."] if 0 in poses.array.shape else []
    factor = unit_factor(poses, "unit", how.unit, problems)
    _, joints = _names(poses, poses, (shape[2], shape[2]), how, problems)
    raise_all(dict.fromkeys(problems))
    stored = Stored(poses.array, layout, np.arange(shape[1]), np.arange(shape[2]), factor)
    return stored, joints, _root(how.root_joint, joints, stored.read(0, 1)[0])


# --- frames ---------------------------------------------------------------------------------------------------


def _join_frames(
    hypotheses: StoredPoses,
    truth: StoredPoses,
    sizes: tuple[int, int],
    how: Declarations,
    hint: str,
    problems: list[str],
    remarks: list[str],
) -> tuple[Rows, Rows]:
    """Give the rows of the two that belong together, in the order of the truth."""
    before = len(problems)
    for poses, number in zip((hypotheses, truth), sizes, strict=True):
        if poses.frame_id is not None and len(poses.frame_id) != number:
            said = f"{poses.name}: {len(poses.frame_id):,} frame_id for {number:,} poses; expected one each. {hint}"
            problems.append(said.strip())
    if hypotheses.frame_id is None or truth.frame_id is None:
        if sizes[0] != sizes[1]:
            without = [poses.name for poses in (hypotheses, truth) if poses.frame_id is None]
            problems.append(
                f"{hypotheses.name} has M = {sizes[0]:,} poses and {truth.name} {sizes[1]:,}; expected as many. "
                f"{hint}Store a frame_id in both to join them ({' and '.join(without)} without)."
            )
        return np.arange(sizes[0]), np.arange(sizes[1])
    ids, wanted = hypotheses.frame_id.tolist(), truth.frame_id.tolist()
    for poses, found in ((hypotheses, ids), (truth, wanted)):
        twice = [name for name, count in Counter(found).items() if count > 1]
        if twice:
            problems.append(
                f"{poses.name} has {len(twice):,} of {len(found):,} frame_id more than once "
                f"(first: {first_few(twice)}). Store each frame once."
            )
    row = {name: place for place, name in enumerate(ids)}
    asked = set(wanted)
    kept = [place for place, name in enumerate(wanted) if name in row]
    if not kept and len(problems) == before:
        problems.append(_nothing_shared(hypotheses, truth, "frame_id", ids, wanted))
    for poses, other, names, number in (
        (hypotheses, truth, [name for name in wanted if name not in row], len(wanted)),
        (truth, hypotheses, [name for name in ids if name not in asked], len(ids)),
    ):
        if names and how.missing == "skip":
            remarks.append(f"{poses.name} lacks {len(names):,} of the {number:,} frames of {other.name}: skipped.")
        elif names and kept:
            problems.append(
                f"{poses.name} lacks {len(names):,} of the {number:,} frames of {other.name} "
                f"(first: {first_few(names)}). Pass --missing skip to score the rest."
            )
    return np.array([row[wanted[place]] for place in kept], dtype=np.intp), np.array(kept, dtype=np.intp)


def _nothing_shared(
    hypotheses: StoredPoses, truth: StoredPoses, what: str, ours: Sequence[str], theirs: Sequence[str]
) -> str:
    return (
        f"{hypotheses.name} and {truth.name} have no {what} in common ({first_few(ours)} against "
        f"{first_few(theirs)}); expected the same names."
    )


# --- joints ---------------------------------------------------------------------------------------------------


def _names(
    hypotheses: StoredPoses, truth: StoredPoses, sizes: tuple[int, int], how: Declarations, problems: list[str]
) -> tuple[tuple[str, ...] | None, tuple[str, ...]]:
    """Give posecal's names of the joints of the two; numbers where the truth's have none."""
    found: list[tuple[str, ...] | None] = []
    for poses, size in zip((hypotheses, truth), sizes, strict=True):
        names = None if poses.joints is None else tuple(canonical_name(name) for name in poses.joints)
        if names is None and how.joint_names is not None:
            names = joint_set(how.joint_names)
        if names is not None and len(names) != size:
            what = (
                f"{len(names)} joints named"
                if poses.joints is not None
                else f"{how.joint_names} has {len(names)} joints"
            )
            problems.append(f"{poses.name}: {what} for K = {size}; expected one name each.")
            names = None
        twice = [name for name, count in Counter(names or ()).items() if count > 1]
        if twice:
            problems.append(f"{poses.name} names joints more than once: {first_few(twice)}.")
        found.append(names)
    ours, theirs = found
    if theirs is None and sizes[0] == sizes[1]:
        theirs = ours
    return ours, theirs or tuple(f"joint {k}" for k in range(sizes[1]))


def _join_joints(
    hypotheses: StoredPoses,
    truth: StoredPoses,
    names: tuple[str, ...] | None,
    true_names: tuple[str, ...],
    size: int,
    how: Declarations,
    problems: list[str],
    remarks: list[str],
) -> tuple[Rows, Rows]:
    """Give the columns of the two that belong together, in the order of the truth."""
    if names is None:
        if size != len(true_names):
            problems.append(
                f"{hypotheses.name} has K = {size} joints and {truth.name} {len(true_names)}; expected as many, or "
                "joints named in both and --joints common."
            )
        return np.arange(size), np.arange(size)
    lacking = [name for name in true_names if name not in names]
    beyond = [name for name in names if name not in true_names]
    kept = [k for k, name in enumerate(true_names) if name in names]
    for poses, missing in ((hypotheses, lacking), (truth, beyond)):
        if missing and kept and how.joints == "same":
            problems.append(
                f"{poses.name} lacks {len(missing)} of the other's joints ({first_few(missing)}). "
                "Pass --joints common to score the shared ones."
            )
    if not kept:
        problems.append(_nothing_shared(hypotheses, truth, "joint", names, true_names))
    elif (lacking or beyond) and how.joints == "common":
        remarks.append(f"{len(kept)} joints are in both; left out: {first_few([*lacking, *beyond], 5)}.")
    return np.array([names.index(true_names[k]) for k in kept], dtype=np.intp), np.array(kept, dtype=np.intp)


def _root(said: str | None, names: tuple[str, ...], truth: FloatArray) -> int | None:
    if said == "none":
        return None
    if said is not None:
        index = (
            int(said) if said.isdecimal() else next((k for k, n in enumerate(names) if n == canonical_name(said)), -1)
        )
        if not 0 <= index < len(names):
            raise PoseDataError(f"root joint: {said!r} is not among the joints. {did_you_mean(said, names)}")
        return index
    known = Skeleton(names).root
    if known is not None:
        return known
    still = np.flatnonzero(~truth.any(axis=(0, 2)))
    return int(still[0]) if len(still) == 1 and len(names) > 1 else None


# --- labels and marks -----------------------------------------------------------------------------------------


def _labels(
    hypotheses: StoredPoses,
    truth: StoredPoses,
    sizes: tuple[int, int],
    rows: Rows,
    true_rows: Rows,
    problems: list[str],
) -> Labels:
    found = {name: values[true_rows] for name, values in _of_poses(truth, sizes[1], problems).items()}
    for name, values in _of_poses(hypotheses, sizes[0], problems).items():
        ours = values[rows]
        if name in found and not np.array_equal(found[name], ours):
            different = int((found[name] != ours).sum())
            problems.append(
                f"{hypotheses.name} and {truth.name} differ in {name} of {different:,} of {len(ours):,} frames. "
                "Are they in the same order? A frame_id in both joins them."
            )
        found.setdefault(name, ours)
    return found


def _of_poses(poses: StoredPoses, number: int, problems: list[str]) -> Labels:
    """Keep what is one word per pose. A file may hold other lists; under a common label's name that is an error."""
    problems += [
        f"{poses.name}: {name} has {len(values):,} values for {number:,} poses; expected one each."
        for name, values in poses.labels.items()
        if len(values) != number and name in COMMON_LABELS
    ]
    return {name: values for name, values in poses.labels.items() if len(values) == number}


def _occluded(
    poses: StoredPoses, rows: Rows, columns: Rows, shape: tuple[int, ...], problems: list[str]
) -> npt.NDArray[np.bool_] | None:
    if len(poses.marks) > 1:
        problems.append(f"{poses.name} has both occluded and visible; expected one of them.")
    for name, marks in poses.marks.items():
        if marks.shape != shape:
            problems.append(f"{poses.name}: {name} {marks.shape}; expected (M, K) = {shape}.")
            return None
        chosen: BoolArray = marks[rows][:, columns]
        return ~chosen if name == "visible" else chosen
    return None
