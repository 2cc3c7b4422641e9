"""Training losses of Li and Lee, Sharma et al. and Wehrbein et al., as released and repaired."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from posecal_models.contract import Context, standard_normal
from posecal_models.estimators.cvae import CVAE
from posecal_models.estimators.mixture_density import MixtureDensityNetwork
from posecal_models.objective import Objective

__all__ = ["AveragedDraws", "EvidenceBound", "MixtureLikelihood", "best_error"]


def best_error(hypotheses: Tensor, truth: Tensor) -> Tensor:
    """Compute the minMPJPE (M,) in mm of hypotheses (N, M, K, 3) and truth (M, K, 3)."""
    return torch.amin(torch.linalg.vector_norm(hypotheses - truth, dim=-1).mean(-1), dim=0)


class MixtureLikelihood(Objective):
    r"""The loss of a mixture density network, in nats per standardised pose.

    .. math:: L = -\log p(y) - \sum_c \log \alpha_c

    The last term, the logarithm of a Dirichlet prior with parameters 2, is that of the ``released`` variant: it draws
    the weights of each image's components together, and the loss is then no proper score. The ``repaired`` one leaves
    it out.

    Parameters
    ----------
    estimator : MixtureDensityNetwork
        The estimator to train.

    Notes
    -----
    Differs from the published code: there the checkpoint is kept by the error of the best mean on the test set. The
    ``released`` variant keeps that of the lowest such error on the validation poses, the ``repaired`` one that of the
    highest likelihood.
    """

    def __init__(self, estimator: MixtureDensityNetwork) -> None:
        super().__init__()
        self.estimator = estimator

    def forward(self, context: Context, truth: Tensor, noise: Tensor | None = None) -> dict[str, Tensor]:
        """Compute the loss of a batch."""
        del noise
        mixture = self.estimator(context)
        nats = -mixture.standardised_log_prob(self.estimator.standardizer.poses(truth)).mean()
        if self.estimator.variant == "repaired":
            return {"loss": nats}
        losses = {"loss": nats - mixture.log_weights.sum(-1).mean(), "nats": nats}
        if not self.estimator.training:
            losses["selection"] = best_error(mixture.means(), truth).mean()
        return losses


class _LatentObjective(Objective):
    """What the losses of a CVAE have in common.

    Parameters
    ----------
    estimator : CVAE
        The estimator to train.
    draws : int
        Latents of each pose, from the encoder and, where they are used, as many from the prior.
    """

    def __init__(self, estimator: CVAE, draws: int = 10) -> None:
        super().__init__()
        self.estimator = estimator
        self.draws = draws

    def noise(self, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Draw standard normal numbers, (2 N, M, L)."""
        return standard_normal((2 * self.draws, len(truth), self.estimator.latents), truth, generator)

    def _encoded(self, context: Context, truth: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Compute standardised keypoints and poses, what is decoded of the encoder's latents, and the divergence."""
        estimator = self.estimator
        keypoints = estimator.standardised_keypoints(context)
        poses = estimator.standardizer.poses(truth).flatten(1)
        mean, log_variance = estimator.encode(keypoints, poses)
        decoded = estimator.decode(mean + (0.5 * log_variance).exp() * noise[: self.draws], keypoints)
        return keypoints, poses, decoded, -0.5 * (1 + log_variance - mean.square() - log_variance.exp())


class AveragedDraws(_LatentObjective):
    r"""The ``released`` loss of a CVAE, standardised.

    .. math:: L = 50 \, \lVert \bar y_q - y \rVert^2 + 50 \, \lVert \bar y_0 - y \rVert^2
              + 10 \, \mathrm{KL}(q \,\Vert\, \mathcal N(0, I))

    with the mean over coordinates of squares and over latents of the divergence, and the decoder's output averaged over
    N draws from the encoder (q) or the prior (0) before the error is taken. Nothing rewards a spread of the draws.

    Notes
    -----
    Differs from the published code: there the checkpoint is kept by the error of the best draw on the test set; here by
    that of the best of the N draws on the validation poses.
    """

    def forward(self, context: Context, truth: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Compute the loss of a batch."""
        estimator = self.estimator
        keypoints, poses, decoded, divergence = self._encoded(context, truth, noise)
        drawn = estimator.decode(noise[self.draws :], keypoints)
        errors = [torch.mean((some.mean(0) - poses).square()) for some in (decoded, drawn)]
        losses = {"loss": 50 * (errors[0] + errors[1]) + 10 * divergence.mean(), "divergence": divergence.sum(1).mean()}
        if not estimator.training:
            in_mm = estimator.standardizer.millimetres(drawn.view(*drawn.shape[:2], -1, 3))
            losses["selection"] = best_error(in_mm, truth).mean()
        return losses


class EvidenceBound(_LatentObjective):
    r"""The ``repaired`` loss of a CVAE: the negative evidence lower bound, nats per standardised pose.

    .. math:: L = \mathrm E_q \left[ -\log \mathcal N(y; f(z, c), \sigma^2) \right]
              + \mathrm{KL}(q \,\Vert\, \mathcal N(0, I))

    The error is that of every draw, and sums are over coordinates and latents.
    """

    def forward(self, context: Context, truth: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Compute the loss of a batch."""
        _, poses, decoded, divergence = self._encoded(context, truth, noise)
        log_sigma = self.estimator.log_sigma
        squares = ((poses - decoded) * (-log_sigma).exp()).square()
        nats = (0.5 * squares + log_sigma + 0.5 * math.log(2 * math.pi)).sum(-1).mean()
        total = divergence.sum(1).mean()
        return {"loss": nats + total, "divergence": total}
