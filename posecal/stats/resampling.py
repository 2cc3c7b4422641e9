"""Tests of calibration errors by random signs of entire sequences.

Frames of a video resemble their neighbours, so a thousand frames may say as much as twenty independent ones.
Everything here flips entire sequences and needs nothing but their sums.

A calibration error is never negative, and never 0 even for a perfect sampler. Under calibration a sequence's summed
deviation from the diagonal is as likely to be what it is as its opposite: multiplying sequences by random signs gives a
p-value. These deviations grow with the model's error, so what a calibrated sampler would show (the null ECE and a band
about the diagonal) comes from flips of the deviations that are left when the model is made calibrated
(:mod:`posecal.stats.calibrated`). With fewer than six sequences no such test can reject at 5 %, and none is made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import FloatArray
from posecal.engine.metric import Deviation
from posecal.engine.sums import Counts, split_by
from posecal.engine.threads import run_in_order
from posecal.stats.calibrated import calibrated_deviations

MIN_SEQUENCES = 6
"""Fewer sequences than this allow no test: of 2⁵ sign patterns two are as extreme as any, and 2/32 is above 5 %."""

LEVEL = 0.05
"""p-values below this are called significant."""

STRONG = 0.01
"""What is said without reserve is shown at this level: of several tests of one report some falls below 0.05 by chance
much more often than in one report of twenty."""

DRAWS = 2000
"""Random sign patterns; with so few sequences that there are fewer patterns, all of them."""

NULL_DRAWS = 500
"""As many of them for what a calibrated sampler would show, of which no small p-value is asked."""

MIN_DRAWS = 199
"""For meshes of many thousand joints there are fewer random patterns, but at least so many."""

MAX_VALUES = 2_200_000
"""There are fewer than :data:`DRAWS` random patterns where patterns × curves × levels would be more than this."""

CHUNK = 2_500_000
"""So many mean deviations are held at a time."""

MESH = 400
"""Of more curves than this, so many evenly spaced ones are tested together."""

MAX_CURVES = 4096
"""So many curves are tested at a time."""

ROUNDING = 1e-9
"""Deviations from calibration of less than this a pose are rounding, and none."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class Null:
    """A calibration error, what a calibrated sampler would show on the same data, and a test.

    Attributes
    ----------
    observed : float
        The statistic.
    mean, high : float
        The mean and 95 % quantile of a calibrated sampler's; NaN, like the band, where they can't be known.
    p : float
        Share of sign patterns of the model's own deviations at which it is at least as large, the observed one
        included.
    band : float
        c of the simultaneous 95 % band q ± c √(q (1 - q)) about the diagonal, in which a calibrated sampler's curve
        would stay.
    sequences : int
        How many there are.
    """

    observed: float
    mean: float
    high: float
    p: float
    band: float
    sequences: int


# --- sign-flips ---------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def _signs(sequences: int, draws: int, seed: int) -> npt.NDArray[np.int8]:
    """Sign patterns, (patterns, sequences); the first is the observed one. All of them where that is few."""
    if sequences < 2 or 2 ** (sequences - 1) <= draws:
        patterns = np.arange(2 ** max(sequences - 1, 0))  # a pattern and its opposite give the same size
        bits = patterns[:, None] >> np.arange(sequences) & 1
        return np.where(bits == 0, 1, -1).astype(np.int8)
    random = np.random.default_rng(seed)
    signs = random.integers(0, 2, (draws, sequences), dtype=np.int8) * 2 - 1
    signs[0] = 1
    return signs


