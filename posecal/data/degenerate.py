"""Checks of poses that are degenerate: one point, joints that repeat others, columns that are no coordinates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.remarks import Count, Example, Remark
from posecal.errors import PoseDataError, first_few, option

LARGEST = 1e7
"""A coordinate beyond this, in mm (10 km), is a fill value or an overflow, and refused as one that is not finite."""

LARGEST_ANGLE = 1e5
"""An angle beyond this, in degrees, likewise."""

FEWEST_JOINTS = 3
"""Poses of fewer joints that count are never said to be one point."""

_FEWEST_COORDINATES = 6
"""Fewer whole numbers may be equal by chance."""

_FILL = 1000.0
"""Three coordinates of this size, in any unit, are not equal by chance."""

_FACTORS = np.sqrt([2.0, 3.0, 5.0])
"""What coordinates are weighted by, so that sums of other coordinates are equal by chance only."""

_SURE = 0.9
"""Confidences of many joints reach this."""

_PIXELS = 20.0
"""Coordinates with a standard deviation above this are none of metres."""


def is_outside(coordinates: FloatArray, limit: float = LARGEST) -> BoolArray:
    """Find coordinates that are NaN, infinite or beyond a limit."""
    return np.asarray(~(np.abs(coordinates) <= limit))


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


def third_column_remarks(name: str, metres: FloatArray, parameter: str, axes: str) -> list[str]:
    """Remark on poses in metres, (..., 3), of which the last column may be a confidence: from 0 to 1, the others not.

    A depth from a camera reaches beyond 1 m, heights reach it by standing persons, and what is relative to a joint is
    negative as well; hands near a camera are the one other case.
    """
    with np.errstate(invalid="ignore"):  # joints that don't count may hold anything
        finite = metres[np.isfinite(metres).all(axis=-1)]
    if finite.shape[-1] < 3 or not len(finite):
        return []
    plane, last = finite[:, :2], finite[:, 2]
    if not (last.min() >= 0 and _SURE <= last.max() <= 1 and (plane.min() < 0 or plane.max() > 1)):
        return []
    return [
        f"{name}: the third coordinate lies within 0 to 1 m in all poses, as a confidence beside two coordinates does. "
        f"If it is one, {option(parameter, axes)} leaves it out."
    ]


def is_one_point(poses: FloatArray, where: BoolArray | None) -> BoolArray:
    """Find poses (..., M, K, D), D > 1, of which all joints that count, (M, K), three or more, lie in one point."""
    k, d = poses.shape[-2:]
    if k < FEWEST_JOINTS or d < 2:
        return np.zeros(poses.shape[:-2], dtype=bool)
    found = poses[..., 0, 0] == poses[..., -1, 0]  # few poses are left to look at closely
    if where is not None:
        found |= ~(where[:, 0] & where[:, -1])
    if not found.any():
        return np.asarray(found)
    some = poses[found]
    counts = np.ones(some.shape[:2], dtype=bool) if where is None else np.broadcast_to(where, poses.shape[:-1])[found]
    first = np.take_along_axis(some, counts.argmax(axis=1)[:, None, None], axis=1)
    found[found] = ((some == first) | ~counts[..., None]).all(axis=(1, 2)) & (counts.sum(axis=1) >= FEWEST_JOINTS)
    return np.asarray(found)


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
    bad = np.flatnonzero(is_one_point(truth, where))
    if len(bad):
        raise PoseDataError(
            f"{name}: in {len(bad):,} of {len(truth):,} frames (first: {first_few(frames[bad].tolist())}) all joints "
            "lie in one point; expected poses. Leave these frames out, or mark them in a member valid (M,)."
        )


class Fills:
    """Joints whose coordinates are all one number in some poses, such as 0 or -1000: it may be a fill value."""

    def __init__(self) -> None:
        self._places, self._poses = Counter[float](), Counter[float]()
        self._first: dict[float, str] = {}
        self._range, self._d = (np.inf, -np.inf), 0

    def add(
        self,
        poses: FloatArray,
        others: FloatArray,
        where: BoolArray | None,
        counted: BoolArray,
        resting: Sequence[int],
        joints: Sequence[str],
    ) -> None:
        """Look at more poses.

        Parameters
        ----------
        poses : array (N, M, K, D)
            Hypotheses, or the truth as one.
        others : array (M, K, D)
            The truth, or a hypothesis: where both are 0, that is a root.
        where : bool array (M, K) or None
            The joints that count.
        counted : bool array (N, M)
            The poses that count.
        resting : sequence of int
            Joints that may be 0, unless they are far from the others.
        joints : sequence of str
            K names.
        """
        self._d = poses.shape[3]
        if self._d == 2:
            low, high = self._range
            self._range = min(low, float(np.nanmin(poses))), max(high, float(np.nanmax(poses)))
        equal = poses[..., 0] == poses[..., 1]
        for joint in resting:
            equal[:, :, joint] &= (poses[:, :, joint, 0] != 0) | _is_apart(poses, joint)
        found = np.flatnonzero(equal)
        if not len(found):
            return
        n, m, k = np.unravel_index(found, equal.shape)
        values = poses[n, m, k]
        is_fill = (values == values[:, :1]).all(axis=1) & counted[n, m]
        is_fill &= values.any(axis=1) | others[m, k].any(axis=1)
        if where is not None:
            is_fill &= where[m, k]
        n, m, k, values = n[is_fill], m[is_fill], k[is_fill], values[is_fill, 0] + 0  # -0 as 0
        for value in np.unique(values):
            at = values == value
            self._places[float(value)] += int(at.sum())
            self._poses[float(value)] += len(np.unique(n[at] * counted.shape[1] + m[at]))
            self._first.setdefault(float(value), joints[k[at][0]])

    def remarks(self, name: str, words: tuple[str, str], total: int | None) -> list[str]:
        """Give a remark for each such number.

        A number other than 0 is found in two places or more, or is at least 1000 in three coordinates; of two
        coordinates it is the least or the largest of all, since whole pixels may be equal by chance.
        """
        return [
            Remark(
                f"{name}: joints are exactly {value:g} in ",
                Count(self._poses[value], *words, of=total),
                " (first: ",
                Example(self._first[value]),
                "). Where that stands for a joint that is not known, mark it in a member valid (M, K).",
            )
            for value, number in sorted(self._places.items())
            if value == 0
            or (number > 1 and (self._d > 2 or value in self._range))
            or (self._d > 2 and abs(value) >= _FILL)
        ]


def _is_apart(poses: FloatArray, joint: int) -> BoolArray:
    """Find poses (N, M, K, D) of which a joint is farther from every other than the box around these is large."""
    others = np.delete(poses, joint, axis=2)
    away = np.fmin.reduce(np.linalg.norm(others - poses[:, :, [joint]], axis=-1), axis=2)
    size = np.linalg.norm(np.fmax.reduce(others, axis=2) - np.fmin.reduce(others, axis=2), axis=-1)
    return np.asarray(away > size)


class Repeats:
    """Joints that equal others in some frames, in all hypotheses."""

    def __init__(self) -> None:
        self._pairs, self._sure = Counter[str](), dict[str, None]()
        self._frames = self._coordinates = self._k = 0

    def add(
        self,
        poses: FloatArray,
        others: FloatArray | None,
        where: BoolArray | None,
        resting: Sequence[int],
        joints: Sequence[str],
    ) -> None:
        """Look at more poses, (N, M, K, D), as :meth:`Fills.add`; joints that are equal in ``others`` don't count."""
        _, m, k, d = poses.shape
        self._k = k
        self._coordinates += poses[..., 0, :].size
        keys = (poses[0] * _FACTORS[:d]).sum(axis=2)
        ordered = np.sort(keys, axis=1)
        if not (ordered[:, 1:] == ordered[:, :-1]).any():
            return
        order = np.argsort(keys, axis=1, kind="stable")
        keys = np.take_along_axis(keys, order, axis=1)
        rows, places = np.nonzero(keys[:, 1:] == keys[:, :-1])
        pairs, numbers = np.unique(order[rows, places] * k + order[rows, places + 1], return_counts=True)
        sure = np.zeros(m, dtype=bool)
        for pair in pairs[np.argsort(-numbers, kind="stable")][:k]:
            j, copy = divmod(int(pair), k)
            if j in resting and copy in resting:
                continue
            values = poses[:, :, j]
            equal = (values == poses[:, :, copy]).all(axis=(0, 2))
            if where is not None:
                equal &= where[:, j] & where[:, copy]
            if others is not None:
                equal &= (others[:, j] != others[:, copy]).any(axis=1)
            if not equal.any():
                continue
            text = f"{joints[copy]} = {joints[j]}"
            self._pairs[text] += int(equal.sum())
            by_chance = (values == np.rint(values)).all(axis=(0, 2)) & (values[:, :1].size < _FEWEST_COORDINATES)
            by_chance |= (values == values[..., :1]).all(axis=(0, 2))  # a fill value
            if (equal & ~by_chance).any():
                sure |= equal & ~by_chance
                self._sure[text] = None
        self._frames += int(sure.sum())

    def remarks(self, name: str, total: int) -> list[str]:
        """Give a remark on them, of so many frames.

        Whole numbers of few coordinates may be equal by chance, and fill values are no repetition: such joints count if
        they are equal in every frame.
        """
        always = [text for text, number in self._pairs.items() if number == total]
        pairs = list(dict.fromkeys([*always * (self._coordinates >= _FEWEST_COORDINATES), *self._sure]))
        if not 0 < len(pairs) < self._k - 1:
            return []
        return [
            Remark(
                f"{name}: joints equal others in ",
                Count(total if always else self._frames, "frame", of=total),
                " (",
                Example(first_few(pairs, 8)),
                "), which so count more than once in means over joints. The protocol's option joints chooses those to "
                "score.",
            )
        ]
