"""Clips of predicted motion in shards: named as in one run over the whole set."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

from posecal.errors import PoseDataError, first_few
from posecal.evaluation.shard_passes import Shard, Summary


def with_clips_of_set(shards: Sequence[Shard], summaries: Sequence[Summary]) -> list[Shard]:
    """Say how each shard names its clips: by numbers through all shards, or after sequences where names come back."""
    owner: dict[str, str] = {}
    pairs = (pair for summary in summaries for pair in summary.sequence_of_clip.items())
    of_sequences = any(owner.setdefault(clip, sequence) != sequence for clip, sequence in pairs)
    of_sequences |= len({summary.are_of_sequences for summary in summaries}) > 1
    numbers: dict[object, int] = {}  # of the first clip of each truth
    found, n_clips = [], 0
    for number, (shard, summary) in enumerate(zip(shards, summaries, strict=True)):
        truth = os.fspath(shard.truth) if isinstance(shard.truth, str | os.PathLike) else number
        if truth not in numbers:
            numbers[truth] = n_clips
            n_clips += summary.clips.stored if summary.clips is not None and summary.clips.numbered else 0
        found.append(replace(shard, first_clip=numbers[truth], of_sequences=of_sequences))
    return found


def refuse_shared_clips(shards: Sequence[Shard], summaries: Sequence[Summary]) -> None:
    """Refuse clips of one name in several shards.

    Raises
    ------
    PoseDataError
        Where there are any.
    """
    owner: dict[str, int] = {}
    for number, summary in enumerate(summaries):
        if shared := [clip for clip in summary.sequence_of_clip if owner.setdefault(clip, number) != number]:
            raise PoseDataError(
                f"clip: {len(shared):,} of {shards[number].name} (first: {first_few(shared)}) are in "
                f"{shards[owner[shared[0]]].name} as well, with other poses; expected names that no two clips share."
            )
