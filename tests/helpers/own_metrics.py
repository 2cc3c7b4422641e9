"""Metrics of the user's own: of a function of arrays, and one that is no mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from posecal.engine.metric import Metric, Statistic

Array = npt.NDArray[np.floating]


def depth_error(hypotheses: Array, truth: Array, where: npt.NDArray[np.bool_] | None = None) -> Array:
    """Mean absolute error along the third axis.

    The rest of the docstring is not the definition.
    """
    errors = np.abs(hypotheses - truth)[..., 2].mean(axis=0)
    return np.where(where, errors, np.nan)


DEPTH = Metric.from_function(depth_error, by_joint=True, unit="mm", range="0 mm upwards", reading="As MPJPE.")
RMS = Metric(
    name="rms",
    label="RMS",
    unit="mm",
    direction="lower",
    family="accuracy",
    brief="root mean square",
    definition="root of the mean squared coordinate error",
    statistic=Statistic("squares", lambda block: (block.offsets**2).mean(axis=(1, 2, 3), dtype=np.float64)),
    finish=np.sqrt,
    headline=True,
    in_group_table=True,
)


def mean_square(hypotheses: Array, truth: Array) -> Array:
    """Mean squared coordinate error."""
    return np.asarray(((hypotheses - truth) ** 2).mean(axis=(0, 2, 3)))


ROOT = replace(Metric.from_function(mean_square, name="rms"), finish=np.sqrt)
"""A mean whose finish was changed, so that it is none any more."""
