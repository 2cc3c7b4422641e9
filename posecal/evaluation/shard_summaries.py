"""Findings of shards put together: whether they are of one set, and which poses several of them hold."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from posecal.data.read import read_poses
from posecal.data.stored_poses import Rows
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError, first_few, option, raise_all
from posecal.evaluation.shard_passes import Failure, Shard, Summary
from posecal.stats.skill import Keys


def refuse_failures(failures: Sequence[Failure], more: str = "") -> None:
    """Refuse shards that failed, by name; with a sentence at the end.

    Raises
    ------
    PoseDataError
        Where there are any.
    """
    pairs = [(failure.name, message) for failure in failures for message in failure.messages]
    messages = [message if message.startswith(name) else f"{name}: {message}" for name, message in pairs]
    if messages:
        messages[-1] = f"{messages[-1]} {more}".rstrip()
    raise_all(messages)


def refuse_left_out(shards: Sequence[Shard], summaries: Sequence[Summary]) -> None:
    """Refuse frames of the one file of truth that no shard has."""
    if shards[0].described.get("missing") != "part" or not isinstance(shards[0].truth, str | os.PathLike):
        return
    truth = read_poses(shards[0].truth, "truth")
    if truth.frame_id is None or truth.valid is not None:
        return
    total, number = len(truth.frame_id), sum(summary.n_poses for summary in summaries)
    if number < total:
        raise PoseDataError(
            f"{truth.name}: {total - number:,} of {total:,} frames are in no shard; expected all. Pass "
            f"{option('missing', 'skip')} to score the rest."
        )


def kept_poses(keys: Sequence[Keys]) -> dict[int, Rows]:
    """Find the poses of each shard that no earlier one has, of shards that share some.

    Poses that equal others of their own shard, as those of cameras that see one moment do, are not looked at.
    """
    every = np.concatenate(keys)
    if np.unique(every).size == every.size:
        return {}
    shard = np.repeat(np.arange(len(keys)), [len(some) for some in keys])
    order = np.argsort(every, kind="stable")
    key, owner = every[order], shard[order]
    begins = np.concatenate([[True], key[1:] != key[:-1]])
    group = np.cumsum(begins) - 1
    is_alone = np.ones(group[-1] + 1, dtype=bool)
    is_alone[group[1:][~begins[1:] & (owner[1:] == owner[:-1])]] = False
    is_repeated = np.zeros(len(every), dtype=bool)
    is_repeated[order] = (owner != owner[begins][group]) & is_alone[group]
    start = np.cumsum([0, *(len(some) for some in keys)])
    of_shard = [is_repeated[start[n] : start[n + 1]] for n in range(len(keys))]
    return {n: np.flatnonzero(~repeated) for n, repeated in enumerate(of_shard) if repeated.any()}


def refuse_duplicates(shards: Sequence[Shard], summaries: Sequence[Summary], kept: Mapping[int, Rows]) -> None:
    """Refuse poses that earlier shards hold, of which these are the others.

    Raises
    ------
    PoseDataError
        With their number in each shard.
    """
    names = first_few([f"{summaries[n].n_poses - len(rows):,} of {shards[n].name}" for n, rows in kept.items()], 5)
    number = sum(summaries[n].n_poses - len(rows) for n, rows in kept.items())
    raise PoseDataError(
        f"duplicates: {number:,} poses are in an earlier shard as well, with the same truth, labels and frame_id "
        f"({names}); expected every pose once. Pass {option('duplicates', 'drop')} to count each once."
    )


def plain(spec: DataSpec) -> DataSpec:
    """Leave out what may differ from shard to shard."""
    return replace(spec, labels=(), has_mask=False, has_weights=False, is_ragged=False)


def common_spec(shards: Sequence[Shard], summaries: Sequence[Summary]) -> DataSpec:
    """Describe all shards.

    Raises
    ------
    PoseDataError
        For those that are described otherwise than the first.
    """
    first = summaries[0].spec
    problems = []
    for shard, summary in zip(shards, summaries, strict=True):
        if difference := plain(summary.spec).difference(plain(first)):
            problems.append(f"{shard.name}: {difference} of {shards[0].name}; expected the same in every shard.")
        elif ("sequence" in summary.spec.labels) != ("sequence" in first.labels):
            problems.append(
                f"{shard.name} and {shards[0].name}: only one has sequence labels; expected both, or neither."
            )
    raise_all(problems)
    labels = [label for label in first.labels if all(label in summary.spec.labels for summary in summaries)]
    for summary in summaries:
        first = first.together_with(summary.spec)
    return replace(first, labels=tuple(labels), has_mask=any(summary.spec.has_mask for summary in summaries))


def splits_sequences(label: str, summaries: Sequence[Summary]) -> bool:
    """Whether poses of one sequence have several values of a label, within a shard or over all."""
    values: dict[str, str] = {}
    for summary in summaries:
        if summary.n_scored and label not in summary.labels:
            return True
        for sequence, value in summary.labels.get(label, {}).items():
            if values.setdefault(sequence, value) != value:
                return True
    return False
