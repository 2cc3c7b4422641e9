"""Errors, alignment, PCK and spread by their formulas, in plain loops; calibration is in ``calibration_oracles``.

Letters are the paper's: ``x`` hypotheses (N, M, K, D), ``y`` truth (M, K, D), ``w`` (M, K) the joints that count,
all lengths in mm. Nothing here imports posecal, so that its fast code is tested
against other code.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

QUANTILES = [Fraction(i, 20) for i in range(21)]


def mean(values: Sequence[float]) -> float:
    """Mean; NaN of nothing."""
    return math.fsum(values) / len(values) if len(values) else math.nan


def relative(x: Array, root: int | None) -> Array:
    """Positions relative to a joint."""
    return x if root is None else x - x[..., root : root + 1, :]


def relative_mask(w: Mask, root: int | None) -> Mask:
    """Joints that count relative to a joint: none where that one does not, or it alone."""
    return w if root is None else w & w[:, root : root + 1] & (w.sum(axis=1, keepdims=True) > 1)


# --- from positions to errors -----------------------------------------------------------------------------------


def joint_errors(x: Array, y: Array) -> Array:
    """d_nmk = ‖x_nmk - y_mk‖."""
    d = np.empty(x.shape[:3])
    for n, m, k in np.ndindex(*d.shape):
        d[n, m, k] = math.dist(x[n, m, k], y[m, k])
    return d


def pose_errors(x: Array, y: Array, w: Mask) -> Array:
    """e_nm: mean over the joints that count."""
    d = joint_errors(x, y)
    e = np.empty(d.shape[:2])
    for n, m in np.ndindex(*e.shape):
        e[n, m] = mean([d[n, m, k] for k in range(d.shape[2]) if w[m, k]])
    return e


def of_errors(errors: Sequence[float], of: str) -> float:
    """From the N errors of a pose to one."""
    rising = sorted(errors)
    n = len(rising)
    if of == "median":
        return (rising[(n - 1) // 2] + rising[n // 2]) / 2
    return {"min": rising[0], "worst": rising[-1], "mean": mean(rising)}[of]


def best_per_frame(e: Array) -> float:
    """The mean over poses of the smallest of the N errors."""
    return mean([min(e[:, m]) for m in range(e.shape[1]) if not math.isnan(e[0, m])])


def best_per_batch(e: Array, sequence: Sequence[str], clips: int) -> float:
    """The same with one n for all poses of each ``clips`` sequences, in the order in which they come."""
    names = list(dict.fromkeys(sequence))
    chosen = []
    for start in range(0, len(names), clips):
        poses = [m for m in range(e.shape[1]) if sequence[m] in names[start : start + clips]]
        poses = [m for m in poses if not math.isnan(e[0, m])]
        if poses:
            n = min(range(len(e)), key=lambda n: sum(e[n, m] for m in poses))
            chosen += [e[n, m] for m in poses]
    return mean(chosen)


def best_per_joint(x: Array, y: Array, w: Mask) -> Array:
    """For each pose the mean over its joints of the smallest of N distances, (M,)."""
    d = joint_errors(x, y)
    return np.array([mean([min(d[:, m, k]) for k in range(y.shape[1]) if w[m, k]]) for m in range(len(y))])


def best_of_subsets(errors: Sequence[float], n: int) -> float:
    """The mean, over all subsets of n of the errors, of the smallest."""
    return mean([min(subset) for subset in itertools.combinations(errors, n)])


def one_pose(x: Array, of: str, scores: Array | None = None, index: int | None = None) -> Array:
    """One pose of the N hypotheses, (1, M, K, D)."""
    found = np.empty((1, *x.shape[1:]))
    for m in range(x.shape[1]):
        if of == "mean_pose":
            found[0, m] = sum(x[n, m] for n in range(len(x))) / len(x)
        elif of == "median_pose":
            found[0, m] = np.median(x[:, m], axis=0)
        elif of == "weighted_pose" and scores is not None:
            found[0, m] = sum(scores[n, m] * x[n, m] for n in range(len(x))) / sum(scores[:, m])
        elif index is not None:
            found[0, m] = x[index, m]
        elif scores is not None:
            found[0, m] = x[max(range(len(x)), key=lambda n: scores[n, m]), m]
    return found


def motion(x: Array, w: Mask, sequence: Sequence[str], order: int) -> Array:
    """Mean over hypotheses and joints of ‖Δx‖ of an order, (M,); a joint counts where it does in all of the frames."""
    signs = {1: (1, -1), 2: (1, -2, 1), 3: (1, -3, 3, -1)}[order]
    found = np.full(len(w), math.nan)
    for m in range(order, len(w)):
        frames = [m - back for back in range(order + 1)]
        if all(sequence[frame] == sequence[m] for frame in frames):
            found[m] = mean(
                [
                    math.hypot(*sum(sign * x[n, frame, k] for sign, frame in zip(signs, frames, strict=True)))
                    for n in range(len(x))
                    for k in range(w.shape[1])
                    if all(w[frame, k] for frame in frames)
                ]
            )
    return found


# --- alignment --------------------------------------------------------------------------------------------------


def aligned(x: Array, y: Array, w: Mask, how: str) -> Array:
    """Each hypothesis moved onto its truth by the best map of a family, fitted to the joints that count.

    NaN where these are so few that the map is perfect whatever the pose.
    """
    moved = np.array(x, dtype=float)
    for n, m in np.ndindex(*x.shape[:2]):
        if w[m].sum() < {"similarity": 3, "reflection": 3, "rigid": 2, "rms_mean": 2}.get(how, 0):
            moved[n, m] = math.nan
        elif w[m].any():
            moved[n, m] = fit(x[n, m][w[m]], y[m][w[m]], how)(x[n, m])
    return moved


def fit(points: Array, target: Array, how: str) -> Callable[[Array], Array]:
    """The map of a family that brings points (K, 3) nearest to their targets."""
    if how == "none":
        return lambda p: p
    if how == "scale":
        s = ratio((points * target).sum(), (points * points).sum())
        return lambda p: s * p
    if how == "norm_root":
        s = ratio(np.linalg.norm(target), np.linalg.norm(points))
        return lambda p: s * p
    middle, centre = points.mean(axis=0), target.mean(axis=0)
    if how == "rms_mean":
        s = np.sqrt(ratio(((target - centre) ** 2).mean(), ((points - middle) ** 2).mean()))
        return lambda p: s * (p - middle) + centre
    u, sizes, vt = np.linalg.svd((target - centre).T @ (points - middle))
    signs = np.ones(3)
    if how != "reflection" and np.linalg.det(u @ vt) < 0:
        signs[2] = -1
    rotation = u @ np.diag(signs) @ vt
    scale = 1.0 if how == "rigid" else ratio((sizes * signs).sum(), ((points - middle) ** 2).sum())
    return lambda p: scale * (p - middle) @ rotation.T + centre


def ratio(over: float | np.floating, under: float | np.floating) -> float:
    """The factor of a size; a pose in one point has none and stays as it is."""
    return float(over / under) if under > 0 else 1.0


def world_errors(x: Array, y: Array, w: Mask, fitted: Mask, segments: Sequence[Sequence[int]], align: str) -> Array:
    """The error of each hypothesis and pose after one similarity for each segment of poses, (N, M)."""
    found = np.full(x.shape[:2], math.nan)
    for frames in segments:
        chosen = [m for m in frames if fitted[m].any()][: 2 if align == "first_two" else None]
        pairs = [(m, k) for m in chosen for k in range(y.shape[1]) if fitted[m, k]]
        for n in range(len(x)):
            move = fit(np.array([x[n, m, k] for m, k in pairs]), np.array([y[p] for p in pairs]), "similarity")
            for m in frames:
                moved = move(x[n, m])
                found[n, m] = mean([math.dist(moved[k], y[m, k]) for k in range(y.shape[1]) if w[m, k]])
    return found


def segments(sequence: Sequence[str], length: int) -> list[list[int]]:
    """Consecutive poses of a sequence, so many at a time from its first."""
    runs = [[m for m, _ in run] for _, run in itertools.groupby(enumerate(sequence), key=lambda pair: pair[1])]
    return [run[start : start + length] for run in runs for start in range(0, len(run), length)]


# --- shares of joints and poses -----------------------------------------------------------------------------------


def chosen_share(shares: Sequence[float], select: str, link: int) -> float:
    """The best hypothesis's share, that of the one with the smallest MPJPE, or the mean over all."""
    return {"own": max(shares), "linked": shares[link], "mean": mean(shares)}[select]


