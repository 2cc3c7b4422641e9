"""Sums of an evaluation in one call, for tests of what is made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from posecal.calibration.rank_tests import PreRank
from posecal.data.pose_data import PoseData
from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals
from posecal.evaluation import Evaluation


def accumulate(
    data: PoseData,
    protocol: Protocol | None = None,
    *,
    by: Sequence[str] = (),
    preranks: Mapping[str, PreRank] | None = None,
    threads: int | None = None,
    progress: Callable[[int], object] | None = None,
) -> Totals:
    """Evaluate pose data into sums."""
    evaluation = Evaluation(by=by, preranks=preranks, protocol=protocol, threads=threads)
    evaluation.add(data, progress=progress, complete=True)
    return evaluation.totals()
