"""How do the sums of shards of one test set become one result?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posecal.calibration.rank_tests import NEEDS_COORDINATE_RANGE
from posecal.engine.totals import Totals, difference_of_signatures
from posecal.errors import PoseDataError, raise_all
from posecal.metrics.proper_entries import PAIRED

__all__ = ["merge_totals"]

Cell = tuple[str, ...]


def merge_totals(parts: Sequence[Totals], names: Sequence[str] | None = None) -> Totals:
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
        What one run over all poses gives, but for what depends on which poses are evaluated together: the box of
        ``tarp_box``, climatology's draws and the cuts of ``spread`` are those of each shard, runs of frames without
        sequence labels stay those of their shard, and no velocity reaches over a cut. A sequence may be split over
        shards.

    Raises
    ------
    PoseDataError
        Where two differ in more than their poses, or hold the same poses.
    """
    if not parts:
        raise PoseDataError("merge: no results; expected at least one.")
    names = names or [f"part {number}" for number in range(1, len(parts) + 1)]
    _refuse_unlike(parts, names)
    _refuse_twice(parts, names)
    first, sequences = parts[0], all(part.sequences for part in parts)
    rows: dict[Cell, int] = {}
    where = [
        np.array([rows.setdefault(cell, len(rows)) for cell in cells], dtype=np.intp)
        for cells in (map(_cells, parts) if sequences or len(parts) == 1 else _apart(parts))
    ]
    values = np.array(list(rows), dtype=np.str_).reshape(len(rows), len(first.cells))
    whole = Totals(
        spec=first.spec,
        protocol=first.protocol,
        version=first.version,
        cells={key: values[:, place] for place, key in enumerate(first.cells)},
        poses=np.zeros(len(rows), dtype=np.int64),
        remarks=tuple(dict.fromkeys(remark for part in parts for remark in part.remarks)),
        sequences=sequences,
    )
    for part, cells_of in zip(parts, where, strict=True):
        np.add.at(whole.poses, cells_of, part.poses)
        for statistic in first.sums:
            whole.add(statistic, cells_of, part.sums[statistic], part.counts[statistic])
    whole.per_pose = {name: np.concatenate([part.per_pose[name] for part in parts]) for name in first.per_pose}
    whole.cell_of = np.concatenate([of[part.cell_of] for part, of in zip(parts, where, strict=True)])
    return whole


def _cells(part: Totals) -> list[Cell]:
    """Give the labels of each cell."""
    return list(zip(*(values.tolist() for values in part.cells.values()), strict=True))


def _apart(parts: Sequence[Totals]) -> list[list[Cell]]:
    """Give the labels of each cell of each shard, with runs of frames named after their shard."""
    at = list(parts[0].cells).index("sequence")
    return [
        [(*cell[:at], f"{number}/{cell[at]}", *cell[at + 1 :]) for cell in _cells(part)]
        for number, part in enumerate(parts, 1)
    ]


def _refuse_unlike(parts: Sequence[Totals], names: Sequence[str]) -> None:
    first, problems = parts[0], []
    for name, part in zip(names[1:], parts[1:], strict=True):
        if part.signature != first.signature:
            problems.append(f"{names[0]} and {name} were not made alike: {difference_of_signatures(first, part)}.")
        if first.protocol.velocity == "second" and part.spec.fps != first.spec.fps:
            rates = f"{first.spec.fps:g} and {part.spec.fps:g}"
            problems.append(f"{names[0]} and {name} have {rates} frames per second; expected the same.")
        held, ours = ({*t.cells, *t.sums, *t.per_pose} for t in (first, part))
        if held != ours:
            problems.append(f"{names[0]} and {name} differ in what they hold: {', '.join(sorted(held ^ ours))}.")
    raise_all(problems)


def _refuse_twice(parts: Sequence[Totals], names: Sequence[str]) -> None:
    """Refuse a cell that two shards hold with the same labels, number of poses and sums."""
    seen: dict[tuple[object, ...], str] = {}
    for name, part in zip(names, parts, strict=True):
        sums = [
            values
            for statistic, values in part.sums.items()
            if statistic not in NEEDS_COORDINATE_RANGE and not statistic.startswith(PAIRED)
        ]
        for place, cell in enumerate(_cells(part)):
            trace = (cell, int(part.poses[place]), *(float(values[place].sum()) for values in sums))
            if trace in seen:
                raise PoseDataError(
                    f"{seen[trace]} and {name} hold the same poses (cell {', '.join(cell)}); expected shards "
                    "without poses in common."
                )
            seen[trace] = name
