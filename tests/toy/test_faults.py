"""The named faults: each matches its description, and its ECE that of the closed-form curves.

The numbers of the table (16 joints, 100 hypotheses, 1,000 independent poses) are those of posecal's own calibration
curve, compared with closed forms where there are any.
"""

import math

import numpy as np
import pytest

from posecal.calibration import LEVELS, calibration_curve
from posecal.errors import PoseDataError
from toy import curves
from toy.faults import FAULTS, Case, find_fault, spread
from toy.pose_world import PoseWorld

N, M, K = 100, 1000, 16
SIGMA = 30.0


def case(world: PoseWorld | None = None, seed: int = 0) -> Case:
    world = world or PoseWorld.independent_joints(sigma=SIGMA)
    rng = np.random.default_rng(seed)
    return Case.of(world, world.draw(rng, sequences=M, frames=1), rng)


def mean_of_curves(*spreads: float) -> np.ndarray:
    return np.mean([curves.coverage_of(N, spread=s) for s in spreads], axis=0)


CLOSED = {
    # fault: (ECE of the median curve, mean of the joints' ECEs), before the noise of M poses
    "perfect": (0.0, 0.0),
    "shifted": (curves.ece(spread=1.23, offset=1.2),) * 2,
    "one-sided": (0.0, 0.0),
    "cancelling-joints": (
        float(np.abs(mean_of_curves(0.75, 1.24) - LEVELS).mean()),
        (curves.ece(spread=0.75) + curves.ece(spread=1.24)) / 2,
    ),
    "few-joints": (0.0, (curves.ece(spread=0.4) + curves.ece(spread=2.5)) / 4),
    "missing-correlation": (0.0, 0.0),
    "excess-correlation": (0.0, 0.0),
    "swapped-anisotropy": (0.0, 0.0),
    "mixed-poses": (float(np.abs(mean_of_curves(0.75, 1.24) - LEVELS).mean()),) * 2,
    "depth-modes": (0.0, 0.0),
    "ignored-image": (0.0, 0.0),
}
"""Most faults leave every joint's distances as they should be, so the ECE can't see them. The median over 16
joints of which 8 lie low and 8 high is the mean of the two in the middle: the mean of a low and a high curve."""


FAST = ("perfect", "shifted", "cancelling-joints")


@pytest.mark.parametrize(
    "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in FAULTS]
)
def test_the_ece_of_each_fault_is_that_of_the_closed_curves(name: str) -> None:
    hypotheses, truth = FAULTS[name].apply(case(), N)
    curve = calibration_curve(hypotheses, truth)
    median, mean = CLOSED[name]
    # One joint's share of M poses has the standard error √(q(1−q)/M), so the mean distance of its curve from what
    # is expected is on average √(2/π) ∫√(q(1−q)) dq/√M = 0.0099. The median over joints scatters as much where the
    # joints are one, and less otherwise; the mean over joints of that distance hardly at all.
    noise = math.sqrt(2 / math.pi) * math.pi / 8 / math.sqrt(M)
    assert abs(curve.ece() - median) < 3 * noise
    assert abs(curve.ece("mean") - mean) < 1.5 * noise


@pytest.mark.slow
def test_the_published_table_is_reproduced() -> None:
    # ECE (paper's summary) and mean over joints of the project's table, which was simulated with other draws
    table = {
        "shifted": (0.006, 0.009),
        "cancelling-joints": (0.022, 0.144),
        "few-joints": (0.003, 0.195),
        "mixed-poses": (0.026, 0.025),
    }
    for name, published in table.items():
        curve = calibration_curve(*FAULTS[name].apply(case(seed=1), N))
        np.testing.assert_allclose((curve.ece(), curve.ece("mean")), published, rtol=0, atol=0.01)


@pytest.mark.parametrize(
    "name", ["perfect", "shifted", "cancelling-joints", "few-joints", "mixed-poses", "ignored-image"]
)
def test_faults_of_the_model_leave_the_truth_alone(name: str) -> None:
    planted = case()
    _, truth = FAULTS[name].apply(planted, 3)
    np.testing.assert_allclose(truth, planted.scene.truth, atol=1e-9)


# --- where joints move together ---------------------------------------------------------------------------------------


def together(correlation: float, n_poses: int = M) -> Case:
    world, rng = PoseWorld.independent_joints(sigma=SIGMA), np.random.default_rng(2)
    scene = world.draw(rng, sequences=n_poses, frames=1)
    return Case.of(world, scene, rng, joint_correlation=correlation)


