"""Gaussian noise around a point estimate, the paper's baseline.

Its standard deviation does not depend on the input. Trained by likelihood it equals the root mean squared error;
trained for the minMPJPE of N hypotheses it becomes smaller, which is the paper's point.
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor, nn

from posecal_models.contract import Context, check_truth, standard_normal
from posecal_models.data.standardizer import Standardizer
from posecal_models.estimators.simple_baseline import SimpleBaseline

__all__ = ["GaussianDistribution", "GaussianNoise", "Spread", "likelihood_optimum"]

Spread = Literal["joint", "coordinate"]


class GaussianDistribution:
    """Independent Gaussians around M poses.

    Parameters
    ----------
    mean : Tensor
        (M, K, 3), mm.
    sigma : Tensor
        (K, 1) or (K, 3), mm.
    """

    def __init__(self, mean: Tensor, sigma: Tensor) -> None:
        self.mean = mean
        self.sigma = sigma

    def sample(self, n: int, *, generator: torch.Generator | None = None, temperature: float = 1.0) -> Tensor:
        """Draw n hypotheses of each pose; the temperature multiplies σ."""
        noise = standard_normal((n, *self.mean.shape), self.mean, generator)
        return self.mean + temperature * self.sigma * noise

    def log_prob(self, truth: Tensor) -> Tensor:
        r"""Compute the log density of poses.

        .. math:: \log p(x) = -\tfrac12 \sum_{k, d} \left(
                  \frac{(x_{kd} - \mu_{kd})^2}{\sigma_{kd}^2} + \log 2 \pi \sigma_{kd}^2 \right)

        Raises
        ------
        PoseDataError
            Where the truth has another shape.

        Examples
        --------
        >>> distribution = GaussianDistribution(torch.zeros(1, 1, 3), torch.ones(1, 1))
        >>> distribution.log_prob(torch.zeros(1, 1, 3))  # -3/2 log 2 pi
        tensor([-2.7568])
        """
        check_truth(truth, *self.mean.shape)
        variance = self.sigma.square()
        terms = (truth - self.mean).square() / variance + (2 * math.pi * variance).log()
        return -0.5 * terms.sum((1, 2))

    def mode(self) -> Tensor:
        """Return the mean, (M, K, 3), mm."""
        return self.mean


class GaussianNoise(nn.Module):
    """A trained SimpleBaseline with Gaussian noise around its estimate.

    Parameters
    ----------
    mean : SimpleBaseline
        The point estimator. It is not trained further.
    spread : str
        One σ for each ``joint`` or for each ``coordinate``.

    Notes
    -----
    With one σ per joint and the paper's 15 joints it has 4,288,572 parameters, the paper's number.

    Differs from the published code: there it has one σ per coordinate, 45 in all.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 3.3.
    """

    def __init__(self, mean: SimpleBaseline, *, spread: Spread = "joint") -> None:
        super().__init__()
        self.mean = mean.requires_grad_(False)
        columns = 1 if spread == "joint" else 3
        self.log_sigma = nn.Parameter(torch.full((len(mean.joints), columns), math.log(100.0)))

    @property
    def joints(self) -> tuple[str, ...]:
        """K names: the joints of the poses."""
        return self.mean.joints

    @property
    def keypoints(self) -> tuple[str, ...]:
        """J names: the keypoints of a context."""
        return self.mean.keypoints

    @property
    def standardizer(self) -> Standardizer:
        """The standardizer of the point estimator."""
        return self.mean.standardizer

    def check(self, context: Context) -> None:
        """Raise an error for keypoints that don't fit the point estimator; see its own check."""
        self.mean.check(context)

    def train(self, mode: bool = True) -> GaussianNoise:
        """Set training mode; the point estimator stays in evaluation mode."""
        super().train(mode)
        self.mean.eval()
        return self

    def forward(self, context: Context) -> GaussianDistribution:
        """Return the distribution of the poses with these keypoints.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels.

        Returns
        -------
        GaussianDistribution
            Of M poses, mm.
        """
        with torch.no_grad():
            mean = self.mean(context).pose
        return GaussianDistribution(mean, self.log_sigma.exp())


def likelihood_optimum(residuals: Tensor, *, spread: Spread = "joint") -> Tensor:
    r"""Compute the maximum likelihood σ: the root mean squared residual.

    .. math:: \sigma_k^2 = \frac{1}{3 M} \sum_{m, d} (x_{mkd} - \mu_{mkd})^2

    Parameters
    ----------
    residuals : Tensor
        (M, K, 3), mm: truth less mean.
    spread : str
        One σ for each ``joint`` or for each ``coordinate``.

    Returns
    -------
    Tensor
        (K, 1) or (K, 3), mm.

    Examples
    --------
    >>> likelihood_optimum(torch.tensor([[[3.0, 4, 0]], [[0.0, 0, 5]]]))  # sqrt((9 + 16 + 25) / 6)
    tensor([[2.8868]])
    """
    columns = (0, 2) if spread == "joint" else (0,)
    return residuals.square().mean(columns, keepdim=True)[0].sqrt()
