"""How is a miscalibrated model mended, without training it again? By its spread, or by a radius that holds.

``spread``: every hypothesis is moved away from, or towards, the per-coordinate median of its pose, x ← c + s (x - c),
by one factor s or one per joint; the one that brings the exchangeable curve closest to the diagonal. ``radius``: per
joint the distance from the median that holds a share 1 - α of the truths (split conformal prediction).

Both are fitted on sequences other than those they are judged on: :func:`cross_fitted` leaves out each part of the
sequences in turn. A mended spread can cost minMPJPE, which is what that number rewards.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.block import Block, BoolArray, FloatArray, block_length, in_order
from posecal.calibration.curve import inside_table
from posecal.calibration.ranks import LEVELS
from posecal.errors import PoseDataError
from posecal.evaluation import add_up, walk
from posecal.metrics.spread import joint_deviations
from posecal.pairs import Hypotheses, PosePairs, Rows
from posecal.protocol import Protocol
from posecal.totals import Totals

__all__ = [
    "FACTORS",
    "RadiusMap",
    "SpreadMap",
    "Stretched",
    "cross_fitted",
    "fit_radius",
    "fit_spread",
    "folds_of",
    "held_out_coverage",
]

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

    def applied(self, pairs: PosePairs) -> PosePairs:
        """Give pairs whose hypotheses are stretched when they are read."""
        factors = _for_joints(self.joints, self.factors, pairs.joints, pairs.names[0])
        return replace(pairs, hypotheses=Stretched(pairs.hypotheses, factors, pairs.root), scores=pairs.scores)


@dataclass(frozen=True)
class RadiusMap:
    """A radius about the median that holds the truth, for each joint.

    Attributes
    ----------
    joints : tuple of str
        K names.
    radii : array (K,)
        mm, or where ``scaled`` multiples of the predicted standard deviation.
    alpha : float
        The share of truths that may lie outside.
    scaled : bool
        Whether the radius goes with the predicted spread of each pose.
    poses, sequences : int
        What it was fitted on.
    """

    joints: tuple[str, ...]
    radii: FloatArray
    alpha: float
    scaled: bool
    poses: int
    sequences: int


@dataclass(frozen=True)
class Stretched:
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

    def taken(self, poses: Rows) -> Stretched:
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


def _for_joints(names: tuple[str, ...], values: FloatArray, joints: tuple[str, ...], where: str) -> FloatArray:
    missing = [joint for joint in joints if joint not in names]
    if missing:
        raise PoseDataError(f"{where} has joints that the map lacks: {', '.join(missing)}. Fit a map on these joints.")
    return values[[names.index(joint) for joint in joints]]


# --- fitting the spread ---------------------------------------------------------------------------------------


def folds_of(pairs: PosePairs, folds: int = 5) -> Rows:
    """Give the part of each pose, (M,), cutting between sequences, the parts alike in poses.

    Raises
    ------
    PoseDataError
        For fewer sequences than parts.
    """
    sequence = pairs.labels.get("sequence")
    if sequence is None:
        return np.arange(len(pairs.truth)) * folds // len(pairs.truth)
    names, place, sizes = np.unique(sequence, return_inverse=True, return_counts=True)
    if not 2 <= folds <= len(names):
        raise PoseDataError(f"folds: {folds}; expected 2 to {len(names)}, the number of sequences of {pairs.names[1]}.")
    load = np.zeros(folds, dtype=np.intp)
    of_name = np.zeros(len(names), dtype=np.intp)
    for name in np.argsort(-sizes, kind="stable"):
        of_name[name] = load.argmin()
        load[of_name[name]] += sizes[name]
    return of_name[place]


def _moving(pairs: PosePairs) -> BoolArray:
    mask = np.ones(len(pairs.joints), dtype=bool)
    if pairs.root is not None:
        mask[pairs.root] = False
    return mask


def _curves(pairs: PosePairs, folds: Rows, threads: int | None) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Sums of the ``inside`` weights for every factor, (F, G, K, Q), and their counts (F, K), by part."""
    moving = _moving(pairs)
    shape = (int(folds.max()) + 1, len(FACTORS), len(pairs.joints), LEVELS.size)
    sums, counts = np.zeros(shape), np.zeros((shape[0], shape[2]), dtype=np.int64)

    def measure(poses: slice, lay_out: Callable[[], Block]) -> tuple[slice, FloatArray, BoolArray]:
        block = lay_out()
        if block.non_finite.any():
            raise PoseDataError(f"{pairs.names[0]} has non-finite coordinates; evaluate says where.")
        found = np.empty((len(block.where), len(FACTORS), len(moving), LEVELS.size))
        for place, factor in enumerate(FACTORS):
            found[:, place] = inside_table(block.stretched(factor), "exchangeable", moving)[:, :-1]
        return poses, found, block.where & moving

    tasks = (partial(measure, poses, lay_out) for poses, lay_out in walk(pairs))
    for poses, found, counted in in_order(tasks, threads):
        for fold in np.unique(folds[poses]):
            chosen = folds[poses] == fold
            sums[fold] += np.nansum(found[chosen], axis=0)
            counts[fold] += counted[chosen].sum(axis=0)
    return sums, counts


