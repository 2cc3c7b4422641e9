"""Results of shards that are kept in a folder, so that the same call goes on where another one stopped."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import posecal
from posecal.data.remote import identity_of
from posecal.engine.storage import load_totals, save_totals
from posecal.engine.totals import Totals
from posecal.errors import PoseFileError
from posecal.evaluation.shard_passes import Method, Shard, Task


class KeptResults:
    """Results of tasks in a folder, each by a hash of all that its numbers depend on.

    Parameters
    ----------
    folder : path or None
        Made if need be; None keeps nothing.
    method : Method
        How all shards are evaluated.

    Raises
    ------
    PoseFileError
        Where the folder can't be made.
    """

    def __init__(self, folder: str | os.PathLike[str] | None, method: Method) -> None:
        self.folder = None if folder is None else Path(folder)
        if self.folder is not None:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise PoseFileError(f"{self.folder}: can't be made ({error.strerror}).") from None
        prepared, pool = method.prepared, method.pool
        self._method = [
            posecal.__version__,
            method.protocol.options,
            method.by,
            sorted(method.preranks),
            [[metric["name"], metric["definition"]] for metric in method.own_metrics],
            sorted(method.dropped),
            method.has_mask,
            method.gallery,
            None if pool is None else pool.hash,
            None
            if prepared is None
            else [prepared.hash, prepared.n_poses, {k: [*v] for k, v in prepared.cuts.items()}],
        ]

    def path(self, task: Task) -> Path | None:
        """Give the file of a task's result; None where nothing is kept, or its poses are in no files."""
        if self.folder is None:
            return None
        parts = [[_identity(shard), None if rows is None else _digest(rows)] for shard, rows in task.parts]
        if any(identity is None for identity, _ in parts):
            return None
        place = None if task.place is None else [_digest(rows) for rows in task.place]
        text = json.dumps([self._method, parts, place, task.first], default=str)
        name = "".join(letter if letter.isalnum() else "-" for letter in task.name)[:40]
        return self.folder / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"

    def holds(self, task: Task) -> bool:
        """Whether there is a result of a task."""
        path = self.path(task)
        return path is not None and path.exists()

    def load(self, task: Task) -> Totals | None:
        """Read the result of a task, where there is one that can be read."""
        path = self.path(task)
        try:
            return None if path is None else load_totals(path)
        except PoseFileError:
            return None

    def save(self, task: Task, totals: Totals) -> None:
        """Write the result of a task, whole or not at all."""
        path = self.path(task)
        if path is not None:
            save_totals(totals, path)


def _identity(shard: Shard) -> list[object] | None:
    """Give what changes where the data of a shard do; None where they are in no files."""
    sources = [shard.hypotheses, shard.truth, *([] if shard.reference is None else [shard.reference])]
    if not all(isinstance(source, str | os.PathLike) for source in sources):
        return None
    described = sorted((name, repr(value)) for name, value in shard.described.items())
    kept = None if shard.kept is None else _digest(shard.kept)
    return [*(identity_of(source) for source in sources), described, shard.first, kept]  # type: ignore[arg-type]


def _digest(rows: Sequence[int] | np.ndarray) -> str:
    return hashlib.sha256(np.asarray(rows).tobytes()).hexdigest()
