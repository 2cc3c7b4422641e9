"""Poses that are one point, masks of what is known, and columns that are no coordinates."""

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.data.degenerate import column_problem
from posecal.data.layout import Layout, MemoryArray
from posecal.data.pose_data import PoseData, match_poses
from posecal.errors import PoseDataError
from tests.helpers.small_files import JOINTS, K, M, N, gt, hypotheses, hyps, truth

Array = np.ndarray[Any, Any]


def evaluated(x: Array, y: Array, **options: Any) -> posecal.Report:
    return posecal.evaluate(x, y, axes="NMKD", unit="mm", joints=JOINTS, threads=1, **options)


# --- one point ------------------------------------------------------------------------------------------------


def test_true_poses_that_are_one_point_are_refused_with_their_number_and_the_first() -> None:
    y = truth()
    y[[2, 5]] = 7.0
    with pytest.raises(
        PoseDataError, match=r"^truth: in 2 of 7 frames \(first: 2, 5\) all joints lie in one point; exp"
    ):
        evaluated(hypotheses(), y)


def test_only_the_joints_that_count_make_a_pose_one_point() -> None:
    y, where = truth(), np.ones((M, K), dtype=bool)
    y[2, :4] = 7.0
    where[2, 4:] = False
    with pytest.raises(PoseDataError, match=r"in 1 of 7 frames \(first: 2\)"):
        evaluated(hypotheses(), y, where=where)
    where[2, 2:4] = False  # two joints that agree may be
    assert evaluated(hypotheses(), y, where=where).totals.poses.sum() == M


# --- what is known --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [bool, int, float])
def test_joints_that_are_not_valid_do_not_count_whatever_they_hold(dtype: type) -> None:
    valid = np.ones((M, K), dtype=dtype)
    valid[2, 3], valid[5] = 0, 0
    y = truth().astype(float)
    y[valid == 0] = np.nan
    data = match_poses(hyps(joints=JOINTS), gt(y, joints=JOINTS, valid=posecal.data.arrays.as_marks(valid, "valid")))
    keep = [0, 1, 2, 3, 4, 6]
    assert data.order.tolist() == keep
    np.testing.assert_array_equal(data.where, valid[keep] == 1)
    assert data.remarks[:2] == (
        "valid: 1 frame without a valid joint (first: 5); left out.",
        "valid: 1 joint is not valid; left out.",
    )
    errors = np.linalg.norm(hypotheses() - truth(), axis=-1)
    errors[:, valid == 0] = np.nan
    right = np.nanmean(errors[:, keep], axis=2).mean()
    assert posecal.evaluate(data, metrics="mpjpe")["mpjpe"] == pytest.approx(right, rel=1e-6)


def test_masks_of_both_files_and_of_the_caller_are_joined() -> None:
    masks = np.random.default_rng(0).random((3, M, K)) < 0.9
    predicted, true = (
        hyps(joints=JOINTS[::-1], valid=masks[0][:, ::-1]),
        gt(joints=JOINTS, valid=masks[1], where=masks[2]),
    )
    np.testing.assert_array_equal(match_poses(predicted, true).where, masks.all(axis=0))


def test_frames_that_are_not_valid_are_left_out() -> None:
    valid = np.arange(M) % 2 == 0
    data = match_poses(hyps(), gt(valid=valid))
    assert data.order.tolist() == [0, 2, 4, 6]
    with pytest.raises(PoseDataError, match=r"^valid: no joint of gt\.npz is valid; expected some\.$"):
        match_poses(hyps(), gt(valid=~valid & valid))


def test_a_mask_of_another_shape_is_refused() -> None:
    with pytest.raises(PoseDataError, match=r"^gt\.npz: valid \(17, 7\); expected \(M, K\) = \(7, 17\) or \(M,\)\.$"):
        match_poses(hyps(), gt(valid=np.ones((K, M), dtype=bool)))


def test_poses_whose_root_does_not_count_are_left_out_with_a_remark() -> None:
    where = np.ones((M, K), dtype=bool)
    where[[1, 4], 0] = False
    report = evaluated(hypotheses(), truth(), where=where, metrics="mpjpe")
    keep = [0, 2, 3, 5, 6]
    right = np.linalg.norm(hypotheses() - truth(), axis=-1)[:, keep].mean()
    assert report["mpjpe"] == pytest.approx(right, rel=1e-6)
    remark = (
        "the root Hip does not count in 2 of 7 frames (first: 1, 4): left out, since their positions are relative to "
    )
    assert f"{remark}it." in report.remarks


