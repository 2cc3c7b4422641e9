"""Parts of the data on which recalibrations are fitted and judged, and the checks of what is recalibrated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, real_array, working_dtype
from posecal.data.degenerate import LARGEST, column_problem, is_outside
from posecal.data.frames import frame_remark
from posecal.data.joint_names import match_joints
from posecal.data.layout import HYPOTHESES, Layout, MemoryArray
from posecal.data.pose_data import PoseData
from posecal.data.remarks import join_remarks
from posecal.data.root import resting_joints
from posecal.data.stored_poses import Rows
from posecal.data.units import PERIODS, quantity
from posecal.data.weights import are_unequal
from posecal.engine.block import Block
from posecal.engine.chunks import map_blocks, read_chunks
from posecal.engine.pose_remarks import PoseRemarks
from posecal.engine.prepare import lack_of_scored, refuse_non_finite, select_scored
from posecal.engine.protocol import Protocol
from posecal.engine.ragged import has_absent, has_absent_anywhere, n_present
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError, first_few, option

T = TypeVar("T")
Value = TypeVar("Value", bound=np.generic)


def folds_of(data: PoseData, folds: int) -> Rows:
    """Give the part of each pose, (M,), cutting between sequences, the parts alike in poses.

    Poses without sequences are cut into runs of consecutive frames.

    Raises
    ------
    PoseDataError
        For fewer than two parts, or fewer sequences (or poses) than parts.
    """
    poses, sequence = len(data.truth), data.labels.get("sequence")
    names, codes, sizes = np.unique(
        np.arange(poses) if sequence is None else sequence, return_inverse=True, return_counts=True
    )
    if not hasattr(folds, "__index__") or folds not in range(2, len(names) + 1):
        units = "poses" if sequence is None else "sequences"
        raise PoseDataError(f"folds: {folds!r}; expected 2 to {len(names)}, the number of {units} of {data.names[1]}.")
    if sequence is None:
        return np.arange(poses) * folds // poses
    load, of_name = np.zeros(folds, dtype=np.intp), np.zeros(len(names), dtype=np.intp)
    for name in np.argsort(-sizes, kind="stable"):
        of_name[name] = load.argmin()
        load[of_name[name]] += sizes[name]
    return of_name[codes]


def number_of_sequences(data: PoseData) -> int:
    """Give the number of labelled sequences."""
    return len(np.unique(data.labels["sequence"])) if "sequence" in data.labels else 0


def movable_joints(data: PoseData) -> BoolArray:
    """Give the joints that are recalibrated, (K,): all but the root."""
    mask = np.ones(len(data.joints), dtype=bool)
    mask[resting_joints(data.root)] = False
    return mask


def select_fitted(data: PoseData, least: int = 2) -> PoseData:
    """Keep the poses that recalibration is fitted on: those that an evaluation would count.

    Parameters
    ----------
    data : PoseData
        All poses.
    least : int
        How many hypotheses are needed; one has no spread.

    Raises
    ------
    PoseDataError
        For fewer hypotheses or unequal weights, for poses that lack some, where the truth is not finite, and where no
        joint counts.
    """
    if data.shape[0] < least:
        raise PoseDataError(f"{data.names[0]}: 1 hypothesis; recalibration needs at least 2.")
    refuse_weights(data.weights, data.names[0])
    data = select_scored(data, Protocol())
    if lack := lack_of_scored(data, Protocol()):
        raise PoseDataError(lack)
    if has_absent(data):
        raise _absent(data)
    return data


def refuse_weights(weights: FloatArray | None, name: str) -> None:
    """Refuse hypotheses that do not count alike.

    Raises
    ------
    PoseDataError
        Where weights (N, M) of a pose above 0 are not equal.
    """
    if weights is not None and (unequal := are_unequal(weights)).any():
        raise PoseDataError(
            f"{name}: weights are not equal in {int(unequal.sum()):,} of {len(unequal):,} frames; expected hypotheses "
            "that count alike for a recalibration. Draw as many from them by their weights, and leave the weights out."
        )


def refuse_absent(weights: FloatArray, name: str) -> None:
    """Refuse hypotheses of weight 0, (N, M), beside others: medians and spreads would be those of absent ones too.

    Raises
    ------
    PoseDataError
        With the number of frames, and the first.
    """
    if len(frames := np.flatnonzero((weights == 0).any(axis=0))):
        raise PoseDataError(
            f"{name}: hypotheses are absent (of weight 0) in {len(frames):,} of {weights.shape[1]:,} frames (first: "
            f"frame {frames[0]}); expected all in each frame that a map is applied to. Leave these frames out."
        )


def _absent(data: PoseData) -> PoseDataError:
    live, n = n_present(data), data.shape[0]
    frames = data.frame_id[live < n].tolist()
    where = f"{len(frames):,} of {len(live):,} frames (first: {first_few(frames)})"
    return PoseDataError(
        f"{data.names[0]}: hypotheses are absent (NaN, or of weight 0) in {where}; expected all N = {n} in each frame "
        f"that a recalibration is fitted on. Leave these frames out, or pass {option('n_hypotheses')} to take the "
        "first ones, as many as all frames have."
    )


def remarks_of(data: PoseData) -> tuple[str, ...]:
    """Give the remarks that an evaluation of the same data would have on hypotheses and frames."""
    looks, start, spec = PoseRemarks(), 0, DataSpec.of(data)
    for chunk in read_chunks(data.replace(reference=None)):
        looks.add(data.names, chunk, data.frame_id[start : start + len(chunk)], spec)
        start += len(chunk)
    return join_remarks([*data.remarks, *filter(None, [frame_remark(data)]), *looks.remarks()])


def measure_blocks(data: PoseData, measure: Callable[[Block], T], threads: int | None) -> Iterator[T]:
    """Measure every block, in the order of the poses.

    Raises
    ------
    PoseDataError
        For coordinates that are not finite where a joint counts.
    """
    start = 0
    for poses, bad, measured in map_blocks(data, lambda block: _measure(block, measure), threads):
        if len(bad) and has_absent_anywhere(data):
            raise _absent(data)
        refuse_non_finite(data, data.names[0], bad + np.array([start, 0]))
        start += poses
        assert measured is not None
        yield measured


def _measure(block: Block, measure: Callable[[Block], T]) -> tuple[int, Rows, T | None]:
    bad = np.argwhere(block.non_finite)
    return len(block.where), bad, None if len(bad) else measure(block)


def values_for_joints(
    names: tuple[str, ...], values: npt.NDArray[Value], joints: tuple[str, ...], whose: str
) -> npt.NDArray[Value]:
    """Give a map's values, which it has by name, in the order of some joints.

    Raises
    ------
    PoseDataError
        Where the map lacks one of them.
    """
    matched, _ = match_joints(joints, names)
    missing = [joint for k, joint in enumerate(joints) if k not in matched]
    if missing:
        raise PoseDataError(f"{whose} has joints that the map lacks: {', '.join(missing)}. Fit a map on these joints.")
    return values[[matched[k] for k in range(len(joints))]]


def factor_of_unit(unit: str | float | None, of_map: str) -> float:
    """Give how many of a map's unit are in one of the hypotheses that it is applied to; 1 where none is declared.

    Raises
    ------
    PoseDataError
        For another quantity than the map's, and for angles of no declared unit.
    """
    if unit is None and of_map in PERIODS:
        raise PoseDataError(f"hypotheses: angles; expected their unit. Pass {option('unit', 'deg')} or rad.")
    measured, factor = (of_map, 1.0) if unit is None else quantity(unit)
    refuse_another_unit("hypotheses", measured, of_map)
    return factor


def refuse_another_unit(name: str, unit: str, of_map: str) -> None:
    """Refuse hypotheses of another quantity than a map's.

    Raises
    ------
    PoseDataError
        Where the two units differ.
    """
    if unit != of_map:
        raise PoseDataError(
            f"{name}: in {unit or 'no unit'}; expected {of_map or 'no unit'}, as what the map was fitted on."
        )


def period_in(of_map: str, factor: float) -> float | None:
    """Give after how much hypotheses repeat, in their own unit; None where they don't."""
    return None if of_map not in PERIODS else PERIODS[of_map] / factor


