"""A wrong spread is fitted and undone, on data that it was not fitted on."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.calibration.ranks import LEVELS
from posecal.data.pose_data import PoseData
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError, for_python
from posecal.recalibration import (
    RadiusMap,
    SpreadMap,
    fit_radius,
    fit_spread,
    held_out_coverage,
    judge_spread,
)
from posecal.recalibration.dispersion import FACTORS, best_factors
from posecal.recalibration.spread_map import rescaled
from tests.helpers.random_worlds import skewed
from tests.helpers.samplers import gaussian, pairs_of, report_of, sequences
from tests.situations.people import JOINTS as PEOPLE_JOINTS
from tests.situations.people import about, people

Array = np.ndarray
FEW = Protocol(metrics="ece, signed_area, min_mpjpe")


# --- the spread -------------------------------------------------------------------------------------------------------


STRAY = math.pi / 2
"""Variance of the median of N Gaussian numbers, over that of one, times N."""


def scale_error(coordinates: int) -> float:
    """Bound of the standard error of the logarithm of a scale.

    The information of a coordinate is 2; a curve that is read at 21 levels wastes some, surely less than half.
    """
    return math.sqrt(1 / coordinates)


def median_error(spread: float, N: int) -> float:
    """Bound of how far the best factor is from 1 / spread because the median of N hypotheses is not their centre."""
    return 0.5 * abs(spread**2 - 1) * STRAY / N


@pytest.mark.slow
def test_a_spread_of_0_4_is_found_and_undone_to_2_percent() -> None:
    N, M, K = 100, 800, 8
    x, y = gaussian(1, N, M, K, spread=0.4, dtype="f4")
    assert 1.7 * scale_error(3 * M * K) + median_error(0.4, N) < 0.02
    found = fit_spread(pairs_of(x, y), threads=1)
    np.testing.assert_array_equal(found.factors, found.factors[0])
    np.testing.assert_allclose(0.4 * found.factors[0], 1, atol=0.02)
    assert (found.poses, found.sequences) == (M, 0)


def test_a_map_that_was_fitted_on_others_calibrates() -> None:
    map_ = fit_spread(pairs_of(*gaussian(1, 12, 300, 4, spread=0.4)), threads=1)
    pairs = pairs_of(*gaussian(2, 12, 200, 4, spread=0.4), labels={"sequence": sequences(200, 40)})
    assert report_of(pairs, "ece").test("ece").p <= 1e-3
    assert report_of(map_.rescale(pairs), "ece").test("ece").p > 0.01


def test_each_joint_has_a_factor_of_its_own_where_it_is_asked_for() -> None:
    N, M, spreads = 40, 300, np.array([0.4, 1.0, 2.0, 0.7])
    x, y = gaussian(3, N, M, 4, spread=spreads)
    found = fit_spread(pairs_of(x, y), per_joint=True, threads=1)
    for spread, factor in zip(spreads, found.factors, strict=True):
        assert abs(math.log(spread * factor)) < 4 * scale_error(3 * M) + median_error(spread, N)
    assert len(set(fit_spread(pairs_of(x[:, :30], y[:30]), threads=1).factors)) == 1


def test_a_factor_between_those_that_are_tried_is_read_off_a_parabola() -> None:
    """Curves whose distances from the diagonal are parabolas in the logarithm of the factor."""
    best = np.array([0.531, 1.0, 2.77])
    distance = np.abs(np.log(FACTORS[:, None] / best))
    sums = 7 * (LEVELS + distance[..., None])
    factors = best_factors(sums, np.array([7, 7, 7]), ("Hip", "Head", "LFoot"), per_joint=True)
    np.testing.assert_allclose(factors, best, rtol=1e-9)
    uncounted = best_factors(sums, np.array([7, 0, 7]), ("Hip", "Head", "LFoot"), per_joint=True)
    np.testing.assert_allclose(uncounted, [0.531, 1, 2.77], rtol=1e-9)
    together = best_factors(sums, np.array([7, 0, 7]), ("Hip", "Head", "LFoot"), per_joint=False)
    np.testing.assert_allclose(together, [math.sqrt(0.531 * 2.77), 1, math.sqrt(0.531 * 2.77)], rtol=1e-9)


@pytest.mark.parametrize("root", [None, 1])
def test_hypotheses_are_rescaled_about_their_median(root: int | None) -> None:
    x = skewed(6, 5, 4, 3)[0]
    factors = np.array([0.5, 1.0, 3.0])
    found = rescaled(x, factors, root)
    for m, k in np.ndindex(4, 3):
        origin = 0 if root is None else x[:, m, root]
        relative = x[:, m, k] - origin
        centre = np.median(relative, axis=0)
        np.testing.assert_allclose(found[:, m, k], centre + factors[k] * (relative - centre) + origin, rtol=1e-12)
    assert rescaled(x.astype("f4"), factors, root).dtype == np.float32


def test_a_map_finds_its_joints_by_name_and_says_which_it_lacks() -> None:
    x, y = skewed(7, 4, 3, 3)
    map_ = SpreadMap(("Head", "RKnee", "LFoot"), np.array([2.0, 3, 4]), 10, 2)
    read = map_.rescale(pairs_of(x, y, joints=["LFoot", "Head", "RKnee"])).hypotheses.read(1, 3)
    np.testing.assert_allclose(read, rescaled(x[:, 1:3], np.array([4.0, 2, 3])))
    with pytest.raises(PoseDataError, match=r"hypotheses has joints that the map lacks: LKnee\. Fit a map on these"):
        map_.rescale(pairs_of(x, y, joints=["LFoot", "Head", "LKnee"]))


def test_joints_that_do_not_count_keep_their_spread() -> None:
    x, y = gaussian(8, 9, 200, 3, spread=0.5)
    where = np.array([True, False, True]) & np.ones((200, 3), dtype=bool)
    x[:, :, 1] = np.nan
    found = fit_spread(pairs_of(x, y, where=where), per_joint=True, threads=1)
    assert found.factors[1] == 1
    assert (found.factors[[0, 2]] > 1.5).all()


def test_the_root_keeps_its_spread() -> None:
    x, y = gaussian(9, 9, 100, 3, spread=0.5)
    found = fit_spread(pairs_of(x, y, root_joint="0"), threads=1)
    assert found.factors[0] == 1
    assert found.factors[1] == found.factors[2] > 1.2


@pytest.mark.parametrize("spread", [0.0, 0.02], ids=["no spread", "far too narrow"])
def test_where_no_factor_calibrates_none_is_given(spread: float) -> None:
    x, y = gaussian(10, 6, 40, 2, spread=spread)
    with pytest.raises(PoseDataError, match=r"spread: no factor from 0\.1 to 10 calibrates all joints together\. Do"):
        fit_spread(pairs_of(x, y), threads=1)


def test_joints_that_no_factor_calibrates_are_named() -> None:
    x, y = gaussian(10, 6, 40, 4, spread=0.8)
    x[:, :, 1:3] = x[:1, :, 1:3]  # they agree on two joints
    joints = ["Hip", "Head", "LFoot", "RKnee"]
    with pytest.raises(PoseDataError, match=r"no factor from 0\.1 to 10 calibrates Head, LFoot\. Do the hypotheses"):
        fit_spread(pairs_of(x, y, joints=joints, root_joint="none"), per_joint=True, threads=1)


def test_one_hypothesis_has_no_spread_to_rescale() -> None:
    x, y = skewed(11, 1, 6, 2)
    for call in (fit_spread, judge_spread):
        with pytest.raises(PoseDataError, match=r"hypotheses: 1 hypothesis; recalibration needs at least 2"):
            call(pairs_of(x, y))
    assert fit_spread(pairs_of(*gaussian(11, 2, 200, 2))).factors.shape == (2,)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("fit", [fit_spread, judge_spread, fit_radius, held_out_coverage])
def test_coordinates_that_are_not_finite_are_refused_where_they_count(
    fit: Any, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 2000)  # ten poses
    x, y = skewed(12, 4, 60, 2)
    x[1, 42, 0, 1] = value
    words = r"^hypotheses has non-finite coordinates in 1 of 60 frames \(first: frame 42, joint 0\)\. Mask"
    with pytest.raises(PoseDataError, match=words):
        fit(pairs_of(x, y), threads=1)
    where = np.ones((60, 2), dtype=bool)
    where[42, 0] = False
    fit(pairs_of(x, y, where=where), threads=1)


# --- arrays -----------------------------------------------------------------------------------------------------------


def test_options_that_don_t_describe_data_are_refused_with_the_nearest() -> None:
    x, y = gaussian(24, 9, 20, 3)
    with pytest.raises(PoseDataError, match=r"^option: 'unti' is not known\. Did you mean unit\?$"):
        fit_spread(x, y, unti="mm")
    with pytest.raises(PoseDataError, match=r"^option: 'metrics' is not known\. Known: axes, "):
        judge_spread(x, y, metrics="ece")


def test_two_arrays_are_fitted_as_pose_data_are() -> None:
    x, y = gaussian(24, 9, 120, 3, spread=0.5)
    how: dict[str, Any] = {
        "axes": "NMKD",
        "unit": "mm",
        "joints": ["Head", "LFoot", "RKnee"],
        "labels": {"sequence": sequences(120, 6)},
    }
    data = PoseData(x, y, **how)
    np.testing.assert_array_equal(fit_spread(x, y, **how).factors, fit_spread(data).factors)
    assert (fit_spread(data).poses, fit_spread(data).sequences, fit_radius(data).sequences) == (120, 6, 6)
    assert fit_spread(data.replace(labels={})).sequences == 0
    np.testing.assert_array_equal(fit_radius(x, y, **how).radii, fit_radius(data).radii)
    np.testing.assert_array_equal(held_out_coverage(x, y, **how), held_out_coverage(data))
    assert judge_spread(x, y, folds=2, **how).after["ece"] == judge_spread(data, folds=2).after["ece"]
    with pytest.raises(PoseDataError, match=r"^truth: missing; expected true poses"):
        fit_spread(x)


def test_a_spread_map_rescales_arrays_of_any_unit() -> None:
    x = skewed(25, 5, 7, 3)[0]
    map_ = SpreadMap(("Hip", "Head", "LFoot"), np.array([1.0, 2, 0.5]), 10, 2, 0)
    np.testing.assert_array_equal(map_.apply(x), rescaled(x, map_.factors, 0))
    np.testing.assert_allclose(map_.apply(x / 1000), map_.apply(x) / 1000, rtol=1e-12)
    np.testing.assert_array_equal(map_.apply(x.tolist()), map_.apply(x))
    assert map_.apply(x.astype("f4")).dtype == map_.apply(x.astype("f2")).dtype == np.float32
    assert map_.apply(x.astype(int)).dtype == np.float64
    assert map_.by_joint == {"Hip": 1.0, "Head": 2.0, "LFoot": 0.5}


@pytest.mark.parametrize(
    ("axes", "laid_out"),
    [
        ("MNKD", lambda x: x.swapaxes(0, 1)),
        ("MKDN", lambda x: np.moveaxis(x, 0, -1)),
        ("MN(DK)", lambda x: x.transpose(1, 0, 3, 2).reshape(6, 5, 9)),
        ("MNTKD", lambda x: x.reshape(5, 2, 3, 3, 3).swapaxes(0, 1)),
        ("NTMKD", lambda x: x.reshape(5, 2, 3, 3, 3).swapaxes(1, 2)),
    ],
)
def test_maps_are_applied_to_arrays_of_any_layout(axes: str, laid_out: Callable[[Array], Array]) -> None:
    x = skewed(25, 5, 6, 3)[0]
    spread = SpreadMap(("Hip", "Head", "LFoot"), np.array([1.0, 2, 0.5]), 10, 2, 0)
    radius = RadiusMap(spread.joints, np.array([math.nan, 20.0, 50]), 0.1, True, 10, 2, 0)
    np.testing.assert_array_equal(spread.apply(laid_out(x), axes=axes), laid_out(spread.apply(x)))
    for laid, plain in zip(radius.apply(laid_out(x), axes=axes), radius.apply(x), strict=True):
        np.testing.assert_allclose(laid, plain, rtol=1e-12)


def test_of_a_sampler_s_iterations_the_last_is_rescaled() -> None:
    x = skewed(25, 5, 6, 3)[0]
    spread = SpreadMap(("Hip", "Head", "LFoot"), np.array([1.0, 2, 0.5]), 10, 2, 0)
    np.testing.assert_array_equal(spread.apply(np.stack([x + 9, x]), axes="INMKD"), spread.apply(x))


def test_a_layout_that_is_not_declared_is_refused_where_it_looks_like_another() -> None:
    x, y = skewed(25, 20, 6, 3)
    laid_out = x.swapaxes(0, 1)
    for map_ in (
        fit_spread(laid_out, y, axes="MNKD", unit="mm"),
        fit_radius(laid_out, y, axes="MNKD", unit="mm", alpha=0.5),
    ):
        with pytest.raises(PoseDataError, match=r"^hypotheses: \(6, 20, 3, 3\); .* 6 poses .* axes=\"MNKD\""):
            map_.apply(laid_out)
        map_.apply(laid_out, axes="MNKD"), map_.apply(laid_out, axes="NMKD"), map_.apply(x)
        with pytest.raises(PoseDataError, match=r"^axes: 'MND' lacks K"):
            map_.apply(laid_out, axes="MND")
        with pytest.raises(PoseDataError, match=r"^hypotheses: \(6, 20, 3, 3\); expected \(M, N, \(DK\)\)"):
            map_.apply(laid_out, axes="MN(DK)")


@pytest.mark.parametrize("scaled", [False, True])
def test_a_radius_map_gives_balls_of_arrays(scaled: bool) -> None:
    x = skewed(26, 5, 7, 3)[0]
    map_ = RadiusMap(("Hip", "Head", "LFoot"), np.array([math.nan, 20.0, 50]), 0.1, scaled, 10, 2, 0)
    centre, radius = map_.apply(x)
    relative = x - x[:, :, :1]
    np.testing.assert_allclose(centre, np.median(relative, axis=0), rtol=1e-12, atol=1e-12)
    widths = relative.std(axis=0, ddof=1).mean(axis=-1) if scaled else np.ones((7, 3))
    np.testing.assert_allclose(radius, map_.radii * widths, rtol=1e-9)
    assert map_.unit == ("standard deviations" if scaled else "mm")


@pytest.mark.parametrize(
    ("hypotheses", "words"),
    [
        (
            np.zeros((5, 7, 2, 3)),
            r"^hypotheses: \(5, 7, 2, 3\); expected \(N, M, K, D\) with the K = 3 joints of the map",
        ),
        (np.zeros((7, 3, 3)), r"^hypotheses: \(7, 3, 3\); expected"),
        (np.zeros((5, 0, 3, 3)), r"^hypotheses: \(5, 0, 3, 3\); expected"),
        ("hyps.npz", r"^hypotheses: str; expected real numbers"),
        ([[1.0], [2.0, 3.0]], r"^hypotheses: lists of unequal lengths"),
        (np.zeros((5, 7, 3, 3), dtype=complex), r"^hypotheses: dtype complex128; expected real numbers"),
    ],
)
def test_a_map_is_applied_to_hypotheses_with_its_joints_only(hypotheses: Any, words: str) -> None:
    joints = ("Hip", "Head", "LFoot")
    for map_ in (SpreadMap(joints, np.ones(3), 9, 3), RadiusMap(joints, np.ones(3), 0.1, False, 9, 3)):
        with pytest.raises(PoseDataError, match=words):
            map_.apply(hypotheses)


# --- remarks on the data ----------------------------------------------------------------------------------------------


def some_people(n: int = 8) -> tuple[Array, Array, dict[str, Any]]:
    random = np.random.default_rng(0)
    y = people(random, 40)
    return about(random, y, n), y, {"unit": "mm", "joints": PEOPLE_JOINTS}


@pytest.mark.parametrize("fit", [fit_spread, fit_radius])
def test_a_map_has_the_remarks_of_an_evaluation_of_its_data(fit: Any) -> None:
    x, y, described = some_people()
    assert fit(x, y, **described).data_remarks == ()
    empty = x.copy()
    empty[:, [3, 9]] = 0
    found = tuple(map(for_python, fit(empty, y, **described).data_remarks))
    assert found == posecal.evaluate(empty, y, metrics="mpjpe", **described).remarks[: len(found)]
    assert found[0].startswith("hypotheses: in 2 of 40 frames (first: 3, 9) every hypothesis is one point.")


def test_other_coordinate_frames_are_named() -> None:
    x, y, described = some_people()
    flipped = x * [1, -1, -1]
    (remark,) = fit_radius(flipped, y, **described).remarks
    assert remark.startswith("coordinate frames differ: negating y and z")
    with pytest.raises(
        PoseDataError, match=r"no factor .*together\. Coordinate frames differ: negating y and z in hyp"
    ):
        fit_spread(flipped, y, **described)


@pytest.mark.parametrize("fit", [fit_spread, fit_radius, judge_spread, held_out_coverage])
@pytest.mark.parametrize("kind", ["NaN in many frames", "NaN in one frame of many", "weight 0"])
def test_absent_hypotheses_are_refused_by_their_name(fit: Any, kind: str) -> None:
    x, y, described = some_people()
    lacking = [3]
    if kind == "NaN in many frames":
        lacking = [3, 20, 21]
    elif kind == "NaN in one frame of many":
        x, y, lacking = np.tile(x, (1, 20, 1, 1)), np.tile(y, (20, 1, 1)), [333]  # beyond the sample that is looked at
    if kind == "weight 0":
        scores = np.full((8, 40), 1 / 8)
        scores[:, 3] = [0.2] * 5 + [0] * 3
        described["scores"] = scores
    else:
        x[5:, lacking] = np.nan
    where = rf"in {len(lacking)} of {len(y)} frames \(first: {lacking[0]}"
    words = rf"^hypotheses: hypotheses are absent .* {where}.*n_hypotheses to take the first"
    with pytest.raises(PoseDataError, match=words):
        fit(x, y, **described)
    described.pop("scores", None)
    fit(x, y, n_hypotheses=5, **described)


def test_poses_of_which_the_root_does_not_count_are_left_out_as_by_an_evaluation() -> None:
    x, y, described = some_people()
    where = np.ones((40, 17), dtype=bool)
    where[7, 0] = False
    broken = y.copy()
    broken[7, 0] = 9000
    rest = np.delete(np.arange(40), 7)
    for fit, values in ((fit_spread, "factors"), (fit_radius, "radii")):
        found = fit(x, broken, where=where, **described)
        assert found.remarks[0].startswith("the root Hip does not count in 1 of 40 frames (first: 7)")
        assert found.poses == 39
        np.testing.assert_array_equal(getattr(found, values), getattr(fit(x[:, rest], y[rest], **described), values))
