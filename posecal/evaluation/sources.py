"""Pose data from what public functions take: two arrays, two files, or pose data."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping
from typing import Any

import numpy.typing as npt

from posecal.data.gaussian import GaussianPrediction
from posecal.data.pose_data import PoseData
from posecal.errors import PoseDataError, did_you_mean

Source = npt.ArrayLike | str | os.PathLike[str] | GaussianPrediction
"""An array, the path of a file, or what hypotheses are drawn from."""

Progress = Callable[[int], object]

_DEFAULTS = {("missing", "error"), ("shared_joints", "same")}

DESCRIPTIONS = tuple(name for name in inspect.signature(PoseData).parameters if name not in {"hypotheses", "truth"})
"""The options that describe data."""


def check_descriptions(options: Mapping[str, Any]) -> None:
    """Refuse options that don't describe data.

    Raises
    ------
    PoseDataError
        For the first of them by name.
    """
    unknown = sorted(set(options) - set(DESCRIPTIONS))
    if unknown:
        raise PoseDataError(f"option: {unknown[0]!r} is not known. {did_you_mean(unknown[0], DESCRIPTIONS)}")


def as_pose_data(hypotheses: Source | PoseData, truth: Source | None, options: Mapping[str, Any]) -> PoseData:
    """Make pose data of two arrays or files; give pose data as they are.

    Raises
    ------
    PoseDataError
        Where the truth is missing, or comes beside pose data, and for options that don't describe data.
    """
    check_descriptions(options)
    given = {name: value for name, value in options.items() if value is not None}
    given = {k: v for k, v in given.items() if (k, v if isinstance(v, str) else "") not in _DEFAULTS}
    if isinstance(hypotheses, PoseData):
        if truth is not None or given:
            what = "truth" if truth is not None else next(iter(given))
            raise PoseDataError(f"{what}: given beside PoseData, which holds it already; expected PoseData alone.")
        return hypotheses
    if truth is None:
        raise PoseDataError("truth: missing; expected true poses (M, K, D) after the hypotheses, or PoseData alone.")
    return PoseData(hypotheses, truth, **given)
