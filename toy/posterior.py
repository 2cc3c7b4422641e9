r"""Samples, density and marginals of poses that are jointly Gaussian.

The exact posterior of :mod:`toy.pose_world`, with the interface of a trained estimator's distribution: ``sample`` and
``log_prob``.

Conventions: mm; a pose of K joints, of which R move; densities and covariances are over those.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError

__all__ = ["Posterior"]

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Posterior:
    """The exact posterior of M poses given their keypoints.

    Poses with the same observed joints share a covariance, so there is one for each pattern of observed joints.

    Attributes
    ----------
    mean : ndarray, shape (M, K, 3)
        Expected poses, mm.
    covariance : ndarray, shape (P, 3R, 3R)
        Covariance of the R joints that move, for each pattern, mm².
    pattern : ndarray of int, shape (M,)
        The pattern of each pose.
    moves : ndarray of bool, shape (K,)
        The joints that move.

    Examples
    --------
    One joint, 3 mm of standard deviation in each coordinate: the density at its mean is (3 √(2π))⁻³ per mm³.

    >>> normal = Posterior(np.zeros((1, 1, 3)), 9 * np.eye(3)[None], np.array([0]), np.array([True]))
    >>> round(float(normal.log_prob(np.zeros((1, 1, 3)))[0]), 4), round(-3 * math.log(3 * math.sqrt(2 * math.pi)), 4)
    (-6.0527, -6.0527)
    """

    mean: Floats
    covariance: Floats
    pattern: npt.NDArray[np.int64]
    moves: Bools

    @cached_property
    def _factor(self) -> Floats:
        return np.asarray(np.linalg.cholesky(self.covariance))

    def sample(self, N: int, rng: np.random.Generator) -> Floats:
        """Draw N independent hypotheses of every pose.

        Parameters
        ----------
        N : int
            Number of hypotheses.
        rng : numpy.random.Generator
            The source of randomness.

        Returns
        -------
        ndarray, shape (N, M, K, 3)
            Poses, mm.

        Notes
        -----
        Differs from the published code: not in it.
        """
        M, K, D = self.mean.shape
        drawn = np.broadcast_to(self.mean, (N, M, K, D)).copy()
        for pattern, factor in enumerate(self._factor):
            poses = np.flatnonzero(self.pattern == pattern)
            deviation = rng.standard_normal((N, poses.size, len(factor))) @ factor.T
            drawn[np.ix_(np.arange(N), poses, np.flatnonzero(self.moves))] += deviation.reshape(N, poses.size, -1, D)
        return drawn

    def log_prob(self, truth: npt.ArrayLike) -> Floats:
        r"""Compute the log density of poses.

        .. math:: −\tfrac12 \left(‖L^{-1}(y − m)‖² + 3R \ln 2π\right) − \ln\det L, \quad L L^T = Σ

        Parameters
        ----------
        truth : array_like, shape (M, K, 3)
            Poses, mm.

        Returns
        -------
        ndarray, shape (M,)
            Nats per pose, of a density in mm. Higher is better.

        Notes
        -----
        Differs from the published code: not in it.
        """
        truth = np.asarray(truth, float)
        if truth.shape != self.mean.shape:
            raise PoseDataError(f"truth {truth.shape}; expected {self.mean.shape}, the shape of the posterior's mean.")
        deviation = (truth - self.mean)[:, self.moves].reshape(len(truth), -1)
        density = np.empty(len(truth))
        for pattern, factor in enumerate(self._factor):
            poses = self.pattern == pattern
            standard = np.linalg.solve(factor, deviation[poses].T)
            norm = len(factor) * math.log(2 * math.pi) + 2 * np.log(np.diag(factor)).sum()
            density[poses] = -((standard**2).sum(axis=0) + norm) / 2
        return density

    @cached_property
    def entropy(self) -> Floats:
        r"""The differential entropy of each pose, (M,) nats: the expected −log_prob of the true pose.

        .. math:: \tfrac12 \ln\det(2π e Σ)
        """
        _, log_determinant = np.linalg.slogdet(2 * math.pi * math.e * self.covariance)
        return np.asarray(log_determinant[self.pattern] / 2)

    def marginal(self, joint: int) -> tuple[Floats, Floats]:
        """Return the marginal distribution of one joint.

        Parameters
        ----------
        joint : int
            Index of the joint.

        Returns
        -------
        mean : ndarray, shape (M, 3)
            mm.
        covariance : ndarray, shape (M, 3, 3)
            mm².

        Notes
        -----
        Differs from the published code: not in it.
        """
        return self.mean[:, joint], self.joint_covariance[self.pattern, joint]

    @cached_property
    def joint_covariance(self) -> Floats:
        """The marginal covariance of each joint in each pattern, (P, K, 3, 3) mm²; 0 for a joint that does not move."""
        P, R = len(self.covariance), int(self.moves.sum())
        blocks = np.einsum("prarb->prab", self.covariance.reshape(P, R, 3, R, 3))
        covariance = np.zeros((P, len(self.moves), 3, 3))
        covariance[:, self.moves] = blocks
        return covariance

    def expected_min_mpjpe(self, N: int, rng: np.random.Generator) -> tuple[float, float]:
        r"""Estimate by simulation the minMPJPE of N hypotheses of this posterior.

        .. math:: \frac1M Σ_m \min_n \frac1K Σ_k ‖x_{nmk} − y_{mk}‖, \quad x_{nm}, y_m ∼ N(m_m, Σ_m)

        Parameters
        ----------
        N : int
            Number of hypotheses.
        rng : numpy.random.Generator
            The source of randomness.

        Returns
        -------
        mean, standard_error : float
            mm, over the M poses and all K joints. Lower is better.

        Raises
        ------
        PoseDataError
            Where there are fewer than 2 poses.

        Notes
        -----
        Differs from the published code: not in it.
        """
        M, K, _ = self.mean.shape
        if M < 2:
            raise PoseDataError(f"posterior: {M} poses; expected at least 2, for the standard error.")
        best = np.empty(M)
        for m, pattern in enumerate(self.pattern):
            factor = self._factor[pattern]
            drawn = (rng.standard_normal((N + 1, len(factor))) @ factor.T).reshape(N + 1, -1, 3)
            best[m] = np.linalg.norm(drawn[1:] - drawn[0], axis=-1).sum(axis=-1).min() / K
        return float(best.mean()), float(best.std(ddof=1) / math.sqrt(M))
