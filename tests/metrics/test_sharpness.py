"""Diversity and sharpness, against loops."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.engine.block import Block
from posecal.engine.finish import mean_over_joints
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from posecal.metrics import diversity, radius
from posecal.metrics.sharpness import predicted_spread, sharpness_metrics
from tests.helpers import oracles
from tests.helpers.random_worlds import Array, Mask, mostly, skewed

N, M, K = 6, 9, 5


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def where() -> Mask:
    """Some joints that count; in pose 4, none."""
    return mostly(M, K)


def over_joints(values: Array, where: Mask) -> Array:
    return np.array([oracles.mean(list(row[kept])) for row, kept in zip(values, where, strict=True)])


@pytest.mark.parametrize("population", [True, False])
@pytest.mark.parametrize("root", [None, 2])
def test_diversity_is_the_mean_standard_deviation(
    arrays: tuple[Array, Array], where: Mask, population: bool, root: int | None
) -> None:
    expected = oracles.deviations(oracles.relative(arrays[0], root), 0 if population else 1)
    found = diversity(*arrays, population=population, where=where, root=root)
    np.testing.assert_allclose(found, over_joints(expected, where))


@pytest.mark.parametrize("share", [0.01, 0.5, 1 / 3, 0.9, 1.0])
@pytest.mark.parametrize("n", [1, 2, 5, 6, 10])
def test_a_radius_holds_its_share_of_the_hypotheses(n: int, share: float) -> None:
    x, y = skewed(1, n, M, K)
    where = np.random.default_rng(n).random((M, K)) < 0.8
    found = radius(x, y, share=share, where=where)
    np.testing.assert_allclose(found, over_joints(oracles.radii(x, share), where), atol=1e-12)


def test_a_radius_counts_exactly_where_rounding_would_not() -> None:
    """0.07 · 100 is 7.000000000000001 in binary, and still seven hypotheses are enough."""
    distances = np.arange(1.0, 101.0)
    x = np.concatenate([-distances, distances])[::2].reshape(100, 1, 1, 1)
    rising = np.sort(np.abs(x.ravel() - np.median(x)))
    for share, place in ((0.07, 6), (0.07 + 4e-12, 6), (0.07 + 3e-11, 7)):  # whole to nine digits, and not
        np.testing.assert_allclose(radius(x, np.zeros((1, 1, 1)), share=share), rising[place])


def test_the_smallest_share_takes_the_nearest_hypothesis() -> None:
    x = np.array([0.0, 4.0, 5.0, 6.0, 9.0]).reshape(5, 1, 1, 1)
    np.testing.assert_allclose(radius(x, np.zeros((1, 1, 1)), share=1e-12), 0)
    np.testing.assert_allclose(radius(x[::2], np.zeros((1, 1, 1)), share=1e-12), 0)
    np.testing.assert_allclose(radius(x[[0, 4]], np.zeros((1, 1, 1)), share=1e-12), 4.5)


def test_spread_does_not_depend_on_the_truth(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    np.testing.assert_allclose(diversity(x, y), diversity(x, y[::-1]), rtol=1e-9)
    np.testing.assert_allclose(radius(x, y), radius(x, y[::-1]), rtol=1e-9)


def test_one_hypothesis_has_no_deviation_but_a_population_of_one_has_none_to_show() -> None:
    x, y = skewed(2, 1, M, K)
    assert np.isnan(diversity(x, y)).all()
    assert not diversity(x, y, population=True).any()
    assert not radius(x, y).any()


def test_equal_hypotheses_have_no_spread(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    same = np.repeat(x[:1], 4, axis=0)
    np.testing.assert_allclose(diversity(same, y), 0, atol=1e-12)
    np.testing.assert_allclose(radius(same, y, share=1), 0, atol=1e-12)


def test_a_pose_without_a_joint_that_counts_has_no_spread(arrays: tuple[Array, Array], where: Mask) -> None:
    for metric in (diversity, radius):
        assert np.flatnonzero(np.isnan(metric(*arrays, where=where))).tolist() == [4]


def test_single_precision_far_from_the_origin_keeps_its_deviation() -> None:
    x, y = (array.astype("f4") + np.float32(4000) for array in skewed(3, N, M, K))
    expected = oracles.deviations(x.astype("f8"), 1).mean(axis=1)
    # Near 4,096 mm a difference of two positions is rounded to 2**-12 mm, and so, at most, is a deviation.
    np.testing.assert_allclose(diversity(x, y), expected, atol=2**-12)


def test_the_predicted_spread_leaves_out_a_root_without_any(arrays: tuple[Array, Array], where: Mask) -> None:
    block = Block(*arrays, where, root=0)
    moving = where.copy()
    moving[:, 0] = False
    expected = over_joints(oracles.deviations(oracles.relative(arrays[0], 0), 1), moving)
    found = predicted_spread(block)
    kept = moving.any(axis=1)
    np.testing.assert_allclose(found[kept], expected[kept])
    assert np.isnan(found[4])


def test_hypotheses_that_agree_have_a_predicted_spread_of_nothing(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    x[:, 3] = y[3]
    found = predicted_spread(Block(x, y, root=0))
    assert found[3] == 0
    assert (np.delete(found, 3) > 0).all()


def test_a_mean_over_joints_passes_over_those_that_do_not_count() -> None:
    nan = np.nan
    np.testing.assert_allclose(mean_over_joints(np.array([[1, nan, 3], [nan, nan, nan]])), [2, nan])


@pytest.mark.parametrize(("deviation", "divisor"), [("sample", "n − 1"), ("population", "n")])
def test_diversity_says_what_it_divides_by(deviation: str, divisor: str) -> None:
    scope = Scope(Protocol(deviation=deviation), DataSpec(4, ("a", "b"), root=None))  # type: ignore[arg-type]
    metric = {metric.name: metric for metric in sharpness_metrics(scope)}["diversity"]
    assert metric.brief.endswith(f"({divisor})")
    assert f"N=4 hypotheses ({divisor}), " in metric.definition


@pytest.mark.parametrize("share", [0, -0.5, 1.01, float("nan")])
def test_a_share_is_above_nothing_and_at_most_all(arrays: tuple[Array, Array], share: float) -> None:
    with pytest.raises(PoseDataError, match=r"share: .*; expected above 0 and at most 1\."):
        radius(*arrays, share=share)
