"""Check of the coordinate frames of hypotheses and truth: axes negated or exchanged, left and right, place and size."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import letters, side_of
from posecal.data.pose_data import PoseData
from posecal.data.remarks import Example, Remark
from posecal.data.root import AnyRoot, origin
from posecal.data.stored_poses import sample_rows
from posecal.data.units import PERIODS

DIFFERENT_FRAMES = "coordinate frames differ"
"""How a remark begins where a simple change removes most of the error; nothing is then said about calibration."""

_POSES, _HYPOTHESES, _JOINTS = 64, 32, 4096
"""How many are looked at, joints of all poses together."""

_LARGE, _REMOVES, _FEWEST = 0.3, 0.6, 5
"""A mean error above this share of the size of the poses, of which one change removes this share, is suspicious, if of
at least so many poses …"""

_AGREE, _BETTER = (0.75, 0.9), (0.75, 0.5)
"""… these shares have errors below these shares of what they were: by axes, sides and order, as some poses are nearly
symmetric, and by a shift or a factor."""

_KNOWN = 0.5
"""Poses of which fewer joints are known than this share are not looked at."""

_FAR = 1.0
"""A shift of this share of the size of the poses is one of frames, as between absolute and relative positions."""

_OF_A_MODEL = 2.4
"""A model may be wrong by a factor up to this; beyond, units differ (2.54 from inches, 10 from centimetres)."""

_ORDERED = 64
"""Of more joints, another order is not looked for: where they lie close, one that fits better is found by chance."""

_ALONG = 0.97
"""A rotation whose largest cosines all reach this follows the axes, and is named by them."""

_AXES = "xyz"


class FrameCheck:
    """The mean hypothesis and the truth of some poses, and a simple change that removes most of a large error.

    Errors are compared as they stand and after each change: axes negated or exchanged, left and right joints exchanged,
    both, the joints in another order, one rotation of all poses, a shift where no root is subtracted, and a factor.
    """

    def __init__(self) -> None:
        self._poses: list[tuple[FloatArray, FloatArray]] = []
        self._looked_at = 0
        self._about: tuple[tuple[str, ...], AnyRoot, str, str] | None = None

    def add(self, data: PoseData) -> None:
        """Look at some more poses, as many as are wanted still.

        Parameters
        ----------
        data : PoseData
            Positions of two or three coordinates; others are not looked at.
        """
        _, _, k, d = data.shape
        wanted = min(_POSES, max(4, _JOINTS // k)) - self._looked_at
        if d < 2 or k < 3 or data.unit in PERIODS or wanted <= 0:
            return
        some = data.replace(reference=None).select(sample_rows(len(data.truth), wanted))
        m = len(some.truth)
        hypotheses = some.hypotheses.read(0, m)[:_HYPOTHESES].astype(np.float64)
        if some.scores is not None and (some.scores >= 0).all():  # of which 0 is that of an absent hypothesis
            hypotheses[some.scores[:_HYPOTHESES] == 0] = np.nan
        known = np.isfinite(hypotheses)
        number = known.sum(axis=0)
        x = np.where(number > 0, np.where(known, hypotheses, 0).sum(axis=0) / np.maximum(number, 1), np.nan)
        y = some.truth.astype(np.float64)
        counted = np.asarray(np.isfinite(x).all(axis=2) & np.isfinite(y).all(axis=2))
        if some.where is not None:
            counted &= some.where
        x, y = (np.where(counted[..., None], poses, np.nan) for poses in (x, y))
        if data.root is not None:
            x, y = x - origin(x, data.root), y - origin(y, data.root)
        usable = np.isfinite(x[..., 0]).mean(axis=1) >= _KNOWN
        self._poses.append((x[usable], y[usable]))
        self._looked_at += m
        self._about = data.joints, data.root, data.unit or "units", data.names[0]

    def remarks(self) -> list[str]:
        """Give a remark where one change removes most of a large error."""
        if self._about is None:
            return []
        joints, root, unit, name = self._about
        x, y = (np.concatenate(poses) for poses in zip(*self._poses, strict=True))
        if len(x) < _FEWEST:
            return []
        centred = y - _mean(y, axis=1)
        size, errors = np.sqrt(np.nanmean((centred**2).sum(axis=2))), _errors(x, y)
        if errors.mean() < _LARGE * size:
            return []
        changes = [*_changes(x, y, joints, is_absolute=root is None), *_fitted_changes(x, y, joints, root)]
        after = {words: _errors(changed, y) for words, changed in changes}
        words = min(after, key=lambda key: after[key].mean() * (1 + len(key) / 50))  # of the best, the simplest
        is_fitted = words.startswith("a ")  # a shift or a factor
        left, agree = after[words].mean(), (after[words] < _BETTER[is_fitted] * errors).mean()
        if left > (1 - _REMOVES) * errors.mean() or agree < _AGREE[is_fitted]:
            return []
        found = f"{errors.mean():,.0f} into {left:,.0f} {unit} ({len(x)} frames looked at)"
        return [
            Remark(
                f"{DIFFERENT_FRAMES}: {words} in {name} turns the error of the mean hypothesis from ",
                Example(found),
                ". Check axes, sides and units before reading anything else; no sentence about calibration is given.",
            )
        ]


def frame_remark(data: PoseData) -> str:
    """Remark on the frames of pose data as they are; empty where nothing is to be said."""
    check = FrameCheck()
    check.add(data)
    return "".join(check.remarks())


def _mean(poses: FloatArray, axis: int) -> FloatArray:
    """Mean over joints that are known, with the axis kept."""
    known = np.isfinite(poses)
    sums: FloatArray = np.where(known, poses, 0).sum(axis=axis, keepdims=True)
    return np.asarray(sums / np.maximum(known.sum(axis=axis, keepdims=True), 1))


def _errors(x: FloatArray, y: FloatArray) -> FloatArray:
    """Mean error over the joints that are known of each pose, (M,)."""
    return _mean(np.linalg.norm(x - y, axis=-1), axis=1)[:, 0]


def _changes(
    x: FloatArray, y: FloatArray, joints: tuple[str, ...], *, is_absolute: bool
) -> Iterator[tuple[str, FloatArray]]:
    """Give simple changes of poses (M, K, D) in words and as changed, the simplest first."""
    exchanged = _exchanged_sides(joints)
    for words, axes, signs in _changes_of_axes(x.shape[2]):
        turned = x[..., axes] * signs
        if words:
            yield words, turned
        if exchanged is not None:
            yield " and ".join(["exchanging left and right joints", *([words] if words else [])]), turned[:, exchanged]
    shift = _mean(y - x, axis=1)
    if is_absolute and np.linalg.norm(shift) > _FAR * np.sqrt(np.nansum((y - _mean(y, axis=1)) ** 2)):
        yield "a shift of each pose", x + shift
    square = np.nansum(x * x)
    factor = float(np.nansum(x * y) / square) if square > 0 else 1.0
    if factor > 0 and not 1 / _OF_A_MODEL < factor < _OF_A_MODEL:
        yield f"a factor of {factor:.3g}", x * factor


def _fitted_changes(
    x: FloatArray, y: FloatArray, joints: tuple[str, ...], root: AnyRoot
) -> Iterator[tuple[str, FloatArray]]:
    """Give the joints of poses (M, K, D) in the order that fits best, and the poses turned by one rotation."""
    from scipy.optimize import linear_sum_assignment

    known = np.isfinite(x).all(axis=(1, 2))  # as y is known where x is
    x0, y0 = x - _mean(x, axis=1), y - _mean(y, axis=1)
    if known.any() and 3 < len(joints) <= _ORDERED:
        distances = np.linalg.norm(x0[known][:, :, None] - y0[known][:, None], axis=-1).mean(axis=0)
        order = linear_sum_assignment(distances.T)[1]
        moved = [f"{joints[j]} for {joints[k]}" for k, j in enumerate(order.tolist()) if j != k]
        if moved:
            others = f" and {len(moved) - 2} more joints" if len(moved) > 2 else ""
            ordered = x[:, order] if root is None else x[:, order] - origin(x[:, order], root)
            yield f"taking {', '.join(moved[:2])}{others}", ordered
    left, _, right = np.linalg.svd(np.einsum("mkd,mke->de", np.nan_to_num(x0), np.nan_to_num(y0)))
    left[:, -1] *= np.linalg.det(left @ right)
    rotation = left @ right
    if np.abs(rotation).max(axis=0).min() < _ALONG:
        yield "one rotation of all poses", x @ rotation if root is not None else x0 @ rotation + _mean(y, axis=1)


def _changes_of_axes(d: int) -> Iterator[tuple[str, list[int], FloatArray]]:
    """Give every order and sign of d axes in words, as an order, and as signs; first the one that changes nothing."""
    for order in permutations(range(d)):
        moved = [_AXES[axis] for axis in range(d) if order[axis] != axis]
        for signs in product((1.0, -1.0), repeat=d):
            negated = [_AXES[axis] for axis in range(d) if signs[axis] < 0]
            words = [f"taking {', '.join(_AXES[axis] for axis in order)} for {', '.join(_AXES[:d])}"] * bool(moved)
            words += [f"negating {' and '.join(negated)}"] * bool(negated)
            yield " and ".join(words), list(order), np.array(signs)


def _exchanged_sides(joints: tuple[str, ...]) -> list[int] | None:
    """Give the order of the joints with left and right exchanged; None where no joint has a partner."""
    plain = [letters(name) for name in joints]
    order = list(range(len(joints)))
    for k, name in enumerate(joints):
        other = {"left": "r", "right": "l"}.get(side_of(name), "") + plain[k][1:]
        if side_of(name) != "middle" and plain.count(other) == 1:
            order[k] = plain.index(other)
    return order if order != sorted(order) else None
