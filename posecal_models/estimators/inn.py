"""The invertible network of Wehrbein et al.: a bijection between poses and their keypoints with latents.

Sampling draws the latents and inverts the map at the detected keypoints.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.data.standardizer import check_pixels
from posecal_models.estimators.latent import LatentPoses
from posecal_models.estimators.mixture_density import Variant
from posecal_models.estimators.simple_baseline import HOURGLASS, check_all_keypoints

__all__ = ["INN", "PoseUnits"]

_BLOCKS = 8
_FEATURES = 56
_CLAMP = 2.0
_LARGE_SIGMA = 2.1
"""Standard deviation of a heatmap from which on a keypoint is uncertain, pixels of 64 x 64 heatmaps."""


class PoseUnits(nn.Module):
    """From millimetres and pixels to the units of the network; nothing is fitted.

    Poses are in metres relative to the mean of their joints, with y up and z towards the camera; keypoints are relative
    to their mean, with y up, and divided by the standard deviation of all numbers of that image. All x come first.

    Parameters
    ----------
    joints : tuple of str
        K joints of the pose, both hips among them.
    """

    def __init__(self, joints: tuple[str, ...]) -> None:
        super().__init__()
        self._hips = [joints.index("RHip"), joints.index("LHip")]
        self.register_buffer("_signs", torch.tensor([1.0, -1, -1]), persistent=False)

    _signs: Tensor

    def fit(self, poses: Tensor, keypoints: Tensor, observed: Tensor | None = None) -> None:
        """Do nothing: the units don't depend on the training set."""

    def check_keypoints(self, context: Context) -> None:
        """Raise an error for keypoints that look normalised already; see :func:`check_pixels`."""
        check_pixels(context)

    def poses(self, poses: Tensor) -> Tensor:
        """Convert poses (..., K, 3) in mm to (..., 3 K)."""
        centred = (poses - poses.mean(-2, keepdim=True)) * self._signs / 1000
        return centred.transpose(-1, -2).flatten(-2)

    def metres(self, numbers: Tensor) -> Tensor:
        """Convert (..., 3 K) to poses (..., K, 3) in metres, relative to the midpoint of the hips."""
        poses: Tensor = numbers.reshape(*numbers.shape[:-1], 3, -1).transpose(-1, -2) * self._signs
        hips = poses[..., self._hips[0], :] + poses[..., self._hips[1], :]
        return poses - hips[..., None, :] / 2

    def keypoints(self, context: Context) -> Tensor:
        """Convert all keypoints, observed or not, to (M, 2 J)."""
        centred = (context.keypoints - context.keypoints.mean(1, keepdim=True)) * self._signs[:2]
        numbers: Tensor = centred.transpose(1, 2).flatten(1)
        return numbers / numbers.square().mean(1, keepdim=True).sqrt().clamp(min=1e-6)


