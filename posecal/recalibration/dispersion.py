"""By what factor is a spread wrong, and what do hypotheses become when it is undone?

Every hypothesis is moved away from, or towards, the per-coordinate median of its pose, x ← c + s (x - c), by one factor
s or one per joint; the one that brings the exchangeable curve closest to the diagonal. A mended spread can cost
minMPJPE, which is what that number rewards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.calibration.curve import inside_table
from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.pose_data import Hypotheses, PoseData, Rows
from posecal.engine.accumulate import accumulate, walk
from posecal.engine.block import Block
from posecal.engine.blocks import block_length
from posecal.engine.merge import merge_totals
from posecal.engine.protocol import Protocol
from posecal.engine.threads import run_in_order
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError
from posecal.recalibration.folds import at_least_two, folds_of, for_joints, moving, sequences

__all__ = ["FACTORS", "RescaledHypotheses", "SpreadMap", "cross_fitted", "fit_spread", "stretched"]

FACTORS: FloatArray = np.exp(np.linspace(np.log(0.1), np.log(10), 61))
"""The spread factors that are tried; the best is interpolated between them."""


@dataclass(frozen=True)
class SpreadMap:
    """A factor of the spread of each joint.

    Attributes
    ----------
    joints : tuple of str
        K names.
    factors : array (K,)
        s of each joint; above 1 widens.
    poses, sequences : int
        What it was fitted on.
    """

    joints: tuple[str, ...]
    factors: FloatArray
    poses: int
    sequences: int

    def applied(self, pairs: PoseData) -> PoseData:
        """Give pairs whose hypotheses are stretched when they are read."""
        factors = for_joints(self.joints, self.factors, pairs.joints, pairs.names[0])
        return replace(pairs, hypotheses=RescaledHypotheses(pairs.hypotheses, factors, pairs.root))


@dataclass(frozen=True)
class RescaledHypotheses:
    """Hypotheses whose spread about their median is multiplied when they are read.

    Attributes
    ----------
    hypotheses : Hypotheses
        As they were.
    factors : array (K,)
        s of each joint.
    root : int or None
        The joint to which spreads are relative.
    """

    hypotheses: Hypotheses
    factors: FloatArray
    root: int | None

    @property
    def n_hypotheses(self) -> int:
        """N."""
        return self.hypotheses.n_hypotheses

    @property
    def itemsize(self) -> int:
        """Bytes of a coordinate."""
        return self.hypotheses.itemsize

    def taken(self, poses: Rows) -> RescaledHypotheses:
        """Keep some poses, by their numbers."""
        return replace(self, hypotheses=self.hypotheses.taken(poses))

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        found = self.hypotheses.read(start, stop)
        return stretched(found, self.factors, self.root)


def stretched(hypotheses: FloatArray, factors: FloatArray, root: int | None = None) -> FloatArray:
    """Multiply the spread of hypotheses about their per-coordinate median.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    factors : array (K,)
        s of each joint.
    root : int, optional
        The joint that positions are relative to; it keeps its own spread.

    Returns
    -------
    array (N, M, K, D)
        c + s (x - c), in the precision of the hypotheses.
    """
    origin = 0 if root is None else hypotheses[:, :, root, None]
    relative = hypotheses - origin
    size = block_length(relative.shape, relative.dtype)
    nowhere = np.zeros(relative.shape[1:], dtype=relative.dtype)
    parts = [
        Block(relative[:, at : at + size], nowhere[at : at + size]).median for at in range(0, relative.shape[1], size)
    ]
    centre = np.concatenate(parts)
    scale = factors.astype(relative.dtype)[:, None]
    moved: FloatArray = centre + scale * (relative - centre) + origin
    return moved


def _curves(pairs: PoseData, folds: Rows, threads: int | None) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Sums of the ``inside`` weights for every factor, (F, G, K, Q), and their counts (F, K), by part."""
    mask = moving(pairs)
    shape = (int(folds.max()) + 1, len(FACTORS), len(pairs.joints), LEVELS.size)
    sums, counts = np.zeros(shape), np.zeros((shape[0], shape[2]), dtype=np.int64)

    def measure(poses: slice, lay_out: Callable[[], Block]) -> tuple[slice, FloatArray, BoolArray]:
        block = lay_out()
        if block.non_finite.any():
            raise PoseDataError(f"{pairs.names[0]} has non-finite coordinates; evaluate says where.")
        found = np.empty((len(block.where), len(FACTORS), len(mask), LEVELS.size))
        for place, factor in enumerate(FACTORS):
            found[:, place] = inside_table(block.stretched(factor), "exchangeable", mask)[:, :-1]
        return poses, found, block.where & mask

    tasks = (partial(measure, poses, lay_out) for poses, lay_out in walk(pairs))
    for poses, found, counted in run_in_order(tasks, threads):
        for fold in np.unique(folds[poses]):
            chosen = folds[poses] == fold
            sums[fold] += np.nansum(found[chosen], axis=0)
            counts[fold] += counted[chosen].sum(axis=0)
    return sums, counts


