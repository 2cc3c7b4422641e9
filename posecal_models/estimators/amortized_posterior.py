r"""The reference estimator: an amortised posterior over the pose, given any subset of named keypoints.

Two parts. A linear Gaussian posterior whose natural parameters add up over the keypoints at hand, fitted in closed
form; with no keypoint it is the prior. And a residual network that reads all keypoints by name and corrects it: a
Gaussian with full covariance, or a mixture of several, in the coordinates in which the first part is standard normal.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError
from posecal_models.contract import Context, check_keypoints
from posecal_models.data.standardizer import Origin, Standardizer
from posecal_models.estimators.gaussian_mixture import GaussianMixture, PoseCoordinates

__all__ = ["AmortizedPosterior"]

MOST_LOG_SCALE = 3.0
"""The network scales the standard deviations of the linear posterior by exp(±3) at most."""
UNKNOWN_SIGMA = 3.0
"""Standard deviation of an observed keypoint whose detector gives none, pixels."""


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
        D, see :class:`posecal_models.estimators.gaussian_mixture.PoseCoordinates`; 0: all, 3K of poses.
    components : int
        C of the mixture.
    width, residuals : int
        Features of a layer, and number of residual blocks.
    position : bool
        Whether the network reads where in the image the person is.
    origin : str
        Origin of the keypoints: ``observed``, their weighted middle, or ``none``, in a world without cameras.
    splines : int
        Coupling layers of splines between u and the mixture, conditional on the features of the network, by zuko.
    joint_dimensions : int
        Coordinates of a joint: 3, or 2 of a pendulum's nodes.

    Raises
    ------
    PoseDataError
        For an origin that is none of these, and for splines without zuko.

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
        components: int = 1,
        width: int = 600,
        residuals: int = 3,
        position: bool = True,
        origin: Origin = "observed",
        splines: int = 0,
        joint_dimensions: int = 3,
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
            "splines": splines,
            "joint_dimensions": joint_dimensions,
        }
        self._is_centred = origin == "observed"
        count, d = len(self.keypoints), dimensions or joint_dimensions * len(self.joints)
        self.standardizer = Standardizer(len(self.joints), dimensions=joint_dimensions, origin=origin)
        self.coordinates = PoseCoordinates(len(self.joints), d, joint_dimensions)
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
        self.splines = _coupling_splines(d, width, splines) if splines else None

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
            Where poses or keypoints don't vary as they should, or fewer images have a keypoint than its map has
            coefficients.
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
            if (count := int(seen.sum())) < design.shape[1]:
                raise PoseDataError(
                    f"keypoints: {self.keypoints[j]} is observed in {count:,} of {len(seen):,} images; expected "
                    f"{design.shape[1]} or more."
                )
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
            weight = sigma.square().reciprocal()
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
        features = self.norm(features)
        correction = self.last(features).unflatten(1, (self.options["components"], -1))
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
            transform=None if self.splines is None else self.splines(features),
        )


def _coupling_splines(dimensions: int, features: int, count: int) -> nn.Module:
    """Build conditional couplings of rational-quadratic splines, the identity before training."""
    try:
        from zuko.flows import NSF
    except ImportError:
        raise PoseDataError("model.splines: zuko is not installed. pip install 'posecal[splines]' brings it.") from None
    couplings: nn.Module = NSF(dimensions, features, transforms=count, passes=2, hidden_features=(256, 256)).transform
    for name, parameter in couplings.named_parameters():
        if name.rpartition(".")[0].endswith("hyper.4"):
            nn.init.zeros_(parameter)
    return couplings
