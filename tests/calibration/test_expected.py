"""Finite-N floors, against simulations of perfect samplers."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import ncx2

from posecal.calibration import (
    DEFINITIONS,
    LEVELS,
    OVER_JOINTS,
    Definition,
    OverJoints,
    calibration_curve,
    ece,
    expected_curve,
    perfect_sampler,
)
from posecal.calibration.expected import (
    FEW_POSES,
    FEWEST_DRAWS,
    MANY_JOINTS,
    MAX_VALUES,
    _bias,
    _floor,
    _table,
    ece_range,
)
from posecal.calibration.ranks import rank_weights
from posecal.errors import PoseDataError

Array = npt.NDArray[np.floating]

TABLE_DRAWS = 400_000
"""Sets of hypotheses behind each N of the table; see finite_n.json."""


# --- the bias at finite N --------------------------------------------------------------------------------------------


@cache
def simulated(N: int, definition: str) -> tuple[Array, Array]:
    """E ω(q) of a Gaussian sampler in 3D and its standard deviation over draws of the hypotheses.

    Given the hypotheses, the truth's squared distance from their centre follows scipy's noncentral χ² law, so only
    the hypotheses are drawn.
    """
    draws = min(40_000, 1_000_000 // N)
    x = np.random.default_rng([N, 9]).standard_normal((draws, N, 3))
    centre = np.median(x, axis=1) if definition == "paper" else np.sort(x, axis=1)[:, (N - 1) // 2]
    distances = np.sort(np.linalg.norm(x - centre[:, None], axis=-1), axis=1)
    if definition == "paper":
        # inside where at most ⌊q N⌋ hypotheses are as near: where the next one is farther than the truth
        allowed = np.array([i * N // 20 for i in range(21)])
        beyond = np.concatenate([distances, np.full((draws, 1), np.inf)], axis=1)
        radii = beyond[:, allowed]
    else:
        radii = np.quantile(distances, LEVELS, axis=1).T
    inside = np.where(np.isinf(radii), 1, ncx2.cdf(np.minimum(radii, 1e3) ** 2, 3, (centre**2).sum(axis=1)[:, None]))
    return inside.mean(axis=0), inside.std(axis=0) / np.sqrt(draws)


@pytest.mark.slow
@pytest.mark.parametrize("definition", ["paper", "reference"])
@pytest.mark.parametrize("N", [2, 3, 5, 10, 20, 40])
def test_the_expected_curve_is_the_simulated_one(N: int, definition: Definition) -> None:
    mean, error = simulated(N, definition)
    draws = min(40_000, 1_000_000 // N)
    # five standard errors of the simulation and of the table, which has six digits
    allowed = 5 * error * np.sqrt(1 + draws / TABLE_DRAWS) + 1e-6
    np.testing.assert_array_less(np.abs(expected_curve(N, definition) - mean), allowed)


@pytest.mark.slow
@pytest.mark.parametrize("definition", ["paper", "reference"])
@pytest.mark.parametrize("N", [21, 33, 50, 90, 200, 300])
def test_between_tabulated_n_and_ranks_the_curve_is_right_to_the_digits_that_are_printed(
    N: int, definition: Definition
) -> None:
    mean, error = simulated(N, definition)
    np.testing.assert_array_less(np.abs(expected_curve(N, definition) - mean), 5 * error + 5e-4)


@pytest.mark.parametrize("definition", ["paper", "reference"])
@pytest.mark.parametrize("N", [2000, 10**6])
def test_beyond_the_table_the_curve_nears_the_diagonal_by_one_over_n(N: int, definition: Definition) -> None:
    gap = np.abs(expected_curve(N, definition) - LEVELS)
    assert gap.max() < 3 / N
    assert gap.max() > 0.1 / N


@pytest.mark.parametrize(
    ("N", "paper", "reference"),
    [(5, 0.113, 0.152), (10, 0.052, 0.080), (20, 0.018, 0.042), (50, 0.0115, 0.0174), (200, 0.0018, 0.0043)],
)
def test_floors_for_endless_test_sets_are_the_known_ones(N: int, paper: float, reference: float) -> None:
    """Known from simulations to three digits (0.0005); a million ranks each would add 0.0005 at q = 1/2."""
    for definition, floor in (("paper", paper), ("reference", reference)):
        found = np.abs(expected_curve(N, definition) - LEVELS).mean()  # type: ignore[arg-type]
        np.testing.assert_allclose(found, floor, atol=0.0005 + 0.0005)


@pytest.mark.parametrize("definition", ["paper", "reference"])
@pytest.mark.parametrize("N", [5, 10, 20, 50])
def test_measured_curves_of_a_perfect_sampler_are_the_expected_ones(N: int, definition: Definition) -> None:
    random = np.random.default_rng([N, 3])
    M, K = 400_000 // N, 2
    y = random.standard_normal((M, K, 3))
    found = calibration_curve(random.standard_normal((N, M, K, 3)), y, definition=definition)
    expected = expected_curve(N, definition)
    allowed = 5 * np.sqrt(expected * (1 - expected) / M) + 1e-3 / N
    np.testing.assert_array_less(np.abs(found.joints - expected), np.broadcast_to(allowed, (K, 21)))


@pytest.mark.parametrize("definition", ["paper", "reference"])
def test_between_two_tabulated_n_the_bias_times_n_is_linear_in_one_over_n(definition: Definition) -> None:
    tabulated = sorted(_table()[definition])
    levels = np.linspace(0.1, 0.9, 9)
    for below, above in itertools.pairwise(tabulated[tabulated.index(5) :]):
        for N in range(below + 1, min(above, below + 4)):
            share = (1 / N - 1 / above) / (1 / below - 1 / above)
            expected = share * below * _bias(below, definition, levels)
            expected += (1 - share) * above * _bias(above, definition, levels)
            np.testing.assert_allclose(N * _bias(N, definition, levels), expected, rtol=1e-12)


def test_of_one_pose_and_joint_there_is_a_floor() -> None:
    assert perfect_sampler(2, 1, 1, draws=1).mean > 0


def test_the_exchangeable_curve_is_the_diagonal() -> None:
    for N in (2, 7, 1000):
        np.testing.assert_array_equal(expected_curve(N), LEVELS)


def test_an_expected_curve_may_be_changed_without_harm() -> None:
    expected_curve(7)[:] = 0
    expected_curve(7, "paper")[:] = 0
    assert expected_curve(7)[20] == 1
    assert expected_curve(7, "paper")[20] == 1
    assert LEVELS[20] == 1


@pytest.mark.parametrize("definition", ["paper", "reference"])
def test_expected_curves_rise_between_nothing_and_all(definition: Definition) -> None:
    for N in (*range(2, 130), 1000, 10**6):
        found = expected_curve(N, definition)
        assert (np.diff(found) >= 0).all()
        assert found[0] >= 0
        assert found[-1] <= 1


# --- the scatter at finite M -----------------------------------------------------------------------------------------


N, M, K, SETS = 10, 60, 5, 150


@cache
def simulated_eces(definition: Definition, over: OverJoints) -> Array:
    """ECE of test sets of a perfect sampler."""
    return np.array([curve.ece(over) for curve in simulated_curves(definition)])


@cache
def simulated_curves(definition: Definition) -> list:
    random = np.random.default_rng(11)
    shape = (SETS, M, K, 3)
    y, x = random.standard_normal(shape), random.standard_normal((N, *shape))
    return [calibration_curve(x[:, i], y[i], definition=definition) for i in range(SETS)]


@pytest.mark.parametrize("over", OVER_JOINTS)
@pytest.mark.parametrize("definition", DEFINITIONS)
def test_the_expected_ece_is_that_of_simulated_test_sets(definition: Definition, over: OverJoints) -> None:
    eces, floor = simulated_eces(definition, over), perfect_sampler(N, M, K, definition, over)
    error = eces.std() * np.sqrt(1 / SETS + 1 / 200)  # of the simulation here and of the 200 draws there
    np.testing.assert_allclose(floor.mean, eces.mean(), atol=5 * error)


@pytest.mark.parametrize("over", OVER_JOINTS)
@pytest.mark.parametrize("definition", DEFINITIONS)
def test_nineteen_of_twenty_test_sets_lie_below_the_quantile(definition: Definition, over: OverJoints) -> None:
    floor = perfect_sampler(N, M, K, definition, over)
    below = (simulated_eces(definition, over) <= floor.high).mean()
    error = np.sqrt(0.95 * 0.05 * (1 / SETS + 1 / 200))
    np.testing.assert_allclose(below, 0.95, atol=5 * error)


@pytest.mark.parametrize(("M", "floor", "digit"), [(200, 0.006, 1e-3), (2_000, 0.002, 1e-3), (20_000, 0.0006, 1e-4)])
def test_floors_of_sixteen_joints_are_the_known_ones(M: int, floor: float, digit: float) -> None:
    np.testing.assert_allclose(perfect_sampler(200, M, 16).mean, floor, atol=digit / 2)


def test_with_endless_poses_only_the_bias_is_left() -> None:
    for definition in ("paper", "reference"):
        bias = np.abs(expected_curve(20, definition) - LEVELS).mean()  # type: ignore[arg-type]
        found = perfect_sampler(20, 10**9, 16, definition)  # type: ignore[arg-type]
        np.testing.assert_allclose([found.mean, found.high], bias, atol=1e-4)
    assert perfect_sampler(20, 10**9, 16).mean < 1e-5


@pytest.mark.parametrize("M", [3, FEW_POSES])
@pytest.mark.parametrize(("joints", "drawn"), [(600, MAX_VALUES // (600 * 21)), (4000, FEWEST_DRAWS)])
def test_of_many_joints_fewer_test_sets_are_drawn_and_never_too_few(M: int, joints: int, drawn: int) -> None:
    found, fewer = (perfect_sampler(2, M, joints, "paper", "mean", draws=n) for n in (drawn, drawn - 1))
    assert perfect_sampler(2, M, joints, "paper", "mean") == found != fewer


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_of_many_joints_the_median_curve_is_drawn_by_itself(definition: Definition) -> None:
    """A median of as many joints as are drawn one by one has nearly the floor of one joint more."""
    one, other = (perfect_sampler(30, 2000, joints, definition) for joints in (MANY_JOINTS, MANY_JOINTS + 1))
    np.testing.assert_allclose((other.mean, other.high), (one.mean, one.high), rtol=0.06)
    assert one != other


@pytest.mark.parametrize("over", OVER_JOINTS)
def test_few_poses_have_the_floor_that_is_drawn_rank_by_rank(over: OverJoints) -> None:
    """Two poses whose curve is the mean of two weights: all pairs of ranks of N = 4 and one joint."""
    weights = rank_weights(4, np.arange(5))
    eces = [np.abs((one + other) / 2 - LEVELS).mean() for one in weights for other in weights]
    found = perfect_sampler(4, 2, 1, over=over)
    np.testing.assert_allclose(found.mean, np.mean(eces), atol=5 * np.std(eces) / np.sqrt(5000))
    assert min(abs(found.high - ece) for ece in eces) < 1e-6


# --- the range at finite N --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("definition", DEFINITIONS)
@pytest.mark.parametrize("N", [2, 3, 7, 19])
def test_no_hypotheses_have_an_ece_out_of_range(definition: Definition, N: int) -> None:
    random = np.random.default_rng(N)
    y, x = np.zeros((40, 1, 3)), random.normal(size=(N, 40, 1, 3))
    low, high = ece_range(N, definition)
    far, near, spread = (ece(x, y + 1e6, definition=definition), ece(x, y, definition=definition), x * [[[0.5]]])
    assert low <= near <= high
    assert low <= ece(spread, y, definition=definition) <= high
    assert far <= high + 1e-12
    if definition == "exchangeable":
        np.testing.assert_allclose(far, high, rtol=1e-9)


def test_the_nearest_curve_of_the_papers_definition_is_the_middle_of_each_step() -> None:
    """N = 2: ω is one number at q = 0 … 0.45, another at 0.5 … 0.95, and 1 at 1: twice 0.05 (1 + 3 + 5 + 7 + 9)."""
    np.testing.assert_allclose(ece_range(2, "paper"), [2 * 0.05 * 25 / 21, 0.5])


def test_the_floor_is_the_same_on_every_call() -> None:
    first = perfect_sampler(7, 40, 3, draws=20)
    _floor.cache_clear()
    assert perfect_sampler(7, 40, 3, draws=20) == first


# --- words -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("definition", DEFINITIONS)
@pytest.mark.parametrize("n", [1, 0, -3])
def test_calibration_needs_two_hypotheses(n: int, definition: Definition) -> None:
    with pytest.raises(PoseDataError, match=rf"n_hypotheses: {n}; expected a whole number of at least 2\."):
        expected_curve(n, definition)
    with pytest.raises(PoseDataError, match=rf"n_hypotheses: {n}; expected"):
        perfect_sampler(n, 10, 3, definition)


@pytest.mark.parametrize(("M", "K"), [(0, 3), (3, 0), (-1, 3)])
def test_a_floor_needs_poses_and_joints(M: int, K: int) -> None:
    with pytest.raises(PoseDataError, match=r"n_(poses|joints): .*; expected a whole number of at least 1\."):
        perfect_sampler(10, M, K)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(PoseDataError, match=r"definition: 'papers' is not known\. Did you mean paper\?"):
        expected_curve(10, "papers")  # type: ignore[arg-type]
    with pytest.raises(PoseDataError, match=r"over: 'meen' is not known\. Did you mean mean\?"):
        perfect_sampler(10, 10, 3, over="meen")  # type: ignore[arg-type]
