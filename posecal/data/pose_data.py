"""What is evaluated: poses as somebody stored or passed them, and the pairs that they become.

:class:`Poses` says what was declared about an array; :class:`PoseData` has no files, units, axes or joint orders
any more. :mod:`posecal.data.match` makes the second of two of the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.layout import Layout, LazyArray
from posecal.errors import PoseDataError

__all__ = ["COMMON_LABELS", "Hypotheses", "Labels", "PoseData", "Rows", "Stored", "StoredPoses"]

COMMON_LABELS = ("sequence", "subject", "action", "camera")
"""Names under which a file can only mean a label of every pose."""

Labels = Mapping[str, npt.NDArray[np.str_]]
Rows = npt.NDArray[np.intp]


@dataclass(frozen=True)
class StoredPoses:
    """Poses as they were stored or passed, with what was declared about them.

    Attributes
    ----------
    name : str
        What messages call them: a file or an argument.
    array : LazyArray
        The coordinates, in any layout.
    axes, unit : str or None
        What was declared.
    joints : tuple of str or None
        Names of the joints.
    frame_id : array of str (M,) or None
        What each frame is called.
    labels : mapping of arrays of str (M,)
        Other things said of each frame.
    marks : mapping of bool arrays (M, K)
        ``occluded`` or ``visible``.
    scores : array (N, M) or None
        The model's score of each hypothesis.
    fps : float or None
        Frames per second.
    """

    name: str
    array: LazyArray
    axes: str | None = None
    unit: str | None = None
    joints: tuple[str, ...] | None = None
    frame_id: npt.NDArray[np.str_] | None = None
    labels: Labels = field(default_factory=dict)
    marks: Mapping[str, BoolArray] = field(default_factory=dict)
    scores: FloatArray | None = None
    fps: float | None = None

    @property
    def beside(self) -> dict[str, npt.NDArray[np.generic]]:
        """What is said of the frames beside their coordinates, as members of a file."""
        found: dict[str, npt.NDArray[np.generic]] = {**self.labels, **self.marks}
        if self.frame_id is not None:
            found["frame_id"] = self.frame_id
        if self.scores is not None:
            found["scores"] = self.scores
        if self.fps is not None:
            found["fps"] = np.array(self.fps)
        return found


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

    def taken(self, poses: Rows) -> Hypotheses:
        """Keep some poses, by their numbers."""


@dataclass(frozen=True)
class Stored:
    """Hypotheses where they lie, and how to read some poses of them.

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
    most : int or None
        How many hypotheses are read, the first ones; all by default.
    """

    array: LazyArray
    layout: Layout
    rows: Rows
    columns: Rows
    factor: float
    most: int | None = None

    @property
    def n_hypotheses(self) -> int:
        """N."""
        return self.most or self.layout.shape(self.array.shape)[0]

    @property
    def itemsize(self) -> int:
        """Bytes of a stored coordinate."""
        return self.array.dtype.itemsize

    def taken(self, poses: Rows) -> Stored:
        """Keep some poses, by their numbers."""
        return replace(self, rows=self.rows[poses])

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        found = self.layout.read(self.array, self.rows[start:stop])[: self.most]
        if not np.array_equal(self.columns, np.arange(found.shape[2])):
            found = found[:, :, self.columns]
        return in_millimetres(found, self.factor)


def in_millimetres(stored: npt.NDArray[np.generic], factor: float) -> FloatArray:
    """Give stored coordinates as real numbers in mm; single precision stays single."""
    single = stored.dtype.kind == "f" and stored.dtype.itemsize <= 4
    found: FloatArray = stored.astype(np.float32 if single else np.float64, copy=False)
    return found if factor == 1 else found * found.dtype.type(factor)


@dataclass(frozen=True)
class PoseData:
    """M poses with N hypotheses each: in mm, in one order of frames and joints.

    Attributes
    ----------
    hypotheses : Hypotheses
        Read some poses at a time.
    truth : array (M, K, D)
        True poses, mm.
    joints : tuple of str
        K names, as :mod:`posecal.data.skeleton` spells them; numbered where there are none.
    root : int or None
        The joint to subtract from every pose.
    frame_id : array of str (M,)
        What each pose is called.
    place : array of int (M,)
        Its place among the truth's frames, as they were stored: two poses are consecutive where their places are.
    labels : mapping of arrays of str (M,)
        What else is said of each pose.
    occluded : bool array (M, K) or None
        The joints whose keypoints were not seen.
    scores : array (N, M) or None
        The model's score of each hypothesis.
    fps : float or None
        Frames per second.
    where : bool array (M, K) or None
        The joints that count.
    usable : bool array (M, K) or None
        The joints that poses are aligned by, where some of them don't count; by default those that count.
    names : tuple of two str
        What messages call the hypotheses and the truth.
    remarks : tuple of str
        What a careful reader should know about the join.
    reference : PoseData or None
        The same poses with other hypotheses, that skills are relative to.
    """

    hypotheses: Hypotheses
    truth: FloatArray
    joints: tuple[str, ...]
    root: int | None
    frame_id: npt.NDArray[np.str_]
    place: Rows
    labels: Labels
    occluded: BoolArray | None
    scores: FloatArray | None
    fps: float | None
    names: tuple[str, str]
    where: BoolArray | None = None
    usable: BoolArray | None = None
    remarks: tuple[str, ...] = ()
    reference: PoseData | None = None

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(N, M, K, D)."""
        m, k, d = self.truth.shape
        return self.hypotheses.n_hypotheses, m, k, d

    def taken(self, poses: Rows) -> PoseData:
        """Keep some poses, by their numbers."""
        return replace(
            self,
            hypotheses=self.hypotheses.taken(poses),
            truth=self.truth[poses],
            frame_id=self.frame_id[poses],
            place=self.place[poses],
            labels={name: values[poses] for name, values in self.labels.items()},
            occluded=None if self.occluded is None else self.occluded[poses],
            scores=None if self.scores is None else self.scores[:, poses],
            where=None if self.where is None else self.where[poses],
            usable=None if self.usable is None else self.usable[poses],
            reference=None if self.reference is None else self.reference.taken(poses),
        )

    def with_hypotheses(self, most: int) -> PoseData:
        """Keep the first hypotheses of every pose.

        Raises
        ------
        PoseDataError
            Where there are fewer, or the hypotheses don't come from an array.
        """
        n = self.shape[0]
        if not 1 <= most <= n or not isinstance(self.hypotheses, Stored):
            raise PoseDataError(f"hypotheses: {most}; expected 1 to N = {n}, the hypotheses of {self.names[0]}.")
        scores = None if self.scores is None else self.scores[:most]
        return replace(self, hypotheses=replace(self.hypotheses, most=most), scores=scores)
