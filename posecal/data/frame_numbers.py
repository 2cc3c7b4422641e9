"""Numbers of frames in their names: the order of the frames of each sequence, and which of them follow each other."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from posecal.data.clips import continue_numbers
from posecal.data.remarks import Example, Remark, join_remarks
from posecal.data.stored_poses import Rows

if TYPE_CHECKING:
    from posecal.data.pose_data import PoseData

Names = npt.NDArray[np.str_]

_LARGEST = 2**62
"""Numbers from here on are none of frames."""

_BEFORE = 8
"""How many earlier frames tell the step between frame numbers to a batch."""

STEPS = "frame numbers are "
"""How the remark begins on numbers that are more than one apart."""

Place = tuple[int, list[str], str, int]
"""Where a batch ends: the order of a pose that follows; the last frames that have numbers, and their sequence; the
number of clips that a layout has had."""


def order_by_number(names: Names, sequence: Names, n_before: int = 0) -> tuple[Rows, Rows, list[str]] | None:
    """Order frames by their sequence, which came first, and the number in their names.

    Parameters
    ----------
    names, sequence : arrays of str (M,)
        Name and sequence of each frame.
    n_before : int
        How many of them, the first ones, came before in this order; what is given is of the others.

    Returns
    -------
    rows : array of int (M - n_before,)
        The frames in that order.
    order : array of int (M - n_before,)
        A rising number of each of them, which differs by 1 where a frame follows the one before it: in its sequence,
        and one step later. A step is the smallest difference of two numbers of the sequence. The first is 0 where it
        follows what came before, or nothing did.
    remarks : list of str
        Where steps are not 1.

    Or None, where the names of a sequence hold no numbers that tell its frames apart.
    """
    values, first, codes = np.unique(sequence, return_index=True, return_inverse=True)
    numbers = np.zeros(len(names), dtype=np.int64)
    by_sequence = np.split(np.argsort(codes, kind="stable"), np.cumsum(np.bincount(codes))[:-1])
    for rows in by_sequence:
        found = _numbers(names[rows].tolist())
        if found is None:
            return None
        numbers[rows] = found
    own = np.arange(n_before, len(names))
    rows = np.concatenate([np.arange(n_before), own[np.lexsort((numbers[own], first[codes[own]]))]])
    steps, later = np.diff(numbers[rows]), codes[rows][1:]
    within = (later == codes[rows][:-1]) & (steps > 0)
    step = np.full(len(values), _LARGEST)
    np.minimum.at(step, later[within], steps[within])
    order = np.concatenate([[0], np.cumsum(np.where(within & (steps == step[later]), 1, 2))])
    if n_before:
        order = order[n_before:] - order[n_before - 1] - 1
    return rows[n_before:] - n_before, order, _remarks(values, step)


def continued(data: PoseData, n_given: int, place: Place) -> tuple[PoseData, Place]:
    """Put a batch in the order of its frame numbers, if it has any, and let its ``order`` continue the one before.

    Frames of clips stay as they lie in the axis T.

    Parameters
    ----------
    data : PoseData
        The batch.
    n_given : int
        How many poses came, those among them that were dropped.
    place : Place
        Where the batch before ended.
    """
    start, names, sequence, n_clips = place
    if (clips := data.clips) is not None:
        data = data.replace(labels=continue_numbers(data.labels, clips, n_clips))
        n_clips, n_given = n_clips + clips.stored, clips.stored * clips.length
    ordered = None
    if data.has_frame_id and clips is None and "sequence" in data.labels:
        sequences = np.concatenate([np.full(len(names), sequence), data.labels["sequence"]])
        ordered = order_by_number(np.concatenate([np.array(names, str), data.frame_id]), sequences, len(names))
    if ordered is None:
        return data.replace(order=data.order + start), (start + n_given, [], "", n_clips)
    rows, order, remarks = ordered
    data = data.select(rows).replace(order=order + start, remarks=join_remarks([*data.remarks, *remarks]))
    last = str(data.labels["sequence"][-1])
    names = [*names * (last == sequence), *data.frame_id[data.labels["sequence"] == last].tolist()]
    return data, (start + int(order[-1]) + 1, names[-_BEFORE:], last, n_clips)


def _remarks(values: Names, step: Rows) -> list[str]:
    """Say which sequences have steps of more than one frame."""
    long = (step > 1) & (step < _LARGEST)
    if not long.any():
        return []
    lengths = np.unique(step[step < _LARGEST])
    found = f"{lengths[lengths > 1][0]} apart"
    if len(lengths) > 1:  # not of all sequences
        names = values[step == lengths[lengths > 1][0]].tolist()
        found += f" in {names[0]}{' and others' * (len(names) > 1)}"
    return [Remark(STEPS, Example(found), ": velocities are of steps of so many frames.")]


def _numbers(names: list[str]) -> list[int] | None:
    """Give the number in each name that varies between them, or the last one where they rise by it; else None."""
    parts = [re.split("([0-9]+)", name) for name in names]
    numbers = [[int(number) for number in part[1::2]] for part in parts]
    if max((max(some, default=0) for some in numbers), default=0) >= _LARGEST:
        return None
    if len({tuple(part[::2]) for part in parts}) == 1:
        if len(names) == 1:
            return [0]
        varying = {column for column in zip(*numbers, strict=True) if len({*column}) > 1}
        if len(varying) == 1 and len({*(column := varying.pop())}) == len(names):
            return list(column)
    last = [some[-1] for some in numbers if some]
    is_rising = len(last) == len(names) and all(one < other for one, other in pairwise(last))
    return last if is_rising else None
