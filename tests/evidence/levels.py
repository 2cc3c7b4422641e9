"""Rejection rates of calibration tests on perfect samplers whose frames resemble their neighbours.

Ranks of the truth are simulated directly. Each joint's is uniform and follows an AR(1) process from frame to frame
(a Gaussian copula); the joints of a frame share a common factor. A spread that is wrong by a factor moves the ranks
as it moves those of isotropic Gaussians in three dimensions. What is judged is posecal's own
:func:`posecal.stats.resampling.sign_flips`, on sums over sequences, and the usual tests beside it,
which treat all frames as independent.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import numpy.typing as npt
from scipy import signal, special, stats

from posecal.calibration import LEVELS
from posecal.engine.metric import Deviation
from posecal.stats.resampling import sign_flips
from tests.evidence import Table

Floats = npt.NDArray[np.floating]
Ranks = npt.NDArray[np.intp]

SUMMARIES = {
    "sign-flips, ECE (median over joints)": Deviation(over="median"),
    "sign-flips, mean of the joints' ECEs": Deviation(over="mean"),
    "sign-flips, worst joint": Deviation(over="worst"),
}
BAND = "simultaneous band about the diagonal"
NOMINAL = 0.05


@dataclass(frozen=True)
class Design:
    """What is simulated.

    Attributes
    ----------
    sequences, frames : int
        S sequences of F frames.
    joints, hypotheses : int
        K and N.
    frame_correlation : float
        Of the underlying Gaussian process between consecutive frames.
    joint_correlation : float
        Of that process between two joints of a frame.
    spread : float
        The model's spread over the right one.
    """

    sequences: int
    frames: int
    joints: int = 16
    hypotheses: int = 100
    frame_correlation: float = 0.95
    joint_correlation: float = 0.3
    spread: float = 1.0


DESIGNS = (Design(20, 100), Design(100, 20), Design(240, 50))


def ranks(design: Design, random: np.random.Generator) -> Ranks:
    """Draw the rank of the truth among its hypotheses, 0 … N, for every sequence, joint and frame, (S, K, F)."""
    shape = design.sequences, design.joints + 1, design.frames
    noise = random.standard_normal(shape)
    keep = design.frame_correlation
    noise[..., 1:] *= math.sqrt(1 - keep**2)
    process = signal.lfilter([1.0], [1.0, -keep], noise, axis=-1)
    common, own = process[:, :1], process[:, 1:]
    shared = design.joint_correlation
    normal = math.sqrt(shared) * common + math.sqrt(1 - shared) * own
    return np.searchsorted(_rank_edges(design.hypotheses, design.spread), normal, side="right")


@cache
def _rank_edges(hypotheses: int, spread: float) -> Floats:
    """Where a standard normal passes from one rank of the truth to the next, (N,), by the chi-square law of radii."""
    share = np.arange(1, hypotheses + 1) / (hypotheses + 1)
    return np.asarray(special.ndtri(special.gammainc(1.5, spread**2 * special.gammaincinv(1.5, share))))


@cache
def _deviation_of_ranks(hypotheses: int) -> Floats:
    """W(q) - q of each rank, (N + 1, Q)."""
    return np.clip(LEVELS * (hypotheses + 1) - np.arange(hypotheses + 1)[:, None], 0, 1) - LEVELS


def deviations(of_truth: Ranks, hypotheses: int) -> Floats:
    """Sums over the frames of each sequence of W(q) - q, (S, K, Q)."""
    S, K, _ = of_truth.shape
    row = (np.arange(S * K).reshape(S, K, 1) * (hypotheses + 1) + of_truth).ravel()
    table = np.bincount(row, minlength=S * K * (hypotheses + 1)).reshape(S * K, -1)
    return (table @ _deviation_of_ranks(hypotheses)).reshape(S, K, -1)


# --- tests that treat frames as independent ------------------------------------------------------------------------


@cache
def _envelope(draws: int, seed: int = 0, times: int = 4000) -> float:
    """Pointwise level at which the binomial envelopes at the 19 inner levels hold 95 % of uniform samples at once."""
    counts = np.random.default_rng(seed).multinomial(draws, np.diff(LEVELS), times)
    return float(np.quantile(_smallest_tail(np.cumsum(counts, axis=1)[:, :-1], draws), NOMINAL))


def _smallest_tail(below: npt.NDArray[np.integer], draws: int) -> Floats:
    """Smallest two-sided binomial tail of the numbers of ranks below each inner level, (..., 19) to (...)."""
    q = LEVELS[1:-1]
    tail = np.minimum(special.bdtr(below, draws, q), special.bdtrc(below - 1.0, draws, q))
    return np.asarray(2 * tail.min(axis=-1))


def independent_tests(uniform: Floats) -> dict[str, bool]:
    """Whether each of the usual tests rejects that these shares (M,) are independent and uniform."""
    draws = len(uniform)
    counts = np.histogram(uniform, LEVELS)[0]
    return {
        "Kolmogorov–Smirnov": bool(stats.kstest(uniform, "uniform", method="asymp").pvalue < NOMINAL),
        "simultaneous ECDF envelope": bool(_smallest_tail(np.cumsum(counts)[:-1], draws) < _envelope(draws)),
        "χ², 20 bins": bool(stats.chisquare(counts).pvalue < NOMINAL),
    }


# --- counting rejections ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rates:
    """Shares of replicates that each test rejects.

    Attributes
    ----------
    rejected : dict of int
        Replicates that were rejected, by test.
    replicates : int
        Out of how many.
    """

    rejected: dict[str, int]
    replicates: int


def interval(rejected: int, replicates: int) -> tuple[float, float]:
    """Wilson's 95 % Monte-Carlo interval of a rejection rate."""
    ends = stats.binomtest(rejected, replicates).proportion_ci(method="wilson")
    return float(ends.low), float(ends.high)


