"""Errors in the world frame, against one fit per segment and hypothesis in loops."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.evaluation import evaluate
from posecal.metrics import world_mpjpe
from posecal.metrics.world import WorldAlignment
from posecal.report.report import Report
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, mostly, skewed

N, M, K = 4, 11, 5
SEQUENCE = ["a"] * 7 + ["b"] * 4


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    """Trajectories that drift, far from the origin."""
    x, y = skewed(0, N, M, K)
    return x + 40 * np.arange(M)[:, None, None] + 9000, y + 5000


@pytest.mark.parametrize("align", ["whole", "first_two"])
@pytest.mark.parametrize("segment", [3, 100, None])
def test_one_alignment_is_fitted_per_segment_and_hypothesis(
    arrays: tuple[Array, Array], align: WorldAlignment, segment: int | None
) -> None:
    x, y = arrays
    where = mostly(M, K)
    each = oracles.world_errors(x, y, where, where, oracles.segments(SEQUENCE, segment or M), align)
    x[:, ~where] = np.nan
    found = world_mpjpe(x, y, sequence=SEQUENCE, align=align, segment=segment, where=where)
    np.testing.assert_allclose(found, each.mean(axis=0), rtol=1e-6)
    assert np.flatnonzero(np.isnan(found)).tolist() == [4]
    least = world_mpjpe(x, y, sequence=SEQUENCE, align=align, segment=segment, where=where, of="min")
    for frames in (slice(0, 7), slice(7, 11)):
        best = np.nansum(each[:, frames], axis=1).argmin()
        np.testing.assert_allclose(least[frames], each[best, frames], rtol=1e-6)


def test_drift_counts_after_alignment_of_the_first_two_frames(arrays: tuple[Array, Array]) -> None:
    """The first two frames are right, and from the third on every joint is 30 mm to the side."""
    _, y = arrays
    x = y[None].copy()
    x[:, 2:, :, 0] += 30
    np.testing.assert_allclose(world_mpjpe(x, y, align="first_two"), [0, 0] + [30] * (M - 2), atol=1e-6)
    assert world_mpjpe(x, y).max() < 30


def test_an_error_in_the_world_names_what_is_not_finite(arrays: tuple[Array, Array]) -> None:
    arrays[0][2, 7, 3, 1] = np.inf
    with pytest.raises(PoseDataError, match=r"non-finite coordinates \(first: pose 7, joint 3\)\. Mask those joints"):
        world_mpjpe(*arrays)


def test_a_trajectory_in_the_plane_is_refused(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"align: points with 2 coordinates"):
        world_mpjpe(arrays[0][..., :2], arrays[1][..., :2])


def report(arrays: tuple[Array, Array], **options: Any) -> Report:
    labels = {"sequence": SEQUENCE, "action": ["walk"] * M}
    return evaluate(*arrays, unit="mm", axes="NMKD", labels=labels, root_joint="none", **options)


ROWS = "wa_mpjpe, w_mpjpe, min_wa_mpjpe, min_w_mpjpe"


@pytest.mark.parametrize("segment", [3, 100, None])
def test_the_rows_of_a_report_are_those_of_the_function(arrays: tuple[Array, Array], segment: int | None) -> None:
    where = mostly(M, K)
    protocol = Protocol(segment=segment or "sequence", metrics=ROWS)
    found = report(arrays, where=where, protocol=protocol, by="action")
    given: dict[str, Any] = {"sequence": SEQUENCE, "segment": segment, "where": where}
    for name, align in (("wa_mpjpe", "whole"), ("w_mpjpe", "first_two")):
        for prefix, of in (("", "mean"), ("min_", "min")):
            errors = world_mpjpe(*arrays, align=align, of=of, **given)  # type: ignore[arg-type]
            assert found[prefix + name] == pytest.approx(np.nanmean(errors), rel=1e-9)
            assert found.value(prefix + name, "action=walk") == pytest.approx(np.nanmean(errors), rel=1e-9)
    assert found.table.poses.iloc[0] == M - 1
    assert f"segment={segment or 'sequence'}" in found.signature or segment == 100


def test_their_definitions_say_what_is_aligned(arrays: tuple[Array, Array]) -> None:
    found = report(arrays, metrics=ROWS).metrics
    error = "error: mean over the 5 joints of ‖x − y‖ after one similarity for each"
    mean, best = "the mean of the N=4 errors", "one of the N=4 hypotheses chosen per sequence"
    segment = "segment of 100 frames of a sequence"
    assert found["wa_mpjpe"].definition == f"mean over poses of {mean}; {error} {segment}"
    assert found["min_w_mpjpe"].definition == (
        f"mean over poses, {best}; {error} {segment}, fitted to its first two frames"
    )
    found = report(arrays, protocol=Protocol(segment="sequence", metrics=ROWS)).metrics
    assert found["wa_mpjpe"].definition == f"mean over poses of {mean}; {error} sequence"


def test_an_interval_is_over_sequences(arrays: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch) -> None:
    """On the log scale, of three sequences or more: the jackknife leaves out one, then another."""
    assert np.isnan(report(arrays, metrics="wa_mpjpe").interval("wa_mpjpe")).all()
    monkeypatch.setattr(sys.modules[__name__], "SEQUENCE", ["a"] * 4 + ["b"] * 3 + ["c"] * 4)
    errors = world_mpjpe(*arrays, sequence=SEQUENCE)
    low, high = report(arrays, metrics="wa_mpjpe").interval("wa_mpjpe")
    assert low < errors.mean() < high
    assert np.sqrt(low * high) == pytest.approx(errors.mean())


def test_poses_of_segments_that_cannot_be_aligned_are_counted(arrays: tuple[Array, Array]) -> None:
    where = np.ones((M, K), dtype=bool)
    where[6:7, 2:] = where[10:, 1:] = False  # the last segments of 3: of one two joints count, of the other one
    found = report(arrays, protocol=Protocol(segment=3, metrics="mpjpe, w_mpjpe"), where=where)
    assert found.count("mpjpe") == M
    assert found.count("w_mpjpe") == M - 2
    (remark,) = [line for line in found.remarks if "fewer than three joints to align" in line]
    assert remark.startswith(f"W-MPJPE: 2 poses of {M} left out")
