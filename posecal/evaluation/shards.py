"""Evaluation of many files as one test set, by any executor of the ``concurrent.futures`` protocol."""

from __future__ import annotations

import builtins
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np

from posecal.calibration.rank_tests import PreRank
from posecal.data.arrays import checked_choice
from posecal.data.layout import HYPOTHESES
from posecal.data.pose_data import PoseData
from posecal.data.remarks import Count, Remark, join_remarks
from posecal.data.remote import is_address, name_of
from posecal.engine.cells import SPREAD, label_name, spread_cuts
from posecal.engine.merge import in_order_of_sequences, merge_tree
from posecal.engine.metric import Statistic
from posecal.engine.prepare import Prepared
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.engine.totals import Totals
from posecal.errors import PosecalError, PoseDataError, option, raise_all
from posecal.evaluation.batches import Evaluation
from posecal.evaluation.kept import KeptResults
from posecal.evaluation.options import check_callable
from posecal.evaluation.shard_clips import refuse_shared_clips, with_clips_of_set
from posecal.evaluation.shard_order import shared_sequences, tasks_of
from posecal.evaluation.shard_passes import (
    Attempt,
    Failure,
    Frames,
    Method,
    Shard,
    Summary,
    Task,
    accumulate,
    find_frames,
    find_spreads,
    sendable_metrics,
    summarize,
)
from posecal.evaluation.shard_summaries import (
    common_spec,
    kept_poses,
    plain,
    refuse_duplicates,
    refuse_failures,
    refuse_left_out,
    splits_sequences,
)
from posecal.evaluation.sources import Progress, Source, check_descriptions
from posecal.metrics.multimodal import NEEDS_TRUE_CLIPS
from posecal.registry import registered_metrics, statistics_of, wants_reference
from posecal.report.report import Report
from posecal.stats.skill import ClimatologyPool

Item = TypeVar("Item")
Result = TypeVar("Result")
Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
Pair = PoseData | tuple[Source | PoseData, Source]

_POOLS = 16
"""How many parts of what climatology samples are put together at a time."""

_ARRAYS = ("where", "labels", "occluded", "scores", "log_prob", "weights", "frame_id", "truth_frame_id", "observed")
"""Options that are of the poses of one shard."""


