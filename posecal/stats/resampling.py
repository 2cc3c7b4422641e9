"""How sure is a number? Statements of uncertainty that take whole sequences as the units of chance.

Frames of a video resemble their neighbours, so a thousand frames may be worth twenty. Everything here resamples,
leaves out or flips whole sequences and needs nothing but their sums.

- A mean, or anything that is finished from means: the delete-one-sequence jackknife with Student's t.
- A calibration error, which is never negative and never 0 even for a perfect sampler: *sequence sign-flips*. Under
  calibration a sequence's summed deviation from the diagonal is as likely to be what it is as its opposite;
  multiplying sequences by random signs shows what a calibrated sampler would show on this data. From the same
  flips come the null ECE, a p-value and a band about the diagonal.

With fewer than six sequences no sign-flip test can reject at 5 %, and none is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from posecal.calibration.curve import joint_median
from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import FloatArray
from posecal.engine.metric import Deviation

__all__ = [
    "FEWEST",
    "Interval",
    "Null",
    "effective_poses",
    "holm",
    "jackknife",
    "paired_p",
    "sign_flips",
    "squared_error",
]

FEWEST = 6
"""Fewer sequences than this allow no test: of 2⁵ sign patterns two are as extreme as any, and 2/32 is above 5 %."""

DRAWS = 2000
"""Random sign patterns; with so few sequences that there are fewer patterns, all of them."""

Counts = npt.NDArray[np.integer] | FloatArray


@dataclass(frozen=True)
class Interval:
    """A 95 % interval of a number, over repetitions of the sequences.

    Attributes
    ----------
    low, high : float
        Its ends; NaN with fewer than two sequences.
    error : float
        Standard error.
    sequences : int
        How many there are.
    """

    low: float
    high: float
    error: float
    sequences: int


@dataclass(frozen=True)
class Null:
    """What a calibrated sampler would show on the same data.

    Attributes
    ----------
    observed : float
        The statistic.
    mean, high : float
        Its mean and 95 % quantile over sign patterns.
    p : float
        Share of patterns at which it is at least as large, the observed one included.
    band : float
        c of the simultaneous 95 % band q ± c √(q (1 - q)) about the diagonal.
    sequences : int
        How many there are.
    """

    observed: float
    mean: float
    high: float
    p: float
    band: float
    sequences: int


@cache
def _student(freedom: int) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975))


def jackknife(value: float, without: FloatArray) -> Interval:
    r"""Interval of a number from its values with each sequence left out.

    .. math:: \hat\theta \pm t_{S-1}\, \sqrt{\tfrac{S-1}{S} \sum_s (\hat\theta_{(s)} - \bar\theta_{(\cdot)})^2}

    Parameters
    ----------
    value : float
        The number over all sequences.
    without : array (S,)
        The number with each sequence left out.

    Returns
    -------
    Interval
        NaN ends with fewer than two sequences, or where the number is not defined without one of them.

    Notes
    -----
    For a ratio of sums this is the cluster-robust t interval. Differs from the published code: none; papers report
    spread over sampling seeds, which says nothing about other people or clips.

    References
    ----------
    Efron and Stein, Ann. Stat. 9, 586 (1981), doi:10.1214/aos/1176345462.

    Examples
    --------
    The mean of 1 and 3: left-out values 3 and 1, standard error 1, and t with one degree of freedom is 12.7.

    >>> found = jackknife(2.0, np.array([3.0, 1.0]))
    >>> round(found.error, 6), round(found.high, 3)
    (1.0, 14.706)
    """
    sequences = len(without)
    if sequences < 2 or np.isnan(value) or np.isnan(without).any():
        return Interval(np.nan, np.nan, np.nan, sequences)
    spread = ((without - without.mean()) ** 2).sum()
    error = float(np.sqrt((sequences - 1) / sequences * spread))
    reach = _student(sequences - 1) * error
    return Interval(value - reach, value + reach, error, sequences)


@cache
def _signs(sequences: int, draws: int, seed: int) -> npt.NDArray[np.float32]:
    """Sign patterns, (patterns, sequences); the first is the observed one. All of them where that is few."""
    if sequences < 2 or 2 ** (sequences - 1) <= draws:
        patterns = np.arange(2 ** max(sequences - 1, 0))  # a pattern and its opposite give the same size
        bits = patterns[:, None] >> np.arange(sequences) & 1
        return np.where(bits == 0, 1, -1).astype(np.float32)
    random = np.random.default_rng(seed)
    signs = random.integers(0, 2, (draws, sequences), dtype=np.int8) * 2 - 1
    signs[0] = 1
    return signs.astype(np.float32)


def judged_curves(deviation: Deviation, mean: FloatArray) -> FloatArray:
    """Curves whose distance from the diagonal counts, (P, R, Q), of mean deviations (P, J, Q)."""
    return joint_median(mean)[:, None] if deviation.over == "median" else mean


def error_of_curves(deviation: Deviation, curves: FloatArray) -> FloatArray:
    """Reduce the curves (P, R, Q) to the error, (P,)."""
    each = np.abs(curves).mean(axis=-1)
    return np.asarray(each.max(axis=-1) if deviation.over == "worst" else each.mean(axis=-1))


def sign_flips(
    deviations: FloatArray,
    counts: Counts,
    deviation: Deviation,
    *,
    offset: FloatArray | None = None,
    draws: int = DRAWS,
    seed: int = 0,
) -> Null:
    r"""Compare a calibration error with what a calibrated sampler would show on the same sequences.

    .. math:: T_b = T\Big( \big( \textstyle\sum_s \sigma_{bs} D_s(k, q) \big) / n_k \Big), \qquad
              D_s(k, q) = \sum_{m \in s} \big( W_{mk}(q) - \operatorname{E} W(q) \big)

    with random signs σ.

    Parameters
    ----------
    deviations : array (S, J, Q)
        D of each sequence, for J curves (joints, say), summed over its poses.
    counts : array (S, J)
        Poses of each sequence that count, or their weights. Curves without any are left out.
    deviation : Deviation
        What T is.
    offset : array (Q,), optional
        What a perfect sampler's curve is off by at this N, for definitions that are biased.
    draws : int
        Sign patterns.
    seed : int
        Of the generator.

    Returns
    -------
    Null
        With NaN p, quantile and band where there are fewer than :data:`FEWEST` sequences.

    Notes
    -----
    The band is the 95 % quantile of ``sup |ω(q) - q| / √(q (1 - q))`` over the levels and the judged curves, with fixed
    weights: estimated standard errors would inflate its level. Differs from the published code: none; ours.

    References
    ----------
    Canay, Romano and Shaikh, Econometrica 85, 1013 (2017), doi:10.3982/ECTA13081 (sign changes of clusters).

    Examples
    --------
    Six sequences that all deviate alike: only the all-plus pattern, of 32, is as extreme.

    >>> found = sign_flips(np.ones((6, 1, 21)), np.ones((6, 1), int), Deviation())
    >>> found.p
    0.03125
    """
    judged = slice(deviation.first, deviation.last)
    deviations, counts = _counting(deviations[:, judged], counts[:, judged])
    total = counts.sum(axis=0)
    D = deviations.astype(np.float32)
    sequences = len(D)
    if not sequences:
        return Null(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    signs = _signs(sequences, draws, seed)
    mean = (signs @ D.reshape(sequences, -1)).reshape(len(signs), *D.shape[1:]) / total[:, None].astype(np.float32)
    if offset is not None:
        mean += offset.astype(np.float32)
    curves = judged_curves(deviation, mean)
    found = error_of_curves(deviation, curves).astype(np.float64)
    if sequences < FEWEST:
        return Null(float(found[0]), np.nan, np.nan, np.nan, np.nan, sequences)
    inner = slice(1, LEVELS.size - 1)
    weights = np.sqrt(LEVELS[inner] * (1 - LEVELS[inner])).astype(np.float32)
    sup = np.abs(curves[..., inner] / weights).max(axis=(1, 2))
    return Null(
        observed=float(found[0]),
        mean=float(found.mean()),
        high=float(np.quantile(found, 0.95)),
        p=float((found >= found[0] * (1 - 1e-5)).mean()),
        band=float(np.quantile(sup, 0.95)),
        sequences=sequences,
    )


def _counting(deviations: FloatArray, counts: Counts) -> tuple[FloatArray, Counts]:
    """Leave out sequences and curves without a pose that counts."""
    kept, used = counts.any(axis=1), counts.any(axis=0)
    return deviations[kept][:, used], counts[kept][:, used]


def _variances(deviations: FloatArray, counts: Counts) -> tuple[FloatArray, FloatArray]:
    """Mean deviations (J, Q), and their variances over sequences."""
    S, total = len(deviations), counts.sum(axis=0)[:, None]
    mean = deviations.sum(axis=0) / total
    residual = deviations - counts[..., None] * mean
    return mean, S / (S - 1) * (residual**2).sum(axis=0) / total**2


def squared_error(deviations: FloatArray, counts: Counts) -> float:
    r"""Mean squared distance of the curves from the diagonal, without what chance adds to it.

    .. math:: \operatorname{mean}_{k,q} \big( (\omega_k(q) - q)^2 - \widehat{\operatorname{Var}}\, \omega_k(q) \big)

    Parameters
    ----------
    deviations, counts
        As for :func:`sign_flips`.

    Returns
    -------
    float
        About 0 for a calibrated model, on either side; NaN with fewer than two sequences.

    Notes
    -----
    Differs from the published code: none; ours.

    Examples
    --------
    >>> squared_error(np.full((4, 1, 21), 0.5), np.ones((4, 1), int))
    0.25
    """
    deviations, counts = _counting(deviations, counts)
    if len(deviations) < 2:
        return float("nan")
    mean, variance = _variances(deviations, counts)
    return float((mean**2 - variance).mean())


def effective_poses(deviations: FloatArray, counts: Counts) -> float:
    r"""Number of independent poses that would be worth as much as these, for a calibration curve.

    .. math:: \sum_{k,q} \omega_k(q) (1 - \omega_k(q)) \Big/ \sum_{k,q} \widehat{\operatorname{Var}}\, \omega_k(q)

    Parameters
    ----------
    deviations, counts
        As for :func:`sign_flips`.

    Returns
    -------
    float
        StoredPoses, at most as many as there are; NaN with fewer than two sequences.

    Notes
    -----
    Differs from the published code: none; ours.

    Examples
    --------
    Two sequences that deviate oppositely, whatever their number of frames, are worth about two poses.

    >>> deviations = np.stack([np.full((1, 21), 3.0), np.full((1, 21), -3.0)])
    >>> round(effective_poses(deviations, np.full((2, 1), 10)), 1)
    1.9
    """
    deviations, counts = _counting(deviations, counts)
    if len(deviations) < 2:
        return float("nan")
    mean, variance = _variances(deviations, counts)
    inner = slice(1, LEVELS.size - 1)
    coverage = np.clip(mean + LEVELS, 0, 1)[:, inner]
    chance = variance[:, inner].sum()
    poses = float(counts.sum(axis=0).max())
    return min(poses, float((coverage * (1 - coverage)).sum() / chance)) if chance > 0 else poses


def paired_p(difference: Interval) -> float:
    """Two-sided p-value of a difference, from its standard error over sequences; NaN with fewer than two."""
    from scipy.special import stdtr

    if np.isnan(difference.error):
        return float("nan")
    middle = (difference.low + difference.high) / 2
    if difference.error == 0:
        return 1.0 if middle == 0 else 0.0
    return float(2 * stdtr(difference.sequences - 1, -abs(middle) / difference.error))


def holm(p: Sequence[float]) -> list[float]:
    """Adjust p-values for their number, so that any false rejection among them stays at its level.

    Parameters
    ----------
    p : sequence of float
        p-values; NaN where there is no test.

    Returns
    -------
    list of float
        Adjusted p-values, in the same order.

    Notes
    -----
    Differs from the published code: none.

    References
    ----------
    Holm, Scand. J. Stat. 6, 65 (1979).

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    tested = [index for index, value in enumerate(p) if not np.isnan(value)]
    found, least = [float("nan")] * len(p), 0.0
    for place, index in enumerate(sorted(tested, key=lambda index: p[index])):
        least = max(least, min(1.0, (len(tested) - place) * p[index]))
        found[index] = least
    return found
