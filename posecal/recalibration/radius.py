"""Which radius about the median holds the truth? Split conformal prediction, joint by joint."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.pose_data import PoseData
from posecal.engine.accumulate import walk
from posecal.engine.block import Block
from posecal.engine.threads import run_in_order
from posecal.errors import PoseDataError
from posecal.metrics.sharpness import joint_deviations
from posecal.recalibration.folds import at_least_two, folds_of, moving, sequences

__all__ = ["RadiusMap", "fit_radius", "held_out_coverage"]


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


def _distances(pairs: PoseData, *, scaled: bool, threads: int | None) -> FloatArray:
    """Distance of the truth from the median, (M, K), mm or predicted standard deviations; NaN for uncounted ones."""
    mask = moving(pairs)

    def measure(lay_out: Callable[[], Block]) -> FloatArray:
        block = lay_out()
        found = np.linalg.norm(block.median.astype(np.float64), axis=-1)
        if scaled:
            with np.errstate(divide="ignore", invalid="ignore"):
                found = found / joint_deviations(block)
        return np.where(block.where & mask, found, np.nan)

    return np.concatenate(list(run_in_order((partial(measure, lay_out) for _, lay_out in walk(pairs)), threads)))


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


def fit_radius(pairs: PoseData, alpha: float = 0.1, *, scaled: bool = False, threads: int | None = None) -> RadiusMap:
    r"""Find the radius about the median that holds the truth of each joint in a share 1 - α of poses.

    .. math:: r_k = d_{(\lceil (n+1)(1-\alpha) \rceil)\,k}, \qquad
              d_{mk} = \lVert y_{mk} - \operatorname{median}_n x_{nmk} \rVert

    Parameters
    ----------
    pairs : PoseData
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
        at_least_two(pairs)
    radii = _radii(_distances(pairs, scaled=scaled, threads=threads), alpha)
    return RadiusMap(pairs.joints, radii, alpha, scaled, len(pairs.truth), sequences(pairs))


def held_out_coverage(
    pairs: PoseData, alpha: float = 0.1, *, scaled: bool = False, folds: int = 5, threads: int | None = None
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
