"""How do pairs of poses and a choice of metrics become sums?

One walk over the blocks. Each statistic is computed for a block and added to the cells of its poses; the
hypotheses are read some poses at a time and let go.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np
import numpy.typing as npt

import posecal
from posecal.block import Block, FloatArray, block_length, blocks_of, in_order
from posecal.cells import cells_of
from posecal.errors import PoseDataError
from posecal.io import Role, as_labels, read_poses
from posecal.joining import Join, join
from posecal.layout import HYPOTHESES, TRUTH, MemoryArray
from posecal.metric import Statistic, Subject
from posecal.metrics.spread import predicted_spread
from posecal.pairs import PosePairs, Poses
from posecal.protocol import Protocol, preset
from posecal.registry import curves_of, metrics_of
from posecal.report import Report
from posecal.totals import Totals

__all__ = ["add_up", "evaluate", "walk"]

WINDOW_BYTES = 32 * 1024 * 1024
"""How much of the hypotheses is read at a time."""

Progress = Callable[[int], object]


def evaluate(
    hypotheses: npt.ArrayLike | str | os.PathLike[str],
    truth: npt.ArrayLike | str | os.PathLike[str],
    /,
    *,
    where: npt.ArrayLike | None = None,
    joints: Sequence[str] | None = None,
    root_joint: str | None = None,
    labels: Mapping[str, npt.ArrayLike] | None = None,
    occluded: npt.ArrayLike | None = None,
    scores: npt.ArrayLike | None = None,
    fps: float | None = None,
    unit: str = "mm",
    axes: str = HYPOTHESES,
    by: Sequence[str] = (),
    protocol: Protocol | str | None = None,
    threads: int | None = None,
) -> Report:
    """Evaluate hypotheses against the truth.

    Parameters
    ----------
    hypotheses : array (N, M, K, D) or path
        Hypotheses, in ``unit`` and in the layout ``axes``; or a file that says all that itself.
    truth : array (M, K, D) or path
        True poses, likewise.
    where : bool array (M, K), optional
        The joints that count.
    joints : sequence of str, optional
        K names, of arrays; they give the skeleton, the root and the joint sets.
    root_joint : str, optional
        The joint to subtract from every pose: a name, an index, or ``none``. By default the hip, or the one
        unnamed joint whose truth is 0 throughout.
    labels : mapping of arrays (M,), optional
        What is said of each pose of an array: ``sequence``, ``action``, ….
    occluded : bool array (M, K), optional
        The joints of arrays whose keypoints were not seen.
    scores : array (N, M), optional
        The model's score of each hypothesis of an array.
    fps : float, optional
        Frames per second, of arrays.
    unit : str
        Of arrays: ``mm``, ``cm``, ``m``, or the millimetres in one unit.
    axes : str
        The layout of an array of hypotheses, such as ``MNKD``.
    by : sequence of str
        Labels to group by.
    protocol : Protocol or str, optional
        The options, or the name of a preset.
    threads : int, optional
        How many; by default one per core.

    Returns
    -------
    Report
        The numbers, with their definitions. ``print`` it.

    Raises
    ------
    PoseDataError
        For everything that does not fit, all at once.
    PoseFileError
        For files that can't be read.

    Notes
    -----
    Differs from the published code: see each metric's definition.

    Examples
    --------
    Two hypotheses of three poses with one joint; every truth is 3 mm from the nearer one.

    >>> import numpy as np
    >>> hypotheses = np.zeros((2, 3, 2, 3))
    >>> hypotheses[0, :, 1], hypotheses[1, :, 1] = [3, 0, 0], [0, 5, 0]
    >>> report = evaluate(hypotheses, np.zeros((3, 2, 3)))
    >>> report.value("min_mpjpe")
    1.5
    """
    if isinstance(protocol, str):
        protocol = preset(protocol).protocol
    sides: list[Poses] = []
    for role, side in (("hypotheses", hypotheses), ("truth", truth)):
        if isinstance(side, (str, os.PathLike)):
            sides.append(read_poses(side, cast(Role, role)))
        else:
            sides.append(_passed(cast(Role, role), side, axes, unit, joints))
    if not isinstance(truth, (str, os.PathLike)):
        sides[1] = replace(
            sides[1],
            labels={name: as_labels(values, name) for name, values in (labels or {}).items()},
            marks={} if occluded is None else {"occluded": np.asarray(occluded)},
            fps=fps,
        )
    if scores is not None:
        sides[0] = replace(sides[0], scores=np.asarray(scores, dtype=np.float64))
    pairs = join(sides[0], sides[1], Join(root_joint=root_joint))
    if where is not None:
        mask = np.asarray(where)
        if mask.dtype != bool or mask.shape != pairs.truth.shape[:2]:
            raise PoseDataError(f"where: {mask.dtype} {mask.shape}; expected bool (M, K) = {pairs.truth.shape[:2]}.")
        pairs = replace(pairs, where=mask)
    return Report(add_up(pairs, protocol, by=by, threads=threads), by)


def _passed(role: Role, array: npt.ArrayLike, axes: str, unit: str, joints: Sequence[str] | None) -> Poses:
    """Declare an array that was passed: its layout and unit are part of the call."""
    found = np.asanyarray(array)
    if found.dtype.kind not in "fiu":
        raise PoseDataError(f"{role}: dtype {found.dtype}; expected real numbers such as float32.")
    names = None if joints is None else tuple(joints)
    layout = axes if role == "hypotheses" else TRUTH
    return Poses(role, MemoryArray(found), axes=layout, unit=unit, joints=names)


def add_up(
    pairs: PosePairs,
    protocol: Protocol | None = None,
    *,
    by: Sequence[str] = (),
    threads: int | None = None,
    progress: Progress | None = None,
) -> Totals:
    """Evaluate pairs of poses into sums.

    Parameters
    ----------
    pairs : PosePairs
        What is evaluated.
    protocol : Protocol, optional
        The options.
    by : sequence of str
        Labels by which poses will be grouped; see :func:`posecal.cells.cells_of`.
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
    pairs = _scored(pairs, protocol)
    subject = Subject(
        n_hypotheses=pairs.shape[0],
        joints=pairs.joints,
        root=pairs.root,
        labels=tuple(pairs.labels),
        fps=pairs.fps,
        scored=pairs.scores is not None,
    )
    statistics = _statistics(protocol, subject)
    wanted = [*by, *([] if protocol.average == "poses" else [protocol.average])]
    cells = cells_of(pairs, wanted, lambda: _spread(pairs, threads))
    totals = Totals(
        subject=subject,
        protocol=protocol,
        version=posecal.__version__,
        cells=cells.labels,
        poses=np.bincount(cells.of_pose).astype(np.int64),
        remarks=pairs.remarks,
        sequences=cells.labelled,
    )
    bad: list[npt.NDArray[np.intp]] = []
    done = 0
    tasks = (partial(_measure, poses, block, cells.of_pose[poses], statistics) for poses, block in walk(pairs))
    for found in in_order(tasks, threads):
        bad.append(found.non_finite)
        for name, (sums, counts) in found.sums.items():
            totals.add(name, found.cells, sums, counts)
        done += found.poses
        if progress is not None:
            progress(done)
    _refuse_non_finite(pairs, pairs.names[0], np.concatenate(bad))
    return totals


