"""Several modes are found where there are several, and seldom where there is one."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.calibration import joint_modes
from posecal.calibration.modes import LEAST, LEAST_WEIGHTED, Modes, centres_of_modes, chance_limit, split_modes
from posecal.calibration.modes import two_modes as along_one_axis
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from tests.helpers.flips import depth_flips
from tests.helpers.laws import UNIMODAL, two_modes

Array = np.ndarray


def naive(points: Array) -> tuple[bool, Array, float]:
    """Modes of N points (N, D), as the module's text says."""
    N = len(points)
    centred = points - points.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    along = centred @ axis
    order, best, cut = np.argsort(along), -1.0, 0
    for first in range(1, N):
        if min(first, N - first) < max(2, 0.15 * N):
            continue
        low, high = along[order[:first]], along[order[first:]]
        between = (first * (low.mean() ** 2) + (N - first) * high.mean() ** 2) / N
        if between > best:
            best, cut = between, first
    low, high = along[order[:cut]].mean(), along[order[cut:]].mean()
    width = (high - low) / 3
    middle, *sides = (int((np.abs(along - at) < width / 2).sum()) for at in ((low + high) / 2, low, high))
    second = np.zeros(N, dtype=bool)
    second[order[cut:]] = True
    several = best > 0.8 * (along**2).mean() and 3 * middle <= min(sides) and min(sides) > 0
    return several, second, high - low


def test_modes_are_those_that_the_text_defines() -> None:
    random = np.random.default_rng(0)
    x = random.normal(0, 1, (30, 3, 3, 12)) + two_modes(random, 90, 12, 4.5).reshape(30, 3, 3, 12)
    groups = split_modes(x)
    assert 0.2 < groups.several.mean() < 0.9
    for pose, joint in np.ndindex(30, 3):
        several, second, apart = naive(x[pose, joint].T)
        assert groups.several[pose, joint] == several
        if several:
            same = np.array_equal(groups.second[pose, joint], second)
            assert same or np.array_equal(groups.second[pose, joint], ~second)  # the axis has no direction
            assert groups.apart[pose, joint] == pytest.approx(apart)
        else:
            assert not groups.second[pose, joint].any()
            assert np.isnan(groups.apart[pose, joint])


def test_two_clusters_are_told_apart_wherever_they_lie_and_whatever_the_unit() -> None:
    line = np.array([0.0, 1, 2, 3, 4, 100, 101, 102, 103, 104])  # centres 2 and 102
    x = np.stack([line, 0 * line, 0 * line])[None, None]
    groups = split_modes(x)
    assert groups.several.all()
    assert groups.apart[0, 0] == pytest.approx(100)
    assert sorted(groups.second[0, 0].tolist()) == [False] * 5 + [True] * 5
    assert len(set(groups.second[0, 0, :5].tolist())) == 1
    moved = split_modes(x / 1000 + 7)
    assert moved.several.all()
    assert moved.apart[0, 0] == pytest.approx(0.1)
    assert not split_modes(x[..., 1:]).several.any()  # nine hypotheses are too few
    assert not split_modes(np.zeros((2, 1, 3, 12))).several.any()


def test_the_centre_of_a_mode_is_the_median_of_its_members() -> None:
    line = np.array([0.0, 1, 2, 3, 9, 100, 101, 102, 103, 104, 109])
    x = np.stack([line, -line, 0 * line], axis=-1)[:, None, None].repeat(2, axis=2)  # (N, 1, 2, 3)
    block = Block(x, np.zeros((1, 2, 3)))
    centres = centres_of_modes(block, np.array([True, False]))
    np.testing.assert_array_equal(centres[0, 0, 0], [2] * 5 + [102.5] * 6)
    np.testing.assert_array_equal(centres[0, 0, 1], [-2] * 5 + [-102.5] * 6)
    np.testing.assert_array_equal(centres[0, 1, 0], [100] * 11)


def test_joints_with_depth_flips_are_named_with_their_share_and_distance() -> None:
    x, y = depth_flips(0, 40, 60, 4)
    x[:, :, 3] = np.random.default_rng(1).normal(0, 30, (40, 60, 3))
    x[:, :24, 1] = x[:1, :24, 1] + np.random.default_rng(2).normal(0, 5, (40, 24, 3))  # of one mode in 24 of 60 poses
    modes = joint_modes(x, y)
    assert modes.several.tolist() == [True, True, True, False]
    np.testing.assert_allclose(modes.share, [1, 0.6, 1, 0], atol=0.02)
    np.testing.assert_allclose(modes.apart[:3], 120, rtol=0.02)
    laid_out = joint_modes(np.moveaxis(x, 0, 1), y, axes="MNKD")
    np.testing.assert_array_equal(laid_out.share, modes.share)
    assert joint_modes(x, y, root=0).share[0] == 0  # relative to it, it does not move
    assert isinstance(modes, Modes)


def test_fewer_than_ten_hypotheses_are_refused() -> None:
    assert LEAST == 10
    with pytest.raises(PoseDataError, match=r"^hypotheses: N = 9; expected at least 10, to find modes"):
        joint_modes(np.zeros((9, 20, 2, 3)), np.zeros((20, 2, 3)))


def test_joints_that_do_not_count_have_no_share() -> None:
    x, y = depth_flips(0, 20, 30, 4)
    x[:, :, 2] = np.nan
    where = np.array([True, True, False, True]) & np.ones((30, 4), dtype=bool)
    where[:10, 1] = False
    modes = joint_modes(x, y, where=where)
    assert modes.several.tolist() == [True, True, False, True]
    assert np.isnan(modes.share[2])


