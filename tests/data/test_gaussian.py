"""Draws from stated Gaussians have their moments, and their log densities are those of SciPy."""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

import posecal
from posecal.data.gaussian import GaussianPrediction, starting_at
from posecal.data.root import Root
from posecal.errors import PoseDataError

Array = npt.NDArray[np.float64]
M, K, D = 6, 4, 3


def random_covariances(seed: int, *shape: int) -> Array:
    """Covariances of a condition number that is not large, (..., n, n)."""
    roots = np.random.default_rng(seed).normal(0, 20, shape)
    return roots @ roots.swapaxes(-1, -2) / shape[-1] + 90 * np.eye(shape[-1])


def world(seed: int = 0, c: int | None = None) -> tuple[Array, Array]:
    """True poses and means (C, M, K, D), or (M, K, D)."""
    random = np.random.default_rng(seed)
    truth = random.normal(0, 100, (M, K, D))
    return truth, truth + random.normal(0, 20, (M, K, D) if c is None else (c, M, K, D))


def normal(truth: Array, mean: Array, covariance: Array) -> Array:
    """Log densities of poses (M, n) by SciPy."""
    return np.array([multivariate_normal(m, s).logpdf(y) for y, m, s in zip(truth, mean, covariance, strict=True)])


# --- log densities


def test_the_density_of_a_covariance_of_the_whole_pose_is_scipy_s() -> None:
    truth, mean = world()
    covariance = random_covariances(1, M, K * D, K * D)
    found = GaussianPrediction(mean, covariance).log_prob(truth)
    np.testing.assert_allclose(found, normal(truth.reshape(M, -1), mean.reshape(M, -1), covariance))


def test_the_density_of_covariances_of_joints_is_the_product_of_theirs() -> None:
    truth, mean = world()
    covariance = random_covariances(2, M, K, D, D)
    of_joints = [normal(truth[:, k], mean[:, k], covariance[:, k]) for k in range(K)]
    np.testing.assert_allclose(GaussianPrediction(mean, covariance).log_prob(truth), np.sum(of_joints, axis=0))


@pytest.mark.parametrize("shape", [(M, K), (M, K, D)])
def test_the_density_of_deviations_is_that_of_their_squares_as_covariance(shape: tuple[int, ...]) -> None:
    truth, mean = world()
    sigma = np.random.default_rng(3).uniform(5, 40, shape)
    squares = (sigma if sigma.ndim == 3 else np.repeat(sigma[..., None], D, axis=-1)) ** 2
    expected = GaussianPrediction(mean, squares[..., None] * np.eye(D)).log_prob(truth)
    np.testing.assert_allclose(GaussianPrediction(mean, sigma=sigma).log_prob(truth), expected)


def test_the_density_of_a_mixture_is_the_weighted_sum_of_its_components() -> None:
    truth, mean = world(c=3)
    sigma = np.random.default_rng(4).uniform(5, 40, (3, M, K))
    weights = np.random.default_rng(5).dirichlet([1, 2, 3], M).T
    weights[:, 0] = [0, 0.25, 0.75]  # one component does not count
    components = [GaussianPrediction(mean[c], sigma=sigma[c]).log_prob(truth) for c in range(3)]
    expected = logsumexp(components, b=weights, axis=0)
    np.testing.assert_allclose(GaussianPrediction(mean, sigma=sigma, mixture_weights=weights).log_prob(truth), expected)


@pytest.mark.parametrize("far", [1e4, 1e6])
@pytest.mark.parametrize("weight", [0.5, 1e-6, 1e-300])
def test_the_density_of_modes_far_apart_is_exact_whatever_their_weights(far: float, weight: float) -> None:
    truth, mean = world(c=3)
    mean[1], mean[2] = mean[1] + far, mean[2] - far
    sigma, weights = np.full((3, M, K), 20.0), np.repeat([[weight], [(1 - weight) / 2], [(1 - weight) / 2]], M, axis=1)
    terms = [normal(truth.reshape(M, -1), m.reshape(M, -1), [400 * np.eye(K * D)] * M) for m in mean]
    found = GaussianPrediction(mean, sigma=sigma, mixture_weights=weights).log_prob(truth)
    np.testing.assert_allclose(found, logsumexp(terms, b=weights, axis=0), rtol=1e-12)
    nowhere = GaussianPrediction(mean + 4e6, sigma=sigma, mixture_weights=weights).log_prob(truth)
    assert (np.isfinite(nowhere) & (nowhere < -1e9)).all()


