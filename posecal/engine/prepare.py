"""Preparation of pose data: the poses and joints that count, and what depends on the whole set."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.degenerate import LARGEST, LARGEST_ANGLE, is_outside, refuse_one_point
from posecal.data.pose_data import PoseData
from posecal.data.remarks import Count, Example, Remark
from posecal.data.root import resting_joints, root_joints, root_name
from posecal.engine.block import Block
from posecal.engine.cells import RUNS, SPREAD, label_name, spread_cuts, spread_labels
from posecal.engine.chunks import map_blocks, read_chunks
from posecal.engine.coordinate_range import CoordinateRange, coordinate_range
from posecal.engine.protocol import Protocol, named_joints
from posecal.engine.true_clips import TrueClips, true_clips
from posecal.errors import PoseDataError, checked_type, first_few, option

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Prepared:
    """What depends on all poses that are evaluated together.

    Attributes
    ----------
    limits : CoordinateRange
        Of the true poses.
    sequences : dict
        The number of each sequence in it, by name; empty where each pose is its own.
    n_poses : int
        How many poses these are.
    first : int or None
        Of a part of them: the number of its first pose, from which runs of poses without sequences are counted.
    cuts : mapping of arrays
        The cuts of the predicted spread, mm, by entries of ``by``.
    clips : TrueClips or None
        The true clips; None where the last observed poses before them are not known.
    unsummed : frozenset of str
        Of a part of them: labels of which no sums are kept, since they split a sequence of the whole set.
    """

    limits: CoordinateRange
    sequences: dict[str, int]
    n_poses: int = 0
    first: int | None = None
    cuts: Mapping[str, FloatArray] = field(default_factory=dict)
    clips: TrueClips | None = None
    unsummed: frozenset[str] = frozenset()

    @classmethod
    def joined(cls, parts: Sequence[Prepared]) -> Prepared:
        """Put together what was found of parts of a test set, in their order."""
        names: dict[str, int] = {}
        limits, n_poses = [], 0
        for part in parts:
            numbers = n_poses + np.arange(part.n_poses)
            if part.sequences:
                numbers = np.array([names.setdefault(name, len(names)) for name in part.sequences])
            limits.append(part.limits._replace(reached_by=numbers[part.limits.reached_by]))
            n_poses += part.n_poses
        clips = TrueClips.joined([part.clips for part in parts])
        return cls(CoordinateRange.joined(limits), names, n_poses, clips=clips)

    @property
    def hash(self) -> str:
        """Equal where two were prepared with poses of the same range."""
        ends = (np.asarray(end, dtype=np.float64).tobytes() for end in self.limits)
        return f"{zlib.crc32(b''.join([*ends, repr(self.sequences).encode(errors='surrogatepass')])):08x}"

    @property
    def hashes(self) -> dict[str, str]:
        """Hashes of its parts, by the need of metrics that each meets."""
        found = {"coordinate range": self.hash}
        if self.clips is not None:
            found["true clips"] = self.clips.hash
        if self.first is not None:
            found[RUNS] = self.hash
        return found


def prepare(data: PoseData) -> Prepared:
    """Find the range of all true poses and their clips, as metrics that depend on the whole set need them.

    Parameters
    ----------
    data : PoseData
        All poses.

    Returns
    -------
    Prepared
        For :class:`posecal.Evaluation`.
    """
    checked_type(data, "data", PoseData)
    names, own = np.zeros(0, dtype=np.str_), np.arange(len(data.truth))
    if "sequence" in data.labels:
        names, own = np.unique(data.labels["sequence"], return_inverse=True)
    limits = coordinate_range(data.truth, data.where, root=data.root, sequence=own)
    numbers = {str(name): number for number, name in enumerate(names)}
    return Prepared(limits, numbers, len(own), clips=true_clips(data))


def add_spread_labels(
    data: PoseData,
    by: Sequence[str],
    spread: Callable[[Block], FloatArray],
    threads: int | None,
    prepared: Prepared | None = None,
    *,
    is_all: bool,
) -> PoseData:
    """Add the labels of entries of ``by`` that cut poses by their predicted spread.

    Parameters
    ----------
    data : PoseData
        Poses.
    by : sequence of str
        Labels by which poses will be grouped.
    spread : callable
        The predicted spread of the poses of a block, (B,), mm.
    threads : int or None
        One per core by default.
    prepared : Prepared, optional
        With cuts that are known.
    is_all : bool
        Whether these are all poses, so that parts of equal size can be cut.

    Returns
    -------
    PoseData
        With labels.
    """
    entries = [entry for entry in by if SPREAD.match(entry) and label_name(entry) not in data.labels]
    if not entries:
        return data
    values = np.concatenate(list(map_blocks(data, spread, threads)))
    known = {} if prepared is None else prepared.cuts
    cuts = {e: known[e] if e in known else spread_cuts(e, values if is_all else None) for e in entries}
    parts = {label_name(e): spread_labels(cuts[e], values) for e in entries}
    return data.replace(labels={**data.labels, **parts})


def select_scored(data: PoseData, protocol: Protocol) -> PoseData:
    """Keep the poses and joints that the options ``frames`` and ``where`` name.

    Parameters
    ----------
    data : PoseData
        Poses.
    protocol : Protocol
        The options.

    Returns
    -------
    PoseData
        With the mask of the joints that count.

    Raises
    ------
    PoseDataError
        Where the data lack the label or the mask, or the truth is not finite where it counts.

    See Also
    --------
    lack_of_scored : whether anything is left.
    """
    name = data.names[1]
    if protocol.frames != "all":
        values = data.labels.get(protocol.frames)
        if values is None:
            raise PoseDataError(
                f"frames: {name} has no label {protocol.frames!r}; expected a yes/no member (M,) of that name."
            )
        data = data.select(np.flatnonzero(np.isin(np.char.lower(values), ("yes", "1", "true"))))
    data = _with_trials(data, protocol)
    data = _with_counting_root(data, is_masked=protocol.where != "all")
    where, usable = data.where, None
    if protocol.where != "all":
        if data.occluded is None:
            raise PoseDataError(
                f"where: {name} does not say which joints are occluded; expected a member occluded or visible, "
                "bool (M, K)."
            )
        scored = data.occluded if protocol.where == "occluded" else ~data.occluded
        usable = np.ones_like(scored) if where is None else where
        where = scored if where is None else scored & where
    data, where = _without_lone_roots(data, where, protocol)
    bad = is_outside(data.truth, _limit(data)).any(axis=2)
    refuse_non_finite(data, name, np.argwhere(bad if where is None else bad & where))
    refuse_one_point(data.truth, where, data.frame_id, name)
    return data.replace(where=where, usable=usable)


def _with_trials(data: PoseData, protocol: Protocol) -> PoseData:
    """Take labels of the average that differ after their first word as one, or remark on them."""
    name = protocol.average
    if name in {"poses", "sequence"} or name not in data.labels:
        return data
    values, inverse = np.unique(data.labels[name], return_inverse=True)
    first = np.array([value.split()[0] if value.split() else value for value in values.tolist()])
    if protocol.trials == "together":
        remarks = (*data.remarks, *_numbered_remarks(name, np.unique(first).tolist()))
        return data.replace(labels={**data.labels, name: first[inverse]}, remarks=remarks)
    words, counts = np.unique(first, return_counts=True)
    if (counts > 1).any():
        shared = values[first == words[counts > 1][0]].tolist()
        remark = Remark(
            f"average: values of {name} that differ after their first word alone (",
            Example(first_few(shared)),
            f"). {option('trials', 'together')} takes those as one.",
        )
        return data.replace(remarks=(*data.remarks, remark))
    return data.replace(remarks=(*data.remarks, *_numbered_remarks(name, values.tolist())))


def _numbered_remarks(name: str, values: Sequence[str]) -> list[str]:
    """Remark on some labels that differ in case or in a number at their end alone, unless all do, as numbers do."""
    if name in {"subject", "camera", "clip"}:  # which have numbers in their names
        return []
    stems = [re.sub(r"[\W_]*\d+$", "", value).casefold() for value in values]
    alike = next((stem for stem in stems if stems.count(stem) > 1), "")
    if not alike or len({*stems}) == 1:
        return []
    shared = first_few([value for value, stem in zip(values, stems, strict=True) if stem == alike])
    words = f"average: values of {name} that differ in case or in a number at their end alone ("
    end = ") are taken as several. Where they are trials of one, give them one name."
    return [Remark(words, Example(shared), end)]


def _with_counting_root(data: PoseData, *, is_masked: bool) -> PoseData:
    """Leave out poses whose root does not count: all their joints would be relative to a joint that is not known."""
    if data.root is None or (data.where is None and not is_masked):
        return data
    joints = root_joints(data.root)
    lost: BoolArray = np.asarray(is_outside(data.truth[:, joints], _limit(data)).any(axis=(1, 2)))
    if data.where is not None:
        lost |= ~data.where[:, joints].all(axis=1) & data.where.any(axis=1)
    if not lost.any():
        return data
    root = root_name(data.root, data.joints)
    remark = Remark(
        f"the root {root} does not count in ",
        Count(int(lost.sum()), "frame", of=len(lost)),
        " (first: ",
        Example.of(data.frame_id[lost].tolist()),
        "): left out, since their positions are relative to it.",
    )
    return data.select(~lost).replace(remarks=(*data.remarks, remark))


def _without_lone_roots(
    data: PoseData, where: BoolArray | None, protocol: Protocol
) -> tuple[PoseData, BoolArray | None]:
    """Mask poses of which only the root is scored: relative to itself it is right whatever the hypotheses are."""
    resting = resting_joints(data.root)
    if where is None or not resting or len(resting) == where.shape[1]:
        return data, where
    scored = where
    if protocol.joints != "all":
        scored = where & np.isin(data.joints, named_joints("joints", protocol.joints, data.joints))
    alone: BoolArray = np.asarray(scored.any(axis=1) & ~np.delete(scored, resting, axis=1).any(axis=1))
    if not alone.any():
        return data, where
    remark = Remark(
        f"only the root {root_name(data.root, data.joints)} counts in ",
        Count(int(alone.sum()), "frame", of=len(alone)),
        " (first: ",
        Example.of(data.frame_id[alone].tolist()),
        "): left out, since its error is 0 relative to itself.",
    )
    return data.replace(remarks=(*data.remarks, remark)), where & ~alone[:, None]


def lack_of_scored(data: PoseData, protocol: Protocol) -> str:
    """Say that :func:`select_scored` left no pose or no joint; nothing where it left some."""
    if not len(data.truth):
        if protocol.frames == "all":
            return f"where: the root of {data.names[1]} counts in no frame; expected some."
        return f"frames: no pose of {data.names[1]} has the label {protocol.frames}; expected some."
    if data.where is not None and not data.where.any():
        what = "counts" if protocol.where == "all" else f"is {protocol.where}"
        return f"where: no joint of {data.names[1]} {what}; expected some to score."
    return ""


def _limit(data: PoseData) -> float:
    return LARGEST_ANGLE if data.unit == "deg" else LARGEST


def refuse_non_finite(data: PoseData, name: str, bad: Indices) -> None:
    """Refuse coordinates that are not finite, at (pose, joint) pairs.

    Raises
    ------
    PoseDataError
        Where there are any.
    """
    if len(bad):
        frames, (frame, joint) = len(np.unique(bad[:, 0])), bad[0]
        sources = data.hypotheses, *([] if data.reference is None else [data.reference.hypotheses])
        poses = [data.truth[frame], *(source.read(int(frame), int(frame) + 1)[:, 0] for source in sources)]
        for root in root_joints(data.root):
            if not all(np.isfinite(pose[..., root, :]).all() for pose in poses):
                joint = root  # which makes all others so
        is_finite = all(np.isfinite(pose[..., joint, :]).all() for pose in poses)
        beyond = "angles beyond 100,000 degrees" if data.unit == "deg" else "coordinates beyond 10 km (1e7 mm)"
        what = beyond if is_finite else "non-finite coordinates"
        raise PoseDataError(
            f"{name} has {what} in {frames:,} of {len(data.truth):,} frames (first: frame "
            f"{data.frame_id[frame]}, joint {data.joints[joint].removeprefix('joint ')}). Mask those joints (in a "
            "file by a member valid (M, K), in Python also by where), or leave those frames out."
        )


def all_within(data: PoseData) -> bool:
    """Whether all coordinates of hypotheses, and of the reference's, are finite and not too large: in one fast pass."""
    for some in (data,) if data.reference is None else (data, data.reference):
        for chunk in read_chunks(some.replace(reference=None)):
            x = chunk.hypotheses
            x = x.transpose(np.argsort(x.strides)[::-1])  # as it lies in memory
            x = x.reshape(len(x), -1)
            with np.errstate(over="ignore", invalid="ignore"):
                if not np.vecdot(x, x).max() < _limit(data) ** 2:  # True for NaN
                    return False
    return True


def refuse_non_finite_hypotheses(data: PoseData) -> None:
    """Refuse a batch with coordinates that are not finite, or its reference's, before any of it is counted.

    Raises
    ------
    PoseDataError
        Where a joint that counts has one.
    """
    if all_within(data):
        return
    for some in (data,) if data.reference is None else (data, data.reference):
        start, bad = 0, np.zeros((0, 2), dtype=np.intp)
        for chunk in read_chunks(some.replace(reference=None)):
            places = np.argwhere(is_outside(chunk.hypotheses, _limit(data)).any(axis=(0, 3)))
            bad = np.concatenate([bad, places + np.array([start, 0])])
            start += len(chunk)
        refuse_non_finite(data, some.names[0], bad if data.where is None else bad[data.where[tuple(bad.T)]])