def links(e: Array) -> list[int]:
    """The hypothesis that minMPJPE chooses for each pose."""
    return [int(np.argmin(e[:, m])) for m in range(e.shape[1])]


def pck(d: Array, w: Mask, threshold: float, select: str, link: Sequence[int], *, strict: bool = True) -> Array:
    """The share of a pose's joints below the threshold, (M,), from distances d (N, M, K)."""
    found = np.full(d.shape[1], math.nan)
    for m in range(d.shape[1]):
        joints = [k for k in range(d.shape[2]) if w[m, k]]
        if joints and not np.isnan(d[:, m, joints]).any():
            right = d[:, m] < threshold if strict else d[:, m] <= threshold
            shares = [mean([float(right[n, k]) for k in joints]) for n in range(len(d))]
            found[m] = chosen_share(shares, select, link[m])
    return found


def auc(d: Array, w: Mask, select: str, link: Sequence[int], *, strict: bool = True) -> Array:
    """The mean of PCK at 0, 5, … 150 mm."""
    return np.mean([pck(d, w, 5.0 * i, select, link, strict=strict) for i in range(31)], axis=0)


def auc_integral(d: Array, w: Mask, select: str, link: Sequence[int]) -> Array:
    """The integral of PCK over 0 … 150 mm, over 150 mm: a sum over the steps of a staircase."""
    edges = sorted({0.0, 150.0, *(float(v) for v in d.flat if v < 150)})
    area = np.zeros(d.shape[1])
    for low, high in itertools.pairwise(edges):
        area += (high - low) * pck(d, w, (low + high) / 2, select, link)
    return area / 150


