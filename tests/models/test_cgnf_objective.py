"""The cGNF's training loss: its formula, and one prior for the graphs of a pose."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.estimators.cgnf.flow import FlowSize
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.objectives import FlowLikelihood

GRAPHS = 11


def estimator() -> CGNF:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = CGNF(FlowSize(blocks=4, hidden=6, context=3, embedding=5)).double()
        for parameter in model.parameters():
            parameter.data = torch.randn_like(parameter) * 0.12
    model.standardizer.pose_scale.fill_(250.0)
    model.standardizer.keypoint_scale.fill_(70.0)
    return model


def batch(poses: int = GRAPHS) -> tuple[Context, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    keypoints = 70 * torch.randn(poses, 16, 2, generator=generator, dtype=torch.float64)
    observed = torch.rand(poses, 16, generator=generator) < 0.7
    return Context(keypoints, observed), 250 * torch.randn(poses, 16, 3, generator=generator, dtype=torch.float64)


def backward(objective: FlowLikelihood, *batch, **options) -> dict[str, torch.Tensor]:
    losses = objective(*batch, **options)
    losses["loss"].backward()
    return {name: loss.detach() for name, loss in losses.items()}


def gradients(model: CGNF) -> dict[str, torch.Tensor]:
    return {name: p.grad.clone() for name, p in model.named_parameters()}


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"sample_weight": 0.1}, {"per_node": True}])
def test_the_loss_is_the_formula_and_its_gradient_autograd_s(options):
    model, (context, truth) = estimator(), batch()
    posterior = -model(context).log_prob(truth).mean() - model.standardizer.log_determinant
    prior = -model.prior(GRAPHS).log_prob(truth).mean() - model.standardizer.log_determinant
    loss = 0.5 * (posterior + prior) / (16 if options.get("per_node") else 1)
    if options.get("sample_weight"):
        error = (model(context).mode() - truth).norm(dim=-1).mean()
        loss = loss + 0.1 * error
    expected = torch.autograd.grad(loss, list(model.parameters()), materialize_grads=True)
    losses = backward(FlowLikelihood(model, **options), context, truth)
    np.testing.assert_allclose(losses["loss"], loss.detach(), rtol=1e-12)
    np.testing.assert_allclose(losses["posterior"], posterior.detach(), rtol=1e-12)
    np.testing.assert_allclose(losses["prior"], prior.detach(), rtol=1e-12)
    for (name, found), wanted in zip(gradients(model).items(), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-10, err_msg=name)


def test_graphs_of_one_pose_share_its_prior():
    one, other, (context, truth) = estimator(), estimator(), batch(4)
    rows = torch.arange(4).repeat_interleave(3)
    context = Context(context.keypoints[rows], torch.rand(12, 16, generator=torch.Generator().manual_seed(5)) < 0.5)
    backward(FlowLikelihood(one), context, truth[rows], graphs_per_pose=1)
    losses = backward(FlowLikelihood(other), context, truth[rows], graphs_per_pose=3)
    for (name, found), wanted in zip(gradients(other).items(), gradients(one).values(), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-10, err_msg=name)
    assert math.isfinite(losses["loss"])


def test_a_negative_weight_is_refused():
    with pytest.raises(PoseDataError, match="sample_weight: -1; expected 0 or more"):
        FlowLikelihood(estimator(), sample_weight=-1)
