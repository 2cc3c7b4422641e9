"""Results of shards that are kept in a folder, so that the same call goes on where another one stopped."""

from __future__ import annotations

import hashlib
import json
import marshal
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path

import numpy as np

import posecal
from posecal.data.remote import identity_of
from posecal.engine.storage import load_totals, save_totals
from posecal.engine.totals import Totals
from posecal.engine.user_code import FileFunction
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
            _content(method.preranks),
            _content(method.own_metrics),
            sorted(method.dropped),
            method.has_mask,
            method.gallery,
            None if pool is None else pool.hash,
            None
            if prepared is None
            else [prepared.hashes, prepared.n_poses, {k: [*v] for k, v in prepared.cuts.items()}],
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


def is_kept(path: Path) -> bool:
    """Whether a file has the name of a result that is kept."""
    return re.fullmatch(r".*-[0-9a-f]{32}\.npz", path.name) is not None


def _identity(shard: Shard) -> list[object] | None:
    """Give what changes where the data of a shard do; None where they are in no files."""
    sources = [shard.hypotheses, shard.truth, *([] if shard.reference is None else [shard.reference])]
    if not all(isinstance(source, str | os.PathLike) for source in sources):
        return None
    described = sorted((name, _content(value)) for name, value in shard.described.items())
    kept = None if shard.kept is None else _digest(shard.kept)
    place = shard.first, shard.first_clip, shard.of_sequences
    return [*(identity_of(source) for source in sources), described, *place, kept]  # type: ignore[arg-type]


def _content(value: object, depth: int = 8) -> object:
    """Give what changes where a value does: a function's code, the file of a name, the numbers of an array."""
    if depth == 0:
        return "…"
    inner = partial(_content, depth=depth - 1)
    if isinstance(value, FileFunction):
        return [value.entry, identity_of(value.entry.rpartition(":")[0])]
    if isinstance(value, partial):
        return [inner(value.func), inner(value.args), inner(value.keywords)]
    if hasattr(value, "__code__"):
        cells = [cell.cell_contents for cell in getattr(value, "__closure__", None) or ()]
        return [hashlib.sha256(marshal.dumps(value.__code__)).hexdigest(), inner(cells)]
    if isinstance(value, np.ndarray):
        return [str(value.dtype), value.shape, _digest(value)]
    if isinstance(value, str | os.PathLike):
        return identity_of(value) if Path(value).is_file() else str(value)
    if isinstance(value, Mapping):
        return sorted((str(key), inner(entry)) for key, entry in value.items())
    if isinstance(value, list | tuple):
        return [inner(entry) for entry in value]
    if is_dataclass(value) and not isinstance(value, type):
        return [inner(getattr(value, field.name)) for field in fields(value)]
    return repr(value)


def _digest(rows: Sequence[int] | np.ndarray) -> str:
    return hashlib.sha256(np.asarray(rows).tobytes()).hexdigest()
