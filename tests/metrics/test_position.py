"""Errors of the poses of a block, against the naive formulas."""

from __future__ import annotations

import numpy as np
import pytest

import posecal
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from posecal.geometry.procrustes import ALIGNMENTS, Alignment
from posecal.metrics.position import OfPoses, joint_errors, linked, pose_errors, pose_of, sorted_errors
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 6, 11, 5
OF_POSES = ("mean_pose", "median_pose", "mode")


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def where() -> Mask:
    """Some joints that count; in pose 4, none."""
    return mostly(M, K)


def test_a_weighted_pose_takes_the_scores_as_weights(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    scores = np.random.default_rng(2).gamma(1, 1, (N, M))
    found = pose_of(Block(x, y, scores=scores), "weighted_pose")
    assert found.shape == (M, K, 3, 1)
    np.testing.assert_allclose(found[..., 0] + y, oracles.one_pose(x, "weighted_pose", scores)[0])


@pytest.mark.parametrize("scores", [np.linspace(-1, 1, N), np.zeros(N)])
def test_a_weighted_pose_needs_weights(arrays: tuple[Array, Array], scores: Array) -> None:
    block = Block(*arrays, scores=np.tile(scores[:, None], (1, M)))
    with pytest.raises(PoseDataError, match=r"scores below 0, or all 0 for a pose; expected weights"):
        pose_of(block, "weighted_pose")


def test_the_mode_is_the_hypothesis_of_the_highest_score(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    scores = np.random.default_rng(2).gamma(1, 1, (N, M))
    found = pose_of(Block(x, y, scores=scores), "mode")
    np.testing.assert_allclose(found[..., 0] + y, oracles.one_pose(x, "mode", scores)[0])


def test_the_body_limits_both_the_fit_and_the_mean(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    body = np.array([True, True, False, True, True])
    block, w = Block(x, y), np.tile(body, (M, 1))
    moved = oracles.aligned(x, y, w, "similarity")
    np.testing.assert_allclose(
        joint_errors(block, "similarity", fit=body).transpose(2, 0, 1), oracles.joint_errors(moved, y), rtol=1e-9
    )
    np.testing.assert_allclose(
        pose_errors(block, "similarity", body=body).T, oracles.pose_errors(moved, y, w), rtol=1e-9
    )


@pytest.mark.parametrize("align", ALIGNMENTS)
@pytest.mark.parametrize("of", [None, *OF_POSES])
def test_joints_that_are_not_scored_take_part_in_the_fit(
    arrays: tuple[Array, Array], where: Mask, align: Alignment, of: OfPoses | None
) -> None:
    """Two occluded joints alone would fit anything."""
    x, y = arrays
    scored, body = where & (np.arange(K) > 2), np.array([True, False, True, True, True])
    block = Block(x, y, scored, usable=where)
    pose = x if of is None else oracles.one_pose(x, of, index=3)
    moved = oracles.aligned(pose, y, where & body, align)
    found = pose_errors(block, align, of, np.arange(K) != 3, 3, fit=body)
    np.testing.assert_allclose(
        found.T, oracles.pose_errors(moved, y, scored & (np.arange(K) != 3)), rtol=1e-9, atol=1e-6
    )


@pytest.mark.parametrize(("align", "joints", "least"), [("similarity", 2, 3), ("reflection", 2, 3), ("rigid", 1, 2)])
def test_an_alignment_of_too_few_joints_is_refused(align: Alignment, joints: int, least: int) -> None:
    x, y = np.ones((3, 4, joints, 3)), np.zeros((4, joints, 3))
    message = rf"^align: {align} of poses with {joints} joints, .* expected at least {least} joints, or none\.$"
    for metric in (posecal.metrics.mpjpe, posecal.metrics.min_mpjpe, posecal.metrics.cps):
        with pytest.raises(PoseDataError, match=message):
            metric(x, y, axes="NMKD", unit="mm", align=align)


def test_two_fits_do_not_share_a_result(arrays: tuple[Array, Array]) -> None:
    block, body = Block(*arrays), np.arange(K) > 0
    for fit in (np.arange(K) < 4, body, None):
        fresh = pose_errors(Block(*arrays), "similarity", body=body, fit=fit)
        np.testing.assert_array_equal(pose_errors(block, "similarity", body=body, fit=fit), fresh)


@pytest.mark.parametrize("align", ["none", "similarity"])
def test_two_masks_do_not_share_sorted_errors(arrays: tuple[Array, Array], align: Alignment) -> None:
    block = Block(*arrays)
    for body in (np.arange(K) < 3, np.arange(K) > 0):
        for fit in (np.arange(K) < 4, np.arange(K) > 0, None):
            expected = np.sort(pose_errors(Block(*arrays), align, body=body, fit=fit), axis=-1)
            np.testing.assert_array_equal(sorted_errors(block, align, body, fit), expected)


def test_two_bodies_do_not_share_a_result(arrays: tuple[Array, Array]) -> None:
    block = Block(*arrays)
    for body in (np.arange(K) < 3, np.arange(K) > 1, None):
        fresh = pose_errors(Block(*arrays), "rigid", body=body)
        np.testing.assert_allclose(pose_errors(block, "rigid", body=body), fresh)


def test_linked_takes_the_values_of_the_hypothesis_that_min_mpjpe_chooses(
    arrays: tuple[Array, Array], where: Mask
) -> None:
    block = Block(*arrays, where)
    values = np.random.default_rng(3).random((M, K, N))
    found = linked(block, values)
    links = oracles.links(oracles.pose_errors(*arrays, where))
    for m in range(M):
        np.testing.assert_allclose(found[m], values[m, :, links[m]])
