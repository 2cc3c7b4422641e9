"""The mixture density network of Li and Lee: five Gaussians around poses, from all keypoints.

The density is that of the mixture, exactly. The published protocol takes the five means as hypotheses and the best of
them; here they are :meth:`PoseMixture.means`, and hypotheses are drawn from the mixture.
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from posecal.data.skeleton import joint_set
from posecal_models.contract import Context, check_truth, standard_normal
from posecal_models.data.standardizer import CoordinateStandardizer, Origin
from posecal_models.estimators.simple_baseline import HOURGLASS, DenseLayer, ResidualBlock, check_all_keypoints

__all__ = ["MixtureDensityNetwork", "PoseMixture", "Variant"]

Variant = Literal["repaired", "released"]


class PoseMixture:
    """Mixtures of C isotropic Gaussians in standardised coordinates.

    Parameters
    ----------
    standardised_means : Tensor
        (M, C, K, 3), unitless.
    sigma : Tensor
        (M, C), unitless.
    log_weights : Tensor
        (M, C), logarithms of weights that sum to 1.
    standardizer : CoordinateStandardizer
        From unitless coordinates to mm.
    """

    def __init__(
        self, standardised_means: Tensor, sigma: Tensor, log_weights: Tensor, standardizer: CoordinateStandardizer
    ) -> None:
        self.standardised_means = standardised_means
        self.sigma = sigma
        self.log_weights = log_weights
        self.standardizer = standardizer

    def means(self) -> Tensor:
        """Return the means of the components, (C, M, K, 3), mm: the published hypotheses."""
        return self.standardizer.millimetres(self.standardised_means).transpose(0, 1)

    def mode(self) -> Tensor:
        """Return the mean of the component with the highest peak, (M, K, 3), mm."""
        coordinates = self.standardised_means[0, 0].numel()
        highest = (self.log_weights - coordinates * self.sigma.log()).argmax(-1)
        return self.standardizer.millimetres(self._component(highest[None])[0])

    def _component(self, index: Tensor) -> Tensor:
        """Select means by the components' indices (n, M): (n, M, K, 3)."""
        return self.standardised_means[torch.arange(index.shape[1], device=index.device), index]

    def sample(self, n: int, *, generator: torch.Generator | None = None, temperature: float = 1.0) -> Tensor:
        """Draw n hypotheses of each pose, a component by its weight each; the temperature multiplies σ."""
        poses, components, *shape = self.standardised_means.shape
        uniform = torch.rand((n, poses, 1), generator=generator, dtype=self.sigma.dtype).to(self.sigma.device)
        index = (uniform > self.log_weights.exp().cumsum(-1)).sum(-1).clamp(max=components - 1)
        sigma = self.sigma.gather(1, index.T).T[..., None, None]
        noise = standard_normal((n, poses, *shape), self.sigma, generator)
        return self.standardizer.millimetres(self._component(index) + temperature * sigma * noise)

    def standardised_log_prob(self, poses: Tensor) -> Tensor:
        r"""Compute the log density of standardised poses.

        .. math:: \log p(y) = \log \sum_c \alpha_c \, (2 \pi \sigma_c^2)^{-D/2}
                  \exp\left( -\frac{\lVert y - \mu_c \rVert^2}{2 \sigma_c^2} \right)

        with D = 3 K coordinates.

        Parameters
        ----------
        poses : Tensor
            (M, K, 3), unitless.

        Returns
        -------
        Tensor
            (M,), nats per standardised pose; higher is better.
        """
        squares = (poses[:, None] - self.standardised_means).square().sum((2, 3))
        normalisers = poses[0].numel() * (0.5 * math.log(2 * math.pi) + self.sigma.log())
        return torch.logsumexp(self.log_weights - normalisers - 0.5 * squares / self.sigma.square(), dim=-1)

    def log_prob(self, truth: Tensor) -> Tensor:
        """Compute the log density of poses (M, K, 3) in mm: (M,), nats per pose in mm; higher is better.

        Raises
        ------
        PoseDataError
            Where the truth has another shape.
        """
        check_truth(truth, len(self.sigma), *self.standardised_means.shape[2:])
        return self.standardised_log_prob(self.standardizer.poses(truth)) - self.standardizer.log_determinant


