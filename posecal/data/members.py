"""What is declared of poses beside their coordinates: labels, and the joints that are occluded, known and count."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, checked_mask
from posecal.data.remarks import Example, Remark
from posecal.data.stored_poses import Labels, Rows, StoredPoses
from posecal.errors import PosecalError, attempt, first_few

T = TypeVar("T", bound=np.generic)

_MARKS = re.compile("mask|valid|missing|annotated|ignore", re.IGNORECASE)
"""Names that labels of two values may have where they stand for poses that do not count."""

_MARKS_OF_MANY = re.compile(f"{_MARKS.pattern}|visib|occlu|confiden", re.IGNORECASE)
"""Names of arrays that may mark joints, coordinates or hypotheses."""

_LOOKED_AT = 10_000
"""Names of frames whose order is looked at."""


@dataclass(frozen=True)
class Members:
    """What is declared of M poses of K joints.

    Attributes
    ----------
    labels : mapping of arrays of str (M,)
        Those that have a value for each pose.
    occluded, valid, where : bool array (M, K) or None
        The joints that are occluded, known, and count.
    """

    labels: Labels
    occluded: BoolArray | None
    valid: BoolArray | None
    where: BoolArray | None

    def select(self, rows: Rows, columns: Rows) -> Members:
        """Keep some poses and joints, by their numbers."""
        masks = (None if mask is None else mask[rows][:, columns] for mask in (self.occluded, self.valid, self.where))
        return Members({name: values[rows] for name, values in self.labels.items()}, *masks)


def read_members(
    poses: StoredPoses, shape: tuple[int, ...], problems: list[str | PosecalError], clip_length: int | None = None
) -> Members:
    """Give what is declared of (M, K) joints, labels also of clips of T; what does not fit is added to the problems."""
    return Members(
        _labels(poses, shape[0], clip_length, problems),
        _occluded(poses, shape, problems),
        _valid(poses, shape, problems),
        None if poses.where is None else attempt(problems, checked_mask, poses.where, shape),
    )


def with_frames_of_clips(poses: StoredPoses, number: int, clip_length: int | None) -> StoredPoses:
    """Give what is declared of C clips of T frames, (C, T) or (C, T, K), as that of M = C · T poses."""
    if clip_length is None or clip_length == 1:
        return poses
    clips = number // clip_length, clip_length

    def flat(values: npt.NDArray[T]) -> npt.NDArray[T]:
        return values.reshape(number, *values.shape[2:]) if values.shape[:2] == clips else values

    return replace(
        poses,
        labels={name: flat(values) for name, values in poses.labels.items()},
        marks={name: flat(values) for name, values in poses.marks.items()},
        frame_id=None if poses.frame_id is None else flat(poses.frame_id),
        valid=None if poses.valid is None else flat(poses.valid),
        where=None if poses.where is None else flat(poses.where),
    )


def unread_remarks(poses: StoredPoses, shape: tuple[int, ...]) -> list[str]:
    """Remark on members of unknown names that are of (M, K) joints, or whose names are those of marks."""
    names = [key for key, size in poses.unread.items() if math.prod(size) == math.prod(shape)]
    which, first = Example(poses.name), Example(first_few(names))
    known = " (M, K); of that shape, valid, occluded and visible are. Rename what is meant."
    remarks: list[str] = [Remark(which, ": not read: ", first, known)] if names else []
    others = [
        f"{key} {size}"
        for key, size in poses.unread.items()
        if key not in names and _MARKS_OF_MANY.search(key) and {*size} <= {1, *shape, *poses.array.shape}
    ]
    if others:
        words = " may mark what does not count. Joints are marked by valid (M, K), absent hypotheses by weights of 0."
        remarks.append(Remark(which, ": not read: ", Example(first_few(others)), words))
    marks = [k for k, v in poses.labels.items() if _MARKS.search(k) and v.shape == shape[:1] and len(np.unique(v)) == 2]
    if marks:
        label = " (M,) is a label; the poses that count are marked by valid (M,). Rename what is meant."
        remarks.append(Remark(which, ": ", Example(first_few(marks)), label))
    return remarks


def frame_id_remarks(hypotheses: StoredPoses, truth: StoredPoses) -> list[str]:
    """Remark on names of frames that only one of two has, and say where their numbers are not in order."""
    named = [poses for poses in (hypotheses, truth) if poses.frame_id is not None]
    if len(named) != 1 or named[0].frame_id is None:
        return []
    ids = named[0].frame_id[:_LOOKED_AT].tolist()
    numbers = [re.fullmatch(r"(.*?)(\d{1,15})(\D*)", name, re.DOTALL) for name in ids]
    pairs = [(a, b) for a, b in pairwise(numbers) if a and b and a.group(1, 3) == b.group(1, 3)]
    is_shuffled = len({*ids}) == len(ids) and any(int(a[2]) > int(b[2]) for a, b in pairs)
    order = "; its numbers are not in order: are the others in the same?" if is_shuffled else "."
    return [Remark("frame_id: only ", Example(named[0].name), " has it, so frames are matched by their place", order)]


def both(first: BoolArray | None, second: BoolArray | None) -> BoolArray | None:
    """Give the joints that both masks hold; None is one that holds all."""
    return second if first is None else first if second is None else first & second


def _labels(poses: StoredPoses, number: int, clip_length: int | None, problems: list[str | PosecalError]) -> Labels:
    """Give the labels that have a value for each pose, or each clip; all of those must that can only be labels."""
    labels = {name: values if values.ndim else np.full(number, values) for name, values in poses.labels.items()}
    n_clips = number // (clip_length or 1)
    problems += [
        f"{poses.name}: {name} {values.shape}; expected one for each pose, (M,) = ({number},)"
        + (f", or each frame of clips, (C, T) = ({n_clips}, {clip_length})." if clip_length else ".")
        for name, values in labels.items()
        if values.ndim > 1
    ]
    labels = {name: values for name, values in labels.items() if values.ndim == 1}
    labels = {k: np.repeat(v, number // n_clips) if len(v) == n_clips != number else v for k, v in labels.items()}
    or_clips = f", or of the {n_clips:,} clips" * (n_clips != number)
    problems += [
        f"{poses.name}: {name} has {len(values):,} values for {number:,} poses; expected one each{or_clips}."
        for name, values in labels.items()
        if len(values) != number and name in poses.required_labels
    ]
    return {name: values for name, values in labels.items() if len(values) == number}


def _occluded(poses: StoredPoses, shape: tuple[int, ...], problems: list[str | PosecalError]) -> BoolArray | None:
    """Give the joints that are marked as occluded, or not as visible; None without marks."""
    if len(poses.marks) > 1:
        problems.append(f"{poses.name} has both occluded and visible; expected one of them.")
    for name, marks in poses.marks.items():
        if marks.shape != shape:
            problems.append(f"{poses.name}: {name} {marks.shape}; expected (M, K) = {shape}.")
            return None
        return ~marks if name == "visible" else marks
    return None


def _valid(poses: StoredPoses, shape: tuple[int, ...], problems: list[str | PosecalError]) -> BoolArray | None:
    """Give the joints that are known, of a mask of joints or of poses; None without one."""
    valid = poses.valid
    if valid is not None and valid.shape not in {shape, shape[:1]}:
        problems.append(f"{poses.name}: valid {valid.shape}; expected (M, K) = {shape} or (M,).")
        return None
    return None if valid is None else np.broadcast_to(valid if valid.ndim == 2 else valid[:, None], shape)
