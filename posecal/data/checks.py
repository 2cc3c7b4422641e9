"""Checks of units: whether poses are of the size of a person in millimetres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.degenerate import FEWEST_JOINTS
from posecal.data.remarks import Count, Example, Remark
from posecal.data.skeleton import Skeleton, known_set
from posecal.errors import PoseDataError, option

FRAMES = 8
"""Of how many frames, the first ones, the units of hypotheses are judged."""

_FACTOR = 50.0
"""Poses that differ so much in size are in two units."""

_FEWEST_ANGLES = 100
"""Of fewer angles nothing is said."""

if TYPE_CHECKING:
    from posecal.data.declarations import Declarations
    from posecal.data.pose_data import PoseData

_POSES = 4096
"""True poses whose size is measured together."""

BONES = (50.0, 700.0)
"""A median bone length outside this range, in mm, is remarked on."""

CENTIMETRES = 20.0, 60.0
"""Poses of a size within this range, in what should be mm, are hands or faces, or people in centimetres."""

HUGE = 20_000.0
"""Poses of this size, in what should be mm, are in mm and declared as m."""

TINY = 10.0
"""Poses of this size, in what should be mm, look like metres: a person's joints lie some 400 mm from their centre."""


def check_units(
    data: PoseData, some: FloatArray, unit: str | None, true_unit: str | None, declared: Declarations
) -> list[str]:
    """Check that hypotheses and truth have the size of a person, and of each other.

    Parameters
    ----------
    data : PoseData
        Hypotheses and truth.
    some : array (N, m, K, D)
        Hypotheses of :data:`FRAMES` frames, or of all where there are fewer.
    unit, true_unit : str or None
        Units that hypotheses and truth declare themselves.
    declared : Declarations
        What the user declares about them.

    Returns
    -------
    list of str
        Remarks, where numbers may still be right.

    Raises
    ------
    PoseDataError
        Where an undeclared unit can't be millimetres, or the two are in different units.
    """
    *_, k, d = data.shape
    if data.unit == "deg":
        return _angle_remarks(data, some, "rad" in (unit, true_unit, declared.unit, declared.truth_unit))
    remarks = _mixed_sizes(data)
    if data.unit != "mm":
        return remarks
    name, true_name = data.names
    is_known = unit is not None or declared.unit is not None
    is_true_known = any(given is not None for given in (true_unit, declared.truth_unit, declared.unit))
    size = pose_size(some[:12].reshape(-1, k, d))
    true_size = pose_size(data.truth)
    sides = ("truth_unit", true_name, true_size, is_true_known), ("unit", name, size, is_known)
    tiny = [
        (key, which, metres_message(which, length), known) for key, which, length, known in sides if 0 < length < TINY
    ]
    undeclared = {key: message for key, _, message, known in tiny if not known}
    if undeclared:
        key = "unit" if "unit" in undeclared else "truth_unit"
        advice = option(key, "m")
        if "truth_unit" not in undeclared and not is_true_known:
            advice += f" and {option('truth_unit', 'mm')}"
        raise PoseDataError(
            f"{' '.join(undeclared.values())} Pass {advice}, or store unit in the files; {option(key, 'mm')} if it is "
            "right."
        )
    remarks += [Remark(Example(message), f" Is the unit of {which} right?") for _, which, message, _ in tiny]
    if true_size > HUGE:
        far = Example(f"{true_size / 1000:,.0f} m")
        remarks.append(Remark(f"joints of {true_name} lie ", far, " from the middle of the pose. Is its unit right?"))
    if size > 0 and true_size > 0 and (ratio := ratio_message(name, true_name, size, true_size)):
        if declared.truth_unit is None and not (is_known and true_unit is not None):
            raise PoseDataError(
                f"{ratio}; expected one unit. Store unit in both, or pass {option('unit')} for the one and "
                f"{option('truth_unit')} for the other."
            )
        remarks.append(Remark(Example(ratio), ". Are their units right?"))
    sizes = [size for _, _, size, known in sides if not known and size > 0]
    remarks = remarks or [*_check_bones(data), *_remark_on_centimetres(data, max(sizes, default=0.0))][:1]
    if d < 3 and not (is_known or is_true_known):
        what, word, meant = ("two coordinates", "px", "pixels") if d == 2 else ("single coordinates", "deg", "degrees")
        remarks.append(f"{what} without a unit are taken as mm; {option('unit', word)} declares {meant}.")
    return remarks


def refuse_tiny(hypotheses: FloatArray, truth: FloatArray) -> None:
    """Refuse arrays of no declared unit that look like metres, or that are in different units.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses.
    truth : array (M, K, D)
        True poses. Where their joints coincide, as in worked examples, they have no size to compare.

    Raises
    ------
    PoseDataError
        With the parameter to pass.
    """
    true_size, size = pose_size(truth), pose_size(hypotheses[:12, :FRAMES].reshape(-1, *truth.shape[1:]))
    right = f"{option('unit', 'mm')} if it is right"
    if 0 < true_size < TINY:
        raise PoseDataError(f"{metres_message('truth', true_size)} Pass {option('unit', 'm')}, or {right}.")
    if true_size > 0 and size > 0 and (message := ratio_message("hypotheses", "truth", size, true_size)):
        raise PoseDataError(f"{message}; expected one unit. Convert one of the two, or pass {right}.")


