"""What is kept of an evaluation? The sums of every statistic, per cell; never the hypotheses.

A *cell* is one combination of sequence and labels. Sums over cells add, so a report of any group of poses, of
shards that were evaluated apart, or of resampled sequences needs nothing but these sums: some hundred kilobytes,
in a file that can be read next year.
"""

from __future__ import annotations

import json
import os
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.archive import write_members
from posecal.block import FloatArray
from posecal.calibration.battery import OF_THE_RUN
from posecal.errors import PoseDataError, PoseFileError, did_you_mean, raise_all
from posecal.io import written_whole
from posecal.metric import Metric, Statistic, Subject
from posecal.protocol import Protocol

__all__ = ["CURVES", "FORMAT", "Totals", "difference_of_signatures", "is_result", "mean_of", "mean_of_known"]

FORMAT = 1
"""The version of the file format."""

CURVES = ("calibration", "battery")
"""Families of metrics that are read off curves."""

Cells = Mapping[str, npt.NDArray[np.str_]]


@dataclass
class Totals:
    """Sums of statistics over the poses of each of C cells.

    Attributes
    ----------
    subject : Subject
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
    kept : dict of arrays (M, …)
        By statistic: the values of every pose, of the few that no sums replace.
    cell_of : array of int (M,)
        With them: the cell of each pose.
    """

    subject: Subject
    protocol: Protocol
    version: str
    cells: Cells
    poses: npt.NDArray[np.int64]
    remarks: tuple[str, ...] = ()
    sequences: bool = True
    sums: dict[str, FloatArray] = field(default_factory=dict)
    counts: dict[str, npt.NDArray[np.int64]] = field(default_factory=dict)
    kept: dict[str, FloatArray] = field(default_factory=dict)
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
        if statistic.kept:
            return len(self._kept(statistic, cells))
        chosen = slice(None) if cells is None else cells
        counted = self.counts[statistic.name][chosen].sum(axis=0)
        return int(np.max(counted, initial=0) if row is None else counted[row])

    def _kept(self, statistic: Statistic, cells: npt.NDArray[np.bool_] | None) -> FloatArray:
        values = self.kept[statistic.name]
        chosen = values if cells is None else values[cells[self.cell_of]]
        return chosen[~np.isnan(chosen).any(axis=1)]

    def value(self, metric: Metric, cells: npt.NDArray[np.bool_] | None = None) -> float:
        """Give a metric over the poses of some cells.

        By the option ``average`` it is the mean of its groups' values; what is read off calibration curves is read
        off the mean of the groups' curves.
        """
        if metric.family in CURVES:
            return metric.finish(self.averaged(metric.statistic, cells))
        cells = np.ones(len(self.poses), dtype=bool) if cells is None else cells
        if self.protocol.average == "poses":
            return self.pooled(metric, cells)
        values = [self.pooled(metric, cells & group) for _, group in self.groups(self.protocol.average)]
        return mean_of_known(values)

    def pooled(self, metric: Metric, cells: npt.NDArray[np.bool_]) -> float:
        """Give a metric over some cells, whatever is averaged."""
        if metric.statistic.kept:
            return metric.finish(self._kept(metric.statistic, cells))
        if not metric.clips:
            return metric.finish(self.mean(metric.statistic, cells))
        sums, counts = self.sums[metric.statistic.name], self.counts[metric.statistic.name]
        names = dict.fromkeys(self.cells["sequence"][cells].tolist())
        batch = {name: place // metric.clips for place, name in enumerate(names)}
        total, number = 0.0, 0
        for wanted in range(len(set(batch.values()))):
            chosen = cells & np.array([batch.get(name, -1) == wanted for name in self.cells["sequence"]])
            poses = int(counts[chosen].sum())
            if poses:
                total += poses * metric.finish(mean_of(sums[chosen].sum(axis=0), counts[chosen].sum(axis=0)))
                number += poses
        return total / number if number else float("nan")

    def by_joint(self, metric: Metric, cells: npt.NDArray[np.bool_] | None = None) -> FloatArray:
        """Give a metric per joint, (K,), averaged as its value; NaN for joints that don't count."""
        if metric.by_joint is None:
            return np.full(len(self.subject.joints), np.nan)
        statistic, finish = metric.by_joint
        return finish(self.averaged(statistic, cells))

    @property
    def signature(self) -> str:
        """One line that is equal for two results exactly where their numbers can be compared."""
        s = self.subject
        parts = {
            "posecal": self.version,
            "N": str(s.n_hypotheses),
            "K": f"{len(s.joints)}({zlib.crc32(','.join(s.joints).encode()):08x})",
            "origin": "as given" if s.root is None else s.joints[s.root],
            **self.protocol.options,
        }
        parts.pop("metrics")
        parts["where"] += ",mask" if s.masked else ""
        default = Protocol().options
        kept = ("posecal", "N", "K", "origin", "joints", "root", "where", "best", "align", "average")
        shown = {key: value for key, value in parts.items() if key in kept or value != default.get(key)}
        shown["ece"] = f"exchangeable,{self.protocol.summary_over_joints}"
        if s.reference:
            shown["reference"] = s.reference
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

    # --- joining shards ---------------------------------------------------------------------------------------

    @staticmethod
    def merged(parts: Sequence[Totals], names: Sequence[str] | None = None) -> Totals:
        """Add the results of shards of one test set.

        Parameters
        ----------
        parts : sequence of Totals
            At least one; evaluated alike.
        names : sequence of str, optional
            What messages call them.

        Returns
        -------
        Totals
            What one run over all poses gives. A sequence may be split over shards; runs of frames without sequence
            labels stay those of their shard, and the box of ``tarp_box`` is that of its shard's true poses.

        Raises
        ------
        PoseDataError
            Where two differ in more than their poses, or hold the same poses.
        """
        if not parts:
            raise PoseDataError("merge: no results; expected at least one.")
        names = names or [f"part {number}" for number in range(1, len(parts) + 1)]
        first = parts[0]
        problems = []
        for name, part in zip(names[1:], parts[1:], strict=True):
            if part.signature != first.signature:
                problems.append(f"{names[0]} and {name} were not made alike: {difference_of_signatures(first, part)}.")
            if first.protocol.velocity == "second" and part.subject.fps != first.subject.fps:
                rates = f"{first.subject.fps:g} and {part.subject.fps:g}"
                problems.append(f"{names[0]} and {name} have {rates} frames per second; expected the same.")
            held, ours = ({*t.cells, *t.sums, *t.kept} for t in (first, part))
            if held != ours:
                problems.append(f"{names[0]} and {name} differ in what they hold: {', '.join(sorted(held ^ ours))}.")
        raise_all(problems)
        keys = list(first.cells)
        rows: dict[tuple[str, ...], int] = {}
        seen: dict[tuple[object, ...], str] = {}
        where = []
        sequences = all(part.sequences for part in parts)
        apart = len(parts) > 1 and not sequences
        for number, (name, part) in enumerate(zip(names, parts, strict=True), 1):
            cells = list(zip(*(part.cells[key].tolist() for key in keys), strict=True))
            at = keys.index("sequence")
            own = [(*c[:at], f"{number}/{c[at]}", *c[at + 1 :]) for c in cells] if apart else cells
            where.append(np.array([rows.setdefault(cell, len(rows)) for cell in own], dtype=np.intp))
            for place, cell in enumerate(cells):
                sums = (float(s[place].sum()) for s_name, s in part.sums.items() if s_name not in OF_THE_RUN)
                print_ = (cell, int(part.poses[place]), *sums)
                if print_ in seen:
                    raise PoseDataError(
                        f"{seen[print_]} and {name} hold the same poses (cell {', '.join(cell)}); expected shards "
                        "without poses in common."
                    )
                seen[print_] = name
        poses = np.zeros(len(rows), dtype=np.int64)
        values = np.array(list(rows), dtype=np.str_).reshape(len(rows), len(keys))
        whole = Totals(
            subject=first.subject,
            protocol=first.protocol,
            version=first.version,
            cells={key: values[:, place] for place, key in enumerate(keys)},
            poses=poses,
            remarks=tuple(dict.fromkeys(remark for part in parts for remark in part.remarks)),
            sequences=sequences,
        )
        for part, cells_of in zip(parts, where, strict=True):
            np.add.at(poses, cells_of, part.poses)
            for statistic in first.sums:
                whole.add(statistic, cells_of, part.sums[statistic], part.counts[statistic])
        whole.kept = {name: np.concatenate([part.kept[name] for part in parts]) for name in first.kept}
        whole.cell_of = np.concatenate([of[part.cell_of] for part, of in zip(parts, where, strict=True)])
        return whole

    # --- files ------------------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the sums into a compressed ``.npz`` file, whole or not at all.

        Raises
        ------
        PoseFileError
            Where the file can't be written.
        """
        about = {
            "posecal": self.version,
            "format": FORMAT,
            "subject": asdict(self.subject),
            "protocol": self.protocol.options,
            "remarks": self.remarks,
            "sequences": self.sequences,
        }
        members: dict[str, npt.NDArray[np.generic]] = {"about": np.array(json.dumps(about)), "poses": self.poses}
        members |= {f"cell/{name}": values for name, values in self.cells.items()}
        for name in self.sums:
            members[f"sum/{name}"], members[f"count/{name}"] = self.sums[name], self.counts[name]
        members |= {f"kept/{name}": values.astype(np.float32) for name, values in self.kept.items()}
        members["cell_of"] = self.cell_of.astype(np.int32)
        written_whole(path, lambda file: write_members(file, members, compressed=True))

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Totals:
        """Read what :meth:`save` wrote.

        Raises
        ------
        PoseFileError
            For files that can't be read or are no results.
        """
        name = Path(path).name
        try:
            with open(path, "rb") as file, np.load(file, allow_pickle=False) as stored:
                members: dict[str, Any] = {key: stored[key] for key in stored.files}
            about = json.loads(str(members.pop("about")))
            if about["format"] != FORMAT:
                raise PoseFileError(
                    f"{name}: format {about['format']} of posecal {about['posecal']}; expected {FORMAT}. "
                    "Evaluate again."
                )
            return Totals(
                subject=Subject(**_tuples(about["subject"])),
                protocol=Protocol().changed(about["protocol"]),
                version=about["posecal"],
                cells=_part(members, "cell/"),
                poses=members["poses"],
                remarks=tuple(about["remarks"]),
                sequences=about["sequences"],
                sums=_part(members, "sum/"),
                counts=_part(members, "count/"),
                kept=_part(members, "kept/"),
                cell_of=members["cell_of"],
            )
        except PoseFileError:
            raise
        except FileNotFoundError:
            raise PoseFileError(f"{path}: no such file.") from None
        except IsADirectoryError:
            raise PoseFileError(f"{path}: is a folder; expected a result of posecal evaluate --save.") from None
        except (
            KeyError,
            TypeError,
            AttributeError,
            ValueError,
            EOFError,
            zipfile.BadZipFile,
            zlib.error,
        ):
            raise PoseFileError(f"{name}: no result of posecal evaluate --save, or not a whole one.") from None
        except OSError as error:
            raise PoseFileError(f"{path}: can't be read ({error.strerror}).") from None


def is_result(path: str | os.PathLike[str]) -> bool:
    """Whether a file looks like a saved result, rather than an array of poses."""
    try:
        with zipfile.ZipFile(path) as archive:
            return "about.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


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


def _part(members: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {key.removeprefix(prefix): value for key, value in members.items() if key.startswith(prefix)}


def _tuples(subject: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in subject.items()}


def difference_of_signatures(one: Totals, other: Totals) -> str:
    """Say in what two results were not made alike."""
    ours, theirs = (dict(part.split("=", 1) for part in t.signature.split()) for t in (one, other))
    keys = [key for key in {**ours, **theirs} if ours.get(key) != theirs.get(key)]
    return ", ".join(f"{key} {ours.get(key, 'default')} against {theirs.get(key, 'default')}" for key in keys)
