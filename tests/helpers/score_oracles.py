"""The naive twins of the proper scores, of the battery, and of how the spread goes with the error.

As in :mod:`tests.helpers.oracles`; a *pose* here is the joints of it that count, ``x`` (N, J, D) and ``y`` (J, D).
"""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from tests.helpers.oracles import QUANTILES, mean

Array = npt.NDArray[np.float64]

# --- proper scores ----------------------------------------------------------------------------------------------


def energy(x: Array, y: Array) -> float:
    """mean ‖x - y‖ - ½ mean ‖x - x′‖ over pairs of different hypotheses."""
    apart = [math.dist(a.ravel(), b.ravel()) for a, b in itertools.permutations(x, 2)]
    return mean([math.dist(point.ravel(), y.ravel()) for point in x]) - mean(apart) / 2


def crps(x: Array, y: Array) -> float:
    """The same of each coordinate, and their mean."""
    axes = np.ndindex(*y.shape)
    return mean([energy(x[(slice(None), *axis)], y[axis]) for axis in axes])


def variogram(x: Array, y: Array) -> float:
    """Over pairs of joints the mean of (√d(y) - mean √d(x))² - var √d(x) / N."""
    found = []
    for k, j in itertools.combinations(range(len(y)), 2):
        roots = [math.sqrt(math.dist(pose[k], pose[j])) for pose in x]
        middle = mean(roots)
        variance = sum((root - middle) ** 2 for root in roots) / (len(x) - 1)
        found.append((math.sqrt(math.dist(y[k], y[j])) - middle) ** 2 - variance / len(x))
    return mean(found)


def near_median(x: Array, y: Array, threshold: float) -> tuple[int, bool]:
    """How many hypotheses have every joint near the median of the others, and whether the truth near that of all."""

    def near(pose: Array, others: Array) -> bool:
        median = np.median(others, axis=0)
        return all(math.dist(joint, middle) < threshold for joint, middle in zip(pose, median, strict=True))

    return sum(near(x[n], np.delete(x, n, axis=0)) for n in range(len(x))), near(y, x)


def brier(inner: int, happened: bool, N: int) -> float:
    """(p - o)² - p (1 - p) / (N - 1)."""
    p = inner / N
    return (p - happened) ** 2 - p * (1 - p) / (N - 1)


def isotonic(values: Sequence[float], weights: Sequence[float]) -> list[float]:
    """The rising values nearest to these: each the largest, over starts before it, of the smallest mean to an end."""

    def average(a: int, b: int) -> float:
        return sum(w * v for w, v in zip(weights[a:b], values[a:b], strict=True)) / sum(weights[a:b])

    n = len(values)
    return [max(min(average(a, b) for b in range(i + 1, n + 1)) for a in range(i + 1)) for i in range(n)]


def brier_parts(outcomes: Sequence[tuple[int, bool]], N: int) -> tuple[float, float]:
    """Miscalibration and discrimination, by isotonic regression of the outcome on p."""
    if not outcomes:
        return math.nan, math.nan
    present = sorted({inner for inner, _ in outcomes})
    frequency = [mean([float(o) for inner, o in outcomes if inner == at]) for at in present]
    weight = [float(sum(inner == at for inner, _ in outcomes)) for at in present]
    better = dict(zip(present, isotonic(frequency, weight), strict=True))
    happened = mean([float(o) for _, o in outcomes])
    recalibrated = mean([(better[inner] - o) ** 2 for inner, o in outcomes])
    as_it_is = mean([(inner / N - o) ** 2 for inner, o in outcomes])
    return as_it_is - recalibrated, happened * (1 - happened) - recalibrated


# --- the battery: a number of each point of a pool (N + 1, J, D), the truth last -----------------------------------


def rank_inside(prerank: Sequence[float]) -> list[float]:
    """How far inside each level the rank of the last number among all of them lies; NaN where all are equal."""
    *others, truth = (float(value) for value in prerank)
    size = max(abs(value) for value in prerank)
    equal = sum(math.isclose(value, truth, rel_tol=0, abs_tol=1e-12 * size) for value in others)
    less = sum(value < truth - 1e-12 * size for value in others)
    if equal == len(others):
        return [math.nan for _ in QUANTILES]
    return [min(max(((len(others) + 1) * float(q) - less) / (equal + 1), 0.0), 1.0) for q in QUANTILES]


def mean_ranks(pool: Array) -> Array:
    """The rank of each point in each coordinate, from 1, ties sharing the mean."""
    flat = pool.reshape(len(pool), -1)
    ranks = np.empty(flat.shape)
    for i, j in np.ndindex(*flat.shape):
        ranks[i, j] = 1 + sum(flat[:, j] < flat[i, j]) + (sum(flat[:, j] == flat[i, j]) - 1) / 2
    return ranks


def average_rank(pool: Array) -> list[float]:
    return [math.fsum(row) for row in mean_ranks(pool)]


def band_depth(pool: Array) -> list[float]:
    return [math.fsum((rank - 1) * (len(pool) - rank) for rank in row) for row in mean_ranks(pool)]


