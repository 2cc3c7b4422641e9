"""PCK, AUC and CPS, against loops over hypotheses, joints and thresholds."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.engine.block import Block
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from posecal.metrics import auc, cps, pck
from posecal.metrics.cps import cps_area, cps_curve, pose_score
from posecal.metrics.pck import Area, auc_share, correct_joints, correct_share, pck_curve
from posecal.metrics.selection import SELECTIONS, Selection, joint_score, least_of_each_rank
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 4, 9, 5


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def where() -> Mask:
    """Some joints that count; in pose 4, none."""
    return mostly(M, K)


def lattice(seed: int) -> tuple[Array, Array]:
    """Poses whose errors are whole multiples of 25 mm, so that many lie at a threshold."""
    random = np.random.default_rng(seed)
    x = np.zeros((N, M, K, 3))
    x[..., 1] = 25 * random.integers(0, 14, (N, M, K))
    return x, np.zeros((M, K, 3))


# --- scores of one error ---------------------------------------------------------------------------------------------


THRESHOLDS = [5.0 * i for i in range(31)]


@given(st.floats(0, 400, allow_subnormal=False))
def test_auc_of_an_error_is_the_share_of_thresholds_above_it(error: float) -> None:
    strict, loose = (auc_share(np.array(error), strict=flag) for flag in (True, False))
    np.testing.assert_allclose(strict, sum(error < t for t in THRESHOLDS) / 31)
    np.testing.assert_allclose(loose, sum(error <= t for t in THRESHOLDS) / 31)


@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_auc_is_right_at_its_thresholds_and_next_to_them(dtype: str) -> None:
    at = np.array(THRESHOLDS[1:], dtype=dtype)
    for errors in (at, np.nextafter(at, at - 1), np.nextafter(at, at + 1)):
        strict = [sum(float(e) < t for t in THRESHOLDS) / 31 for e in errors]
        loose = [sum(float(e) <= t for t in THRESHOLDS) / 31 for e in errors]
        np.testing.assert_allclose(auc_share(errors), strict, rtol=1e-6)
        np.testing.assert_allclose(auc_share(errors, strict=False), loose, rtol=1e-6)


@given(st.floats(0, 400, allow_subnormal=False))
def test_exact_auc_is_the_area_left_of_150_mm(error: float) -> None:
    np.testing.assert_allclose(auc_share(np.array(error), area="integral"), max(0, 150 - error) / 150)


def test_scores_are_nothing_at_infinity() -> None:
    for area in get_args(Area):
        for strict in (False, True):
            assert auc_share(np.array(np.inf), area=area, strict=strict) == 0
    assert cps_area(np.array(np.inf)) == 0
    assert correct_share(np.array(np.inf), 150.0, strict=False) == 0


def test_the_largest_auc_is_30_of_31_thresholds() -> None:
    y = np.zeros((1, 2, 3))
    assert auc(y[None], y) == pytest.approx(30 / 31)
    assert auc(y[None], y, strict=False) == 1
    assert auc(y[None], y, area="integral") == 1


# --- of poses --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("threshold", [150.0, 75.0, 1e-3])
@pytest.mark.parametrize("select", SELECTIONS)
def test_pck_is_the_loop(select: Selection, threshold: float, strict: bool, where: Mask) -> None:
    for x, y in (skewed(1, N, M, K), lattice(1)):
        link = oracles.links(oracles.pose_errors(x, y, where))
        expected = oracles.pck(oracles.joint_errors(x, y), where, threshold, select, link, strict=strict)
        found = pck(x, y, threshold=threshold, select=select, strict=strict, where=where)
        np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("select", SELECTIONS)
def test_auc_is_the_loop_over_thresholds(select: Selection, strict: bool, where: Mask) -> None:
    for x, y in (skewed(2, N, M, K), lattice(2)):
        link = oracles.links(oracles.pose_errors(x, y, where))
        expected = oracles.auc(oracles.joint_errors(x, y), where, select, link, strict=strict)
        np.testing.assert_allclose(auc(x, y, select=select, strict=strict, where=where), expected)


@pytest.mark.parametrize("select", SELECTIONS)
def test_exact_auc_is_the_area_under_the_staircase(select: Selection, where: Mask) -> None:
    x, y = skewed(3, N, M, K)
    link = oracles.links(oracles.pose_errors(x, y, where))
    expected = oracles.auc_integral(oracles.joint_errors(x, y), where, select, link)
    np.testing.assert_allclose(auc(x, y, area="integral", select=select, where=where), expected)


def test_a_root_is_subtracted_and_counts(arrays: tuple[Array, Array]) -> None:
    x, y = (oracles.relative(array, 1) for array in arrays)
    for metric in (pck, auc, cps):
        np.testing.assert_allclose(metric(*arrays, root=1), metric(x, y))
    assert (pck(*arrays, root=1, threshold=1e-6) >= 1 / K).all()


def test_pck_and_auc_take_the_best_hypothesis_of_each_threshold() -> None:
    """Hypothesis 0 has joints at 10 and 200 mm, hypothesis 1 two at 100: up to 100 mm the first is better."""
    y = np.zeros((1, 2, 3))
    x = np.zeros((2, 1, 2, 3))
    x[0, 0, :, 0], x[1, 0, :, 0] = [10, 200], [100, 100]
    # 31 thresholds: none right to 10, one of two joints at 15 … 100 (18), both at 105 … 150 (10)
    np.testing.assert_allclose(auc(x, y), (18 / 2 + 10) / 31)
    np.testing.assert_allclose(pck(x, y, threshold=50), 0.5)
    np.testing.assert_allclose(pck(x, y, threshold=150), 1)


@pytest.mark.parametrize("K", [*range(1, 20), 31, 32, 33, 40, 41, 60])
def test_errors_are_put_in_order_however_many_joints_there_are(K: int) -> None:
    errors = np.random.default_rng(K).permutation(K * 8 * 30).reshape(K, 8, 30) % 97.0
    errors[-1, 2] = np.inf
    expected = np.sort(errors, axis=0).min(axis=-1)
    np.testing.assert_array_equal(least_of_each_rank(errors), expected)


def test_a_joint_at_the_threshold_is_wrong_unless_it_is_asked_for() -> None:
    block = Block(np.array([0.0, 90.0]).reshape(1, 1, 2, 1), np.zeros((1, 2, 1)))
    assert correct_joints(block, 90.0).tolist() == correct_joints(block, 90.0, strict=True).tolist() == [0.5]
    assert correct_joints(block, 90.0, strict=False).tolist() == [1]
    assert correct_share(np.array([0.0, 90.0]), 90.0).tolist() == [1, 0]


def test_a_pose_without_a_joint_that_counts_has_no_share(arrays: tuple[Array, Array], where: Mask) -> None:
    for metric in (pck, auc, cps):
        for select in SELECTIONS:
            found = metric(*arrays, select=select, where=where)
            assert np.flatnonzero(np.isnan(found)).tolist() == [4]


# --- parts that the registry uses ------------------------------------------------------------------------------------


JOINTS, BODY = np.array([True, False, True, True, False]), np.array([True, True, True, True, False])


@pytest.mark.parametrize("select", SELECTIONS)
def test_some_joints_are_scored_while_the_body_is_aligned_and_links(
    arrays: tuple[Array, Array], where: Mask, select: Selection
) -> None:
    x, y = arrays
    w, body = where & JOINTS, where & BODY
    link = oracles.links(oracles.pose_errors(x, y, body))
    d, moved = oracles.joint_errors(x, y), oracles.joint_errors(oracles.aligned(x, y, body, "rigid"), y)
    block = Block(x, y, where)
    np.testing.assert_allclose(correct_joints(block, 90.0, select, JOINTS, BODY), oracles.pck(d, w, 90, select, link))
    shares = joint_score(block, auc_share, select, "rigid", JOINTS, BODY)
    np.testing.assert_allclose(shares, oracles.auc(moved, w, select, link))
    areas = pose_score(block, cps_area, select, "rigid", JOINTS, BODY)
    np.testing.assert_allclose(areas, oracles.cps(moved, w, select, link))


def test_two_sets_of_joints_do_not_share_a_result(arrays: tuple[Array, Array]) -> None:
    block = Block(*arrays)
    for joints in (JOINTS, BODY, None):
        fresh = joint_score(Block(*arrays), auc_share, "own", "none", joints)
        np.testing.assert_allclose(joint_score(block, auc_share, "own", "none", joints), fresh)


@pytest.mark.parametrize("select", SELECTIONS)
def test_a_score_may_add_thresholds_as_a_last_axis(arrays: tuple[Array, Array], where: Mask, select: Selection) -> None:
    x, y = arrays
    thresholds = np.array([40.0, 90.0, 250.0])
    link = oracles.links(oracles.pose_errors(x, y, where))
    d, block = oracles.joint_errors(x, y), Block(x, y, where)

    def reached(errors: Array) -> Array:
        return correct_share(errors[..., None], thresholds)

    joints, poses = joint_score(block, reached, select), pose_score(block, reached, select)
    for place, t in enumerate(thresholds):
        np.testing.assert_allclose(joints[:, place], oracles.pck(d, where, t, select, link))
        np.testing.assert_allclose(poses[:, place], oracles.complete(d, where, t, select, link))


@pytest.mark.parametrize("rule", ["<", "<="])
@pytest.mark.parametrize("select", SELECTIONS)
def test_the_curves_are_the_loops_at_each_threshold(select: Selection, rule: Literal["<", "<="]) -> None:
    """CPS's threshold is never right; errors are at the thresholds 50, 100, ... mm."""
    x, y = lattice(5)
    options = {"pck_joints": "all", "pck_best": select, "cps_best": select, "cps_align": "none", "pck_rule": rule}
    scope = Scope(Protocol(**options), DataSpec(N, tuple("abcde"), root=None))  # type: ignore[arg-type]
    w, d = np.ones((M, K), dtype=bool), oracles.joint_errors(x, y)
    link = oracles.links(oracles.pose_errors(x, y, w))
    joints, poses = (curve.statistic.compute(Block(x, y)) for curve in (pck_curve(scope), cps_curve(scope)))
    assert pck_curve(scope).at.tolist() == cps_curve(scope).at.tolist() == [10 * i for i in range(31)]
    assert f"‖x − y‖ {rule} τ, " in pck_curve(scope).definition
    for place, t in enumerate(range(0, 301, 10)):
        share = oracles.pck(d, w, t, select, link, strict=rule == "<")
        np.testing.assert_allclose(joints[:, place], share, atol=1e-12)
        np.testing.assert_allclose(poses[:, place], oracles.complete(d, w, t, select, link), atol=1e-12)


# --- words -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("metric", [pck, auc, cps])
def test_an_unknown_selection_is_refused(arrays: tuple[Array, Array], metric: object) -> None:
    with pytest.raises(PoseDataError, match=r"select: 'link' is not known\. Did you mean linked\?"):
        metric(*arrays, select="link")  # type: ignore[operator]


@pytest.mark.parametrize("threshold", [0, -1, float("inf"), float("nan")])
def test_a_threshold_is_a_length(arrays: tuple[Array, Array], threshold: float) -> None:
    with pytest.raises(PoseDataError, match=r"threshold: .*; expected a length above 0\."):
        pck(*arrays, threshold=threshold)
