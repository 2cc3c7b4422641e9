r"""The reference estimator: an amortised posterior over the pose, given any subset of named keypoints.

Two parts. A linear Gaussian posterior whose natural parameters add up over the keypoints at hand, fitted in closed
form; with no keypoint it is the prior. And a residual network that reads all keypoints by name and corrects it: a
mixture of Gaussians with full covariance, in the coordinates in which the first part is standard normal.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError
from posecal_models.contract import Context, check_keypoints, check_truth, standard_normal
from posecal_models.data.standardizer import Origin, Standardizer

__all__ = ["AmortizedPosterior", "GaussianMixture", "PoseCoordinates"]

LEAST_DEVIATION = 1e-3
"""Standard deviation along a direction in which poses vary, over the largest."""
MOST_LOG_SCALE = 3.0
"""The network scales the standard deviations of the linear posterior by exp(±3) at most."""
UNKNOWN_SIGMA = 3.0
"""Standard deviation of an observed keypoint whose detector gives none, pixels."""


class PoseCoordinates(nn.Module):
    """Whitened principal components of standardised poses: D uncorrelated coordinates of variance 1.

    Parameters
    ----------
    joints : int
        K.
    dimensions : int
        D, at most 3K. The directions in which poses vary least are left out: with both hips about their middle, poses
        have no more than 3K - 3.
    """

    basis: Tensor
    scale: Tensor

    def __init__(self, joints: int, dimensions: int) -> None:
        super().__init__()
        self.register_buffer("basis", torch.eye(dimensions, 3 * joints))
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
        return flat.view(*flat.shape[:-1], -1, 3)


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
    ) -> None:
        self.standardizer = standardizer
        self.coordinates = coordinates
        self.centre = centre
        self.factor = factor
        self.log_weights = log_weights
        self.means = means
        self.factors = factors

    def sample(self, n: int, *, generator: torch.Generator | None = None, temperature: float = 1.0) -> Tensor:
        """Draw n hypotheses of each pose.

        Parameters
        ----------
        n : int
            N.
        generator : torch.Generator, optional
            The source of randomness, of the CPU; torch's own where not given.
        temperature : float
            Multiplies the standard deviations of each component.

        Returns
        -------
        Tensor
            (N, M, K, 3), mm.
        """
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

        with s_d the standard deviation along direction d, mm.

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
        standardised = (self.factors @ (u[:, None] - self.means)[..., None])[..., 0]
        constant = 0.5 * z.shape[-1] * math.log(2 * math.pi)
        terms = self.log_weights + _log_determinant(self.factors) - 0.5 * standardised.square().sum(-1) - constant
        return terms.logsumexp(-1) + _log_determinant(self.factor)

    def mode(self) -> Tensor:
        """Return the mean of the component of the highest density at its mean, (M, K, 3), mm."""
        best = (self.log_weights + _log_determinant(self.factors)).argmax(-1)
        return self._poses(self.means[torch.arange(len(best), device=best.device), best][None])[0]

    def _poses(self, u: Tensor) -> Tensor:
        """Turn coordinates u (N, M, D) into poses (N, M, K, 3), mm."""
        z = torch.linalg.solve_triangular(self.factor, u.movedim(0, -1), upper=True).movedim(-1, 0)
        return self.standardizer.millimetres(self.coordinates.inverse(z + self.centre))


def _log_determinant(triangular: Tensor) -> Tensor:
    return triangular.diagonal(dim1=-2, dim2=-1).log().sum(-1)


class _Residual(nn.Module):
    """Norm, two linear maps, added to the input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU()
        )

    def forward(self, features: Tensor) -> Tensor:
        result: Tensor = features + self.layers(features)
        return result


