"""Sums of every statistic per cell: all that an evaluation keeps of the poses.

A *cell* is one combination of sequence and labels. Sums over cells add, so a report of any group of poses, of
shards that were evaluated apart, or of resampled sequences needs nothing but these sums.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import canonical_names
from posecal.data.root import root_name
from posecal.engine.cells import natural_key
from posecal.engine.finish import ReadOff
from posecal.engine.gallery import Gallery
from posecal.engine.metric import Metric, Statistic
from posecal.engine.pose_hashes import PoseHashes
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.engine.sums import (
    Cells,
    Counts,
    Indices,
    add_rows,
    batches,
    compact,
    mean_of,
    mean_of_known,
    split_by,
    sum_by,
)
from posecal.errors import PoseDataError, did_you_mean

CURVES = ("calibration", "rank_tests")
"""Families of metrics that are read off curves."""

Finish = Callable[[FloatArray], npt.ArrayLike]


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
        The labels of each cell; ``sequence`` is always among them. They don't change once anything was read.
    poses : array of int (C,)
        Poses in each cell.
    remarks : tuple of str
        What a careful reader should know.
    n_frames : int
        Frames that were given, counted or not.
    has_sequences : bool
        Whether the sequences were labelled; else they are runs of consecutive frames, treated as independent.
    sums, counts : dicts of arrays (C, …) and (C,) or (C, J)
        By statistic: the sum over the poses that count, and their number.
    per_pose : dict of arrays (M, …)
        By statistic: the values of every pose, of the few that no sums replace.
    cell_of : array of int (M,)
        With them: the cell of each pose.
    pose_hashes : array of int (H, 2)
        Of the true poses; see :func:`posecal.engine.pose_hashes.pose_hashes`.
    own_metrics : tuple of Metric
        The user's metrics that the sums are of.
    prepared_hashes : dict of str
        Hashes of what was found from all poses together, by the need of metrics that it meets.
    gallery : Gallery or None
        A few poses for pictures; None where none are kept.
    """

    spec: DataSpec
    protocol: Protocol
    version: str
    cells: Mapping[str, npt.NDArray[np.str_]]
    poses: npt.NDArray[np.int64]
    remarks: tuple[str, ...] = ()
    n_frames: int = 0
    has_sequences: bool = True
    sums: dict[str, FloatArray] = field(default_factory=dict)
    counts: dict[str, npt.NDArray[np.int64]] = field(default_factory=dict)
    per_pose: dict[str, FloatArray] = field(default_factory=dict)
    cell_of: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    pose_hashes: PoseHashes = field(default_factory=lambda: np.zeros((0, 2), dtype=np.uint64))
    own_metrics: tuple[Metric, ...] = ()
    prepared_hashes: dict[str, str] = field(default_factory=dict)
    gallery: Gallery | None = None
    _shared: dict[Hashable, tuple[Cells, FloatArray]] = field(default_factory=dict, init=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_shared": {}}  # what was computed is neither pickled nor copied

    def add(self, name: str, cells: Indices, sums: FloatArray, counts: npt.NDArray[np.int64]) -> None:
        """Add the sums of some poses of a statistic to their cells.

        Parameters
        ----------
        name : str
            The statistic.
        cells, sums, counts : arrays (R,), (R, …) and (R,) or (R, J)
            What is added, and to which cells.
        """
        if name not in self.sums:
            self.sums[name] = np.zeros((len(self.poses), *sums.shape[1:]))
            self.counts[name] = np.zeros((len(self.poses), *counts.shape[1:]), dtype=np.int64)
        add_rows(self.sums[name], cells, sums)
        add_rows(self.counts[name], cells, counts)
        self._shared.clear()

    # --- groups of cells --------------------------------------------------------------------------------------

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the labels that poses can be grouped by."""
        return tuple(name for name in self.cells if self.has_sequences or name != "sequence")

    @cached_property
    def sequence_of(self) -> Indices:
        """The sequence of each cell, (C,): its number in the order of the names."""
        return np.unique(self.cells["sequence"], return_inverse=True)[1]

    @property
    def n_sequences(self) -> int:
        """S, the number of sequences."""
        return int(self.sequence_of.max(initial=-1)) + 1

    def units(self, number: int | None = None) -> str:
        """Name and count what is treated as independent: ``16 sequences``, ``100 runs of frames`` or ``5 frames``.

        Parameters
        ----------
        number : int, optional
            How many; all there are by default.
        """
        number = self.n_sequences if number is None else number
        is_run = np.bincount(self.sequence_of, self.poses).max(initial=0) > 1
        one = "sequence" if self.has_sequences else "run of frames" if is_run else "frame"
        many = "runs of frames" if one == "run of frames" else f"{one}s"
        return f"{number:,} {one if number == 1 else many}"

    def groups(self, label: str) -> Iterator[tuple[str, Indices]]:
        """Give each value of a label, in their natural order, with the indices of its cells.

        Raises
        ------
        PoseDataError
            For a label that the poses don't have.
        """
        if label not in self.labels:
            raise PoseDataError(f"by: {label!r} is not a label of these poses. {did_you_mean(label, self.labels)}")
        values, codes = np.unique(self.cells[label], return_inverse=True)
        cells = split_by(codes, len(values))
        for value in sorted(range(len(values)), key=lambda value: natural_key(str(values[value]))):
            yield str(values[value]), cells[value]

    @cached_property
    def group_of(self) -> Indices:
        """The group of each cell, (C,), by the option ``average``; 0 for all where it is over poses."""
        numbers = np.zeros(len(self.poses), dtype=np.intp)
        if self.protocol.average != "poses":
            for number, (_, group) in enumerate(self.groups(self.protocol.average)):
                numbers[group] = number
        return numbers

    def mean(self, statistic: Statistic, cells: Cells = None) -> FloatArray:
        """Mean of a statistic over the poses of some cells; NaN where none counts."""
        return mean_of(*(part.sum(axis=0) for part in self.of_cells(statistic, cells)))

    def averaged(self, statistic: Statistic, cells: Cells = None) -> FloatArray:
        """Mean of a statistic; by the option ``average``, the mean of its groups' means, for each joint by itself."""
        sums, counts = self._weighted(statistic, cells)
        return mean_of(sums.sum(axis=0), counts.sum(axis=0))

    def by_sequence(self, statistic: Statistic, cells: Cells = None) -> tuple[FloatArray, Counts]:
        """Sum a statistic over each sequence among some cells: sums (S, …) and counts (S,) or (S, J).

        By the option ``average`` they are weighted, so that all groups together count as much as their poses do, and
        each as much as any other.
        """
        codes, n = compact(self.sequence_of, cells)
        sums, counts = self._weighted(statistic, cells)
        return sum_by(codes, n, sums), sum_by(codes, n, counts)

    def of_cells(self, statistic: Statistic, cells: Cells = None) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """Give the sums of a statistic of some cells, (C, …), and its counts, (C,) or (C, J)."""
        if statistic.name not in self.sums:
            raise PoseDataError(f"result: holds no sums of {statistic.name}. Evaluate again, with its metric.")
        sums, counts = self.sums[statistic.name], self.counts[statistic.name]
        if statistic.derive is not None:
            key = "derived", statistic.name
            if key not in self._shared:
                self._shared[key] = None, statistic.derive(sums, counts, self.sequence_of)
            sums = self._shared[key][1]
        return (sums, counts) if cells is None else (sums[cells], counts[cells])

    def _weighted(self, statistic: Statistic, cells: Cells) -> tuple[FloatArray, Counts]:
        """Sums and counts of some cells; by the option ``average``, scaled so that each group counts as much."""
        sums, counts = self.of_cells(statistic, cells)
        if self.protocol.average == "poses":
            return sums, counts
        codes, n = compact(self.group_of, cells)
        number = sum_by(codes, n, counts)
        even = number.sum(axis=0) / np.maximum((number > 0).sum(axis=0), 1)
        weight = (even / np.maximum(number, 1))[codes]
        return sums * np.expand_dims(weight, tuple(range(weight.ndim, sums.ndim))), counts * weight

    def effective_sample_size(self, statistic: Statistic) -> FloatArray:
        r"""Poses that a mean over them all would need for the variance of the average, were poses independent.

        .. math:: G^2 \Big/ \textstyle\sum_g 1/n_g

        of G groups with n_g poses that count; a number, or one for each joint, (J,).
        """
        counts = self.counts[statistic.name]
        if self.protocol.average == "poses":
            return np.asarray(counts.sum(axis=0), dtype=np.float64)
        number = sum_by(*compact(self.group_of, None), counts)
        shares = np.where(number > 0, 1 / np.maximum(number, 1), 0).sum(axis=0)
        return np.asarray((number > 0).sum(axis=0) ** 2 / np.where(shares > 0, shares, np.inf))

    def count(self, statistic: Statistic, cells: Cells = None, row: int | None = None) -> int:
        """Poses that count in a statistic: in one of its rows, or at the joint where most do."""
        if statistic.per_pose:
            return len(self.known_poses(statistic, cells))
        counts = self.of_cells(statistic, cells)[1].sum(axis=0)
        return int(np.max(counts, initial=0) if row is None else counts[row])

    def value(self, metric: Metric, cells: Cells = None) -> float:
        """Give a metric over the poses of some cells.

        By the option ``average`` it is the mean of its groups' values; what is read off calibration curves is read
        off the mean of the groups' curves.
        """
        if metric.family in CURVES:
            means = self.averaged
            return float(self.finished(metric, cells, "value", lambda finish: finish(means(metric.statistic, cells))))
        if self.protocol.average == "poses":
            return self.pooled(metric, cells)
        return mean_of_known(self.group_values(metric, cells))

    def finished(self, metric: Metric, cells: Cells, what: str, apply: Callable[[Finish], npt.ArrayLike]) -> FloatArray:
        """Finish means of some cells by ``apply``; ``what`` says which means these are.

        What a ``ReadOff`` shares is computed for the first of its metrics, and again where other cells are asked
        for or sums were added.
        """
        finish = metric.finish
        if not isinstance(finish, ReadOff):
            return np.asarray(apply(finish))
        key = what, metric.statistic.name, finish.summary
        shared = self._shared.get(key)
        if shared is None or shared[0] is not cells:
            shared = self._shared[key] = cells, np.asarray(apply(finish.summary))
        return finish.read(shared[1])

    def group_values(self, metric: Metric, cells: Cells = None) -> FloatArray:
        """Give a metric for each of the G groups among some cells by the option ``average``, (G,)."""
        codes, n = compact(self.group_of, cells)
        if metric.statistic.per_pose or metric.sequences_per_batch:
            groups = (part if cells is None else cells[part] for part in split_by(codes, n))
            return np.array([self.pooled(metric, group) for group in groups])
        sums, counts = self.of_cells(metric.statistic, cells)
        return np.asarray(metric.finish(mean_of(sum_by(codes, n, sums), sum_by(codes, n, counts))))

    def pooled(self, metric: Metric, cells: Cells = None) -> float:
        """Give a metric over the poses of some cells together, whatever the option ``average`` is."""
        if metric.statistic.per_pose:
            poses = self.known_poses(metric.statistic, cells)
            return float(np.asarray(metric.finish(self.per_pose[metric.statistic.name][poses])))
        if not metric.sequences_per_batch:
            return float(np.asarray(metric.finish(self.mean(metric.statistic, cells))))
        _, sums, counts = self.sequences_in_order(metric, cells)
        first = np.arange(0, len(sums), metric.sequences_per_batch)
        values, number = batch_sums(metric, np.add.reduceat(sums, first), np.add.reduceat(counts, first))
        return float(values.sum() / number.sum()) if number.any() else float("nan")

    def sequences_in_order(self, metric: Metric, cells: Cells) -> tuple[Indices, FloatArray, Counts]:
        """Sum a metric's statistic over each sequence among some cells, in the order of their first cells.

        Where one hypothesis is chosen for each sequence or batch, over all its cells, the sums are of that one alone.

        Returns
        -------
        order : array of int (S,)
            Which sequence each row is, in the order of the names.
        sums, counts : arrays (S, …)
            Without weights.
        """
        codes, n = compact(self.sequence_of, cells)
        first = np.full(n, len(codes))
        np.minimum.at(first, codes, np.arange(len(codes)))
        order = np.argsort(first)
        sums, counts = self.of_cells(metric.statistic, cells)
        if cells is not None and _chooses_for_sequences(metric):
            sums = np.take_along_axis(sums, self._chosen(metric)[cells, None], axis=-1)
        return order, sum_by(codes, n, sums)[order], sum_by(codes, n, counts)[order]

    def _chosen(self, metric: Metric) -> Indices:
        """Give for each cell the hypothesis of the smallest sum over its sequence, or its batch within ``average``."""
        name, k = metric.statistic.name, metric.sequences_per_batch
        if ("chosen", name) not in self._shared:
            batch = batches(self.sequence_of, k, self.group_of * (k > 1))
            chosen = sum_by(*compact(batch, None), self.sums[name]).argmin(axis=-1)[batch]
            self._shared["chosen", name] = chosen, np.zeros(0)
        return np.asarray(self._shared["chosen", name][0])

    def known_poses(self, statistic: Statistic, cells: Cells = None) -> Indices:
        """Give the indices of the poses of some cells whose values per pose hold no NaN."""
        if statistic.name not in self.per_pose:
            raise PoseDataError(f"result: holds no values of {statistic.name}. Evaluate again, with its metric.")
        if cells is None:
            poses = np.arange(len(self.cell_of))
        else:
            order, first = self._poses_by_cell
            length = first[cells + 1] - first[cells]
            skipped = np.repeat(first[cells] - np.cumsum(length) + length, length)
            poses = np.sort(order[skipped + np.arange(len(skipped))])
        return poses[~np.isnan(self.per_pose[statistic.name][poses]).any(axis=1)]

    @cached_property
    def _poses_by_cell(self) -> tuple[Indices, Indices]:
        """The poses in the order of their cells, (M,), and where each cell begins, (C + 1,)."""
        number = np.bincount(self.cell_of, minlength=len(self.poses))
        return np.argsort(self.cell_of, kind="stable"), np.concatenate([[0], np.cumsum(number)])

    def by_joint(self, metric: Metric, cells: Cells = None) -> FloatArray:
        """Give a metric per joint, (K,), averaged as its value; NaN for joints that don't count."""
        if metric.by_joint is None:
            return np.full(len(self.spec.joints), np.nan)
        statistic, finish = metric.by_joint
        return finish(self.averaged(statistic, cells))

    @property
    def signature(self) -> str:
        """One line that is equal for two results exactly where their numbers can be compared."""
        s, names = self.spec, canonical_names(self.spec.joints)
        parts = {
            "posecal": self.version,
            "N": str(s.n_hypotheses),
            "K": f"{len(s.joints)}({zlib.crc32(','.join(names).encode(errors='surrogatepass')):08x})",
            **({} if s.unit == "mm" else {"unit": s.unit or "none"}),
            "origin": "as given" if s.root is None else root_name(s.root, names),
            **self.protocol.options,
            **({"apart": ",".join(s.apart)} if s.apart else {}),
        }
        parts.pop("metrics")
        parts["where"] += ",mask" if s.has_mask else ""
        default = Protocol().options
        always = ("posecal", "N", "K", "origin", "joints", "root", "where", "best", "align", "average")
        shown = {key: value for key, value in parts.items() if key in always or value != default.get(key)}
        shown["ece"] = f"exchangeable,{self.protocol.summary_over_joints}"
        if s.reference:
            shown["reference"] = f"{s.reference},N={s.n_reference}"
        return " ".join(f"{key}={value.replace(' ', '_')}" for key, value in shown.items())


def _chooses_for_sequences(metric: Metric) -> bool:
    """Whether a metric is the smallest of the hypotheses' means over each sequence or batch of them."""
    return metric.sequences_per_batch > 0 and isinstance(metric.finish, partial) and metric.finish.func is np.min


def batch_sums(metric: Metric, sums: FloatArray, counts: Counts) -> tuple[FloatArray, FloatArray]:
    """Give a metric of the mean over each batch of sequences, times its poses, (batches,); and the poses."""
    poses = counts.sum(axis=tuple(range(1, counts.ndim))).astype(np.float64)
    values = np.asarray(metric.finish(mean_of(sums, counts)))
    return np.where(poses > 0, values * poses, 0.0), poses