@pytest.mark.parametrize("correlation", [0.3, pytest.param(0.8, marks=pytest.mark.slow)])
def test_truths_and_perfect_hypotheses_move_together_as_asked_and_each_joint_as_before(correlation: float) -> None:
    planted = together(correlation)
    pairs = ~np.eye(K, dtype=bool)
    for values in (planted.truth_deviation[None] / SIGMA, planted.deviations(N) / SIGMA):
        found = np.einsum("nmka,nmla->kl", values, values)[pairs].mean() / (3 * values.shape[0] * M)
        np.testing.assert_allclose(found, correlation, atol=4 * 1.25 / math.sqrt(3 * values.shape[0] * M))
        np.testing.assert_allclose(values.std(), 1, rtol=0.05)


def test_the_truth_of_a_case_is_one_draw() -> None:
    planted = together(0.3)
    before = planted.truth_deviation
    FAULTS["mixed-poses"].apply(planted, 3)
    np.testing.assert_array_equal(planted.truth_deviation, before)
    np.testing.assert_array_equal(together(0.3).truth_deviation, before)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_the_ece_of_each_fault_is_the_same_where_joints_move_together(name: str) -> None:
    # A fault is an act on each joint, whatever the others do; only the noise of the median curve is larger.
    curve = calibration_curve(*FAULTS[name].apply(together(0.3), N))
    median, mean = CLOSED[name]
    noise = math.sqrt(2 / math.pi) * math.pi / 8 / math.sqrt(M)
    assert abs(curve.ece() - median) < 3 * noise
    assert abs(curve.ece("mean") - mean) < 1.5 * noise


def test_ignored_image_where_joints_move_together_draws_about_the_means_of_other_poses_none_twice() -> None:
    planted = together(0.9999999, 40)
    hypotheses, truth = FAULTS["ignored-image"].apply(planted, 39)
    np.testing.assert_array_equal(truth, planted.scene.truth)
    stray = hypotheses[:, :, None] - planted.posterior.mean  # (N, M, M, K, 3): all joints alike about the right mean
    nearest = stray.std(axis=3).sum(axis=-1).argmin(axis=2)
    for pose in range(40):
        assert sorted(nearest[:, pose]) == [other for other in range(40) if other != pose]


def test_ignored_image_where_joints_move_together_needs_other_poses() -> None:
    with pytest.raises(PoseDataError, match="N = 5 hypotheses and M = 5 poses; expected more poses than hypotheses"):
        FAULTS["ignored-image"].apply(together(0.3, 5), 5)


# --- what each fault does ---------------------------------------------------------------------------------------------


def deviations(name: str, n: int = N) -> tuple[np.ndarray, np.ndarray]:
    """Hypotheses and truth about the posterior mean, in posterior standard deviations."""
    planted = case()
    hypotheses, truth = FAULTS[name].apply(planted, n)
    return (hypotheses - planted.posterior.mean) / SIGMA, (truth - planted.posterior.mean) / SIGMA


def rms(values: np.ndarray, *, keep: int) -> np.ndarray:
    """Root mean square over all axes but one."""
    axes = tuple(axis for axis in range(values.ndim) if axis != keep % values.ndim)
    return np.sqrt((values**2).mean(axis=axes))


@pytest.mark.slow
def test_shifted_is_1_2_too_deep_and_1_23_too_wide() -> None:
    model, _ = deviations("shifted")
    np.testing.assert_allclose(model.mean(axis=(0, 1, 2)), [0, 0, 1.2], atol=5 * 1.23 / math.sqrt(N * M * K))
    np.testing.assert_allclose(model.std(axis=(0, 1, 2)), 1.23, rtol=0.01)


def test_one_sided_puts_the_truth_behind_the_mean_at_its_own_distance() -> None:
    planted = case()
    _, truth = FAULTS["one-sided"].apply(planted, 2)
    moved = truth - planted.posterior.mean
    np.testing.assert_allclose(moved[..., :2], 0, atol=1e-9)
    np.testing.assert_allclose(moved[..., 2], np.linalg.norm(planted.truth_deviation, axis=-1))


def test_cancelling_joints_alternate() -> None:
    model, _ = deviations("cancelling-joints")
    np.testing.assert_allclose(rms(model, keep=2), [0.75, 1.24] * 8, rtol=0.01)


def test_few_joints_are_a_quarter_each() -> None:
    model, _ = deviations("few-joints")
    np.testing.assert_allclose(rms(model, keep=2), [0.4, 1, 2.5, 1] * 4, rtol=0.01)


