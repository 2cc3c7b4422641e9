"""Calibration by its formulas, in plain loops that import nothing of posecal; letters as in ``oracles``."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np

from tests.helpers.oracles import QUANTILES, Array, Mask, mean


def ranks_within(n: int, percent: int) -> tuple[Fraction, Fraction]:
    """The ranks between which the central interval of N lies, from 1 to N at most."""
    low = max(Fraction(n + 1, 2) * (1 - Fraction(percent, 100)), Fraction(1))
    return low, n + 1 - low


def interval(values: Sequence[float], percent: int) -> tuple[float, float]:
    """The values at the two ranks, on the line between two neighbours."""
    rising = sorted(values)
    found = []
    for rank in ranks_within(len(rising), percent):
        below = math.floor(rank)
        step = rising[below] - rising[below - 1] if rank > below else 0.0
        found.append(rising[below - 1] + float(rank - below) * step)
    return found[0], found[1]


def held(values: Sequence[float], truth: float, percent: int) -> float:
    """The part of the truth's gap between its neighbours that lies between the two ranks; ties share theirs."""
    low, high = ranks_within(len(values), percent)
    less, equal = sum(v < truth for v in values), sum(v == truth for v in values)
    return mean([float(max(0, min(gap + 1, high) - max(gap, low))) for gap in range(less, less + equal + 1)])


def over_axes(x: Array, y: Array, of: Callable[[Array, float], float]) -> Array:
    """Mean over the axes of what is made of the N values of a coordinate and its truth, (M, K)."""
    found = np.empty(y.shape[:2])
    for m, k in np.ndindex(*found.shape):
        found[m, k] = mean([of(x[:, m, k, d], y[m, k, d]) for d in range(y.shape[2])])
    return found


def centre(points: Array, truth: Array, definition: str) -> Array:
    """The point from which distances are measured."""
    if definition == "exchangeable":
        return np.asarray(np.median([*points, truth], axis=0))
    if definition == "paper":
        return np.asarray(np.median(points, axis=0))
    return np.sort(points, axis=0)[(len(points) - 1) // 2]


def inside_one(points: Array, truth: Array, definition: str) -> list[float]:
    """How far inside each q-ball of its hypotheses (N, D) a truth (D,) lies."""
    c = centre(points, truth, definition)
    N, distances, true = len(points), [math.dist(p, c) for p in points], math.dist(truth, c)
    if definition == "paper":
        inner = sum(d <= true for d in distances)
        return [float(Fraction(inner, N) <= q) for q in QUANTILES]
    if definition == "reference":
        return [float(radius > true) for radius in np.quantile(distances, [float(q) for q in QUANTILES])]
    equal = sum(math.isclose(d, true, rel_tol=1e-12) for d in distances)
    less = sum(d < true and not math.isclose(d, true, rel_tol=1e-12) for d in distances)
    return [float(min(max(((N + 1) * q - less) / (equal + 1), Fraction(0)), Fraction(1))) for q in QUANTILES]


def inside(x: Array, y: Array, w: Mask, definition: str) -> Array:
    """The same for every pose and joint, (M, K, 21); NaN for joints that don't count."""
    found = np.full((*w.shape, 21), math.nan)
    for m, k in np.ndindex(*w.shape):
        if w[m, k]:
            found[m, k] = inside_one(x[:, m, k], y[m, k], definition)
    return found


def curves(weights: Array) -> Array:
    """ω_k(q), (K, 21): the mean over the poses in which joint k counts."""
    K = weights.shape[1]
    columns = [[row for row in weights[:, k] if not math.isnan(row[0])] for k in range(K)]
    return np.array([np.mean(rows, axis=0) if rows else np.full(21, math.nan) for rows in columns])


def pooled_curve(weights: Array) -> Array:
    """One column: per pose the mean over its joints that count, then the mean over such poses."""
    poses = [[row for row in pose if not math.isnan(row[0])] for pose in weights]
    columns = [np.mean(rows, axis=0) for rows in poses if rows]
    return np.mean(columns, axis=0) if columns else np.full(21, math.nan)


def curve_ece(curve: Array) -> float:
    """The mean over the levels of |ω(q) - q|."""
    return mean([abs(omega - float(q)) for omega, q in zip(curve, QUANTILES, strict=True)])


def curve_area(curve: Array) -> float:
    """∫ (ω(q) - q) dq by trapezoids."""
    gaps = [omega - float(q) for omega, q in zip(curve, QUANTILES, strict=True)]
    return math.fsum((one + other) / 2 / 20 for one, other in itertools.pairwise(gaps))


def over_joints(by_joint: Array, pooled: Array, over: str) -> Array:
    """The one curve that stands for all joints."""
    counted = [curve for curve in by_joint if not math.isnan(curve[0])]
    if over == "pooled" or not counted:
        return pooled
    if over == "worst":
        return max(counted, key=curve_ece)
    return np.asarray(np.median(counted, axis=0) if over == "median" else np.mean(counted, axis=0))


def ece(by_joint: Array, pooled: Array, over: str) -> float:
    """ECE of the median curve or of the pooled one; the mean or the largest of the joints' ECEs."""
    if over in {"median", "pooled"}:
        return curve_ece(over_joints(by_joint, pooled, over))
    errors = [curve_ece(curve) for curve in by_joint if not math.isnan(curve[0])]
    return math.nan if not errors else mean(errors) if over == "mean" else max(errors)
