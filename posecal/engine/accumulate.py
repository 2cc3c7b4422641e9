"""How do pairs of poses and a choice of metrics become sums?

In one walk over the blocks. Each statistic is computed for a block and added to the cells of its poses; the
hypotheses are read some poses at a time and let go.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import numpy.typing as npt

import posecal
from posecal.calibration.rank_tests import PreRank
from posecal.data.arrays import FloatArray
from posecal.data.pose_data import PoseData
from posecal.engine.block import Before, Block
from posecal.engine.blocks import block_length, iter_blocks
from posecal.engine.cells import cells_of
from posecal.engine.coordinate_range import coordinate_range
from posecal.engine.metric import SUM_OF_TRUE_POSES, DataSpec, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.threads import run_in_order
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError
from posecal.metrics.sharpness import predicted_spread
from posecal.registry import curves_of, metrics_of, occlusion_metrics_of

__all__ = ["accumulate", "walk"]

WINDOW_BYTES = 32 * 1024 * 1024
"""How much of the hypotheses is read at a time."""

Progress = Callable[[int], object]


def accumulate(
    pairs: PoseData,
    protocol: Protocol | None = None,
    *,
    by: Sequence[str] = (),
    preranks: Mapping[str, PreRank] | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Totals:
    """Evaluate pairs of poses into sums.

    Parameters
    ----------
    pairs : PoseData
        What is evaluated.
    protocol : Protocol, optional
        The options.
    by : sequence of str
        Labels by which poses will be grouped; see :func:`posecal.engine.cells.cells_of`. ``occlusion`` tells occluded from
        visible joints.
    preranks : mapping of callables, optional
        Tests of the battery of one's own, by name: each from a pool of poses (N + 1, K, D), the truth last, to a
        number of each, (N + 1,).
    threads : int, optional
        How many; by default one per core.
    progress : callable, optional
        Called with the number of poses that are done.

    Returns
    -------
    Totals
        Sums per cell.

    Raises
    ------
    PoseDataError
        For labels or masks that the pairs lack, options that don't fit, and coordinates that are not finite.
    """
    protocol = protocol or Protocol()
    if not {"all", "scores"}.intersection(protocol.wanted) and not any(n.endswith("_skill") for n in protocol.wanted):
        pairs = replace(pairs, reference=None)  # no number needs it
    masked = pairs.where is not None
    pairs = _scored(pairs, protocol)
    spec = DataSpec(
        n_hypotheses=pairs.shape[0],
        joints=pairs.joints,
        root=pairs.root,
        labels=tuple(pairs.labels),
        fps=pairs.fps,
        has_scores=pairs.scores is not None,
        has_occlusion=pairs.occluded is not None,
        has_mask=masked,
        preranks=tuple(preranks or ()),
        reference="" if pairs.reference is None else pairs.reference.names[0],
        n_reference=0 if pairs.reference is None else pairs.reference.shape[0],
    )
    statistics = _statistics(protocol, spec, preranks)
    if "occlusion" in by:
        statistics |= {
            s.name: s for ms in occlusion_metrics_of(protocol, spec).values() for m in ms.values() for s in m.statistics
        }
    wanted = [label for label in by if label != "occlusion"]
    cells = cells_of(pairs, wanted, lambda: _spread(pairs, threads), average=protocol.average)
    totals = Totals(
        spec=spec,
        protocol=protocol,
        version=posecal.__version__,
        cells=cells.labels,
        poses=np.bincount(cells.of_pose).astype(np.int64),
        remarks=pairs.remarks,
        sequences=cells.labelled,
        cell_of=cells.of_pose,
    )
    bad: list[npt.NDArray[np.intp]] = []
    bad_of_reference: list[npt.NDArray[np.intp]] = []
    kept: dict[str, list[FloatArray]] = {}
    done = 0
    tasks = (
        partial(_measure, poses, block, cells.of_pose[poses], tuple(statistics.values()))
        for poses, block in walk(pairs)
    )
    for found in run_in_order(tasks, threads):
        bad.append(found.non_finite)
        bad_of_reference.append(found.non_finite_of_reference)
        for name, (sums, counts) in found.sums.items():
            totals.add(name, found.cells, sums, counts)
        for name, values in found.per_pose.items():
            kept.setdefault(name, []).append(values)
        done += found.poses
        if progress is not None:
            progress(done)
    _refuse_non_finite(pairs, pairs.names[0], np.concatenate(bad))
    _refuse_non_finite(pairs, spec.reference, np.concatenate(bad_of_reference))
    totals.per_pose = {name: np.concatenate(parts) for name, parts in kept.items()}
    return totals


def _statistics(protocol: Protocol, spec: DataSpec, preranks: Mapping[str, PreRank] | None) -> dict[str, Statistic]:
    found = {SUM_OF_TRUE_POSES.name: SUM_OF_TRUE_POSES}
    found |= {s.name: s for metric in metrics_of(protocol, spec, preranks).values() for s in metric.statistics}
    if {"default", "all"}.intersection(protocol.wanted):
        found |= {curve.statistic.name: curve.statistic for curve in curves_of(protocol, spec).values()}
    return found


# --- one walk -------------------------------------------------------------------------------------------------


def walk(pairs: PoseData) -> Iterator[tuple[slice, Callable[[], Block]]]:
    """Give the blocks of some pairs, to be laid out, each with the poses that it holds."""
    _, m, k, d = pairs.shape
    held = [pairs.hypotheses, *([] if pairs.reference is None else [pairs.reference.hypotheses])]
    most = max(some.n_hypotheses for some in held)
    window = max(1, WINDOW_BYTES // (k * d * max(some.n_hypotheses * some.itemsize for some in held)))
    sequence = pairs.labels.get("sequence", np.zeros(m, dtype=np.str_))
    follows = np.concatenate([[False], (sequence[1:] == sequence[:-1]) & (np.diff(pairs.place) == 1)])
    previous: Before | None = None
    own = np.unique(sequence, return_inverse=True)[1] if "sequence" in pairs.labels else np.arange(m)
    box = cache(partial(coordinate_range, pairs.truth, pairs.where, root=pairs.root, sequence=own))
    for start in range(0, m, window):
        poses = slice(start, min(start + window, m))
        hypotheses, truth = pairs.hypotheses.read(poses.start, poses.stop), pairs.truth[poses]
        size = block_length((most, *hypotheses.shape[1:]), hypotheses.dtype)
        blocks = iter_blocks(
            hypotheses,
            truth,
            None if pairs.where is None else pairs.where[poses],
            root=pairs.root,
            scores=None if pairs.scores is None else pairs.scores[:, poses],
            follows=follows[poses],
            previous=previous,
            occluded=None if pairs.occluded is None else pairs.occluded[poses],
            usable=None if pairs.usable is None else pairs.usable[poses],
            reference=None if pairs.reference is None else pairs.reference.hypotheses.read(poses.start, poses.stop),
            box=box,
            sequence=own[poses],
        )
        for number, block in enumerate(blocks):
            yield slice(start + number * size, min(start + (number + 1) * size, poses.stop)), block
        previous = hypotheses[:, -1:].copy(), truth[-1:], None if pairs.where is None else pairs.where[poses][-1:]


@dataclass(frozen=True)
class _Measured:
    """The sums of one block: a row for each run of poses of one cell."""

    poses: int
    cells: npt.NDArray[np.intp]
    sums: dict[str, tuple[FloatArray, npt.NDArray[np.int64]]]
    per_pose: dict[str, FloatArray]
    non_finite: npt.NDArray[np.intp]
    non_finite_of_reference: npt.NDArray[np.intp]


def _measure(
    poses: slice, lay_out: Callable[[], Block], cells: npt.NDArray[np.intp], statistics: Sequence[Statistic]
) -> _Measured:
    block = lay_out()
    nowhere = np.zeros_like(block.where)
    non_finite = block.non_finite, nowhere if block.reference is None else block.reference.non_finite
    bad, bad_of_reference = (np.argwhere(joints) + np.array([poses.start, 0]) for joints in non_finite)
    if len(bad) or len(bad_of_reference):
        return _Measured(len(cells), cells[:0], {}, {}, bad, bad_of_reference)
    runs = np.flatnonzero(np.concatenate([[True], cells[1:] != cells[:-1]]))
    sums: dict[str, tuple[FloatArray, npt.NDArray[np.int64]]] = {}
    kept_values: dict[str, FloatArray] = {}
    for statistic in statistics:
        values = block.share(
            ("statistic", statistic.name), partial(statistic.compute, block)
        )  # skills ask for them again
        values = np.asarray(values, dtype=np.float64)
        if statistic.per_pose:
            kept_values[statistic.name] = values
            continue
        kept = 2 if statistic.per_joint else 1
        counted = ~np.isnan(values.reshape(*values.shape[:kept], -1)[..., 0])
        shown = counted.reshape(*counted.shape, *[1] * (values.ndim - kept))
        total = np.add.reduceat(np.where(shown, values, 0), runs, axis=0)
        sums[statistic.name] = total, np.add.reduceat(counted, runs, axis=0, dtype=np.int64)
    return _Measured(len(cells), cells[runs], sums, kept_values, bad, bad_of_reference)


def _spread(pairs: PoseData, threads: int | None) -> FloatArray:
    tasks = ((lambda block=block: predicted_spread(block())) for _, block in walk(replace(pairs, reference=None)))
    return np.concatenate(list(run_in_order(tasks, threads)))


# --- what counts ----------------------------------------------------------------------------------------------


def _scored(pairs: PoseData, protocol: Protocol) -> PoseData:
    """Keep the poses and joints that the options ``frames`` and ``where`` name."""
    name = pairs.names[1]
    if protocol.frames != "all":
        values = pairs.labels.get(protocol.frames)
        if values is None:
            raise PoseDataError(
                f"frames: {name} has no label {protocol.frames!r}; expected a yes/no member (M,) of that name."
            )
        kept = np.flatnonzero(np.isin(np.char.lower(values), ("yes", "1", "true")))
        if not kept.size:
            raise PoseDataError(f"frames: no pose of {name} has the label {protocol.frames}; expected some.")
        pairs = pairs.taken(kept)
    where, usable = pairs.where, None
    if protocol.where != "all":
        if pairs.occluded is None:
            raise PoseDataError(
                f"where: {name} does not say which joints are occluded; expected a member occluded or visible, "
                "bool (M, K)."
            )
        chosen = pairs.occluded if protocol.where == "occluded" else ~pairs.occluded
        usable = np.ones_like(chosen) if where is None else where
        where = chosen if where is None else chosen & where
    if where is not None and not where.any():
        what = "counts" if protocol.where == "all" else f"is {protocol.where}"
        raise PoseDataError(f"where: no joint of {name} {what}; expected some to score.")
    bad = ~np.isfinite(pairs.truth).all(axis=2)
    _refuse_non_finite(pairs, name, np.argwhere(bad if where is None else bad & where))
    return replace(pairs, where=where, usable=usable)


def _refuse_non_finite(pairs: PoseData, name: str, bad: npt.NDArray[np.intp]) -> None:
    if len(bad):
        frames, (frame, joint) = len(np.unique(bad[:, 0])), bad[0]
        raise PoseDataError(
            f"{name} has non-finite coordinates in {frames:,} of {len(pairs.truth):,} frames (first: frame "
            f"{pairs.frame_id[frame]}, joint {pairs.joints[joint].removeprefix('joint ')}). Mask those joints with "
            "where, or leave those frames out."
        )
