"""What is done with the shards of a test set where they are read: in this process, in others or on a cluster."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from posecal.calibration.rank_tests import PreRank
from posecal.data.clips import Clips, is_of_sequence, select_clips, with_names_of_set
from posecal.data.draws import DrawnHypotheses
from posecal.data.file_array import without_checksums
from posecal.data.frame_numbers import STEPS
from posecal.data.gaussian import starting_at
from posecal.data.joined import join_poses
from posecal.data.pose_data import PoseData
from posecal.data.stored_poses import ArrayHypotheses, Rows
from posecal.engine.chunks import map_blocks
from posecal.engine.metric import Metric
from posecal.engine.pose_hashes import are_told_apart, pose_keys
from posecal.engine.prepare import Prepared, lack_of_scored, prepare, select_scored
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.engine.totals import Totals
from posecal.errors import PosecalError, PoseDataError, option
from posecal.evaluation.batches import Evaluation
from posecal.evaluation.sources import Source, as_pose_data
from posecal.metrics.sharpness import predicted_spread
from posecal.registry import register, registered_metrics, wants_reference
from posecal.stats.skill import ClimatologyPool, Keys, climatology, with_reference

Names = npt.NDArray[np.str_]
_ROW = "row in the shard"
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Shard:
    """Hypotheses and truth of a part of the poses.

    Attributes
    ----------
    name : str
        What messages call it.
    hypotheses, truth : Source
        As for :func:`posecal.evaluate`; pose data alone.
    reference : Source, optional
        Hypotheses of another model.
    described : mapping
        The options that describe the data.
    first : int
        How many poses lie in the shards before it, by which draws are seeded.
    first_clip : int
        How many clips lie in the shards before it, by which those without names are numbered.
    of_sequences : bool
        Whether clips are named after their sequences, since those of several have one name somewhere in the set.
    kept : array of int, optional
        Poses that no earlier shard has, where it shares some.
    """

    name: str
    hypotheses: Source | PoseData
    truth: Source | None
    reference: Source | PoseData | None = None
    described: Mapping[str, Any] = field(default_factory=dict)
    first: int = 0
    first_clip: int = 0
    of_sequences: bool = False
    kept: Rows | None = None

    def open(self) -> PoseData:
        """Open the sources and match them, with the hypotheses of another model as their reference."""
        data = as_pose_data(starting_at(self.hypotheses, self.first), self.truth, self.described)
        if data.clips is not None and not data.clips.has_axis:
            raise PoseDataError(
                f"{self.name}: clips by a label clip, which may lie in several files; expected {option('axes')} "
                "with a T, such as NMTKD, so that each is whole, or all poses in one call of evaluate."
            )
        data = with_names_of_set(data, self.first_clip, of_sequences=self.of_sequences)
        some = data.hypotheses
        if isinstance(some, ArrayHypotheses) and isinstance(some.array, DrawnHypotheses):
            drawn = replace(some.array, prediction=starting_at(some.array.prediction, self.first))
            data = data.replace(hypotheses=replace(some, array=drawn))
        if self.reference is not None:
            own = dict.fromkeys(("scores", "weights", "log_prob", "dimensions"))  # of the model
            other = as_pose_data(self.reference, self.truth, {**self.described, **own})
            data = with_reference(data, other.replace(names=("reference", other.names[1])))  # of one name in all shards
        return data if self.kept is None else select_clips(data, self.kept)

    def of(self, data: PoseData) -> Shard:
        """Give the shard of data that were opened."""
        return Shard(self.name, data, None, first=self.first)


@dataclass(frozen=True)
class Method:
    """How all shards are evaluated, and what was found from all of them.

    Attributes
    ----------
    protocol, by, preranks, threads, gallery
        As for :func:`posecal.evaluate`.
    own_metrics : tuple of mappings
        The parts of the user's metrics, which other processes register; pickled as they are, they lose their functions.
    dropped : frozenset of str
        Labels that split a sequence of the whole set, which nobody asked for; poses keep their clips.
    has_mask : bool
        Whether some joints don't count in some shard.
    prepared : Prepared, optional
        What depends on all poses.
    pool : ClimatologyPool, optional
        What climatology samples.
    """

    protocol: Protocol
    by: tuple[str, ...] = ()
    preranks: Mapping[str, PreRank] = field(default_factory=dict)
    threads: int | None = None
    own_metrics: tuple[Mapping[str, Any], ...] = ()
    gallery: bool = True
    dropped: frozenset[str] = frozenset()
    has_mask: bool = False
    prepared: Prepared | None = None
    pool: ClimatologyPool | None = None

    def open(self, shard: Shard) -> PoseData:
        """Open a shard, with its reference, and select what is scored."""
        data = shard.open()
        if self.pool is not None:
            data = with_reference(data, climatology(data, pool=self.pool))
        data = select_scored(data if wants_reference(self.protocol) else data.replace(reference=None), self.protocol)
        if self.has_mask and data.where is None:
            data = data.replace(where=np.ones(data.truth.shape[:2], dtype=bool))
        kept = {k: values for k, values in data.labels.items() if k == "clip" or k not in self.dropped}
        return data.replace(labels=kept)

    def register(self) -> None:
        """Register the user's metrics where they are not known yet."""
        known = {metric.name for metric in registered_metrics()}
        for parts in self.own_metrics:
            if parts["name"] not in known:
                register(Metric(**parts))


