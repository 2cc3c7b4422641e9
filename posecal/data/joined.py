"""Pose data of several sources as one, whose hypotheses are read where they lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.pose_data import PoseData
from posecal.data.remarks import join_remarks
from posecal.data.stored_poses import Hypotheses, Rows


@dataclass(frozen=True)
class JoinedHypotheses:
    """Hypotheses of several sources, read some poses at a time.

    Attributes
    ----------
    parts : tuple of Hypotheses
        The sources, of as many hypotheses.
    source, row : arrays of int (M,)
        Where each pose lies: in which of them, and its number there.
    """

    parts: tuple[Hypotheses, ...]
    source: Rows
    row: Rows

    @property
    def n_hypotheses(self) -> int:
        """N."""
        return self.parts[0].n_hypotheses

    @property
    def itemsize(self) -> int:
        """Bytes of a stored coordinate, by which windows are measured."""
        return max(part.itemsize for part in self.parts)

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        source, row = self.source[start:stop], self.row[start:stop]
        found = []
        for number in np.unique(source):
            rows = row[source == number]
            found.append(self.parts[number].select(rows).read(0, len(rows)))
        together = np.concatenate(found, axis=1)
        return together if len(found) == 1 else together[:, np.argsort(np.argsort(source, kind="stable"))]

    def select(self, poses: Rows) -> JoinedHypotheses:
        """Keep some poses, by their numbers."""
        return replace(self, source=self.source[poses], row=self.row[poses])


def join_poses(parts: Sequence[PoseData]) -> PoseData:
    """Put the poses of several sources after one another; at least one, which describe their poses alike."""
    if len(parts) == 1:
        return parts[0]
    first, sizes = parts[0], [len(part.truth) for part in parts]
    members: dict[str, Any] = {}
    for name in ("truth", "frame_id", "order", "occluded", "log_prob", "scores", "weights", "where", "usable"):
        values = [_member(part, name, parts) for part in parts]
        members[name] = None if values[0] is None else np.concatenate(values, axis=-1 if name in _OF_HYPOTHESES else 0)
    references = [part.reference for part in parts if part.reference is not None]
    return first.replace(
        **members,
        hypotheses=_join([part.hypotheses for part in parts], sizes),
        labels={name: np.concatenate([part.labels[name] for part in parts]) for name in first.labels},
        remarks=join_remarks(remark for part in parts for remark in part.remarks),
        reference=join_poses(references) if references else None,
    )


def _join(parts: Sequence[Any], sizes: Sequence[int]) -> Hypotheses:
    """Join hypotheses of so many poses each; samples of climatology can do so by themselves."""
    if hasattr(parts[0], "joined"):
        joined: Hypotheses = parts[0].joined(parts)
        return joined
    rows = np.concatenate([np.arange(size) for size in sizes])
    return JoinedHypotheses(tuple(parts), np.repeat(np.arange(len(parts)), sizes), rows)


_OF_HYPOTHESES = ("scores", "weights")


def _member(data: PoseData, name: str, parts: Sequence[PoseData]) -> Any:
    """Give a member of pose data, or what stands for it where others of the parts have one."""
    value = getattr(data, name)
    if value is not None or all(getattr(part, name) is None for part in parts):
        return value
    n, m, k, _ = data.shape
    if name == "weights":
        return np.full((n, m), 1 / n)
    return np.ones((m, k), dtype=bool) if name == "where" or data.where is None else data.where
