"""Training losses of Li and Lee, Sharma et al. and Wehrbein et al., as released and repaired."""

from __future__ import annotations

import torch
from torch import Tensor

from posecal_models.contract import Context
from posecal_models.estimators.mixture_density import MixtureDensityNetwork
from posecal_models.objective import Objective

__all__ = ["MixtureLikelihood", "best_error"]


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
