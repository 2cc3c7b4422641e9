"""What is kept of an evaluation? The sums of every statistic, per cell; never the hypotheses.

A *cell* is one combination of sequence and labels. Sums over cells add, so a report of any group of poses, of
shards that were evaluated apart, or of resampled sequences needs nothing but these sums.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.engine.metric import DataSpec, Metric, Statistic
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError, did_you_mean

__all__ = ["CURVES", "Totals", "difference_of_signatures", "mean_of", "mean_of_known"]

CURVES = ("calibration", "rank_tests")
"""Families of metrics that are read off curves."""

Cells = Mapping[str, npt.NDArray[np.str_]]


@dataclass
class Totals:
    """Sums of statistics over the poses of each of C cells.

    Attributes
    ----------
    spec : DataSpec
        What was measured.
    protocol : Protocol
        How.
    version : str
        Of posecal.
    cells : mapping of arrays of str (C,)
        The labels of each cell; ``sequence`` is always among them.
    poses : array of int (C,)
        Poses in each cell.
    remarks : tuple of str
        What a careful reader should know.
    sequences : bool
        Whether the sequences were labelled; else they are runs of consecutive frames, taken as independent.
    sums, counts : dicts of arrays (C, …) and (C,) or (C, J)
        By statistic: the sum over the poses that count, and their number.
    per_pose : dict of arrays (M, …)
        By statistic: the values of every pose, of the few that no sums replace.
    cell_of : array of int (M,)
        With them: the cell of each pose.
    """

    spec: DataSpec
    protocol: Protocol
    version: str
    cells: Cells
    poses: npt.NDArray[np.int64]
    remarks: tuple[str, ...] = ()
    sequences: bool = True
    sums: dict[str, FloatArray] = field(default_factory=dict)
    counts: dict[str, npt.NDArray[np.int64]] = field(default_factory=dict)
    per_pose: dict[str, FloatArray] = field(default_factory=dict)
    cell_of: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    # --- adding -----------------------------------------------------------------------------------------------

    def add(self, name: str, cells: npt.NDArray[np.intp], sums: FloatArray, counts: npt.NDArray[np.int64]) -> None:
        """Add the sums of some poses of a statistic to their cells.

        Parameters
        ----------
        name : str
            The statistic.
        cells : array of int (R,)
            The cell of each row.
        sums, counts : arrays (R, …) and (R,) or (R, J)
            What is added.
        """
        if name not in self.sums:
            self.sums[name] = np.zeros((len(self.poses), *sums.shape[1:]))
            self.counts[name] = np.zeros((len(self.poses), *counts.shape[1:]), dtype=np.int64)
        np.add.at(self.sums[name], cells, sums)
        np.add.at(self.counts[name], cells, counts)

    # --- reading ----------------------------------------------------------------------------------------------

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the labels that poses can be grouped by."""
        return tuple(name for name in self.cells if self.sequences or name != "sequence")

    def units(self, number: int | None = None) -> str:
        """Say how many of what is taken as independent: ``16 sequences``, ``100 runs of frames`` or ``5 frames``.

        Parameters
        ----------
        number : int, optional
            How many; all there are by default.
        """
        names, place = np.unique(self.cells["sequence"], return_inverse=True)
        number = len(names) if number is None else number
        if self.sequences:
            one, many = "sequence", "sequences"
        elif np.bincount(place, self.poses).max(initial=0) > 1:
            one, many = "run of frames", "runs of frames"
        else:
            one, many = "frame", "frames"
        return f"{number:,} {one if number == 1 else many}"

    def groups(self, label: str) -> Iterator[tuple[str, npt.NDArray[np.bool_]]]:
        """Give each value of a label, in their natural order, with its cells.

        Raises
        ------
        PoseDataError
            For a label that the poses don't have.
        """
        if label not in self.labels:
            raise PoseDataError(f"by: {label!r} is not a label of these poses. {did_you_mean(label, self.labels)}")
        values = self.cells[label]
        for value in sorted(set(values.tolist()), key=_natural):
            yield value, values == value

    def mean(self, statistic: Statistic, cells: npt.NDArray[np.bool_] | None = None) -> FloatArray:
        """Mean of a statistic over the poses of some cells; NaN where none counts."""
        chosen = slice(None) if cells is None else cells
        return mean_of(self.sums[statistic.name][chosen].sum(axis=0), self.counts[statistic.name][chosen].sum(axis=0))

    def averaged(self, statistic: Statistic, cells: npt.NDArray[np.bool_] | None = None) -> FloatArray:
        """Mean of a statistic; by the option ``average``, the mean of its groups' means, for each joint by itself."""
        sums, counts = self._weighed(statistic, cells)
        return mean_of(sums.sum(axis=0), counts.sum(axis=0))

    def _weighed(
        self, statistic: Statistic, cells: npt.NDArray[np.bool_] | None
    ) -> tuple[FloatArray, npt.NDArray[np.integer] | FloatArray]:
        """Sums and counts of some cells; by the option ``average``, scaled so that each group counts as much."""
        chosen = np.ones(len(self.poses), dtype=bool) if cells is None else cells
        sums, counts = self.sums[statistic.name][chosen], self.counts[statistic.name][chosen]
        if self.protocol.average == "poses":
            return sums, counts
        place = self.group_of[chosen]
        number = np.zeros((self.group_of.max(initial=-1) + 1, *counts.shape[1:]))
        np.add.at(number, place, counts)
        even = number.sum(axis=0) / np.maximum((number > 0).sum(axis=0), 1)
        weight = (even / np.maximum(number, 1))[place]
        return sums * np.expand_dims(weight, tuple(range(weight.ndim, sums.ndim))), counts * weight

    @cached_property
    def group_of(self) -> npt.NDArray[np.intp]:
        """The group of each cell, by the option ``average``."""
        place = np.zeros(len(self.poses), dtype=np.intp)
        for number, (_, group) in enumerate(self.groups(self.protocol.average)):
            place[group] = number
        return place

    def worth(self, statistic: Statistic) -> FloatArray:
        r"""Poses that a mean over them all would need for the variance of the average, were poses independent.

        .. math:: G^2 \Big/ \textstyle\sum_g 1/n_g

        of G groups with n_g poses that count; a number, or one for each joint, (J,).
        """
        counts = self.counts[statistic.name]
        if self.protocol.average == "poses":
            return np.asarray(counts.sum(axis=0), dtype=np.float64)
        number = np.zeros((self.group_of.max(initial=-1) + 1, *counts.shape[1:]))
        np.add.at(number, self.group_of, counts)
        shares = np.where(number > 0, 1 / np.maximum(number, 1), 0).sum(axis=0)
        worth: FloatArray = np.asarray((number > 0).sum(axis=0) ** 2 / np.where(shares > 0, shares, np.inf))
        return worth

    def count(self, statistic: Statistic, cells: npt.NDArray[np.bool_] | None = None, row: int | None = None) -> int:
        """Poses that count in a statistic: in one of its rows, or at the joint where most do."""
        if statistic.per_pose:
            return len(self._kept(statistic, cells))
        chosen = slice(None) if cells is None else cells
        counted = self.counts[statistic.name][chosen].sum(axis=0)
        return int(np.max(counted, initial=0) if row is None else counted[row])

    def _kept(self, statistic: Statistic, cells: npt.NDArray[np.bool_] | None) -> FloatArray:
        values = self.per_pose[statistic.name]
        chosen = values if cells is None else values[cells[self.cell_of]]
        return chosen[~np.isnan(chosen).any(axis=1)]

    def value(self, metric: Metric, cells: npt.NDArray[np.bool_] | None = None) -> float:
        """Give a metric over the poses of some cells.

        By the option ``average`` it is the mean of its groups' values; what is read off calibration curves is read
        off the mean of the groups' curves.
        """
        if metric.family in CURVES:
            return float(metric.finish(self.averaged(metric.statistic, cells)))
        cells = np.ones(len(self.poses), dtype=bool) if cells is None else cells
        if self.protocol.average == "poses":
            return self.pooled(metric, cells)
        values = [self.pooled(metric, cells & group) for _, group in self.groups(self.protocol.average)]
        return mean_of_known(values)

    def pooled(self, metric: Metric, cells: npt.NDArray[np.bool_]) -> float:
        """Give a metric over some cells, whatever is averaged."""
        if metric.statistic.per_pose:
            return float(metric.finish(self._kept(metric.statistic, cells)))
        if not metric.sequences_per_batch:
            return float(metric.finish(self.mean(metric.statistic, cells)))
        sums, counts = self.sums[metric.statistic.name], self.counts[metric.statistic.name]
        names = dict.fromkeys(self.cells["sequence"][cells].tolist())
        batch = {name: place // metric.sequences_per_batch for place, name in enumerate(names)}
        total, number = 0.0, 0
        for wanted in range(len(set(batch.values()))):
            chosen = cells & np.array([batch.get(name, -1) == wanted for name in self.cells["sequence"]])
            poses = int(counts[chosen].sum())
            if poses:
                total += poses * float(metric.finish(mean_of(sums[chosen].sum(axis=0), counts[chosen].sum(axis=0))))
                number += poses
        return total / number if number else float("nan")

    def by_joint(self, metric: Metric, cells: npt.NDArray[np.bool_] | None = None) -> FloatArray:
        """Give a metric per joint, (K,), averaged as its value; NaN for joints that don't count."""
        if metric.by_joint is None:
            return np.full(len(self.spec.joints), np.nan)
        statistic, finish = metric.by_joint
        return finish(self.averaged(statistic, cells))

    @property
    def signature(self) -> str:
        """One line that is equal for two results exactly where their numbers can be compared."""
        s = self.spec
        parts = {
            "posecal": self.version,
            "N": str(s.n_hypotheses),
            "K": f"{len(s.joints)}({zlib.crc32(','.join(s.joints).encode()):08x})",
            "origin": "as given" if s.root is None else s.joints[s.root],
            **self.protocol.options,
        }
        parts.pop("metrics")
        parts["where"] += ",mask" if s.has_mask else ""
        default = Protocol().options
        kept = ("posecal", "N", "K", "origin", "joints", "root", "where", "best", "align", "average")
        shown = {key: value for key, value in parts.items() if key in kept or value != default.get(key)}
        shown["ece"] = f"exchangeable,{self.protocol.summary_over_joints}"
        if s.reference:
            shown["reference"] = f"{s.reference},N={s.n_reference}"
        return " ".join(f"{key}={value.replace(' ', '_')}" for key, value in shown.items())

    # --- sequences --------------------------------------------------------------------------------------------

    def by_sequence(
        self, statistic: Statistic, cells: npt.NDArray[np.bool_] | None = None
    ) -> tuple[FloatArray, npt.NDArray[np.integer] | FloatArray]:
        """Add up a statistic over each sequence among some cells: sums (S, …) and counts (S,) or (S, J).

        By the option ``average`` they are weighted, so that all groups together count as much as their poses do, and
        each as much as any other.
        """
        chosen = np.ones(len(self.poses), dtype=bool) if cells is None else cells
        _, place = np.unique(self.cells["sequence"][chosen], return_inverse=True)
        sums, counts = self._weighed(statistic, chosen)
        added = np.zeros((place.max(initial=-1) + 1, *sums.shape[1:]))
        number = np.zeros((len(added), *counts.shape[1:]), dtype=counts.dtype)
        np.add.at(added, place, sums)
        np.add.at(number, place, counts)
        return added, number


def _natural(text: str) -> list[tuple[int, str]]:
    """A key that sorts numbers within text by their size."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", text)]


def mean_of(sums: FloatArray, counts: npt.NDArray[np.integer] | FloatArray) -> FloatArray:
    """Divide sums by counts; NaN where nothing counts."""
    number = np.expand_dims(counts, tuple(range(np.ndim(counts), np.ndim(sums))))
    return np.where(number > 0, sums / np.maximum(number, 1), np.nan)


def mean_of_known(values: Sequence[float]) -> float:
    """Give the mean of those that are not NaN."""
    found = [value for value in values if not np.isnan(value)]
    return float(np.mean(found)) if found else float("nan")


def difference_of_signatures(one: Totals, other: Totals) -> str:
    """Say in what two results were not made alike."""
    ours, theirs = (dict(part.split("=", 1) for part in t.signature.split()) for t in (one, other))
    keys = [key for key in {**ours, **theirs} if ours.get(key) != theirs.get(key)]
    return ", ".join(f"{key} {ours.get(key, 'default')} against {theirs.get(key, 'default')}" for key in keys)
