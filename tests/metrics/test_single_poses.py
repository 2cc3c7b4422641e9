"""The numbers by which poses are chosen are those of the pose alone."""

from functools import cache

import numpy as np

import posecal
from posecal.calibration.curve import signed_area
from posecal.engine.block import Block
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.metrics.single_poses import pose_numbers

N, M, K = 9, 4, 6
RANDOM = np.random.default_rng(1)
TRUTH = RANDOM.normal(0, 300, (M, K, 3))
TRUTH[:, 0] = 0
HYPOTHESES = TRUTH + RANDOM.normal(0, 50, (N, M, K, 3)) * np.r_[0, np.ones(K - 1)][:, None]


@cache
def numbers() -> np.ndarray:
    spec = DataSpec(N, tuple(map(str, range(K))), root=0)
    return pose_numbers(Scope(Protocol(), spec)).compute(Block(HYPOTHESES, TRUTH, root=0))


def test_the_signed_area_is_that_of_the_curve_of_the_pose_alone() -> None:
    for m in range(M):
        curve = posecal.calibration_curve(HYPOTHESES[:, [m], 1:], TRUTH[[m], 1:])
        np.testing.assert_allclose(numbers()[m, 0], signed_area(curve.pooled), rtol=1e-12)


def test_spread_and_errors_are_those_of_numpy() -> None:
    x = HYPOTHESES
    np.testing.assert_allclose(numbers()[:, 1], x[:, :, 1:].std(axis=0, ddof=1).mean(axis=(1, 2)), rtol=1e-6)
    median = np.linalg.norm(np.median(x, axis=0) - TRUTH, axis=-1).mean(axis=1)
    np.testing.assert_allclose(numbers()[:, 2], median, rtol=1e-6)
    np.testing.assert_allclose(numbers()[:, 3], np.linalg.norm(x - TRUTH, axis=-1).mean(axis=-1).min(axis=0), rtol=1e-6)
