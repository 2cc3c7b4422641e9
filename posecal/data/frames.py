"""Check of the coordinate frames of hypotheses and truth: axes negated or exchanged, left and right, place and size."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import letters, side_of
from posecal.data.pose_data import PoseData
from posecal.data.root import origin
from posecal.data.stored_poses import sample_rows
from posecal.data.units import PERIODS

DIFFERENT_FRAMES = "coordinate frames differ"
"""How a remark begins where a simple change removes most of the error; nothing is then said about calibration."""

_POSES, _HYPOTHESES, _JOINTS = 64, 32, 4096
"""How many are looked at, joints of all poses together."""

_LARGE, _REMOVES, _AGREE, _FEWEST = 0.3, 0.6, 0.9, 5
"""A mean error above this share of the size of the poses, of which one change removes this share, in this share of at
least so many poses, is suspicious."""

_FAR = 1.0
"""A shift of this share of the size of the poses is one of frames, as between absolute and relative positions."""

_OF_A_MODEL = 2.4
"""A model may be wrong by a factor up to this; beyond, units differ (2.54 from inches, 10 from centimetres)."""

_AXES = "xyz"


def frame_remark(data: PoseData) -> str:
    """Find a simple change of the hypotheses that removes most of a large error.

    The mean of some hypotheses of some poses is compared with the truth as it stands and after each change: axes
    negated or exchanged, left and right joints exchanged, both, a shift where no root is subtracted, and a factor.

    Parameters
    ----------
    data : PoseData
        Positions of two or three coordinates.

    Returns
    -------
    str
        A remark; empty where the error is small or no change removes most of it.
    """
    number = min(len(data.truth), _POSES, max(4, _JOINTS // data.shape[2]))
    rows = sample_rows(len(data.truth), number)
    some = data.replace(reference=None).select(rows)
    _, m, k, d = some.shape
    if d < 2 or k < 3 or data.unit in PERIODS:
        return ""
    with np.errstate(over="ignore", invalid="ignore"):  # of coordinates that are refused for their size
        x = some.hypotheses.read(0, m)[:_HYPOTHESES].mean(axis=0, dtype=np.float64)
    y = some.truth.astype(np.float64)
    usable = np.isfinite(x).all(axis=(1, 2)) & np.isfinite(y).all(axis=(1, 2))
    if some.where is not None:
        usable &= some.where.all(axis=1)
    x, y = x[usable], y[usable]
    if data.root is not None:
        x, y = x - origin(x, data.root), y - origin(y, data.root)
    if len(x) < _FEWEST:
        return ""
    centred = y - y.mean(axis=1, keepdims=True)
    size, errors = np.sqrt((centred**2).sum(axis=2).mean()), _errors(x, y)
    if errors.mean() < _LARGE * size:
        return ""
    after = {
        words: _errors(changed, y) for words, changed in _changes(x, y, data.joints, is_absolute=data.root is None)
    }
    words = min(
        after, key=lambda key: after[key].mean() * (1 + len(key) / 50)
    )  # of those that are as good, the simplest
    left, agree = after[words].mean(), (after[words] < errors / 2).mean()
    if left > (1 - _REMOVES) * errors.mean() or agree < _AGREE:
        return ""
    return (
        f"{DIFFERENT_FRAMES}: {words} in {data.names[0]} turns the error of the mean hypothesis from "
        f"{errors.mean():,.0f} into {left:,.0f} {data.unit or 'units'} ({len(x)} frames looked at). Check axes, "
        "sides and units before reading anything else; no sentence about calibration is given."
    )


def _errors(x: FloatArray, y: FloatArray) -> FloatArray:
    """Mean error over the joints of each pose, (M,)."""
    return np.asarray(np.linalg.norm(x - y, axis=-1).mean(axis=1))


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
    shift = (y - x).mean(axis=1, keepdims=True)
    if is_absolute and np.linalg.norm(shift) > _FAR * np.linalg.norm(y - y.mean(axis=1, keepdims=True)):
        yield "a shift of each pose", x + shift
    square = (x * x).sum()
    factor = float((x * y).sum() / square) if square > 0 else 1.0
    if factor > 0 and not 1 / _OF_A_MODEL < factor < _OF_A_MODEL:
        yield f"a factor of {factor:.3g}", x * factor


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
