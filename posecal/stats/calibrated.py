"""Deviations that the sequences of a calibrated sampler would show, from those of any model on the same sequences."""

from __future__ import annotations

import math

import numpy as np

from posecal.calibration.ranks import LEVELS, rank_weights
from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.sums import Counts

FEWEST = 0.01
"""A level says how much frames depend on each other where ω (1 - ω) is at least this: truths lie on either side."""

FAR = 1.0
"""Levels further than this from any such level, in log odds, take the dependence of the standardized errors."""

NOISE = np.pi / 2 / (2 * 0.6744897501960817) ** 2
"""Mean square of what the median of N normal numbers is off by, times N, in units of their squared distance between
quartiles, the unit of standardized errors."""

SMALLEST_SHARE = 0.25
"""Of the mean squared standardized error, what is not noise of the median counts as at least this share."""

LEAST_SHARE = 0.1
"""Where it is less than this, how much frames depend on each other is not known: taken as :data:`SMALLEST_SHARE`, it
may make deviations 2.5 times too small."""

_INNER = slice(1, LEVELS.size - 1)


def calibrated_deviations(
    deviations: FloatArray,
    counts: Counts,
    offset: FloatArray | None = None,
    errors: FloatArray | None = None,
    n: float = np.inf,
) -> FloatArray:
    r"""Make a model calibrated by a monotone map of its ranks, and give what its sequences deviate by then.

    .. math:: D^*_s(k, q) = \sqrt{\frac{q (1 - q)}{\omega_k(q') (1 - \omega_k(q'))}} \;
              \frac{D_s(k, q') - n_{sk} \bar D_k(q')}{\sqrt{1 - \sum_s (n_{sk} / n_k)^2}}, \qquad \omega_k(q') = q

    Parameters
    ----------
    deviations : array (S, J, Q)
        D of each sequence, summed over its poses.
    counts : array (S, J)
        Poses of each sequence that count, or their weights; each curve has some.
    offset : array (Q,), optional
        What a perfect sampler's curve is off by; its curve then takes the place of q.
    errors : array (S, J, 3) or (S, K, 3), optional
        Sums of :func:`posecal.calibration.standardized.standardized_errors`, of each curve, or of the K joints of poses
        that all curves are about.
    n : float
        N, the mean effective number of hypotheses.

    Returns
    -------
    array (S, J, Q)
        Sums, as the deviations; with random signs of sequences their mean has the mean 0, and the variance that a
        calibrated sampler's curve would have. NaN at levels where nothing tells that variance.

    Notes
    -----
    Between two of the levels, standardized deviations are interpolated, with the correlation √(odds ratio) that a
    Brownian bridge has between them. Where the truths lie nearly all inside the smallest ball, or outside the largest,
    the ranks don't say how much frames depend on each other; the logarithms of the standardized errors do, and a
    factor of the spread leaves their differences as they are. Without those, frames count as independent there. Of few
    hypotheses that are much too wide, errors are those of their median; where less than :data:`LEAST_SHARE` of the mean
    squared one is not, they don't say either.
    Ranks say something at levels from 1/(N + 1) to N/(N + 1) alone: beyond, the weight of a truth outside all balls
    rises from 0 to 1 whatever the truth. There a calibrated sampler's W vary by less than q (1 - q), by as much as
    those of uniform ranks.
    Differs from the published code: none; ours.

    Examples
    --------
    One truth in two lies inside each ball of one sequence, and none inside those of the other: ω = 1/4 throughout.
    At q = 1/4 the sequences deviate by a quarter of their 40 poses, times √2 as there are two.

    >>> inside = np.stack([np.full((1, 21), 20.0), np.zeros((1, 21))])
    >>> found = calibrated_deviations(inside - 40 * LEVELS, np.full((2, 1), 40))
    >>> found[:, 0, 5].round(2)
    array([ 14.14, -14.14])
    """
    total = counts.sum(axis=0)  # (J,)
    lost = 1 - ((counts / total) ** 2).sum(axis=0)
    scale = 1 / np.sqrt(np.where(lost > 0, lost, 1))
    mean = deviations.sum(axis=0) / total[:, None]
    expected = LEVELS if offset is None else LEVELS + offset
    omega = np.clip(expected + mean, 0, 1)
    spread = np.sqrt(omega * (1 - omega))
    known = spread**2 >= FEWEST
    known[:, (1 / (n + 1) - 1e-9 > LEVELS) | (n / (n + 1) + 1e-9 < LEVELS)] = False
    known[:, [0, -1]] = False
    standardized = (deviations - counts[..., None] * mean) * np.divide(
        scale[:, None], spread, out=np.zeros_like(spread), where=known
    )
    odds, wanted = _log_odds(omega), _log_odds(expected)[_INNER]
    first, last = known.argmax(axis=1)[:, None], LEVELS.size - 1 - known[:, ::-1].argmax(axis=1)[:, None]
    below = (odds[:, :, None] <= wanted).sum(axis=1) - 1  # (J, Q - 2); odds rise with the level
    low, high = np.clip(below, first, last), np.clip(below + 1, first, last)
    from_odds, to_odds = np.take_along_axis(odds, low, 1), np.take_along_axis(odds, high, 1)
    gap = to_odds - from_odds
    share = np.clip(np.divide(wanted - from_odds, gap, out=np.zeros_like(gap), where=gap > 0), 0, 1)
    length = np.sqrt(share**2 + (1 - share) ** 2 + 2 * share * (1 - share) * np.exp(-gap / 2))
    taken = np.take_along_axis(standardized, low[None], 2) * ((1 - share) / length)
    taken += np.take_along_axis(standardized, high[None], 2) * (share / length)
    apart = np.maximum(from_odds - wanted, wanted - to_odds) > (np.inf if errors is None else FAR)
    apart |= ~known.any(axis=1, keepdims=True)
    if apart.any():
        of_errors = (_of_errors(counts, errors, n) * scale)[..., None] * _share_of_chance(n)[_INNER]
        taken = np.where(apart, of_errors, taken)
    result = np.zeros(deviations.shape)
    result[..., _INNER] = taken * np.sqrt((expected * (1 - expected)).clip(0))[_INNER]
    return result