class _Subnet(nn.Module):
    """From half of the numbers and the condition to log scale and shift of the other half."""

    def __init__(self, half: int, width: int) -> None:
        super().__init__()
        self.first = nn.Linear(half, width)
        self.condition = nn.Linear(_FEATURES, width, bias=False)
        self.last = nn.Linear(width, 2 * half)

    def forward(self, half: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        log_scale, shift = self.last(torch.relu(self.first(half) + self.condition(condition))).chunk(2, dim=-1)
        return 0.636 * _CLAMP * torch.atan(log_scale / _CLAMP), shift


class _Coupling(nn.Module):
    """An affine coupling of both halves, each given the other and the condition, and a fixed permutation."""

    order: Tensor
    inverse_order: Tensor

    def __init__(self, numbers: int, width: int, seed: int) -> None:
        super().__init__()
        self.first, self.second = (_Subnet(numbers // 2, width) for _ in range(2))
        order = torch.from_numpy(np.random.RandomState(seed).permutation(numbers))
        self.register_buffer("order", order, persistent=False)
        self.register_buffer("inverse_order", order.argsort(), persistent=False)

    def forward(self, numbers: Tensor, condition: Tensor) -> Tensor:
        one, two = numbers.chunk(2, dim=-1)
        log_scale, shift = self.second(two, condition)
        one = log_scale.exp() * one + shift
        log_scale, shift = self.first(one, condition)
        return torch.cat([one, log_scale.exp() * two + shift], dim=-1)[..., self.order]

    def inverse(self, numbers: Tensor, condition: Tensor) -> Tensor:
        one, two = numbers[..., self.inverse_order].chunk(2, dim=-1)
        log_scale, shift = self.first(one, condition)
        two = (two - shift) * (-log_scale).exp()
        log_scale, shift = self.second(two, condition)
        return torch.cat([(one - shift) * (-log_scale).exp(), two], dim=-1)


class INN(nn.Module):
    r"""Wehrbein et al.'s conditional invertible network.

    .. math:: [z, c] = f(x; h), \qquad z \sim \mathcal N(0, I)

    with poses x, keypoints c, latents z of the remaining dimensions and the condition h, features of the Gaussians that
    are fitted to a detector's heatmaps. From ``context.sigma`` these are isotropic with amplitude 1.

    Parameters
    ----------
    joints, keypoints : tuple of str
        K joints of the pose, without the root but with both hips, and J keypoints. Human3.6M's 16 and those of the
        stacked hourglass network where not given.
    width : int
        Hidden features of a coupling's networks.
    variant : str
        The losses that it is trained by, see :mod:`posecal_models.adversarial`.

    Raises
    ------
    PoseDataError
        Where poses have no more numbers than keypoints, or an odd number of them.

    Notes
    -----
    With 16 keypoints and 16 joints it has 2,157,176 parameters, the published number.

    Differs from the published code: the heatmap's Gaussians are made of the detector's σ, whose unit is a 64th of a
    square 1.25 times as large as the keypoints' extent. As there, the hips and their midpoint have no condition, nor
    has the neck, which stands for the midpoint where the data have no keypoint of it.

    References
    ----------
    Wehrbein et al. 2021, arXiv:2107.13788.

    Examples
    --------
    >>> sum(p.numel() for p in INN().parameters())
    2157176
    """

    def __init__(
        self,
        joints: tuple[str, ...] | None = None,
        keypoints: tuple[str, ...] | None = None,
        *,
        width: int = 1028,
        variant: Variant = "repaired",
    ) -> None:
        super().__init__()
        self.joints = joint_set("h36m-16") if joints is None else joints
        self.keypoints = HOURGLASS if keypoints is None else keypoints
        self.variant: Variant = variant
        self.options = {"width": width, "variant": variant}
        numbers = 3 * len(self.joints)
        self.latents = numbers - 2 * len(self.keypoints)
        if self.latents < 1 or numbers % 2:
            raise PoseDataError(
                f"INN: {numbers} coordinates of poses and {2 * len(self.keypoints)} of keypoints; expected an even "
                "number, and more than those of the keypoints."
            )
        without = ("Hip", "RHip", "LHip", "Neck/Nose")
        self.conditioned = [name for name in self.keypoints if name not in without]
        self._columns = [self.keypoints.index(name) for name in self.conditioned]
        self.condition = nn.Sequential(nn.Linear(6 * len(self.conditioned), 256), nn.ReLU(), nn.Linear(256, _FEATURES))
        self.blocks = nn.ModuleList(_Coupling(numbers, width, seed) for seed in range(_BLOCKS))
        self.standardizer = PoseUnits(self.joints)
        for parameter in self.blocks.parameters():
            nn.init.normal_(parameter, 0, 0.05)

    def check(self, context: Context) -> None:
        """Raise an error where a keypoint is missing or not finite; all are read, observed or not."""
        check_all_keypoints(context, self.keypoints, "An INN")

    def heatmap_sigma(self, context: Context) -> Tensor:
        """Compute σ of the conditioned keypoints' heatmaps, (M, 13), pixels of the heatmap; large ones are doubled."""
        if context.sigma is None:
            return context.keypoints.new_full((len(context), len(self._columns)), 0.2)
        extent = (context.keypoints.amax(1) - context.keypoints.amin(1)).amax(-1, keepdim=True).clamp(min=1e-6)
        sigma = (context.sigma[:, self._columns] * 64 / (1.25 * extent)).clamp(0.2, 10)
        return torch.where(sigma > _LARGE_SIGMA, 2 * sigma, sigma)

    def inputs(self, context: Context) -> tuple[Tensor, Tensor]:
        """Compute keypoints (M, 2 J) in the network's units and the condition's features (M, 56)."""
        self.check(context)
        keypoints = self.standardizer.keypoints(context)
        x, y = (axis[:, self._columns] for axis in keypoints.chunk(2, dim=-1))
        variance = (self.heatmap_sigma(context) / 20).square()
        zero = torch.zeros_like(variance)
        gaussians = torch.stack([torch.ones_like(zero), x, y, variance, zero, variance], dim=-1)
        return keypoints, self.condition(gaussians.flatten(1))

    def transform(self, poses: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Map poses (..., 3 K) to latents (..., L) and keypoints (..., 2 J), all in the network's units."""
        for block in self.blocks:
            poses = block(poses, condition)
        return poses[..., : self.latents], poses[..., self.latents :]

    def inverse(self, latents: Tensor, keypoints: Tensor, condition: Tensor) -> Tensor:
        """Map latents (..., M, L) and keypoints (M, 2 J) to poses (..., M, 3 K), all in the network's units."""
        numbers = torch.cat([latents, keypoints.expand(*latents.shape[:-1], -1)], dim=-1)
        for block in reversed(self.blocks):
            numbers = block.inverse(numbers, condition)  # type: ignore[operator]
        return numbers

    def forward(self, context: Context) -> LatentPoses:
        """Return the distribution of the poses with these keypoints.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels, and the detector's σ; all of them are read, observed or not.

        Returns
        -------
        LatentPoses
            Of M poses, mm.

        Raises
        ------
        PoseDataError
            As :meth:`check`.
        """
        keypoints, condition = self.inputs(context)

        def decode(latents: Tensor) -> Tensor:
            return 1000 * self.standardizer.metres(self.inverse(latents, keypoints, condition))

        reason = "poses of an INN project exactly onto the keypoints, so they have no density in all dimensions."
        return LatentPoses(decode, self.latents, keypoints, reason)