def checked_for_map(
    hypotheses: npt.ArrayLike, axes: str | None, joints: tuple[str, ...], poses: int
) -> tuple[FloatArray, Layout, int | None]:
    """Check hypotheses that a map with K joints is applied to, and give them as (N, M, K, D).

    Parameters
    ----------
    hypotheses : array
        As passed.
    axes : str or None
        Their layout; (N, M, K, D) by default.
    joints, poses : tuple of str and int
        The map's joints, and the number of poses that it was fitted on.

    Returns
    -------
    x, layout, clip_length : array (N, M, K, D), Layout, and int or None
        The hypotheses, and how they were laid out.

    Raises
    ------
    PoseDataError
        For another number of joints, arrays of another shape or type, and where a layout that isn't declared looks
        like (M, N, K, D).
    """
    x, layout = real_array(hypotheses, "hypotheses"), Layout(HYPOTHESES if axes is None else axes, HYPOTHESES)
    if x.ndim != len(layout.groups) or 0 in x.shape or layout.shape(x.shape)[2] != len(joints):
        letters = ", ".join(group if len(group) == 1 else f"({group})" for group in layout.groups)
        raise PoseDataError(
            f"hypotheses: {x.shape}; expected ({letters}) with the K = {len(joints)} joints of the map."
        )
    if axes is None:
        refuse_exchanged("hypotheses", x.shape, poses)
    rows = np.arange(layout.shape(x.shape)[1])
    if problem := column_problem("hypotheses", layout.read(MemoryArray(x), rows[:8]), "axes", layout.text):
        raise PoseDataError(problem)
    paper = layout.read(MemoryArray(x), rows).astype(working_dtype(x.dtype), copy=False)
    refuse_unusable("hypotheses", paper)
    return paper, layout, layout.clip_length(x.shape)