class _BoundedLinear(nn.Linear):
    """A linear map whose weight is divided by its Frobenius norm where that is above 1."""

    def forward(self, features: Tensor) -> Tensor:
        norm = torch.linalg.vector_norm(self.weight)
        return functional.linear(features, self.weight / norm.clamp(min=1), self.bias)


class MixtureDensityNetwork(nn.Module):
    """Li and Lee's network from all keypoints to a mixture of Gaussians, one σ for each component.

    Parameters
    ----------
    joints, keypoints : tuple of str
        K joints of the pose, without the root, and J keypoints. Human3.6M's 16 and those of the stacked hourglass
        network where not given.
    components : int
        C.
    width, residuals : int
        Features of a layer, and number of residual blocks.
    dropout : float
        Dropout probability in training.
    origin : str
        Origin of the keypoints; ``none``, as published, keeps their position in the image.
    variant : str
        The loss that it is trained by, see :class:`posecal_models.published_losses.MixtureLikelihood`.

    Notes
    -----
    With 16 keypoints, 16 joints and 5 components it has 4,498,682 parameters, the published number.

    Differs from the published code: none in the network, whose weights it doesn't read (there the three heads are one
    matrix); the weights of components are not bounded from below by 1e-8 in the likelihood.

    References
    ----------
    Li and Lee 2019, arXiv:1904.05547.

    Examples
    --------
    >>> sum(p.numel() for p in MixtureDensityNetwork().parameters())
    4498682
    """

    def __init__(
        self,
        joints: tuple[str, ...] | None = None,
        keypoints: tuple[str, ...] | None = None,
        *,
        components: int = 5,
        width: int = 1024,
        residuals: int = 2,
        dropout: float = 0.5,
        origin: Origin = "none",
        variant: Variant = "repaired",
    ) -> None:
        super().__init__()
        self.joints = joint_set("h36m-16") if joints is None else joints
        self.keypoints = HOURGLASS if keypoints is None else keypoints
        self.variant: Variant = variant
        self.options = {
            "components": components,
            "width": width,
            "residuals": residuals,
            "dropout": dropout,
            "origin": origin,
            "variant": variant,
        }
        self.first = DenseLayer(2 * len(self.keypoints), width, dropout, _BoundedLinear)
        self.residuals = nn.ModuleList(ResidualBlock(width, dropout, _BoundedLinear) for _ in range(residuals))
        self.means = _BoundedLinear(width, 3 * components * len(self.joints))
        self.spread = _BoundedLinear(width, components)
        self.weights = nn.Linear(width, components)
        self.standardizer = CoordinateStandardizer(len(self.joints), len(self.keypoints), origin=origin)
        for module in self.modules():
            if isinstance(module, nn.Linear):
                for parameter in module.parameters():  # biases too
                    deviation = math.sqrt(2 / parameter.shape[-1])
                    nn.init.trunc_normal_(parameter, 0, deviation, -2 * deviation, 2 * deviation)
            elif isinstance(module, nn.BatchNorm1d):
                module.eps, module.momentum = 1e-3, 0.01

    def check(self, context: Context) -> None:
        """Raise an error where a keypoint is missing or not finite; all are read, observed or not."""
        check_all_keypoints(context, self.keypoints, "A mixture density network")

    def forward(self, context: Context) -> PoseMixture:
        """Return the distribution of the poses with these keypoints.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels; all of them are read, observed or not.

        Returns
        -------
        PoseMixture
            Of M poses, mm.

        Raises
        ------
        PoseDataError
            As :meth:`check`.
        """
        self.check(context)
        features: Tensor = self.first(self.standardizer.all_keypoints(context).flatten(1))
        for residual in self.residuals:
            features = residual(features)
        sigma = (functional.elu(self.spread(features)) + 1).clamp(1e-15, 1e15)
        means: Tensor = self.means(features)
        shape = (len(means), sigma.shape[1], len(self.joints), 3)
        return PoseMixture(means.view(shape), sigma, self.weights(features).log_softmax(-1), self.standardizer)
