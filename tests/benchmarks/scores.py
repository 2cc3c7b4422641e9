"""How fast are the proper scores and the sign-flips, on one thread?

    OMP_NUM_THREADS=1 python tests/benchmarks/scores.py

The scores of 2,000 poses of K=16 joints with N=200 hypotheses in single precision, and 2,000 sign patterns of 240
sequences × 16 joints × 21 levels. Times are of the processor, the best of some runs; the energy score is held against
scipy's ``pdist`` before it is timed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial.distance import cdist, pdist

from posecal.calibration import LEVELS
from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.metric import Deviation
from posecal.engine.per_pose import iter_blocks
from posecal.metrics.brier import fair_brier
from posecal.metrics.proper import joint_crps, joint_energies, variograms
from posecal.stats.resampling import sign_flips

SCORES: dict[str, Callable[[Block], FloatArray]] = {
    "energy score, whole pose and each joint": joint_energies,
    "CRPS": joint_crps,
    "variogram score": variograms,
    "Brier score": fair_brier,
}


def energies_by_pdist(x: FloatArray, y: FloatArray) -> FloatArray:
    """Fair energy scores of every joint and of the whole pose, (M, K + 1), from N (N - 1) / 2 distances each."""

    def score(points: FloatArray, truth: FloatArray) -> float:
        return float(cdist(points, truth[None]).mean() - pdist(points).mean() / 2)

    N, M, K, _ = x.shape
    return np.array(
        [
            [*(score(x[:, m, k], y[m, k]) for k in range(K)), score(x[:, m].reshape(N, -1), y[m].ravel())]
            for m in range(M)
        ]
    )


def seconds(run: Callable[[], object], times: int) -> float:
    """Best processor time of a call."""
    found = []
    for _ in range(times):
        start = time.process_time()
        run()
        found.append(time.process_time() - start)
    return min(found)


def main() -> None:
    """Time everything."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--poses", type=int, default=2000)
    options.add_argument("--times", type=int, default=3)
    asked = options.parse_args()
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (asked.poses, 16, 3)).astype(np.float32)
    x = (y + random.normal(0, 100, (200, *y.shape))).astype(np.float32)
    print(f"N=200, M={asked.poses:,}, K=16, float32; NumPy {np.__version__}, one thread\n")
    print("| | s |\n|---|---:|")
    few = slice(0, min(100, asked.poses))
    ours = np.concatenate([joint_energies(lay_out()) for lay_out in iter_blocks(x[:, few], y[few])])
    np.testing.assert_allclose(ours, energies_by_pdist(x[:, few], y[few]), rtol=1e-4)

    def measure(*scores: Callable[[Block], FloatArray]) -> None:
        for block in (lay_out() for lay_out in iter_blocks(x, y)):
            for score in scores:
                score(block)

    for name, score in SCORES.items():
        print(f"| {name} | {seconds(partial(measure, score), asked.times):.2f} |")
    together = seconds(partial(measure, *SCORES.values()), asked.times)
    print(f"| all four in one walk, as a report computes them | {together:.2f} |")
    plain = seconds(lambda: energies_by_pdist(x[:, few], y[few]), asked.times) * asked.poses / (few.stop - few.start)
    print(f"| energy score by scipy's pdist | {plain:.2f} |")
    deviations, counts = random.normal(size=(240, 16, LEVELS.size)), np.full((240, 16), 50)
    sign_flips(deviations, counts, Deviation(over="median"))  # draws the patterns once
    best = seconds(lambda: sign_flips(deviations, counts, Deviation(over="median")), 5 * asked.times)
    print(f"| 2,000 sign-flips of 240 sequences × 16 joints × 21 levels | {best:.3f} |")


if __name__ == "__main__":
    main()
