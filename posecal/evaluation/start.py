"""The accumulator that the first batch of an evaluation starts, and that later ones continue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from posecal.calibration.rank_tests import NEEDS_COORDINATE_RANGE, PreRank
from posecal.data.pose_data import PoseData
from posecal.engine.accumulate import Accumulator
from posecal.engine.cells import CellIndex
from posecal.engine.gallery import POSE_NUMBERS, number_shown
from posecal.engine.metric import Metric, Statistic
from posecal.engine.prepare import Prepared, prepare
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError, option
from posecal.metrics.multimodal import NEEDS_TRUE_CLIPS
from posecal.metrics.single_poses import pose_numbers
from posecal.registry import registered_metrics, statistics_of


def statistics_and_numbers(
    protocol: Protocol,
    spec: DataSpec,
    by: Sequence[str],
    preranks: Mapping[str, PreRank],
    own: Sequence[Metric],
    gallery: bool,
) -> tuple[Statistic, ...]:
    """Choose the statistics that a protocol needs, and with a gallery the numbers that its poses are chosen by."""
    statistics = statistics_of(protocol, spec, by, preranks, own)
    return (*statistics, pose_numbers(Scope(protocol, spec))) if gallery and number_shown(spec) else statistics


def start_accumulator(
    spec: DataSpec,
    protocol: Protocol,
    data: PoseData,
    by: Sequence[str],
    preranks: Mapping[str, PreRank],
    prepared: Prepared | None,
    threads: int | None,
    gallery: bool,
    *,
    complete: bool,
) -> Accumulator:
    """Make an accumulator of the statistics that a protocol needs, without poses so far.

    Raises
    ------
    PoseDataError
        Where a metric depends on the whole set, and neither ``prepared`` nor all poses (``complete``) are there.
    """
    own = tuple(m for m in registered_metrics() if m.headline or m.name in protocol.wanted)
    statistics = statistics_and_numbers(protocol, spec, by, preranks, own, gallery)
    names = {statistic.name for statistic in statistics}
    if prepared is None and names & (NEEDS_COORDINATE_RANGE | NEEDS_TRUE_CLIPS):
        if not complete:
            raise PoseDataError(
                "metrics: tarp_box depends on all true poses, which come in batches here; expected "
                f"{option('prepared')} with posecal.prepare of them, or metrics without it."
            )
        prepared = prepare(data)
    place = {} if prepared is None or prepared.first is None else {"first": prepared.first, "n_poses": prepared.n_poses}
    labels = [name for name in data.labels if prepared is None or name not in prepared.unsummed]
    index = CellIndex([entry for entry in by if entry != "occlusion"], protocol.average, labels, **place)
    return Accumulator(spec, protocol, statistics, index, prepared=prepared, own_metrics=own, threads=threads)


def spec_of(data: PoseData, prepared: Prepared | None, *, complete: bool, **more: Any) -> DataSpec:
    """Describe all poses, or those of a batch, whose true clips are known if they were prepared."""
    if not complete and data.clips is not None and not data.clips.has_axis:
        raise PoseDataError(
            "clip: a label of poses that come in batches, which may cut clips; expected whole clips, "
            f"{option('axes')} with a T, or all poses in one call."
        )
    spec = DataSpec.of(data, **more)
    return spec if complete else replace(spec, has_observed=prepared is not None and prepared.clips is not None)


def continue_accumulator(
    accumulator: Accumulator, spec: DataSpec, by: Sequence[str], preranks: Mapping[str, PreRank], number: int
) -> Accumulator:
    """Give the accumulator that takes a further batch: the same one, or one for absent or weighted hypotheses as well.

    Raises
    ------
    PoseDataError
        Where the data of the batch, by its number, are not described as those before.
    """
    labels = accumulator.spec.labels
    if sorted(labels) == sorted(spec.labels):  # in any order
        spec = replace(spec, labels=labels)
    together = spec.together_with(accumulator.spec)
    if together == accumulator.spec:
        return accumulator
    if together == accumulator.spec.together_with(spec):
        has_gallery = any(statistic.name == POSE_NUMBERS for statistic in accumulator.statistics)
        own = accumulator.own_metrics
        statistics = statistics_and_numbers(accumulator.protocol, together, by, preranks, own, has_gallery)
        return accumulator.with_weights(together, statistics)
    raise PoseDataError(f"batch {number}: {together.difference(accumulator.spec)}; expected the same in every batch.")