def _best_factors(
    sums: FloatArray, counts: npt.NDArray[np.int64], joints: tuple[str, ...], *, per_joint: bool
) -> FloatArray:
    """Factors (K,) at which the curves (G, K, Q) are closest to the diagonal; 1 for joints that don't count."""
    used = counts > 0
    distance = ((sums[:, used] / counts[used][:, None] - LEVELS) ** 2).mean(axis=-1)  # (G, K used)
    if not per_joint:
        distance = np.repeat(distance.mean(axis=1, keepdims=True), used.sum(), axis=1)
    uncalibrated = np.flatnonzero(used)[np.isin(distance.argmin(axis=0), (0, len(FACTORS) - 1))]
    if uncalibrated.size:
        which = (
            ", ".join(joints[k].removeprefix("joint ") for k in uncalibrated) if per_joint else "all joints together"
        )
        raise PoseDataError(
            f"spread: no factor from {FACTORS[0]:g} to {FACTORS[-1]:g} calibrates {which}. Do the hypotheses all agree?"
        )
    factors = np.ones(len(counts))
    factors[used] = [_minimum(column) for column in distance.T]
    return factors


def _minimum(distance: FloatArray) -> float:
    """Where a function of the factors is smallest, by a parabola in the logarithm through the best three."""
    best = int(distance.argmin())
    left, middle, right = distance[best - 1 : best + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0 else 0.0
    step = math.log(FACTORS[1] / FACTORS[0])
    return float(FACTORS[best] * math.exp(shift * step))


def fit_spread(pairs: PoseData, *, per_joint: bool = False, threads: int | None = None) -> SpreadMap:
    """Find the factor of the spread that calibrates hypotheses.

    Parameters
    ----------
    pairs : PoseData
        Hypotheses, N ≥ 2, and truth.
    per_joint : bool
        Whether each joint has its own factor.
    threads : int, optional
        How many; by default one per core.

    Returns
    -------
    SpreadMap
        The factors that minimise the mean over q (and joints) of (ω_k(q) - q)², exchangeable definition.

    Raises
    ------
    PoseDataError
        For one hypothesis, and where no factor calibrates.

    Notes
    -----
    Judge it on other sequences: :func:`cross_fitted`. Differs from the published code: none; ours.
    """
    at_least_two(pairs)
    sums, counts = _curves(pairs, np.zeros(len(pairs.truth), dtype=np.intp), threads)
    factors = _best_factors(sums[0], counts[0], pairs.joints, per_joint=per_joint)
    return SpreadMap(pairs.joints, factors, len(pairs.truth), sequences(pairs))


def cross_fitted(
    pairs: PoseData,
    protocol: Protocol | None = None,
    *,
    folds: int = 5,
    per_joint: bool = False,
    threads: int | None = None,
) -> tuple[Totals, Totals, list[FloatArray]]:
    """Judge a spread factor on sequences that it was not fitted on.

    Parameters
    ----------
    pairs : PoseData
        Hypotheses and truth.
    protocol : Protocol, optional
        What is measured.
    folds : int
        Parts into which the sequences are cut; each is mended by a factor fitted on the others.
    per_joint : bool
        Whether each joint has its own factor.
    threads : int, optional
        How many; by default one per core.

    Returns
    -------
    before, after : Totals
        Over all poses: as they are, and each mended by the factor of the other parts.
    factors : list of arrays (K,)
        Of each part.

    Raises
    ------
    PoseDataError
        For fewer sequences than parts.
    """
    at_least_two(pairs)
    part = folds_of(pairs, folds)
    sums, counts = _curves(pairs, part, threads)
    before = accumulate(pairs, protocol, threads=threads)
    after, factors = [], []
    for fold in range(folds):
        others = sums.sum(axis=0) - sums[fold], counts.sum(axis=0) - counts[fold]
        found = _best_factors(*others, pairs.joints, per_joint=per_joint)
        held_out = pairs.taken(np.flatnonzero(part == fold))
        mended = SpreadMap(pairs.joints, found, 0, 0).applied(held_out)
        after.append(accumulate(mended, protocol, threads=threads))
        factors.append(found)
    return before, merge_totals(after), factors
