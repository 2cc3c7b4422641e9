"""Functions that turn means of a statistic into the reported number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from posecal.data.arrays import FloatArray


@dataclass(frozen=True)
class ReadOff:
    """Finish by reading a number off what several metrics share, such as the median curve.

    Attributes
    ----------
    summary : callable
        From means of the statistic, ``(..., *shape)``, to what is shared, ``(..., *other)``: computed once for all
        metrics of the statistic that have this very function.
    read : callable
        From that, which it must leave unchanged, to numbers, ``(...)``.
    """

    summary: Callable[[FloatArray], FloatArray]
    read: Callable[[FloatArray], FloatArray]

    def __call__(self, means: FloatArray) -> FloatArray:
        """Finish means of the statistic."""
        return self.read(self.summary(means))


def mean_over_joints(values: FloatArray) -> FloatArray:
    """Mean over the last axis of what is not NaN; NaN where nothing is left."""
    number = np.isfinite(values).sum(axis=-1)
    return np.where(number > 0, np.nansum(values, axis=-1) / np.maximum(number, 1), np.nan)


def entry(*place: int) -> Callable[[FloatArray], FloatArray]:
    """Finish by reading one entry of the means, (..., *shape) to (...)."""
    index: tuple[Any, ...] = (..., *place)
    return lambda means: np.asarray(means[index])


MEAN = entry()
"""Finish by the mean over poses itself."""


def per_joint(*place: int) -> Callable[[FloatArray], FloatArray]:
    """Finish by reading one entry of each joint, (..., K, *shape) to (..., K)."""
    index: tuple[Any, ...] = (..., slice(None), *place)
    return lambda means: np.asarray(means[index])