def test_a_root_that_is_not_known_is_named_and_no_other_joint() -> None:
    y = truth().astype(float)
    y[3, 0] = np.nan
    with pytest.raises(
        PoseDataError, match=r"^truth has non-finite coordinates in 1 of 7 .* \(first: frame 3, joint Hip\)"
    ):
        evaluated(hypotheses(), y)
    x = hypotheses()
    x[2, 5, 0] = np.inf
    with pytest.raises(PoseDataError, match=r"^hypotheses has non-finite .* \(first: frame 5, joint Hip\)"):
        evaluated(x, truth())
    report = evaluated(
        hypotheses(), y, occluded=~np.isfinite(y).all(axis=2), protocol=posecal.Protocol(where="visible")
    )
    assert report.totals.poses.sum() == M - 1


# --- fill values ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [1.1e7, -1e19, 1e20, np.inf, np.nan])
def test_fill_values_are_refused_in_one_call_and_in_batches(value: float) -> None:
    x, what = hypotheses(), "coordinates beyond 10 km" if np.isfinite(value) else "non-finite coordinates"
    x[3, 4, 6, 1] = value
    words = rf"^hypotheses has {what}.* in 1 of 7 frames \(first: frame 4, joint LFoot\)"
    with pytest.raises(PoseDataError, match=words):
        evaluated(x, truth())
    evaluation = posecal.Evaluation(axes="NMKD", unit="mm", joints=JOINTS)
    with pytest.raises(PoseDataError, match=words):
        evaluation.update(x, truth())
    y = truth()
    y[4, 6, 1] = value
    with pytest.raises(PoseDataError, match=rf"^truth has {what}.* in 1 of 7 frames \(first: frame 4, joint LFoot\)"):
        evaluated(hypotheses(), y)


@pytest.mark.parametrize("value", [1e8, 1e20, float(np.finfo(np.float32).max)])
def test_a_hypothesis_that_is_far_away_as_a_whole_is_refused(value: float) -> None:
    """Relative to its root it is near, and what it does to sums would change the numbers of the others."""
    x = hypotheses()
    x[3, 4] = value
    with pytest.raises(PoseDataError, match=r"^hypotheses has .*beyond 10 km.* \(first: frame 4, joint Hip\)"):
        evaluated(x, truth())
    with pytest.raises(PoseDataError, match=r"^hypotheses: .*beyond 10 km .* \(first: pose 4, joint 0\)"):
        posecal.metrics.mpjpe(x, truth(), root=0)


@pytest.mark.parametrize("value", [1.1e5, -1e9])
def test_angles_beyond_many_turns_are_refused(value: float) -> None:
    y = np.random.default_rng(0).uniform(-180, 180, (30, 3, 1))
    x = y + np.random.default_rng(1).normal(0, 9, (8, *y.shape))
    options: dict[str, Any] = {"unit": "deg", "axes": "NMKD", "truth_axes": "MKD", "joints": ["a", "b", "c"]}
    x[:, 5] += 360 * 250  # turns that are whole
    assert posecal.evaluate(x, y, **options)["mpjpe"] < 9
    x[3, 21, 1] = value
    words = r"^hypotheses has angles beyond 100,000 degrees in 1 of 30 frames \(first: frame 21, joint b\)"
    with pytest.raises(PoseDataError, match=words):
        posecal.evaluate(x, y, **options)
    evaluation = posecal.Evaluation(**options)
    with pytest.raises(PoseDataError, match=words):
        evaluation.update(x, y)
    x[3, 21, 1], y[4, 2] = 0, value
    with pytest.raises(
        PoseDataError, match=words.replace("hypotheses", "truth").replace("21", "4").replace("b\\)", "c")
    ):
        posecal.evaluate(x, y, **options)


def test_three_joints_of_one_coordinate_are_not_said_to_be_three_coordinates() -> None:
    y = np.random.default_rng(0).uniform(-180, 180, (30, 3, 1))
    data = PoseData(np.stack([y] * 5), y, unit="deg")
    assert data.shape == (5, 30, 3, 1)
    with pytest.raises(PoseDataError, match=r"coordinates last\. Pass truth_axes=.MDK."):
        PoseData(np.zeros((5, 30, 3, 17)), np.zeros((30, 3, 17)), unit="mm")


# --- columns and axes -----------------------------------------------------------------------------------------


def with_confidence(poses: Array, values: Array) -> Array:
    return np.concatenate([poses, values], axis=-1)


def test_a_fourth_coordinate_is_refused_with_what_it_looks_like() -> None:
    random = np.random.default_rng(1)
    y = with_confidence(truth(), random.uniform(0.2, 1, (M, K, 1)))
    x = with_confidence(hypotheses(), np.full((N, M, K, 1), 3.0))
    with pytest.raises(PoseDataError) as refused:
        match_poses(hyps(x), gt(y))
    assert str(refused.value).splitlines()[1:] == [
        '  - hyps.npz has D = 4 coordinates; expected at most 3 of a position. Pass axes="NMKC" to leave out the '
        "last as a confidence, or store coordinates alone.",
        f"  - gt.npz has D = 4 coordinates; the last lies between {y[..., 3].min():.2g} and 1, as a confidence does; "
        'expected at most 3 of a position. Pass truth_axes="MKC" to leave out the last as a confidence, or store '
        "coordinates alone.",
    ]


