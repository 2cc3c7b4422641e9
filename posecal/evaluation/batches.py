"""Evaluation in batches, as in a training loop or in several processes."""

from __future__ import annotations

import copy
import inspect
import os
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from posecal.calibration.rank_tests import PreRank
from posecal.data.clips import frame_names, pose_names, select_clips
from posecal.data.declarations import Declarations
from posecal.data.frame_numbers import Place, continued
from posecal.data.frames import FrameCheck
from posecal.data.gaussian import starting_at
from posecal.data.layout import HYPOTHESES
from posecal.data.pose_data import PoseData
from posecal.data.remarks import join_remarks
from posecal.engine.accumulate import Accumulator, Pending
from posecal.engine.merge import merge_totals
from posecal.engine.pose_hashes import dropped_remarks
from posecal.engine.prepare import (
    Prepared,
    add_spread_labels,
    all_within,
    lack_of_scored,
    refuse_non_finite_hypotheses,
    select_scored,
)
from posecal.engine.presets import as_protocol
from posecal.engine.protocol import Protocol
from posecal.engine.ragged import has_absent, has_absent_anywhere, live_remark
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, checked_type, first_few
from posecal.evaluation.options import check_callable, check_callables, check_label_names, label_entries
from posecal.evaluation.sources import Progress, Source, as_pose_data
from posecal.evaluation.start import continue_accumulator, spec_of, start_accumulator, statistics_and_numbers
from posecal.metrics.sharpness import predicted_spread
from posecal.registry import check_names, wants_reference
from posecal.report.report import Report