def sendable_metrics() -> tuple[Mapping[str, Any], ...]:
    """Give the parts of the user's metrics that can be sent, for :meth:`Method.register`; others stay here."""
    found = []
    for metric in registered_metrics():
        with suppress(Exception):  # whatever pickling a user's function raises
            pickle.dumps(parts := {field.name: getattr(metric, field.name) for field in fields(metric)})
            found.append(parts)
    return tuple(found)


@dataclass(frozen=True)
class Task:
    """Poses that are evaluated together: those of a shard, and sequences of which others hold poses.

    Attributes
    ----------
    name : str
        What messages call it.
    parts : tuple
        Shards, with the numbers of their scored poses that are taken; None for all.
    place : tuple of two arrays of int (M,), optional
        In which order they are taken, and the ``order`` of each, by which poses follow each other.
    first : int
        The number of its first pose in the whole set.
    """

    name: str
    parts: tuple[tuple[Shard, Rows | None], ...]
    place: tuple[Rows, Rows] | None = None
    first: int = 0


@dataclass(frozen=True)
class Failure:
    """What was wrong with a shard."""

    name: str
    messages: tuple[str, ...]


@dataclass(frozen=True)
class Summary:
    """What the first pass finds of a shard, from its true poses.

    Attributes
    ----------
    spec : DataSpec
        What the data are.
    n_poses : int
        How many there are, scored or not.
    n_stored : int
        How many there are in the file of hypotheses.
    lack : str
        Why nothing is scored; empty where something is.
    keys : array of int (M,)
        What tells the poses apart; empty where nothing does.
    prepared : Prepared or None
        Of the poses that are scored; None where there is none.
    pool : ClimatologyPool
        What climatology may sample.
    labels : mapping of mappings
        The value of each label for each sequence, of labels that split none.
    sequences : tuple of str
        Sequences of poses that are scored, in the order of their first ones.
    clips : Clips or None
        What clips have in common; without the poses before them.
    sequence_of_clip : mapping of str
        By the name of a clip; empty where clips have numbers.
    are_of_sequences : bool
        Whether clips are named after their sequences.
    """

    spec: DataSpec
    n_poses: int
    n_stored: int
    lack: str
    keys: Keys
    prepared: Prepared | None
    pool: ClimatologyPool | None
    labels: Mapping[str, Mapping[str, str]]
    sequences: tuple[str, ...] = ()
    clips: Clips | None = None
    sequence_of_clip: Mapping[str, str] = field(default_factory=dict)
    are_of_sequences: bool = False

    @property
    def n_scored(self) -> int:
        """How many poses are scored."""
        return 0 if self.prepared is None else self.prepared.n_poses


@dataclass(frozen=True)
class Attempt(Generic[Item, Result]):
    """A call whose failure is a result, so that other shards go on."""

    function: Callable[[Item], Result]

    def __call__(self, item: Item) -> Result | Failure:
        """Call the function of a shard or a task."""
        name = getattr(item, "name", "")
        try:
            return self.function(item)
        except PosecalError as error:
            return Failure(name, tuple(error.problems) or (error.message,))
        except Exception as error:  # noqa: BLE001 (of whatever kind: the results of other shards are kept)
            return Failure(name, (f"{type(error).__name__}: {error}",))


