"""Mean distances between the points of a set, in space and on a circle, as proper scores need them."""

from __future__ import annotations

import numpy as np

from posecal.data.arrays import FloatArray, squared_norms

STRIP = 50
"""Points whose distances to all later ones are taken at a time: as many as stay in cache."""


def half_mean_distances(points: FloatArray, weights: FloatArray | None = None) -> FloatArray:
    r"""Half the mean distance between two different points of each set, (B, S, D, n) to (B, S).

    Of weights (B, n), of sum 1, it is ½ Σ_{i ≠ j} w_i w_j ‖x_i − x_j‖ / (1 − Σ w²); NaN for one point.

    One product of (x, ‖x‖², 1) with (-2x, 1, ‖x‖²) gives the squared distances of a strip of points to themselves and
    to all later ones, each of which stands for two. A pose at a time, laid into the same memory: its pairs fill the
    cache.
    """
    B, S, D, n = points.shape
    centres = points.mean(axis=-1, keepdims=True)
    left, right = np.ones((2, S, D + 2, n), dtype=points.dtype)
    buffer = np.empty(S * min(STRIP, n) * n, dtype=points.dtype)
    strips = []
    for start in range(0, n, STRIP):
        own, later = min(STRIP, n - start), n - start
        distances = buffer[: S * own * later].reshape(S, own, later)
        times = np.repeat(np.array([1, 2], dtype=points.dtype), [own, later - own])
        factors = left[..., start : start + own].swapaxes(-1, -2), right[..., start:]
        strips.append((factors, distances, np.einsum("sii->si", distances[..., :own]), times))
    total = np.zeros((B, S))
    for b in range(B):
        centred = np.subtract(points[b], centres[b], out=left[:, :D])
        left[:, D] = right[:, -1] = squared_norms(centred)
        np.multiply(centred, -2, out=right[:, :D])
        start = 0
        for factors, distances, to_itself, times in strips:
            np.matmul(*factors, out=distances)
            np.abs(distances, out=distances)  # rounding may leave a square a little below 0
            to_itself[...] = 0
            np.sqrt(distances, out=distances)
            if weights is None:
                total[b] += (distances @ times).sum(axis=-1, dtype=np.float64)
            else:
                total[b] += distances @ (times * weights[b, start:]) @ weights[b, start : start + distances.shape[1]]
                start += distances.shape[1]
    if weights is None:
        total /= 2 * n * (n - 1)
        return total
    return np.asarray(total / (2 * different(weights)[:, None]))


def different(weights: FloatArray) -> FloatArray:
    """Chance that two points drawn by weights (B, n) of sum 1 are different ones, 1 − Σ w², (B,); NaN where it is 0."""
    chance = 1 - (weights**2).sum(axis=-1)
    return np.where(chance > 0, chance, np.nan)


def half_mean_differences(values: FloatArray, weights: FloatArray) -> FloatArray:
    """½ Σ_{i ≠ j} w_i w_j |x_i − x_j| / (1 − Σ w²) of values (B, K, D, N), weights (B, N), by one sort."""
    order = np.argsort(values, axis=-1)
    ordered = np.take_along_axis(values, order, axis=-1)
    each = np.take_along_axis(np.broadcast_to(weights[:, None, None], values.shape), order, axis=-1)
    times = each * (2 * np.cumsum(each, axis=-1) - each - 1)  # the weight below minus that above
    return np.asarray(np.einsum("bkdn,bkdn->bkd", ordered, times) / different(weights)[:, None, None])


def half_mean_arcs(offsets: FloatArray, period: float, weights: FloatArray | None = None) -> FloatArray:
    """Half the mean distance, the shorter way round, of two different of N points on a circle, (..., N) to (...).

    A half circle that begins anywhere parts two points with a chance of their distance over half a period, so that
    the distances of all pairs are the integral of n (N - n) over where it begins, n the points within it, halved; of
    points with weights (B, N) of sum 1, n is the weight within it, and N is 1.
    """
    n, half = offsets.shape[-1], period / 2
    points = np.mod(offsets.astype(np.float64), period)
    ends = np.concatenate([points, np.mod(points - half, period)], axis=-1)  # where a point leaves it, and enters
    order = np.argsort(ends, axis=-1)
    at = np.take_along_axis(ends, order, axis=-1)
    arcs = np.diff(at, axis=-1, append=at[..., :1] + period)
    if weights is not None:
        each = np.broadcast_to(weights.reshape(len(weights), *[1] * (points.ndim - 2), n), points.shape)
        leaving = np.take_along_axis(np.concatenate([-each, each], axis=-1), order, axis=-1)
        within = (each * (points < half)).sum(axis=-1, keepdims=True) + np.cumsum(leaving, axis=-1)
        pairs = (within * (1 - within) * arcs).sum(axis=-1)
        return np.asarray(pairs / (2 * different(weights).reshape(-1, *[1] * (pairs.ndim - 1))))
    inside = (points < half).sum(axis=-1, keepdims=True) + np.cumsum(np.where(order < n, -1, 1), axis=-1)
    return np.asarray((inside * (n - inside) * arcs).sum(axis=-1) / (2 * n * (n - 1)))


def on_circle(offsets: FloatArray, period: float) -> FloatArray:
    """Place offsets (..., D, N) on circles of that circumference, relative to the point of 0, as (..., 2 D, N)."""
    radius = period / (2 * np.pi)
    angles = offsets / radius
    return np.concatenate([radius * np.sin(angles), -2 * radius * np.sin(angles / 2) ** 2], axis=-2)
