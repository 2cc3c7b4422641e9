"""The pose world's posterior against independent algebra, scipy's densities, Bayes' rule and simulations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from posecal.data.skeleton import JOINT_SETS, Skeleton
from posecal.errors import PoseDataError
from toy import best_of
from toy.pose_world import PoseWorld


def random_world(seed: int, K: int) -> PoseWorld:
    """A tree of K joints of any shape, with full bone covariances and an oblique camera."""
    rng = np.random.default_rng(seed)
    parents = tuple(int(rng.integers(-1, k)) for k in range(K))
    roots = rng.standard_normal((K, 3, 3))
    return PoseWorld(
        joints=tuple(f"joint {k}" for k in range(K)),
        parents=parents,
        bones=100 * rng.standard_normal((K, 3)),
        bone_covariance=400 * (roots @ roots.swapaxes(1, 2) + 0.1 * np.eye(3)),
        keypoint_sigma=float(rng.uniform(2, 20)),
        view=rng.standard_normal((2, 3)),
    )


def flat(poses: np.ndarray) -> np.ndarray:
    return poses.reshape(*poses.shape[:-2], -1)


worlds = st.builds(random_world, st.integers(0, 10_000), st.integers(1, 12))


class TestPrior:
    @settings(derandomize=True, max_examples=20, deadline=None)
    @given(worlds)
    def test_covariance_adds_up_the_bones_that_two_joints_share(self, world: PoseWorld) -> None:
        def path(k: int) -> set[int]:
            return set() if k < 0 else {k} | path(world.parents[k])

        K = len(world.joints)
        for a in range(K):
            np.testing.assert_allclose(world.mean[a], sum(world.bones[j] for j in path(a)), atol=1e-9)
            for b in range(K):
                shared = sum((world.bone_covariance[j] for j in path(a) & path(b)), np.zeros((3, 3)))
                block = world.covariance[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
                np.testing.assert_allclose(block, shared, atol=1e-9)

    def test_draws_have_its_mean_and_covariance(self) -> None:
        world = PoseWorld.person()
        drawn = flat(world.draw(np.random.default_rng(0), sequences=400, frames=50).truth)
        error = np.sqrt(np.diag(world.covariance) / len(drawn))
        np.testing.assert_array_less(np.abs(drawn.mean(axis=0) - flat(world.mean)), 4.5 * error)
        found = np.cov(drawn.T)
        # Var of a sample covariance of Gaussians: (Σ_aa Σ_bb + Σ_ab²)/M
        sd = np.sqrt(
            (np.outer(np.diag(world.covariance), np.diag(world.covariance)) + world.covariance**2) / len(drawn)
        )
        np.testing.assert_array_less(np.abs(found - world.covariance), 5 * sd)

    def test_a_person_stands_as_the_skeleton_rests(self) -> None:
        world = PoseWorld.person("h36m-17")
        rest = Skeleton(world.joints).rest_pose  # x to the person's left, y backwards, z up
        np.testing.assert_allclose(world.mean, np.stack([rest[:, 0], -rest[:, 2], rest[:, 1]], axis=-1))

    def test_a_persons_bones_swing_more_than_they_stretch(self) -> None:
        world = PoseWorld.person(across=0.25, along=0.05)
        for bone, covariance in zip(world.bones, world.bone_covariance, strict=True):
            length = np.linalg.norm(bone)
            sd = np.sqrt(np.linalg.eigvalsh(covariance)) / length
            np.testing.assert_allclose(sd, [0.05, 0.25, 0.25])
            np.testing.assert_allclose(bone @ covariance @ bone / length**4, 0.05**2)

    @pytest.mark.parametrize("name", [name for name in JOINT_SETS if Skeleton(JOINT_SETS[name]).is_known])
    def test_every_joint_set_has_a_world(self, name: str) -> None:
        world = PoseWorld.person(name)
        scene = world.draw(np.random.default_rng(0), sequences=2, frames=3, hidden=0.5)
        posterior = world.posterior(scene.keypoints, scene.observed)
        assert posterior.sample(4, np.random.default_rng(0)).shape == (4, 6, len(world.joints), 3)
        assert np.isfinite(posterior.log_prob(scene.truth)).all()

    def test_the_hip_stays_at_the_origin(self) -> None:
        world = PoseWorld.person("h36m-17")
        scene = world.draw(np.random.default_rng(0))
        posterior = world.posterior(scene.keypoints, scene.observed)
        np.testing.assert_array_equal(scene.truth[:, 0], 0)
        np.testing.assert_array_equal(posterior.sample(3, np.random.default_rng(0))[:, :, 0], 0)
        np.testing.assert_array_equal(posterior.marginal(0)[1], 0)

    def test_the_keypoint_of_the_hip_carries_no_information(self) -> None:
        rng = np.random.default_rng(1)
        with_hip, without = PoseWorld.person("h36m-17"), PoseWorld.person("h36m-16")
        scene = with_hip.draw(rng, hidden=0.4)
        other = without.posterior(scene.keypoints[:, 1:], scene.observed[:, 1:])
        same = with_hip.posterior(scene.keypoints, scene.observed)
        np.testing.assert_allclose(same.mean[:, 1:], other.mean, atol=1e-8)
        np.testing.assert_allclose(same.log_prob(scene.truth), other.log_prob(scene.truth[:, 1:]))


class TestPosterior:
    @settings(derandomize=True, max_examples=30, deadline=None)
    @given(worlds, st.integers(0, 10_000))
    def test_equals_the_information_form(self, world: PoseWorld, seed: int) -> None:
        # Precisions add: Σ_post⁻¹ = Σ⁻¹ + HᵀH/τ², m_post = Σ_post (Σ⁻¹ m + Hᵀc/τ²)
        rng = np.random.default_rng(seed)
        K = len(world.joints)
        seen = rng.random(K) < 0.6
        keypoints = 200 * rng.standard_normal((1, K, 2))
        shows = np.zeros((2 * seen.sum(), 3 * K))
        for row, k in enumerate(np.flatnonzero(seen)):
            shows[2 * row : 2 * row + 2, 3 * k : 3 * k + 3] = world.view
        precision = np.linalg.inv(world.covariance)
        covariance = np.linalg.inv(precision + shows.T @ shows / world.keypoint_sigma**2)
        mean = covariance @ (
            precision @ flat(world.mean) + shows.T @ keypoints[0, seen].ravel() / world.keypoint_sigma**2
        )
        posterior = world.posterior(keypoints, seen[None])
        scale = np.abs(covariance).max()
        np.testing.assert_allclose(posterior.covariance[0], covariance, rtol=1e-5, atol=1e-7 * scale)
        np.testing.assert_allclose(flat(posterior.mean)[0], mean, rtol=1e-5, atol=1e-4)

    def test_obeys_bayes_rule(self) -> None:
        # log p(x|c) − log p(x) − log p(c|x) = −log p(c), which no x changes
        rng = np.random.default_rng(2)
        world = PoseWorld.person()
        scene = world.draw(rng, sequences=1, frames=1)
        observed = rng.random(scene.observed.shape) < 0.5
        posterior, prior = world.posterior(scene.keypoints, observed), world.prior(1)
        evidence = []
        for pose in world.draw(rng, sequences=6, frames=1).truth:
            surprise = (scene.keypoints[0] - pose @ world.view.T)[observed[0]]
            likelihood = stats.norm.logpdf(surprise, scale=world.keypoint_sigma).sum()
            evidence.append(posterior.log_prob(pose[None])[0] - prior.log_prob(pose[None])[0] - likelihood)
        np.testing.assert_allclose(evidence, evidence[0], rtol=1e-9)

    def test_density_is_scipys(self) -> None:
        world = random_world(3, 5)
        scene = world.draw(np.random.default_rng(3), sequences=4, frames=1, hidden=0.5)
        posterior = world.posterior(scene.keypoints, scene.observed)
        expected = [
            stats.multivariate_normal(flat(mean), posterior.covariance[pattern]).logpdf(flat(truth))
            for mean, pattern, truth in zip(posterior.mean, posterior.pattern, scene.truth, strict=True)
        ]
        np.testing.assert_allclose(posterior.log_prob(scene.truth), expected)

    def test_truths_are_draws_of_it(self) -> None:
        # The squared Mahalanobis distance of a true pose is χ² with 48 degrees of freedom: mean 48, variance 96
        world = PoseWorld.person()
        scene = world.draw(np.random.default_rng(4), sequences=80, frames=50, hidden=0.4)
        posterior = world.posterior(scene.keypoints, scene.observed)
        # log p = −(d² + 48 ln 2π + ln det Σ)/2 and the entropy is (48 + 48 ln 2π + ln det Σ)/2
        squared = 48 - 2 * (posterior.log_prob(scene.truth) + posterior.entropy)
        np.testing.assert_allclose(squared.mean(), 48, atol=4 * math.sqrt(96 / 4000))
        assert stats.kstest(squared, stats.chi2(48).cdf).pvalue > 1e-4

    def test_samples_have_its_mean_and_covariance(self) -> None:
        world = PoseWorld.person("3dhp-14")
        scene = world.draw(np.random.default_rng(5), sequences=2, frames=1, hidden=0.5)
        posterior = world.posterior(scene.keypoints, scene.observed)
        drawn = flat(posterior.sample(20_000, np.random.default_rng(6)))
        for m in range(2):
            covariance = posterior.covariance[posterior.pattern[m]]
            error = np.sqrt(np.diag(covariance) / 20_000)
            np.testing.assert_array_less(np.abs(drawn[:, m].mean(axis=0) - flat(posterior.mean[m])), 4.5 * error)
            sd = np.sqrt((np.outer(np.diag(covariance), np.diag(covariance)) + covariance**2) / 20_000)
            np.testing.assert_array_less(np.abs(np.cov(drawn[:, m].T) - covariance), 5 * sd)

    def test_marginals_are_blocks_of_the_joint_covariance(self) -> None:
        world = random_world(7, 6)
        scene = world.draw(np.random.default_rng(7), sequences=3, frames=2, hidden=0.5)
        posterior = world.posterior(scene.keypoints, scene.observed)
        for k in range(6):
            mean, covariance = posterior.marginal(k)
            np.testing.assert_array_equal(mean, posterior.mean[:, k])
            for m in range(6):
                block = posterior.covariance[posterior.pattern[m]][3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
                np.testing.assert_array_equal(covariance[m], block)

    def test_nothing_observed_is_the_prior(self) -> None:
        world = random_world(8, 4)
        nothing = world.posterior(np.full((2, 4, 2), 99.0), np.zeros((2, 4), bool))
        np.testing.assert_allclose(nothing.mean, np.stack([world.mean] * 2))
        np.testing.assert_allclose(nothing.covariance, world.covariance[None])
        np.testing.assert_array_equal(world.prior(2).mean, nothing.mean)

    def test_the_value_of_a_hidden_keypoint_is_never_read(self) -> None:
        world = PoseWorld.person()
        scene = world.draw(np.random.default_rng(9), sequences=4, frames=2, hidden=0.5)
        filled = np.where(scene.observed[..., None], scene.keypoints, 1e9)
        first, second = (world.posterior(k, scene.observed) for k in (scene.keypoints, filled))
        np.testing.assert_array_equal(first.mean, second.mean)

    @settings(derandomize=True, max_examples=20, deadline=None)
    @given(worlds, st.integers(0, 10_000))
    def test_a_further_keypoint_never_makes_less_certain(self, world: PoseWorld, seed: int) -> None:
        rng = np.random.default_rng(seed)
        K = len(world.joints)
        observed = np.tile(rng.random(K) < 0.5, (2, 1))
        observed[1, rng.integers(K)] = True
        posterior = world.posterior(np.zeros((2, K, 2)), observed)
        fewer, more = posterior.covariance[posterior.pattern]
        gain = np.linalg.eigvalsh(fewer - more)
        assert gain.min() > -1e-8 * np.abs(fewer).max()

    def test_order_of_the_frames_does_not_matter(self) -> None:
        world = PoseWorld.person()
        scene = world.draw(np.random.default_rng(10), sequences=6, frames=3, hidden=0.5)
        order = np.random.default_rng(0).permutation(18)
        straight = world.posterior(scene.keypoints, scene.observed)
        shuffled = world.posterior(scene.keypoints[order], scene.observed[order])
        np.testing.assert_allclose(shuffled.mean, straight.mean[order])
        np.testing.assert_allclose(shuffled.log_prob(scene.truth[order]), straight.log_prob(scene.truth)[order])

    def test_min_mpjpe_of_one_isotropic_joint_is_that_of_the_quadrature(self) -> None:
        # The posterior's sd is 30 mm in each of three coordinates, for truth and hypotheses alike
        world = PoseWorld.independent_joints(("Spine",), sigma=30.0)
        seen = world.posterior(np.zeros((4000, 1, 3)), np.ones((4000, 1), bool))
        mean, error = seen.expected_min_mpjpe(20, np.random.default_rng(11))
        exact = best_of.expected_min_mpjpe(30.0, N=20, D=3, truth_sigma=30.0)
        np.testing.assert_allclose(mean, exact, rtol=0, atol=4 * error)


class TestIndependentJoints:
    def test_posterior_is_isotropic_and_the_same_for_every_joint(self) -> None:
        world = PoseWorld.independent_joints(sigma=25.0, prior_ratio=4.0)
        scene = world.draw(np.random.default_rng(0), sequences=1, frames=2)
        posterior = world.posterior(scene.keypoints, scene.observed)
        np.testing.assert_allclose(posterior.covariance[0], 625 * np.eye(48), atol=1e-9)
        np.testing.assert_allclose(world.covariance, 16 * 625 * np.eye(48))


class TestSequences:
    def test_errors_of_the_posterior_mean_are_correlated_as_asked(self) -> None:
        world = PoseWorld.person()
        scene = world.draw(np.random.default_rng(12), sequences=60, frames=60, correlation=0.9, hidden=0.3)
        posterior = world.posterior(scene.keypoints, scene.observed)
        error = (scene.truth - posterior.mean) / np.sqrt(
            np.diagonal(posterior.joint_covariance[posterior.pattern], axis1=-2, axis2=-1)
        )
        error = error.reshape(60, 60, -1)
        lagged = (error[:, 1:] * error[:, :-1]).mean(axis=(1, 2))  # one value for each independent sequence
        np.testing.assert_allclose(lagged.mean(), 0.9, atol=4 * lagged.std() / math.sqrt(60))

    def test_frames_are_independent_unless_asked(self) -> None:
        scene = PoseWorld.person().draw(np.random.default_rng(13), sequences=50, frames=40)
        wrist = (scene.truth - scene.truth.mean(axis=0))[:, -1].reshape(50, 40, 3)
        lagged = (wrist[:, 1:] * wrist[:, :-1]).mean(axis=(1, 2)) / (wrist**2).mean()
        np.testing.assert_allclose(lagged.mean(), 0, atol=4 * lagged.std() / math.sqrt(50))

    def test_every_other_sequence_shows_all_keypoints(self) -> None:
        scene = PoseWorld.person().draw(np.random.default_rng(14), sequences=200, frames=3, hidden=0.25)
        even = scene.sequence % 2 == 0
        assert scene.observed[even].all()
        share = 1 - scene.observed[~even].mean()
        np.testing.assert_allclose(share, 0.25, atol=4 * math.sqrt(0.25 * 0.75 / 1600))
        for number in range(200):
            assert (scene.observed[scene.sequence == number] == scene.observed[3 * number]).all()
        np.testing.assert_array_equal(np.isnan(scene.keypoints).all(axis=-1), ~scene.observed)

    def test_the_seed_decides_everything(self) -> None:
        first, second = (PoseWorld.person().draw(np.random.default_rng(15), hidden=0.3) for _ in range(2))
        np.testing.assert_array_equal(first.truth, second.truth)
        np.testing.assert_array_equal(first.keypoints, second.keypoints)


class TestRefusals:
    def test_a_loop_is_no_tree(self) -> None:
        bones, covariance = np.ones((2, 3)), np.tile(np.eye(3), (2, 1, 1))
        with pytest.raises(PoseDataError, match="joint a is its own ancestor; expected a tree"):
            PoseWorld(("a", "b"), (1, 0), bones, covariance, 1.0)

    def test_shapes_that_do_not_fit(self) -> None:
        with pytest.raises(PoseDataError, match=r"2 joints, 2 parents, bones \(3, 3\)"):
            PoseWorld(("a", "b"), (-1, 0), np.ones((3, 3)), np.ones((2, 3, 3)), 1.0)

    def test_a_rigid_bone_on_a_moving_joint(self) -> None:
        covariance = np.stack([np.eye(3), np.zeros((3, 3))])
        with pytest.raises(PoseDataError, match="bone of b: its covariance is singular"):
            PoseWorld(("a", "b"), (-1, 0), np.ones((2, 3)), covariance, 1.0)

    def test_a_camera_without_noise(self) -> None:
        with pytest.raises(PoseDataError, match=r"keypoint_sigma: 0\.0 mm; expected more than 0"):
            PoseWorld.person(keypoint_sigma=0.0)

    def test_a_world_that_does_not_move(self) -> None:
        with pytest.raises(PoseDataError, match="none of 1 joints moves"):
            PoseWorld(("a",), (-1,), np.ones((1, 3)), np.zeros((1, 3, 3)), 1.0)

    def test_keypoints_of_another_world(self) -> None:
        with pytest.raises(PoseDataError, match=r"keypoints \(5, 14, 2\), observed \(5, 14\); expected \(M, 16, 2\)"):
            PoseWorld.person().posterior(np.zeros((5, 14, 2)), np.ones((5, 14), bool))

    def test_observed_keypoints_that_are_not_there(self) -> None:
        with pytest.raises(PoseDataError, match="keypoints: some are not finite"):
            PoseWorld.person().posterior(np.full((1, 16, 2), np.nan), np.ones((1, 16), bool))

    def test_truths_of_another_shape(self) -> None:
        with pytest.raises(PoseDataError, match=r"truth \(3, 16, 3\); expected \(2, 16, 3\)"):
            PoseWorld.person().prior(2).log_prob(np.zeros((3, 16, 3)))

    def test_shares_that_are_none(self) -> None:
        with pytest.raises(PoseDataError, match=r"hidden 1\.5; expected"):
            PoseWorld.person().draw(np.random.default_rng(0), hidden=1.5)
