"""Thresholds of PCK and AUC: their range, and the lengths of a body that they are shares of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import find_joint
from posecal.engine.block import Block
from posecal.errors import PoseDataError

_LENGTHS = {
    "torso": (("LHip+RHip", "Hip"), ("LShoulder+RShoulder", "Thorax")),
    "head": (("Head",), ("UpperNeck", "Thorax", "Neck/Nose")),
}
"""Lengths by name: the joints of their two ends, the first that the poses have; a plus is the midpoint."""


def range_of(text: str) -> tuple[float, float, int]:
    """Read a range of thresholds from ``first:last:number``.

    Raises
    ------
    ValueError
        Where it is none.

    Examples
    --------
    >>> range_of("0:50:100")
    (0.0, 50.0, 100)
    """
    first, last, number = text.split(":")
    found = float(first), float(last), int(number)
    if not is_range(found):
        raise ValueError(text)
    return found


def is_range(thresholds: object) -> bool:
    """Whether these are a first threshold from 0, a larger last one, and a number of at least 2."""
    if not isinstance(thresholds, tuple | list) or len(thresholds) != 3:
        return False
    first, last, number = thresholds
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in thresholds)
    return numbers and 0 <= first < last < np.inf and number == int(number) >= 2


def reference_length(text: str, joints: tuple[str, ...]) -> tuple[str, Callable[[Block], FloatArray] | None]:
    """Give the length of each true pose that thresholds are shares of.

    Parameters
    ----------
    text : str
        ``none``, ``torso`` (from the middle of the hips to that of the shoulders), ``head`` (from its top to the neck),
        or two joints as ``LShoulder - RHip``, where a plus makes a midpoint.
    joints : tuple of str
        K names.

    Returns
    -------
    words : str
        What the length is, for definitions.
    length : callable or None
        From a block to lengths, (B,), NaN where an end does not count or the length is 0; None for none.

    Raises
    ------
    PoseDataError
        Where the poses lack a joint.
    """
    if text == "none":
        return "", None
    ends = _LENGTHS.get(text) or tuple((end.strip(),) for end in text.split(" - "))
    if len(ends) != 2:
        raise PoseDataError(f"pck_relative: {text!r}; expected none, torso, head, or two joints as LShoulder - RHip.")
    places = [_joints(end, joints) for end in ends]
    for end, place in zip(ends, places, strict=True):
        if not place:
            raise PoseDataError(f"pck_relative: {text} needs {' or '.join(end)}, which the poses don't have.")

    def length(block: Block) -> FloatArray:
        first, second = (block.truth[:, place].mean(axis=1) for place in places)
        known = block.where[:, [*places[0], *places[1]]].all(axis=1)
        apart = np.linalg.norm(first - second, axis=-1)
        return np.where(known & (apart > 0), apart, np.nan)

    return f"of the {text}" if text in _LENGTHS else f"of {text.replace(' - ', ' to ')}", length


def _joints(choices: tuple[str, ...], joints: tuple[str, ...]) -> list[int]:
    """Give the joints of the first choice that is there; none where no choice is."""
    for choice in choices:
        found = [find_joint(name.strip(), joints) for name in choice.split("+")]
        if None not in found:
            return [joint for joint in found if joint is not None]
    return []