def evaluate_shards(
    pairs: Sequence[Pair],
    /,
    *,
    map: Map = builtins.map,  # noqa: A002 (as executors call it)
    by: Sequence[str] | str = (),
    metrics: str | Sequence[str] | None = None,
    reference: Literal["climatology"] | Sequence[Source | PoseData] | None = None,
    preranks: Mapping[str, PreRank] | None = None,
    protocol: Protocol | str | None = None,
    threads: int | None = None,
    gallery: bool = True,
    duplicates: Literal["error", "drop"] = "error",
    keep: str | os.PathLike[str] | None = None,
    progress: Callable[[str, int], Progress | None] | None = None,
    **described: Any,
) -> Report:
    """Evaluate many files as one test set, with the numbers of one run over all their poses.

    Parameters
    ----------
    pairs : sequence of (hypotheses, truth), or of PoseData
        The shards, in order. One file of truth may stand in several pairs: frames are then joined by ``frame_id``.
    map : callable
        Applies a function to every shard, in order: ``executor.map`` of any executor of ``concurrent.futures``. In this
        process by default.
    by, metrics, preranks, protocol, gallery
        As for :func:`evaluate`.
    reference : str or sequence, optional
        ``climatology``, or hypotheses of another model for each shard.
    threads : int, optional
        Of each process; by default 1 with an executor, else one per core.
    duplicates : str
        ``error``, or ``drop`` to count poses that several shards hold once. Poses are the same where truth, labels and
        ``frame_id`` are.
    keep : path, optional
        A folder for the results of shards of files. The same call finds those that are done there, by where their files
        lie, their size and time of change, and by the options, and goes on with the others.
    progress : callable, optional
        From the name of a pass and how many shards it has, to what is called with the number of those that are done.
    **described
        Options that describe the data, as for :func:`evaluate` (``unit=``, ``joints=``, ``axes=``, …), but for arrays
        of single poses, which belong into ``PoseData``.

    Returns
    -------
    Report
        The numbers.

    Raises
    ------
    PoseDataError
        For shards that can't be evaluated, by name, after all were tried; for shards that are described otherwise than
        the first, and poses that several hold.

    Notes
    -----
    The true poses are read twice: what depends on the whole set is found first (coordinate range, what climatology
    samples, runs of poses without sequences, poses that several shards hold). Hypotheses are read once; twice where
    ``by`` cuts the predicted spread into equal parts. Where metrics are of consecutive frames, a sequence that lies in
    several shards is evaluated in one task, in the order of its frame numbers.

    See Also
    --------
    merge_totals : Results that were made apart.

    Examples
    --------
    >>> random = np.random.default_rng(0)
    >>> truth = random.normal(0, 300, (64, 5, 3))
    >>> hypotheses = truth[:, None] + random.normal(0, 50, (64, 20, 5, 3))
    >>> halves = [(hypotheses[part], truth[part]) for part in (slice(0, 32), slice(32, 64))]
    >>> evaluate_shards(halves, axes="MNKD", unit="mm", threads=1)
    <posecal Report: N=20, M=64, K=5, 64 frames: minMPJPE ..., ECE ..., signed area ...>
    """
    checked_choice(duplicates, "duplicates", ("error", "drop"))
    check_callable("map", map)
    check_callable("progress", progress)
    check_descriptions(described)
    raise_all(f"{n}: an array of poses; expected it in PoseData of each shard." for n in _ARRAYS if n in described)
    evaluation = Evaluation(
        by=by, metrics=metrics, preranks=preranks, protocol=protocol, gallery=gallery
    )  # checks them
    wants = reference is not None and wants_reference(evaluation.protocol)
    method = Method(
        evaluation.protocol,
        evaluation.by,
        {} if preranks is None else dict(preranks),
        1 if threads is None and map is not builtins.map else threads,
        sendable_metrics(),
        gallery,
    )
    is_pooled = isinstance(reference, str) and wants
    shards = _shards(pairs, reference if wants and not is_pooled else None, described)
    passes = _Passes(map, progress, keep)
    pools: list[ClimatologyPool] = []
    summaries = _summaries(passes, shards, method, pools if is_pooled else None)
    remarks: list[str] = []
    if kept := kept_poses([summary.keys for summary in summaries]):
        if duplicates == "error":
            refuse_duplicates(shards, summaries, kept)
        number = sum(summaries[n].n_poses - len(rows) for n, rows in kept.items())
        remarks.append(Remark(Count(number, "pose"), " came in several shards; each is counted once."))
        shards = [replace(shard, kept=kept.get(n)) for n, shard in enumerate(shards)]
        shards = [shard for shard in shards if shard.kept is None or len(shard.kept)]
        pools.clear()
        find = partial(summarize, method=method, is_pooled=is_pooled)
        summaries = list(_without_pools(passes.attempts("summing up once more", find, shards), pools))
        refuse_failures([result for result in summaries if isinstance(result, Failure)])
    if all(summary.lack for summary in summaries):
        raise PoseDataError(summaries[0].lack)
    spec = common_spec(shards, summaries)
    refuse_shared_clips(shards, summaries)
    if is_pooled:
        spec = replace(spec, reference="climatology", n_reference=spec.n_hypotheses)
    method = replace(method, has_mask=spec.has_mask, pool=ClimatologyPool.joined(pools) if is_pooled else None)
    statistics = statistics_of(method.protocol, spec, method.by, method.preranks, registered_metrics())
    method = _with_findings(passes, shards, summaries, method, spec, statistics)
    frames: dict[int, Frames] = {}
    shared = shared_sequences(summaries)
    has_segments = any(statistic.by_segment for statistic in statistics)
    has_steps = not spec.clip_length and any(statistic.earlier for statistic in statistics)  # none between clips
    if shared and (has_segments or has_steps):
        holders = [n for n, summary in enumerate(summaries) if shared.intersection(summary.sequences)]
        order = partial(find_frames, method=replace(method, pool=None), sequences=shared)
        frames = dict(zip(holders, passes.run("ordering frames", order, [shards[n] for n in holders]), strict=True))
    tasks, of_order = tasks_of(shards, summaries, frames, has_segments=has_segments)
    total = merge_tree(passes.results(tasks, method))
    sequences = dict.fromkeys(name for summary in summaries for name in summary.sequences)
    total = in_order_of_sequences(total, list(sequences))
    total.n_frames = sum(summary.n_poses for summary in summaries)
    total.remarks = join_remarks([*remarks, *of_order, *total.remarks], total.n_frames)
    return Report(total, method.by)


