"""Calibration curves: means of the weights, and their summaries over joints."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.calibration import DEFINITIONS, LEVELS, CalibrationCurve, Definition, calibration_curve
from posecal.calibration.curve import MANY, inside_table, joint_median
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from tests.helpers import calibration_oracles, oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 6, 17, 4


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def where() -> Mask:
    """Some joints that count; of pose 4 none, and joint 3 never."""
    mask = mostly(M, K)
    mask[:, 3] = False
    return mask


@pytest.mark.parametrize("root", [None, 1, -3])
@pytest.mark.parametrize("definition", DEFINITIONS)
def test_curves_are_means_over_the_poses_in_which_a_joint_counts(
    arrays: tuple[Array, Array], where: Mask, definition: Definition, root: int | None
) -> None:
    x, y = (oracles.relative(array, None if root is None else 1) for array in arrays)
    w = where if root is None else oracles.relative_mask(where, 1) & (np.arange(K) != 1)
    weights = calibration_oracles.inside(x, y, w, definition)
    found = calibration_curve(*arrays, definition=definition, where=where, root=root)
    assert found.definition == definition
    np.testing.assert_allclose(found.joints, calibration_oracles.curves(weights), atol=1e-12)
    np.testing.assert_allclose(found.pooled, calibration_oracles.pooled_curve(weights), atol=1e-12)
    np.testing.assert_allclose(
        found.median, calibration_oracles.over_joints(found.joints, found.pooled, "median"), atol=1e-12
    )


def test_a_pooled_curve_weights_each_pose_alike() -> None:
    """Pose 0 has three joints inside, pose 1 one joint outside: the joints do not weigh the same."""
    x = np.array([-1.0, 1.0, -2.0, 2.0]).reshape(4, 1, 1, 1) * np.ones((4, 2, 3, 1))
    y = np.zeros((2, 3, 1))
    y[1, 0] = 100
    where = np.array([[True, True, True], [True, False, False]])
    curve = calibration_curve(x, y, where=where, definition="paper")
    np.testing.assert_allclose(curve.pooled[10], 1 / 2)
    np.testing.assert_allclose(curve.joints[:, 10], [1 / 2, 1, 1])


def test_the_root_carries_no_information_and_is_left_out(arrays: tuple[Array, Array]) -> None:
    found = calibration_curve(*arrays, root=2).joints
    assert np.isnan(found[2]).all()
    assert not np.isnan(np.delete(found, 2, axis=0)).any()


def test_curves_do_not_depend_on_the_blocks(
    arrays: tuple[Array, Array], where: Mask, monkeypatch: pytest.MonkeyPatch
) -> None:
    entire = calibration_curve(*arrays, where=where)
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 1)
    np.testing.assert_array_equal(calibration_curve(*arrays, where=where).joints, entire.joints)


def test_of_one_hypothesis_nothing_is_known(arrays: tuple[Array, Array]) -> None:
    found = calibration_curve(arrays[0][:1], arrays[1])
    assert np.isnan(found.joints).all()
    assert np.isnan(found.pooled).all()
    assert np.isnan(found.median).all()


def test_without_a_joint_that_counts_nothing_is_known(arrays: tuple[Array, Array]) -> None:
    found = calibration_curve(*arrays, where=np.zeros((M, K), dtype=bool))
    assert np.isnan(found.median).all()
    assert np.isnan(found.pooled).all()


@pytest.mark.parametrize("K", [1, 2, 5])
def test_the_median_of_an_even_number_of_joints_lies_between_two(K: int) -> None:
    coverage = np.random.default_rng(K).random((K, 21))
    np.testing.assert_allclose(CalibrationCurve("paper", coverage, coverage[0]).median, np.median(coverage, axis=0))


@pytest.mark.parametrize("K", [MANY, MANY + 1, MANY + 30])
@pytest.mark.parametrize("missing", [0.0, 0.02, 0.5, 1.0])
def test_the_median_of_many_joints_is_numpy_s(K: int, missing: float) -> None:
    random = np.random.default_rng(K)
    curves = random.random((3, K, 21))
    gone = random.random((3, K)) < missing
    gone[0] = missing == 1
    curves[gone] = np.nan
    expected = [
        np.full(21, np.nan) if rows.all() else np.nanmedian(c, axis=0) for c, rows in zip(curves, gone, strict=True)
    ]
    np.testing.assert_allclose(joint_median(curves), expected, rtol=1e-15)


def test_joints_that_never_count_are_no_part_of_the_median() -> None:
    coverage = np.stack([LEVELS, np.full(21, np.nan), LEVELS**2])
    found = CalibrationCurve("paper", coverage, LEVELS)
    np.testing.assert_allclose(found.median, (LEVELS + LEVELS**2) / 2)
    np.testing.assert_array_equal(found.levels, LEVELS)


def test_a_table_has_a_row_per_joint_and_one_for_the_pose(arrays: tuple[Array, Array], where: Mask) -> None:
    joints = np.array([True, False, True, True])
    found = inside_table(Block(*arrays, where), "paper", joints)
    expected = calibration_oracles.inside(*arrays, where & joints, "paper")
    np.testing.assert_array_equal(found[:, :K], expected)
    for m in range(M):
        np.testing.assert_allclose(found[m, K], calibration_oracles.pooled_curve(expected[m : m + 1]))


def test_swapped_arguments_are_refused(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"The two look swapped\."):
        calibration_curve(arrays[1], arrays[0])


@pytest.mark.parametrize("root", [4, -5])
def test_a_root_beyond_the_joints_is_refused(arrays: tuple[Array, Array], root: int) -> None:
    with pytest.raises(PoseDataError, match=rf"root: {root}; expected the index of one of 4 joints"):
        calibration_curve(*arrays, root=root)
