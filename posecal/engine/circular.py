"""Coordinates that repeat, such as angles: the shorter way round, and unwrapping about a circular mean."""

from __future__ import annotations

import numpy as np

from posecal.data.arrays import FloatArray


def wrapped(offsets: FloatArray, period: float) -> FloatArray:
    """Bring offsets to within half a period of 0."""
    times = offsets.dtype.type(period)
    return np.asarray(offsets - times * np.round(offsets / times))


def unwrapped(offsets: FloatArray, period: float) -> FloatArray:
    """Bring offsets (..., N) to within half a period of their circular mean, and that to within one of 0."""
    angles = offsets * (2 * np.pi / period)
    mean = np.arctan2(np.sin(angles).mean(axis=-1), np.cos(angles).mean(axis=-1)) * (period / (2 * np.pi))
    centre = mean[..., None].astype(offsets.dtype)
    return np.asarray(centre + wrapped(offsets - centre, period))