def _log_odds(shares: FloatArray) -> FloatArray:
    shares = np.clip(shares, 1e-9, 1 - 1e-9)
    return np.asarray(np.log(shares / (1 - shares)))


def _share_of_chance(n: float) -> FloatArray:
    """Standard deviation of W of uniform ranks among n hypotheses over √(q (1 - q)), (Q,)."""
    if n > 100:
        return np.ones(LEVELS.size)
    number = max(round(n), 1)
    deviations = rank_weights(number, np.arange(number + 1)).std(axis=0)
    return np.asarray(deviations / np.sqrt(np.maximum(LEVELS * (1 - LEVELS), 1e-9)))


def _of_errors(counts: Counts, errors: FloatArray | None, n: float) -> FloatArray:
    """Give what a curve of unit variance per pose would deviate by in each sequence, (S, J)."""
    independent = np.sqrt(counts)
    if errors is None:
        return independent
    number, logs, squares = np.moveaxis(errors, -1, 0)
    total = np.maximum(number.sum(axis=0), 1)
    mean = logs.sum(axis=0) / total
    variance = squares.sum(axis=0) / total - mean**2
    is_known = variance > 1e-6
    deviations = (logs - number * mean) / np.sqrt(np.where(is_known, variance, 1))
    if not is_known.any():
        return independent
    deviations *= _without_noise(deviations, number, np.exp(2 * mean + 1.5 * variance), is_known, n)
    if number.shape == counts.shape:
        return np.where(is_known, deviations, independent)
    size = np.sqrt((deviations[:, is_known] ** 2).sum(axis=0).mean() / total[is_known].mean())
    together = deviations[:, is_known].sum(axis=1)
    together /= max(np.sqrt((together**2).sum()), 1e-300)
    return np.asarray(together[:, None] * (size * np.sqrt(counts.sum(axis=0))))


def _without_noise(
    deviations: FloatArray, number: FloatArray, squares: FloatArray, is_known: BoolArray, n: float
) -> float:
    r"""Give the factor by which the noise of the median of n hypotheses makes deviations of sequences too small.

    .. math:: \sqrt{\frac{1 + (e - 1) / r^2}{e}}

    Noise is independent from frame to frame. A share r of the mean ``squares`` that is none makes the squared errors
    of two frames correlate by r² of what they would, and so the design effect e of a sequence's frames exceed 1 by r²
    as much. NaN where r is below :data:`LEAST_SHARE`.
    """
    share = 1 - NOISE / n / squares[is_known].mean()
    if share < LEAST_SHARE:
        return math.nan
    share = max(share, SMALLEST_SHARE)
    total = number.sum(axis=0)
    lost = 1 - (number**2).sum(axis=0) / np.maximum(total, 1) ** 2
    effects = (deviations**2).sum(axis=0)[is_known] / np.maximum(total * lost, 1e-300)[is_known]
    effect = max(float(effects.mean()), 1.0)
    return float(np.sqrt((1 + (effect - 1) / share**2) / effect))
