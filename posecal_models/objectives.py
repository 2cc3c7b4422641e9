"""Training objectives: modules from a batch to its losses."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.adversarial import InvertibleLosses
from posecal_models.contract import Context, standard_normal
from posecal_models.estimators.amortized_posterior import AmortizedPosterior
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.estimators.cvae import CVAE
from posecal_models.estimators.gaussian_noise import GaussianNoise
from posecal_models.estimators.inn import INN
from posecal_models.estimators.mixture_density import MixtureDensityNetwork
from posecal_models.estimators.registry import ReferenceEstimator
from posecal_models.estimators.simple_baseline import SimpleBaseline
from posecal_models.objective import Objective
from posecal_models.published_losses import AveragedDraws, EvidenceBound, MixtureLikelihood
from posecal_models.settings import TrainConfig

__all__ = [
    "BestOfN",
    "FlowLikelihood",
    "Likelihood",
    "Objective",
    "SquaredError",
    "build_objective",
    "mode_error",
]

SampleLoss = Literal["joints", "pairs"]


class FlowLikelihood(Objective):
    r"""The training loss of a cGNF.

    .. math:: L = \tfrac12 \left( L_{prior} + L_{post} \right) + \lambda L_{sample}

    All terms are means over the batch: negative log densities in nats per pose (standardised), and the error of the
    mode in mm.

    Parameters
    ----------
    estimator : CGNF
        The estimator to train.
    sample_weight : float
        λ, the weight of the mode's error, per mm. 0: the mode is not computed.
    per_node : bool
        Whether log densities are divided by K, as in the released code, which changes the meaning of λ and clipping.
    sample_loss : str
        See :func:`mode_error`.

    Raises
    ------
    PoseDataError
        Where λ is negative.
    """

    def __init__(
        self,
        estimator: CGNF,
        *,
        sample_weight: float = 0.0,
        per_node: bool = False,
        sample_loss: SampleLoss = "joints",
    ) -> None:
        super().__init__()
        if sample_weight < 0:
            raise PoseDataError(f"sample_weight: {sample_weight}; expected 0 or more.")
        self.estimator = estimator
        self.sample_weight = sample_weight
        self._nats_weight = 0.5 / (len(estimator.joints) if per_node else 1)
        self.sample_loss: SampleLoss = sample_loss

    def initialise(self, context: Context, truth: Tensor) -> None:
        """Set the ActNorms from a first batch."""
        flow, standardizer = self.estimator.flow, self.estimator.standardizer
        flow.initialise_actnorm(standardizer.poses(truth)[:, None], self.estimator.embed(context))

    def forward(
        self, context: Context, truth: Tensor, noise: Tensor | None = None, *, graphs_per_pose: int = 1
    ) -> dict[str, Tensor]:
        """Compute the losses of a batch.

        Parameters
        ----------
        context : Context
            Keypoints of M graphs, pixels.
        truth : Tensor
            (M, K, 3), mm. Graphs of one pose are consecutive.
        noise : Tensor, optional
            Not used: nothing is random.
        graphs_per_pose : int
            How many consecutive graphs have the same truth; its prior is computed once.

        Returns
        -------
        dict of str to Tensor
            ``loss`` (what is minimised), ``prior`` and ``posterior`` (nats per pose, standardised) and, where it is
            used, ``mode`` (mm); scalars; lower is better.
        """
        del noise
        flow, standardizer = self.estimator.flow, self.estimator.standardizer
        poses = standardizer.poses(truth)[:, None]
        conditioned = flow.condition(self.estimator.embed(context))
        unconditioned = flow.condition(flow.empty_context(), folded=conditioned.blocks)
        posterior = -conditioned.log_prob_per_node(poses).sum((1, 2)).mean()
        prior = -unconditioned.log_prob_per_node(poses[::graphs_per_pose]).sum((1, 2)).mean()
        losses = {"loss": self._nats_weight * (posterior + prior), "prior": prior, "posterior": posterior}
        if self.sample_weight:
            mode = standardizer.millimetres(conditioned.inverse(torch.zeros_like(poses)))[:, 0]
            losses["mode"] = mode_error(mode, truth, kind=self.sample_loss).mean()
            losses["loss"] = losses["loss"] + self.sample_weight * losses["mode"]
        return losses


def mode_error(mode: Tensor, truth: Tensor, *, kind: SampleLoss = "joints") -> Tensor:
    r"""Compute the mean joint error of a single pose.

    .. math:: \frac1K \sum_k \lVert \hat x_k - x_k \rVert

    Parameters
    ----------
    mode, truth : Tensor
        (..., K, 3), mm.
    kind : str
        ``joints``: over the joints. ``pairs``: over pairs of consecutive numbers, across joints, as released.

    Returns
    -------
    Tensor
        (...), mm; lower is better.

    Notes
    -----
    Differs from the published code: ``pairs`` is used there, about 0.78 of the mean joint error.

    Examples
    --------
    >>> mode_error(torch.tensor([[3.0, 0, 4], [0, 0, 0]]), torch.zeros(2, 3))  # (5 + 0) / 2
    tensor(2.5000)
    >>> mode_error(torch.tensor([[3.0, 0, 4], [0, 0, 0]]), torch.zeros(2, 3), kind="pairs")  # (3 + 4 + 0) / 3
    tensor(2.3333)
    """
    difference = mode - truth
    if kind == "pairs":
        difference = difference.flatten(-2).view(*difference.shape[:-2], -1, 2)
    return torch.mean(torch.linalg.vector_norm(difference, dim=-1), dim=-1)


class SquaredError(Objective):
    r"""The mean squared error of standardised poses, unitless.

    .. math:: \frac{1}{3 M K} \sum \left( \hat x - x \right)^2

    Parameters
    ----------
    estimator : SimpleBaseline
        The estimator to train.
    """

    def __init__(self, estimator: SimpleBaseline) -> None:
        super().__init__()
        self.estimator = estimator

    def forward(self, context: Context, truth: Tensor, noise: Tensor | None = None) -> dict[str, Tensor]:
        """Compute the loss of a batch."""
        del noise
        poses = self.estimator.standardizer.poses(truth)
        return {"loss": torch.mean((self.estimator.standardised_poses(context) - poses).square())}


class Likelihood(Objective):
    """The negative log likelihood, nats per pose in mm.

    Parameters
    ----------
    estimator : GaussianNoise or AmortizedPosterior
        The estimator to train.
    truth_noise : float
        Standard deviation of noise on the true poses, mm.
    """

    def __init__(self, estimator: GaussianNoise | AmortizedPosterior, truth_noise: float = 0.0) -> None:
        super().__init__()
        self.estimator = estimator
        self.truth_noise = truth_noise

    def noise(self, truth: Tensor, generator: torch.Generator) -> Tensor | None:
        """Draw the noise on the truth, (M, K, 3)."""
        return self.truth_noise * standard_normal(tuple(truth.shape), truth, generator) if self.truth_noise else None

    def forward(self, context: Context, truth: Tensor, noise: Tensor | None = None) -> dict[str, Tensor]:
        """Compute the loss of a batch."""
        truth = truth if noise is None else truth + noise
        return {"loss": -torch.mean(self.estimator(context).log_prob(truth))}


class BestOfN(Objective):
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
        super().__init__()
        self.estimator = estimator
        self.hypotheses = hypotheses

    def noise(self, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Draw standard normal numbers, (N, M, K, 3)."""
        return standard_normal((self.hypotheses, *truth.shape), truth, generator)

    def forward(self, context: Context, truth: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Compute the loss of a batch."""
        distribution = self.estimator(context)
        errors = torch.linalg.vector_norm(distribution.mean + distribution.sigma * noise - truth, dim=-1)
        return {"loss": torch.mean(torch.amin(torch.mean(errors, dim=-1), dim=0))}


def build_objective(estimator: ReferenceEstimator, config: TrainConfig) -> Objective:
    """Build the objective of a configuration.

    Parameters
    ----------
    estimator : ReferenceEstimator
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
        return FlowLikelihood(
            estimator,
            sample_weight=config.sample_weight,
            per_node=config.loss_per == "node",
            sample_loss=config.sample_loss,
        )
    if isinstance(estimator, SimpleBaseline) and config.objective == "squared-error":
        return SquaredError(estimator)
    if isinstance(estimator, (GaussianNoise, AmortizedPosterior)) and config.objective == "likelihood":
        return Likelihood(estimator, config.truth_noise)
    if isinstance(estimator, GaussianNoise) and config.objective == "min-mpjpe":
        return BestOfN(estimator, config.hypotheses)
    if isinstance(estimator, MixtureDensityNetwork) and config.objective == "published":
        return MixtureLikelihood(estimator)
    if isinstance(estimator, CVAE) and config.objective == "published":
        return (AveragedDraws if estimator.variant == "released" else EvidenceBound)(estimator, config.hypotheses)
    if isinstance(estimator, INN) and config.objective == "published":
        return InvertibleLosses(estimator, config.hypotheses, learning_rate=config.learning_rate, seed=config.seed)
    raise PoseDataError(
        f"train.objective: {config.objective} of a {type(estimator).__name__}; expected likelihood for a cGNF or an "
        "AmortizedPosterior, squared-error for a SimpleBaseline, likelihood or min-mpjpe for a Gaussian noise model, "
        "published for the others."
    )
