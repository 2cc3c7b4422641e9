r"""A world of poses in which the right answer is known.

Joints hang on a kinematic tree, ``x_k = x_parent(k) + b_k + ε_k`` with Gaussian ``ε_k``, so the pose is jointly
Gaussian. A camera sees keypoints ``c_k = V x_k + η_k`` with Gaussian noise, of any subset of the joints. The
posterior of the pose given any subset is Gaussian, with exact samples, density and marginals: the oracle for
metrics (a perfect sampler has an ECE of 0) and for estimators (how many nats above the true posterior).

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
    """Truths, and what the camera saw of them.

    Attributes
    ----------
    truth : ndarray, shape (M, K, 3)
        Poses, mm.
    keypoints : ndarray, shape (M, K, V)
        What the camera saw, mm; NaN where a joint is hidden.
    observed : ndarray of bool, shape (M, K)
        The joints whose keypoint is there.
    sequence, frame : ndarray of int, shape (M,)
        Which sequence a pose belongs to, and its place in it.
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
        The index of each joint's parent, -1 for a joint that hangs on the origin.
    bones : ndarray, shape (K, 3)
        Mean offset of each joint from its parent, mm.
    bone_covariance : ndarray, shape (K, 3, 3)
        Covariance of that offset, mm²; 0 for a joint that does not move against its parent.
    keypoint_sigma : float
        Standard deviation of a keypoint's noise per coordinate, above 0, mm.
    view : ndarray, shape (V, 3)
        What a keypoint shows of a joint; by default its x and y.

    Examples
    --------
    A joint 100 mm from the origin that strays by 3 mm, and a camera whose noise is 4 mm. The keypoint's weight is
    3² / (3² + 4²) = 0.36, so a keypoint 25 mm to the right of the mean moves the posterior by 9 mm; depth stays.

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
        flat = self.moves & (np.linalg.eigvalsh(self.bone_covariance)[:, 0] <= 0)
        if flat.any():
            raise PoseDataError(
                f"bone of {self.joints[flat.argmax()]}: its covariance is singular; expected a positive definite "
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
        """Make a standing person who faces the camera.

        Parameters
        ----------
        joints : str or tuple of str
            A joint set or joints of posecal's human tree.
        across, along : float
            Standard deviation of a bone's end across and along the bone, as a share of its length: limbs swing
            more than they stretch.
        keypoint_sigma : float
            Standard deviation of a keypoint's noise per coordinate, mm.

        Returns
        -------
        PoseWorld
            K joints. Bones that lean tie depth to the image, so that keypoints tell a little of it.

        Raises
        ------
        PoseDataError
            Where a joint is not on the human tree.

        Notes
        -----
        Differs from the published code: not in it.
        """
        names = joint_set(joints) if isinstance(joints, str) else tuple(joints)
        skeleton = Skeleton(names)
        rest = skeleton.rest_pose @ _TO_CAMERA.T
        bones = np.array([rest[k] - (rest[p] if p >= 0 else 0) for k, p in enumerate(skeleton.parents)])
        length = np.linalg.norm(bones, axis=-1)[:, None, None]
        lengthwise = bones[:, :, None] * bones[:, None, :]  # length² times the projection on the bone
        covariance = across**2 * (length**2 * np.eye(3) - lengthwise) + along**2 * lengthwise
        return cls(names, skeleton.parents, bones, covariance, keypoint_sigma)

    @classmethod
    def independent_joints(
        cls, joints: str | tuple[str, ...] = "h36m-16", *, sigma: float = 30.0, prior_ratio: float = 3.78
    ) -> PoseWorld:
        """Make the plainest world: given the keypoints, every joint strays alike in every direction by itself.

        Joints hang on the origin, not on each other, and the camera sees depth as well. This is the world in which
        the faults of :mod:`toy.faults` show their textbook numbers.

        Parameters
        ----------
        joints : str or tuple of str
            A joint set or joints of posecal's human tree; a Hip would move like the others, so leave it out.
        sigma : float
            Standard deviation of each coordinate given the keypoints, mm.
        prior_ratio : float
            How many times wider it is without keypoints, above 1.

        Returns
        -------
        PoseWorld
            With all joints observed, its posterior covariance is ``sigma² I``.

        Raises
        ------
        PoseDataError
            Where a joint is not on the human tree, ``sigma`` is not above 0, or ``prior_ratio`` not above 1.

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
        """Which joints move, (K,): all but those whose whole path from the origin is rigid."""
        rigid = ~self.bone_covariance.any(axis=(1, 2))
        return np.asarray((self._path & ~rigid).any(axis=1))

    @cached_property
    def _path(self) -> Bools:
        """Which joints (columns) lie between the origin and each joint (rows), itself included."""
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
        """The covariance of the R joints that move, (3R, 3R) in mm², before any keypoint is seen."""
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

        for the bones and for the keypoints' noise alike, so that the truth's deviation from the posterior mean is
        an AR(1) process with the same ρ, as the errors of a model on video are.

        Parameters
        ----------
        rng : numpy.random.Generator
            Where the draws come from.
        sequences, frames : int
            How many sequences, and frames in each; M is their product.
        correlation : float
            ρ between consecutive frames; 0 makes all frames independent.
        hidden : float
            Share of keypoints that are missing from every other sequence, the same ones throughout a sequence. The
            sequences between show every keypoint.

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
        spread = vectors * np.sqrt(np.maximum(values, 0))[:, None, :]
        offsets = self.bones + np.einsum("kab,mkb->mka", spread, noise[..., :3])
        truth = np.einsum("kj,mja->mka", self._path.astype(float), offsets)
        gone = rng.random((sequences, K)) < hidden
        gone[::2] = False
        observed = ~np.repeat(gone, frames, axis=0)
        keypoints = truth @ self.view.T + self.keypoint_sigma * noise[..., 3:]
        return Scene(
            truth=truth,
            keypoints=np.where(observed[..., None], keypoints, np.nan),
            observed=observed,
            sequence=np.repeat(np.arange(sequences), frames),
            frame=np.tile(np.arange(frames), sequences),
        )

    def posterior(self, keypoints: npt.ArrayLike, observed: npt.ArrayLike) -> Posterior:
        r"""Give the exact law of the poses given their keypoints.

        .. math:: Σ_{post} = Σ − G H Σ, \quad m_{post} = m + G (c − H m), \quad G = Σ H^T (H Σ H^T + τ² I)^{-1}

        Parameters
        ----------
        keypoints : array_like, shape (M, K, V)
            mm. The value of a keypoint that is not observed is never read.
        observed : array_like of bool, shape (M, K)
            The joints whose keypoint is there; none at all gives the prior.

        Returns
        -------
        Posterior
            M poses.

        Raises
        ------
        PoseDataError
            Where the shapes don't belong to this world, or an observed keypoint is not finite.

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
        seen_patterns, pattern = np.unique(observed, axis=0, return_inverse=True)
        mean = np.broadcast_to(self.mean, (len(observed), K, 3)).copy()
        covariances = []
        for index, seen in enumerate(seen_patterns):
            poses = np.flatnonzero(pattern == index)
            gain, covariance = self._condition(seen[self.moves])
            known = np.flatnonzero(seen & self.moves)
            surprise = keypoints[np.ix_(poses, known)] - (self.mean @ self.view.T)[known]
            update = surprise.reshape(len(poses), -1) @ gain.T
            mean[np.ix_(poses, np.flatnonzero(self.moves))] += update.reshape(len(poses), -1, 3)
            covariances.append(covariance)
        return Posterior(mean, np.array(covariances), pattern.reshape(-1), self.moves)

    def _condition(self, seen: Bools) -> tuple[Floats, Floats]:
        """Gain (3R, V·seen) and posterior covariance (3R, 3R) for one pattern of the moving joints."""
        shows = np.kron(np.eye(len(seen))[seen], self.view)
        if not seen.any():
            return np.zeros((3 * len(seen), 0)), self.covariance
        noise = self.keypoint_sigma**2 * np.eye(len(shows))
        sees = shows @ self.covariance
        gain = np.linalg.solve(sees @ shows.T + noise, sees).T.astype(float)
        rest = np.eye(3 * len(seen)) - gain @ shows
        covariance = rest @ self.covariance @ rest.T + gain @ noise @ gain.T  # Joseph's form stays positive
        return gain, (covariance + covariance.T) / 2

    def prior(self, poses: int) -> Posterior:
        """Give the law of the poses when nothing is seen.

        Parameters
        ----------
        poses : int
            M.

        Returns
        -------
        Posterior
            M times the same law.

        Notes
        -----
        Differs from the published code: not in it.
        """
        nothing = np.zeros((poses, len(self.joints)), bool)
        return self.posterior(np.full((*nothing.shape, len(self.view)), np.nan), nothing)