def _angle_remarks(data: PoseData, some: FloatArray, are_radians: bool) -> list[str]:
    """Remark on degrees that look like radians, of both or of one."""
    with np.errstate(invalid="ignore", over="ignore"):  # joints that don't count may hold anything
        sizes = [np.abs(poses[np.isfinite(poses)].astype(np.float64)) for poses in (some, data.truth)]
    if are_radians or min(map(len, sizes)) < _FEWEST_ANGLES:
        return []
    size, true_size = (float(np.sqrt(np.mean(angles**2))) for angles in sizes)
    if all(1 < angles.max() <= 2 * np.pi for angles in sizes):
        return [f"all angles lie within 6.3 degrees. Are they radians? {option('unit', 'rad')} declares them."]
    if size > 0 and true_size > 0 and (ratio := ratio_message(*data.names, size, true_size)):
        return [Remark(Example(ratio), ". Is one of the two in radians?")]
    return []


def _mixed_sizes(data: PoseData) -> list[str]:
    """Remark on true poses that differ in size as two units do."""
    if data.truth.shape[1] < FEWEST_JOINTS or data.truth.shape[2] < 2:
        return []
    m = len(data.truth)
    parts = (slice(start, start + _POSES) for start in range(0, m, _POSES))
    sizes = np.concatenate(
        [_sizes(data.truth[part], None if data.where is None else data.where[part]) for part in parts]
    )
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    far = int((np.abs(np.log(sizes / np.median(sizes))) > np.log(_FACTOR)).sum()) if len(sizes) else 0
    if not far:
        return []
    words = f" of {data.names[1]} differs from that of most over {_FACTOR:g} times. Are all in one unit?"
    return [Remark("the size of ", Count(far, "pose", of=m), words)]


def _sizes(poses: FloatArray, where: BoolArray | None) -> FloatArray:
    """Median distance of the joints from their median, of the coordinate where it is largest, (m,); NaN if not known.

    One joint that is far away changes nothing.
    """
    middle = poses.shape[1] // 2
    poses = poses if where is None else np.where(where[..., None], poses, np.nan)
    with np.errstate(invalid="ignore", over="ignore"):  # of coordinates that are refused later
        centre = np.sort(poses.swapaxes(1, 2), axis=2)[..., middle]
        away = np.abs(poses - centre[:, None]).max(axis=2)
    return np.where(np.isfinite(away).all(axis=1), np.sort(away, axis=1)[:, middle], np.nan)


def ratio_message(name: str, true_name: str, size: float, true_size: float) -> str:
    """Describe two sizes that can't be in one unit; empty where they can."""
    if 0.05 < size / true_size < 20:
        return ""
    return f"{name} and {true_name} differ in size by a factor of {max(size / true_size, true_size / size):,.0f}"


def metres_message(name: str, size: float) -> str:
    """Describe poses that look like metres, for a message.

    Parameters
    ----------
    name : str
        What messages call them.
    size : float
        Of :func:`pose_size`.

    Returns
    -------
    str
        A sentence.
    """
    return f"{name} looks like metres: joints lie {size:.2g} from the middle of the pose; expected some 400 (mm)."


def pose_size(poses: FloatArray) -> float:
    """Measure how large poses are: the median of their joints' root mean square distance from their mean.

    Parameters
    ----------
    poses : array (M, K, D)
        In any unit; poses with joints that are not finite don't count.

    Returns
    -------
    float
        In that unit; 0 where no pose is finite.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # of coordinates that are refused for their size
        some = _sample(poses)
        some = some[np.isfinite(some).all(axis=(1, 2))]
        if not len(some):
            return 0.0
        return float(_median(np.sqrt(((some - some.mean(axis=1, keepdims=True)) ** 2).sum(axis=2).mean(axis=1))))


def _median(values: FloatArray, axis: int = 0) -> FloatArray:
    """Median of finite values along an axis: of few, several times faster than NumPy's."""
    ordered, middle = np.sort(values, axis=axis), values.shape[axis] // 2
    low = middle if values.shape[axis] % 2 else middle - 1
    return np.asarray((ordered.take(low, axis=axis) + ordered.take(middle, axis=axis)) / 2)


def _sample(poses: FloatArray) -> FloatArray:
    """Give up to a thousand poses, evenly chosen, in double precision."""
    return poses[:: max(1, len(poses) // 500)].astype(np.float64)


def _remark_on_centimetres(data: PoseData, size: float) -> list[str]:
    """Remark on undeclared poses of no known skeleton that are as small as a hand, or a person in centimetres."""
    if data.parents or known_set(data.joints) or not CENTIMETRES[0] <= size < CENTIMETRES[1]:
        return []
    return [
        Remark(
            f"{data.names[1]} may be in centimetres: joints lie ",
            Example(f"{size:.0f}"),
            " from the middle of the pose, as those of a hand in mm or of a person in cm. Pass "
            f"{option('unit', 'cm')}, or {option('unit', 'mm')} if it is right.",
        )
    ]


def _check_bones(data: PoseData) -> list[str]:
    found = known_set(data.joints)
    if data.parents or (found is not None and found.rest):  # no person's
        return []
    bones = Skeleton(data.joints).bones
    if not bones:
        return []
    parents, children = np.array(bones).T
    some = _sample(data.truth)
    with np.errstate(invalid="ignore"):  # joints that don't count may hold anything
        lengths = np.linalg.norm(some[:, children] - some[:, parents], axis=-1)
    lengths = lengths[np.isfinite(lengths)]
    if not lengths.size or BONES[0] <= np.median(lengths) <= BONES[1]:
        return []
    return [
        Remark(
            f"the median bone of {data.names[1]} is ",
            Example(f"{np.median(lengths):,.1f}"),
            f" mm long; expected {BONES[0]:g} to {BONES[1]:g}. Is its unit right?",
        )
    ]
