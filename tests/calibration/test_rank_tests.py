"""Rank tests: every planted fault is seen by what should see it, perfect samplers are rejected as often as meant.

The faults are planted in two worlds, of joints that are independent and of joints that move together (correlation
0.3). Where they move together every test rejects that did so when the faults were first simulated; where they are
independent three don't (``BLIND``). In both, three are too weak for 1,000 poses (``WEAK``).
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from posecal.calibration import LEVELS
from posecal.calibration.rank_tests import RANK_TESTS, Pool, rank_test_metrics, user_weights, weights_of_ranks
from posecal.engine.block import Block
from posecal.engine.per_pose import iter_blocks
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from posecal.evaluation import evaluate
from posecal.stats.resampling import Deviation, sign_flips
from tests.helpers.random_worlds import skewed
from tests.helpers.samplers import gaussian, sequences
from tests.helpers.score_oracles import PRERANKS, box_share, rank_inside, sides, tarp_box
from toy.experiments.fault_table import COLUMNS, FaultEvaluation, evaluate_faults
from toy.faults import FAULTS

Array = np.ndarray
TESTS = {test.name: test for test in RANK_TESTS}

# --- the planted faults -----------------------------------------------------------------------------------------------

N, M = 50, 1000

TABLE: dict[str, tuple[float, str, float]] = {
    "perfect": (0.010, "", 1.0),
    "shifted": (0.006, "coordinate_pit tarp_box average_rank band_depth pair_distance mahalanobis", 1.21),
    "one-sided": (0.003, "coordinate_pit tarp_box tarp average_rank band_depth pair_distance mahalanobis", 2.59),
    "cancelling-joints": (0.022, "ece_mean coordinate_pit tarp band_depth pair_distance mahalanobis", 1.00),
    "few-joints": (0.003, "ece_mean coordinate_pit tarp_box tarp band_depth pair_distance mahalanobis", 1.05),
    "missing-correlation": (0.003, "tarp average_rank band_depth pair_distance mahalanobis", 1.02),
    "excess-correlation": (0.006, "tarp average_rank band_depth pair_distance mahalanobis", 1.02),
    "swapped-anisotropy": (0.005, "coordinate_pit tarp band_depth pair_distance mahalanobis", 1.02),
    "mixed-poses": (0.026, "ece_mean tarp band_depth pair_distance mahalanobis", 1.01),
    "depth-modes": (0.007, "coordinate_pit average_rank band_depth pair_distance", 1.10),
    "ignored-image": (0.004, "", 3.78),
}
"""What was simulated before posecal, with other draws: ECE, tests that reject, energy score over the best."""

WORLDS = {"apart": 0.0, "together": 0.3}
"""The correlation between joints. All that rejects in the table does where joints move together."""

BLIND = {("shifted", "mahalanobis"), ("one-sided", "mahalanobis"), ("one-sided", "tarp")}
"""What shows only where joints move together; apart, 4,000 poses find the .02 that a shift leaves to Mahalanobis."""

WEAK = {("shifted", "band_depth"), ("cancelling-joints", "tarp"), ("cancelling-joints", "pair_distance")}
"""What misses the diagonal by .02 to .04, in both worlds or in one of them.

