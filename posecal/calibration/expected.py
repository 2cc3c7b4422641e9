"""Finite-N floors: the ECE that a perfect sampler would show, for N hypotheses of M poses.

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

from posecal.calibration.curve import OVER_JOINTS, ece_over_joints
from posecal.calibration.ranks import DEFINITIONS, LEVELS, Definition, rank_weights
from posecal.data.arrays import FloatArray, checked_choice, checked_number
from posecal.engine.protocol import OverJoints

MAX_VALUES = 4_000_000
"""At most so many values of curves are drawn for a floor: 200 test sets of up to 952 joints."""


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
        For fewer than two hypotheses, or an unknown definition.

    Notes
    -----
    ``paper`` and ``reference`` are read from a table for isotropic Gaussians in three dimensions, made by
    ``python -m toy rank-law`` in a checkout and interpolated in 1/N. Differs from the published code: none.

    See Also
    --------
    posecal.perfect_sampler : Its ECE at finite M.

    Examples
    --------
    >>> expected_curve(7)[10].item()
    0.5
    """
    checked_choice(definition, "definition", DEFINITIONS)
    n = _whole(n_hypotheses, "n_hypotheses", 2)
    if definition == "exchangeable":
        return LEVELS.copy()
    if definition == "reference":
        return LEVELS + _bias(n, "reference", LEVELS)
    allowed = np.arange(LEVELS.size) * n // (LEVELS.size - 1)
    rank = (allowed + 1) / (n + 1)
    return rank + _bias(n, "paper", rank)


def _whole(value: object, name: str, least: int) -> int:
    """Check a whole number."""
    expected = f"a whole number of at least {least}"
    return int(checked_number(value, name, lambda number: number >= least and number.is_integer(), expected))


def _bias(n_hypotheses: int, definition: str, at: FloatArray) -> FloatArray:
    """Bias of the tabulated law at shares, where N times the bias is smooth in 1/N and in the share."""
    table = _table()[definition]

    def scaled(n: int) -> FloatArray:
        row = table[n]
        if definition == "paper":  # no bias where nothing or everything is inside
            row = np.concatenate([[0.0], row, [0.0]])
        return n * np.interp(at, np.linspace(0, 1, row.size), row)

    above = min((n for n in table if n >= n_hypotheses), default=max(table))
    below = max(n for n in table if n <= n_hypotheses)
    if above == below:
        return scaled(above) / n_hypotheses
    share = (1 / n_hypotheses - 1 / above) / (1 / below - 1 / above)
    return (share * scaled(below) + (1 - share) * scaled(above)) / n_hypotheses


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
        The summary over joints; see :func:`posecal.ece`.
    draws : int
        Test sets drawn, from a fixed seed; of thousands of joints fewer, but at least 20, since their summary varies
        little from one test set to another.

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

    See Also
    --------
    posecal.calibration.expected_curve : Its calibration curve for M → ∞.
    posecal.ece : The ECE of hypotheses.

    Examples
    --------
    With 20 hypotheses the paper's definition is off by 0.018 however many poses there are.

    >>> round(perfect_sampler(20, 10**6, 16, "paper").mean, 3)
    0.018
    """
    checked_choice(definition, "definition", DEFINITIONS)
    checked_choice(over, "over", OVER_JOINTS)
    sizes = ((n_hypotheses, "n_hypotheses", 2), (n_poses, "n_poses", 1), (n_joints, "n_joints", 1), (draws, "draws", 1))
    N, M, K, number = (_whole(*size) for size in sizes)
    return _floor(N, M, K, definition, over, number)


@cache
def _floor(N: int, M: int, K: int, definition: Definition, over: OverJoints, draws: int) -> Floor:
    mean = expected_curve(N, definition)
    if definition == "exchangeable":
        weights, ranks = np.unique(rank_weights(N, np.arange(N + 1)), axis=0, return_counts=True)  # alike at 21 levels
        chances = ranks / (N + 1)
    else:
        chances = np.diff(np.concatenate([[0.0], mean, [1.0]]))
        weights = np.tri(LEVELS.size + 1, LEVELS.size, -1)[::-1, ::-1]
    random = np.random.default_rng(0)
    draws = min(draws, max(20, MAX_VALUES // (K * LEVELS.size)))
    counts = random.multinomial(M, chances, size=(draws, K))
    curves = counts @ weights / M
    errors = ece_over_joints(np.concatenate([curves, curves.mean(axis=1, keepdims=True)], axis=1), over)
    return Floor(float(np.mean(errors)), float(np.quantile(errors, 0.95)))
