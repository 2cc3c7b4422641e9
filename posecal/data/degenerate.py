"""Checks of poses that are degenerate: one point, joints that repeat others, columns that are no coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.remarks import Count, Example, Remark
from posecal.errors import PoseDataError, first_few, option

LARGEST = 1e7
"""A coordinate beyond this, in mm (10 km), is a fill value or an overflow, and refused as one that is not finite."""

FEWEST_JOINTS = 3
"""Poses of fewer joints that count are never said to be one point."""

_PIXELS = 20.0
"""Coordinates with a standard deviation above this are none of metres."""


def is_outside(coordinates: FloatArray) -> BoolArray:
    """Find coordinates that are NaN, infinite or beyond :data:`LARGEST`."""
    return np.asarray(~(np.abs(coordinates) <= LARGEST))


def column_problem(name: str, poses: npt.NDArray[Any], parameter: str, axes: str) -> str:
    """Say that poses hold something beside coordinates, such as a confidence, and how to declare it.

    Parameters
    ----------
    name : str
        What messages call them.
    poses : array (..., D)
        Some of them, in their own unit.
    parameter : str
        The option that declares their layout.
    axes : str
        The layout in which they were read.

    Returns
    -------
    str
        Empty where D is 1, 2 or 3 and the last of three columns is no confidence beside pixels.
    """
    d = poses.shape[-1]
    poses = poses[np.isfinite(poses).all(axis=-1)]
    finite = poses[..., -1]
    is_confidence = finite.size > 0 and finite.min() >= 0 and finite.max() <= 1 and finite.any()
    if d < 3 or (d == 3 and not (is_confidence and np.std(poses[..., :2]) > _PIXELS)):
        return ""
    looks = f"; the last lies between {finite.min():.2g} and {finite.max():.2g}, as a confidence does"
    declared = option(parameter, axes.replace("D", "C"))
    return (
        f"{name} has D = {d} coordinates{looks if is_confidence else ''}; expected at most 3 of a position. Pass "
        f"{declared} to leave out the last as a confidence, or store coordinates alone."
    )


def refuse_one_point(truth: FloatArray, where: BoolArray | None, frames: npt.NDArray[np.str_], name: str) -> None:
    """Refuse true poses of which all joints that count lie in one point.

    Parameters
    ----------
    truth : array (M, K, D)
        True poses.
    where : bool array (M, K) or None
        The joints that count.
    frames : array of str (M,)
        Names of the frames.
    name : str
        What messages call the truth.

    Raises
    ------
    PoseDataError
        With their number and the first of them. Poses of one coordinate, and of fewer than three joints that count,
        pass.
    """
    if truth.shape[2] < 2 or truth.shape[1] < FEWEST_JOINTS:
        return
    candidates = np.flatnonzero((truth[:, 0] == truth[:, -1]).all(axis=1) | (where is not None))
    some = truth[candidates]
    counts = np.ones(some.shape[:2], dtype=bool) if where is None else where[candidates]
    low, high = (
        reduce(np.where(counts[..., None], some, fill), axis=1)
        for reduce, fill in ((np.min, np.inf), (np.max, -np.inf))
    )
    bad = candidates[(low == high).all(axis=1) & (counts.sum(axis=1) >= FEWEST_JOINTS)]
    if len(bad):
        raise PoseDataError(
            f"{name}: in {len(bad):,} of {len(truth):,} frames (first: {first_few(frames[bad].tolist())}) all joints "
            "lie in one point; expected poses. Leave these frames out, or mark them in a member valid (M,)."
        )


def truth_remarks(
    truth: FloatArray, where: BoolArray | None, joints: Sequence[str], root: Sequence[int], name: str
) -> list[str]:
    """Remark on joints that repeat others in every frame, and on joints that are a fill value in some frames.

    Parameters
    ----------
    truth : array (M, K, D)
        True poses, as stored.
    where : bool array (M, K) or None
        The joints that count.
    joints : sequence of str
        K names.
    root : sequence of int
        The joints that are subtracted, which may be 0.
    name : str
        What messages call the truth.

    Returns
    -------
    list of str
        Remarks.
    """
    m, k, d = truth.shape
    if d < 2 or m < 2 or k < FEWEST_JOINTS:
        return []
    copies = [] if where is not None else _copies(truth)
    remarks: list[str] = []
    if 0 < len(copies) < k - 1:
        pairs = [f"{joints[j]} = {joints[original]}" for j, original in copies]
        remarks.append(
            Remark(
                f"{name}: {len(copies)} of {k} joints equal others in every frame (",
                Example(first_few(pairs, 8)),
                "), which so count twice in means over joints. The protocol's option joints chooses those to score.",
            )
        )
    return remarks + fill_remarks(truth, where, joints, [*root, *(j for j, _ in copies)], name)


def _copies(truth: FloatArray) -> list[tuple[int, int]]:
    """Give joints that equal an earlier one in every frame, each with that one."""
    _, first, group = np.unique(truth[0], axis=0, return_index=True, return_inverse=True)
    original = first[group.reshape(-1)].tolist()  # the first joint that lies where each does in the first frame
    return [
        (j, original[j])
        for j in range(len(original))
        if original[j] != j and np.array_equal(truth[:, j], truth[:, original[j]])
    ]


def fill_remarks(
    poses: FloatArray, where: BoolArray | None, joints: Sequence[str], resting: Sequence[int], name: str
) -> list[str]:
    """Remark on joints whose coordinates are all one number in some poses, such as 0 or -1000: it may be a fill value.

    Parameters
    ----------
    poses : array (M, K, D)
        True poses, or hypotheses one after another.
    where : bool array (M, K) or None
        The joints that count.
    joints : sequence of str
        K names.
    resting : sequence of int
        Joints that may be 0.
    name : str
        What messages call the poses.

    Returns
    -------
    list of str
        A remark for each such number. Other than 0 it is found at two joints or more and, of two coordinates, as the
        least or the largest of all, since whole pixels may be equal by chance.
    """
    counted = np.ones(poses.shape[:2], dtype=bool) if where is None else where
    equal = (poses == poses[..., :1]).all(axis=2) & counted
    equal &= ~equal.all(axis=1, keepdims=True)  # a pose in one point is another fault
    values, numbers = np.unique(poses[..., 0][equal], return_counts=True)
    if poses.shape[2] == 2 and values.size:
        numbers *= np.isin(values, np.array([0, np.nanmin(poses), np.nanmax(poses)]))
    remarks: list[str] = []
    for value in values[(values == 0) | (numbers > 1)]:
        found = equal & (poses[..., 0] == value)
        if value == 0:
            found[:, [*resting, *np.flatnonzero((found | ~counted).all(axis=0))]] = False
        if found.any():
            places = [f"{joints[j]} in {number:,}" for j, number in enumerate(found.sum(axis=0)) if number]
            remarks.append(
                Remark(
                    f"{name}: joints are exactly {value:g} in ",
                    Count(int(found.any(axis=1).sum()), "pose", of=len(poses)),
                    " (",
                    Example(first_few(places)),
                    "). Where that stands for a joint that is not known, mark it in a member valid (M, K).",
                )
            )
    return remarks


def distinct_hypotheses(hypotheses: FloatArray) -> int:
    """Count the distinct hypotheses of a pose, the median over some poses, (N, M, K, D)."""
    n, m = hypotheses.shape[:2]
    flat = hypotheses.reshape(n, m, -1)
    with np.errstate(invalid="ignore", over="ignore"):  # joints that don't count may hold anything
        seen = np.sort((flat * np.random.default_rng(0).normal(size=flat.shape[2])).sum(axis=2), axis=0)
    return int(np.median(1 + (np.diff(seen, axis=0) != 0).sum(axis=0)))
