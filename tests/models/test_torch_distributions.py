"""Distributions of PyTorch, zuko and Pyro as estimators."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import stats
from torch import distributions

from posecal.errors import PoseDataError
from posecal_models.contract import Context, Estimator, PoseDistribution
from posecal_models.data.keypoint_set import KeypointSet
from posecal_models.sample import sample_to_file
from posecal_models.torch_distributions import from_torch

JOINTS = ("RKnee", "RFoot", "LHip")


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def gaussian(poses: int = 4) -> distributions.MultivariateNormal:
    factor = 10 * torch.eye(9) + random(9, 9).tril(-1)
    return distributions.MultivariateNormal(300 * random(poses, 9, seed=1), scale_tril=factor)


def mixture(poses: int = 4) -> distributions.MixtureSameFamily:
    """Of two components, with an event of shape (K, 3)."""
    means = torch.stack([random(poses, 3, 3), 100 + random(poses, 3, 3)], dim=1)
    components = distributions.Independent(distributions.Normal(means, 20.0), 2)
    return distributions.MixtureSameFamily(
        distributions.Categorical(torch.tensor([0.25, 0.75]).expand(poses, 2)), components
    )


def context(poses: int = 5) -> Context:
    return Context(100 * random(poses, 3, 2), torch.ones(poses, 3, dtype=torch.bool))


def test_a_gaussian_has_the_density_and_the_layout_of_its_coordinates():
    distribution, truth = gaussian(), 300 * random(4, 3, 3, seed=2)
    poses = from_torch(distribution, JOINTS)
    assert isinstance(poses, PoseDistribution)
    expected = [
        stats.multivariate_normal(mean, covariance).logpdf(x.flatten())
        for mean, covariance, x in zip(distribution.loc, distribution.covariance_matrix, truth, strict=True)
    ]
    np.testing.assert_allclose(poses.log_prob(truth), expected, rtol=1e-4)
    drawn = poses.sample(4000, generator=torch.Generator().manual_seed(0))
    assert drawn.shape == (4000, 4, 3, 3)
    np.testing.assert_allclose(drawn.mean(0), distribution.loc.view(4, 3, 3), atol=5 * 12 / np.sqrt(4000))


def test_a_mixture_draws_each_component_by_its_weight():
    poses = from_torch(mixture(), JOINTS)
    drawn = poses.sample(2000, generator=torch.Generator().manual_seed(0))
    share = (drawn.mean((2, 3)) > 50).double().mean(0)
    np.testing.assert_allclose(share, 0.75, atol=5 * np.sqrt(0.75 * 0.25 / 2000))
    assert poses.log_prob(drawn[0]).shape == (4,)


def test_a_generator_decides_the_draws_and_torch_s_own_state_stays():
    poses, generator = from_torch(gaussian(), JOINTS), torch.Generator()
    before = torch.get_rng_state()
    one, two = (poses.sample(3, generator=generator.manual_seed(5)) for _ in range(2))
    next_one = poses.sample(3, generator=generator)
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(one, two)
    assert not torch.equal(one, next_one)
    assert not torch.equal(poses.sample(3), poses.sample(3))  # without one, of torch's own


def test_a_function_of_the_context_is_an_estimator_that_is_sampled_into_a_file(tmp_path):
    seen = context(70)  # of more than one block
    estimator = from_torch(
        lambda given: distributions.Independent(distributions.Normal(given.keypoints.repeat(1, 1, 2)[..., :3], 1.0), 2),
        JOINTS,
    )
    assert isinstance(estimator, Estimator)
    assert estimator.keypoints == JOINTS
    keypoints = KeypointSet(
        keypoints=seen.keypoints.numpy(),
        observed=seen.observed.numpy(),
        sigma=np.ones((70, 3), np.float32),
        joints=JOINTS,
        frame_id=np.arange(70),
    )
    sample_to_file(estimator, keypoints, tmp_path / "hyps.npz", n=4)
    with np.load(tmp_path / "hyps.npz") as file:
        assert file["hypotheses"].shape == (70, 4, 4, 3)
        np.testing.assert_allclose(file["hypotheses"][:, :, 1:, :2].mean(1), seen.keypoints, atol=4)


@pytest.mark.parametrize(
    ("distribution", "words"),
    [
        (distributions.Normal(torch.zeros(4, 3, 3), 1.0), r"event shape \(\).*Independent\(distribution, 2\)"),
        (distributions.MultivariateNormal(torch.zeros(9), torch.eye(9)), r"batch shape \(\).*expand\(\(M,\)\)"),
        (
            distributions.MultivariateNormal(torch.zeros(4, 12), torch.eye(12)),
            r"expected \(M,\) and \(9,\) or",
        ),
        (torch.zeros(4, 9), "a Tensor; expected one of torch.distributions"),
    ],
    ids=["coordinates as poses", "one pose", "another joint", "no distribution"],
)
def test_what_is_no_distribution_of_poses_is_refused(distribution, words):
    with pytest.raises(PoseDataError, match=words):
        from_torch(distribution, JOINTS)


def test_what_a_function_returns_and_takes_is_checked():
    with pytest.raises(PoseDataError, match="of 4 poses; expected 5, one for each image"):
        from_torch(lambda _: gaussian(4), JOINTS)(context())
    with pytest.raises(PoseDataError, match="a Tensor; expected one of"):
        from_torch(lambda given: given.keypoints, JOINTS)(context())
    with pytest.raises(PoseDataError, match=r"expected \(M, 2, 2\)"):
        from_torch(lambda _: gaussian(5), JOINTS, JOINTS[:2])(context())
    with pytest.raises(PoseDataError, match="joints: RKnee given more than once"):
        from_torch(gaussian(), (*JOINTS, "RKnee"))
    with pytest.raises(PoseDataError, match=r"expected \(M, K, D\) = \(4, 3, 3\)"):
        from_torch(gaussian(), JOINTS).log_prob(torch.zeros(4, 9))


def test_a_flow_of_zuko_is_an_estimator():
    """In mm by an affine map of torch; its density is that of the flow's own, less the log of the scale."""
    zuko = pytest.importorskip("zuko")
    flow = zuko.flows.NSF(features=9, context=6, transforms=1, hidden_features=(8,))
    scale = distributions.AffineTransform(0.0, 200.0, event_dim=1)
    estimator = from_torch(
        lambda given: distributions.TransformedDistribution(flow(given.keypoints.flatten(1) / 100), scale), JOINTS
    )
    seen, truth = context(), 200 * random(5, 3, 3, seed=3)
    poses = estimator(seen)
    expected = flow(seen.keypoints.flatten(1) / 100).log_prob(truth.flatten(1) / 200) - 9 * np.log(200)
    np.testing.assert_allclose(poses.log_prob(truth).detach(), expected.detach(), rtol=1e-5)
    one, two = (poses.sample(6, generator=torch.Generator().manual_seed(1)) for _ in range(2))
    assert one.shape == (6, 5, 3, 3)
    assert torch.equal(one, two)


def test_a_distribution_of_pyro_is_one_of_poses():
    """Pyro's can be called, which draws; they are distributions all the same."""
    pyro = pytest.importorskip("pyro.distributions")
    poses = from_torch(pyro.MultivariateNormal(torch.zeros(4, 9), torch.eye(9)), JOINTS)
    assert poses.sample(2, generator=torch.Generator().manual_seed(0)).shape == (2, 4, 3, 3)
