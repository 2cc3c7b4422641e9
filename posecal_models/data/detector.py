"""Noise model of a 2D keypoint detector: Gaussian for visible keypoints, heavy-tailed for hidden ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.limits import Limit, check_limits

__all__ = ["Detector"]


@dataclass(frozen=True)
class Detector:
    r"""A noise model of a keypoint detector.

    .. math:: c = \pi(x) + \sigma \varepsilon, \qquad \varepsilon \sim \mathcal N(0, I) \text{ if visible, }
              t_\nu \text{ in 2D, scaled to variance 1, if hidden}

    Attributes
    ----------
    sigma : float
        Standard deviation of a visible keypoint in each direction, pixels.
    hidden_sigma : float
        Standard deviation of a hidden keypoint in each direction, pixels. Its tails are heavy.
    hidden_share : float
        Probability of a keypoint to be hidden, independently of the others.
    degrees_of_freedom : int
        ν of the hidden keypoints' noise, at least 3.
    threshold : float
        Keypoints with a larger σ count as missing, pixels.

    Raises
    ------
    PoseDataError
        Where a number is out of its range, or every keypoint would count as missing.

    Notes
    -----
    Differs from the published code: none; the paper's keypoints come from a detector, and those with σ > 5 pixels are
    removed.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4, "Occlusion Representation".
    """

    sigma: Annotated[float, Limit(0, words="0 pixels or more")] = 3.0
    hidden_sigma: Annotated[float, Limit(0, words="0 pixels or more")] = 25.0
    hidden_share: Annotated[float, Limit(0, 1, "a share between 0 and 1")] = 0.12
    degrees_of_freedom: Annotated[int, Limit(3, 1000, "3 or more, so that the variance is finite")] = 3
    threshold: Annotated[float, Limit(0, words="0 pixels or more")] = 5.0

    def __post_init__(self) -> None:
        check_limits(self, "detector")
        visible_count = self.sigma <= self.threshold and self.hidden_share < 1
        hidden_count = self.hidden_sigma <= self.threshold and self.hidden_share > 0
        if not visible_count and not hidden_count:
            raise PoseDataError(
                f"detector.threshold: {self.threshold:g} pixels; with sigma {self.sigma:g}, hidden_sigma "
                f"{self.hidden_sigma:g} and hidden_share {self.hidden_share:g} every keypoint counts as missing. "
                "Raise it, or lower sigma."
            )

    def detect(self, keypoints: Tensor, generator: torch.Generator) -> Context:
        """Simulate the detection of keypoints.

        Parameters
        ----------
        keypoints : Tensor
            (M, K, 2), pixels: exact projections of the joints; NaN where unknown, which is never observed.
        generator : torch.Generator
            The source of randomness, of the CPU.

        Returns
        -------
        Context
            Noisy keypoints, their σ, and which of them count as observed. Hidden keypoints have noisy values too, for
            estimators that use every keypoint.
        """
        if keypoints.ndim != 3:
            raise PoseDataError(f"keypoints {tuple(keypoints.shape)}: expected (M, K, 2).")
        shape, device = keypoints.shape, keypoints.device
        hidden = (torch.rand(shape[:2], generator=generator) < self.hidden_share).to(device)
        noise = torch.randn(shape, generator=generator)
        degrees = self.degrees_of_freedom
        chi_squared = torch.randn((*shape[:2], 1, degrees), generator=generator).square().sum(-1)
        heavy_tailed = (noise * torch.sqrt((degrees - 2) / chi_squared)).to(device)
        noise = noise.to(device)
        sigma = torch.where(hidden, self.hidden_sigma, self.sigma)
        noisy = keypoints + sigma[..., None] * torch.where(hidden[..., None], heavy_tailed, noise).to(keypoints.dtype)
        observed = (sigma <= self.threshold) & keypoints.isfinite().all(-1)
        return Context(noisy, observed, sigma.to(keypoints.dtype))

    def detect_set(self, data: LiftingSet, *, seed: int = 0) -> LiftingSet:
        """Simulate the detection of all keypoints of a data set.

        Parameters
        ----------
        data : LiftingSet
            With exact keypoints.
        seed : int
            Seed of the noise.

        Returns
        -------
        LiftingSet
            With noisy keypoints, their σ and which count as observed.
        """
        context = self.detect(torch.from_numpy(data.keypoints), torch.Generator().manual_seed(seed))
        sigma = torch.zeros_like(context.keypoints[..., 0]) if context.sigma is None else context.sigma
        return replace(
            data,
            keypoints=context.keypoints.numpy(),
            observed=context.observed.numpy(),
            sigma=sigma.numpy(),
        )