def summarize(shard: Shard, method: Method, *, is_pooled: bool) -> Summary:
    """Find what the whole set depends on, from the true poses of a shard."""
    with without_checksums():  # which the last pass compares
        data = shard.open()
    has_mask, keys = data.where is not None, pose_keys(data)
    scored = method.open(shard.of(data))
    labels: dict[str, dict[str, str]] = {}
    sequences: tuple[str, ...] = ()
    if "sequence" in scored.labels and len(scored.truth):
        names, first, inverse = np.unique(scored.labels["sequence"], return_index=True, return_inverse=True)
        sequences = tuple(names[np.argsort(first)].tolist())
        for label, values in scored.labels.items():
            if (values[first][inverse] == values).all():
                labels[label] = dict(zip(names.tolist(), values[first].tolist(), strict=True))
    stored, clips = data.hypotheses, data.clips
    are_named = clips is not None and "clip" not in clips.numbered
    pairs = zip(data.labels["clip"].tolist(), data.labels["sequence"].tolist(), strict=True) if are_named else ()
    return Summary(
        spec=DataSpec.of(scored, has_mask=has_mask, preranks=tuple(method.preranks)),
        n_poses=len(data.truth),
        n_stored=stored.array.shape[1] if isinstance(stored, ArrayHypotheses) else len(data.truth),
        lack=lack_of_scored(scored, method.protocol),
        keys=keys if are_told_apart(data) else keys[:0],
        prepared=prepare(scored) if len(scored.truth) else None,
        pool=ClimatologyPool.of(data, keys) if is_pooled else None,
        labels=labels,
        sequences=sequences,
        clips=None if clips is None else replace(clips, observed={}),
        sequence_of_clip=dict(pairs),
        are_of_sequences=are_named and is_of_sequence(data),
    )


@dataclass(frozen=True)
class Frames:
    """The frames of a shard whose sequences lie in several ones.

    Attributes
    ----------
    names : array of str (m,) or None
        Their names, where the shard has any.
    sequence, order : arrays (m,)
        Of each.
    scored : array of int (m,)
        Their numbers among the poses that are scored; -1 for others.
    others, order_of_others : arrays of int (rest,)
        The other poses that are scored.
    """

    names: Names | None
    sequence: Names
    order: Rows
    scored: Rows
    others: Rows
    order_of_others: Rows


def find_frames(shard: Shard, method: Method, sequences: frozenset[str]) -> Frames:
    """Find the frames of some sequences of a shard."""
    with without_checksums():
        data = shard.open()
    rows = np.arange(len(data.truth))
    numbered = data.replace(labels={**data.labels, _ROW: rows.astype(np.str_)})
    scored = method.open(shard.of(numbered))
    number = np.full(len(rows), -1)
    number[scored.labels[_ROW].astype(np.intp)] = np.arange(len(scored.truth))
    rows = np.flatnonzero(np.isin(data.labels["sequence"], [*sequences]))
    others = np.setdiff1d(np.arange(len(scored.truth)), number[rows])
    names = data.frame_id[rows] if data.has_frame_id and data.clips is None else None  # clips lie in their order
    return Frames(names, data.labels["sequence"][rows], data.order[rows], number[rows], others, scored.order[others])


def find_spreads(shard: Shard, method: Method) -> npt.NDArray[np.float64]:
    """Find the predicted spread of every pose of a shard that is scored, (M,)."""
    data = method.open(replace(shard, reference=None))
    if not len(data.truth):
        return np.zeros(0)
    return np.concatenate([np.asarray(part) for part in map_blocks(data, predicted_spread, method.threads)])


def accumulate(task: Task, method: Method) -> Totals | None:
    """Sum the statistics of the poses of a task; None where it has none that is scored."""
    method.register()
    parts = []
    for shard, rows in task.parts:
        data = method.open(shard)
        if rows is not None:
            data = data.select(rows)
        if len(data.truth):
            parts.append(data)
    if not parts:
        return None
    data = join_poses(parts)
    if task.place is not None:
        rows, order = task.place
        remarks = tuple(remark for remark in data.remarks if not remark.startswith(STEPS))  # of single shards
        data = data.select(rows).replace(order=order, remarks=remarks)
    assert method.prepared is not None
    prepared = replace(method.prepared, first=task.first)
    options: dict[str, Any] = {"preranks": method.preranks, "prepared": prepared, "threads": method.threads}
    evaluation = Evaluation(by=method.by, protocol=method.protocol, gallery=method.gallery, **options)
    evaluation.add(data, complete=True, has_mask=method.has_mask, of_set=True)
    return evaluation.totals()
