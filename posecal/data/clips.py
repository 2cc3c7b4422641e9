"""Clips: runs of consecutive poses that are predicted together, such as the frames after an observation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray, as_array, as_labels
from posecal.data.layout import Layout
from posecal.data.remarks import Count, Example, Remark
from posecal.data.stored_poses import Labels, Rows, StoredPoses, in_millimetres
from posecal.errors import PosecalError, PoseDataError

if TYPE_CHECKING:
    from posecal.data.pose_data import PoseData

Names = npt.NDArray[np.str_]


@dataclass(frozen=True)
class Clips:
    """What clips of poses have in common.

    Attributes
    ----------
    length : int
        T, the most poses that a clip has.
    numbered : tuple of str
        The labels that are made of the numbers of the clips.
    has_axis : bool
        Whether the layout has a T, so that every clip is whole.
    stored : int
        How many clips the truth holds, those that are not evaluated among them; 0 where the layout has no T.
    observed : mapping of arrays (K, D)
        The last observed pose before each clip, by the clip's name, in the unit of the poses; empty where unknown.
    """

    length: int
    numbered: tuple[str, ...] = ()
    has_axis: bool = False
    stored: int = 0
    observed: Mapping[str, FloatArray] = field(default_factory=dict)


def clip_length(layouts: tuple[Layout, Layout], hypotheses: StoredPoses, truth: StoredPoses) -> int | None:
    """Give T of a layout with clips, the truth's first; None where neither has any."""
    return layouts[1].clip_length(truth.array.shape) or layouts[0].clip_length(hypotheses.array.shape)


