"""Interface of estimators: from 2D keypoints to a distribution of 3D poses.

One contract for the reference models and for any other: ``estimator(context)`` returns a :class:`PoseDistribution`
with ``.sample(n)`` and ``.log_prob(truth)``. The classes here are protocols: subclassing is not needed.

Letters: N hypotheses, M poses, K joints. Poses are in millimetres, relative to the root, in the camera's frame (x to
the right, y down, z away from the camera); keypoints are in pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from posecal.errors import PoseDataError, first_few, raise_all

__all__ = [
    "Context",
    "Estimator",
    "PointEstimate",
    "PoseDistribution",
    "check_keypoints",
    "check_truth",
    "standard_normal",
]


@dataclass(frozen=True)
class Context:
    """2D keypoints of M poses, the input of an estimator.

    Attributes
    ----------
    keypoints : Tensor
        (M, K, 2), pixels. Values of missing keypoints are not read and may be NaN.
    observed : Tensor
        (M, K), bool: which keypoints were detected.
    sigma : Tensor or None
        (M, K), pixels: the detector's own standard deviation of each keypoint, where it gives one.

    Raises
    ------
    PoseDataError
        Where shapes or types don't fit, or an observed keypoint is not finite (not checked on a GPU, where it would
        need a synchronisation).

    Examples
    --------
    >>> context = Context(torch.zeros(5, 16, 2), torch.ones(5, 16, dtype=torch.bool))
    >>> len(context), len(context[:2]), int(context.without_keypoints().observed.sum())
    (5, 2, 0)
    """

    keypoints: Tensor
    observed: Tensor
    sigma: Tensor | None = None

    def __post_init__(self) -> None:
        shape = tuple(self.keypoints.shape)
        if len(shape) != 3 or shape[2] != 2:
            raise PoseDataError(f"keypoints {shape}: expected (M, K, 2).")
        problems = []
        if tuple(self.observed.shape) != shape[:2] or self.observed.dtype != torch.bool:
            problems.append(
                f"observed {tuple(self.observed.shape)} {self.observed.dtype}: expected bool of shape {shape[:2]}."
            )
        if self.sigma is not None and tuple(self.sigma.shape) != shape[:2]:
            problems.append(f"sigma {tuple(self.sigma.shape)}: expected {shape[:2]}, one number per keypoint.")
        raise_all(problems)
        if self.keypoints.device.type == "cpu":
            _check_finite(self.keypoints, self.observed)

    def __len__(self) -> int:
        return len(self.keypoints)

    def __getitem__(self, poses: slice | Tensor) -> Context:
        return Context(
            self.keypoints[poses],
            self.observed[poses],
            None if self.sigma is None else self.sigma[poses],
        )

    def to(self, device: torch.device | str, dtype: torch.dtype | None = None) -> Context:
        """Move to a device, and convert to a floating type where one is given."""
        return Context(
            self.keypoints.to(device, dtype),
            self.observed.to(device),
            None if self.sigma is None else self.sigma.to(device, dtype),
        )

    def without_keypoints(self) -> Context:
        """Return the same context with no keypoint observed: the context of the prior."""
        return replace(self, observed=torch.zeros_like(self.observed))


def _check_finite(keypoints: Tensor, observed: Tensor) -> None:
    """Raise an error for observed keypoints that are not finite."""
    broken = observed & ~keypoints.isfinite().all(-1)
    if broken.any():
        pose, keypoint = broken.nonzero()[0].tolist()
        raise PoseDataError(
            f"keypoints: {int(broken.sum()):,} of {int(observed.sum()):,} observed ones are not finite (first: image "
            f"{pose}, keypoint {keypoint}). Mark them as not observed."
        )


def check_keypoints(context: Context, keypoints: tuple[str, ...]) -> None:
    """Check the number of keypoints against those that an estimator reads.

    Parameters
    ----------
    context : Context
        Keypoints of M poses.
    keypoints : tuple of str
        The names that the estimator reads, in order.

    Raises
    ------
    PoseDataError
        Where there are more or fewer.
    """
    if context.keypoints.shape[1] != len(keypoints):
        raise PoseDataError(
            f"keypoints {tuple(context.keypoints.shape)}: expected (M, {len(keypoints)}, 2), in the order of "
            f"{first_few(keypoints)}."
        )


def check_truth(truth: Tensor, poses: int, joints: int, dimensions: int = 3) -> None:
    """Check the shape of true poses against that of a distribution.

    Parameters
    ----------
    truth : Tensor
        Expected: (M, K, D), mm.
    poses, joints, dimensions : int
        M, K and D.

    Raises
    ------
    PoseDataError
        Where it has another shape; nothing is broadcast.
    """
    if tuple(truth.shape) != (poses, joints, dimensions):
        raise PoseDataError(f"truth {tuple(truth.shape)}: expected (M, K, D) = {(poses, joints, dimensions)}.")


def standard_normal(shape: tuple[int, ...], like: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Draw standard normal numbers on the CPU and move them, so that a seed gives the same ones on every device.

    Parameters
    ----------
    shape : tuple of int
        The shape.
    like : Tensor
        A tensor on the device and of the type of the result.
    generator : torch.Generator, optional
        A generator of the CPU; torch's own where not given.

    Returns
    -------
    Tensor
        Of this shape.
    """
    return torch.randn(shape, generator=generator, dtype=like.dtype).to(like.device)


