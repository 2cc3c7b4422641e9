"""Numbers of single poses, by which the worst are chosen for pictures."""

from __future__ import annotations

from functools import partial

import numpy as np

from posecal.calibration.curve import inside_table, signed_area
from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.gallery import POSE_NUMBERS
from posecal.engine.metric import Statistic
from posecal.engine.ragged import measure
from posecal.engine.scope import Scope
from posecal.metrics.position import pose_errors
from posecal.metrics.sharpness import predicted_spread


def pose_numbers(scope: Scope) -> Statistic:
    """Give signed area, predicted spread, error of the median pose and minMPJPE of each pose, (B, 4).

    The signed area is that of the curve of the pose alone, the mean over its joints that move: 0 where the truth is as
    central as half of the hypotheses, −0.5 where it is outside of all of them at every joint. Lengths are in mm.
    """
    inside = Statistic("inside_exchangeable", partial(inside_table, definition="exchangeable", joints=scope.moving))

    def compute(block: Block) -> FloatArray:
        area = signed_area(measure(block, inside)[:, -1])
        error = pose_errors(block, of="median_pose", body=scope.body)[:, 0]
        best = pose_errors(block, body=scope.body).min(axis=1)
        return np.stack([area, predicted_spread(block, scope.moving), error, best], axis=1, dtype=np.float64)

    return Statistic(POSE_NUMBERS, compute)