def with_clip_labels(labels: Labels, rows: Rows, length: int | None) -> tuple[Labels, tuple[str, ...]]:
    """Add the labels of clips that are missing: ``clip``, and ``sequence`` where each clip is one.

    Parameters
    ----------
    labels : mapping of arrays of str (M,)
        Those that are there.
    rows : array of int (M,)
        The stored poses, counted through the clips.
    length : int or None
        T of the layout; None where it has no clips.

    Returns
    -------
    labels : mapping
        With these. Clips of the same name in several sequences are several clips.
    numbered : tuple of str
        The labels that are numbers of clips.

    Examples
    --------
    >>> labels, numbered = with_clip_labels({}, np.arange(4), 2)
    >>> labels["sequence"].tolist(), numbered
    (['0', '0', '1', '1'], ('clip', 'sequence'))
    """
    numbered: tuple[str, ...] = ()
    if "clip" not in labels:
        if length is None:
            return labels, ()
        labels, numbered = {**labels, "clip": (rows // length).astype(np.str_)}, ("clip",)
    if "sequence" not in labels:
        return {"sequence": labels["clip"], **labels}, (*numbered, *("sequence",) * len(numbered))
    clip, sequence = labels["clip"], labels["sequence"]
    if len(np.unique(np.stack([clip, sequence]), axis=1).T) > len(np.unique(clip)):
        labels = {**labels, "clip": of_sequence(sequence, clip)}
    return labels, numbered


def with_horizons(labels: Labels, order: Rows, rows: Rows, length: int | None, fps: float | None) -> Labels:
    """Add the label ``horizon``, the time since the last observed pose, where there are clips and it is missing.

    It is ``40 ms`` where the frames per second are known, and else the number of the frame in its clip, from 1.
    """
    if "clip" not in labels or "horizon" in labels or not len(order):
        return labels
    _, first, codes = np.unique(labels["clip"], return_index=True, return_inverse=True)
    frame = order - order[first][codes] if length is None else rows % length
    times, numbers = np.unique(frame + 1, return_inverse=True)
    texts = [f"{round(1000 * time / fps)} ms" if fps else str(time) for time in times.tolist()]
    if len({*texts}) < len(texts):
        texts = [str(time) for time in times.tolist()]
    return {**labels, "horizon": np.array(texts)[numbers]}


def describe_clips(
    labels: Labels,
    numbered: tuple[str, ...],
    length: int | None,
    n_poses: int,
    truth: StoredPoses,
    rows: Rows,
    columns: Rows,
    n_coordinates: int,
    factor: float,
    problems: list[str | PosecalError],
) -> Clips | None:
    """Describe the clips that poses form by their label ``clip``; None where they form none.

    Parameters
    ----------
    labels : mapping of arrays of str (M,)
        Of the poses.
    numbered : tuple of str
        The labels that are numbers of clips.
    length : int or None
        T of the layout; by default the most poses that a clip has.
    n_poses : int
        How many the truth holds.
    truth : StoredPoses
        As stored, perhaps with a member ``observed``.
    rows, columns : arrays of int (M,) and (K,)
        The stored poses and joints.
    n_coordinates : int
        D.
    factor : float
        Millimetres in the unit of the truth.
    problems : list
        What does not fit is added.
    """
    if "clip" not in labels or not len(rows):
        if truth.observed is not None and "clip" not in labels:
            problems.append(f"{truth.name}: observed without clips; expected axes with a T, or a label clip.")
        return None
    names, first, counts = np.unique(labels["clip"], return_index=True, return_counts=True)
    most = int(counts.max()) if length is None else length
    clips = Clips(most, numbered, length is not None, 0 if length is None else n_poses // length)
    if (observed := truth.observed) is None:
        return clips
    number, stored = np.argsort(np.argsort(rows[first])), len(names)
    if length is not None:
        number, stored = rows[first] // length, int(rows.max()) // length + 1
    joints = int(columns.max()) + 1
    if observed.ndim != 3 or len(observed) < stored or observed.shape[1] < joints or observed.shape[2] != n_coordinates:
        problems.append(
            f"{truth.name}: observed {observed.shape}; expected the last observed pose of each clip, (M, K, D) with "
            f"M = {stored:,} clips, in the order of the truth's joints."
        )
        return None
    poses = in_millimetres(observed[number][:, columns], factor).astype(np.float64)
    if not np.isfinite(poses).all():
        problems.append(f"{truth.name}: observed has non-finite coordinates; expected the pose before each clip.")
    return replace(clips, observed=dict(zip(names.tolist(), poses, strict=True)))


def frame_names(data: PoseData, frame_id: npt.ArrayLike) -> Names:
    """Give names of the frames of poses, (M,): one each, or one for each clip.

    Raises
    ------
    PoseDataError
        For another number of names.
    """
    names, (m, length) = as_array(frame_id, "frame_id"), (len(data.truth), data.clips.length if data.clips else 1)
    is_by_clip = data.clips is not None and names.shape == (m // length, length)
    names = np.atleast_1d(as_labels(names.reshape(-1) if is_by_clip else names, "frame_id", or_one=True))
    if len(names) * length == m and data.clips is not None:
        return np.repeat(names, length)
    if len(names) != m:
        or_clips = f", or per clip, ({m // length},)" if data.clips is not None else ""
        raise PoseDataError(f"frame_id: {names.shape}; expected one name per pose, ({m},){or_clips}.")
    return names


def pose_names(data: PoseData) -> list[str]:
    """Name poses by their frames: where windows overlap, a frame is another pose at another horizon."""
    names: list[str] = data.frame_id.tolist()
    if data.clips is None or not data.clips.has_axis:
        return names
    places = data.order % data.clips.length + 1
    return [f"{name} at horizon {place}" for name, place in zip(names, places.tolist(), strict=True)]


def given_labels(data: PoseData) -> Labels:
    """Give the labels of poses but numbers of clips, which follow from their place."""
    numbered = () if data.clips is None else data.clips.numbered
    return {name: values for name, values in data.labels.items() if name not in numbered}


def select_clips(data: PoseData, rows: Rows) -> PoseData:
    """Select poses whose frames did not come before; whole clips where poses form such.

    Raises
    ------
    PoseDataError
        Where a clip would be cut.
    """
    if data.clips is not None:
        names, codes = np.unique(data.labels["clip"], return_inverse=True)
        left = np.bincount(codes[rows], minlength=len(names))
        if cut := names[(left > 0) & (left < np.bincount(codes))].tolist():
            raise PoseDataError(
                f"frame_id: frames of {len(cut):,} clips came before at the same horizon (first: clip {cut[0]}), and "
                "others of them did not; expected a name for each clip, or each frame of a recording."
            )
    return data.select(rows)


def short_clip_remarks(clips: Clips | None, clip: Names | None) -> list[str]:
    """Remark on clips of fewer than T poses."""
    if clips is None or clip is None:
        return []
    names, counts = np.unique(clip, return_counts=True)
    short = names[counts < clips.length].tolist()
    if not short:
        return []
    first = Example.of(short)
    return [
        Remark(
            "clip: ",
            Count(len(short), "clip", of=len(names)),
            f" of fewer than T = {clips.length} frames (first: ",
            first,
            "): left out of ADE, FDE and all other metrics of whole clips.",
        )
    ]


def with_names_of_set(data: PoseData, before: int, *, of_sequences: bool) -> PoseData:
    """Name the clips of a part of a test set as one run over all of it does.

    Parameters
    ----------
    data : PoseData
        The part.
    before : int
        How many clips the parts before it have, where clips have numbers.
    of_sequences : bool
        Whether clips of several sequences have one name somewhere in the set, so that each is named after its sequence.
    """
    if (clips := data.clips) is None:
        return data
    clip, labels = data.labels["clip"], continue_numbers(data.labels, clips, before)
    if of_sequences and not is_of_sequence(data):
        labels = {**labels, "clip": of_sequence(labels["sequence"], clip)}
    names = dict(zip(clip.tolist(), labels["clip"].tolist(), strict=True))
    observed = {names[name]: pose for name, pose in clips.observed.items() if name in names}
    return data.replace(labels=labels, clips=replace(clips, observed=observed))


def of_sequence(sequence: Names, clip: Names) -> Names:
    """Name clips after their sequences."""
    return np.char.add(np.char.add(sequence, " / "), clip)


def is_of_sequence(data: PoseData) -> bool:
    """Whether clips are named after their sequences."""
    starts = np.char.add(data.labels["sequence"], " / ")
    return bool(np.char.startswith(data.labels["clip"], starts).all())


def continue_numbers(labels: Labels, clips: Clips | None, before: int) -> Labels:
    """Let numbers of clips go on after those of the batches before."""
    numbered = () if clips is None or not before else clips.numbered
    return {**labels, **{name: (labels[name].astype(np.intp) + before).astype(np.str_) for name in numbered}}
