"""Standardisation of poses and keypoints, with constants fitted on the training set and saved with the weights.

Keypoints are taken relative to the mean of the observed ones, so that the position of a person in the image does not
matter, and divided by one number; the mean pose is subtracted from poses, which are divided by one number. Both maps
are affine, so that densities can be converted: log p in mm is log p of the standardised pose minus K * D * log(scale).
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor, nn

from posecal.errors import PoseDataError
from posecal_models.contract import Context

__all__ = ["CoordinateStandardizer", "Origin", "Standardizer", "check_pixels"]

Origin = Literal["observed", "root", "none"]

MIN_SPREAD = 2.0
"""Minimum standard deviation of keypoints about their centre, pixels; below it they are not in pixels."""


class Standardizer(nn.Module):
    r"""The affine maps between millimetres or pixels and the units of a network.

    .. math:: x = (\mathrm{pose} - \mu) / s, \qquad c = (\mathrm{keypoint} - o) / r

    with the origin o the mean of the pose's observed keypoints (``observed``), the first of them, which is the root's
    (``root``), or zero (``none``).

    Parameters
    ----------
    joints : int
        K.
    dimensions : int
        D.
    origin : str
        Origin of the keypoints: ``observed``, ``root`` or ``none``.

    Notes
    -----
    Differs from the published code: there 2D is multiplied by 0.0139 and 3D by 0.0036, for all data; :meth:`released`
    gives these constants.

    Examples
    --------
    >>> standardizer = Standardizer(joints=1)
    >>> standardizer.fit(poses=torch.tensor([[[3.0, 0, 4]], [[-3.0, 0, -4]]]), keypoints=torch.zeros(2, 1, 2) + 7)
    >>> standardizer.pose_scale  # sqrt of the mean of 9, 0, 16, 9, 0, 16
    tensor(2.8868)
    """

    pose_mean: Tensor
    pose_scale: Tensor
    keypoint_scale: Tensor

    def __init__(self, joints: int, *, dimensions: int = 3, origin: Origin = "observed") -> None:
        super().__init__()
        self.origin: Origin = origin
        self.register_buffer("pose_mean", torch.zeros(joints, dimensions))
        self.register_buffer("pose_scale", torch.ones(()))
        self.register_buffer("keypoint_scale", torch.ones(()))

    @classmethod
    def released(cls, joints: int, *, origin: Origin = "root") -> Standardizer:
        """Build with the published code's constants: 2D * 0.0139 and 3D * 0.0036, without a mean pose.

        Parameters
        ----------
        joints : int
            K.
        origin : str
            Origin of the keypoints; in that code the hip's.

        Returns
        -------
        Standardizer
            With these constants.
        """
        standardizer = cls(joints, origin=origin)
        standardizer.pose_scale.fill_(1 / 0.0036)
        standardizer.keypoint_scale.fill_(1 / 0.0139)
        return standardizer

    def fit(self, poses: Tensor, keypoints: Tensor, observed: Tensor | None = None) -> None:
        """Fit the constants to training data.

        Poses in two dimensions, such as a pendulum's, have no camera: their keypoints may be in any unit.

        Parameters
        ----------
        poses : Tensor
            (M, K, D), mm.
        keypoints : Tensor
            (M, K, 2), pixels.
        observed : Tensor, optional
            (M, K), bool; all where not given.

        Raises
        ------
        PoseDataError
            Where all poses are the same, or an observed keypoint is not finite.
        """
        mask = torch.ones_like(keypoints[..., 0], dtype=torch.bool) if observed is None else observed
        self.pose_mean.copy_(poses.double().mean(0))
        self.pose_scale.copy_((poses.double() - self.pose_mean.double()).square().mean().sqrt())
        if not self.pose_scale > 0:
            raise PoseDataError(f"poses: all {len(poses):,} are the same pose; expected different poses.")
        self.keypoint_scale.fill_(1)
        centred = self.keypoints(Context(keypoints, mask))[mask]
        spread = float(centred.double().square().mean().sqrt())
        self.keypoint_scale.fill_(spread if spread > 0 else 1)

    def check_keypoints(self, context: Context) -> None:
        """Raise an error for keypoints that are not in the unit of the training set.

        Parameters
        ----------
        context : Context
            Keypoints as given by a user.

        Raises
        ------
        PoseDataError
            Where their standard deviation is below a fiftieth of that of the training keypoints, as for keypoints that
            are normalised already.
        """
        several = context.observed.sum(-1) > 1
        if not several.any():
            return
        centred = self.keypoints(context[several])
        spread = float(centred[context.observed[several]].square().mean().sqrt())
        if spread < 0.02:
            raise PoseDataError(
                f"keypoints: standard deviation {spread * float(self.keypoint_scale):.3g} about their centre, where "
                f"those of training have {float(self.keypoint_scale):.3g} pixels; expected pixels. "
                "They look normalised already: give pixels."
            )

    def keypoints(self, context: Context) -> Tensor:
        """Standardise the keypoints.

        Parameters
        ----------
        context : Context
            Keypoints in pixels.

        Returns
        -------
        Tensor
            (M, K, 2), unitless; 0 where nothing was observed.
        """
        return torch.where(context.observed[..., None], self.all_keypoints(context), 0)

    def all_keypoints(self, context: Context) -> Tensor:
        """Standardise all keypoints, observed or not, for estimators that read every keypoint.

        Parameters
        ----------
        context : Context
            Keypoints in pixels.

        Returns
        -------
        Tensor
            (M, K, 2), unitless; relative to the origin.
        """
        origin = context.keypoints[:, :1] if self.origin == "root" else torch.zeros_like(context.keypoints[:, :1])
        if self.origin == "observed":
            observed = context.observed[..., None]
            count = observed.sum(1, keepdim=True).clamp(min=1)
            origin = torch.where(observed, context.keypoints, 0).sum(1, keepdim=True) / count
        return (context.keypoints - origin) / self.keypoint_scale

    def poses(self, poses: Tensor) -> Tensor:
        """Standardise poses (..., K, D) in mm; unitless."""
        return (poses - self.pose_mean) / self.pose_scale

    def millimetres(self, poses: Tensor) -> Tensor:
        """Turn standardised poses (..., K, D) back into mm."""
        return poses * self.pose_scale + self.pose_mean

    @property
    def log_determinant(self) -> Tensor:
        """Log of the volume in mm of a unit volume of standardised poses: the sum of log(scale) over K * D, nats."""
        return self.pose_scale.log().expand_as(self.pose_mean).sum()

    def extra_repr(self) -> str:
        """Format the constants."""
        if not math.isfinite(float(self.pose_scale)):
            return f"origin={self.origin!r}"
        return (
            f"origin={self.origin!r}, pose_scale={float(self.pose_scale):.1f} mm, "
            f"keypoint_scale={float(self.keypoint_scale):.1f} px"
        )


class CoordinateStandardizer(Standardizer):
    r"""The affine maps with a mean and a standard deviation of each coordinate.

    .. math:: x_{kd} = (\mathrm{pose}_{kd} - \mu_{kd}) / s_{kd}, \qquad
              c_{jd} = (\mathrm{keypoint}_{jd} - o_d - \nu_{jd}) / r_{jd}

    Parameters
    ----------
    joints, keypoints : int
        K and J.
    origin : str
        Origin of the keypoints; ``none`` keeps their position in the image.

    Examples
    --------
    >>> standardizer = CoordinateStandardizer(joints=1, keypoints=1)
    >>> standardizer.fit(torch.tensor([[[3.0, 0, 40]], [[5.0, 2, 20]]]), torch.tensor([[[600.0, 5]], [[700.0, 9]]]))
    >>> standardizer.pose_scale, standardizer.keypoint_scale
    (tensor([[ 1.,  1., 10.]]), tensor([[50.,  2.]]))
    """

    keypoint_mean: Tensor

    def __init__(self, joints: int, keypoints: int, *, origin: Origin = "none") -> None:
        super().__init__(joints, origin=origin)
        self.register_buffer("pose_scale", torch.ones(joints, 3))
        self.register_buffer("keypoint_mean", torch.zeros(keypoints, 2))
        self.register_buffer("keypoint_scale", torch.ones(keypoints, 2))

    def fit(self, poses: Tensor, keypoints: Tensor, observed: Tensor | None = None) -> None:
        """Fit the constants to training data; see :meth:`Standardizer.fit`.

        A coordinate that does not vary is divided by 1.

        Parameters
        ----------
        poses : Tensor
            (M, K, 3), mm.
        keypoints : Tensor
            (M, J, 2), pixels.
        observed : Tensor, optional
            (M, J), bool; all where not given. The others are left out.
        """
        mask = torch.ones_like(keypoints[..., 0], dtype=torch.bool) if observed is None else observed
        self.keypoint_mean.zero_()
        self.keypoint_scale.fill_(1)
        centred = self.all_keypoints(Context(keypoints, mask)).double()
        weights = mask[..., None] / mask.sum(0).clamp(min=1)[:, None]
        self.keypoint_mean.copy_(torch.where(mask[..., None], weights * centred, 0).sum(0))
        squares = (centred - self.keypoint_mean.double()).square()
        self.keypoint_scale.copy_(_or_one(torch.where(mask[..., None], weights * squares, 0).sum(0).sqrt()))
        self.pose_mean.copy_(poses.double().mean(0))
        spread = (poses.double() - self.pose_mean.double()).square().mean(0).sqrt()
        if not spread.any():
            raise PoseDataError(f"poses: all {len(poses):,} are the same pose; expected different poses.")
        self.pose_scale.copy_(_or_one(spread))

    def check_keypoints(self, context: Context) -> None:
        """Raise an error for keypoints that look normalised already; see :func:`check_pixels`."""
        check_pixels(context)

    def all_keypoints(self, context: Context) -> Tensor:
        """Standardise all keypoints, observed or not: (M, J, 2), unitless."""
        return super().all_keypoints(context) - self.keypoint_mean / self.keypoint_scale

    def extra_repr(self) -> str:
        """Format the constants."""
        return f"origin={self.origin!r}, joints={len(self.pose_scale)}, keypoints={len(self.keypoint_scale)}"


def _or_one(spread: Tensor) -> Tensor:
    return torch.where(spread > 0, spread, 1)


def check_pixels(context: Context) -> None:
    """Raise an error for keypoints that look normalised already.

    Parameters
    ----------
    context : Context
        Keypoints of M poses, pixels.

    Raises
    ------
    PoseDataError
        Where the standard deviation of the observed ones about their centre is below 2 pixels.
    """
    several = context.observed.sum(-1) > 1
    keypoints, observed = context.keypoints[several].double(), context.observed[several][..., None]
    if not len(keypoints):
        return
    centre = torch.where(observed, keypoints, 0).sum(1, keepdim=True) / observed.sum(1, keepdim=True)
    spread = float((keypoints - centre)[observed[..., 0]].square().mean().sqrt())
    if spread < MIN_SPREAD:
        raise PoseDataError(
            f"keypoints: standard deviation {spread:.3g} about their centre; expected {MIN_SPREAD:g} pixels or more. "
            "They look normalised already: give pixels."
        )
