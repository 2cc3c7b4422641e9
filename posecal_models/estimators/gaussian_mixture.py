"""Mixtures of Gaussians with full covariance over poses, in whitened principal components."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from posecal.errors import PoseDataError
from posecal_models.contract import check_truth, standard_normal
from posecal_models.data.standardizer import Standardizer

if TYPE_CHECKING:
    from zuko.transforms import ComposedTransform

__all__ = ["GaussianMixture", "PoseCoordinates"]

LEAST_DEVIATION = 1e-3
"""Standard deviation along a direction in which poses vary, over the largest."""


class PoseCoordinates(nn.Module):
    """Whitened principal components of standardised poses: D uncorrelated coordinates of variance 1.

    Parameters
    ----------
    joints : int
        K.
    dimensions : int
        D, at most 3K. The directions in which poses vary least are left out: with both hips about their middle, poses
        have no more than 3K - 3.
    joint_dimensions : int
        Coordinates of a joint, 3 of poses.
    """

    basis: Tensor
    scale: Tensor

    def __init__(self, joints: int, dimensions: int, joint_dimensions: int = 3) -> None:
        super().__init__()
        self.joint_dimensions = joint_dimensions
        self.register_buffer("basis", torch.eye(dimensions, joint_dimensions * joints))
        self.register_buffer("scale", torch.ones(dimensions))

    def fit(self, poses: Tensor) -> None:
        """Fit to standardised poses (M, K, 3), whose mean is 0.

        Raises
        ------
        PoseDataError
            Where they vary along a direction that is left out, or not along one that is kept.
        """
        dimensions = len(self.scale)
        _, singular, basis = torch.linalg.svd(poses.double().flatten(1), full_matrices=False)
        deviations = singular / math.sqrt(len(poses))
        least, left_out = LEAST_DEVIATION * deviations[0], deviations[dimensions:]
        if len(deviations) < dimensions or deviations[dimensions - 1] < least or (left_out > least).any():
            raise PoseDataError(
                f"poses: along {int((deviations >= least).sum())} principal directions they vary by a thousandth of "
                f"the largest standard deviation or more; expected {dimensions} (model.dimensions)."
            )
        self.basis.copy_(basis[:dimensions])
        self.scale.copy_(deviations[:dimensions])

    def forward(self, poses: Tensor) -> Tensor:
        """Turn standardised poses (M, K, 3) into coordinates (M, D)."""
        return poses.flatten(1) @ self.basis.T / self.scale

    def inverse(self, coordinates: Tensor) -> Tensor:
        """Turn coordinates (..., D) into standardised poses (..., K, 3)."""
        flat = (coordinates * self.scale) @ self.basis
        return flat.view(*flat.shape[:-1], -1, self.joint_dimensions)


class GaussianMixture:
    """Mixtures of Gaussians with full covariance over M poses.

    They are given in coordinates u = U (z - m) of each pose, with z the coordinates of :class:`PoseCoordinates`.

    Parameters
    ----------
    standardizer : Standardizer
        Of the poses.
    coordinates : PoseCoordinates
        Of the standardised poses.
    centre : Tensor
        (M, D), m.
    factor : Tensor
        (M, D, D), upper triangular U.
    log_weights : Tensor
        (M, C).
    means : Tensor
        (M, C, D), of u.
    factors : Tensor
        (M, C, D, D), upper triangular T with the precision TᵀT of u.
    transform : zuko.transforms.ComposedTransform, optional
        A bijection of u for each of the M poses; the mixture is then over its values.
    """

    def __init__(
        self,
        standardizer: Standardizer,
        coordinates: PoseCoordinates,
        centre: Tensor,
        factor: Tensor,
        *,
        log_weights: Tensor,
        means: Tensor,
        factors: Tensor,
        transform: ComposedTransform | None = None,
    ) -> None:
        self.standardizer = standardizer
        self.coordinates = coordinates
        self.centre = centre
        self.factor = factor
        self.log_weights = log_weights
        self.means = means
        self.factors = factors
        self.transform = transform

    def sample(self, n: int, *, generator: torch.Generator | None = None, temperature: float = 1.0) -> Tensor:
        """Draw n hypotheses of each pose; the temperature multiplies the deviations of each component."""
        poses, components, dimensions = self.means.shape
        normal = standard_normal((n, poses, dimensions + 1), self.means, generator)
        noise, uniform = normal[..., :-1], torch.special.ndtr(normal[..., -1:])
        component = (uniform > self.log_weights.exp().cumsum(-1)[..., :-1]).sum(-1)
        identity = torch.eye(dimensions, dtype=noise.dtype, device=noise.device)
        inverse = torch.linalg.solve_triangular(self.factors, identity, upper=True)
        u = torch.zeros_like(noise)
        for c in range(components):
            of_c = self.means[:, c] + temperature * torch.einsum("mde,nme->nmd", inverse[:, c], noise)
            u = torch.where((component == c)[..., None], of_c, u)
        return self._poses(u)

    def log_prob(self, truth: Tensor) -> Tensor:
        r"""Compute the log density of poses.

        .. math:: \log p(x) = \log \sum_c w_c \, \mathcal N\left(u; \mu_c, (T_c^T T_c)^{-1}\right)
                  + \log \lvert U \rvert - \sum_d \log s_d

        with s_d the standard deviation along direction d, mm; with a transform f, f(u) takes the place of u, and
        :math:`\log \lvert \partial f / \partial u \rvert` is added.

        Parameters
        ----------
        truth : Tensor
            (M, K, 3), mm. What lies off the D directions of the coordinates does not count.

        Returns
        -------
        Tensor
            (M,), nats per pose in mm over the D directions; higher is better.

        Raises
        ------
        PoseDataError
            Where the truth has another shape.
        """
        check_truth(truth, len(self.means), *self.standardizer.pose_mean.shape)
        scale = self.coordinates.scale * self.standardizer.pose_scale
        return self.log_prob_of(self.coordinates(self.standardizer.poses(truth))) - scale.log().sum()

    def log_prob_of(self, z: Tensor) -> Tensor:
        """Compute the log density (M,) of whitened coordinates (M, D)."""
        u = (self.factor @ (z - self.centre)[..., None])[..., 0]
        log_change: Tensor | float = 0.0
        if self.transform is not None:
            u, log_change = self.transform.call_and_ladj(u)
        standardised = (self.factors @ (u[:, None] - self.means)[..., None])[..., 0]
        constant = 0.5 * z.shape[-1] * math.log(2 * math.pi)
        terms = self.log_weights + _log_determinant(self.factors) - 0.5 * standardised.square().sum(-1) - constant
        return terms.logsumexp(-1) + log_change + _log_determinant(self.factor)

    def mode(self) -> Tensor:
        """Return the mean of the component of the highest density at its mean, (M, K, 3), mm."""
        best = (self.log_weights + _log_determinant(self.factors)).argmax(-1)
        return self._poses(self.means[torch.arange(len(best), device=best.device), best][None])[0]

    def _poses(self, u: Tensor) -> Tensor:
        """Turn coordinates u (N, M, D) into poses (N, M, K, 3), mm."""
        if self.transform is not None:
            u = self.transform.inv(u)
        z = torch.linalg.solve_triangular(self.factor, u.movedim(0, -1), upper=True).movedim(-1, 0)
        return self.standardizer.millimetres(self.coordinates.inverse(z + self.centre))


def _log_determinant(triangular: Tensor) -> Tensor:
    return triangular.diagonal(dim1=-2, dim2=-1).log().sum(-1)
