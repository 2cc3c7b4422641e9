"""SimpleBaseline against numbers of the public PyTorch code (tests/fixtures/reference_models/README.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models.contract import Context, PointEstimate
from posecal_models.estimators.simple_baseline import SimpleBaseline, from_public
from posecal_models.objectives import SquaredError

FOLDER = Path(__file__).parents[1] / "fixtures" / "reference_models"
SIXTEEN = tuple(f"joint {k}" for k in range(16))


@pytest.fixture(scope="module")
def numbers() -> dict[str, np.ndarray]:
    with np.load(FOLDER / "sb_tiny_io.npz") as file:
        return {name: file[name] for name in file.files}


def baseline(**options) -> SimpleBaseline:
    with np.load(FOLDER / "sb_tiny_state.npz") as file:
        state = {name: torch.from_numpy(file[name]) for name in file.files}
    estimator = SimpleBaseline(SIXTEEN[1:], SIXTEEN, width=16, origin="none", **options)
    missing, unexpected = estimator.load_state_dict(from_public(state), strict=False)
    assert not unexpected
    assert all(name.startswith("standardizer.") for name in missing)
    return estimator


def context(numbers, dtype=torch.float32) -> Context:
    keypoints = torch.from_numpy(numbers["x"]).to(dtype).unflatten(1, (16, 2))
    return Context(keypoints, torch.ones(keypoints.shape[:2], dtype=torch.bool))


@pytest.mark.parametrize(("dtype", "suffix", "tolerance"), [(torch.float64, "_f64", 1e-10), (torch.float32, "", 1e-6)])
def test_the_estimate_equals_the_reference(numbers, dtype, suffix, tolerance):
    estimator = baseline().to(dtype).eval()
    ours = estimator.standardised_poses(context(numbers, dtype)).flatten(1).detach()
    np.testing.assert_allclose(ours, numbers[f"eval_out{suffix}"], rtol=0, atol=tolerance)


def test_a_training_pass_without_dropout_equals_the_reference(numbers):
    estimator = baseline(dropout=0.0).train()
    truth = torch.from_numpy(numbers["y"]).unflatten(1, (15, 3))
    loss = SquaredError(estimator)(context(numbers), truth)["loss"]
    loss.backward()
    np.testing.assert_allclose(loss.detach(), numbers["train_nodrop_loss"], rtol=1e-6)
    norm = torch.sqrt(sum(p.grad.square().sum() for p in estimator.parameters()))
    np.testing.assert_allclose(norm, numbers["grad_norm_before_clip"], rtol=1e-5)


def test_the_paper_s_size_has_the_paper_s_number_of_parameters():
    estimator = SimpleBaseline(SIXTEEN[1:], SIXTEEN)
    assert sum(p.numel() for p in estimator.parameters()) == 4_288_557


def test_it_returns_a_point_in_mm_and_refuses_a_density(numbers):
    estimator = baseline().eval()
    estimator.standardizer.pose_scale.fill_(100.0)
    estimate = estimator(context(numbers))
    assert isinstance(estimate, PointEstimate)
    np.testing.assert_allclose(estimate.pose.detach().flatten(1), 100 * numbers["eval_out"], rtol=1e-5, atol=1e-3)
    with pytest.raises(PoseDataError, match="a point estimate has no density"):
        estimate.log_prob(estimate.pose)


def test_a_keypoint_that_is_not_a_number_is_refused(numbers):
    broken = context(numbers)
    broken.keypoints[2, 3, 0] = torch.nan
    with pytest.raises(PoseDataError, match=r"1 of 96 are not finite; SimpleBaseline reads every keypoint"):
        baseline().eval()(broken)


def test_a_state_dict_of_something_else_is_refused():
    with pytest.raises(PoseDataError, match=r"conv1\.weight is not part of a SimpleBaseline"):
        from_public({"conv1.weight": torch.zeros(1)})
