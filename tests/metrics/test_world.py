"""Errors in the world frame, against one fit per segment and hypothesis in loops."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.errors import PoseDataError
from posecal.metrics import world_mpjpe
from posecal.metrics.world import WorldAlignment
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 4, 11, 5
SEQUENCE = ["a"] * 7 + ["b"] * 4


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    """Trajectories that drift, far from the origin."""
    x, y = skewed(0, N, M, K)
    return x + 40 * np.arange(M)[:, None, None] + 9000, y + 5000


def errors(x: Array, y: Array, w: Mask, segments: list[list[int]], align: str) -> Array:
    """The error of each hypothesis and pose, (N, M)."""
    found = np.full(x.shape[:2], np.nan)
    for frames in segments:
        fitted = [m for m in frames if w[m].any()][: 2 if align == "first_two" else None]
        pairs = [(m, k) for m in fitted for k in range(y.shape[1]) if w[m, k]]
        for n in range(len(x)):
            move = oracles.fit(np.array([x[n, m, k] for m, k in pairs]), np.array([y[p] for p in pairs]), "similarity")
            for m in frames:
                moved = move(x[n, m])
                joints = [k for k in range(y.shape[1]) if w[m, k]]
                found[n, m] = oracles.mean([float(np.linalg.norm(moved[k] - y[m, k])) for k in joints])
    return found


@pytest.mark.parametrize("align", ["whole", "first_two"])
@pytest.mark.parametrize("segment", [3, 100, None])
def test_one_alignment_is_fitted_per_segment_and_hypothesis(
    arrays: tuple[Array, Array], align: WorldAlignment, segment: int | None
) -> None:
    x, y = arrays
    where = mostly(M, K)
    step = segment or M
    parts = [list(range(s, min(s + step, stop))) for start, stop in ((0, 7), (7, 11)) for s in range(start, stop, step)]
    each = errors(x, y, where, parts, align)
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