def _statistics(protocol: Protocol, subject: Subject) -> tuple[Statistic, ...]:
    found = {s.name: s for metric in metrics_of(protocol, subject).values() for s in metric.statistics}
    if protocol.metrics in {"default", "all"}:
        found |= {curve.statistic.name: curve.statistic for curve in curves_of(protocol, subject).values()}
    return tuple(found.values())


# --- one walk -------------------------------------------------------------------------------------------------


def walk(pairs: PosePairs) -> Iterator[tuple[slice, Callable[[], Block]]]:
    """Give the blocks of some pairs, to be laid out, each with the poses that it holds."""
    n, m, k, d = pairs.shape
    window = max(1, WINDOW_BYTES // (n * k * d * pairs.stored.array.dtype.itemsize))
    sequence = pairs.labels.get("sequence", np.zeros(m, dtype=np.str_))
    follows = np.concatenate([[False], sequence[1:] == sequence[:-1]])
    previous: tuple[FloatArray, FloatArray] | None = None
    for start in range(0, m, window):
        poses = slice(start, min(start + window, m))
        hypotheses, truth = pairs.stored.read(poses.start, poses.stop), pairs.truth[poses]
        size = block_length(hypotheses.shape, hypotheses.dtype)
        blocks = blocks_of(
            hypotheses,
            truth,
            None if pairs.where is None else pairs.where[poses],
            root=pairs.root,
            scores=None if pairs.scores is None else pairs.scores[:, poses],
            follows=follows[poses],
            previous=previous,
        )
        for number, block in enumerate(blocks):
            yield slice(start + number * size, min(start + (number + 1) * size, poses.stop)), block
        previous = hypotheses[:, -1:].copy(), truth[-1:]


@dataclass(frozen=True)
class _Measured:
    """The sums of one block: a row for each run of poses of one cell."""

    poses: int
    cells: npt.NDArray[np.intp]
    sums: dict[str, tuple[FloatArray, npt.NDArray[np.int64]]]
    non_finite: npt.NDArray[np.intp]


def _measure(
    poses: slice, lay_out: Callable[[], Block], cells: npt.NDArray[np.intp], statistics: Sequence[Statistic]
) -> _Measured:
    block = lay_out()
    bad = np.argwhere(block.non_finite) + np.array([poses.start, 0])
    if len(bad):
        return _Measured(len(cells), cells[:0], {}, bad)
    runs = np.flatnonzero(np.concatenate([[True], cells[1:] != cells[:-1]]))
    sums = {}
    for statistic in statistics:
        values = np.asarray(statistic.compute(block), dtype=np.float64)
        kept = 2 if statistic.per_joint else 1
        counted = ~np.isnan(values.reshape(*values.shape[:kept], -1)[..., 0])
        shown = counted.reshape(*counted.shape, *[1] * (values.ndim - kept))
        total = np.add.reduceat(np.where(shown, values, 0), runs, axis=0)
        sums[statistic.name] = total, np.add.reduceat(counted, runs, axis=0, dtype=np.int64)
    return _Measured(len(cells), cells[runs], sums, bad)


def _spread(pairs: PosePairs, threads: int | None) -> FloatArray:
    tasks = ((lambda block=block: predicted_spread(block())) for _, block in walk(pairs))
    return np.concatenate(list(in_order(tasks, threads)))


# --- what counts ----------------------------------------------------------------------------------------------


def _scored(pairs: PosePairs, protocol: Protocol) -> PosePairs:
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
    where = pairs.where
    if protocol.where != "all":
        if pairs.occluded is None:
            raise PoseDataError(
                f"where: {name} does not say which joints are occluded; expected a member occluded or visible, "
                "bool (M, K)."
            )
        chosen = pairs.occluded if protocol.where == "occluded" else ~pairs.occluded
        where = chosen if where is None else chosen & where
    if where is not None and not where.any():
        raise PoseDataError(f"where: no joint of {name} is {protocol.where}; expected some to score.")
    bad = ~np.isfinite(pairs.truth).all(axis=2)
    _refuse_non_finite(pairs, name, np.argwhere(bad if where is None else bad & where))
    return replace(pairs, where=where)


def _refuse_non_finite(pairs: PosePairs, name: str, bad: npt.NDArray[np.intp]) -> None:
    if len(bad):
        frames = len(np.unique(bad[:, 0]))
        raise PoseDataError(
            f"{name} has non-finite coordinates in {frames:,} of {len(pairs.truth):,} frames (first: frame "
            f"{pairs.frame_id[bad[0, 0]]}, joint {pairs.joints[bad[0, 1]]}). Mask those joints with where, or leave "
            "those frames out."
        )
