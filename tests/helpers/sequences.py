"""Ranks of the truth in sequences of correlated frames, drawn directly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from posecal.calibration import LEVELS
from posecal.calibration.ranks import rank_weights

Array = np.ndarray


@dataclass(frozen=True)
class Ranks:
    """Errors of AR(1) frames and correlated joints, and their ranks among N hypotheses of some spread.

    Attributes
    ----------
    sequences, frames, joints : int
        Sizes.
    correlation : float
        Between neighbouring frames.
    between_joints : float
        Between the joints of a frame.
    hypotheses, coordinates : int
        N and D.
    """

    sequences: int
    frames: int
    joints: int = 8
    correlation: float = 0.0
    between_joints: float = 0.3
    hypotheses: int = 50
    coordinates: int = 3

    def errors(self, random: np.random.Generator) -> Array:
        """True poses minus the centres of the distributions that they are drawn from, (S, F, K, D), of variance 1."""
        shape = (self.sequences, self.frames, self.joints, self.coordinates)
        common = random.normal(size=(*shape[:2], 1, shape[3]))
        errors = np.sqrt(1 - self.between_joints) * random.normal(size=shape) + np.sqrt(self.between_joints) * common
        for frame in range(1, self.frames):
            fresh = np.sqrt(1 - self.correlation**2) * errors[:, frame]
            errors[:, frame] = self.correlation * errors[:, frame - 1] + fresh
        return errors

    def sums(
        self, random: np.random.Generator, spread: float | Array = 1.0, shift: float = 0.0, modes: float = 0.0
    ) -> tuple[Array, Array]:
        """Give the sums over each sequence of the ranks' weights, (S, K, Q), and of standardized errors, (S, K, 3).

        The model's spread (one, or of each sequence) and centre are off, or it has one mode where there are two, alike
        at each joint of a frame.
        """
        spread = np.reshape(spread, (-1, 1, 1))
        errors = self.errors(random)
        errors[..., 0] += shift + modes * random.choice([-1, 1], size=(*errors.shape[:2], 1))
        distances = np.linalg.norm(errors, axis=-1) / spread
        less = random.binomial(self.hypotheses, stats.chi(self.coordinates).cdf(distances))
        noise = np.sqrt(np.pi / 2 / self.hypotheses) * random.spawn(1)[0].normal(size=errors.shape)
        width = 2 * stats.norm.ppf(0.75) * np.sqrt(self.coordinates)  # the distance between quartiles
        logs = np.maximum(np.log(np.linalg.norm(errors / np.asarray(spread)[..., None] + noise, axis=-1) / width), -5)
        standardized = np.stack([np.ones_like(logs), logs, logs**2], axis=-1)
        return rank_weights(self.hypotheses, less).sum(axis=1), standardized.sum(axis=1)


def deviations(ranks: Ranks, inside: Array) -> tuple[Array, Array]:
    """Deviations from the diagonal and counts, as tests take them."""
    counts = np.full(inside.shape[:2], ranks.frames)
    return inside - counts[..., None] * LEVELS, counts
