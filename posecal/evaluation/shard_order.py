"""Tasks of shards: where frames follow each other from shard to shard, their sequence is evaluated in one task."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from posecal.data.frame_numbers import order_by_number
from posecal.data.stored_poses import Rows
from posecal.engine.sums import split_by
from posecal.errors import PoseDataError, first_few
from posecal.evaluation.shard_passes import Frames, Names, Shard, Summary, Task


def shared_sequences(summaries: Sequence[Summary]) -> frozenset[str]:
    """Find the sequences of which several shards hold poses that are scored."""
    number = Counter(name for summary in summaries for name in summary.sequences)
    return frozenset(name for name, shards in number.items() if shards > 1)


def tasks_of(
    shards: Sequence[Shard], summaries: Sequence[Summary], frames: Mapping[int, Frames], *, has_segments: bool
) -> tuple[list[Task], list[str]]:
    """Make a task of each shard, or of its share of the sequences that lie in several ones.

    Parameters
    ----------
    shards, summaries : sequences
        All of them.
    frames : mapping of Frames
        By the number of a shard, the frames of sequences that others hold as well; empty where no metric is of
        consecutive poses.
    has_segments : bool
        Whether consecutive poses are aligned together.

    Returns
    -------
    tasks : list of Task
        Of shards of which something is scored.
    remarks : list of str
        What a careful reader should know.

    Raises
    ------
    PoseDataError
        Where segments reach over shards whose order is not known.
    """
    first = np.cumsum([0, *(summary.n_scored for summary in summaries)])
    tasks = {n: Task(shard.name, ((shard, None),), first=int(first[n])) for n, shard in enumerate(shards)}
    if not frames:
        return [tasks[n] for n in tasks if summaries[n].n_scored], []
    numbers = [*frames]
    sizes = [len(frames[n].order) for n in numbers]
    shard_of = np.repeat(numbers, sizes)
    scored = np.concatenate([frames[n].scored for n in numbers])
    sequence = np.concatenate([frames[n].sequence for n in numbers])
    ordered = _by_number(frames, sequence)
    rows, order, remarks = ordered or _as_they_come(frames, summaries, sequence)
    if not ordered and (names := _returning(summaries, shared_sequences(summaries))):
        what = f"sequence: {first_few(names)} in shards that don't follow each other, and no numbers in frame_id tell "
        if has_segments:
            raise PoseDataError(
                f"{what}the order of the frames; expected some, since segments are of consecutive ones."
            )
        remarks = [*remarks, f"{what}the order of the frames: no difference over time reaches from shard to shard."]
    is_scored = scored[rows] >= 0
    rows, order = rows[is_scored], order[is_scored]
    codes = np.unique(sequence[rows], return_inverse=True)[1]
    of_sequence = split_by(codes, int(codes.max(initial=-1)) + 1)
    load = {n: len(frames[n].others) for n in numbers}
    given: dict[int, list[Rows]] = {n: [] for n in numbers}
    for places in sorted(of_sequence, key=lambda places: int(places[0])):
        holders = dict.fromkeys(shard_of[rows[places]].tolist())
        chosen = min(holders, key=lambda n: (load[n], n))
        load[chosen] += len(places)
        given[chosen].append(places)
    for n in numbers:
        places = np.concatenate([np.zeros(0, dtype=np.intp), *given[n]])
        tasks[n] = _task(n, shards, frames[n], shard_of[rows[places]], scored[rows[places]], order[places])
    return [task for n, task in tasks.items() if task.parts and summaries[n].n_scored], remarks


def _task(own: int, shards: Sequence[Shard], frames: Frames, shard_of: Rows, scored: Rows, order: Rows) -> Task:
    """Make a task of a shard's own poses and of some that lie in this and in others, in their order."""
    shard_of = np.concatenate([np.full(len(frames.others), own), shard_of])
    scored = np.concatenate([frames.others, scored])
    order = np.concatenate([frames.order_of_others, order])
    by_shard = np.argsort(shard_of, kind="stable")  # as they lie after one another when shards are read
    holders = np.unique(shard_of).tolist()
    parts = tuple((shards[n], scored[shard_of == n]) for n in holders)
    place = np.empty(len(by_shard), dtype=np.intp)
    place[by_shard] = np.arange(len(by_shard))
    return Task(", ".join(shards[n].name for n in holders), parts, (place, order))


Ordered = tuple[Rows, Rows, list[str]]
"""Frames one after another, a number of each that differs by 1 where one follows the one before it, and remarks."""


def _by_number(frames: Mapping[int, Frames], sequence: Names) -> Ordered | None:
    """Order the frames of all shards by the numbers in their names; None where they have none."""
    names = [some.names for some in frames.values() if some.names is not None]
    return order_by_number(np.concatenate(names), sequence) if len(names) == len(frames) else None


def _as_they_come(frames: Mapping[int, Frames], summaries: Sequence[Summary], sequence: Names) -> Ordered:
    """Order the frames of all shards by sequence, in the order of the shards."""
    start = np.cumsum([0, *(summary.n_poses for summary in summaries)])
    order = np.concatenate([some.order + start[n] for n, some in frames.items()])
    _, first, codes = np.unique(sequence, return_index=True, return_inverse=True)
    rows = np.lexsort((order, first[codes]))
    return rows, order[rows], []


def _returning(summaries: Sequence[Summary], shared: frozenset[str]) -> list[str]:
    """Name the sequences that come back after another one, from shard to shard."""
    holding = [summary.sequences for summary in summaries if summary.sequences]
    found = []
    for name in sorted(shared):
        holders = [n for n, sequences in enumerate(holding) if name in sequences]
        follows = (b == a + 1 and holding[a][-1] == name == holding[b][0] for a, b in pairwise(holders))
        found += [] if all(follows) else [name]
    return found
