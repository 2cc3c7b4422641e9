"""In which units does a network see poses and keypoints? Constants, fitted on the training set, saved with weights.

Keypoints are taken relative to the mean of the observed ones (a person is the same person wherever in the image), then
divided by one number; poses have a mean pose taken off and are divided by one number. Both are affine, so a density
keeps its meaning: log p in mm is log p of the standardised pose less K * D * log(scale).
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor, nn

from posecal.errors import PoseDataError
from posecal_models.contract import Context

__all__ = ["Origin", "Standardizer", "check_pixels"]

Origin = Literal["observed", "root", "none"]

SMALLEST = 2.0
"""Keypoints of people that spread over less, pixels, are none in pixels."""


class Standardizer(nn.Module):
    r"""The affine maps between millimetres or pixels and what a network sees.

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
        What keypoints are relative to: ``observed``, ``root`` or ``none``.

    Notes
    -----
    Differs from the published code: it multiplies 2D by 0.0139 and 3D by 0.0036, whatever the data;
    :meth:`released` gives these constants.

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
        """Give the published code's constants: 2D * 0.0139 and 3D * 0.0036, nothing taken off.

        Parameters
        ----------
        joints : int
            K.
        origin : str
            What keypoints are relative to; in that code to the hip's.

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
        """Take the constants from training data.

        Poses in two dimensions, such as a pendulum's, are of no camera: theirs may be any keypoints.

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
        known = torch.ones_like(keypoints[..., 0], dtype=torch.bool) if observed is None else observed
        self.pose_mean.copy_(poses.double().mean(0))
        self.pose_scale.copy_((poses.double() - self.pose_mean.double()).square().mean().sqrt())
        if not self.pose_scale > 0:
            raise PoseDataError(f"poses: all {len(poses):,} are the same pose; expected poses that vary.")
        self.keypoint_scale.fill_(1)
        centred = self.keypoints(Context(keypoints, known))[known]
        spread = float(centred.double().square().mean().sqrt())
        self.keypoint_scale.fill_(spread if spread > 0 else 1)

    def check_keypoints(self, context: Context) -> None:
        """Refuse keypoints that are not in the pixels this was fitted on.

        Parameters
        ----------
        context : Context
            Keypoints as a user gives them.

        Raises
        ------
        PoseDataError
            Where they spread over less than a fiftieth of what training keypoints did, as keypoints do that were
            normalised already.
        """
        several = context.observed.sum(-1) > 1
        if not several.any():
            return
        centred = self.keypoints(context[several])
        spread = float(centred[context.observed[several]].square().mean().sqrt())
        if spread < 0.02:
            raise PoseDataError(
                f"keypoints: spread over {spread * float(self.keypoint_scale):.3g} about their centre where those of "
                f"training spread over {float(self.keypoint_scale):.3g} pixels; expected pixels. "
                "They look normalised already: give the pixels."
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
        """Standardise the keypoints, also those that are not observed, for estimators that read them all.

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
            known = context.observed[..., None]
            count = known.sum(1, keepdim=True).clamp(min=1)
            origin = torch.where(known, context.keypoints, 0).sum(1, keepdim=True) / count
        return (context.keypoints - origin) / self.keypoint_scale

    def poses(self, poses: Tensor) -> Tensor:
        """Standardise poses (..., K, D) in mm; unitless."""
        return (poses - self.pose_mean) / self.pose_scale

    def millimetres(self, poses: Tensor) -> Tensor:
        """Turn standardised poses (..., K, D) back into mm."""
        return poses * self.pose_scale + self.pose_mean

    @property
    def log_determinant(self) -> Tensor:
        """Log of the volume that one unit of a standardised pose has in mm: K * D * log(scale), nats."""
        return self.pose_mean.numel() * self.pose_scale.log()

    def extra_repr(self) -> str:
        """Show the constants."""
        if not math.isfinite(float(self.pose_scale)):
            return f"origin={self.origin!r}"
        return (
            f"origin={self.origin!r}, pose_scale={float(self.pose_scale):.1f} mm, "
            f"keypoint_scale={float(self.keypoint_scale):.1f} px"
        )


def check_pixels(context: Context) -> None:
    """Refuse keypoints that look normalised already.

    Parameters
    ----------
    context : Context
        Keypoints of M poses, pixels.

    Raises
    ------
    PoseDataError
        Where the observed ones spread over less than 2 pixels about the middle of their pose.
    """
    several = context.observed.sum(-1) > 1
    seen, known = context.keypoints[several].double(), context.observed[several][..., None]
    if not len(seen):
        return
    middle = torch.where(known, seen, 0).sum(1, keepdim=True) / known.sum(1, keepdim=True)
    spread = float((seen - middle)[known[..., 0]].square().mean().sqrt())
    if spread < SMALLEST:
        raise PoseDataError(
            f"keypoints: spread over {spread:.3g} about their centre; expected {SMALLEST:g} pixels or more. "
            "They look normalised already: give the pixels."
        )
