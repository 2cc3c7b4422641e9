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

from posecal.calibration.curve import OVER_JOINTS, joint_ece, joint_median
from posecal.calibration.ranks import DEFINITIONS, LEVELS, Definition, rank_weights
from posecal.data.arrays import FloatArray, checked_choice, checked_number
from posecal.engine.protocol import OverJoints

MAX_VALUES = 500_000
"""At most so many values of curves are drawn for a floor: 5000 test sets of up to 4 joints, 1488 of 16."""

FEWEST_DRAWS = 20
"""Test sets that are drawn however many joints there are: their summary varies little from one to another."""

FEW_POSES = 50
"""Of fewer poses each one's rank is drawn; curves of more are normal, but for 2 % of the floor."""

MANY_JOINTS = 50
"""The median curve of more joints than this is normal, but for 1 % of the floor."""


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
    draws: int = 5000,
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
        Test sets drawn, from a fixed seed; fewer where several joints make ``MAX_VALUES`` values, at least
        ``FEWEST_DRAWS``.

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
    Frames and joints are independent here; where they are correlated, as in video, the floor is higher. The mean is
    exact to 2 %, and the quantile to 4 %.
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
    weights, chances = _law(N, definition)
    if M < FEW_POSES:
        draws = min(draws, max(FEWEST_DRAWS, MAX_VALUES // (K * LEVELS.size)))
        curves = _drawn(weights, chances, M, (draws, K))
        if over == "pooled":
            curves = curves.mean(axis=1, keepdims=True)
    else:
        mean, covariance = chances @ weights, np.cov(weights.T, aweights=chances, ddof=0)
        covariance, K = _of_summary(covariance, K, over)
        draws = min(draws, max(FEWEST_DRAWS, MAX_VALUES // (K * LEVELS.size)))
        curves = _normal(mean, covariance / M, (draws, K))
    if over == "median":
        curves = joint_median(curves)[:, None]
    errors = np.abs(curves - LEVELS).mean(axis=-1)
    errors = errors.max(axis=-1) if over == "worst" else errors.mean(axis=-1)
    return Floor(float(np.mean(errors)), float(np.quantile(errors, 0.95)))


def _law(N: int, definition: Definition) -> tuple[FloatArray, FloatArray]:
    """Weights (C, Q) of a perfect sampler's truth of each class of ranks, and the chances of these classes, (C,)."""
    if definition == "exchangeable":
        weights, ranks = np.unique(rank_weights(N, np.arange(N + 1)), axis=0, return_counts=True)  # alike at 21 levels
        return weights, ranks / (N + 1)
    chances = np.diff(np.concatenate([[0.0], expected_curve(N, definition), [1.0]]))
    return np.tri(LEVELS.size + 1, LEVELS.size, -1)[::-1, ::-1], chances


def _drawn(weights: FloatArray, chances: FloatArray, M: int, shape: tuple[int, int]) -> FloatArray:
    """Draw the curves, (draws, K, Q), of M poses."""
    random, ends = np.random.default_rng(0), np.cumsum(chances[:-1])
    weights = weights.astype(np.float32)
    curves = np.zeros((*shape, LEVELS.size), dtype=np.float32)
    for _ in range(M):
        curves += weights[np.searchsorted(ends, random.random(shape), side="right")]
    return curves / M


def _of_summary(covariance: FloatArray, K: int, over: OverJoints) -> tuple[FloatArray, int]:
    r"""Covariance of the curves that a summary is made of, and their number.

    The pooled curve is one. So is the median of many normal curves, of covariance
    :math:`\sigma_i \sigma_j \arcsin(\rho_{ij}) / (K + \pi/2 - 1)`.
    """
    if over == "pooled":
        return covariance / K, 1
    if over != "median" or K <= MANY_JOINTS:
        return covariance, K
    deviations = np.sqrt(np.diag(covariance).clip(0))
    product = np.outer(deviations, deviations)
    correlation = np.divide(covariance, product, out=np.zeros_like(product), where=product > 0)
    return product * np.arcsin(correlation.clip(-1, 1)) / (K + np.pi / 2 - 1), 1


def _normal(mean: FloatArray, covariance: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Draw normal curves, (draws, K, Q)."""
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(values.clip(0))).T.astype(np.float32)
    curves = np.random.default_rng(0).standard_normal((*shape, LEVELS.size), dtype=np.float32) @ root
    return np.asarray(curves + mean.astype(np.float32))


def ece_range(n_hypotheses: int, definition: Definition = "exchangeable") -> tuple[float, float]:
    """Give the smallest and the largest ECE that N hypotheses can have, of whatever number of poses.

    Parameters
    ----------
    n_hypotheses : int
        N, at least 2.
    definition : str
        One of :data:`posecal.calibration.ranks.DEFINITIONS`.

    Returns
    -------
    low, high : float
        Where the shares of the ranks are such that the curve is as near to the diagonal as its steps allow, and where
        all truths have one rank.

    Raises
    ------
    PoseDataError
        For fewer than two hypotheses, or an unknown definition.

    See Also
    --------
    posecal.perfect_sampler : The ECE of a perfect sampler.

    Examples
    --------
    >>> [round(ece, 3) for ece in ece_range(5)], [round(ece, 3) for ece in ece_range(5, "paper")]
    ([0.0, 0.395], [0.048, 0.5])
    """
    checked_choice(definition, "definition", DEFINITIONS)
    N = _whole(n_hypotheses, "n_hypotheses", 2)
    weights = rank_weights(N, np.arange(N + 1)) if definition == "exchangeable" else np.eye(2)[:, [0] * LEVELS.size]
    high = float(joint_ece(weights).max())
    if definition != "paper":
        return 0.0, high
    steps = np.arange(LEVELS.size) * N // (LEVELS.size - 1)  # ω is one number where this is
    least = [np.abs(LEVELS[steps == step] - np.median(LEVELS[steps == step])).sum() for step in np.unique(steps)[:-1]]
    return float(sum(least)) / LEVELS.size, high
