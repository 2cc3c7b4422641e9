"""What would a perfect sampler show here? The floor of each ECE at finite N and M.

Two things keep a perfect sampler's ECE above 0. At finite N the definitions ``paper`` and ``reference`` are
biased: their curve is not the diagonal even for M → ∞ (their bias is tabulated for three-dimensional isotropic
Gaussian joints). At finite M the curve scatters about its mean, whatever the definition.

Both are put together here by drawing what M independent frames of K independent joints would show. Real frames
and joints are not independent, so a real perfect sampler shows more than this.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from posecal.calibration.curve import CalibrationCurve
from posecal.calibration.error import OverJoints, ece
from posecal.calibration.ranks import LEVELS, Definition, known_definition, rank_weights
from posecal.data.arrays import FloatArray
from posecal.errors import PoseDataError

__all__ = ["Floor", "expected_curve", "perfect_sampler"]


@dataclass(frozen=True)
class Floor:
    """What a perfect sampler's ECE would be.

    Attributes
    ----------
    mean : float
        Expected ECE.
    high : float
        The 95 % quantile: a perfect sampler stays below it in 19 of 20 test sets.
    """

    mean: float
    high: float


@cache
def _table() -> dict[str, dict[int, FloatArray]]:
    text = files("posecal.calibration").joinpath("finite_n.json").read_text(encoding="utf-8")
    stored = json.loads(text)
    return {d: {int(n): np.array(row) for n, row in stored[d].items()} for d in ("paper", "reference")}


def expected_curve(n_hypotheses: int, definition: Definition = "exchangeable") -> FloatArray:
    """Calibration curve of a perfect sampler with N hypotheses, for M → ∞.

    Parameters
    ----------
    n_hypotheses : int
        N, at least 2.
    definition : str
        One of :data:`posecal.calibration.ranks.DEFINITIONS`.

    Returns
    -------
    array (Q,)
        E ω(q): the diagonal for ``exchangeable``.

    Raises
    ------
    PoseDataError
        For fewer than two hypotheses or an unknown definition.

    Notes
    -----
    ``paper`` and ``reference`` are read from a table for isotropic Gaussians in three dimensions, made by
    ``python -m toy rank-law`` in a checkout and interpolated in 1/N. Differs from the published code: none.

    Examples
    --------
    >>> expected_curve(7)[10].entry()
    0.5
    """
    known = known_definition(definition)
    if n_hypotheses < 2:
        raise PoseDataError(f"hypotheses: N = {n_hypotheses}; calibration needs at least 2.")
    if known == "exchangeable":
        return LEVELS.copy()
    if known == "reference":
        return LEVELS + _bias(n_hypotheses, "reference", LEVELS)
    allowed = np.arange(LEVELS.size) * n_hypotheses // (LEVELS.size - 1)
    rank = np.minimum((allowed + 1) / (n_hypotheses + 1), 1)
    return rank + np.where(rank < 1, _bias(n_hypotheses, "paper", rank), 0)


def _bias(n_hypotheses: int, definition: str, at: FloatArray) -> FloatArray:
    """Bias of the tabulated law at shares, where N times the bias is smooth in 1/N and in the share."""
    table = _table()[definition]

    def scaled(n: int) -> FloatArray:
        row = table[n]
        if definition == "paper":  # no bias where nothing or everything is inside
            row = np.concatenate([[0.0], row, [0.0]])
        return n * np.interp(at, np.linspace(0, 1, row.size), row)

    above = min((n for n in table if n >= n_hypotheses), default=max(table))
    below = max((n for n in table if n <= n_hypotheses), default=min(table))
    if above == below:
        return scaled(above) / n_hypotheses
    share = (1 / n_hypotheses - 1 / above) / (1 / below - 1 / above)
    return (share * scaled(below) + (1 - share) * scaled(above)) / n_hypotheses


@cache
def perfect_sampler(
    n_hypotheses: int,
    n_poses: int,
    n_joints: int,
    definition: Definition = "exchangeable",
    over: OverJoints = "median",
    *,
    draws: int = 200,
) -> Floor:
    """Draw the ECE that a perfect sampler would show on a test set of this size.

    Parameters
    ----------
    n_hypotheses, n_poses, n_joints : int
        N, M and K: hypotheses, poses that count, joints that count.
    definition : str
        One of :data:`posecal.calibration.ranks.DEFINITIONS`.
    over : str
        The summary over joints; see :func:`posecal.calibration.error.ece`.
    draws : int
        Test sets drawn, from a fixed seed.

    Returns
    -------
    Floor
        Mean and 95 % quantile of the ECE over the draws.

    Raises
    ------
    PoseDataError
        For fewer than two hypotheses, no pose or joint, or an unknown name.

    Notes
    -----
    Frames and joints are independent here; where they are correlated, as in video, the floor is higher.
    Differs from the published code: none; ours.

    Examples
    --------
    With 20 hypotheses the paper's definition is off by 0.018 however many poses there are.

    >>> round(perfect_sampler(20, 10**6, 16, "paper").mean, 3)
    0.018
    """
    known = known_definition(definition)
    mean = expected_curve(n_hypotheses, known)
    if n_poses < 1 or n_joints < 1:
        raise PoseDataError(f"poses: M = {n_poses}, K = {n_joints}; expected at least one of each.")
    if known == "exchangeable":
        chances = np.full(n_hypotheses + 1, 1 / (n_hypotheses + 1))
        weights = rank_weights(n_hypotheses, np.arange(n_hypotheses + 1))
    else:
        edges = np.concatenate([[0.0], np.maximum.accumulate(np.clip(mean, 0, 1)), [1.0]])
        chances = np.diff(edges)
        weights = np.tri(LEVELS.size + 1, LEVELS.size, -1)[::-1, ::-1]
    random = np.random.default_rng(0)
    counts = random.multinomial(n_poses, chances, size=(draws, n_joints))
    curves = counts @ weights / n_poses
    found = [ece(CalibrationCurve(known, curve, curve.mean(axis=0)), over) for curve in curves]
    return Floor(float(np.mean(found)), float(np.quantile(found, 0.95)))