def refuse_exchanged(name: str, shape: tuple[int, ...], poses: int) -> None:
    """Refuse hypotheses of no declared layout that look like (M, N, K, D), by the number of poses of the fit.

    Raises
    ------
    PoseDataError
        With the layouts to choose from.
    """
    if shape[0] == poses != shape[1]:
        raise PoseDataError(
            f"{name}: {shape}; expected (N, M, K, D), but the first axis has the {poses} poses of the fit. "
            f"Pass {option('axes', 'MNKD')} or {option('axes', HYPOTHESES)}."
        )


def refuse_unusable(name: str, hypotheses: FloatArray, valid: BoolArray | None = None, start: int = 0) -> None:
    """Refuse hypotheses that a map can't be applied to.

    Parameters
    ----------
    name : str
        What messages call them.
    hypotheses : array (N, m, K, D)
        Some of them; NaN in all hypotheses of a joint stand for one that is not known.
    valid : bool array (m, K), optional
        The joints that are known; the others may hold anything.
    start : int
        The number of the first pose.

    Raises
    ------
    PoseDataError
        For coordinates that are infinite or beyond 1e7, and joints that only some hypotheses have: their median and
        spread would be those of fewer.
    """
    flat = hypotheses.reshape(-1)
    if np.vdot(flat, flat) < LARGEST**2:  # one fast pass; true of nearly every array
        return
    is_nan = np.isnan(hypotheses)
    beyond: BoolArray = np.asarray((is_outside(hypotheses) & ~is_nan).any(axis=(0, 3)))
    lacking: BoolArray = np.asarray((is_nan.any(axis=0) & ~is_nan.all(axis=0)).any(axis=-1))
    for bad, what in (
        (beyond, "infinite coordinates or some beyond 10 km (1e7 mm)"),
        (lacking, "joints of which some hypotheses are absent (NaN)"),
    ):
        found = np.flatnonzero((bad if valid is None else bad & valid).any(axis=1))
        if len(found):
            raise PoseDataError(
                f"{name} has {what} (first: frame {start + found[0]}); expected numbers, or NaN in all hypotheses for "
                "what is not known. Leave these frames out."
            )