def _best_factors(sums: FloatArray, counts: npt.NDArray[np.int64], *, per_joint: bool) -> FloatArray:
    """Factors (K,) at which the curves (G, K, Q) are closest to the diagonal; 1 for joints that don't count."""
    used = counts > 0
    distance = ((sums[:, used] / counts[used][:, None] - LEVELS) ** 2).mean(axis=-1)  # (G, K used)
    if not per_joint:
        distance = np.repeat(distance.mean(axis=1, keepdims=True), used.sum(), axis=1)
    factors = np.ones(len(counts))
    factors[used] = [_minimum(column) for column in distance.T]
    return factors


def _minimum(distance: FloatArray) -> float:
    """Where a function of the factors is smallest, by a parabola in the logarithm through the best three."""
    best = int(distance.argmin())
    if best in (0, len(FACTORS) - 1):
        raise PoseDataError(
            f"spread: no factor from {FACTORS[0]:g} to {FACTORS[-1]:g} calibrates a joint. Do its hypotheses all agree?"
        )
    left, middle, right = distance[best - 1 : best + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0 else 0.0
    step = math.log(FACTORS[1] / FACTORS[0])
    return float(FACTORS[best] * math.exp(shift * step))


def fit_spread(pairs: PosePairs, *, per_joint: bool = False, threads: int | None = None) -> SpreadMap:
    """Find the factor of the spread that calibrates hypotheses.

    Parameters
    ----------
    pairs : PosePairs
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
    _at_least_two(pairs)
    sums, counts = _curves(pairs, np.zeros(len(pairs.truth), dtype=np.intp), threads)
    factors = _best_factors(sums[0], counts[0], per_joint=per_joint)
    return SpreadMap(pairs.joints, factors, len(pairs.truth), _sequences(pairs))


def _at_least_two(pairs: PosePairs) -> None:
    if pairs.shape[0] < 2:
        raise PoseDataError(f"{pairs.names[0]}: 1 hypothesis; recalibration needs at least 2.")


def _sequences(pairs: PosePairs) -> int:
    return len(np.unique(pairs.labels["sequence"])) if "sequence" in pairs.labels else 0


def cross_fitted(
    pairs: PosePairs,
    protocol: Protocol | None = None,
    *,
    folds: int = 5,
    per_joint: bool = False,
    threads: int | None = None,
) -> tuple[Totals, Totals, list[FloatArray]]:
    """Judge a spread factor on sequences that it was not fitted on.

    Parameters
    ----------
    pairs : PosePairs
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
    _at_least_two(pairs)
    part = folds_of(pairs, folds)
    sums, counts = _curves(pairs, part, threads)
    before = add_up(pairs, protocol, threads=threads)
    after, factors = [], []
    for fold in range(folds):
        found = _best_factors(sums.sum(axis=0) - sums[fold], counts.sum(axis=0) - counts[fold], per_joint=per_joint)
        held_out = pairs.taken(np.flatnonzero(part == fold))
        mended = SpreadMap(pairs.joints, found, 0, 0).applied(held_out)
        after.append(add_up(mended, protocol, threads=threads))
        factors.append(found)
    return before, Totals.merged(after), factors


# --- conformal radii ------------------------------------------------------------------------------------------


def _distances(pairs: PosePairs, *, scaled: bool, threads: int | None) -> FloatArray:
    """Distance of the truth from the median, (M, K), mm or predicted standard deviations; NaN for uncounted ones."""
    moving = _moving(pairs)

    def measure(lay_out: Callable[[], Block]) -> FloatArray:
        block = lay_out()
        found = np.linalg.norm(block.median.astype(np.float64), axis=-1)
        if scaled:
            with np.errstate(divide="ignore", invalid="ignore"):
                found = found / joint_deviations(block)
        return np.where(block.where & moving, found, np.nan)

    return np.concatenate(list(in_order((partial(measure, lay_out) for _, lay_out in walk(pairs)), threads)))


def _radii(distances: FloatArray, alpha: float) -> FloatArray:
    """The ⌈(n + 1)(1 - α)⌉-th smallest distance of each joint; NaN for joints that don't count."""
    radii = np.full(distances.shape[1], np.nan)
    for joint, column in enumerate(distances.T):
        known = np.sort(column[~np.isnan(column)])
        if not len(known):
            continue
        place = math.ceil((len(known) + 1) * (1 - alpha) - 1e-9)
        if place > len(known):
            raise PoseDataError(
                f"alpha: {alpha:g} needs more than {len(known)} poses; the smallest possible with them is "
                f"{1 / (len(known) + 1):.4g}."
            )
        radii[joint] = known[place - 1]
    return radii


def fit_radius(pairs: PosePairs, alpha: float = 0.1, *, scaled: bool = False, threads: int | None = None) -> RadiusMap:
    r"""Find the radius about the median that holds the truth of each joint in a share 1 - α of poses.

    .. math:: r_k = d_{(\lceil (n+1)(1-\alpha) \rceil)\,k}, \qquad
              d_{mk} = \lVert y_{mk} - \operatorname{median}_n x_{nmk} \rVert

    Parameters
    ----------
    pairs : PosePairs
        Hypotheses and truth, n poses.
    alpha : float
        The share of truths that may lie outside, between 0 and 1.
    scaled : bool
        Whether distances count in multiples of the predicted standard deviation of the pose's joint, so that
        uncertain poses get larger balls.
    threads : int, optional
        How many; by default one per core.

    Returns
    -------
    RadiusMap
        The radii.

    Raises
    ------
    PoseDataError
        For an α outside (0, 1), or smaller than 1/(n + 1), which no number of poses n allows.

    Notes
    -----
    The coverage is at least 1 - α for a new pose that is exchangeable with these; frames of one video are less worth
    than their number says. Differs from the published code: none; ours.

    References
    ----------
    Angelopoulos and Bates, arXiv:2107.07511 (split conformal prediction).
    """
    if not 0 < alpha < 1:
        raise PoseDataError(f"alpha: {alpha:g}; expected between 0 and 1.")
    if scaled:
        _at_least_two(pairs)
    radii = _radii(_distances(pairs, scaled=scaled, threads=threads), alpha)
    return RadiusMap(pairs.joints, radii, alpha, scaled, len(pairs.truth), _sequences(pairs))


def held_out_coverage(
    pairs: PosePairs, alpha: float = 0.1, *, scaled: bool = False, folds: int = 5, threads: int | None = None
) -> FloatArray:
    """Share of held-out truths inside the radius that was fitted on the other sequences, per joint.

    Parameters
    ----------
    pairs, alpha, scaled, threads
        As for :func:`fit_radius`.
    folds : int
        Parts into which the sequences are cut.

    Returns
    -------
    array (K,)
        Shares; 1 - α is meant. NaN for joints that don't count.

    Raises
    ------
    PoseDataError
        As :func:`fit_radius`, and for fewer sequences than parts.
    """
    part = folds_of(pairs, folds)
    distances = _distances(pairs, scaled=scaled, threads=threads)
    within = np.full(distances.shape, np.nan)
    for fold in range(folds):
        radii = _radii(distances[part != fold], alpha)
        chosen = part == fold
        within[chosen] = np.where(np.isnan(distances[chosen]), np.nan, distances[chosen] <= radii)
    number = (~np.isnan(within)).sum(axis=0)
    return np.where(number > 0, np.nansum(within, axis=0) / np.maximum(number, 1), np.nan)
