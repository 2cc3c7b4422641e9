"""Coordinates that repeat, such as angles: the shorter way round, circular means, and unwrapping about them."""

from __future__ import annotations

import numpy as np

from posecal.data.arrays import FloatArray

_PARTS = 230_400
"""Parts of a circle, 640 of each degree, in which points are compared."""


def wrapped(offsets: FloatArray, period: float) -> FloatArray:
    """Bring offsets to within half a period of 0."""
    return offsets - _turns(offsets, period)


def circular_mean(offsets: FloatArray, period: float, weights: FloatArray | float = 1.0) -> FloatArray:
    """Direction of the weighted sum of points (..., N) on a circle, (...), within half a period of 0."""
    angles = offsets * (2 * np.pi / period)
    sine, cosine = (np.asarray(weights * f(angles)).sum(axis=-1) for f in (np.sin, np.cos))
    mean = np.arctan2(sine, cosine) * (period / (2 * np.pi))
    return np.asarray(mean.astype(offsets.dtype))


def unwrapped(offsets: FloatArray, period: float) -> FloatArray:
    """Bring offsets (..., N) to within half a period of their circular mean, by whole periods."""
    return offsets - _turns(offsets - circular_mean(offsets, period)[..., None], period)


def turns_of_pool(points: FloatArray, period: float) -> FloatArray:
    """The whole periods to subtract from points (..., N) so that they lie about their circular mean.

    Where the circle is cut depends on the set of the points alone, also where they cancel, or one lies opposite their
    mean: it is found in whole numbers of parts of the circle, sorted.
    """
    parts = np.rint(points.astype(np.float64) * (_PARTS / period))
    around = np.sort(parts % _PARTS, axis=-1)
    mean = np.rint(circular_mean(around, _PARTS))[..., None]
    return np.asarray(np.floor((parts - mean + _PARTS // 2) / _PARTS).astype(points.dtype))


def _turns(offsets: FloatArray, period: float) -> FloatArray:
    """The whole periods nearest to offsets."""
    times = offsets.dtype.type(period)
    return np.asarray(times * np.round(offsets / times))
