"""Training objectives: their interface, and those of the two baselines."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.batch_shard import draw_rows
from posecal_models.config import TrainConfig
from posecal_models.contract import Context
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.estimators.cgnf.objective import FlowObjective
from posecal_models.estimators.gaussian_noise import GaussianNoise
from posecal_models.estimators.registry import ReferenceEstimator
from posecal_models.estimators.simple_baseline import SimpleBaseline

__all__ = ["BestOfN", "Likelihood", "Objective", "SquaredError", "build_objective"]


class Objective(Protocol):
    """A training loss, a mean over the poses of a batch."""

    def initialise(self, context: Context, truth: Tensor) -> None:
        """Initialise the estimator with a first batch."""
        ...

    def backward(
        self, context: Context, truth: Tensor, *, generator: torch.Generator, graphs_per_pose: int = 1
    ) -> dict[str, Tensor]:
        """Add the batch's gradients to those of the parameters; return the losses, ``loss`` among them, to minimise."""
        ...

    def evaluate(self, context: Context, truth: Tensor, *, generator: torch.Generator) -> dict[str, Tensor]:
        """Compute the losses without gradients."""
        ...


class _SingleLoss:
    """An objective of one loss, whose gradient is a single backward pass."""

    def initialise(self, context: Context, truth: Tensor) -> None:
        """Do nothing: no initialisation is needed."""

    def backward(
        self, context: Context, truth: Tensor, *, generator: torch.Generator, graphs_per_pose: int = 1
    ) -> dict[str, Tensor]:
        """Add the batch's gradients to those of the parameters and return the loss."""
        del graphs_per_pose
        loss = self.loss(context, truth, generator)
        torch.autograd.backward(loss)
        return {"loss": loss.detach()}

    @torch.no_grad()
    def evaluate(self, context: Context, truth: Tensor, *, generator: torch.Generator) -> dict[str, Tensor]:
        """Compute the loss without gradients."""
        return {"loss": self.loss(context, truth, generator)}

    def loss(self, context: Context, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Compute the loss of a batch, a scalar."""
        raise NotImplementedError


class SquaredError(_SingleLoss):
    r"""The mean squared error of standardised poses, unitless.

    .. math:: \frac{1}{3 M K} \sum \left( \hat x - x \right)^2

    Parameters
    ----------
    estimator : SimpleBaseline
        The estimator to train.
    """

    def __init__(self, estimator: SimpleBaseline) -> None:
        self.estimator = estimator

    def loss(self, context: Context, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Compute the loss of a batch, a scalar."""
        del generator
        poses = self.estimator.standardizer.poses(truth)
        return torch.mean((self.estimator.standardised_poses(context) - poses).square())


class Likelihood(_SingleLoss):
    """The negative log likelihood, nats per pose in mm.

    Parameters
    ----------
    estimator : GaussianNoise
        The estimator to train.
    """

    def __init__(self, estimator: GaussianNoise) -> None:
        self.estimator = estimator

    def loss(self, context: Context, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Compute the loss of a batch, a scalar."""
        del generator
        return -torch.mean(self.estimator(context).log_prob(truth))


class BestOfN(_SingleLoss):
    r"""The minMPJPE of N hypotheses, in mm, which the paper shows to give overconfident models.

    .. math:: \min_n \frac1K \sum_k \lVert \hat x_{nk} - x_k \rVert

    Parameters
    ----------
    estimator : GaussianNoise
        The estimator to train.
    hypotheses : int
        N.
    """

    def __init__(self, estimator: GaussianNoise, hypotheses: int = 200) -> None:
        self.estimator = estimator
        self.hypotheses = hypotheses

    def loss(self, context: Context, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Compute the loss of a batch, a scalar."""
        distribution = self.estimator(context)
        mean: Tensor = distribution.mean

        def draw(poses: int) -> Tensor:
            shape = (self.hypotheses, poses, *mean.shape[1:])
            return torch.randn(shape, generator=generator, device=mean.device, dtype=mean.dtype)

        poses = mean + distribution.sigma * draw_rows(draw, len(mean), axis=1)
        errors = torch.mean(torch.linalg.vector_norm(poses - truth, dim=-1), dim=-1)
        return torch.mean(torch.amin(errors, dim=0))


def build_objective(estimator: ReferenceEstimator, config: TrainConfig) -> Objective:
    """Build the objective of a configuration.

    Parameters
    ----------
    estimator : CGNF, SimpleBaseline or GaussianNoise
        The estimator to train.
    config : TrainConfig
        Settings of the training.

    Returns
    -------
    Objective
        The objective.

    Raises
    ------
    PoseDataError
        Where the estimator has no such objective.
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
        f"train.objective: {config.objective} of a {type(estimator).__name__}; expected likelihood for a cGNF, "
        "squared-error for a SimpleBaseline, likelihood or min-mpjpe for a Gaussian noise model."
    )