@pytest.mark.parametrize("nothing", [0.0, np.nan])
@pytest.mark.parametrize("kind", ["sigma", "covariance", "full"])
def test_a_component_of_weight_0_may_be_anything(kind: str, nothing: float) -> None:
    truth, mean = world(c=2)
    shapes = {"sigma": (M, K), "covariance": (M, K, D, D), "full": (M, K * D, K * D)}
    spread = np.full((M, K), 20.0) if kind == "sigma" else random_covariances(15, *shapes[kind])
    spreads, weights = np.stack([spread, spread]), np.repeat([[0.0], [1.0]], M, axis=1)
    weights[:, 2] = 1, 0
    mean[0, np.arange(M) != 2] = mean[1, 2] = nothing
    spreads[0, np.arange(M) != 2] = spreads[1, 2] = nothing
    word, one = "sigma" if kind == "sigma" else "covariance", mean[1].copy()
    one[2] = mean[0, 2]
    padded = GaussianPrediction(mean, **{word: spreads}, mixture_weights=weights)
    alone = GaussianPrediction(one, **{word: spread})
    np.testing.assert_allclose(padded.log_prob(truth), alone.log_prob(truth))
    np.testing.assert_array_equal(padded.sample(5, seed=2), alone.sample(5, seed=2))


def turn_to_root(root: int) -> Array:
    """From all coordinates to those of the other joints relative to one, (KD - D, KD)."""
    relative = np.eye(K) - np.eye(K)[root]
    return np.kron(np.delete(relative, root, axis=0), np.eye(D))


def test_relative_to_a_joint_the_density_is_that_of_the_differences() -> None:
    truth, mean = world()
    covariance, turn = random_covariances(6, M, K * D, K * D), turn_to_root(2)
    moved = (poses.reshape(M, -1) @ turn.T for poses in (truth, mean))
    expected = normal(*moved, turn @ covariance @ turn.T)
    np.testing.assert_allclose(GaussianPrediction(mean, covariance).log_prob(truth, root=2), expected)


@pytest.mark.parametrize("kind", ["sigma", "covariance", "full"])
@pytest.mark.parametrize("nothing", [0.0, np.nan])
def test_a_root_that_does_not_move_leaves_the_others_as_they_are(kind: str, nothing: float) -> None:
    truth, mean = world()
    mean[:, 1] = nothing
    others = [0, 2, 3]
    sigma = np.random.default_rng(7).uniform(5, 40, (M, K))
    covariance = random_covariances(8, M, K, D, D)
    full = random_covariances(9, M, K * D, K * D)
    sigma[:, 1] = covariance[:, 1] = nothing
    full[:, 3:6] = full[:, :, 3:6] = nothing
    given = {"sigma": {"sigma": sigma}, "covariance": {"covariance": covariance}, "full": {"covariance": full}}[kind]
    rest = {"sigma": {"sigma": sigma[:, others]}, "covariance": {"covariance": covariance[:, others]}}
    rest["full"] = {"covariance": np.delete(np.delete(full, [3, 4, 5], axis=1), [3, 4, 5], axis=2)}
    truth[:, 1] = 0
    expected = GaussianPrediction(mean[:, others], **rest[kind]).log_prob(truth[:, others])
    np.testing.assert_allclose(GaussianPrediction(mean, **given).log_prob(truth, root=1), expected)


def test_with_a_root_for_each_part_the_density_is_that_of_each_part() -> None:
    truth, mean = world()
    sigma = np.random.default_rng(10).uniform(5, 40, (M, K))
    prediction, rows = GaussianPrediction(mean, sigma=sigma), np.arange(M)
    root = Root(((0,), (2,)), (0, 0, 1, 1))
    found = prediction.log_density(truth, rows, np.arange(K), root, rows.astype(str).tolist())
    parts = [slice(0, 2), slice(2, 4)]
    expected = [GaussianPrediction(mean[:, p], sigma=sigma[:, p]).log_prob(truth[:, p], root=0) for p in parts]
    np.testing.assert_allclose(found, np.sum(expected, axis=0))


