"""Rescaling of the dispersion of hypotheses about their median, by a factor that calibrates them.

Every hypothesis is moved away from, or towards, the per-coordinate median of its pose, x ← c + s (x - c), by one factor
s or one per joint: the one that brings the exchangeable calibration curve closest to the diagonal. A wider spread can
cost minMPJPE, which rewards a spread that is too narrow. Of angles x - c is the shorter way round, and so is what it
becomes: a spread of more than half a turn goes on round the circle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.calibration.curve import inside_table
from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.frames import frame_remark
from posecal.data.pose_data import PoseData
from posecal.data.root import AnyRoot, origin
from posecal.data.stored_poses import Hypotheses, Rows
from posecal.data.units import PERIODS
from posecal.engine.block import Block
from posecal.engine.circular import wrapped
from posecal.engine.merge import merge_totals
from posecal.engine.per_pose import iter_blocks
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError, for_python
from posecal.evaluation.call import evaluate
from posecal.evaluation.sources import Source, as_pose_data
from posecal.recalibration import folds as parts
from posecal.report.report import Report

FACTORS: FloatArray = np.exp(np.linspace(np.log(0.1), np.log(10), 61))
"""The spread factors that are tried; the best is interpolated between them."""

MOST_BEYOND = 0.1
"""Of angles only factors are tried that bring at most this share of the hypotheses more than half a turn away from the
median: those all round the circle are calibrated too, and of no use."""


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
    root : int, Root or None
        What positions were relative to.
    data_unit : str
        Of what it was fitted on: ``mm``, ``deg``, ``px``, or empty.
    data_remarks : tuple of str
        On what it was fitted on, as those of :class:`posecal.PoseData`; a file of the map does not hold them.
    """

    joints: tuple[str, ...]
    factors: FloatArray
    poses: int
    sequences: int
    root: AnyRoot = None
    data_unit: str = "mm"
    data_remarks: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a careful reader should know about the data that it was fitted on."""
        return tuple(map(for_python, self.data_remarks))

    @property
    def by_joint(self) -> dict[str, float]:
        """The factors by the names of their joints."""
        return dict(zip(self.joints, self.factors.tolist(), strict=True))

    def apply(
        self, hypotheses: npt.ArrayLike, /, *, axes: str | None = None, unit: str | float | None = None
    ) -> FloatArray:
        """Rescale the dispersion of hypotheses.

        Parameters
        ----------
        hypotheses : array (N, M, K, D), or as ``axes`` says
            Hypotheses with the joints of the map, in any unit.
        axes : str, optional
            Their layout, as for :func:`posecal.evaluate`; ``NMKD`` by default.
        unit : str or float, optional
            Their unit, which only a map of angles needs: ``deg`` or ``rad``.

        Returns
        -------
        array in the same layout, without an axis ``I``
            c + s (x - c), in the same unit; c is the per-coordinate median of a pose's hypotheses.

        Raises
        ------
        PoseDataError
            For another number of joints, arrays of another shape, type or quantity, a layout that is none, angles
            without a unit, where no layout is given and only the first axis has the length of the poses that the map
            was fitted on, for columns that are no coordinates, coordinates that are infinite or beyond 1e7, and joints
            that only some hypotheses have.
        """
        factor = parts.factor_of_unit(unit, self.data_unit)
        x, layout, clip_length = parts.checked_for_map(hypotheses, axes, self.joints, self.poses)
        return layout.store(rescaled(x, self.factors, self.root, parts.period_in(self.data_unit, factor)), clip_length)

    def rescale(self, data: PoseData) -> PoseData:
        """Give pose data whose hypotheses are rescaled when they are read."""
        parts.refuse_another_unit(data.names[0], data.unit, self.data_unit)
        factors = parts.values_for_joints(self.joints, self.factors, data.joints, data.names[0])
        period = PERIODS.get(data.unit)
        rescaled_hypotheses = RescaledHypotheses(data.hypotheses, factors, data.root, period)
        return data.replace(hypotheses=rescaled_hypotheses, log_prob=None, dimensions=0)  # of another distribution


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
    period : float or None
        After how much coordinates repeat.
    """

    hypotheses: Hypotheses
    factors: FloatArray
    root: AnyRoot
    period: float | None = None

    @property
    def n_hypotheses(self) -> int:
        """N."""
        return self.hypotheses.n_hypotheses

    @property
    def itemsize(self) -> int:
        """Bytes of a coordinate."""
        return self.hypotheses.itemsize

    def select(self, poses: Rows) -> RescaledHypotheses:
        """Keep some poses, by their numbers."""
        return replace(self, hypotheses=self.hypotheses.select(poses))

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        return rescaled(self.hypotheses.read(start, stop), self.factors, self.root, self.period)


