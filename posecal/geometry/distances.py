"""Mean distances between the points of a set, in space and on a circle, as proper scores need them."""

from __future__ import annotations

import numpy as np

from posecal.data.arrays import FloatArray, squared_norms

STRIP = 50
"""Points whose distances to all later ones are taken at a time: as many as stay in cache."""


def half_mean_distances(points: FloatArray) -> FloatArray:
    """Half the mean distance between two different points of each set, (B, S, D, n) to (B, S).

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
        for factors, distances, to_itself, times in strips:
            np.matmul(*factors, out=distances)
            np.abs(distances, out=distances)  # rounding may leave a square a little below 0
            to_itself[...] = 0
            np.sqrt(distances, out=distances)
            total[b] += (distances @ times).sum(axis=-1, dtype=np.float64)
    total /= 2 * n * (n - 1)
    return total


def half_mean_arcs(offsets: FloatArray, period: float) -> FloatArray:
    """Half the mean distance, the shorter way round, of two different of N points on a circle, (..., N) to (...).

    A half circle that begins anywhere parts two points with a chance of their distance over half a period, so that
    the distances of all pairs are the integral of n (N - n) over where it begins, n the points within it, halved.
    """
    n, half = offsets.shape[-1], period / 2
    points = np.mod(offsets.astype(np.float64), period)
    ends = np.concatenate([points, np.mod(points - half, period)], axis=-1)  # where a point leaves it, and enters
    order = np.argsort(ends, axis=-1)
    at = np.take_along_axis(ends, order, axis=-1)
    inside = (points < half).sum(axis=-1, keepdims=True) + np.cumsum(np.where(order < n, -1, 1), axis=-1)
    arcs = np.diff(at, axis=-1, append=at[..., :1] + period)
    return np.asarray((inside * (n - inside) * arcs).sum(axis=-1) / (2 * n * (n - 1)))


def on_circle(offsets: FloatArray, period: float) -> FloatArray:
    """Place offsets (..., D, N) on circles of that circumference, relative to the point of 0, as (..., 2 D, N)."""
    radius = period / (2 * np.pi)
    angles = offsets / radius
    return np.concatenate([radius * np.sin(angles), -2 * radius * np.sin(angles / 2) ** 2], axis=-2)
