"""posecal's calibration curves on Gaussians, against closed-form curves.

Tolerances are computed: five binomial standard errors for the finite number of poses, and for the finite number of
hypotheses the first-order bend of :func:`toy.curves.coverage_of` with a quarter of it for the orders beyond.
"""

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posecal.calibration import LEVELS, calibration_curve
from toy import curves

INNER = slice(1, -1)
drawn = settings(derandomize=True, deadline=None)
seeds = st.integers(0, 2**32 - 1)
dimensions = st.integers(1, 6)
spreads = st.one_of(st.floats(0.3, 0.8), st.floats(1.25, 2.5))


curve_of = partial(calibration_curve, axes="NMKD")  # also where lengths drawn at random agree


def sampler(
    seed: int,
    *,
    N: int,
    M: int,
    K: int,
    D: int,
    spread: float = 1.0,
    offset: float = 0.0,
    truth_D: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Hypotheses N(μ, σ² I) and truths N(μ*, I) with σ = spread and ‖μ* − μ‖ = offset, about poses of any kind."""
    rng = np.random.default_rng(seed)
    centre = 300 * rng.standard_normal((M, K, D))
    direction = rng.standard_normal((M, K, D))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    strays = rng.standard_normal((M, K, D))
    strays[..., D if truth_D is None else truth_D :] = 0
    return centre + spread * rng.standard_normal((N, M, K, D)), centre + offset * direction + strays


def error(expected: np.ndarray, draws: int) -> np.ndarray:
    """Standard error of a share of so many independent draws."""
    return np.sqrt(expected * (1 - expected) / draws)


@settings(drawn, max_examples=15)
@given(seed=seeds, N=st.integers(80, 200), K=st.integers(2, 7), D=dimensions, spread=spreads)
def test_a_wrong_spread_shows_its_closed_curve_and_ece(seed: int, N: int, K: int, D: int, spread: float) -> None:
    M = 300
    curve = curve_of(*sampler(seed, N=N, M=M, K=K, D=D, spread=spread))
    infinite, exact = curves.coverage(spread=spread, D=D), curves.coverage_of(N, spread=spread, D=D)
    beyond = 0.25 * np.abs(exact - infinite)
    tolerance = 5 * error(exact, M * K) + beyond
    np.testing.assert_array_less(np.abs(curve.joints.mean(axis=0) - exact)[INNER], tolerance[INNER] + 1e-12)
    # The median curve lies among the joints' curves, each with M poses.
    one = 5 * error(exact, M) + np.abs(exact - infinite) + beyond
    assert abs(curve.ece() - curves.ece(spread=spread, D=D)) < one.mean()


@settings(drawn, max_examples=10)
@given(seed=seeds, K=st.integers(2, 5), D=dimensions, offset=st.floats(0.5, 2.5))
def test_a_wrong_mean_shows_its_closed_curve(seed: int, K: int, D: int, offset: float) -> None:
    N, M = 200, 400
    measured = curve_of(*sampler(seed, N=N, M=M, K=K, D=D, offset=offset)).joints.mean(axis=0)
    exact = curves.coverage(offset=offset, D=D)
    # N hypotheses shift a level by at most a few ranks: the discreteness of one and the median's pull, below 4/N
    around = [curves.coverage(np.clip(LEVELS + shift, 0, 1), offset=offset, D=D) for shift in (-4 / N, 4 / N)]
    tolerance = 5 * error(exact, M * K) + np.maximum(exact - around[0], around[1] - exact)
    np.testing.assert_array_less(np.abs(measured - exact)[INNER], tolerance[INNER])


@settings(drawn, max_examples=10)
@given(seed=seeds, D=st.integers(2, 5), data=st.data())
def test_a_truth_in_fewer_dimensions_shows_its_closed_curve(seed: int, D: int, data: st.DataObject) -> None:
    N, M, K = 200, 400, 4
    truth_D = data.draw(st.integers(1, D - 1))
    measured = curve_of(*sampler(seed, N=N, M=M, K=K, D=D, truth_D=truth_D)).joints.mean(axis=0)
    exact = curves.coverage(D=D, truth_D=truth_D)
    around = [curves.coverage(np.clip(LEVELS + shift, 0, 1), D=D, truth_D=truth_D) for shift in (-4 / N, 4 / N)]
    tolerance = 5 * error(exact, M * K) + np.maximum(exact - around[0], around[1] - exact)
    np.testing.assert_array_less(np.abs(measured - exact)[INNER], tolerance[INNER])


@pytest.mark.slow
@settings(drawn, max_examples=25)
@given(
    seed=seeds,
    N=st.integers(2, 30),
    D=dimensions,
    law=st.sampled_from(["normal", "skewed", "discrete", "correlated"]),
)
def test_exchangeable_ranks_are_uniform_for_every_number_of_hypotheses(seed: int, N: int, D: int, law: str) -> None:
    rng = np.random.default_rng(seed)
    M, K = 1500, 3
    pool = rng.standard_normal((N + 1, M, K, D))
    if law == "skewed":
        pool = np.exp(pool)
    elif law == "discrete":
        pool = np.round(pool)
    elif law == "correlated":
        pool += 2 * rng.standard_normal((1, M, K, D)) + 0.5 * pool[:, :, :1]
    pool += 100 * np.arange(K)[:, None]  # joints of one place, as whole numbers give now and then, are no pose
    which = rng.integers(N + 1, size=M)  # any of the pooled points may be the truth
    truth = pool[which, np.arange(M)]
    hypotheses = np.stack([np.delete(pool[:, m], which[m], axis=0) for m in range(M)], axis=1)
    measured = curve_of(hypotheses, truth).pooled
    # The joints of a pose may go together, so only poses count; a weight varies no more than q(1 − q).
    np.testing.assert_array_less(np.abs(measured - LEVELS)[INNER], 5 * error(LEVELS, M)[INNER])


@pytest.mark.parametrize("N", [2, *(pytest.param(N, marks=pytest.mark.slow) for N in (3, 5, 10, 20))])
def test_exchangeable_ranks_of_few_hypotheses_are_uniform_to_a_tenth_of_a_rank(N: int) -> None:
    M, K = 60_000, 4
    measured = curve_of(*sampler(N, N=N, M=M, K=K, D=3)).joints.mean(axis=0)
    tolerance = 4.5 * error(LEVELS, M * K)
    assert tolerance.max() < 0.1 / (N + 1)
    np.testing.assert_array_less(np.abs(measured - LEVELS)[INNER], tolerance[INNER])


@settings(drawn, max_examples=10)
@given(seed=seeds, D=dimensions, N=st.integers(40, 120), narrow=st.floats(0.3, 0.75))
def test_overconfident_curves_lie_below_the_diagonal_everywhere(seed: int, D: int, N: int, narrow: float) -> None:
    measured = curve_of(*sampler(seed, N=N, M=1500, K=4, D=D, spread=narrow)).joints.mean(axis=0)
    assert (measured[INNER] < LEVELS[INNER]).all()


@pytest.mark.slow
@settings(drawn, max_examples=10)
@given(seed=seeds, D=dimensions, N=st.integers(40, 120), wide=st.floats(1.35, 3))
def test_underconfident_curves_lie_above_the_diagonal_everywhere(seed: int, D: int, N: int, wide: float) -> None:
    measured = curve_of(*sampler(seed, N=N, M=1500, K=4, D=D, spread=wide)).joints.mean(axis=0)
    assert (measured[INNER] > LEVELS[INNER]).all()


@pytest.mark.parametrize(
    "definition", ["exchangeable", *(pytest.param(name, marks=pytest.mark.slow) for name in ("paper", "reference"))]
)
def test_all_definitions_show_the_closed_curve_when_there_are_many_hypotheses(definition: str) -> None:
    N, M, K = 700, 800, 6
    hypotheses, truth = sampler(5, N=N, M=M, K=K, D=3, spread=0.7)
    curve = curve_of(hypotheses, truth, definition=definition)  # type: ignore[arg-type]
    measured, exact = curve.joints.mean(axis=0), curves.coverage(spread=0.7)
    # A rank more or less, half a level's rounding and the median's pull: below 3/N of a level
    around = [curves.coverage(np.clip(LEVELS + shift, 0, 1), spread=0.7) for shift in (-3 / N, 3 / N)]
    tolerance = 4.5 * error(exact, M * K) + np.maximum(exact - around[0], around[1] - exact)
    np.testing.assert_array_less(np.abs(measured - exact)[INNER], tolerance[INNER])


class TestLaws:
    """What leaves a curve as it is; ``spread`` makes sure that it isn't the diagonal."""

    @settings(drawn, max_examples=10)
    @given(seed=seeds, N=st.integers(3, 12), D=dimensions, power=st.integers(-12, 12))
    def test_a_common_scale_changes_nothing(self, seed: int, N: int, D: int, power: int) -> None:
        hypotheses, truth = sampler(seed, N=N, M=7, K=3, D=D, spread=0.6)
        scaled = curve_of(2.0**power * hypotheses, 2.0**power * truth)  # exact in floating point
        np.testing.assert_array_equal(scaled.joints, curve_of(hypotheses, truth).joints)

    @settings(drawn, max_examples=10)
    @given(seed=seeds, N=st.integers(3, 12), data=st.data())
    def test_turning_by_right_angles_and_mirroring_change_nothing(self, seed: int, N: int, data: st.DataObject) -> None:
        hypotheses, truth = sampler(seed, N=N, M=7, K=3, D=3, spread=0.6)
        axes = data.draw(st.permutations(range(3)))
        signs = np.array(data.draw(st.tuples(*[st.sampled_from([-1.0, 1.0])] * 3)))
        turned = curve_of(signs * hypotheses[..., axes], signs * truth[..., axes])
        np.testing.assert_allclose(turned.joints, curve_of(hypotheses, truth).joints, atol=1e-12)

    def test_any_other_rotation_leaves_the_law_of_the_curve(self) -> None:
        # The median of each coordinate does not turn with the points, so single ranks may change. Turned isotropic
        # Gaussians are isotropic Gaussians: the same closed curve.
        N, M, K = 150, 800, 4
        hypotheses, truth = sampler(8, N=N, M=M, K=K, D=3, spread=0.6)
        turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
        plain, turned = curve_of(hypotheses, truth), curve_of(hypotheses @ turn, truth @ turn)
        assert not np.array_equal(plain.joints, turned.joints)
        exact = curves.coverage_of(N, spread=0.6)
        bend = 0.25 * np.abs(exact - curves.coverage(spread=0.6))
        for curve in (plain, turned):
            away = np.abs(curve.joints.mean(axis=0) - exact)
            np.testing.assert_array_less(away[INNER], (4.5 * error(exact, M * K) + bend)[INNER])

    @settings(drawn, max_examples=10)
    @given(seed=seeds, N=st.integers(3, 12), D=dimensions)
    def test_order_of_hypotheses_and_of_poses_changes_nothing(self, seed: int, N: int, D: int) -> None:
        hypotheses, truth = sampler(seed, N=N, M=7, K=3, D=D, spread=0.6)
        rng = np.random.default_rng(seed)
        poses = rng.permutation(7)
        shuffled = curve_of(hypotheses[rng.permutation(N)][:, poses], truth[poses])
        np.testing.assert_allclose(shuffled.joints, curve_of(hypotheses, truth).joints, atol=1e-12)

    @settings(drawn, max_examples=10)
    @given(seed=seeds, N=st.integers(3, 12), D=dimensions, joints=st.permutations(range(4)))
    def test_order_of_joints_orders_the_curves(self, seed: int, N: int, D: int, joints: list[int]) -> None:
        hypotheses, truth = sampler(seed, N=N, M=7, K=4, D=D, spread=0.6)
        plain = curve_of(hypotheses, truth)
        moved = curve_of(hypotheses[:, :, joints], truth[:, joints])
        np.testing.assert_array_equal(moved.joints, plain.joints[joints])
        assert math.isclose(moved.ece(), plain.ece())