def rescaled(
    hypotheses: FloatArray, factors: FloatArray, root: AnyRoot = None, period: float | None = None
) -> FloatArray:
    """Multiply the spread of hypotheses about their per-coordinate median.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    factors : array (K,)
        s of each joint.
    root : int or Root, optional
        What positions are relative to; it keeps its own spread.
    period : float, optional
        After how much coordinates repeat, such as 360 for degrees.

    Returns
    -------
    array (N, M, K, D)
        c + s (x - c), in the precision of the hypotheses.
    """
    start = 0 if root is None else origin(hypotheses, root)
    zeros = np.zeros(hypotheses.shape[1:], dtype=hypotheses.dtype)
    blocks = iter_blocks(hypotheses, zeros, root=root, period=period)
    centre = np.concatenate([lay_out().median for lay_out in blocks])
    times = factors.astype(centre.dtype)[:, None]
    if period is not None:  # what does not change stays as it is written
        away = wrapped(hypotheses - start - centre, period)
        return hypotheses + (wrapped(times * away, period) - away)
    moved: FloatArray = centre + times * (hypotheses - start - centre) + start
    return moved


def _curves(data: PoseData, fold_of: Rows, threads: int | None) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Sums of the ``inside`` weights for every factor, (F, G, K, Q), and their counts (F, K), by fold."""
    mask = parts.movable_joints(data)
    shape = (int(fold_of.max()) + 1, len(FACTORS), len(data.joints), LEVELS.size)
    sums, counts = np.zeros(shape), np.zeros((shape[0], shape[2]), dtype=np.int64)

    def measure(block: Block) -> tuple[FloatArray, BoolArray, FloatArray]:
        tables = [inside_table(block.scale_dispersion(factor), "exchangeable", mask)[:, :-1] for factor in FACTORS]
        counted = block.where & mask
        return np.nan_to_num(np.stack(tables, axis=1)), counted, _beyond(block, counted)

    start, beyond = 0, np.zeros(len(FACTORS))
    for weights, counted, shares in parts.measure_blocks(data, measure, threads):
        beyond += shares
        folds = fold_of[start : start + len(weights)]
        start += len(weights)
        for fold in np.unique(folds):
            sums[fold] += weights[folds == fold].sum(axis=0)
            counts[fold] += counted[folds == fold].sum(axis=0)
    return sums[:, beyond <= MOST_BEYOND * counts.sum()], counts


def _beyond(block: Block, counted: BoolArray) -> FloatArray:
    """For every factor the sum over joints of the share of angles more than half a turn from the median, (G,)."""
    if block.period is None:
        return np.zeros(len(FACTORS))
    away = np.abs(block.shortest(block.from_median)[counted])
    limits = block.period / 2 / FACTORS
    return np.array([(away > limit).mean(axis=(1, 2)).sum() for limit in limits])


def _best_factors(
    sums: FloatArray,
    counts: npt.NDArray[np.int64],
    joints: tuple[str, ...],
    *,
    per_joint: bool,
    frames: str = "",
) -> FloatArray:
    """Factors (K,) at which the curves (G, K, Q) are closest to the diagonal; 1 for joints that don't count.

    Between the tried factors it is a parabola's smallest value, in the logarithm, through the best three. The remark on
    coordinate ``frames``, if any, is the reason where none calibrates.
    """
    used = counts > 0
    distance = ((sums[:, used] / counts[used][:, None] - LEVELS) ** 2).mean(axis=-1)  # (G, K used)
    if not per_joint:
        distance = np.repeat(distance.mean(axis=1, keepdims=True), used.sum(), axis=1)
    best = distance.argmin(axis=0)
    tried = FACTORS[: len(distance)]
    uncalibrated = np.flatnonzero(used)[np.isin(best, (0, len(tried) - 1))]
    if uncalibrated.size:
        names = ", ".join(joints[k].removeprefix("joint ") for k in uncalibrated)
        raise PoseDataError(
            f"spread: no factor from {tried[0]:g} to {tried[-1]:.3g} calibrates "
            f"{names if per_joint else 'all joints together'}. "
            + (f"C{frames[1:]}" if frames else "Do the hypotheses all agree?")
        )
    left, middle, right = np.take_along_axis(distance, best + np.array([[-1], [0], [1]]), axis=0)
    shift = 0.5 * (left - right) / (left - 2 * middle + right)  # the best is the first of its kind: left > middle
    factors = np.ones(len(counts))
    factors[used] = FACTORS[best] * (FACTORS[1] / FACTORS[0]) ** shift
    return factors


def fit_spread(
    hypotheses: Source | PoseData,
    truth: Source | None = None,
    /,
    *,
    per_joint: bool = False,
    threads: int | None = None,
    **described: Any,
) -> SpreadMap:
    """Find the factor of the spread that calibrates hypotheses.

    Parameters
    ----------
    hypotheses, truth : arrays, paths or PoseData
        As for :func:`posecal.evaluate`; at least two hypotheses.
    per_joint : bool
        Whether each joint has its own factor.
    threads : int, optional
        One per core by default.
    **described
        Options that describe the data, as for :func:`posecal.evaluate` (``labels=``, ``joints=``, ``unit=``, …).

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

    Examples
    --------
    Hypotheses with half the spread of the truth are widened by about 2.

    >>> random = np.random.default_rng(0)
    >>> truth, hypotheses = random.normal(0, 60, (500, 4, 3)), random.normal(0, 30, (50, 500, 4, 3))
    >>> spread_map = fit_spread(hypotheses, truth, unit="mm")
    >>> bool(1.8 < spread_map.factors[0] < 2.2), spread_map.apply(hypotheses).shape
    (True, (50, 500, 4, 3))
    """
    data = parts.select_fitted(as_pose_data(hypotheses, truth, described))
    sums, counts = _curves(data, np.zeros(len(data.truth), dtype=np.intp), threads)
    factors = _best_factors(sums[0], counts[0], data.joints, per_joint=per_joint, frames=frame_remark(data))
    fitted = len(data.truth), parts.number_of_sequences(data), data.root, data.unit, parts.remarks_of(data)
    return SpreadMap(data.joints, factors, *fitted)


def cross_fitted(
    hypotheses: Source | PoseData,
    truth: Source | None = None,
    /,
    *,
    protocol: Protocol | str | None = None,
    folds: int = 5,
    per_joint: bool = False,
    threads: int | None = None,
    **described: Any,
) -> tuple[Report, Report, list[FloatArray]]:
    """Judge a spread factor on sequences that it was not fitted on.

    Parameters
    ----------
    hypotheses, truth, per_joint, threads, **described
        As for :func:`fit_spread`.
    protocol : Protocol or str, optional
        What is measured.
    folds : int
        Parts into which the sequences are cut; each is rescaled by a factor fitted on the others.

    Returns
    -------
    before, after : Report
        Over all poses: as they are, and each rescaled by the factor of the other parts.
    factors : list of arrays (K,)
        Of each part.

    Raises
    ------
    PoseDataError
        For one hypothesis, and fewer sequences than parts.
    """
    data = parts.select_fitted(as_pose_data(hypotheses, truth, described))
    fold_of = parts.folds_of(data, folds)
    sums, counts = _curves(data, fold_of, threads)
    totals, factors, frames = [], list[FloatArray](), frame_remark(data)
    for fold in range(folds):
        others = sums.sum(axis=0) - sums[fold], counts.sum(axis=0) - counts[fold]
        factors.append(_best_factors(*others, data.joints, per_joint=per_joint, frames=frames))
        held_out = data.select(np.flatnonzero(fold_of == fold))
        rescaled_part = SpreadMap(data.joints, factors[-1], 0, 0, data_unit=data.unit).rescale(held_out)
        totals.append(evaluate(rescaled_part, protocol=protocol, threads=threads).totals)
    return evaluate(data, protocol=protocol, threads=threads), Report(merge_totals(totals)), factors
