"""Cells: the groups of poses whose sums are kept apart, by sequence and by label.

A cell is one combination of a sequence and labels. Labels that don't split any sequence are kept along with it;
others only where they are asked for. Poses without sequence labels form runs of 2^k consecutive poses, with the
smallest k that leaves at most 100 runs, so that the runs depend on the number of poses alone and not on the batches in
which they come.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.errors import PoseDataError, did_you_mean

MAX_RUNS = 100
"""Poses without sequence labels form at most so many runs of consecutive poses."""

RUNS = "runs"
"""Under this name results keep the hash of the whole set by whose poses their runs are numbered."""

SPREAD = re.compile("predicted_spread(?![^:=])")
"""Entries of ``by`` that cut poses by their predicted spread."""

Labels = Mapping[str, npt.NDArray[np.str_]]
Indices = npt.NDArray[np.intp]


def label_name(by: str) -> str:
    """Give the label that an entry of ``by`` names: itself, but ``predicted_spread:40,60`` for ``…=40,60``.

    So each way to cut the spread is a label of its own, and ``label=value`` has one equals sign.
    """
    return by.replace("=", ":", 1) if SPREAD.match(by) else by


def spread_cuts(entry: str, spread: FloatArray | None) -> FloatArray:
    """Give the cuts of an entry such as ``predicted_spread``, ``predicted_spread:5`` or ``predicted_spread=40,60``.

    Parameters
    ----------
    entry : str
        Of ``by``: terciles, so many equal parts, or cuts in mm.
    spread : array (M,) or None
        The predicted spread of all poses, mm; None where it isn't known yet.

    Returns
    -------
    array (cuts,)
        Rising, mm.

    Raises
    ------
    PoseDataError
        For another text, where parts are asked for and the spreads are not known, and where no pose has a spread.
    """
    try:
        if "=" in entry:
            cuts = np.sort([float(cut) for cut in entry.partition("=")[2].split(",")])
        elif spread is None:
            raise PoseDataError(
                f"by: {entry!r} needs all poses before the first batch; expected cuts in mm, such as "
                "predicted_spread=40,60."
            )
        else:
            parts, known = int(entry.partition(":")[2] or 3), spread[~np.isnan(spread)]
            if not known.size:
                raise PoseDataError(
                    f"by: {entry!r} needs a spread; expected at least 2 hypotheses and a joint that counts."
                )
            cuts = np.quantile(known, np.arange(1, parts) / parts)
        if not np.isfinite(cuts).all() or not cuts.size:
            raise ValueError
    except ValueError as error:
        if isinstance(error, PoseDataError):
            raise
        raise PoseDataError(
            f"by: {entry!r}; expected predicted_spread, predicted_spread:5 (equal parts) or predicted_spread=40,60 "
            "(cuts in mm)."
        ) from None
    return cuts


def spread_labels(cuts: FloatArray, spread: FloatArray) -> npt.NDArray[np.str_]:
    """Name the part between two cuts that each pose belongs to; poses without a spread go to the last."""
    edges = [f"{cut:.1f}" for cut in cuts]
    names = [f"1: below {edges[0]} mm"]
    names += [f"{k + 2}: {edges[k]} to {edges[k + 1]} mm" for k in range(len(edges) - 1)]
    names += [f"{len(edges) + 1}: above {edges[-1]} mm"]
    return np.array(names)[np.searchsorted(cuts, spread, side="right")]


def run_length(n_poses: int) -> int:
    """Give the smallest power of two that leaves at most :data:`MAX_RUNS` runs of so many poses."""
    return 1 << max(0, -(-n_poses // MAX_RUNS) - 1).bit_length()


def natural_key(text: str) -> list[tuple[int, str]]:
    """Give a key that sorts numbers within text by their size."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", text)]


