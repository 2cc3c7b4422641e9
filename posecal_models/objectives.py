"""What are the estimators trained to do? One interface for all losses, and those of the two baselines."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.cgnf.model import CGNF
from posecal_models.cgnf.objective import FlowObjective
from posecal_models.config import TrainConfig
from posecal_models.contract import Context
from posecal_models.estimators import ReferenceEstimator
from posecal_models.gaussian_noise import GaussianNoise
from posecal_models.simple_baseline import SimpleBaseline
from posecal_models.whole_batch import drawn

__all__ = ["BestOfN", "Likelihood", "Objective", "SquaredError", "objective_of"]


class Objective(Protocol):
    """A training loss, a mean over the poses of a batch."""

    def initialise(self, context: Context, truth: Tensor) -> None:
        """Prepare the estimator with a first batch."""
        ...

    def backward(
        self, context: Context, truth: Tensor, *, generator: torch.Generator, graphs_per_pose: int = 1
    ) -> dict[str, Tensor]:
        """Add the batch's gradients to the parameters; give the losses, ``loss`` among them, lower is better."""
        ...

    def evaluate(self, context: Context, truth: Tensor, *, generator: torch.Generator) -> dict[str, Tensor]:
        """Give the losses without gradients."""
        ...


class _Plain:
    """An objective whose gradient is a single backward pass."""

    def initialise(self, context: Context, truth: Tensor) -> None:
        """Do nothing: there is nothing to prepare."""

    def backward(
        self, context: Context, truth: Tensor, *, generator: torch.Generator, graphs_per_pose: int = 1
    ) -> dict[str, Tensor]:
        """Add the batch's gradients to the parameters and give the loss."""
        del graphs_per_pose
        loss = self.loss(context, truth, generator)
        torch.autograd.backward(loss)
        return {"loss": loss.detach()}

    @torch.no_grad()
    def evaluate(self, context: Context, truth: Tensor, *, generator: torch.Generator) -> dict[str, Tensor]:
        """Give the loss without gradients."""
        return {"loss": self.loss(context, truth, generator)}

    def loss(self, context: Context, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch, a scalar."""
        raise NotImplementedError


class SquaredError(_Plain):
    r"""The mean squared error of standardised poses, unitless.

    .. math:: \frac{1}{3 M K} \sum \left( \hat x - x \right)^2

    Parameters
    ----------
    estimator : SimpleBaseline
        What is trained.
    """

    def __init__(self, estimator: SimpleBaseline) -> None:
        self.estimator = estimator

    def loss(self, context: Context, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch, a scalar."""
        del generator
        poses = self.estimator.standardizer.poses(truth)
        return torch.mean((self.estimator.standardised(context) - poses).square())


class Likelihood(_Plain):
    """The negative log density, nats per pose in mm.

    Parameters
    ----------
    estimator : GaussianNoise
        What is trained.
    """

    def __init__(self, estimator: GaussianNoise) -> None:
        self.estimator = estimator

    def loss(self, context: Context, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch, a scalar."""
        del generator
        return -torch.mean(self.estimator(context).log_prob(truth))


class BestOfN(_Plain):
    r"""The error of the best of N hypotheses, in mm: what the paper warns of.

    .. math:: \min_n \frac1K \sum_k \lVert \hat x_{nk} - x_k \rVert

    Parameters
    ----------
    estimator : GaussianNoise
        What is trained.
    hypotheses : int
        N.
    """

    def __init__(self, estimator: GaussianNoise, hypotheses: int = 200) -> None:
        self.estimator = estimator
        self.hypotheses = hypotheses

    def loss(self, context: Context, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch, a scalar."""
        around = self.estimator(context)
        mean: Tensor = around.mean

        def draw(poses: int) -> Tensor:
            shape = (self.hypotheses, poses, *mean.shape[1:])
            return torch.randn(shape, generator=generator, device=mean.device, dtype=mean.dtype)

        poses = mean + around.sigma * drawn(draw, len(mean), axis=1)
        errors = torch.mean(torch.linalg.vector_norm(poses - truth, dim=-1), dim=-1)
        return torch.mean(torch.amin(errors, dim=0))


def objective_of(estimator: ReferenceEstimator, config: TrainConfig) -> Objective:
    """Give the objective that a configuration names.

    Parameters
    ----------
    estimator : CGNF, SimpleBaseline or GaussianNoise
        What is trained.
    config : TrainConfig
        How.

    Returns
    -------
    Objective
        Its loss.

    Raises
    ------
    PoseDataError
        Where the estimator can't be trained so.
    """
    if isinstance(estimator, CGNF) and config.objective == "likelihood":
        return FlowObjective(
            estimator,
            sample_weight=config.sample_weight,
            per_node=config.loss_per == "node",
            sample_loss=config.sample_loss,
        )
    if isinstance(estimator, SimpleBaseline) and config.objective == "squared-error":
        return SquaredError(estimator)
    if isinstance(estimator, GaussianNoise) and config.objective == "likelihood":
        return Likelihood(estimator)
    if isinstance(estimator, GaussianNoise) and config.objective == "min-mpjpe":
        return BestOfN(estimator, config.hypotheses)
    raise PoseDataError(
        f"train.objective: {config.objective} of a {type(estimator).__name__}; expected likelihood of a cGNF, "
        "squared-error of a SimpleBaseline, likelihood or min-mpjpe of a Gaussian noise model."
    )
