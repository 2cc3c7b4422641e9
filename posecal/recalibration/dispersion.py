"""Fit of the factor of the dispersion of hypotheses that calibrates them.

Every hypothesis is moved away from, or towards, the median of its pose or of its mode by one factor s or one per joint:
the one that brings the exchangeable calibration curve closest to the diagonal. A wider spread can cost minMPJPE, which
rewards a spread that is too narrow. The curve alone does not say whether a factor helps: the energy score and the CRPS
before and after do.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from posecal.calibration.curve import inside_table
from posecal.calibration.modes import LEAST, Modes, centres_of_modes, split_modes, summarize_modes
from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import BoolArray, FloatArray, checked_choice
from posecal.data.fitted_poses import fitted_hashes
from posecal.data.frames import frame_remark
from posecal.data.pose_data import PoseData
from posecal.data.stored_poses import Rows
from posecal.data.units import PERIODS
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from posecal.evaluation.sources import Source, as_pose_data
from posecal.recalibration import folds as parts
from posecal.recalibration.effect import changes_between, report_of
from posecal.recalibration.spread_map import SpreadMap
from posecal.report.report import Report

About = Literal["median", "modes"]
ABOUT: tuple[About, ...] = ("median", "modes")
"""What hypotheses are rescaled about."""

Counts = npt.NDArray[np.int64]

FACTORS: FloatArray = np.exp(np.linspace(np.log(0.1), np.log(10), 61))
"""The spread factors that are tried; the best is interpolated between them."""

MOST_BEYOND = 0.1
"""Of angles only factors are tried that bring at most this share of the hypotheses more than half a turn away from the
median: those all round the circle are calibrated too, and of no use."""


def find_modes(
    hypotheses: Source | PoseData,
    truth: Source | None = None,
    /,
    *,
    threads: int | None = None,
    **described: Any,
) -> Modes | None:
    """Find the joints whose hypotheses have several modes; the truth does not count.

    Parameters
    ----------
    hypotheses, truth, threads, **described
        As for :func:`posecal.recalibration.fit_spread`.

    Returns
    -------
    Modes or None
        As :func:`posecal.calibration.joint_modes` gives them of arrays; None for angles, and for fewer than ten
        hypotheses.

    Raises
    ------
    PoseDataError
        For data that can't be recalibrated either.
    """
    data = parts.select_fitted(as_pose_data(hypotheses, truth, described))
    if data.shape[0] < LEAST or data.unit in PERIODS:
        return None
    mask = parts.movable_joints(data)

    def measure(block: Block) -> tuple[BoolArray, FloatArray, BoolArray]:
        groups = split_modes(block.offsets)
        return groups.several, groups.apart, block.where & mask

    of_blocks = zip(*parts.measure_blocks(data, measure, threads), strict=True)
    several, apart, counted = (np.concatenate(part) for part in of_blocks)
    return summarize_modes(several, apart, counted, data.shape[0])


def joints_about_modes(data: PoseData, about: About, threads: int | None) -> BoolArray:
    """Give the joints whose hypotheses are rescaled about their modes, (K,).

    Raises
    ------
    PoseDataError
        For ``modes`` where no joint has several.
    """
    if checked_choice(about, "about", ABOUT) == "median":
        return np.zeros(len(data.joints), dtype=bool)
    modes = find_modes(data, threads=threads)
    if modes is None:
        what = f"N = {data.shape[0]}" if data.unit not in PERIODS else "angles"
        raise PoseDataError(f"about: 'modes' of {what}; expected at least {LEAST} hypotheses, of positions.")
    if not modes.several.any():
        raise PoseDataError(
            f"about: 'modes', but no joint has several: at most {np.nanmax(modes.share):.0%} of the poses of a joint; "
            f"expected more than {modes.limit:.0%}, which may come by chance. Fit about the median."
        )
    return modes.several


def curve_sums(data: PoseData, part_of: Rows, modal: BoolArray, threads: int | None) -> tuple[FloatArray, Counts]:
    """Sum the ``inside`` weights for every factor, (P, G, K, Q), and count them, (P, K), by part of the data.

    Parameters
    ----------
    data : PoseData
        M poses.
    part_of : array of int (M,)
        The part of each pose.
    modal : bool array (K,)
        The joints whose hypotheses are rescaled about their modes.
    threads : int or None
        One per core by default.
    """
    mask = parts.movable_joints(data)
    shape = (int(part_of.max()) + 1, len(FACTORS), len(data.joints), LEVELS.size)
    sums, counts = np.zeros(shape), np.zeros((shape[0], shape[2]), dtype=np.int64)

    def measure(block: Block) -> tuple[FloatArray, BoolArray, FloatArray]:
        centre = centres_of_modes(block, modal) if modal.any() else None
        scaled = (block.scale_dispersion(factor, centre) for factor in FACTORS)
        tables = [inside_table(one, "exchangeable", mask)[:, :-1] for one in scaled]
        counted = block.where & mask
        return np.nan_to_num(np.stack(tables, axis=1)), counted, _beyond(block, counted)

    start, beyond = 0, np.zeros(len(FACTORS))
    for weights, counted, shares in parts.measure_blocks(data, measure, threads):
        beyond += shares
        of_poses = part_of[start : start + len(weights)]
        start += len(weights)
        for part in np.unique(of_poses):
            sums[part] += weights[of_poses == part].sum(axis=0)
            counts[part] += counted[of_poses == part].sum(axis=0)
    return sums[:, beyond <= MOST_BEYOND * counts.sum()], counts


def _beyond(block: Block, counted: BoolArray) -> FloatArray:
    """For every factor the sum over joints of the share of angles more than half a turn from the median, (G,)."""
    if block.period is None:
        return np.zeros(len(FACTORS))
    away = np.abs(block.shortest(block.from_median)[counted])
    limits = block.period / 2 / FACTORS
    return np.array([(away > limit).mean(axis=(1, 2)).sum() for limit in limits])


def best_factors(
    sums: FloatArray,
    counts: Counts,
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
    about: About = "median",
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
    about : str
        ``median``: hypotheses are rescaled about the median of their pose. ``modes``: at joints with several modes
        about that of the mode that each belongs to, so that modes which are too narrow, or too wide, are mended where
        they lie.
    threads : int, optional
        One per core by default.
    **described
        Options that describe the data, as for :func:`posecal.evaluate` (``labels=``, ``joints=``, ``unit=``, …).

    Returns
    -------
    SpreadMap
        The factors that minimise the mean over q (and joints) of (ω_k(q) - q)², exchangeable definition, with the
        energy score and the CRPS before and after. Where these get worse its ``objections`` say so, and writing it
        needs ``anyway=True``.

    Raises
    ------
    PoseDataError
        For one hypothesis, where no factor calibrates, and for ``modes`` where no joint has several.

    Notes
    -----
    Judge it on other sequences: :func:`posecal.recalibration.judge_spread`. Differs from the published code: none;
    ours.

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
    modal = joints_about_modes(data, about, threads)
    sums, counts = curve_sums(data, np.zeros(len(data.truth), dtype=np.intp), modal, threads)
    factors = best_factors(sums[0], counts[0], data.joints, per_joint=per_joint, frames=frame_remark(data))
    return finished_map(data, factors, modal, threads)


def finished_map(
    data: PoseData, factors: FloatArray, modal: BoolArray, threads: int | None, before: Report | None = None
) -> SpreadMap:
    """Make a map of the factors that were fitted on some data, with what it changes there; ``before`` saves time."""
    fitted = len(data.truth), parts.number_of_sequences(data), data.root, data.unit, parts.remarks_of(data)
    about_modes, hashes = tuple(np.array(data.joints)[modal].tolist()), fitted_hashes(data.truth)
    spread_map = SpreadMap(data.joints, factors, *fitted, modal=about_modes, fitted_on=hashes)
    before, after = before or report_of(data, threads), report_of(spread_map.rescale(data), threads)
    return replace(spread_map, changes=changes_between(before, after))
