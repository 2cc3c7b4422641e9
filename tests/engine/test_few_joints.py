"""Poses of which so few joints count that they fit, or are right, whatever the hypotheses are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.report.curves import curve
from tests.helpers.random_worlds import Array

N, M, K = 5, 30, 6
JOINTS = ["Hip", "RKnee", "LKnee", "Thorax", "Head", "LWrist"]
FEW = np.arange(M) % 2 == 0
ALIGNED = ("pa_mpjpe", "pa_min_mpjpe", "pa_median_pose_mpjpe", "pa_pck", "pa_auc", "pa_pve", "cps")
_RANDOM = np.random.default_rng(7)
Y = _RANDOM.normal(0, 300, (M, K, 3))
Y -= Y[:, :1]
X = Y + _RANDOM.normal(0, 60, (N, M, K, 3))
X -= X[:, :, :1]


def where(few: int) -> Any:
    """Every second pose with so few joints, the root among them."""
    return ~FEW[:, None] | (np.arange(K) < few)


def report(poses: Any = slice(None), **options: Any) -> posecal.Report:
    declared: dict[str, Any] = {"axes": "NMKD", "unit": "mm", "joints": JOINTS, "root_joint": "Hip", "threads": 1}
    metrics = ["default", *ALIGNED]
    protocol = posecal.Protocol(metrics=options.pop("metrics", metrics), **options.pop("protocol", {}))
    return posecal.evaluate(X[:, poses], Y[poses], **{**declared, "protocol": protocol, "gallery": False, **options})


@pytest.mark.parametrize("best", ["own", "linked", "mean"])
def test_aligned_numbers_are_of_the_poses_that_have_enough_joints(best: str) -> None:
    protocol = {"pck_best": best, "cps_best": best, "pck_joints": "all"}
    found, expected = report(where=where(2), protocol=protocol), report(~FEW, protocol=protocol)
    for name in ALIGNED:
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-6, err_msg=name)
    assert found["mpjpe"] != expected["mpjpe"]
    heights = [curve(each, "cps_curve")[1] for each in (found, expected)]
    np.testing.assert_allclose(*heights, rtol=1e-6)
    (remark,) = [text for text in found.remarks if "few joints" in text]
    assert remark.startswith("truth: in 15 of 30 frames (first: 0, 2, 4) so few joints count that any pose fits them")


def test_no_aligned_number_no_remark() -> None:
    assert not [text for text in report(where=where(2), metrics="mpjpe").remarks if "few joints" in text]
    protocol = {"align": "rigid", "cps_align": "none"}
    assert not [text for text in report(where=where(2), protocol=protocol).remarks if "few joints" in text]


def test_alignments_are_fitted_to_joints_that_are_not_scored_too() -> None:
    occluded = ~where(2) & False
    occluded[:, 4] = True
    found = report(occluded=occluded, protocol={"where": "occluded"}, metrics="pa_mpjpe")
    assert found["pa_mpjpe"] > 10
    assert not [text for text in found.remarks if "few joints" in text]


@pytest.mark.parametrize("metric", ["mpjpe", "min_mpjpe", "cps"])
def test_functions_of_arrays_give_nan_for_such_poses(metric: str) -> None:
    how: dict[str, Any] = {"axes": "NMKD", "unit": "mm", "where": where(2)}
    found = getattr(posecal.metrics, metric)(X, Y, align="similarity", **how)
    np.testing.assert_array_equal(np.isnan(found), FEW)
    assert not np.isnan(getattr(posecal.metrics, metric)(X, Y, align="rigid", **how)).any()


def test_a_trajectory_of_two_points_has_no_error_in_the_world() -> None:
    mask = np.zeros((M, K), dtype=bool)
    mask[[0, 1], 3], mask[10:] = True, True
    sequence = np.arange(M) // 10
    for of in ("mean", "min"):
        found: Array = posecal.metrics.world_mpjpe(X, Y, where=mask, sequence=sequence, of=of, axes="NMKD", unit="mm")  # type: ignore[arg-type]
        np.testing.assert_array_equal(np.isnan(found), np.arange(M) < 10)


def test_a_pose_of_which_only_the_root_counts_is_left_out() -> None:
    found, expected = report(where=where(1)), report(~FEW)
    for name in ("mpjpe", *ALIGNED):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-6, err_msg=name)
    (remark,) = [text for text in found.remarks if "only the root" in text]
    assert remark.startswith("only the root Hip counts in 15 of 30 frames (first: 0, 2, 4")
    assert not [text for text in found.remarks if "equals the truth" in text or "the same" in text]
    errors = posecal.metrics.mpjpe(X, Y, where=where(1), root=0, axes="NMKD", unit="mm")
    np.testing.assert_array_equal(np.isnan(errors), FEW)


def test_a_joint_that_is_not_scored_does_not_keep_such_a_pose() -> None:
    """Of every second pose hip and right knee count; scored are hip and head."""
    scored: dict[str, Any] = {"protocol": {"joints": "Hip, Head"}, "metrics": "mpjpe"}
    found, expected = report(where=where(2), **scored), report(~FEW, **scored)
    np.testing.assert_allclose(found["mpjpe"], expected["mpjpe"], rtol=1e-6)
    assert [text for text in found.remarks if text.startswith("only the root Hip counts in 15 of 30 frames")]