def n_draws(draws: int, values: int) -> int:
    """How many random patterns to draw where each gives so many values."""
    return min(draws, max(MIN_DRAWS, MAX_VALUES // max(1, values)))


def n_patterns(sequences: int, values: int, draws: int = DRAWS) -> int:
    """How many sign patterns a test of so many sequences has, where each gives so many values."""
    return min(1 << min(max(sequences - 1, 0), 60), n_draws(draws, values))


def thin(counts: Counts) -> npt.NDArray[np.intp]:
    """Choose curves, of (S, J) counts: those that count, at most :data:`MESH` of them, evenly spaced."""
    used = np.flatnonzero(counts.any(axis=0))
    return used if len(used) <= MESH else used[np.linspace(0, len(used) - 1, MESH).astype(int)]


def counting(deviations: FloatArray, counts: Counts) -> tuple[FloatArray, Counts]:
    """Leave out sequences and curves without a pose that counts."""
    rows, columns = counts.any(axis=1), counts.any(axis=0)
    if rows.all() and columns.all():
        return deviations, counts
    return deviations[rows][:, columns], counts[rows][:, columns]


def without_rounding(deviations: FloatArray, counts: Counts) -> FloatArray:
    """Set deviations (S, J, Q) of less than :data:`ROUNDING` a pose to 0: sums of ties end beside the diagonal."""
    return np.asarray(np.where(np.abs(deviations) <= ROUNDING * counts[..., None], 0, deviations))


def _reduce_flips(
    reduce: Callable[[FloatArray], Result],
    deviations: FloatArray,
    counts: Counts,
    signs: npt.NDArray[np.int8],
    offset: FloatArray | None,
) -> list[Result]:
    """Reduce the mean deviations (patterns, Q, J) at sign patterns, some patterns at a time.

    Each sequence's part is rounded to a multiple of a power of two so large that sums of them fit a float32 as they
    are: however many threads and whichever order a matrix product takes, the sum is the same.
    """
    S, J, Q = deviations.shape
    parts = (deviations / counts.sum(axis=0)[:, None]).swapaxes(1, 2).reshape(S, Q * J)
    exponents = np.frexp(np.abs(parts).sum(axis=0))[1] - np.finfo(np.float32).nmant
    parts = np.ldexp(np.rint(np.ldexp(parts, -exponents)), exponents).astype(np.float32)
    added = None if offset is None else offset.astype(np.float32)[:, None]

    def reduce_some(signs: npt.NDArray[np.int8]) -> Result:
        mean = (signs.astype(np.float32) @ parts).reshape(-1, Q, J)
        if added is not None:
            mean += added
        return reduce(mean)

    step = max(1, CHUNK // parts.shape[1])
    tasks = (partial(reduce_some, signs[at : at + step]) for at in range(0, len(signs), step))
    return list(run_in_order(tasks, None if len(signs) > step else 1))


def _median(curves: FloatArray) -> FloatArray:
    """Median over the J curves (patterns, Q, J), which are sorted in place."""
    J = curves.shape[-1]
    curves.sort(axis=-1)
    return np.asarray(curves[..., J // 2] if J % 2 else (curves[..., J // 2 - 1] + curves[..., J // 2]) / 2)


def sign_flips(
    deviations: FloatArray,
    counts: Counts,
    deviation: Deviation,
    *,
    offset: FloatArray | None = None,
    errors: FloatArray | None = None,
    n: float = np.inf,
    slack: float = 0.0,
    draws: int = DRAWS,
    seed: int = 0,
) -> Null:
    r"""Compare a calibration error with what a calibrated sampler would show on the same sequences.

    .. math:: T_b = T\Big( \big( \textstyle\sum_s \sigma_{bs} D_s(k, q) \big) / n_k \Big), \qquad
              D_s(k, q) = \sum_{m \in s} \big( W_{mk}(q) - \operatorname{E} W(q) \big)

    with random signs σ, for the p-value. The mean, the 95 % quantile and the band are over random signs of what these
    deviations would be, were the model calibrated: :func:`posecal.stats.calibrated.calibrated_deviations`.

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
    errors : array (S, J, 3) or (S, K, 3), optional
        Sums of standardized errors, of these curves or of the joints that they are all about.
    n : float
        N, the mean effective number of hypotheses.
    slack : float
        By so much a calibrated model's error may be larger than by chance: p is that of the error less this.
    draws : int
        Sign patterns. Where 2\ :sup:`S - 1` is no more, all of them are tried. For more than some 52 curves there are
        fewer: as many as give :data:`MAX_VALUES` mean deviations, and at least :data:`MIN_DRAWS`.
    seed : int
        Of the generator.

    Returns
    -------
    Null
        With NaN p, mean, quantile and band where there are fewer than :data:`MIN_SEQUENCES` sequences; with NaN mean,
        quantile and band where nothing tells how much frames depend on each other.

    Notes
    -----
    Of more than :data:`MESH` curves (the vertices of a mesh), so many evenly spaced ones are tested: the level is as
    exact, and ``observed`` is the error of those.

    A deviation of less than :data:`ROUNDING` a pose is none. The 95 % quantile is not below an error that the test does
    not reject, nor above one that it does: for errors near it the two ways of flipping differ a little.

    The band is the 95 % quantile of ``sup |ω(q) - q| / √(q (1 - q))`` over the levels and the judged curves, with fixed
    weights: estimated standard errors would inflate its level. Differs from the published code: none; ours.

    References
    ----------
    Canay, Romano and Shaikh, Econometrica 85, 1013 (2017), doi:10.3982/ECTA13081 (sign changes of clusters).

    Examples
    --------
    Six sequences that all deviate alike: only the all-plus pattern, of 32, is as extreme.

    >>> null = sign_flips(np.ones((6, 1, 21)), np.ones((6, 1), int), Deviation())
    >>> null.p
    0.03125
    """
    judged = slice(deviation.first, deviation.last)
    D, counts = deviations[:, judged], counts[:, judged]
    rows, columns = np.flatnonzero(counts.any(axis=1)), thin(counts)
    if errors is not None:
        errors = (errors[:, columns] if errors.shape[:2] == counts.shape else errors)[rows]
    D, counts = D[rows][:, columns], counts[rows][:, columns]
    D = without_rounding(D, counts)
    sequences = len(D)
    if not sequences:
        return Null(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    inner = slice(1, LEVELS.size - 1)
    weights = np.sqrt(LEVELS[inner] * (1 - LEVELS[inner])).astype(np.float32)

    def distances_of(mean: FloatArray) -> FloatArray:
        curves = _median(mean)[..., None] if deviation.over == "median" else mean
        return np.abs(curves, out=curves)

    def error_of(distances: FloatArray) -> FloatArray:
        each = distances.mean(axis=1)
        return np.asarray(each.max(axis=-1) if deviation.over == "worst" else each.mean(axis=-1))

    def error_and_sup(mean: FloatArray) -> FloatArray:
        distances = distances_of(mean)
        return np.stack([error_of(distances), (distances.max(axis=-1)[:, inner] / weights).max(axis=-1)])

    signs = _signs(sequences, n_draws(draws, D[0].size), seed)
    tested = sequences >= MIN_SEQUENCES
    parts = _reduce_flips(lambda m: error_of(distances_of(m)), D, counts, signs if tested else signs[:1], offset)
    own = np.concatenate(parts).astype(np.float64)
    if not tested:
        return Null(float(own[0]), np.nan, np.nan, np.nan, np.nan, sequences)
    signs = _signs(sequences, n_draws(min(draws, NULL_DRAWS), D[0].size), seed)
    calibrated = calibrated_deviations(D, counts, offset, errors, n)
    observed, p = float(own[0]), float(_share_as_large(own, slack))
    if np.isnan(calibrated).any():
        return Null(observed, np.nan, np.nan, p, np.nan, sequences)
    null, sup = np.concatenate(_reduce_flips(error_and_sup, calibrated, counts, signs, offset), axis=1)
    high = float(np.quantile(null, 0.95))
    return Null(
        observed=observed,
        mean=float(null.mean(dtype=np.float64)),
        high=slack + (max if p >= LEVEL else min)(high, observed - slack),  # it never contradicts p
        p=p,
        band=float(np.quantile(sup, 0.95)),
        sequences=sequences,
    )


def sign_flips_of_each(
    deviations: FloatArray,
    counts: Counts,
    *,
    offset: FloatArray | None = None,
    slack: float = 0.0,
    draws: int = DRAWS,
    seed: int = 0,
) -> FloatArray:
    """Give the p-value of each curve's own calibration error, as :func:`sign_flips` of it alone has it.

    Parameters
    ----------
    deviations, counts, offset, slack, draws, seed
        As for :func:`sign_flips`; curves over the same sequences share their sign patterns.

    Returns
    -------
    array (J,)
        p-values; NaN for curves that count in fewer than :data:`MIN_SEQUENCES` sequences.
    """
    p, deviations = np.full(counts.shape[1], np.nan), without_rounding(deviations, counts)
    most = n_draws(draws, max(1, deviations[:1].size))
    sets, of_curve = np.unique(counts > 0, axis=1, return_inverse=True)
    for used, members in zip(sets.T, split_by(of_curve.ravel(), sets.shape[1]), strict=True):
        if used.sum() < MIN_SEQUENCES:
            continue
        signs = _signs(int(used.sum()), most, seed)
        for curves in np.split(members, range(MAX_CURVES, len(members), MAX_CURVES)):
            some = np.ix_(used, curves)
            errors = _reduce_flips(_error_of_each, deviations[some], counts[some], signs, offset)
            p[curves] = _share_as_large(np.concatenate(errors), slack)
    return p


def _error_of_each(mean: FloatArray) -> FloatArray:
    return np.asarray(np.abs(mean, out=mean).mean(axis=1))


def _share_as_large(errors: FloatArray, slack: float) -> FloatArray:
    """Share of sign patterns (patterns, …) at which an error is as large as the first less the slack, but for rounding.

    The first, observed one included.
    """
    return np.asarray((errors >= errors[0] * (1 - 1e-5) - ROUNDING - slack).mean(axis=0))


# --- p-values -----------------------------------------------------------------------------------------------------


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
    values = np.asarray(p, dtype=np.float64)
    order = np.argsort(values)  # NaN last
    steps = np.maximum((~np.isnan(values)).sum() - np.arange(len(values)), 1) * values[order]
    adjusted = np.empty(len(values))
    adjusted[order] = np.maximum.accumulate(np.minimum(steps, 1.0))
    return adjusted.tolist()