def test_mixed_poses_alternate() -> None:
    model, _ = deviations("mixed-poses")
    np.testing.assert_allclose(rms(model[:, ::2], keep=3), 0.75, rtol=0.01)
    np.testing.assert_allclose(rms(model[:, 1::2], keep=3), 1.24, rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "of_truth", "of_model"), [("missing-correlation", 0.9, 0.0), ("excess-correlation", 0.5, 0.95)]
)
def test_correlations_between_joints_are_as_named(name: str, of_truth: float, of_model: float) -> None:
    model, truth = deviations(name)
    pairs = ~np.eye(K, dtype=bool)
    # Averages over 240 joint pairs and 3 axes that share M common factors: error below (1 − ρ² + ρ)/√M
    for values, correlation in ((truth[None], of_truth), (model, of_model)):
        found = np.einsum("nmka,nmla->kl", values, values)[pairs].mean() / (3 * values.shape[0] * M)
        np.testing.assert_allclose(found, correlation, atol=4 * 1.25 / math.sqrt(3 * values.shape[0] * M))
        np.testing.assert_allclose(values.std(), 1, rtol=0.05)


def test_swapped_anisotropy_stretches_truth_in_depth_and_model_to_the_side() -> None:
    model, truth = deviations("swapped-anisotropy")
    np.testing.assert_allclose(rms(model, keep=-1), [3, 1, 1], rtol=0.01)
    np.testing.assert_allclose(rms(truth, keep=-1), [1, 1, 3], rtol=5 / math.sqrt(2 * M * K))


@pytest.mark.slow
def test_depth_modes_lie_three_deviations_away_with_the_whole_pose_on_one_side() -> None:
    model, truth = deviations("depth-modes")
    side = np.sign(truth[..., 2].mean(axis=1))
    assert 0.4 < (side > 0).mean() < 0.6
    np.testing.assert_allclose((truth[..., 2] * side[:, None]).mean(), 3, atol=5 / math.sqrt(M * K))
    np.testing.assert_allclose(rms(model, keep=-1), math.sqrt((3 + 9) / 3), rtol=0.01)  # E r² = 12, no direction


def test_ignored_image_draws_from_the_prior() -> None:
    planted = case()
    hypotheses, _ = FAULTS["ignored-image"].apply(planted, N)
    np.testing.assert_allclose(
        hypotheses.mean(axis=(0, 1)), planted.world.mean, atol=5 * 3.78 * SIGMA / math.sqrt(N * M)
    )
    np.testing.assert_allclose((hypotheses - planted.world.mean).std(), 3.78 * SIGMA, rtol=0.01)


def test_every_fault_works_on_a_person_with_hidden_keypoints() -> None:
    world = PoseWorld.person("h36m-17")
    rng = np.random.default_rng(0)
    planted = Case.of(world, world.draw(rng, sequences=4, frames=3, hidden=0.5), rng)
    for fault in FAULTS.values():
        hypotheses, truth = fault.apply(planted, 5)
        assert hypotheses.shape == (5, 12, 17, 3)
        assert np.isfinite(hypotheses).all()
        np.testing.assert_array_equal(hypotheses[:, :, 0], 0)  # the hip stays
        np.testing.assert_array_equal(truth[:, 0], 0)


@pytest.mark.slow
def test_faults_that_keep_every_distance_keep_the_ece_of_a_person_low() -> None:
    # Of a person's joints depth is far wider than the image: only acts that keep the distances stay unseen
    planted = case(PoseWorld.person())
    noise = math.sqrt(2 / math.pi) * math.pi / 8 / math.sqrt(M)
    for name in ("perfect", "missing-correlation", "excess-correlation", "depth-modes", "ignored-image"):
        assert calibration_curve(*FAULTS[name].apply(planted, N)).ece() < 3 * noise


@pytest.mark.slow
def test_a_spread_has_the_closed_curve() -> None:
    hypotheses, truth = spread(0.4).apply(case(), N)
    measured = calibration_curve(hypotheses, truth).joints.mean(axis=0)
    exact = curves.coverage_of(N, spread=0.4)
    error = np.sqrt(exact * (1 - exact) / (M * K))
    bend = np.abs(exact - curves.coverage(spread=0.4))
    np.testing.assert_array_less(np.abs(measured - exact)[1:-1], (4.5 * error + 0.25 * bend)[1:-1])


def test_names_lead_to_faults() -> None:
    assert find_fault("one-sided") is FAULTS["one-sided"]
    assert find_fault("spread-0.6").name == "spread-0.6"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("one-side", r"fault: 'one-side' is not known\. Did you mean one-sided\?"),
        ("spread-wide", r"'spread-wide' is not known"),
        ("spread--1", r"spread: -1\.0; expected a factor, 0 or more"),
    ],
)
def test_other_names_are_refused(name: str, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        find_fault(name)


def test_no_hypotheses_are_refused() -> None:
    with pytest.raises(PoseDataError, match="N = 0 hypotheses"):
        FAULTS["perfect"].apply(case(), 0)