class Evaluation:
    """Evaluation in batches: the sums of all that came so far, never the hypotheses.

    The numbers are those of one call of :func:`evaluate` over all batches together. Memory does not grow with the
    number of batches, but for two numbers a pose, the frame ids, where they are given, and at most 1 MB of hashes.

    Parameters
    ----------
    joints, root_joint, unit, truth_unit, axes, truth_axes, fps, shared_joints, n_hypotheses, skeleton, dimensions
        Of all batches; as for :func:`evaluate`.
    by, metrics, preranks, protocol, threads, draws, seed, gallery
        As for :func:`evaluate`. Where hypotheses are drawn, give each evaluation that will be merged another ``seed``.
    prepared : Prepared, optional
        What depends on the whole set, for ``tarp_box``: :func:`posecal.prepare` of the true poses of all batches.

    Raises
    ------
    PoseDataError
        For options that can't be, and metrics that no data could have.

    Examples
    --------
    >>> import numpy as np
    >>> random = np.random.default_rng(0)
    >>> evaluation = Evaluation(axes="MNKD", unit="mm")
    >>> for clip in ("walk 1", "walk 2"):
    ...     truth = random.normal(0, 300, (64, 5, 3))
    ...     evaluation.update(truth[:, None] + random.normal(0, 50, (64, 20, 5, 3)), truth, sequence=clip)
    >>> evaluation.compute().totals.poses.sum()
    np.int64(128)
    """

    def __init__(
        self,
        *,
        joints: Sequence[str] | str | None = None,
        root_joint: str | int | None = None,
        unit: str | None = None,
        truth_unit: str | None = None,
        axes: str | None = None,
        truth_axes: str | None = None,
        fps: float | None = None,
        shared_joints: Literal["same", "common"] = "same",
        n_hypotheses: int | None = None,
        skeleton: object = None,
        dimensions: int | None = None,
        draws: int | None = None,
        seed: int | None = None,
        by: Sequence[str] | str = (),
        metrics: str | Sequence[str] | None = None,
        preranks: Mapping[str, PreRank] | None = None,
        protocol: Protocol | str | None = None,
        prepared: Prepared | None = None,
        threads: int | None = None,
        gallery: bool = True,
    ) -> None:
        self._options: dict[str, Any] = {"joints": joints, "root_joint": root_joint, "unit": unit}
        self._options |= {"axes": axes, "truth_axes": truth_axes, "fps": fps, "shared_joints": shared_joints}
        self._options |= {"truth_unit": truth_unit, "n_hypotheses": n_hypotheses, "skeleton": skeleton}
        Declarations(**{k: v for k, v in self._options.items() if k != "fps"})  # refuses values that no data could have
        self._options |= {"dimensions": dimensions, "draws": draws, "seed": seed}
        check_callables("preranks", preranks := {} if preranks is None else preranks)
        if not isinstance(prepared, Prepared | None):
            raise PoseDataError(f"prepared: {type(prepared).__name__}; expected what posecal.prepare gives.")
        self.protocol = as_protocol(protocol, metrics)
        check_names(self.protocol, [*preranks])
        self.by, self._gallery = label_entries(by), checked_type(gallery, "gallery", bool)
        self._preranks, self._prepared, self._threads = dict(preranks), prepared, threads
        self.reset()

    def reset(self) -> None:
        """Forget all batches."""
        self._accumulator: Accumulator | None = None
        self._label_names = set[str]()  # that were checked
        self._axes: str | None = None  # of the first batch, where none is declared
        self._has_frames: bool | None = None  # None before the first batch
        self._lack: str | None = None  # why no pose or joint counts so far, "" where some do
        self._frames, self._held = dict[str, None](), list[str]()  # of own poses that count; those that are pending
        self._frames_of_others, self._others, self._frame_check = set[str](), list[Totals](), FrameCheck()
        self._remarks, self._batches, self._n_frames = join_remarks([]), 0, 0
        self._place: Place = 0, [], "", 0  # of the last pose

    def update(
        self,
        hypotheses: Source,
        truth: Source,
        /,
        *,
        where: npt.ArrayLike | None = None,
        occluded: npt.ArrayLike | None = None,
        scores: npt.ArrayLike | None = None,
        log_prob: npt.ArrayLike | None = None,
        weights: npt.ArrayLike | None = None,
        frame_id: npt.ArrayLike | None = None,
        **labels: npt.ArrayLike,
    ) -> None:
        """Add a batch of any length.

        Parameters
        ----------
        hypotheses, truth : arrays
            In the layout and unit that were declared once; tensors of any device.
        where, occluded, scores, weights, log_prob
            Of the batch, as for :func:`evaluate`.
        frame_id : array (M,), optional
            Names of the frames. A frame that came before is counted once: samplers for several processes repeat some.
            Differences over time follow the numbers in them, from batch to batch too. Of C clips of T frames also (C,)
            or (C, T); a frame is counted once at each horizon, since windows of one recording may overlap.
        **labels
            Labels of the poses by name, such as ``sequence=``: an array (M,), or one value for the batch.

        Raises
        ------
        PoseDataError
            For a batch that does not fit, or not with the earlier ones. It is not counted then.

        Notes
        -----
        Where a metric of one's own fails, or the user interrupts, all later calls are refused until :meth:`reset`.
        """
        if not labels.keys() <= self._label_names:
            check_label_names(labels, inspect.signature(self.update), inspect.signature(Evaluation))
            self._label_names = self._label_names | labels.keys()
        is_stored = isinstance(hypotheses, str | os.PathLike)  # a file may declare its own layout
        given = {**self._options, "where": where, "occluded": occluded, "scores": scores, "weights": weights}
        given |= {"labels": labels or None, "log_prob": log_prob}
        given |= {} if self._axes is None or is_stored else {"axes": self._axes}
        data = as_pose_data(starting_at(hypotheses, self._n_frames), truth, given)
        n_given = len(data.truth)
        if frame_id is not None:
            data = self._new_frames(data, frame_id)
        elif self._has_frames:
            raise PoseDataError("frame_id: missing in this batch; expected one in every batch, or in none.")
        elif not data.has_frame_id:
            data = data.replace(frame_id=(self._n_frames + np.arange(n_given)).astype(np.str_))
        if len(data.truth):
            self.add(data, hold_back=frame_id is not None, n_given=n_given)
        self._remarks = join_remarks([*self._remarks, *dropped_remarks(n_given - len(data.truth))])
        if self._options["axes"] is None and not is_stored:
            self._axes = HYPOTHESES  # what arrays are read in that declare none

    def _new_frames(self, data: PoseData, frame_id: npt.ArrayLike) -> PoseData:
        """Name the poses of a batch, and drop those that came before."""
        names = frame_names(data, frame_id)
        if self._has_frames is False:
            raise PoseDataError("frame_id: given for this batch and not for the earlier ones; expected in every one.")
        if data.has_frame_id and {*names.tolist()} != {*data.frame_id.tolist()}:
            raise PoseDataError(f"frame_id: others than those in {data.names[1]}; expected one of the two.")
        names = data.frame_id if data.has_frame_id else names  # a file's are in the order of their numbers
        known = self._frames.keys() | self._frames_of_others if self._frames_of_others else self._frames
        data = data.replace(frame_id=names, has_frame_id=True)
        first = {name: row for row, name in reversed(list(enumerate(pose_names(data)))) if name not in known}
        return select_clips(data, np.sort(np.array([*first.values()], dtype=np.intp)))

    def add(
        self,
        data: PoseData,
        *,
        progress: Progress | None = None,
        hold_back: bool = False,
        complete: bool = False,
        n_given: int | None = None,
        has_mask: bool | None = None,
        of_set: bool = False,
    ) -> None:
        """Add pose data.

        Parameters
        ----------
        data : PoseData
            The next poses.
        progress : callable, optional
            Called with the number of poses that are done.
        hold_back : bool
            Whether these poses stay in memory until the next ones come, and can be dropped by their ``frame_id``.
        complete : bool
            Whether these are all poses: what depends on the whole set is then found first.
        n_given : int, optional
            How many poses came, those among them that were dropped; as many by default.
        has_mask : bool, optional
            Of poses that :func:`posecal.engine.prepare.select_scored` gave: whether the user masks joints.
        of_set : bool
            Whether these are a part of a set of which others count, so that none of these needs to.

        Raises
        ------
        PoseDataError
            For data that don't fit, or not with the earlier ones, and after a failure part way.
        """
        check_callable("progress", progress)
        n_given = len(checked_type(data, "data", PoseData).truth) if n_given is None else n_given
        data = data if wants_reference(self.protocol) else data.replace(reference=None)
        data, place = (data, self._place) if complete else continued(data, n_given, self._place)
        if has_mask is None:
            has_mask, data = data.where is not None, select_scored(data, self.protocol)
        if (lack := "" if of_set else lack_of_scored(data, self.protocol)) and complete:
            raise PoseDataError(lack)
        remarks = [*data.remarks]
        if len(data.truth):
            pending: Pending = "all" if hold_back else "none" if complete else "rest"
            count = partial(self._count, data, progress, pending, has_mask)
            is_plain = not complete and data.scores is None and data.weights is None and all_within(data)
            ragged = not is_plain and has_absent(data)
            try:
                if not (complete or is_plain or ragged):  # else all poses are checked as they are measured
                    refuse_non_finite_hypotheses(data)
                remarks.append(count(ragged))
            except PoseDataError:
                if ragged or not has_absent_anywhere(data):
                    raise
                remarks.append(count(True))
        self._remarks = join_remarks([*self._remarks, *filter(None, remarks)])
        self._place, self._n_frames = place, self._n_frames + n_given
        self._lack = lack if self._lack is None else self._lack and lack
        self._has_frames, self._batches = hold_back, self._batches + 1

    def _count(self, data: PoseData, progress: Progress | None, pending: Pending, has_mask: bool, ragged: bool) -> str:
        """Add poses that count to the sums, and give a remark on them, or none."""
        complete = pending == "none"
        more: dict[str, Any] = {"has_mask": has_mask, "preranks": tuple(self._preranks), "is_ragged": ragged}
        spec = spec_of(data, self._prepared, complete=complete, **more)
        remark = live_remark(data) if ragged else ""
        data = add_spread_labels(data, self.by, predicted_spread, self._threads, self._prepared, is_all=complete)
        if self._accumulator is None:
            options = self.by, self._preranks, self._prepared, self._threads, self._gallery
            accumulator = start_accumulator(spec, self.protocol, data, *options, complete=complete)
        else:
            accumulator = continue_accumulator(self._accumulator, spec, self.by, self._preranks, self._batches + 1)
        accumulator.add(data, progress, pending=pending)
        self._accumulator = accumulator
        self._frame_check.add(data)
        if pending == "all":
            self._frames |= dict.fromkeys(names := pose_names(data))
            self._held = [*self._held, *names][-accumulator.n_pending :]
        return remark

    def totals(self) -> Totals:
        """Give the sums of all batches.

        Returns
        -------
        Totals
            Sums per cell.

        Raises
        ------
        PoseDataError
            Where no batch came, none has a pose or joint that counts, or one failed part way.
        """
        if self._lack:
            raise PoseDataError(self._lack)
        if not (parts := self._parts()):
            raise PoseDataError("evaluation: no batch so far; expected at least one update before compute.")
        totals = parts[0] if len(parts) == 1 else merge_totals(parts)
        remarks, n = [*self._remarks, *self._frame_check.remarks(), *totals.remarks], self._n_frames
        totals.n_frames, totals.remarks = n, join_remarks(remarks, n if self._batches > 1 else None)
        return totals

    def _parts(self) -> list[Totals]:
        """Sums of the own batches, and of those of others."""
        own = [] if self._accumulator is None else [self._accumulator.totals()]
        return [totals for totals in (*own, *self._others) if totals.poses.sum()]

    def compute(self) -> Report:
        """Give the report of all batches so far; more may come afterwards.

        Returns
        -------
        Report
            The numbers.

        Raises
        ------
        PoseDataError
            As :meth:`totals`.
        """
        return Report(self.totals(), self.by)

    def merge(self, other: Evaluation, /) -> None:
        """Add the batches of another evaluation, such as that of another process.

        Parameters
        ----------
        other : Evaluation
            Made alike, with or without batches; it stays as it is. A frame that both have, by ``frame_id``, is counted
            once if it is in the last batch of either: there samplers for several processes put those that they repeat.

        Raises
        ------
        PoseDataError
            For what is no Evaluation; where both have poses and differ in options, metrics, N, joints or in having
            sequence labels; where a frame of both, by ``frame_id``, is in the last batch of neither; and, with or
            without ``frame_id``, where poses of equal truth and labels are in both. Nothing is changed then.
        """
        if not isinstance(other, Evaluation):
            raise PoseDataError(f"merge: {type(other).__name__}; expected an Evaluation.")
        other, kept = copy.copy(other), copy.copy(self)
        frames = {*other._frames, *other._frames_of_others}
        common = sorted(frames.intersection([*self._frames, *self._frames_of_others]))
        for side in (other, kept):
            common = side._drop_pending(common)
        if common:
            raise PoseDataError(
                f"merge: {len(common):,} frames are in both ({first_few(common)}), and not in the last batch of "
                "either; expected each frame in one process."
            )
        parts = [*kept._parts(), *other._parts()]
        if len(parts) > 1:
            merge_totals(parts)  # refuses what does not fit before anything changes
        self.__dict__.update(kept.__dict__)
        self._others = [*self._others, *other._parts()]
        self._frames_of_others = self._frames_of_others | frames
        self._remarks = join_remarks([*self._remarks, *other._remarks, *other._frame_check.remarks()])
        self._n_frames, self._batches = self._n_frames + other._n_frames, self._batches + other._batches
        self._has_frames = other._has_frames if self._has_frames is None else self._has_frames
        self._lack = min((k for k in (self._lack, other._lack) if k is not None), key=len, default=None)

    def _drop_pending(self, names: Sequence[str]) -> list[str]:
        """Drop frames that are pending, and give those that are not."""
        dropped = set(names).intersection(self._held)
        if dropped and self._accumulator is not None:
            self._accumulator = copy.copy(self._accumulator)
            self._accumulator.select_pending(np.array([name not in dropped for name in self._held]))
            self._frames = dict.fromkeys(name for name in self._frames if name not in dropped)
            self._held = [name for name in self._held if name not in dropped]
            self._remarks = join_remarks([*self._remarks, *dropped_remarks(len(dropped))])
        return [name for name in names if name not in dropped]

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if self._accumulator is not None:  # pickled without functions
            what = self.protocol, self._accumulator.spec, self.by, self._preranks, self._accumulator.own_metrics
            self._accumulator.statistics = statistics_and_numbers(*what, self._gallery)