def test_some_frames_and_joints_have_their_marginal_density() -> None:
    truth, mean = world()
    covariance = random_covariances(11, M, K * D, K * D)
    rows, columns = np.array([4, 0, 1, 5]), np.array([3, 1])
    places = (columns[:, None] * D + np.arange(D)).ravel()
    expected = normal(
        truth[rows][:, columns].reshape(4, -1),
        mean[rows][:, columns].reshape(4, -1),
        covariance[rows][:, places[:, None], places],
    )
    prediction = GaussianPrediction(mean, covariance)
    np.testing.assert_allclose(
        prediction.log_density(truth[rows][:, columns], rows, columns, None, rows.astype(str).tolist()), expected
    )


def test_frames_are_read_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    truth, mean = world()
    prediction = GaussianPrediction(mean, random_covariances(12, M, K * D, K * D))
    whole = prediction.log_prob(truth)
    monkeypatch.setattr("posecal.data.gaussian._BLOCK", 2 * (K * D) ** 2)
    np.testing.assert_array_equal(prediction.log_prob(truth), whole)


# --- draws


@pytest.mark.parametrize("kind", ["sigma", "covariance", "full"])
def test_draws_have_the_stated_mean_and_covariance(kind: str) -> None:
    _, mean = world()
    n = 20_000
    covariance = random_covariances(13, M, K * D, K * D)
    if kind != "full":
        covariance *= np.kron(np.eye(K), np.ones((D, D))) if kind == "covariance" else np.eye(K * D)
    blocks = np.stack([covariance[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(K)], axis=1)
    deviations = np.sqrt(np.diagonal(blocks, axis1=-2, axis2=-1))
    given = {"sigma": {"sigma": deviations}, "covariance": {"covariance": blocks}, "full": {"covariance": covariance}}
    drawn = GaussianPrediction(mean, **given[kind]).sample(n, seed=3)
    assert drawn.shape == (n, M, K, D)
    scale = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    z = (drawn.mean(axis=0) - mean).reshape(M, -1) / scale * np.sqrt(n)
    assert np.abs(z).max() < 4.5  # of 72 standard normal numbers
    for m in range(M):
        off = (np.cov(drawn[:, m].reshape(n, -1).T) - covariance[m]) / np.outer(scale[m], scale[m])
        assert np.abs(off).max() < 5 * np.sqrt(2 / n)


def test_components_are_drawn_by_their_weights() -> None:
    mean = np.array([-1000.0, 0, 1000])[:, None, None, None] * np.ones((3, M, K, D))
    weights = np.repeat([[0.2], [0.5], [0.3]], M, axis=1)
    drawn = GaussianPrediction(mean, sigma=np.ones((3, M, K)), mixture_weights=weights).sample(5000, seed=1)
    component = np.round(drawn / 1000).astype(int)
    assert (component == component[:, :, :1, :1]).all()  # of the whole pose
    for c in (-1, 0, 1):
        share, expected = (component[:, :, 0, 0] == c).mean(axis=0), weights[c + 1]
        assert (np.abs(share - expected) < 4.5 * np.sqrt(expected * (1 - expected) / 5000)).all()


def test_draws_depend_on_the_seed_and_the_frame_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    _, mean = world(c=2)
    weights = np.full((2, M), 0.5)
    prediction = GaussianPrediction(mean, sigma=np.full((2, M, K), 9.0), mixture_weights=weights)
    drawn = prediction.sample(7, seed=4)
    np.testing.assert_array_equal(prediction.sample(7, seed=4), drawn)
    np.testing.assert_array_equal(prediction.sample(3, seed=4), drawn[:3])  # the first of many
    np.testing.assert_array_equal(prediction.sample_frames(2, 5, 7, 4), drawn[:, 2:5])
    assert (prediction.sample(7, seed=5) != drawn).all()
    monkeypatch.setattr("posecal.data.gaussian._DRAWN", 2 * 7 * K * D)  # two frames at a time
    np.testing.assert_array_equal(prediction.sample(7, seed=4), drawn)
    later = GaussianPrediction(mean[:, 2:], sigma=np.full((2, M - 2, K), 9.0), mixture_weights=weights[:, 2:])
    np.testing.assert_array_equal(starting_at(later, 2).sample(7, seed=4), drawn[:, 2:])
    same = GaussianPrediction(np.zeros((M, K, D)), sigma=np.ones((M, K))).sample(7)
    assert len(np.unique(same)) == same.size  # no two frames have the same numbers


def test_a_joint_that_does_not_move_is_drawn_at_its_mean() -> None:
    _, mean = world()
    sigma = np.ones((M, K))
    sigma[:, 2] = 0
    sigma[:, 3] = np.nan
    mean[:, 3] = np.nan
    drawn = GaussianPrediction(mean, sigma=sigma).sample(5)
    assert (drawn[:, :, 2] == mean[:, 2]).all()
    assert (drawn[:, :, 3] == 0).all()


def test_draws_are_as_precise_as_the_means() -> None:
    _, mean = world()
    assert GaussianPrediction(mean.astype("f4"), sigma=np.ones((M, K))).sample(2).dtype == np.float32
    assert GaussianPrediction(mean, sigma=np.ones((M, K), "f4")).sample(2).dtype == np.float64


# --- what does not fit


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, r"^covariance and sigma: neither given; expected one of them\.$"),
        ({"covariance": np.ones((M, K, D, D)), "sigma": np.ones((M, K))}, "both given"),
        ({"sigma": np.ones((M, D))}, r"^sigma \(6, 3\); expected \(6, 4\) or \(6, 4, 3\) beside a mean \(6, 4, 3\)\.$"),
        ({"covariance": np.ones((M, K, D))}, r"expected \(6, 12, 12\) or \(6, 4, 3, 3\)"),
        ({"sigma": np.ones((M, K)), "mixture_weights": np.ones((1, M))}, r"^mean \(6, 4, 3\); expected \(C, M, K, D\)"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(given: dict[str, Array], message: str) -> None:
    with pytest.raises(PoseDataError, match=message):
        GaussianPrediction(np.zeros((M, K, D)), **given)


def test_weights_that_are_none_are_refused_with_the_first_frames() -> None:
    weights = np.full((2, M), 0.5)
    weights[0, 1], weights[:, 4] = 0.6, [-0.5, 1.5]
    make = {"mean": np.zeros((2, M, K, D)), "sigma": np.ones((2, M, K))}
    with pytest.raises(
        PoseDataError, match=r"^mixture_weights: below 0, or not of sum 1, in 2 of 6 frames \(first: 1, 4"
    ):
        GaussianPrediction(**make, mixture_weights=weights)
    with pytest.raises(PoseDataError, match=r"^mixture_weights \(6, 2\); expected \(C, M\) = \(2, 6\)\.$"):
        GaussianPrediction(**make, mixture_weights=weights.T)


@pytest.mark.parametrize("kind", ["covariance", "full"])
def test_covariances_that_are_none_are_refused_with_the_first_frames(kind: str) -> None:
    truth, mean = world()
    size = D if kind == "covariance" else K * D
    shape = (M, K, D, D) if kind == "covariance" else (M, size, size)
    covariance = np.broadcast_to(np.eye(size), shape).copy()
    covariance[1, ..., 0, 1] = 0.5  # not symmetric
    covariance[3, ..., 0, 1] = covariance[3, ..., 1, 0] = 1.5  # a correlation above 1
    covariance[4, ..., 2, 2] = np.inf
    prediction = GaussianPrediction(mean, covariance)
    message = (
        r"^covariance: not symmetric and positive definite in 3 of 6 frames \(first: 1, 3, 4\); expected so of every"
    )
    with pytest.raises(PoseDataError, match=message):
        prediction.log_prob(truth)
    with pytest.raises(PoseDataError, match=message):
        prediction.sample(2)
    assert np.isfinite(GaussianPrediction(mean[[0, 2, 5]], covariance[[0, 2, 5]]).log_prob(truth[[0, 2, 5]])).all()


@pytest.mark.parametrize("ridge", [0, 1e-14])
def test_covariances_of_coordinates_that_follow_from_others_are_refused_whatever_rounding_says(ridge: float) -> None:
    """Of 40 products that are singular some have a Cholesky factor by rounding."""
    roots = np.random.default_rng(0).normal(0, 20, (40, 6, 6))
    roots[:, 3:] = -roots[:, :3]
    singular = roots @ roots.swapaxes(1, 2)
    singular *= 1 + ridge * np.eye(6)
    with pytest.raises(PoseDataError, match=r"^covariance: not symmetric and positive definite in 40 of 40 frames"):
        GaussianPrediction(np.zeros((40, 2, 3)), singular).log_prob(np.zeros((40, 2, 3)))


def test_whether_a_covariance_is_refused_depends_on_no_other_frame_and_no_unit() -> None:
    covariance = np.repeat(np.diag([1e-8, 1.0, 1e6])[None, None], 2, axis=0)
    prediction = GaussianPrediction(np.zeros((2, 1, 3)), covariance)
    density = -(3 * np.log(2 * np.pi) + np.log(1e-2)) / 2
    np.testing.assert_allclose(prediction.log_prob(np.zeros((2, 1, 3))), density)
    covariance[1, 0, 1, 1] = -1
    with pytest.raises(PoseDataError, match=r"in 1 of 2 frames \(first: 1\)"):
        GaussianPrediction(np.zeros((2, 1, 3)), covariance).log_prob(np.zeros((2, 1, 3)))


def test_means_that_are_not_finite_are_refused_where_the_joint_moves() -> None:
    truth, mean = world(c=2)
    mean[1, 3, 2, 0] = np.nan
    sigma, weights = np.full((2, M, K), 9.0), np.full((2, M), 0.5)
    prediction = GaussianPrediction(mean, sigma=sigma, mixture_weights=weights)
    message = r"^mean: not finite in 1 of 6 frames \(first: 3\); expected so of every joint but the root\.$"
    with pytest.raises(PoseDataError, match=message):
        prediction.log_prob(truth)
    with pytest.raises(PoseDataError, match=message):
        prediction.sample(2)
    sigma[:, 3, 2] = 0
    assert np.isfinite(GaussianPrediction(mean, sigma=sigma, mixture_weights=weights).log_prob(truth[:], root=2)).all()


def test_deviations_that_are_none_are_refused() -> None:
    truth, mean = world()
    sigma = np.ones((M, K))
    sigma[2, 1], sigma[5, 0] = -1, np.inf
    with pytest.raises(PoseDataError, match=r"^sigma: not above 0 in 2 of 6 frames \(first: 2, 5\)"):
        GaussianPrediction(mean, sigma=sigma).log_prob(truth)
    with pytest.raises(PoseDataError, match=r"^sigma: not above 0 in 2 of 6 frames"):
        GaussianPrediction(mean, sigma=sigma).sample(3)


def test_every_coordinate_of_a_joint_needs_a_deviation() -> None:
    truth, mean = world()
    sigma = np.ones((M, K, D))
    sigma[2, 1, 0], sigma[4, 3, 2] = -1, 0
    with pytest.raises(PoseDataError, match=r"^sigma: not above 0 in 2 of 6 frames \(first: 2, 4\)"):
        GaussianPrediction(mean, sigma=sigma).log_prob(truth)


def test_frames_of_a_part_are_named_by_their_own_numbers() -> None:
    sigma = np.full((60, 2), 30.0)
    sigma[50] = -1
    prediction = GaussianPrediction(np.zeros((60, 2, 3)), sigma=sigma)
    with pytest.raises(PoseDataError, match=r"^sigma: not above 0 in 1 of 10 frames \(first: 50\)"):
        prediction.sample_frames(45, 55, 5, 0)
    assert prediction.sample_frames(0, 50, 5, 0).shape == (5, 50, 2, 3)


def test_a_joint_without_spread_that_is_not_the_root_has_no_density() -> None:
    truth, mean = world()
    sigma = np.ones((M, K))
    sigma[:, 2] = 0
    prediction = GaussianPrediction(mean, sigma=sigma)
    with pytest.raises(PoseDataError, match=r"in 6 of 6 frames .* of every joint but the root"):
        prediction.log_prob(truth)
    assert np.isfinite(prediction.log_prob(truth, root=2)).all()


def test_rounded_covariances_are_symmetric_enough() -> None:
    truth, mean = world()
    covariance = random_covariances(14, M, K * D, K * D)
    rounded = covariance.astype(np.float32) * (1 + 1e-6 * np.random.default_rng(0).normal(size=covariance.shape))
    found = GaussianPrediction(mean, rounded).log_prob(truth)
    np.testing.assert_allclose(found, GaussianPrediction(mean, covariance).log_prob(truth), rtol=1e-4)


def test_other_shapes_of_the_truth_are_refused() -> None:
    _, mean = world()
    with pytest.raises(PoseDataError, match=r"^truth \(6, 4\); expected \(M, K, D\) = \(6, 4, 3\)\.$"):
        GaussianPrediction(mean, sigma=np.ones((M, K))).log_prob(mean[..., 0])


def test_it_says_its_sizes() -> None:
    prediction = posecal.GaussianPrediction(
        np.zeros((2, M, K, D)), sigma=np.ones((2, M, K)), mixture_weights=np.full((2, M), 0.5)
    )
    assert repr(prediction) == "GaussianPrediction(C=2, M=6, K=4, D=3)"