class _Passes:
    """Passes over all shards, by a map of the user's, whose failures are raised at the end of each."""

    def __init__(
        self,
        map: Map,  # noqa: A002
        progress: Callable[[str, int], Progress | None] | None,
        keep: str | os.PathLike[str] | None,
    ) -> None:
        self._map, self._progress, self._keep = map, progress, keep

    def attempts(self, what: str, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Any]:
        """Give the result of each item, or why it failed, in their order."""
        step, done = None if self._progress is None else self._progress(what, len(items)), 0
        try:
            for done, result in enumerate(self._map(Attempt(function), items), 1):
                yield result
                if step is not None:
                    step(done)
        except PosecalError:
            raise
        except Exception as error:  # of the executor, whatever it is
            kept = f" Results so far are in {self._keep}." if self._keep is not None else ""
            raise PoseDataError(
                f"map: the executor failed while {what} ({type(error).__name__}: {error}); expected a result or an "
                f"error for each shard. Was a process killed, or is there a function that can't be pickled?{kept}"
            ) from error
        if done < len(items):
            raise PoseDataError(f"map: {done:,} results while {what}; expected one for each of {len(items):,} shards.")

    def run(self, what: str, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """Give the results of all items.

        Raises
        ------
        PoseDataError
            With the names of those that failed.
        """
        found = list(self.attempts(what, function, items))
        refuse_failures([result for result in found if isinstance(result, Failure)])
        return found

    def results(self, tasks: Sequence[Task], method: Method) -> Iterator[Totals]:
        """Evaluate the tasks whose results are not kept, and give the results of all, in their order."""
        kept = KeptResults(self._keep, method)
        is_done = [kept.holds(task) for task in tasks]
        rest = [task for task, done in zip(tasks, is_done, strict=True) if not done]
        evaluate = Attempt(partial(accumulate, method=method))
        results = self.attempts("evaluating", evaluate.function, rest)
        failures = []
        for task, done in zip(tasks, is_done, strict=True):
            found = kept.load(task) if done else next(results)
            if done and found is None:  # it can't be read
                done, found = False, evaluate(task)
            if isinstance(found, Failure):
                failures.append(found)
            elif found is not None:
                if not done:
                    kept.save(task, found)
                yield found
        for _ in results:
            pass  # lets the map come to its end
        share = f"{len(tasks) - len(failures):,} of {len(tasks):,} shards are done"
        advice = f"; {option('keep')} with a folder keeps their results"
        if self._keep is not None:
            advice = f", in {self._keep}: the same call goes on from there"
        refuse_failures(failures, f"{share}{advice}.")


def _shards(
    pairs: Sequence[Pair], reference: str | Sequence[Source | PoseData] | None, described: Mapping[str, Any]
) -> list[Shard]:
    """Name the shards.

    Raises
    ------
    PoseDataError
        For what are no pairs, and other than one reference each.
    """
    if isinstance(pairs, str | PoseData) or not hasattr(pairs, "__len__") or not len(pairs):
        raise PoseDataError("pairs: expected at least one pair of hypotheses and truth, or PoseData.")
    if reference is not None and (isinstance(reference, str) or len(reference) != len(pairs)):
        raise PoseDataError(f"reference: expected climatology, or hypotheses for each of {len(pairs):,} shards.")
    shards = []
    for number, pair in enumerate(pairs):
        two: Sequence[Any] = (pair, None) if isinstance(pair, PoseData) else pair
        if not isinstance(two, tuple | list) or len(two) != 2:
            raise PoseDataError(f"pairs: number {number + 1} is of type {type(pair).__name__}; expected a pair.")
        hypotheses, truth = map(_absolute, two)
        name = name_of(hypotheses) if isinstance(hypotheses, str | os.PathLike) else f"shard {number + 1}"
        other = None if reference is None else _absolute(reference[number])
        shards.append(Shard(name, hypotheses, truth, other, {} if truth is None else dict(described)))
    truths = [shard.truth for shard in shards]
    is_one = len(shards) > 1 and isinstance(truths[0], str | os.PathLike) and all(t == truths[0] for t in truths)
    if is_one and described.get("missing", "error") == "error":
        shards = [replace(shard, described={**shard.described, "missing": "part"}) for shard in shards]
    names = [shard.name for shard in shards]
    if len({*names}) < len(names):
        shards = [
            replace(s, name=os.fspath(s.hypotheses)) if isinstance(s.hypotheses, str | os.PathLike) else s
            for s in shards
        ]
    return shards


def _absolute(source: Any) -> Any:
    """Give the path of a file from the root, for processes of another working folder; all else as it is."""
    is_path = isinstance(source, str | os.PathLike) and not is_address(source)
    return os.path.abspath(source) if is_path else source


def _without_pools(results: Iterable[Any], pools: list[ClimatologyPool]) -> Iterator[Any]:
    """Put what climatology samples together as it comes, so that few of it are in memory."""
    for result in results:
        if isinstance(result, Summary) and result.pool is not None:
            pools.append(result.pool)
            if len(pools) > _POOLS:
                pools[:] = [ClimatologyPool.joined(pools)]
            result = replace(result, pool=None)
        yield result


def _summaries(
    passes: _Passes, shards: list[Shard], method: Method, pools: list[ClimatologyPool] | None
) -> list[Summary]:
    """Find what the whole set depends on; shards whose shapes fit several layouts are of the others' layout."""
    function = partial(summarize, method=method, is_pooled=pools is not None)
    pools = [] if pools is None else pools
    found = list(_without_pools(passes.attempts("summing up", function, shards), pools))
    failed = [n for n, result in enumerate(found) if isinstance(result, Failure)]
    read = [result for result in found if isinstance(result, Summary)]
    if failed and read and "axes" not in shards[0].described:
        other = [replace(shards[n], described={**shards[n].described, "axes": HYPOTHESES}) for n in failed]
        again = _without_pools(passes.attempts("summing up", function, other), pools)
        for n, shard, result in zip(failed, other, again, strict=True):
            if isinstance(result, Summary) and plain(result.spec) == plain(read[0].spec):
                found[n], shards[n] = result, shard
    refuse_failures([result for result in found if isinstance(result, Failure)])
    first = np.cumsum([0, *(summary.n_stored for summary in found)])
    shards[:] = [replace(shard, first=int(start)) for shard, start in zip(shards, first, strict=False)]
    refuse_left_out(shards, found)
    shards[:] = with_clips_of_set(shards, found)
    if any(shard.first_clip or shard.of_sequences for shard in shards):
        pools.clear()
        found = list(_without_pools(passes.attempts("naming clips", function, shards), pools))
        refuse_failures([result for result in found if isinstance(result, Failure)])
    return found


def _with_findings(
    passes: _Passes,
    shards: Sequence[Shard],
    summaries: Sequence[Summary],
    method: Method,
    spec: DataSpec,
    statistics: Sequence[Statistic],
) -> Method:
    """Put together what was found of all shards, and find the cuts of the predicted spread."""
    wanted = {*(label_name(entry) for entry in method.by), method.protocol.average, method.protocol.frames, "sequence"}
    every = {label for summary in summaries for label in summary.spec.labels}
    unwanted = (name for name in every - wanted if name not in spec.labels or splits_sequences(name, summaries))
    method = replace(method, dropped=frozenset(unwanted))
    entries = [entry for entry in method.by if SPREAD.match(entry) and label_name(entry) not in every]
    values = None
    if any("=" not in entry for entry in entries):
        find = partial(find_spreads, method=replace(method, pool=None))
        values = np.concatenate(passes.run("cutting the predicted spread", find, shards))
    prepared = Prepared.joined([summary.prepared for summary in summaries if summary.prepared is not None])
    cuts, unsummed = {entry: spread_cuts(entry, values) for entry in entries}, method.dropped & {"clip"}
    clips = prepared.clips if any(statistic.name in NEEDS_TRUE_CLIPS for statistic in statistics) else None
    return replace(method, prepared=replace(prepared, cuts=cuts, unsummed=unsummed, clips=clips))
