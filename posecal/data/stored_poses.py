"""Poses as they are stored or passed, with what is declared about them, and hypotheses read from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.layout import Layout, LazyArray

COMMON_LABELS = frozenset(("sequence", "clip", "subject", "action", "camera"))
"""Names under which a file can only mean a label of every pose."""

Labels = Mapping[str, npt.NDArray[np.str_]]
Rows = npt.NDArray[np.intp]

RUN = 8
"""Poses of a sample that are read together."""


@dataclass(frozen=True)
class StoredPoses:
    """Poses as they are stored or passed, with what is declared about them.

    Attributes
    ----------
    name : str
        What messages call them: a file or an argument.
    array : LazyArray
        The coordinates, in any layout.
    axes, unit : str or None
        What is declared.
    joints : tuple of str or None
        Names of the joints.
    parents : tuple of int or str, or None
        The number or name of each joint's parent, -1 or an empty name for a root.
    frame_id : array of str (M,) or None
        Name of each frame.
    labels : mapping of arrays of str, (M,) or () for all
        Other properties of each frame.
    required_labels : set of str
        The labels that must have a value per pose; lists of other lengths under other names are not labels.
    marks : mapping of bool arrays (M, K)
        ``occluded`` or ``visible``.
    where : bool array (M, K) or None
        The joints that count.
    valid : bool array (M, K) or (M,) or None
        The joints, or the poses, that are known; the others may hold anything.
    scores : array (N, M) or None
        The model's score of each hypothesis.
    log_prob : array (M,) or None
        The model's log density at the true pose, nats, of coordinates in the unit.
    dimensions : int or None
        The number of coordinates that the density is over.
    weights : array (N, M) or None
        The weight of each hypothesis, of sum 1 for each pose.
    fps : float or None
        Frames per second.
    recalibrated_on : array (H,) or None
        Hashes of the poses that the map was fitted on which recalibrated them; see :mod:`posecal.data.fitted_poses`.
    observed : array or None
        The last observed pose before each clip.
    unread : mapping of tuples of int
        The shapes of other members of several axes, by name, which nothing reads.
    """

    name: str
    array: LazyArray
    axes: str | None = None
    unit: str | None = None
    joints: tuple[str, ...] | None = None
    parents: tuple[int | str, ...] | None = None
    frame_id: npt.NDArray[np.str_] | None = None
    labels: Labels = field(default_factory=dict)
    required_labels: frozenset[str] = COMMON_LABELS
    marks: Mapping[str, BoolArray] = field(default_factory=dict)
    where: BoolArray | None = None
    valid: BoolArray | None = None
    scores: FloatArray | None = None
    log_prob: FloatArray | None = None
    dimensions: int | None = None
    weights: FloatArray | None = None
    fps: float | None = None
    recalibrated_on: npt.NDArray[np.uint64] | None = None
    observed: npt.NDArray[np.generic] | None = None
    unread: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    @property
    def frame_members(self) -> dict[str, npt.NDArray[np.generic]]:
        """What is declared about the frames, without their coordinates, as members of a file."""
        others: dict[str, object] = {"frame_id": self.frame_id, "scores": self.scores, "weights": self.weights}
        others |= {"fps": self.fps, "valid": self.valid}
        return {**self.labels, **self.marks, **{k: np.asarray(v) for k, v in others.items() if v is not None}}


class Hypotheses(Protocol):
    """N hypotheses of M poses, read some poses at a time."""

    @property
    def n_hypotheses(self) -> int:
        """N."""

    @property
    def itemsize(self) -> int:
        """Bytes of a stored coordinate, by which windows are measured."""

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""

    def select(self, poses: Rows) -> Hypotheses:
        """Keep some poses, by their numbers."""


@dataclass(frozen=True)
class ArrayHypotheses:
    """Hypotheses in an array in memory or in a file, read some poses at a time.

    Attributes
    ----------
    array : LazyArray
        As stored.
    layout : Layout
        Its axes.
    rows, columns : arrays of int
        The stored poses and joints that count, in the order in which they count.
    factor : float
        Millimetres in its unit.
    n_hypotheses : int
        How many are read, the first ones.
    """

    array: LazyArray
    layout: Layout
    rows: Rows
    columns: Rows
    factor: float
    n_hypotheses: int

    @property
    def itemsize(self) -> int:
        """Bytes of a stored coordinate."""
        return self.array.dtype.itemsize

    def select(self, poses: Rows) -> ArrayHypotheses:
        """Keep some poses, by their numbers."""
        return replace(self, rows=self.rows[poses])

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        hypotheses = self.layout.read(self.array, self.rows[start:stop])[: self.n_hypotheses]
        if not np.array_equal(self.columns, np.arange(hypotheses.shape[2])):
            hypotheses = hypotheses[:, :, self.columns]
        return in_millimetres(hypotheses, self.factor)


def in_millimetres(stored: npt.NDArray[np.generic], factor: float) -> FloatArray:
    """Give stored coordinates as real numbers in mm; single precision stays single."""
    single = stored.dtype.kind == "f" and stored.dtype.itemsize <= 4
    lengths: FloatArray = stored.astype(np.float32 if single else np.float64, copy=False)
    return lengths if factor == 1 else lengths * lengths.dtype.type(factor)


def sample_rows(m: int, number: int) -> Rows:
    """Choose about so many of m poses, in runs of eight that lie evenly: what is stored in chunks is read in few."""
    if number >= m:
        return np.arange(m)
    runs = max(1, number // RUN)
    starts = np.linspace(0, m - min(RUN, number), runs).astype(np.intp)
    return np.unique(starts[:, None] + np.arange(min(RUN, number)))
