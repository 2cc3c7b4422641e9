"""Coordinates that repeat, such as angles: the shorter way round, circular means, and unwrapping about them."""

from __future__ import annotations

import numpy as np

from posecal.data.arrays import FloatArray


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


def _turns(offsets: FloatArray, period: float) -> FloatArray:
    """The whole periods nearest to offsets."""
    times = offsets.dtype.type(period)
    return np.asarray(times * np.round(offsets / times))
