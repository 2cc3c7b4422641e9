"""By what are poses kept apart? Sequences, and the labels that a report will group by.

A cell is one combination of them. Labels that do not split a sequence cost nothing and are kept; others only where
they are asked for. Poses without sequences are kept in runs of consecutive frames.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.data.pose_data import PoseData
from posecal.errors import PoseDataError, did_you_mean

__all__ = ["RUNS", "Cells", "cells_of", "label_name"]

RUNS = 100
"""Without sequence labels, poses are kept in at most so many runs of consecutive frames."""

Labels = Mapping[str, npt.NDArray[np.str_]]


@dataclass(frozen=True)
class Cells:
    """The cells of some poses.

    Attributes
    ----------
    labels : dict of arrays of str (C,)
        The labels of each cell; ``sequence`` is always among them.
    of_pose : array of int (M,)
        The cell of each pose.
    labelled : bool
        Whether the sequences are the user's, rather than runs of frames.
    """

    labels: dict[str, npt.NDArray[np.str_]]
    of_pose: npt.NDArray[np.intp]
    labelled: bool


def label_name(by: str) -> str:
    """Give the label that an entry of ``--by`` names: itself, but ``spread:40,60`` for ``spread=40,60``.

    So each way to cut the spread is a label of its own, and ``label=value`` has one equals sign.
    """
    return by.replace("=", ":", 1) if by.startswith("spread=") else by


def cells_of(pairs: PoseData, by: Sequence[str], spread: Callable[[], FloatArray], *, average: str = "poses") -> Cells:
    """Sort poses into cells.

    Parameters
    ----------
    pairs : PoseData
        M poses.
    by : sequence of str
        Labels that must be kept apart. ``spread`` are terciles of the predicted spread, ``spread:5`` quintiles,
        ``spread=40,60`` the parts between such cuts in mm.
    spread : callable
        Gives the predicted spread of each pose, (M,), mm; called only where it is asked for.
    average : str
        A label over whose groups numbers are averaged, kept apart as well; ``poses`` for none.

    Returns
    -------
    Cells
        In the order of their first pose.

    Raises
    ------
    PoseDataError
        For a label that the poses don't have.
    """
    labels = dict(pairs.labels)
    for entry in by:
        if re.match("spread(?![^:=])", entry) and label_name(entry) not in labels:
            labels[label_name(entry)] = _parts(entry, spread())
    wanted = {label_name(entry): "by" for entry in by}
    wanted |= dict.fromkeys([] if average == "poses" else [average], "average")
    for name, option in wanted.items():
        if name not in (labels if option == "by" else pairs.labels):
            known = [*labels, "spread"] if option == "by" else [*pairs.labels, "poses"]
            raise PoseDataError(f"{option}: {name!r} is not a label of these poses. {did_you_mean(name, known)}")
    labelled, n_poses = "sequence" in labels, len(pairs.truth)
    runs = np.arange(n_poses) * min(RUNS, n_poses) // n_poses
    sequence = labels.get("sequence", runs.astype(np.str_))
    _, first, place = np.unique(sequence, return_index=True, return_inverse=True)
    kept = {"sequence": sequence} | {
        name: values
        for name, values in labels.items()
        if name in wanted or (labelled and np.array_equal(values[first][place], values))
    }
    rows: dict[tuple[str, ...], int] = {}
    combinations = zip(*(values.tolist() for values in kept.values()), strict=True)
    of_pose = np.array([rows.setdefault(row, len(rows)) for row in combinations], dtype=np.intp)
    values = np.array(list(rows), dtype=np.str_)
    return Cells({name: values[:, column] for column, name in enumerate(kept)}, of_pose, labelled)


def _parts(entry: str, spread: FloatArray) -> npt.NDArray[np.str_]:
    """Name the part of the poses that each belongs to by its predicted spread; those with none go to the last."""
    known = spread[~np.isnan(spread)]
    if not known.size:
        raise PoseDataError(f"by: {entry!r} needs a spread; expected at least 2 hypotheses and a joint that counts.")
    try:
        if "=" in entry:
            cuts = np.sort([float(cut) for cut in entry.partition("=")[2].split(",")])
            if not np.isfinite(cuts).all():
                raise ValueError
        else:
            parts = int(entry.partition(":")[2] or 3)
            cuts = np.quantile(known, np.arange(1, parts) / parts)
        if not np.isfinite(cuts).all():
            raise ValueError
        edges = [f"{cut:.1f}" for cut in cuts]
        names = [f"1: below {edges[0]} mm"]
    except (ValueError, IndexError):
        raise PoseDataError(
            f"by: {entry!r}; expected spread, spread:5 (equal parts) or spread=40,60 (cuts in mm)."
        ) from None
    names += [f"{k + 2}: {edges[k]} to {edges[k + 1]} mm" for k in range(len(edges) - 1)]
    names += [f"{len(edges) + 1}: above {edges[-1]} mm"]
    return np.array(names)[np.searchsorted(cuts, spread, side="right")]
