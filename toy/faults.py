r"""Named faults of samplers, each one modification of the exact posterior.

Each fault takes the exact posterior of a scene and draws hypotheses that are wrong in one way. Most leave the truth
unchanged. Five need a truth with another distribution than that of a Gaussian world (correlated as given, stretched in
depth, always on one side, in two depth modes) and change its deviation from the posterior mean; their descriptions say
so, and the truth is returned with the hypotheses.

In :meth:`~toy.pose_world.PoseWorld.independent_joints` every fault has a closed form: the deviations are ``σ z`` with
independent standard normal z. In another world a fault is the same modification of that world's posterior; and a case
may have correlated joints, each with its own marginal distribution.

Conventions: hypotheses (N, M, K, 3), truth (M, K, 3), mm, camera frame; depth is the last coordinate. A joint's sd
is the root mean square of its three.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError, did_you_mean
from toy.pose_world import PoseWorld, Scene
from toy.posterior import Posterior

__all__ = ["FAULTS", "Case", "Fault", "find_fault", "spread"]

Floats = npt.NDArray[np.float64]

_DEPTH = np.array([0.0, 0, 1])


@dataclass(frozen=True)
class Case:
    """A scene with its exact posterior, and a source of randomness.

    Attributes
    ----------
    world : PoseWorld
        The world of the scene.
    scene : Scene
        M truths and their keypoints.
    posterior : Posterior
        The exact posterior of the truths given the keypoints.
    rng : numpy.random.Generator
        The source of randomness of the hypotheses.
    joint_correlation : float or None
        Correlation between the standardised deviations of any two joints, of truths and of perfect hypotheses; that of
        the posterior where None.
    """

    world: PoseWorld
    scene: Scene
    posterior: Posterior
    rng: np.random.Generator
    joint_correlation: float | None = None

    @classmethod
    def of(
        cls, world: PoseWorld, scene: Scene, rng: np.random.Generator, *, joint_correlation: float | None = None
    ) -> Case:
        """Compute the posterior of a scene; with a joint correlation, draw the truths again about the mean."""
        case = cls(world, scene, world.posterior(scene.keypoints, scene.observed), rng, joint_correlation)
        if joint_correlation is None:
            return case
        truth = case.posterior.mean + case.correlated(1, joint_correlation)[0]
        return replace(case, scene=replace(scene, truth=truth))

    def deviations(self, N: int) -> Floats:
        """Draw N perfect hypotheses as deviations from the posterior mean, (N, M, K, 3) in mm."""
        if self.joint_correlation is not None:
            return self.correlated(N, self.joint_correlation)
        return self.posterior.sample(N, self.rng) - self.posterior.mean

    @property
    def truth_deviation(self) -> Floats:
        """The truth as a deviation from the posterior mean, (M, K, 3) in mm."""
        return self.scene.truth - self.posterior.mean

    @property
    def joint_sd(self) -> Floats:
        """The posterior standard deviation of each joint, root mean square over coordinates, (M, K, 1) in mm."""
        variance = np.trace(self.posterior.joint_covariance, axis1=-2, axis2=-1) / 3
        return np.asarray(np.sqrt(variance)[self.posterior.pattern][..., None])

    def correlated(self, N: int, correlation: float) -> Floats:
        """Draw deviations with the correct marginal of each joint and a given correlation between joints.

        Parameters
        ----------
        N : int
            Number of draws of every pose.
        correlation : float
            Between the standardised deviations of any two joints, 0 to 1.

        Returns
        -------
        ndarray, shape (N, M, K, 3)
            mm.

        Notes
        -----
        Differs from the published code: not in it.
        """
        M, K, D = self.posterior.mean.shape
        values, vectors = np.linalg.eigh(self.posterior.joint_covariance)
        root = vectors * np.sqrt(np.maximum(values, 0))[..., None, :] @ vectors.swapaxes(-1, -2)
        common = self.rng.standard_normal((N, M, 1, D))
        independent = self.rng.standard_normal((N, M, K, D))
        standard = np.sqrt(correlation) * common + np.sqrt(1 - correlation) * independent
        return np.asarray(np.einsum("mkab,nmkb->nmka", root[self.posterior.pattern], standard))


@dataclass(frozen=True)
class Fault:
    """A named fault of a sampler.

    Attributes
    ----------
    name : str
        Its name on the command line and in :data:`FAULTS`.
    description : str
        The fault in one sentence.
    draw : callable
        ``draw(case, N)`` returns deviations from the posterior mean: hypotheses (N, M, K, 3), truth (M, K, 3), mm.
    """

    name: str
    description: str
    draw: Callable[[Case, int], tuple[Floats, Floats]]

    def apply(self, case: Case, N: int) -> tuple[Floats, Floats]:
        """Draw hypotheses with this fault, and the truth to evaluate them against.

        Parameters
        ----------
        case : Case
            A scene and its exact posterior.
        N : int
            Number of hypotheses.

        Returns
        -------
        hypotheses : ndarray, shape (N, M, K, 3)
            mm.
        truth : ndarray, shape (M, K, 3)
            mm; that of the scene unless the fault changes it.

        Notes
        -----
        Differs from the published code: not in it.
        """
        if N < 1:
            raise PoseDataError(f"N = {N} hypotheses; expected at least 1.")
        hypotheses, truth = self.draw(case, N)
        return case.posterior.mean + hypotheses, case.posterior.mean + truth


def _perfect(case: Case, N: int) -> tuple[Floats, Floats]:
    return case.deviations(N), case.truth_deviation


def _shifted(case: Case, N: int) -> tuple[Floats, Floats]:
    return 1.23 * case.deviations(N) + 1.2 * case.joint_sd * _DEPTH, case.truth_deviation


def _one_sided(case: Case, N: int) -> tuple[Floats, Floats]:
    distance = np.linalg.norm(case.truth_deviation, axis=-1, keepdims=True)
    return case.deviations(N), distance * _DEPTH


def _scaled_joints(cycle: list[float]) -> Callable[[Case, int], tuple[Floats, Floats]]:
    """Scale the moving joints by the factors of a cycle, one after the other."""

    def draw(case: Case, N: int) -> tuple[Floats, Floats]:
        factor = np.ones(len(case.world.joints))
        joints = np.flatnonzero(case.world.moves)
        factor[joints] = np.resize(cycle, joints.size)
        return factor[:, None] * case.deviations(N), case.truth_deviation

    return draw


def _correlation(truth: float, model: float) -> Callable[[Case, int], tuple[Floats, Floats]]:
    def draw(case: Case, N: int) -> tuple[Floats, Floats]:
        return case.correlated(N, model), case.correlated(1, truth)[0]

    return draw


def _swapped_anisotropy(case: Case, N: int) -> tuple[Floats, Floats]:
    stretch = 1 + 2 * _DEPTH
    return (stretch * case.deviations(N))[..., ::-1], stretch * case.truth_deviation


def _mixed_poses(case: Case, N: int) -> tuple[Floats, Floats]:
    factor = np.resize([0.75, 1.24], len(case.scene.truth))
    return factor[:, None, None] * case.deviations(N), case.truth_deviation


def _depth_modes(case: Case, N: int) -> tuple[Floats, Floats]:
    """Shift the whole true pose forwards or backwards; the model has the same distances in random directions."""
    M = len(case.scene.truth)

    def two_modes(deviation: Floats) -> Floats:
        side = case.rng.choice([-1.0, 1.0], (*deviation.shape[:-2], 1, 1))
        return np.asarray(deviation + 3 * side * case.joint_sd * _DEPTH)

    radius = np.linalg.norm(two_modes(case.deviations(N)), axis=-1, keepdims=True)
    direction = case.rng.standard_normal((N, M, len(case.world.joints), 3))
    shell = radius * direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return shell, two_modes(case.truth_deviation)


def _ignored_image(case: Case, N: int) -> tuple[Floats, Floats]:
    """Draw from the prior; with correlated joints, from the posteriors of other poses of the scene."""
    M, mean = len(case.scene.truth), case.posterior.mean
    if case.joint_correlation is None:
        return case.world.prior(M).sample(N, case.rng) - mean, case.truth_deviation
    if N >= M:
        raise PoseDataError(
            f"ignored-image: N = {N} hypotheses and M = {M} poses; expected more poses than hypotheses."
        )
    others = np.array([case.rng.choice(M - 1, N, replace=False) for _ in range(M)]).T
    others += others >= np.arange(M)  # distinct poses, none of them the pose itself
    return mean[others] + case.deviations(N) - mean, case.truth_deviation


def spread(factor: float) -> Fault:
    """Build the fault of a spread that is wrong by one factor for all joints and poses.

    Parameters
    ----------
    factor : float
        Factor of the hypotheses' deviations, 0 or more: below 1 overconfident, above 1 underconfident.

    Returns
    -------
    Fault
        Named ``spread-<factor>``.

    Raises
    ------
    PoseDataError
        Where the factor is negative or not finite.

    Examples
    --------
    >>> spread(0.4).name
    'spread-0.4'
    """
    if not 0 <= factor < np.inf:
        raise PoseDataError(f"spread: {factor}; expected a factor, 0 or more.")
    return Fault(
        f"spread-{factor:g}",
        f"All hypotheses are {factor:g} times as far from the mean as they should be.",
        lambda case, N: (factor * case.deviations(N), case.truth_deviation),
    )


FAULTS: dict[str, Fault] = {
    fault.name: fault
    for fault in (
        Fault("perfect", "None: hypotheses are drawn from the exact posterior.", _perfect),
        Fault("shifted", "The mean is 1.2 sd too deep and the spread 1.23 times the correct one.", _shifted),
        Fault(
            "one-sided",
            "The truth is always behind the mean, at the correct distance; the model is on all sides.",
            _one_sided,
        ),
        Fault(
            "cancelling-joints",
            "The spread is 0.75 times the correct one in half of the joints, 1.24 times in the others.",
            _scaled_joints([0.75, 1.24]),
        ),
        Fault(
            "few-joints",
            "The spread is 0.4 times the correct one in a quarter of the joints, 2.5 times in another.",
            _scaled_joints([0.4, 1, 2.5, 1]),
        ),
        Fault(
            "missing-correlation",
            "The truth's joints are correlated (0.9), the model's independent.",
            _correlation(0.9, 0.0),
        ),
        Fault(
            "excess-correlation",
            "The truth's joints are weakly correlated (0.5), the model's strongly (0.95).",
            _correlation(0.5, 0.95),
        ),
        Fault(
            "swapped-anisotropy",
            "The truth is stretched threefold in depth, the model from left to right.",
            _swapped_anisotropy,
        ),
        Fault(
            "mixed-poses",
            "The spread is 0.75 times the correct one in every other pose, 1.24 times in the rest.",
            _mixed_poses,
        ),
        Fault(
            "depth-modes",
            "The truth is 3 sd in front of or behind the mean, the model at the same distance in any direction.",
            _depth_modes,
        ),
        Fault("ignored-image", "The model draws from the prior, whatever the keypoints.", _ignored_image),
    )
}
"""The faults of the table in ``docs/toy.md``, by name, in its order."""


def find_fault(name: str) -> Fault:
    """Find a fault by its name.

    Parameters
    ----------
    name : str
        A key of :data:`FAULTS`, or ``spread-<factor>``.

    Returns
    -------
    Fault
        The fault.

    Raises
    ------
    PoseDataError
        Where no fault has this name.

    Examples
    --------
    >>> find_fault("spread-1.5").description
    'All hypotheses are 1.5 times as far from the mean as they should be.'
    """
    if name in FAULTS:
        return FAULTS[name]
    if factor := re.fullmatch(r"spread-(-?\d*\.?\d+)", name):
        return spread(float(factor[1]))
    raise PoseDataError(f"fault: {name!r} is not known. {did_you_mean(name, [*FAULTS, 'spread-0.5'])}")
