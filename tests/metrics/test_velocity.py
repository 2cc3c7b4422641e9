"""Motion, against loops, within each sequence and over joints that count in all poses of a difference."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest

from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from posecal.evaluation import evaluate
from posecal.metrics import acceleration_error, jitter, mpjve
from posecal.metrics.velocity import velocity_metrics
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 6, 11, 5
SEQUENCE = ["a"] * 4 + ["b"] + ["c"] * 4 + ["a"] * 2

FUNCTIONS = {
    "mpjve": (mpjve, 1),
    "acceleration_error": (acceleration_error, 2),
    "jitter": (jitter, 3),
    "true_jitter": (partial(jitter, of="truth"), 3),
}


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def where() -> Mask:
    return mostly(M, K)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("root", [None, 1])
@pytest.mark.parametrize("masked", [False, True])
def test_motion_is_the_naive_formula(
    arrays: tuple[Array, Array], where: Mask, root: int | None, masked: bool, name: str
) -> None:
    x, y = (oracles.relative(array, root) for array in arrays)
    w = oracles.relative_mask(where, root) if masked else np.ones((M, K), dtype=bool)
    function, order = FUNCTIONS[name]
    found = function(*arrays, sequence=SEQUENCE, root=root, where=where if masked else None)
    moving = {"jitter": x, "true_jitter": y[None]}.get(name, x - y)
    np.testing.assert_allclose(found, oracles.motion(moving, w, SEQUENCE, order), rtol=1e-9)


def test_a_constant_acceleration_has_an_error_and_no_jitter() -> None:
    """One hypothesis stands still, the other is 3 m² mm from it: it gains 6 mm per frame²."""
    x = np.zeros((2, 6, 1, 3))
    x[1, :, 0, 1] = 3 * np.arange(6) ** 2
    still = np.zeros((6, 1, 3))
    np.testing.assert_allclose(acceleration_error(x, still), [math.nan, math.nan, 3, 3, 3, 3])
    np.testing.assert_allclose(jitter(x, still), [math.nan] * 3 + [0] * 3, atol=1e-12)
    np.testing.assert_allclose(jitter(x[:1], x[1] ** 2 / 9, of="truth"), [math.nan] * 3 + [36, 60, 84])


def test_a_joint_that_did_not_count_in_the_pose_before_has_no_step() -> None:
    """Joint 0 is off by 100 mm throughout: its error of velocity is 0, also where it appears for the first time."""
    y = np.zeros((3, 2, 3))
    x = y[None] + [[100.0, 0, 0], [0, 0, 0]]
    where = np.array([[False, True], [True, True], [True, True]])
    np.testing.assert_allclose(mpjve(x, y, where=where), [math.nan, 0, 0])


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("length", [1, 2, 3])
def test_motion_does_not_depend_on_the_blocks(
    arrays: tuple[Array, Array], where: Mask, length: int, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    x, y = arrays
    x[:, ~where], y[~where] = np.nan, np.nan
    whole = FUNCTIONS[name][0](x, y, sequence=SEQUENCE, where=where)
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", length * N * K * 3 * 8)
    np.testing.assert_array_equal(FUNCTIONS[name][0](x, y, sequence=SEQUENCE, where=where), whole)


def test_without_labels_all_poses_are_one_sequence(arrays: tuple[Array, Array]) -> None:
    found = mpjve(*arrays)
    np.testing.assert_allclose(found, mpjve(*arrays, sequence=["one"] * M))
    assert np.flatnonzero(np.isnan(found)).tolist() == [0]


def test_motion_per_second_is_that_per_frame_times_a_power_of_the_frames_per_second(
    arrays: tuple[Array, Array],
) -> None:
    for function, order in FUNCTIONS.values():
        np.testing.assert_allclose(function(*arrays, fps=50), 50**order * function(*arrays))


def test_a_jitter_is_of_the_hypotheses_or_of_the_truth(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"of: 'mean' is not known\. Known: hypotheses, truth\."):
        jitter(*arrays, of="mean")  # type: ignore[arg-type]


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
    ("velocity", "fps", "unit", "rate"),
    [("frame", 25.0, "mm/frame", 1), ("frame", None, "mm/frame", 1), ("second", 25.0, "mm/s", 25)],
)
def test_motion_is_per_frame_or_per_second(velocity: str, fps: float | None, unit: str, rate: float) -> None:
    spec = DataSpec(3, ("a", "b"), None, ("sequence",), fps)
    found = {m.name: m for m in velocity_metrics(Scope(Protocol(velocity=velocity), spec))}  # type: ignore[arg-type]
    for order, power, names in (
        (1, "", ["mpjve", "mean_pose_mpjve"]),
        (2, "²", ["acceleration_error", "mean_pose_acceleration_error"]),
        (3, "³", ["jitter", "mean_pose_jitter", "true_jitter"]),
    ):
        for name in names:
            metric = found.pop(name)
            assert (metric.unit, metric.direction) == (f"{unit}{power}", "lower" if order < 3 else "none")
            assert metric.finish(np.array(4.0)) == 4 * rate**order
    assert not found


def test_the_definition_of_a_jitter_says_whose_it_is() -> None:
    found = {m.name: m for m in velocity_metrics(Scope(Protocol(), DataSpec(3, ("a", "b"), None, ("sequence",))))}
    assert found["jitter"].definition == (
        "mean over consecutive poses of a sequence of the mean over hypotheses, each followed through its sequence, of "
        "the mean over the 2 joints of ‖Δ³x‖, Δ³x = x[t] − 3 x[t−1] + 3 x[t−2] − x[t−3]"
    )
    assert found["true_jitter"].definition == (
        "mean over consecutive poses of a sequence of the mean over the 2 joints of "
        "‖Δ³y‖, Δ³y = y[t] − 3 y[t−1] + 3 y[t−2] − y[t−3]"
    )


def test_motion_of_angles_goes_the_shorter_way_round() -> None:
    """Both turn by 10 degrees a frame, past 360; the hypothesis by 1 degree more at the fourth."""
    true = (np.arange(6) * 10 + 335.0) % 360
    angle = (true + (np.arange(6) > 2)) % 360
    report = evaluate(
        angle.reshape(1, 6, 1, 1),
        true.reshape(6, 1, 1),
        unit="deg",
        labels={"sequence": "a"},
        axes="NMKD",
        metrics="mpjve, acceleration_error, jitter, true_jitter",
    )
    assert report["mpjve"] == pytest.approx(1 / 5)
    assert report["acceleration_error"] == pytest.approx((1 + 1) / 4)
    assert report["jitter"] == pytest.approx((1 + 2 + 1) / 3)
    assert report["true_jitter"] == pytest.approx(0, abs=1e-9)
    assert report.metrics["jitter"].unit == "deg/frame³"
