"""Pose data that are rescaled when they are read."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.recalibration import SpreadMap
from tests.helpers.samplers import gaussian


def test_hypotheses_of_unequal_weights_are_not_rescaled_about_a_median_without_weights() -> None:
    x, y = gaussian(1, 4, 6, 2)
    weights = np.full((4, 6), 0.25)
    how: dict[str, Any] = {"unit": "mm", "root_joint": "none"}
    spread_map = SpreadMap(("a", "b"), np.array([2.0, 1.0]), 6, 1)
    even = posecal.PoseData(x, y, joints=("a", "b"), weights=weights, **how)
    np.testing.assert_allclose(spread_map.rescale(even).hypotheses.read(0, 6), spread_map.apply(x))
    weights[:, 2] = 0.7, 0.1, 0.1, 0.1
    uneven = posecal.PoseData(x, y, joints=("a", "b"), weights=weights, **how)
    with pytest.raises(PoseDataError, match=r"weights are not equal in 1 of 6 frames; expected hypotheses that count"):
        spread_map.rescale(uneven)