A perfect sampler misses it by .01 on average over 1,000 poses, and by .027 once in a thousand times, so that whether
these reject there is chance. They are tested with four times as many, where joints move together.
"""


@pytest.fixture(scope="module")
def found() -> dict[str, dict[str, FaultEvaluation]]:
    return {world: evaluate_faults(0, N=N, M=M, joint_correlation=c) for world, c in WORLDS.items()}


@pytest.fixture(scope="module")
def found_in_more_poses() -> dict[str, FaultEvaluation]:
    faults = sorted({fault for fault, _ in WEAK})
    return evaluate_faults(0, N=N, M=4 * M, joint_correlation=WORLDS["together"], faults=faults)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "fault", "test"),
    [
        (world, fault, test)
        for world in WORLDS
        for fault, (_, tests, _) in TABLE.items()
        for test in tests.split()
        if (fault, test) not in WEAK and (world == "together" or (fault, test) not in BLIND)
    ],
)
def test_a_fault_is_seen_by_the_tests_that_should_see_it(
    found: dict[str, dict[str, FaultEvaluation]], world: str, fault: str, test: str
) -> None:
    assert found[world][fault].report.test(test).p < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "test"), sorted(WEAK))
def test_a_fault_that_shows_little_is_seen_in_more_poses(
    found_in_more_poses: dict[str, FaultEvaluation], fault: str, test: str
) -> None:
    assert test in TABLE[fault][1].split()
    assert found_in_more_poses[fault].report.test(test).p < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("fault", TABLE)
def test_the_ece_stays_where_the_fault_leaves_it(
    found: dict[str, dict[str, FaultEvaluation]], world: str, fault: str
) -> None:
    # A joint's curve strays from what is expected by √(2/π) ∫√(q(1−q)) dq/√M on average; the median of 16 independent
    # joints by 1.25/√16 of that, and that of joints that move as one by all of it.
    apart = world == "apart" and "correlation" not in fault
    stray = math.sqrt(2 / math.pi) * math.pi / 8 / math.sqrt(M) * (1.25 / 4 if apart else 1)
    assert abs(found[world][fault].report["ece"] - TABLE[fault][0]) < 3 * math.sqrt(2) * stray  # two simulations


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("fault", TABLE)
def test_the_energy_score_pays_for_a_fault_as_much_as_it_should(
    found: dict[str, dict[str, FaultEvaluation]], world: str, fault: str
) -> None:
    one = found[world][fault]
    ratio = one.report["energy_score"] / one.least_energy
    low, high = one.report.interval("energy_score")
    error = (high - low) / 2 / one.least_energy
    assert abs(ratio - TABLE[fault][2]) < 0.005 + 2 * error  # two simulations, and two digits


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("fault", ["perfect", "ignored-image"])
def test_who_samples_from_the_prior_passes_every_calibration_test_as_a_perfect_sampler_does(
    found: dict[str, dict[str, FaultEvaluation]], world: str, fault: str
) -> None:
    assert min(found[world][fault].report.test(column).p for column in COLUMNS) > 0.01 / len(COLUMNS)


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("fault", [fault for fault in TABLE if fault not in {"perfect", "ignored-image"}])
def test_every_other_fault_is_seen_after_adjusting_for_the_number_of_tests(
    found: dict[str, dict[str, FaultEvaluation]], world: str, fault: str
) -> None:
    assert min(p for _, p in found[world][fault].report.rank_tests().values()) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "test"), sorted(BLIND))
def test_in_independent_isotropic_joints_a_distance_is_blind_to_a_shift(
    found: dict[str, dict[str, FaultEvaluation]], fault: str, test: str
) -> None:
    # Of one-sided truths the squared distance is that of any draw: 16 · 3. Of shifted ones it is, in units of the
    # model's variance, (48 + 16 · 1.2²) / 1.23² = 46.96 where the model's own is 48, and scatters by √96 = 9.8.
    # With correlation 0.3 one direction of 16 has the variance 0.7 + 16 · 0.3 = 5.5, and the shift lies along it:
    # (47 + (5.5 + 16 · 1.2²) / 5.5) / 1.23² = 34.5.
    assert found["apart"][fault].report[test] < 0.05
    assert found["together"][fault].report[test] > found["apart"][fault].report[test]


def test_where_joints_move_together_there_must_be_more_poses_than_hypotheses() -> None:
    with pytest.raises(PoseDataError, match=r"^M = 6 poses and N = 6 hypotheses; expected more poses"):
        evaluate_faults(N=6, M=6, joint_correlation=0.3)


def test_every_fault_of_the_toy_world_is_in_the_table() -> None:
    assert list(TABLE) == list(FAULTS)


# --- the level --------------------------------------------------------------------------------------------------------

REPLICATES, SEQUENCES, FRAMES = 200, 10, 3


@pytest.fixture(scope="module")
def rejections() -> dict[str, int]:
    """How many of 200 perfect samplers each test rejects at 5 %; the frames of a sequence are alike by two thirds."""
    poses, K, n = REPLICATES * SEQUENCES * FRAMES, 3, 19
    random = np.random.default_rng(20)
    common, own = (
        random.standard_normal((poses // FRAMES, 1, K, 3)),
        random.standard_normal((poses // FRAMES, FRAMES, K, 3)),
    )
    stray = (math.sqrt(2 / 3) * common + math.sqrt(1 / 3) * own).reshape(poses, K, 3)
    common, own = random.standard_normal((n, poses, 1, 3)), random.standard_normal((n, poses, K, 3))
    mix = np.array([0.5, 0.8, 1.0])[:, None]  # joints have something in common, less and less
    widths, centre = np.array([20.0, 35, 60]), random.normal(0, 30, (poses, K, 3))
    shared = random.standard_normal((poses // FRAMES, 1, 1, 3)).repeat(FRAMES, axis=1).reshape(poses, 1, 3)
    y = centre + widths * (mix * stray + np.sqrt(1 - mix**2) * shared)
    x = centre + widths * (mix * own + np.sqrt(1 - mix**2) * common)
    joints, counts = np.ones(K, dtype=bool), {}
    runs = [slice(start, start + SEQUENCES * FRAMES) for start in range(0, poses, SEQUENCES * FRAMES)]
    sequence = np.arange(SEQUENCES).repeat(FRAMES)
    blocks = [lay_out() for run in runs for lay_out in iter_blocks(x[:, run], y[run], sequence=sequence)]
    for test in RANK_TESTS:
        weights = np.concatenate([test.weights(block, joints) for block in blocks])
        D = (weights - LEVELS).reshape(REPLICATES, SEQUENCES, FRAMES, -1, LEVELS.size).sum(axis=2)
        number = np.full(D.shape[1:3], FRAMES)
        counts[test.name] = sum(sign_flips(d, number, Deviation()).p <= 0.05 for d in D)
    return counts


@pytest.mark.slow
@pytest.mark.parametrize("test", TESTS)
def test_perfect_samplers_are_rejected_as_often_as_meant(rejections: dict[str, int], test: str) -> None:
    low, high = stats.binom(REPLICATES, 0.03).ppf(5e-4), stats.binom(REPLICATES, 0.07).ppf(1 - 5e-4)
    assert low <= rejections[test] <= high


# --- ranks, ties, and joints that don't count -------------------------------------------------------------------------


@given(st.lists(st.integers(0, 5), min_size=2, max_size=12))
def test_weights_are_those_of_the_rank_among_all_points_ties_shared(prerank: list[int]) -> None:
    found = weights_of_ranks(np.array(prerank, dtype=float))
    np.testing.assert_allclose(found, rank_inside([float(value) for value in prerank]), atol=1e-12)


def test_numbers_tie_up_to_their_rounding_in_their_own_pool() -> None:
    """Sums of the same numbers in another order differ by a few parts in 10¹⁶ of the largest of a pool."""
    prerank = np.array([[1e12, 3e12, 2e12], [1 + 1e-7, 3, 1], [5 + 4e-15, 5, 5 + 8e-15], [-9e3, -7e3, -7e3 - 1e-12]])
    expected = [rank_inside([1, 3, 2]), rank_inside([2, 3, 1]), rank_inside([0, 0, 0]), rank_inside([0, 1, 1])]
    np.testing.assert_allclose(weights_of_ranks(prerank), expected)


@pytest.mark.parametrize("name", PRERANKS)
@pytest.mark.parametrize("N", [3, 6])
def test_a_rank_test_is_its_definition(name: str, N: int) -> None:
    x, y = skewed(N, N, 7, 4)
    where = np.random.default_rng(N).random((7, 4)) < 0.7
    where[0], where[1] = False, True
    found = TESTS[name].weights(Block(x, y, where=where), np.ones(4, dtype=bool))
    assert found.shape == (7, 1, LEVELS.size)
    assert np.isnan(found[0]).all()
    for m in range(1, 7):
        pool = np.concatenate([x[:, m][:, where[m]], y[m][where[m]][None]])
        np.testing.assert_allclose(found[m, 0], rank_inside(PRERANKS[name](pool)), atol=1e-9)


@pytest.mark.parametrize("name", PRERANKS)
def test_points_are_ranked_by_the_number_that_the_definition_names(name: str) -> None:
    x, y = skewed(4, 5, 3, 4)
    prerank = TESTS[name].prerank
    assert prerank is not None
    found = prerank(Pool.of(Block(x, y), np.ones(4, dtype=bool)))
    for m in range(3):
        expected = np.array(PRERANKS[name](np.concatenate([x[:, m], y[m][None]])))
        if name in {"average_rank", "band_depth"}:
            expected /= 4 * 3  # a mean over coordinates, there a sum
        np.testing.assert_allclose(found[m] + (name == "average_rank"), expected)  # from 0, there from 1


@pytest.mark.parametrize("N", [3, 6])
def test_tarp_in_a_box_is_its_definition(N: int) -> None:
    x, y = skewed(N, N, 7, 4)
    where = np.random.default_rng(N).random((7, 4)) < 0.7
    where[0], where[1] = False, True
    y[:, 2, 1] = 12.5  # nothing to tell
    y[:, 3], x[:, :, 3] = 1e-3 * y[:, 3], 1e-3 * x[:, :, 3]  # sides of less than a millimetre
    found = TESTS["tarp_box"].weights(Block(x, y, where=where), np.ones(4, dtype=bool))
    assert np.isnan(found[0]).all()
    for m in range(1, 7):
        box = sides(np.delete(y, m, axis=0), np.delete(where, m, axis=0))
        pool, own = np.concatenate([x[:, m], y[m][None]]), [box[k] for k in np.flatnonzero(where[m])]
        share = box_share(np.where(where[m][:, None], y[m], math.nan))[where[m]]
        np.testing.assert_allclose(found[m, 0], rank_inside(tarp_box(pool[:, where[m]], own, share)), atol=1e-9)


def test_in_a_box_without_a_side_the_truth_has_no_rank() -> None:
    x, y = skewed(3, 6, 1, 4)  # of one pose
    assert np.isnan(TESTS["tarp_box"].weights(Block(x, y), np.ones(4, dtype=bool))).all()


@pytest.mark.parametrize("test", TESTS)
def test_among_hypotheses_that_all_are_the_truth_it_has_no_rank(test: str) -> None:
    y = skewed(5, 2, 6, 4)[1]
    weights = TESTS[test].weights(Block(np.repeat(y[None], 9, axis=0), y), np.ones(4, dtype=bool))
    assert np.isnan(weights).all()


def test_an_axis_in_which_all_hypotheses_are_the_truth_has_its_ranks_shared() -> None:
    x, y = skewed(5, 9, 6, 4)
    x[..., 2] = y[..., 2]  # positions in a plane
    weights = TESTS["coordinate_pit"].weights(Block(x, y), np.ones(4, dtype=bool))
    np.testing.assert_allclose(weights[:, :, 2], np.broadcast_to(LEVELS, weights[:, :, 2].shape), atol=1e-12)
    assert not np.isnan(weights).any()


# --- a user's own pre-rank --------------------------------------------------------------------------------------------


def height(pool: Array) -> Array:
    """Height of the highest joint."""
    return pool[..., 2].max(axis=1)


def test_a_prerank_of_ones_own_is_ranked_like_the_others() -> None:
    x, y = skewed(6, 8, 9, 3)
    found = user_weights(Block(x, y), np.ones(3, dtype=bool), height)
    for m in range(9):
        pool = np.concatenate([x[:, m], y[m][None]])
        np.testing.assert_allclose(found[m, 0], rank_inside(height(pool)), atol=1e-9)


def test_a_prerank_of_ones_own_has_no_rank_where_no_joint_counts() -> None:
    x, y = skewed(6, 8, 4, 3)
    where = np.array([[True] * 3, [False] * 3, [False, False, True], [True, False, False]])
    found = user_weights(Block(x, y, where), np.array([True, True, False]), lambda pool: pool[:, 0, 0])
    assert np.isnan(found).all(axis=(1, 2)).tolist() == [False, True, True, False]
    assert np.isnan(found).any(axis=(1, 2)).tolist() == [False, True, True, False]


def test_of_coordinates_the_number_is_a_mean_and_of_poses_it_is_one() -> None:
    known = {m.name: m for m in rank_test_metrics(Scope(Protocol(), DataSpec(6, ("a", "b", "c"), root=0)))}
    assert list(known) == list(TESTS)
    for name, metric in known.items():
        over = ", mean over axes and the 2 joints" if name == "coordinate_pit" else " of poses of the 2 joints"
        assert f"of |ω(q) − q|{over} (no root), ω: " in metric.definition
        assert (metric.by_joint is not None) == (name == "coordinate_pit")


def test_a_prerank_of_ones_own_is_reported_with_its_p_value_among_the_others() -> None:
    x, y = gaussian(7, 20, 60, 4, bias=[0, 0, 80.0])
    options = {"unit": "mm", "metrics": "rank_tests", "preranks": {"height": height}}
    report = evaluate(x, y, labels={"sequence": sequences(60, 12)}, **options)
    null, adjusted = report.rank_tests()["height"]
    assert len(report.rank_tests()) == len(RANK_TESTS) + 1
    assert null.p < 0.01
    assert adjusted >= null.p
    assert report.metrics["height"].rejection == "the truth does not rank as one of the hypotheses would"


@pytest.mark.parametrize(
    ("prerank", "shape"),
    [(lambda pool: pool[:, 0], r"\(6, 3\)"), (lambda pool: pool[1:, 0, 0], r"\(5,\)"), (lambda pool: 1.0, r"\(\)")],
    ids=["too many", "too few", "one"],
)
def test_a_prerank_that_gives_other_than_a_number_per_pose_is_refused(prerank: object, shape: str) -> None:
    x, y = skewed(8, 5, 3, 2)
    with pytest.raises(
        PoseDataError, match=rf"prerank: gave {shape} for a pool of 6 poses; expected one finite number"
    ):
        user_weights(Block(x, y), np.ones(2, dtype=bool), prerank)  # type: ignore[arg-type]


def test_a_prerank_that_is_not_finite_is_refused() -> None:
    x, y = skewed(9, 5, 3, 2)
    with pytest.raises(PoseDataError, match="expected one finite number each"):
        user_weights(Block(x, y), np.ones(2, dtype=bool), lambda pool: np.full(len(pool), np.nan))


def test_a_prerank_that_fails_is_refused_with_what_it_said() -> None:
    x, y = skewed(9, 5, 3, 2)
    with pytest.raises(PoseDataError, match=r"prerank: it fails on a pool of 6 poses \(IndexError: index 9 is"):
        user_weights(Block(x, y), np.ones(2, dtype=bool), lambda pool: pool[:, 9, 0])


def test_a_prerank_of_a_saved_result_has_no_function() -> None:
    x, y = skewed(9, 5, 3, 2)
    with pytest.raises(PoseDataError, match=r"prerank: 'height' is known from a saved result only; expected its func"):
        user_weights(Block(x, y), np.ones(2, dtype=bool), None, "height")
