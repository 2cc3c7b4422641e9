"""Hypotheses and truths with two modes: a limb towards the camera or away from it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]


def depth_flips(
    seed: int, N: int, M: int, K: int, *, true: float = 15.0, narrow: float = 5.0, depth: float = 60.0
) -> tuple[Array, Array]:
    """Hypotheses (N, M, K, 3) and truths (M, K, 3), mm: all joints of a pose lie behind or before a point.

    The truth is about its mode with the deviation ``true`` along each axis, the hypotheses with ``narrow``.
    """
    random = np.random.default_rng(seed)
    centre = random.normal(0, 300, (M, K, 3))
    y = centre + random.normal(0, true, (M, K, 3))
    x = centre + random.normal(0, narrow, (N, M, K, 3))
    y[..., 2] += depth * random.choice([-1, 1], (M, 1))
    x[..., 2] += depth * random.choice([-1, 1], (N, M, 1))
    return x, y
