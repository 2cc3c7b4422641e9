"""Distributions of PyTorch, and of libraries built on them such as zuko and Pyro, under the contract of estimators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import overload

import torch
from torch import Tensor
from torch.distributions import Distribution

from posecal.errors import PoseDataError, first_few
from posecal_models.contract import Context, check_keypoints, check_truth

__all__ = ["TorchEstimator", "TorchPoses", "from_torch"]


@dataclass(frozen=True)
class TorchPoses:
    """The distributions of M poses that a distribution of PyTorch states; see :func:`from_torch`.

    Attributes
    ----------
    distribution : torch.distributions.Distribution
        Of batch shape (M,) and event shape (3K,) or (K, 3), mm.
    joints : tuple of str
        K names.

    Raises
    ------
    PoseDataError
        Where its shapes are others.
    """

    distribution: Distribution
    joints: tuple[str, ...]

    def __post_init__(self) -> None:
        batch, event = tuple(self.distribution.batch_shape), tuple(self.distribution.event_shape)
        expected = (3 * len(self.joints),), (len(self.joints), 3)
        if len(batch) == 1 and event in expected:
            return
        advice = ""
        if not event and len(batch) > 1:
            advice = f" Independent(distribution, {len(batch) - 1}) makes the coordinates of a pose one event."
        elif not batch:
            advice = " distribution.expand((M,)) repeats it for M poses."
        kind, count = type(self.distribution).__name__, len(self.joints)
        raise PoseDataError(
            f"distribution: a {kind} of batch shape {batch} and event shape {event}; expected (M,) and {expected[0]} "
            f"or {expected[1]} for {count} joints.{advice}"
        )

    def sample(self, n: int, *, generator: torch.Generator | None = None) -> Tensor:
        """Draw n hypotheses of each pose, (n, M, K, 3) in mm; torch's own state stays, where a generator is given."""
        if generator is None:
            return self._poses(self.distribution.sample(torch.Size([n])))
        seed = int(torch.randint(2**62, (), generator=generator))
        gpus = range(torch.cuda.device_count()) if torch.cuda.is_initialized() else ()  # type: ignore[no-untyped-call]
        with torch.random.fork_rng(devices=gpus):
            torch.default_generator.manual_seed(seed)
            if gpus:
                torch.cuda.manual_seed_all(seed)
            return self._poses(self.distribution.sample(torch.Size([n])))

    def _poses(self, drawn: Tensor) -> Tensor:
        return drawn.reshape(*drawn.shape[:2], len(self.joints), 3)

    def log_prob(self, truth: Tensor) -> Tensor:
        """Compute the log density at ``truth`` (M, K, 3) in mm: (M,), nats per pose in mm."""
        (poses,) = self.distribution.batch_shape
        check_truth(truth, poses, len(self.joints))
        log_density: Tensor = self.distribution.log_prob(truth.reshape(poses, *self.distribution.event_shape))
        return log_density


@dataclass(frozen=True)
class TorchEstimator:
    """An estimator made of a function that returns a distribution of PyTorch; see :func:`from_torch`.

    Attributes
    ----------
    conditional : callable
        From a context of M poses to their distribution.
    joints, keypoints : tuple of str
        K joints of the poses, and the keypoints that a context holds.
    """

    conditional: Callable[[Context], Distribution]
    joints: tuple[str, ...]
    keypoints: tuple[str, ...]

    def __call__(self, context: Context) -> TorchPoses:
        """Return the distribution of the poses with these keypoints.

        Raises
        ------
        PoseDataError
            Where there are more or fewer keypoints, or no distribution of as many poses and joints is returned.
        """
        check_keypoints(context, self.keypoints)
        distribution = self.conditional(context)
        if not isinstance(distribution, Distribution):
            raise PoseDataError(f"distribution: a {type(distribution).__name__}; expected one of torch.distributions.")
        poses = TorchPoses(distribution, self.joints)
        if (count := poses.distribution.batch_shape[0]) != len(context):
            raise PoseDataError(f"distribution: of {count:,} poses; expected {len(context):,}, one for each image.")
        return poses


@overload
def from_torch(distribution: Distribution, joints: Sequence[str]) -> TorchPoses: ...


@overload
def from_torch(
    distribution: Callable[[Context], Distribution], joints: Sequence[str], keypoints: Sequence[str] | None = None
) -> TorchEstimator: ...


def from_torch(
    distribution: Distribution | Callable[[Context], Distribution],
    joints: Sequence[str],
    keypoints: Sequence[str] | None = None,
) -> TorchPoses | TorchEstimator:
    """Bring a distribution of PyTorch, zuko or Pyro under the contract of estimators.

    Parameters
    ----------
    distribution : torch.distributions.Distribution or callable
        Of batch shape (M,) and event shape (3K,), a pose's coordinates joint by joint, or (K, 3); in mm, relative to
        the root. Or a function from a :class:`posecal_models.contract.Context` of M poses to such a distribution, which
        makes an estimator.
    joints : sequence of str
        K names.
    keypoints : sequence of str, optional
        The keypoints that the function reads, in order; the joints where not given.

    Returns
    -------
    TorchPoses or TorchEstimator
        A distribution of poses, or an estimator.

    Raises
    ------
    PoseDataError
        Where names are repeated, or the shapes don't fit the joints.

    Notes
    -----
    These distributions draw from torch's own generator. Where one is given, a number of it seeds torch's own while they
    draw, whose state is put back; numbers that are drawn on a GPU differ from those of a CPU.

    Differs from the published code: not in it.

    Examples
    --------
    Two poses of three joints, with a standard deviation of 10 mm.

    >>> mean = torch.zeros(2, 9)
    >>> normal = torch.distributions.MultivariateNormal(mean, scale_tril=10 * torch.eye(9))
    >>> poses = from_torch(normal, ("RKnee", "RFoot", "LHip"))
    >>> poses.sample(100).shape, poses.log_prob(torch.zeros(2, 3, 3))  # -9 (log 10 + log(2 π) / 2)
    (torch.Size([100, 2, 3, 3]), tensor([-28.9937, -28.9937]))
    """
    joints = tuple(joints)
    keypoints = joints if keypoints is None else tuple(keypoints)
    for what, names in (("joints", joints), ("keypoints", keypoints)):
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise PoseDataError(f"{what}: {first_few(repeated)} given more than once; expected names that differ.")
    if isinstance(distribution, Distribution):
        return TorchPoses(distribution, joints)
    if not callable(distribution):
        raise PoseDataError(
            f"distribution: a {type(distribution).__name__}; expected one of torch.distributions, or a function from a "
            "context to one."
        )
    return TorchEstimator(distribution, joints, keypoints)
