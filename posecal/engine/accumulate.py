"""Accumulation of per-pose statistics into sums per cell, in one pass over blocks of poses.

Poses come in one piece (an array or a file, read some poses at a time) or in batches of any length. Either way they are
cut into the same blocks, at multiples of the block length counted from the first pose, so that the sums are the same.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

import posecal
from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.clips import given_labels
from posecal.data.pose_data import PoseData
from posecal.engine.block import block_length
from posecal.engine.cells import CellIndex
from posecal.engine.chunks import Chunk, Indices, join_chunks, read_chunks
from posecal.engine.gallery import Gallery, join_galleries, worst_of
from posecal.engine.measure import Measured, measure_block, of_plain_poses
from posecal.engine.metric import Metric, Statistic
from posecal.engine.pose_hashes import PoseHashes, add_hashes, pose_hashes, repeated_remarks, smallest_hashes
from posecal.engine.pose_remarks import PoseRemarks
from posecal.engine.prepare import Prepared, refuse_non_finite
from posecal.engine.protocol import Protocol
from posecal.engine.ragged import lay_out, with_weights
from posecal.engine.scope import DataSpec, Scope
from posecal.engine.segments import SegmentsAndClips
from posecal.engine.sums import add_rows, joined_rows, padded
from posecal.engine.threads import run_in_order
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, first_few, option

Progress = Callable[[int], object]
Pending = Literal["rest", "none", "all"]


class Accumulator:
    """Sums of statistics per cell, of poses that come in one piece or in batches.

    Parameters
    ----------
    spec : DataSpec
        What the data are; the same for all batches.
    protocol : Protocol
        The options.
    statistics : sequence of Statistic
        What is summed.
    index : CellIndex
        What is kept apart.
    prepared : Prepared, optional
        What depends on the whole set, where a statistic needs it.
    own_metrics : sequence of Metric
        The user's metrics among those that are summed for.
    threads : int, optional
        One per core by default.
    """

    def __init__(
        self,
        spec: DataSpec,
        protocol: Protocol,
        statistics: Sequence[Statistic],
        index: CellIndex,
        *,
        prepared: Prepared | None = None,
        own_metrics: Sequence[Metric] = (),
        threads: int | None = None,
    ) -> None:
        self.spec, self.protocol, self.own_metrics = spec, protocol, tuple(own_metrics)
        self.statistics = tuple(statistics)
        self._index, self._prepared, self._threads = index, prepared, threads
        self._sums: dict[str, tuple[FloatArray, npt.NDArray[np.int64]]] = {}
        self._poses = np.zeros(0, dtype=np.int64)
        self._are_lent = False  # whether totals that were given hold these sums
        self._per_pose: dict[str, list[FloatArray]] = {}
        self._cell_of: list[Indices] = []
        self._hashes: list[PoseHashes] = []
        self._gallery: Gallery | None = None
        self._truth_name = ""
        self._pending: list[Chunk] = []  # poses that wait for the next ones, in memory of their own
        self._length = self._measured = self._given = 0
        self._earlier = max((statistic.earlier for statistic in self.statistics), default=0)
        self._before: Chunk | None = None  # so many poses before the pending ones
        clips = None if prepared is None else prepared.clips
        self._segments = SegmentsAndClips(self.statistics, protocol.segment_length, spec, clips)
        self._last: tuple[str, str, int] | None = None  # of the last pose, as _place; None where it was dropped
        self._remarks = PoseRemarks(Scope(protocol, spec), self.statistics)
        self._prepared_hashes = {} if prepared is None else prepared.hashes
        self._first = 0 if prepared is None else prepared.first or 0
        self._failure = ""  # what stopped a batch when some of it was counted

    def add(self, data: PoseData, progress: Progress | None = None, *, pending: Pending = "rest") -> None:
        """Add poses.

        Parameters
        ----------
        data : PoseData
            The next poses; the first one continues the last one's sequence where their ``order`` differs by 1.
        progress : callable, optional
            Called with the number of poses that are done.
        pending : str
            Which of them wait for the next ones: the ``rest`` that fills no block, ``none``, or ``all``.

        Raises
        ------
        PoseDataError
            For sequences that ``prepared`` lacks, coordinates that are not finite, and after a failure.

        Notes
        -----
        A failure while poses are measured leaves some of them counted. Then nothing more is added or given.
        """
        self._refuse_after_failure()
        if data.reference is not None and hasattr(data.reference.hypotheses, "hash"):
            self._prepared_hashes["climatology"] = data.reference.hypotheses.hash
        numbers = self._sequence_numbers(data)
        try:
            self._add(data, numbers, progress, pending)
        except BaseException as error:  # an interrupt as well
            self._failure = f"{type(error).__name__}: {error}".strip(": ")
            raise
        self._last = _place(data, -1)

    def _add(self, data: PoseData, numbers: Indices, progress: Progress | None, pending: Pending) -> None:
        most = max(data.shape[0], 0 if data.reference is None else data.reference.shape[0])
        self._length = self._length or block_length((most, *data.shape[1:]), data.hypotheses.read(0, 1).dtype)
        cells, moved = self._index.assign(data.labels, len(data.truth))
        if moved is not None:
            self._join_cells(moved)
        self._grow(int(cells.max(initial=-1)) + 1)
        first, measured_before = self._measured + self.n_pending, self._measured
        bad: list[Indices] = []
        bad_of_reference: list[Indices] = []
        for measured in self._measure(self._blocks_of_more(self._located(data, cells, numbers), pending)):
            bad.append(measured.non_finite)
            bad_of_reference.append(measured.non_finite_of_reference)
            if progress is not None:
                progress(self._measured - measured_before)
        names = data.names[0], "" if data.reference is None else data.reference.names[0]
        for name, places in zip(names, (bad, bad_of_reference), strict=True):
            if places:
                refuse_non_finite(data, name, np.concatenate(places) - np.array([first, 0]))
        self._truth_name = data.names[1]

    def totals(self) -> Totals:
        """Give the sums of all poses so far; more may be added afterwards.

        Raises
        ------
        PoseDataError
            After a batch that failed part way.
        """
        self._refuse_after_failure()
        final, cells = copy.copy(self), self._index.cells
        n = len(cells["sequence"])
        final._are_lent = True
        final._per_pose = {name: list(parts) for name, parts in self._per_pose.items()}
        final._cell_of, final._hashes, final._pending = list(self._cell_of), list(self._hashes), list(self._pending)
        final._segments = copy.copy(self._segments)
        for _ in final._measure(final._last_block()):
            pass
        self._are_lent |= final._are_lent
        poses = final._poses[:n]
        number = np.cumsum(poses > 0) - 1
        used = slice(n) if poses.all() else np.flatnonzero(poses)  # select_pending may leave none
        hashes = smallest_hashes(final._hashes)
        return Totals(
            spec=self.spec,
            protocol=self.protocol,
            version=posecal.__version__,
            cells={name: values[used] for name, values in cells.items()},
            poses=poses[used],
            remarks=(*self._remarks.remarks(), *repeated_remarks(hashes, int(final._poses.sum()), self._truth_name)),
            has_sequences=self._index.has_sequences,
            sums={name: sums[used] for name, (sums, _) in final._sums.items()},
            counts={name: counts[used] for name, (_, counts) in final._sums.items()},
            per_pose={name: np.concatenate(parts) for name, parts in final._per_pose.items()},
            cell_of=number[np.concatenate(final._cell_of)] if final._per_pose else np.zeros(0, dtype=np.intp),
            pose_hashes=hashes,
            own_metrics=self.own_metrics,
            prepared_hashes=dict(self._prepared_hashes),
            gallery=final._gallery,
        )

    def select_pending(self, chosen: BoolArray) -> None:
        """Keep some of the pending poses; the one after a pose that is dropped follows none."""
        if self._pending:
            poses = join_chunks(self._pending)
            follows = poses.follows & np.concatenate([[True], chosen[:-1]])
            poses = replace(poses, follows=follows).select(np.flatnonzero(chosen))
            self._pending = [poses] if len(poses) else []
            if not chosen[-1]:
                self._last = None

    def with_weights(self, spec: DataSpec, statistics: Sequence[Statistic]) -> Accumulator:
        """Copy the sums of some statistics, those of absent or weighted hypotheses, so that such poses can be added."""
        other, names = copy.deepcopy(self), {statistic.name for statistic in statistics}
        other.spec, other.statistics = spec, tuple(statistics)
        other._sums = {name: sums for name, sums in other._sums.items() if name in names}
        for name, value in of_plain_poses(self.spec.n_hypotheses).items():  # the poses so far
            other._sums.setdefault(name, (value * other._poses, other._poses.copy()))
        other._per_pose = {name: values for name, values in other._per_pose.items() if name in names}
        other._cell_of = other._cell_of if other._per_pose else []
        other._pending = [with_weights(chunk, spec) for chunk in other._pending]
        other._earlier, other._segments = 0, SegmentsAndClips((), 0, spec)  # no such metric is of weighted hypotheses
        return other

    @property
    def n_pending(self) -> int:
        """How many poses are pending."""
        return sum(map(len, self._pending))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "statistics": ()}  # functions stay in the process

    def __copy__(self) -> Accumulator:
        other = object.__new__(Accumulator)
        other.__dict__.update(self.__dict__)
        return other

    def _refuse_after_failure(self) -> None:
        if self._failure:
            raise PoseDataError(
                f"evaluation: a batch failed part way ({self._failure}), so that some of it is counted; expected "
                "reset() and all batches anew."
            )

    # --- blocks

    def _sequence_numbers(self, data: PoseData) -> Indices:
        """Give the numbers of the poses' sequences in the coordinate range, (m,)."""
        if self._prepared is None or "sequence" not in data.labels:
            if self._prepared is not None and self._prepared.sequences:
                raise PoseDataError(
                    f"sequence: missing in these poses; expected one of {option('prepared')}, such as "
                    f"{next(iter(self._prepared.sequences))}."
                )
            return self._first + self._measured + self.n_pending + np.arange(len(data.truth))
        names, inverse = np.unique(data.labels["sequence"], return_inverse=True)
        lacking = [str(name) for name in names if str(name) not in self._prepared.sequences]
        if lacking:
            raise PoseDataError(
                f"sequence: {first_few(lacking)} not in {option('prepared')}; expected it to be made with the true "
                "poses of all batches and their sequences."
            )
        return np.array([self._prepared.sequences[str(name)] for name in names], dtype=np.intp)[inverse]

    def _located(self, data: PoseData, cells: Indices, numbers: Indices) -> Iterator[Chunk]:
        """Read the poses with their cells, and with the numbers of their sequences in the coordinate range."""
        start, first = 0, _place(data, 0)
        given = given_labels(data)
        continues = first is not None and (*first[:2], first[2] - 1) == self._last
        for chunk in read_chunks(data, self._length):
            chunk, stop = with_weights(chunk, self.spec), start + len(chunk)
            follows = chunk.follows.copy()
            follows[0] |= continues and start == 0
            self._remarks.add(data.names, chunk, data.frame_id[start:stop], self.spec)
            part = slice(start, stop)
            labels = {name: values[part] for name, values in given.items()}
            hashes = pose_hashes(chunk.truth, labels, data.frame_id[part] if data.has_frame_id else None)
            yield replace(chunk, cells=cells[part], sequence=numbers[part], hashes=hashes, follows=follows)
            start = stop

    def _measure(self, tasks: Iterable[Callable[[], Measured]]) -> Iterator[Measured]:
        """Run tasks and add what they give to the sums."""
        for measured in run_in_order(tasks, self._threads):
            self._measured += measured.poses
            if self._are_lent:
                self._sums = {name: (sums.copy(), counts.copy()) for name, (sums, counts) in self._sums.items()}
                self._poses, self._are_lent = self._poses.copy(), False
            for name, (sums, counts) in measured.sums.items():
                if name not in self._sums:
                    rows = len(self._poses)
                    self._sums[name] = (
                        np.zeros((rows, *sums.shape[1:])),
                        np.zeros((rows, *counts.shape[1:]), dtype=np.int64),
                    )
                add_rows(self._sums[name][0], measured.cells, sums)
                add_rows(self._sums[name][1], measured.cells, counts)
            add_rows(self._poses, measured.cells, measured.poses_of_cells)
            for name, values in measured.per_pose.items():
                self._per_pose.setdefault(name, []).append(values)
            if measured.per_pose:
                self._cell_of.append(measured.cell_of)
            if measured.worst is not None:
                self._gallery = join_galleries([some for some in (self._gallery, measured.worst) if some is not None])
            yield measured

    def _blocks_of_more(self, chunks: Iterable[Chunk], pending: Pending) -> Iterator[Callable[[], Measured]]:
        """Give the tasks of whole blocks, as poses come."""
        if pending == "all":
            waiting, self._pending = self._pending, []
            for chunk in waiting:
                yield from self._blocks(chunk)
            self._pending += [chunk.copy() for chunk in chunks]
            return
        for chunk in chunks:
            yield from self._blocks(chunk)
        if pending == "none":
            yield from self._last_block()

    def _blocks(self, chunk: Chunk) -> Iterator[Callable[[], Measured]]:
        """Give the tasks of the blocks that pending poses and more of them fill; the rest is pending."""
        number = self.n_pending
        if number:  # the first block begins with them
            missing = min(self._length - number, len(chunk))
            first = join_chunks([*self._pending, chunk.select(slice(0, missing))])
            chunk = chunk.select(slice(missing, len(chunk)))
            self._pending = [first]
            if len(first) == self._length:
                self._pending = []
                yield from self._block(first, 0, self._length)
        stop = len(chunk) // self._length * self._length
        for start in range(0, stop, self._length):
            yield from self._block(chunk, start, start + self._length)
        if stop < len(chunk):
            self._pending.append(chunk.select(slice(stop, len(chunk))).copy())

    def _last_block(self) -> Iterator[Callable[[], Measured]]:
        """Give the tasks of all pending poses."""
        waiting, self._pending = self._pending, []
        for chunk in waiting:
            yield from self._blocks(chunk)
        for chunk in self._pending:
            yield from self._block(chunk, 0, len(chunk))
        self._pending = []
        yield from self._segments.rest(self.statistics)

    def _block(self, chunk: Chunk, start: int, stop: int) -> Iterator[Callable[[], Measured]]:
        """Give the task of a block, and those of the segments that its poses complete."""
        limits = None if self._prepared is None else self._prepared.limits
        make = lay_out(chunk, start, stop, self.spec, limits, self._before)
        statistics = [statistic for statistic in self.statistics if not (statistic.by_segment or statistic.by_clip)]
        part = chunk.select(slice(start, stop))
        choose = partial(worst_of, part, self.spec, self._gallery)
        yield partial(measure_block, self._given, make, part.cells, statistics, choose)
        self._given += stop - start
        add_hashes(self._hashes, part.hashes)
        if self._earlier:
            last = replace(chunk.select(slice(max(start, stop - self._earlier), stop)), reference=None)
            joined = join_chunks([last] if self._before is None else [self._before, last])
            self._before = joined.select(slice(-self._earlier, None))
        yield from self._segments.add(part, lambda: self._index.cells["sequence"][part.cells], self.statistics)

    # --- cells

    def _grow(self, rows: int) -> None:
        """Make room for so many cells, doubling it."""
        if rows > len(self._poses):
            more = max(rows, 2 * len(self._poses)) - len(self._poses)
            self._are_lent = False
            self._poses = padded(self._poses, more)
            self._sums = {n: (padded(sums, more), padded(counts, more)) for n, (sums, counts) in self._sums.items()}

    def _join_cells(self, moved: Indices) -> None:
        """Give cells their new numbers, adding up those that are one now."""
        joined = partial(joined_rows, moved)
        self._grow(len(moved))
        self._poses = joined(self._poses)
        self._sums = {name: (joined(sums), joined(counts)) for name, (sums, counts) in self._sums.items()}
        self._cell_of = [moved[cells] for cells in self._cell_of]
        self._pending = [replace(chunk, cells=moved[chunk.cells]) for chunk in self._pending]
        self._segments.renumber(moved)


def _place(data: PoseData, row: int) -> tuple[str, str, int] | None:
    """Give sequence, clip and order of a pose; None where there are no sequences."""
    if "sequence" not in data.labels:
        return None
    sequence = data.labels["sequence"]
    return str(sequence[row]), str(data.labels.get("clip", sequence)[row]), int(data.order[row])