class AmortizedPosterior(nn.Module):
    r"""An amortised posterior over the pose, given any subset of named keypoints.

    With z the whitened pose, and c the keypoints about their weighted middle, the linear part is

    .. math:: z \sim \mathcal N(0, I), \quad c_j = b_j + B_j z + \varepsilon_j, \quad
              \operatorname{var} \varepsilon_j = r_j + \sigma_j^2, \qquad
              \Lambda = I + \sum_j \frac{B_j^T B_j}{r_j + \sigma_j^2}

    over the keypoints at hand: Bayes' rule with independent noise, in natural parameters. The network's mixture is over
    :math:`u = U (z - \mu)` with :math:`\Lambda = U^T U`, which is standard normal before training.

    Parameters
    ----------
    joints, keypoints : tuple of str
        K joints of the pose, without the root, and J keypoints. Human3.6M's 16 where not given.
    dimensions : int
        D, see :class:`PoseCoordinates`; 0: 3K.
    components : int
        C of the mixture.
    width, residuals : int
        Features of a layer, and number of residual blocks.
    position : bool
        Whether the network reads where in the image the person is.
    origin : str
        Origin of the keypoints: ``observed``, their weighted middle, or ``none``, in a world without cameras.

    Notes
    -----
    A hidden keypoint is read with its σ where the context has one; without σ it counts as missing.

    Differs from the published code: not in it.
    """

    position_mean: Tensor
    position_scale: Tensor
    temperature: Tensor

    def __init__(
        self,
        joints: tuple[str, ...] | None = None,
        keypoints: tuple[str, ...] | None = None,
        *,
        dimensions: int = 0,
        components: int = 4,
        width: int = 600,
        residuals: int = 3,
        position: bool = True,
        origin: Origin = "observed",
    ) -> None:
        super().__init__()
        self.joints: tuple[str, ...] = joint_set("h36m-16") if joints is None else joints
        self.keypoints: tuple[str, ...] = self.joints if keypoints is None else keypoints
        if origin == "root":
            raise PoseDataError("model.origin: root of an amortised posterior; expected observed or none.")
        self.options = {
            "dimensions": dimensions,
            "components": components,
            "width": width,
            "residuals": residuals,
            "position": position,
            "origin": origin,
        }
        self._is_centred = origin == "observed"
        count, d = len(self.keypoints), dimensions or 3 * len(self.joints)
        self.standardizer = Standardizer(len(self.joints), origin=origin)
        self.coordinates = PoseCoordinates(len(self.joints), d)
        self.register_buffer("position_mean", torch.zeros(2))
        self.register_buffer("position_scale", torch.ones(()))
        self.register_buffer("temperature", torch.ones(()))
        self.keypoint_mean = nn.Parameter(torch.zeros(count, 2))
        self.keypoint_maps = nn.Parameter(torch.zeros(count, 2, d))
        self.keypoint_log_variance = nn.Parameter(torch.zeros(count))
        self.first = nn.Linear(5 * count + 2, width)
        self.residuals = nn.ModuleList(_Residual(width) for _ in range(residuals))
        self.norm = nn.LayerNorm(width)
        self._sizes = (1, d, d, d * (d - 1) // 2)  # log weight, mean, log diagonal and off-diagonal of a component
        self.last = nn.Linear(width, components * sum(self._sizes))
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)
        if components > 1:  # different components, near the linear posterior
            nn.init.normal_(self.last.bias, std=0.05)

    def check(self, context: Context) -> None:
        """Raise an error for another number of keypoints than this estimator reads."""
        check_keypoints(context, self.keypoints)

    def fit(self, poses: Tensor, context: Context) -> None:
        """Fit scales, coordinates and the linear part to training data, in closed form.

        Parameters
        ----------
        poses : Tensor
            (M, K, 3), mm.
        context : Context
            Their keypoints, pixels.

        Raises
        ------
        PoseDataError
            Where poses or keypoints don't vary as they should.
        """
        self.check(context)
        self.standardizer.fit(poses, context.keypoints, context.observed)
        standardised = self.standardizer.poses(poses)
        self.coordinates.fit(standardised)
        c, sigma, middle = self._centred(context)
        self.position_mean.copy_(middle.mean(0))
        self.position_scale.copy_((middle - self.position_mean).square().mean().sqrt().clamp(min=1e-6))
        z = self.coordinates(standardised).double()
        design = torch.cat([torch.ones_like(z[:, :1]), z], dim=1)
        for j in range(len(self.keypoints)):
            seen = context.observed[:, j]
            target = c[seen, j].double()
            solution = torch.linalg.lstsq(design[seen], target).solution
            residual = (target - design[seen] @ solution).square().mean()
            noise = sigma[seen, j].double().square().mean()
            self.keypoint_mean.data[j] = solution[0]
            self.keypoint_maps.data[j] = solution[1:].T
            self.keypoint_log_variance.data[j] = (residual - noise).clamp(min=1e-6).log()

    def _centred(self, context: Context) -> tuple[Tensor, Tensor, Tensor]:
        """Return scaled keypoints about their middle, 0 where missing; σ, infinite where missing; and the middle."""
        given = context.keypoints.isfinite().all(-1)
        sigma = torch.full_like(context.keypoints[..., 0], torch.inf)
        if context.sigma is not None:
            sigma = torch.where(given & (context.sigma > 0), context.sigma, sigma)
        sigma = torch.where(context.observed & sigma.isinf(), UNKNOWN_SIGMA, sigma)
        scale = self.standardizer.keypoint_scale
        keypoints = torch.where(sigma.isfinite()[..., None], context.keypoints / scale, 0)
        weight = sigma.square().reciprocal()[..., None]
        middle = (weight * keypoints).sum(1) / weight.sum(1).clamp(min=1e-12)
        if self._is_centred:
            keypoints = torch.where(sigma.isfinite()[..., None], keypoints - middle[:, None], 0)
        return keypoints, sigma / scale, middle

    def _linear_posterior(self, c: Tensor, sigma: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean (M, D) and upper factor (M, D, D) of the precision, from scaled keypoints and their σ."""
        precision = (self.keypoint_log_variance.exp() + sigma.square()).reciprocal()  # 0 for a missing one
        maps, mean = self.keypoint_maps, self.keypoint_mean
        difference = c - mean
        maps_about_middle = maps.expand(len(c), *maps.shape)
        if self._is_centred:  # the middle of the same keypoints, seen with the same weights
            weight = torch.where(sigma.isfinite(), sigma, torch.inf).square().reciprocal()
            weight = (weight / weight.sum(1, keepdim=True).clamp(min=1e-12))[..., None]
            difference = difference + (weight * mean).sum(1, keepdim=True)
            maps_about_middle = maps - torch.einsum("mj,jad->mad", weight[..., 0], maps)[:, None]
        weighted = (maps_about_middle * precision[..., None, None]).flatten(1, 2)  # (M, 2J, D)
        prior = torch.eye(weighted.shape[-1], dtype=weighted.dtype, device=weighted.device)
        information = prior + weighted.mT @ maps_about_middle.flatten(1, 2)
        evidence = (weighted.mT @ difference.flatten(1)[..., None])[..., 0]
        lower = torch.linalg.cholesky(information)
        return torch.cholesky_solve(evidence[..., None], lower)[..., 0], lower.mT

    def forward(self, context: Context) -> GaussianMixture:
        """Return the distribution of the poses with these keypoints.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels; σ is used where given.

        Returns
        -------
        GaussianMixture
            Of M poses.

        Raises
        ------
        PoseDataError
            Where there are more or fewer keypoints.
        """
        self.check(context)
        c, sigma, middle = self._centred(context)
        at_hand = sigma.isfinite()
        mean, factor = self._linear_posterior(c, sigma)
        log_sigma = torch.where(at_hand, sigma, 1).log()
        place = (middle - self.position_mean) / self.position_scale * at_hand.any(1, keepdim=True)
        features = self.first(
            torch.cat(
                [
                    c.clamp(-10, 10).flatten(1),
                    at_hand.to(c.dtype),
                    context.observed.to(c.dtype),
                    log_sigma,
                    place if self.options["position"] else torch.zeros_like(place),
                ],
                dim=1,
            )
        )
        for residual in self.residuals:
            features = residual(features)
        correction = self.last(self.norm(features)).unflatten(1, (self.options["components"], -1))
        log_weight, offset, log_diagonal, off_diagonal = correction.split(self._sizes, dim=-1)
        d = offset.shape[-1]
        triangle = torch.zeros(*offset.shape, d, dtype=c.dtype, device=c.device)
        above = torch.triu_indices(d, d, 1, device=c.device)
        triangle[..., above[0], above[1]] = off_diagonal / math.sqrt(d)
        diagonal = (MOST_LOG_SCALE * torch.tanh(log_diagonal / MOST_LOG_SCALE)).exp()
        return GaussianMixture(
            self.standardizer,
            self.coordinates,
            mean,
            factor,
            log_weights=log_weight.squeeze(-1).log_softmax(-1),
            means=offset,
            factors=(torch.diag_embed(diagonal) + triangle) / self.temperature,
        )
