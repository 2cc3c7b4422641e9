"""How fast is posecal, against the plain NumPy formulas, in one run?

    python tests/benchmarks/speed.py

On N=200, M=2000, K=16, float32 (77 MB): the median of some runs of each way, and ratios. Every fast number is held
against the plain one's before it is timed.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np

from posecal.calibration import DEFINITIONS, LEVELS
from posecal.calibration.ranks import inside
from posecal.data.arrays import FloatArray
from posecal.data.pose_data import PoseData
from tests.helpers.sums import accumulate
from posecal.engine.block import Block, iter_blocks
from posecal.engine.protocol import Protocol
from posecal.engine.threads import available_cores, run_in_order
from posecal.geometry.procrustes import aligned_errors
from posecal.metrics.pck import correct_joints
from posecal.metrics.position import pose_errors


def plain_errors(x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """minMPJPE, PCK and the three calibration curves, formula by formula over the whole array."""
    errors = np.linalg.norm(x - y, axis=-1)
    found = [errors.mean(axis=-1).min(axis=0), (errors < 150).mean(axis=-1).max(axis=0)]
    n = len(x)
    for definition in DEFINITIONS:
        if definition == "exchangeable":
            pooled = np.concatenate([x, y[None]])
            centre = np.median(pooled, axis=0)
        elif definition == "paper":
            centre = np.median(x, axis=0)
        else:
            centre = np.partition(x, (n - 1) // 2, axis=0)[(n - 1) // 2]
        distances, true = np.linalg.norm(x - centre, axis=-1), np.linalg.norm(y - centre, axis=-1)
        if definition == "exchangeable":
            less, equal = (distances < true).sum(axis=0), (distances == true).sum(axis=0)
            weights = np.clip(((n + 1) * LEVELS - less[..., None]) / (equal[..., None] + 1), 0, 1)
        elif definition == "paper":
            weights = (distances <= true).sum(axis=0)[..., None] * 20 <= np.arange(21) * n
        else:
            weights = np.moveaxis(np.quantile(distances, LEVELS, axis=0) > true, 0, -1)
        found.append(weights.mean(axis=0))
    return tuple(found)


def fast_errors(x: FloatArray, y: FloatArray, threads: int) -> tuple[FloatArray, ...]:
    """The same, block by block."""

    def measure(lay_out: Callable[[], Block]) -> tuple[FloatArray, ...]:
        block = lay_out()
        return (
            pose_errors(block).min(axis=-1),
            correct_joints(block, 150.0),
            *(inside(block, d).sum(axis=0) for d in DEFINITIONS),
        )

    parts = list(run_in_order((lambda b=b: measure(b) for b in iter_blocks(x, y)), threads))
    poses = [np.concatenate([part[i] for part in parts]) for i in range(2)]
    return *poses, *(sum(part[i] for part in parts) / len(y) for i in range(2, 5))


def plain_procrustes(x: FloatArray, y: FloatArray) -> FloatArray:
    """Procrustes-aligned MPJPE of every hypothesis by batched singular value decompositions."""
    x, y = x.astype(np.float64), y.astype(np.float64)
    middle, target = x.mean(axis=-2, keepdims=True), y.mean(axis=-2, keepdims=True)
    x0, y0 = x - middle, y - target
    left, sizes, right = np.linalg.svd(np.einsum("mki,nmkj->nmij", y0, x0))
    sign = np.sign(np.linalg.det(left @ right))
    left[..., 2] *= sign[..., None]
    sizes[..., 2] *= sign
    scale = sizes.sum(axis=-1) / (x0**2).sum(axis=(-1, -2))
    moved = scale[..., None, None] * (x0 @ np.swapaxes(left @ right, -1, -2))
    return np.linalg.norm(moved - y0, axis=-1).mean(axis=-1)


def fast_procrustes(x: FloatArray, y: FloatArray, threads: int) -> FloatArray:
    """The same, block by block."""

    def measure(lay_out: Callable[[], Block]) -> FloatArray:
        block = lay_out()
        errors = aligned_errors(block.offsets, block.truth, block.weights(), "similarity")
        return errors.mean(axis=1).T

    return np.concatenate(list(run_in_order((lambda b=b: measure(b) for b in iter_blocks(x, y)), threads)), axis=1)


def seconds(run: Callable[[], object], times: int) -> float:
    """Median time of a call."""
    found = []
    for _ in range(times):
        start = time.perf_counter()
        run()
        found.append(time.perf_counter() - start)
    return statistics.median(found)


def row(name: str, ours: float, against: float, what: str) -> None:
    """Print one comparison."""
    print(f"{name:58} {ours * 1e3:9.1f} ms   {against / ours:6.1f} × {what}")


def main() -> None:
    """Run all comparisons."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--poses", type=int, default=2000)
    options.add_argument("--times", type=int, default=5)
    asked = options.parse_args()
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (asked.poses, 16, 3)).astype(np.float32)
    x = (y + random.normal(0, 100, (200, *y.shape))).astype(np.float32)
    cores = available_cores()
    print(f"N=200, M={asked.poses}, K=16, float32, {x.nbytes / 1e6:.0f} MB; NumPy {np.__version__}, {cores} cores")
    copy = seconds(lambda: x.copy(), asked.times)
    row("copying the array", copy, copy, "itself")

    for fast, plain in zip(fast_errors(x, y, 1), plain_errors(x, y), strict=True):
        np.testing.assert_allclose(fast, plain, rtol=1e-4, atol=1e-3)
    plain_time = seconds(lambda: plain_errors(x, y), max(1, asked.times // 2))
    row("minMPJPE + PCK + 3 ECE, plain NumPy", plain_time, plain_time, "itself")
    for threads in dict.fromkeys((1, cores)):
        ours = seconds(lambda threads=threads: fast_errors(x, y, threads), asked.times)
        row(f"minMPJPE + PCK + 3 ECE, blocks, {threads} thread(s)", ours, plain_time, "faster than plain")

    difference = np.abs(fast_procrustes(x, y, 1) - plain_procrustes(x, y)).max()
    svd_time = seconds(lambda: plain_procrustes(x, y), max(1, asked.times // 2))
    row(f"Procrustes, batched SVD (differs by {difference:.1e} mm at most)", svd_time, svd_time, "itself")
    for threads in dict.fromkeys((1, cores)):
        ours = seconds(lambda threads=threads: fast_procrustes(x, y, threads), asked.times)
        row(f"Procrustes, blocks, {threads} thread(s)", ours, svd_time, "faster than SVD")

    pairs = PoseData(x, y, axes="NMKD", unit="mm")
    families = {
        "position": "min_mpjpe, mpjpe, mean_pose_mpjpe",
        "Procrustes": "pa_min_mpjpe, cps",
        "PCK": "pck, auc",
        "calibration": "ece, ece_paper, ece_reference",
        "spread": "radius_50, radius_90, diversity",
        "the default report": "default",
    }
    for name, metrics in families.items():
        for threads in (1,) if metrics != "default" else dict.fromkeys((1, cores)):
            protocol = Protocol(metrics=metrics)
            time_ = seconds(lambda p=protocol, t=threads: accumulate(pairs, p, threads=t), asked.times)
            print(
                f"{f'{name}, {threads} thread(s)':58} {time_ * 1e3:9.1f} ms   {time_ / copy:6.1f} × the time of copying"
            )


if __name__ == "__main__":
    main()