def test_a_confidence_that_is_declared_is_left_out() -> None:
    x, y = (with_confidence(poses, np.ones((*poses.shape[:-1], 1))) for poses in (hypotheses(), truth()))
    data = PoseData(x.swapaxes(0, 1), y, axes="MNKC", truth_axes="MKC", joints=JOINTS, unit="mm")
    np.testing.assert_array_equal(data.truth, truth())
    np.testing.assert_array_equal(data.hypotheses.read(0, M), hypotheses())
    only = PoseData(x, truth(), axes="NMKC", joints=JOINTS, unit="mm")
    np.testing.assert_array_equal(only.hypotheses.read(2, 4), hypotheses()[:, 2:4])


def test_pixels_with_a_confidence_are_no_positions() -> None:
    random = np.random.default_rng(2)
    pixels = np.concatenate([random.uniform(0, 640, (9, 4, 2)), random.uniform(0, 1, (9, 4, 1))], axis=-1)
    assert "has D = 3 coordinates; the last lies between" in column_problem("gt", pixels, "truth_axes", "MKD")
    for poses in (pixels[..., :2], pixels * [1, 1, 300], pixels * [1, 1, 0], pixels / 640):
        assert column_problem("gt", poses, "truth_axes", "MKD") == ""


@pytest.mark.parametrize("declared", ["MKD", None])
def test_one_prediction_of_each_pose_is_one_hypothesis(declared: str | None) -> None:
    data = PoseData(hypotheses()[0], truth(), axes=declared, joints=JOINTS, unit="mm")
    assert data.shape == (1, M, K, 3)
    np.testing.assert_array_equal(data.hypotheses.read(1, 3), hypotheses()[:1, 1:3])
    right = np.linalg.norm(hypotheses()[0] - truth(), axis=-1).mean()
    assert posecal.evaluate(data)["mpjpe"] == pytest.approx(right, rel=1e-6)


def test_one_prediction_may_have_the_axes_of_its_own() -> None:
    data = PoseData(hypotheses()[0].transpose(0, 2, 1), truth(), axes="MDK", joints=JOINTS, unit="mm", truth_axes="MKD")
    np.testing.assert_array_equal(data.hypotheses.read(0, M)[0], hypotheses()[0])


def test_a_layout_without_coordinates_has_one_of_each_joint() -> None:
    values = np.arange(24.0).reshape(2, 3, 4)
    layout = Layout("NMK", "NMKD")
    assert layout.shape(values.shape) == (2, 3, 4, 1)
    np.testing.assert_array_equal(layout.read(MemoryArray(values), np.array([0, 2])), values[:, [0, 2], :, None])
    np.testing.assert_array_equal(layout.store(values[..., None]), values)


def test_clips_of_one_prediction_are_read_frame_by_frame() -> None:
    clips = np.arange(2 * 3 * 4 * 2.0).reshape(2, 3, 4, 2)
    layout = Layout("MTKD", "NMKD")
    assert layout.shape(clips.shape) == (1, 6, 4, 2)
    np.testing.assert_array_equal(layout.read(MemoryArray(clips), np.arange(6)), clips.reshape(1, 6, 4, 2))


@pytest.mark.parametrize(("third", "is_said"), [((0.2, 1.0), True), ((0.2, 0.8), False), ((-0.1, 1.0), False)])
def test_a_third_column_that_may_be_a_confidence_beside_metres_is_remarked_on(
    third: tuple[float, float], is_said: bool
) -> None:
    random = np.random.default_rng(0)
    truth = random.normal(0, 0.4, (30, 5, 3))
    truth[..., 2] = np.linspace(*third, 150).reshape(30, 5)
    data = posecal.PoseData(truth + random.normal(0, 0.05, (4, 30, 5, 3)), truth, unit="m")
    words = "truth: the third coordinate lies within 0 to 1 m in all poses, as a confidence"
    found = [remark for remark in data.remarks if remark.startswith(words)]
    assert len(found) == is_said
    assert all("truth_axes" in remark for remark in found)


def test_functions_of_arrays_refuse_some_true_poses_in_one_point() -> None:
    random = np.random.default_rng(0)
    truth = random.normal(0, 300, (30, 5, 3))
    hypotheses = truth + random.normal(0, 50, (4, 30, 5, 3))
    truth[[3, 8]] = 0
    with pytest.raises(PoseDataError, match=r"^truth: in 2 of 30 frames \(first: 3, 8\) all joints lie in one point"):
        posecal.metrics.min_mpjpe(hypotheses, truth)
