"""The conditional variational autoencoder of Sharma et al.: poses from standard normal latents and all keypoints."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from posecal.data.skeleton import joint_set
from posecal_models.contract import Context
from posecal_models.data.standardizer import CoordinateStandardizer, Origin
from posecal_models.estimators.latent import LatentPoses
from posecal_models.estimators.mixture_density import Variant
from posecal_models.estimators.simple_baseline import HOURGLASS, DenseLayer, ResidualBlock, check_all_keypoints

__all__ = ["CVAE"]


class CVAE(nn.Module):
    r"""Sharma et al.'s conditional variational autoencoder.

    .. math:: z \sim \mathcal N(0, I), \qquad y = f(z, c)

    with standardised poses y and keypoints c. In training z comes from an encoder that also reads the pose.

    Parameters
    ----------
    joints, keypoints : tuple of str
        K joints of the pose, without the root, and J keypoints. Human3.6M's 16 and those of the stacked hourglass
        network where not given.
    width, residuals : int
        Features of a layer, a quarter of them latents, and number of residual blocks of encoder and decoder.
    dropout : float
        Dropout probability in training.
    origin : str
        Origin of the keypoints; ``none``, as published, keeps their position in the image.
    variant : str
        ``released``: the encoder's means and log variances pass through batch norm, ReLU and dropout, so that no mean
        is negative and no σ is below 1. ``repaired``: they are linear, and poses have Gaussian noise around the
        decoder's output, with one σ for each coordinate; see :mod:`posecal_models.published_losses` for the losses.

    Notes
    -----
    With 16 keypoints and 16 joints the ``released`` one has 9,100,080 parameters, the published number; the
    ``repaired`` one 1,024 less, those of the batch norm, and 48 more, the σ.

    Differs from the published code: its scores of depth relations, which choose one pose, are not here.

    References
    ----------
    Sharma et al. 2019, arXiv:1904.01324.

    Examples
    --------
    >>> sum(p.numel() for p in CVAE(variant="released").parameters())
    9100080
    """

    def __init__(
        self,
        joints: tuple[str, ...] | None = None,
        keypoints: tuple[str, ...] | None = None,
        *,
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
            "width": width,
            "residuals": residuals,
            "dropout": dropout,
            "origin": origin,
            "variant": variant,
        }
        self.latents = width // 4
        inputs, outputs = 2 * len(self.keypoints), 3 * len(self.joints)

        def blocks() -> list[nn.Module]:
            return [ResidualBlock(width, dropout) for _ in range(residuals)]

        head: nn.Module = nn.Linear(width, 2 * self.latents)
        if variant == "released":
            head = DenseLayer(width, 2 * self.latents, dropout)
        self.encoder = nn.Sequential(DenseLayer(inputs + outputs, width, dropout), *blocks(), head)
        self.condition = DenseLayer(inputs, width - self.latents, dropout)
        self.decoder = nn.Sequential(*blocks(), nn.Linear(width, outputs))
        if variant == "repaired":
            self.log_sigma = nn.Parameter(torch.zeros(outputs))
        self.standardizer = CoordinateStandardizer(len(self.joints), len(self.keypoints), origin=origin)
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.kaiming_normal_(module.weight)

    def check(self, context: Context) -> None:
        """Raise an error where a keypoint is missing or not finite; all are read, observed or not."""
        check_all_keypoints(context, self.keypoints, "A CVAE")

    def standardised_keypoints(self, context: Context) -> Tensor:
        """Standardise the keypoints, (M, 2 J), after :meth:`check`."""
        self.check(context)
        return self.standardizer.all_keypoints(context).flatten(1)

    def encode(self, keypoints: Tensor, poses: Tensor) -> tuple[Tensor, Tensor]:
        """Compute mean and log variance (M, L) of the latents of standardised keypoints (M, 2 J) and poses (M, 3 K)."""
        mean, log_variance = self.encoder(torch.cat([keypoints, poses], dim=-1)).chunk(2, dim=-1)
        return mean, log_variance

    def decode(self, latents: Tensor, keypoints: Tensor) -> Tensor:
        """Make standardised poses (n, M, 3 K) of latents (n, M, L) and standardised keypoints (M, 2 J)."""
        rows = keypoints.expand(len(latents), *keypoints.shape).flatten(0, 1)
        features = torch.cat([latents.flatten(0, 1), self.condition(rows)], dim=-1)
        return torch.unflatten(self.decoder(features), 0, latents.shape[:2])

    def forward(self, context: Context) -> LatentPoses:
        """Return the distribution of the poses with these keypoints.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels; all of them are read, observed or not.

        Returns
        -------
        LatentPoses
            Of M poses, mm.

        Raises
        ------
        PoseDataError
            As :meth:`check`.
        """
        keypoints = self.standardised_keypoints(context)
        noisy = self.variant == "repaired"

        def decode(latents: Tensor) -> Tensor:
            poses = self.decode(latents[..., : self.latents], keypoints)
            if noisy:
                poses = poses + self.log_sigma.exp() * latents[..., self.latents :]
            return self.standardizer.millimetres(poses.view(*poses.shape[:2], -1, 3))

        count = self.latents + noisy * 3 * len(self.joints)
        reason = "the density of a CVAE is an integral over its latents; its bound needs the true pose."
        return LatentPoses(decode, count, keypoints, reason)