def rejection_rates(
    design: Design, replicates: int, seed: int = 0, *, independent: bool = True, draws: int = 2000
) -> Rates:
    """Simulate and count.

    Parameters
    ----------
    design : Design
        What is simulated.
    replicates : int
        How often.
    seed : int
        Of the generator.
    independent : bool
        Whether the tests that treat frames as independent are counted too.
    draws : int
        Sign patterns.
    """
    random = np.random.default_rng(seed)
    rejected: dict[str, int] = {}
    counts = np.full((design.sequences, design.joints), design.frames)
    for _ in range(replicates):
        drawn = ranks(design, random)
        for name, yes in _judge(design, drawn, counts, random, independent=independent, draws=draws):
            rejected[name] = rejected.get(name, 0) + yes
    return Rates(rejected, replicates)


def _judge(
    design: Design,
    drawn: Ranks,
    counts: npt.NDArray[np.int64],
    random: np.random.Generator,
    *,
    independent: bool,
    draws: int,
) -> Iterator[tuple[str, bool]]:
    D = deviations(drawn, design.hypotheses)
    for name, deviation in SUMMARIES.items():
        null = sign_flips(D, counts, deviation, draws=draws)
        yield name, null.p <= NOMINAL
        if deviation.over == "median":
            curve = np.median(D.sum(axis=0) / counts.sum(axis=0)[:, None], axis=0)
            yield BAND, bool((np.abs(curve) > null.band * np.sqrt(LEVELS * (1 - LEVELS)) + 1e-7).any())
    if independent:
        uniform = (drawn + random.random(drawn.shape)) / (design.hypotheses + 1)
        for name, yes in independent_tests(uniform[:, 0].ravel()).items():
            yield f"{name}, one joint", yes
        for name, yes in independent_tests(uniform.ravel()).items():
            yield f"{name}, all joints", yes


def _rows(spread: float, replicates: int) -> list[tuple[str, ...]]:
    rates = [rejection_rates(replace(d, spread=spread), replicates, independent=spread == 1) for d in DESIGNS]
    return [(name, *(_cell(rate, name) for rate in rates)) for name in rates[0].rejected]


def _cell(rate: Rates, name: str) -> str:
    low, high = interval(rate.rejected[name], rate.replicates)
    return f"{rate.rejected[name] / rate.replicates:.1%} ({low:.1%} to {high:.1%})"


_DESIGNS = tuple(f"{d.sequences} × {d.frames}" for d in DESIGNS)
TABLES = [
    Table("levels", ("a perfect sampler is rejected", *_DESIGNS), partial(_rows, 1.0), 300),
    Table("power", ("spread × 0.9 is found", *_DESIGNS), partial(_rows, 0.9), 300),
]