def pair_distance(pool: Array) -> list[float]:
    pairs = list(itertools.combinations(range(pool.shape[1]), 2))
    roots = np.array([[math.sqrt(math.dist(pose[k], pose[j])) for k, j in pairs] for pose in pool])
    roots = roots.reshape(len(pool), len(pairs))
    return [math.fsum((row - roots.mean(axis=0)) ** 2) for row in roots]


def mahalanobis(pool: Array) -> list[float]:
    flat = pool.reshape(len(pool), -1)
    centred = flat - flat.mean(axis=0)
    covariance = centred.T @ centred / len(pool)
    shrunk = 0.9 * covariance + 0.1 * np.diag(np.diag(covariance))
    inverse = np.linalg.inv(shrunk)
    return [float(row @ inverse @ row) for row in centred]


def tarp(pool: Array) -> list[float]:
    """Distances to the first hypothesis, which is no part of the pool then."""
    return [math.dist(pose.ravel(), pool[0].ravel()) for pose in pool[1:]]


def sides(truths: Array, counted: npt.NDArray[np.bool_]) -> list[list[tuple[float, float]]]:
    """The least and the largest of each coordinate of each joint (K, D) over the true poses in which it counts."""
    _, K, D = truths.shape
    found = []
    for k in range(K):
        known = [pose[k] for pose, there in zip(truths, counted, strict=True) if there[k]]
        ends = [(min(float(p[d]) for p in known), max(float(p[d]) for p in known)) for d in range(D)] if known else []
        found.append(ends or [(math.nan, math.nan)] * D)
    return found


def tarp_box(pool: Array, box: Sequence[Sequence[tuple[float, float]]], share: Array) -> list[float]:
    """Distances to a point of the box, when its sides are made to reach from 0 to 1; a side of no length is no axis."""
    axes = [(k, d, *ends) for k, joint in enumerate(box) for d, ends in enumerate(joint) if ends[0] < ends[1]]
    reference = [float(share[k, d]) for k, d, _, _ in axes]
    return [math.dist([(pose[k, d] - a) / (b - a) for k, d, a, b in axes], reference) for pose in pool]


def box_share(truth: Array) -> Array:
    """Where in the box: drawn from the bytes of the true pose, NaN where a joint does not count."""
    return np.random.default_rng(zlib.crc32(truth.tobytes())).random(truth.shape)


PRERANKS: dict[str, Callable[[Array], list[float]]] = {
    "average_rank": average_rank,
    "band_depth": band_depth,
    "pair_distance": pair_distance,
    "mahalanobis": mahalanobis,
    "tarp": tarp,
}


# --- spread and error of poses -------------------------------------------------------------------------------------


def rank_correlation(spread: Sequence[float], error: Sequence[float]) -> float:
    """Pearson's correlation of the ranks."""
    if len(set(spread)) < 2 or len(set(error)) < 2:
        return math.nan
    ranks = [mean_ranks(np.array(values)[:, None])[:, 0] for values in (spread, error)]
    s, e = (r - r.mean() for r in ranks)
    return float((s * e).sum() / math.sqrt((s**2).sum() * (e**2).sum()))


def ause(spread: Sequence[float], error: Sequence[float]) -> float:
    """The mean, over dropped shares 0 … 0.95, of what is left by spread minus what is left by error."""
    if not len(error):
        return math.nan

    def left(order: Sequence[float], share: float) -> float:
        kept = max(int(np.rint((1 - share) * len(error))), 1)
        least = sorted(range(len(error)), key=lambda m: order[m])[:kept]
        return mean([error[m] for m in least]) / mean(error)

    return mean([left(spread, i / 20) - left(error, i / 20) for i in range(20)])


def aurc(spread: Sequence[float], error: Sequence[float]) -> float:
    """The mean, over numbers n of poses, of the mean error of the n of least spread; of equal spreads, their mean."""
    tied = {value: mean([e for s, e in zip(spread, error, strict=True) if s == value]) for value in spread}
    kept = [tied[value] for value in sorted(spread)]
    return mean([mean(kept[:n]) for n in range(1, len(kept) + 1)]) if kept else math.nan


def excess_aurc(spread: Sequence[float], error: Sequence[float]) -> float:
    """How much less the order of the errors has."""
    return aurc(spread, error) - aurc(error, error)


def failure_auroc(spread: Sequence[float], error: Sequence[float], threshold: float) -> float:
    """The share of pairs of a failure and a success of which the failure has the larger spread."""
    failures = [s for s, e in zip(spread, error, strict=True) if e > threshold]
    successes = [s for s, e in zip(spread, error, strict=True) if not e > threshold]
    pairs = [1.0 if f > s else 0.5 if f == s else 0.0 for f in failures for s in successes]
    return mean(pairs) if pairs else math.nan


def failure_rate(spread: Sequence[float], error: Sequence[float], threshold: float) -> float:
    """The share of failures."""
    return mean([float(e > threshold) for e in error]) if len(error) else math.nan