def complete(d: Array, w: Mask, threshold: float, select: str, link: Sequence[int]) -> Array:
    """Whether all of a pose's joints are below the threshold, (M,)."""
    found = np.full(d.shape[1], math.nan)
    for m in range(d.shape[1]):
        if w[m].any() and not np.isnan(d[:, m, w[m]]).any():
            worst = d[:, m, w[m]].max(axis=1)
            found[m] = chosen_share([float(error < threshold) for error in worst], select, link[m])
    return found


def cps(d: Array, w: Mask, select: str, link: Sequence[int]) -> Array:
    """The trapezoid over τ = 1, 2, … 300 mm of the share of complete poses."""
    heights = [complete(d, w, float(t), select, link) for t in range(1, 301)]
    return np.sum([(one + other) / 2 for one, other in itertools.pairwise(heights)], axis=0)


# --- spread -------------------------------------------------------------------------------------------------------


def deviations(x: Array, less: int) -> Array:
    """Standard deviation over n, divided by N - less, averaged over the axes, (M, K)."""
    N, M, K, D = x.shape
    found = np.full((M, K), math.nan)
    for m, k in np.ndindex(M, K):
        axes = []
        for i in range(D):
            middle = mean(x[:, m, k, i])
            axes.append(math.sqrt(sum((v - middle) ** 2 for v in x[:, m, k, i]) / (N - less)))
        found[m, k] = mean(axes)
    return found


def radii(x: Array, share: float) -> Array:
    """The smallest ball about the median that holds at least a share of the hypotheses, (M, K)."""
    found = np.full(x.shape[1:3], math.nan)
    for m, k in np.ndindex(*found.shape):
        middle = np.median(x[:, m, k], axis=0)
        distances = sorted(math.dist(point, middle) for point in x[:, m, k])
        found[m, k] = next(r for i, r in enumerate(distances) if (i + 1) / len(x) >= share - 1e-9)
    return found