@pytest.mark.parametrize("N", [10, 20, 50, 200])
@pytest.mark.parametrize("law", UNIMODAL)
def test_of_distributions_without_modes_the_share_stays_below_the_limit(law: str, N: int) -> None:
    x = UNIMODAL[law](np.random.default_rng(3), 600, N)
    share = split_modes(x[:, None]).several.mean()
    assert share < chance_limit(N) + 3 * np.sqrt(chance_limit(N) * (1 - chance_limit(N)) / 600)


@pytest.mark.parametrize("N", [10, 20, 50, 200])
def test_modes_six_deviations_apart_are_beyond_the_limit(N: int) -> None:
    x = two_modes(np.random.default_rng(4), 400, N, 6) + np.random.default_rng(5).normal(size=(400, 3, N))
    assert split_modes(x[:, None]).several.mean() > chance_limit(N) + 0.1


@pytest.mark.parametrize("N", [10, 23, 24, 47, 48, 100, 200])
@pytest.mark.parametrize("law", UNIMODAL)
def test_some_ordered_hypotheses_of_one_coordinate_show_modes_as_seldom(law: str, N: int) -> None:
    x = np.sort(UNIMODAL[law](np.random.default_rng(N), 600, N).reshape(600, 1, 3, N))
    quarter = (N - 1) // 4
    widest = (x[..., N - 1 - quarter] - x[..., quarter]).argmax(axis=-1)
    assert along_one_axis(x, widest).mean() < chance_limit(N)


@pytest.mark.parametrize("N", [10, 20, 50, 200])
def test_and_modes_eight_deviations_apart_on_the_coordinate_that_is_asked_for(N: int) -> None:
    random = np.random.default_rng(N)
    x = random.normal(size=(1, 300, 3, N))
    x[:, :, 2] += 8 * (np.arange(N) % 2)
    x.sort(axis=-1)
    assert along_one_axis(x, np.full((1, 300), 2)).mean() > 0.9
    assert along_one_axis(x, np.zeros((1, 300), dtype=int)).mean() < chance_limit(N)
    assert not along_one_axis(x[..., :9], np.full((1, 300), 2)).any()


def of_angles(x: Array) -> Array:
    """Whether rows of angles (R, N), degrees, have two modes, as a block finds it."""
    block = Block(x.T[:, :, None, None], np.zeros((len(x), 1, 1)), period=360.0)
    return along_one_axis(block.sorted, np.zeros((len(x), 1), dtype=int), period=block.period)[:, 0]


@pytest.mark.parametrize("N", [10, 20, 50, 200])
def test_angles_without_two_directions_show_modes_seldom_wherever_the_circle_is_cut(N: int) -> None:
    random = np.random.default_rng(N)
    about = random.uniform(-180, 180, (1000, 1))
    for concentration in (0.0, 0.5, 2.0, 10.0):
        directions = np.degrees(random.vonmises(0, concentration, (1000, N)))
        assert of_angles(about + directions).mean() < chance_limit(N)
    assert of_angles(about + random.uniform(-90, 90, (1000, N))).mean() < chance_limit(N)


@pytest.mark.parametrize("apart", [120, 180])  # of opposite directions no mean says where to cut
@pytest.mark.parametrize("N", [10, 20, 50, 200])
def test_two_directions_are_found_also_where_they_are_opposite(N: int, apart: int) -> None:
    random = np.random.default_rng(N)
    second = random.random((1000, N)) < 0.5
    x = random.uniform(-180, 180, (1000, 1)) + apart * second + random.normal(0, 15, (1000, N))
    assert of_angles(x).mean() > 0.9


def of_weighted(x: Array, weights: Array) -> Array:
    return along_one_axis(x[:, None, None], np.zeros((len(x), 1), dtype=int), weights)[:, 0]


@pytest.mark.parametrize(("N", "concentration"), [(30, 5.0), (60, 1.0), (200, 0.3), (200, 0.12)])
def test_weighted_hypotheses_have_modes_where_their_weights_do(N: int, concentration: float) -> None:
    random = np.random.default_rng(N)
    weights = random.dirichlet(np.full(N, concentration), 1000)
    few = 1 / (weights**2).sum(axis=1) < LEAST_WEIGHTED
    for one in (random.normal(size=(1000, N)), random.uniform(-3, 3, (1000, N))):
        assert of_weighted(one, weights).mean() < chance_limit(LEAST_WEIGHTED) / 2
    both = random.normal(size=(1000, N)) + 8 * (random.random((1000, N)) < 0.5)
    assert of_weighted(both, weights)[~few].mean() > 0.95
    assert not of_weighted(both, weights)[few].any()


def test_hypotheses_of_small_weight_are_no_mode() -> None:
    x = np.concatenate([np.random.default_rng(0).normal(size=(100, 50)), np.full((100, 50), 20.0)], axis=1)
    x[:, 50:] += np.random.default_rng(1).normal(size=(100, 50))
    weights = np.repeat([[0.0195] * 50 + [0.0005] * 50], 100, axis=0)
    assert not of_weighted(x, weights).any()
    assert of_weighted(x, np.full((100, 100), 0.01)).all()


def test_copies_of_few_draws_are_no_modes() -> None:
    random = np.random.default_rng(0)
    drawn = random.normal(size=(2000, 1, 1, 10))
    axis = np.zeros((2000, 1), dtype=int)
    assert along_one_axis(np.sort(drawn), axis).mean() > chance_limit(200)  # as often as of ten, not of 200
    assert not along_one_axis(np.sort(np.repeat(drawn, 20, axis=-1)), axis).any()
    apart = np.sort(np.repeat(random.normal(size=(100, 1, 1, 20)) + 20 * (np.arange(20) % 2), 2, axis=-1))
    assert along_one_axis(apart, axis[:100]).mean() > 0.9  # half of them are