class CellIndex:
    """The cell of every pose, for poses that come in one piece or in batches.

    Parameters
    ----------
    by : sequence of str
        Labels that must be kept apart.
    average : str
        A label over whose groups numbers are averaged, kept apart as well; ``poses`` for none.
    labels : sequence of str
        Names of the labels that every pose has.
    first, n_poses : int
        Of a part of the poses: the number of its first one, and how many there are in all.

    Attributes
    ----------
    has_sequences : bool
        Whether sequences are labels of the poses, rather than runs of poses.

    Raises
    ------
    PoseDataError
        For a label that the poses don't have.
    """

    def __init__(
        self, by: Sequence[str], average: str, labels: Sequence[str], first: int = 0, n_poses: int = 0
    ) -> None:
        wanted = {label_name(entry): "by" for entry in by} | ({} if average == "poses" else {average: "average"})
        own = {label_name(entry) for entry in by if SPREAD.match(entry)}
        for name, option in wanted.items():
            if name not in labels and not (option == "by" and name in own):
                known = [*labels, "predicted_spread"] if option == "by" else [*labels, "poses"]
                raise PoseDataError(f"{option}: {name!r} is not a label of these poses. {did_you_mean(name, known)}")
        self.has_sequences = "sequence" in labels
        self._wanted = [name for name in wanted if name != "sequence"]
        optional = [name for name in labels if name not in {*wanted, "sequence"}] if self.has_sequences else []
        self._optional: dict[str, dict[str, str]] = {name: {} for name in optional}
        self._poses, self._run_length = first, run_length(n_poses)
        self._rows: dict[tuple[str, ...], int] = {}

    @property
    def names(self) -> list[str]:
        """The labels of a cell."""
        return ["sequence", *self._wanted, *self._optional]

    @property
    def cells(self) -> dict[str, npt.NDArray[np.str_]]:
        """The labels of all cells, (C,) each, in the order of their first pose."""
        values = np.array(list(self._rows), dtype=np.str_).reshape(len(self._rows), len(self.names))
        return {name: values[:, column] for column, name in enumerate(self.names)}

    def assign(self, labels: Labels, n_poses: int) -> tuple[Indices, Indices | None]:
        """Give the cells of the next poses.

        Parameters
        ----------
        labels : mapping of arrays of str (m,)
            Their labels, those made of the predicted spread among them.
        n_poses : int
            m.

        Returns
        -------
        cells : array of int (m,)
            The cell of each pose.
        moved : array of int (C,) or None
            Where cells were joined: the new number of each earlier cell.
        """
        columns, length = self.names, self._run_length
        sequence: npt.NDArray[Any]
        if self.has_sequences:
            sequence = labels["sequence"]
            self._drop_splitting(sequence, labels)
        else:
            while self._run_length < run_length(self._poses + n_poses):
                self._run_length *= 2
            sequence = (self._poses + np.arange(n_poses)) // self._run_length
        self._poses += n_poses
        moved = None
        if self._rows and (self.names != columns or self._run_length != length):
            kept = [columns.index(name) for name in self.names]
            before = [tuple(row[column] for column in kept) for row in self._rows]
            if not self.has_sequences:
                joined = self._run_length // length
                before = [(str(int(row[0]) // joined), *row[1:]) for row in before]
            self._rows = {}
            moved = np.array([self._rows.setdefault(row, len(self._rows)) for row in before], dtype=np.intp)
        values = [sequence, *(labels[name] for name in self.names[1:])]
        changes = np.ones(n_poses, dtype=bool)
        changes[1:] = np.any([column[1:] != column[:-1] for column in values], axis=0)
        first = np.flatnonzero(changes)
        rows = zip(*(column[first].astype(np.str_).tolist() for column in values), strict=True)
        numbers = np.array([self._rows.setdefault(row, len(self._rows)) for row in rows], dtype=np.intp)
        return np.repeat(numbers, np.diff(first, append=n_poses)), moved

    def _drop_splitting(self, sequence: npt.NDArray[np.str_], labels: Labels) -> None:
        """Drop the optional labels that split a sequence."""
        names, first, inverse = np.unique(sequence, return_index=True, return_inverse=True)
        for label, value_of in list(self._optional.items()):
            values = labels[label]
            expected = [value_of.setdefault(str(name), str(values[at])) for name, at in zip(names, first, strict=True)]
            if not np.array_equal(np.array(expected)[inverse], values):
                del self._optional[label]
