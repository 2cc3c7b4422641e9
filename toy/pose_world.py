r"""A Gaussian model of poses and keypoints with an exact posterior.

Joints form a kinematic tree, ``x_k = x_parent(k) + b_k + ε_k`` with Gaussian ``ε_k``, so the pose is jointly Gaussian.
A camera observes keypoints ``c_k = V x_k + η_k`` with Gaussian noise, of any subset of the joints. The posterior of the
pose given any subset is Gaussian, with exact samples, density and marginals: the oracle for metrics (a perfect sampler
has an ECE of 0) and for estimators (by how many nats they exceed the true posterior's negative log density).

Conventions: camera frame, x to the right, y down, z away from the camera, in mm, the hip at the origin. By default
the view is orthographic: the keypoint of a joint is its (x, y) in mm. A Hip among the joints stays at the origin;
densities are over the joints that move.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from posecal.data.skeleton import Skeleton, joint_set
from posecal.errors import PoseDataError
from toy.posterior import Posterior

__all__ = ["PoseWorld", "Posterior", "Scene"]

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

_TO_CAMERA = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # rest poses: x to the person's left, y backwards, z up


@dataclass(frozen=True)
class Scene:
    """True poses and their keypoints.

    Attributes
    ----------
    truth : ndarray, shape (M, K, 3)
        Poses, mm.
    keypoints : ndarray, shape (M, K, V)
        Keypoints, mm; NaN where a joint is hidden.
    observed : ndarray of bool, shape (M, K)
        The joints with an observed keypoint.
    sequence, frame : ndarray of int, shape (M,)
        Index of a pose's sequence, and of its frame in it.
    """

    truth: Floats
    keypoints: Floats
    observed: Bools
    sequence: npt.NDArray[np.int64]
    frame: npt.NDArray[np.int64]


@dataclass(frozen=True)
class PoseWorld:
    """A kinematic tree with Gaussian bones, and a camera.

    Attributes
    ----------
    joints : tuple of str
        K names.
    parents : tuple of int
        The index of each joint's parent, -1 for a joint whose parent is the origin.
    bones : ndarray, shape (K, 3)
        Mean offset of each joint from its parent, mm.
    bone_covariance : ndarray, shape (K, 3, 3)
        Covariance of that offset, mm²; 0 for a joint that does not move relative to its parent.
    keypoint_sigma : float
        Standard deviation of a keypoint's noise per coordinate, above 0, mm.
    view : ndarray, shape (V, 3)
        Projection matrix from a joint to its keypoint; by default onto x and y.

    Examples
    --------
    A joint 100 mm from the origin with a standard deviation of 3 mm, and keypoints with noise of 4 mm. The keypoint's
    weight is 3² / (3² + 4²) = 0.36, so a keypoint 25 mm to the right of the mean shifts the posterior by 9 mm; depth
    is unchanged.

    >>> world = PoseWorld(("Spine",), (-1,), np.array([[0, -100.0, 0]]), 9 * np.eye(3)[None], keypoint_sigma=4)
    >>> posterior = world.posterior([[[25, -100]]], [[True]])
    >>> posterior.mean[0, 0].round(6).tolist()
    [9.0, -100.0, 0.0]
    >>> np.diag(posterior.marginal(0)[1][0]).round(6).tolist()  # 9 (1 − 0.36)
    [5.76, 5.76, 9.0]
    """

    joints: tuple[str, ...]
    parents: tuple[int, ...]
    bones: Floats
    bone_covariance: Floats
    keypoint_sigma: float
    view: Floats = field(default_factory=lambda: np.eye(3)[:2])

    def __post_init__(self) -> None:
        K = len(self.joints)
        if self.bones.shape != (K, 3) or self.bone_covariance.shape != (K, 3, 3) or len(self.parents) != K:
            raise PoseDataError(
                f"world: {K} joints, {len(self.parents)} parents, bones {self.bones.shape}, covariances "
                f"{self.bone_covariance.shape}; expected (K,), (K, 3) and (K, 3, 3)."
            )
        if not self.keypoint_sigma > 0:
            raise PoseDataError(f"keypoint_sigma: {self.keypoint_sigma} mm; expected more than 0.")
        if not self.moves.any():
            raise PoseDataError(f"world: none of {K} joints moves; expected at least 1.")
        singular = self.moves & (np.linalg.eigvalsh(self.bone_covariance)[:, 0] <= 0)
        if singular.any():
            raise PoseDataError(
                f"bone of {self.joints[singular.argmax()]}: its covariance is singular; expected a positive definite "
                "one, or 0 for every bone from the origin to it."
            )

    @classmethod
    def person(
        cls,
        joints: str | tuple[str, ...] = "h36m-16",
        *,
        across: float = 0.25,
        along: float = 0.05,
        keypoint_sigma: float = 10.0,
    ) -> PoseWorld:
        """Build the world of a standing person who faces the camera.

        Parameters
        ----------
        joints : str or tuple of str
            A joint set or joints of posecal's human skeleton.
        across, along : float
            Standard deviation of a bone's end across and along the bone, relative to its length: directions vary
            more than lengths.
        keypoint_sigma : float
            Standard deviation of a keypoint's noise per coordinate, mm.

        Returns
        -------
        PoseWorld
            K joints. In oblique bones depth and image coordinates are correlated, so that keypoints carry some
            information on depth.

        Raises
        ------
        PoseDataError
            Where a joint is not in the human skeleton.

        Notes
        -----
        Differs from the published code: not in it.
        """
        names = joint_set(joints) if isinstance(joints, str) else tuple(joints)
        skeleton = Skeleton(names)
        rest = skeleton.rest_pose @ _TO_CAMERA.T
        bones = np.array([rest[k] - (rest[p] if p >= 0 else 0) for k, p in enumerate(skeleton.parents)])
        length = np.linalg.norm(bones, axis=-1)[:, None, None]
        lengthwise = bones[:, :, None] * bones[:, None, :]  # length² times the projection onto the bone
        covariance = across**2 * (length**2 * np.eye(3) - lengthwise) + along**2 * lengthwise
        return cls(names, skeleton.parents, bones, covariance, keypoint_sigma)

    @classmethod
    def independent_joints(
        cls, joints: str | tuple[str, ...] = "h36m-16", *, sigma: float = 30.0, prior_ratio: float = 3.78
    ) -> PoseWorld:
        """Build the world of independent joints, each with the same isotropic posterior given the keypoints.

        The parent of every joint is the origin, and the camera observes depth as well. In this world the faults of
        :mod:`toy.faults` have closed forms.

        Parameters
        ----------
        joints : str or tuple of str
            A joint set or joints of posecal's human skeleton; a Hip would move like the others, so leave it out.
        sigma : float
            Standard deviation of each coordinate given the keypoints, mm.
        prior_ratio : float
            Ratio of the prior's standard deviation to it, above 1.

        Returns
        -------
        PoseWorld
            With all joints observed, its posterior covariance is ``sigma² I``.

        Raises
        ------
        PoseDataError
            Where a joint is not in the human skeleton, ``sigma`` is not above 0, or ``prior_ratio`` not above 1.

        Notes
        -----
        Differs from the published code: not in it.
        """
        if not (sigma > 0 and prior_ratio > 1):
            raise PoseDataError(f"sigma {sigma} mm, prior_ratio {prior_ratio}; expected above 0 and above 1.")
        names = joint_set(joints) if isinstance(joints, str) else tuple(joints)
        rest = Skeleton(names).rest_pose @ _TO_CAMERA.T
        variance = (prior_ratio * sigma) ** 2
        keypoint_sigma = sigma / math.sqrt(1 - prior_ratio**-2)
        K = len(names)
        return cls(names, (-1,) * K, rest, np.tile(variance * np.eye(3), (K, 1, 1)), keypoint_sigma, np.eye(3))

    @cached_property
    def moves(self) -> Bools:
        """The joints that move, (K,): all but those whose path from the origin is rigid."""
        rigid = ~self.bone_covariance.any(axis=(1, 2))
        return np.asarray((self._path & ~rigid).any(axis=1))

    @cached_property
    def _path(self) -> Bools:
        """The joints (columns) on the path from the origin to each joint (rows), itself included."""
        path = np.eye(len(self.joints), dtype=bool)
        for k in range(len(self.joints)):
            ancestor, steps = self.parents[k], 0
            while ancestor >= 0:
                path[k, ancestor] = True
                ancestor, steps = self.parents[ancestor], steps + 1
                if steps > len(self.joints):
                    raise PoseDataError(f"parents: joint {self.joints[k]} is its own ancestor; expected a tree.")
        return path

    @cached_property
    def mean(self) -> Floats:
        """The expected pose, (K, 3) in mm."""
        return np.asarray(self._path @ self.bones)

    @cached_property
    def covariance(self) -> Floats:
        """The prior covariance of the R joints that move, (3R, 3R) in mm²."""
        path = self._path[self.moves].astype(float)
        R = len(path)
        return np.asarray(np.einsum("kj,lj,jab->kalb", path, path, self.bone_covariance).reshape(3 * R, 3 * R))

    def draw(
        self,
        rng: np.random.Generator,
        *,
        sequences: int = 40,
        frames: int = 25,
        correlation: float = 0.0,
        hidden: float = 0.0,
    ) -> Scene:
        r"""Draw sequences of truths and their keypoints.

        .. math:: ε_t = ρ ε_{t−1} + \sqrt{1 − ρ²}\, ξ_t

        for the bones and for the keypoints' noise, so that the truth's deviation from the posterior mean is an AR(1)
        process with the same ρ, similar to the errors of a model on video.

        Parameters
        ----------
        rng : numpy.random.Generator
            The source of randomness.
        sequences, frames : int
            Number of sequences, and of frames in each; M is their product.
        correlation : float
            ρ between consecutive frames; with 0 all frames are independent.
        hidden : float
            Share of keypoints that are missing in every other sequence, the same ones in all its frames. In the other
            sequences every keypoint is observed.

        Returns
        -------
        Scene
            M poses, in the order of the sequences.

        Raises
        ------
        PoseDataError
            Where a share is not between 0 and 1, or there is no frame.

        Notes
        -----
        Differs from the published code: not in it.
        """
        if sequences < 1 or frames < 1 or not 0 <= correlation < 1 or not 0 <= hidden <= 1:
            raise PoseDataError(
                f"sequences {sequences}, frames {frames}, correlation {correlation}, hidden {hidden}; expected at "
                "least 1, at least 1, 0 to below 1, and 0 to 1."
            )
        K, V = len(self.joints), len(self.view)
        noise = rng.standard_normal((frames, sequences, K, 3 + V))
        for t in range(1, frames):
            noise[t] = correlation * noise[t - 1] + math.sqrt(1 - correlation**2) * noise[t]
        noise = noise.swapaxes(0, 1).reshape(sequences * frames, K, 3 + V)
        values, vectors = np.linalg.eigh(self.bone_covariance)
        factor = vectors * np.sqrt(np.maximum(values, 0))[:, None, :]
        offsets = self.bones + np.einsum("kab,mkb->mka", factor, noise[..., :3])
        truth = np.einsum("kj,mja->mka", self._path.astype(float), offsets)
        missing = rng.random((sequences, K)) < hidden
        missing[::2] = False
        observed = ~np.repeat(missing, frames, axis=0)
        keypoints = truth @ self.view.T + self.keypoint_sigma * noise[..., 3:]
        return Scene(
            truth=truth,
            keypoints=np.where(observed[..., None], keypoints, np.nan),
            observed=observed,
            sequence=np.repeat(np.arange(sequences), frames),
            frame=np.tile(np.arange(frames), sequences),
        )

    def posterior(self, keypoints: npt.ArrayLike, observed: npt.ArrayLike) -> Posterior:
        r"""Compute the exact posterior of the poses given their keypoints.

        .. math:: Σ_{post} = Σ − G H Σ, \quad m_{post} = m + G (c − H m), \quad G = Σ H^T (H Σ H^T + τ² I)^{-1}

        Parameters
        ----------
        keypoints : array_like, shape (M, K, V)
            mm. Values of keypoints that are not observed are not read.
        observed : array_like of bool, shape (M, K)
            The joints with an observed keypoint; without any the posterior is the prior.

        Returns
        -------
        Posterior
            M poses.

        Raises
        ------
        PoseDataError
            Where the shapes don't fit this world, or an observed keypoint is not finite.

        Notes
        -----
        Differs from the published code: not in it.
        """
        keypoints, observed = np.asarray(keypoints, float), np.asarray(observed, bool)
        K, V = len(self.joints), len(self.view)
        if keypoints.shape[1:] != (K, V) or observed.shape != keypoints.shape[:2]:
            raise PoseDataError(
                f"keypoints {keypoints.shape}, observed {observed.shape}; expected (M, {K}, {V}) and (M, {K})."
            )
        if not np.isfinite(keypoints[observed]).all():
            raise PoseDataError("keypoints: some are not finite; expected numbers where a joint is observed.")
        masks, pattern = np.unique(observed, axis=0, return_inverse=True)
        mean = np.broadcast_to(self.mean, (len(observed), K, 3)).copy()
        covariances = []
        for index, mask in enumerate(masks):
            poses = np.flatnonzero(pattern == index)
            gain, covariance = self._condition(mask[self.moves])
            joints = np.flatnonzero(mask & self.moves)
            innovation = keypoints[np.ix_(poses, joints)] - (self.mean @ self.view.T)[joints]
            update = innovation.reshape(len(poses), -1) @ gain.T
            mean[np.ix_(poses, np.flatnonzero(self.moves))] += update.reshape(len(poses), -1, 3)
            covariances.append(covariance)
        return Posterior(mean, np.array(covariances), pattern.reshape(-1), self.moves)

    def _condition(self, observed: Bools) -> tuple[Floats, Floats]:
        """Compute the gain (3R, V·observed) and the posterior covariance (3R, 3R) for one pattern of moving joints."""
        H = np.kron(np.eye(len(observed))[observed], self.view)
        if not observed.any():
            return np.zeros((3 * len(observed), 0)), self.covariance
        noise = self.keypoint_sigma**2 * np.eye(len(H))
        H_covariance = H @ self.covariance
        gain = np.linalg.solve(H_covariance @ H.T + noise, H_covariance).T.astype(float)
        residual = np.eye(3 * len(observed)) - gain @ H
        covariance = residual @ self.covariance @ residual.T + gain @ noise @ gain.T  # Joseph form: stays positive
        return gain, (covariance + covariance.T) / 2

    def prior(self, poses: int) -> Posterior:
        """Return the prior of the poses, without any observed keypoint.

        Parameters
        ----------
        poses : int
            M.

        Returns
        -------
        Posterior
            M times the same distribution.

        Notes
        -----
        Differs from the published code: not in it.
        """
        observed = np.zeros((poses, len(self.joints)), bool)
        return self.posterior(np.full((*observed.shape, len(self.view)), np.nan), observed)
