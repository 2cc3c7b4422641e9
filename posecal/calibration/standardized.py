"""Standardized errors: how far the median lies from the truth, in units of the hypotheses' own spread.

A factor of the spread adds a constant to their logarithms. So how much these vary from sequence to sequence says how
much frames depend on each other, whatever the calibration of the model is: what ranks can't say where nearly all truths
lie inside the smallest ball, or outside the largest.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from posecal.calibration.modes import two_modes
from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.metric import Statistic
from posecal.engine.scope import Scope

NAME = "standardized_errors"
"""Of the statistic."""

MODES = 4
"""Its column on modes."""

SMALLEST = -5.0
"""Smaller logarithms are taken as this: a median that equals the truth by chance."""


def standardized_errors(block: Block, joints: BoolArray) -> FloatArray:
    r"""Give the logarithm of the standardized error of each joint, and its square.

    .. math:: \ell = \log \Big( \lVert \operatorname{median}_n x_n - y \rVert \Big/
              \sqrt{\textstyle\sum_d (x_{(3N/4)} - x_{(N/4)})_d^2} \Big)

    Parameters
    ----------
    block : Block
        B poses.
    joints : bool array (K,)
        The joints that are scored.

    Returns
    -------
    array (B, K, 5)
        Whether hypotheses differ, whether ℓ is known, ℓ and ℓ², all 0 where it is not, and whether hypotheses have
        :func:`two_modes`; NaN for joints that don't count.
    """
    n, ordered = block.n_hypotheses, block.sorted
    quarter = (n - 1) // 4
    width = ordered[..., n - 1 - quarter] - ordered[..., quarter]
    spread, error = (np.einsum("bkd,bkd->bk", v, v, dtype=np.float64) for v in (width, block.shortest(block.median)))
    points = ordered if block.weights is None else block.offsets
    modes = two_modes(points, width.argmax(axis=-1), block.weights, block.period)
    known = (spread > 0) & (error > 0)
    logs = np.zeros(spread.shape)
    logs[known] = np.maximum(np.log(error[known] / spread[known]) / 2, SMALLEST)
    differ = (ordered[..., 0] != ordered[..., -1]).any(axis=-1)
    values = np.stack([differ, known, logs, logs**2, modes], axis=-1)
    values[~(block.where & joints)] = np.nan
    return values


def standardized_errors_of(scope: Scope) -> Statistic:
    """The statistic of :func:`standardized_errors` of the joints that move."""
    return Statistic(NAME, partial(standardized_errors, joints=scope.moving), per_joint=True)