@runtime_checkable
class PoseDistribution(Protocol):
    """Distributions of the M poses of a context."""

    def sample(self, n: int, *, generator: torch.Generator | None = None) -> Tensor:
        """Draw n hypotheses of each pose.

        Parameters
        ----------
        n : int
            N.
        generator : torch.Generator, optional
            The source of randomness, of the CPU; torch's own where not given.

        Returns
        -------
        Tensor
            (N, M, K, 3), mm. Reference estimators have a ``temperature``, the scale of the noise, too.
        """
        ...

    def log_prob(self, truth: Tensor) -> Tensor:
        """Compute the log density of poses.

        Parameters
        ----------
        truth : Tensor
            (M, K, 3), mm.

        Returns
        -------
        Tensor
            (M,), nats per pose in mm; higher is better.

        Raises
        ------
        PoseDataError
            Where the truth has another shape, or there is no density.
        """
        ...


@runtime_checkable
class Estimator(Protocol):
    """A callable from keypoints to a distribution of poses."""

    @property
    def joints(self) -> tuple[str, ...]:
        """K names: the joints of the poses."""
        ...

    @property
    def keypoints(self) -> tuple[str, ...]:
        """The names of the keypoints that a context must hold, in order."""
        ...

    def __call__(self, context: Context) -> PoseDistribution:
        """Return the distribution of the poses with these keypoints."""
        ...


class PointEstimate:
    """The distribution of a point estimator: all of its mass at one pose.

    Parameters
    ----------
    pose : Tensor
        (M, K, 3), mm.

    Examples
    --------
    >>> PointEstimate(torch.zeros(4, 15, 3)).sample(2).shape
    torch.Size([2, 4, 15, 3])
    """

    def __init__(self, pose: Tensor) -> None:
        self.pose = pose

    def sample(self, n: int, *, generator: torch.Generator | None = None) -> Tensor:
        """Repeat the estimate n times, (n, M, K, 3) in mm; nothing is random."""
        del generator
        return self.pose.expand(n, *self.pose.shape)

    def log_prob(self, truth: Tensor) -> Tensor:
        """Raise an error: a point has no density.

        Raises
        ------
        PoseDataError
            Always.
        """
        raise PoseDataError(
            f"log_prob of {len(truth)} poses: a point estimate has no density. "
            "Add Gaussian noise with posecal_models.estimators.gaussian_noise.GaussianNoise."
        )

    def mode(self) -> Tensor:
        """Return the estimate itself, (M, K, 3), mm."""
        return self.pose
