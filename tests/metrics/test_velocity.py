"""Velocity errors, against loops, within each sequence and over joints that count in both poses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from posecal.metrics import mpjve
from posecal.metrics.velocity import velocity_metrics
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 6, 11, 5
SEQUENCE = ["a"] * 4 + ["b"] + ["c"] * 4 + ["a"] * 2


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def where() -> Mask:
    return mostly(M, K)


@pytest.mark.parametrize("root", [None, 1])
@pytest.mark.parametrize("masked", [False, True])
def test_velocity_errors_are_the_naive_formula(
    arrays: tuple[Array, Array], where: Mask, root: int | None, masked: bool
) -> None:
    x, y = (oracles.relative(array, root) for array in arrays)
    w = oracles.relative_mask(where, root) if masked else np.ones((M, K), dtype=bool)
    found = mpjve(*arrays, sequence=SEQUENCE, root=root, where=where if masked else None)
    np.testing.assert_allclose(found, oracles.velocity_errors(x, y, w, SEQUENCE), rtol=1e-9)


def test_a_joint_that_did_not_count_in_the_pose_before_has_no_step() -> None:
    """Joint 0 is off by 100 mm throughout: its error of velocity is 0, also where it appears for the first time."""
    y = np.zeros((3, 2, 3))
    x = y[None] + [[100.0, 0, 0], [0, 0, 0]]
    where = np.array([[False, True], [True, True], [True, True]])
    np.testing.assert_allclose(mpjve(x, y, where=where), [math.nan, 0, 0])


@pytest.mark.parametrize("length", [1, 2, 3])
def test_velocities_do_not_depend_on_the_blocks(
    arrays: tuple[Array, Array], where: Mask, length: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    x, y = arrays
    x[:, ~where], y[~where] = np.nan, np.nan
    whole = mpjve(x, y, sequence=SEQUENCE, where=where)
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", length * N * K * 3 * 8)
    np.testing.assert_allclose(mpjve(x, y, sequence=SEQUENCE, where=where), whole)


def test_without_labels_all_poses_are_one_sequence(arrays: tuple[Array, Array]) -> None:
    found = mpjve(*arrays)
    np.testing.assert_allclose(found, mpjve(*arrays, sequence=["one"] * M))
    assert np.flatnonzero(np.isnan(found)).tolist() == [0]


def test_velocities_per_second_are_those_per_frame_times_the_frames_per_second(arrays: tuple[Array, Array]) -> None:
    np.testing.assert_allclose(mpjve(*arrays, fps=50), 50 * mpjve(*arrays))


def test_a_velocity_needs_a_sequence_label_for_every_pose(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"sequence \(3,\): expected \(M,\) = \(11,\)\."):
        mpjve(*arrays, sequence=["a", "b", "c"])


@pytest.mark.parametrize("fps", [0, -25, math.nan, math.inf])
def test_frames_per_second_are_above_zero(arrays: tuple[Array, Array], fps: float) -> None:
    with pytest.raises(PoseDataError, match=r"fps: .*; expected frames per second above 0\."):
        mpjve(*arrays, fps=fps)


def test_a_velocity_refuses_what_is_not_finite(arrays: tuple[Array, Array]) -> None:
    arrays[0][2, 7, 3, 1] = math.nan
    with pytest.raises(PoseDataError, match=r"non-finite coordinates \(first: pose 7, joint 3\)"):
        mpjve(*arrays)


def test_a_velocity_refuses_a_root_beyond_the_joints(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"root: 5; expected the index of one of 5 joints"):
        mpjve(*arrays, root=5)


@pytest.mark.parametrize(
    ("velocity", "fps", "unit", "number"),
    [("frame", 25.0, "mm/frame", 4), ("frame", None, "mm/frame", 4), ("second", 25.0, "mm/s", 100)],
)
def test_a_velocity_is_per_frame_or_per_second(velocity: str, fps: float | None, unit: str, number: float) -> None:
    spec = DataSpec(3, ("a", "b"), None, ("sequence",), fps)
    found = list(velocity_metrics(Scope(Protocol(velocity=velocity), spec)))  # type: ignore[arg-type]
    assert [metric.name for metric in found] == ["mpjve", "mean_pose_mpjve"]
    for metric in found:
        assert metric.unit == unit
        assert metric.finish(np.array(4.0)) == number
