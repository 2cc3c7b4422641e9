"""Time of the report and of its parts, against the plain NumPy formulas and against copying the array, in one run.

    OMP_NUM_THREADS=1 python tests/benchmarks/speed.py

On N=200, M=2000, K=16, float32 (77 MB): the median of some runs of each way, and ratios. Every fast number is compared
with the plain one's before it is timed. Then the walk over the blocks beside the whole report, made of arrays and
printed, for this and for other shapes (many poses, many joints, many groups and sequences, these also at half their
size), batches beside one call, and clips by horizon. Times on one thread are of the processor.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

import posecal
from posecal.calibration import DEFINITIONS, LEVELS
from posecal.calibration.ranks import inside
from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.per_pose import iter_blocks
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
        errors = aligned_errors(block.offsets, block.truth, block.joint_weights(), "similarity")
        return errors.mean(axis=1).T

    return np.concatenate(list(run_in_order((lambda b=b: measure(b) for b in iter_blocks(x, y)), threads)), axis=1)


class Shape(NamedTuple):
    """How many hypotheses, poses, joints, sequences and groups; 0 for poses without such a label."""

    n: int
    m: int
    k: int
    sequences: int = 0
    groups: int = 0

    def __str__(self) -> str:
        words = f"N={self.n}, M={self.m:,}, K={self.k:,}"
        words += f", {self.sequences:,} sequences" if self.sequences else ""
        return words + (f", {self.groups:,} groups" if self.groups else "")

    def poses(self) -> tuple[FloatArray, FloatArray]:
        """Draw hypotheses (N, M, K, 3) and truth (M, K, 3), mm."""
        random = np.random.default_rng(0)
        y = random.normal(0, 300, (self.m, self.k, 3)).astype(np.float32)
        return (y + random.normal(0, 100, (self.n, *y.shape))).astype(np.float32), y

    @property
    def labels(self) -> dict[str, npt.NDArray[np.str_]]:
        """The labels of the poses."""
        numbers = {"sequence": self.sequences, "group": self.groups}
        return {
            name: (np.arange(self.m) * number // self.m).astype(np.str_) for name, number in numbers.items() if number
        }


REPORTS = (
    Shape(200, 2000, 16),
    Shape(4, 120_000, 4, 236),
    Shape(10, 16, 6890),
    Shape(4, 20_000, 4, 10_000, 1000),
    Shape(4, 20_000, 4, 10_000, 500),
    Shape(4, 20_000, 4, 5000, 1000),
)
"""What the whole report is timed on."""

FAMILIES = {
    "position": "min_mpjpe, mpjpe, mean_pose_mpjpe",
    "Procrustes": "pa_min_mpjpe, cps",
    "PCK": "pck, auc",
    "calibration": "ece, ece_paper, ece_reference",
    "spread": "radius_50, radius_90, diversity",
}


def seconds(run: Callable[[], object], times: int, threads: int = 1) -> float:
    """Median time of a call: of the processor, so that other programs matter less, and by the clock for threads."""
    clock = time.process_time if threads == 1 else time.perf_counter
    durations = []
    for _ in range(times):
        start = clock()
        run()
        durations.append(clock() - start)
    return statistics.median(durations)


def row(name: str, ours: float, ratio: float, what: str) -> None:
    """Print one comparison."""
    print(f"{name:66} {ours * 1e3:9.1f} ms   {ratio:6.2f} {what}", flush=True)


def families(times: int) -> None:
    """Time each family, and the whole report, in copies of the array."""
    x, y = REPORTS[0].poses()
    data = posecal.PoseData(x, y, unit="mm", axes="NMKD")
    copy = seconds(x.copy, times)
    row("copying the array", copy, 1, "copies")
    for name, metrics in FAMILIES.items():
        took = seconds(partial(posecal.evaluate, data, metrics=metrics, threads=1), times)
        row(f"{name}, 1 thread", took, took / copy, "copies")
    for threads in dict.fromkeys((1, available_cores())):
        sums = seconds(partial(posecal.evaluate, data, threads=threads), times, threads)
        row(f"the default report, its sums alone, {threads} thread(s)", sums, sums / copy, "copies")
        whole = seconds(
            lambda n=threads: str(posecal.evaluate(x, y, unit="mm", axes="NMKD", threads=n)), times, threads
        )
        row(f"the default report, {threads} thread(s)", whole, whole / copy, "copies")


def report(shape: Shape, times: int) -> None:
    """Time the walk over the blocks of some poses, and the whole report from arrays to print."""
    x, y = shape.poses()
    by: Sequence[str] = ("group",) if shape.groups else ()
    data = posecal.PoseData(x, y, unit="mm", axes="NMKD", labels=shape.labels)
    walk = seconds(partial(posecal.evaluate, data, by=by, threads=1), times)
    row(f"{shape}: the walk over the blocks", walk, 1, "walks")

    def whole() -> str:
        return str(posecal.evaluate(x, y, unit="mm", axes="NMKD", labels=shape.labels, by=by, threads=1))

    took = seconds(whole, times)
    row(f"{shape}: the report", took, took / walk, "walks")


def reports(times: int) -> None:
    """Time the report on each shape."""
    for shape in REPORTS:
        report(shape, times)


def batches(times: int) -> None:
    """Time 40 batches of 64 poses beside one call."""
    x, y = Shape(200, 40 * 64, 16).poses()

    def in_batches() -> posecal.Report:
        evaluation = posecal.Evaluation(unit="mm", axes="NMKD", threads=1)
        for start in range(0, len(y), 64):
            evaluation.update(x[:, start : start + 64], y[start : start + 64])
        return evaluation.compute()

    one = seconds(partial(posecal.evaluate, x, y, unit="mm", axes="NMKD", threads=1), times)
    row("N=200, M=2,560, K=16: one call", one, 1, "calls")
    took = seconds(in_batches, times)
    row("N=200, M=2,560, K=16: 40 batches of 64 poses", took, took / one, "calls")


def horizons(times: int) -> None:
    """Time 3,000 clips of 25 frames by horizon, where each clip is a sequence and where clips are of 60 recordings."""
    clips, frames = 3000, 25
    x, y = Shape(10, clips * frames, 16).poses()
    x, y = x.reshape(10, clips, frames, 16, 3), y.reshape(clips, frames, 16, 3)
    for number in (clips, 60):
        labels = {"sequence": np.arange(clips) * number // clips}
        data = posecal.PoseData(x, y, unit="mm", axes="NMTKD", root_joint="none", labels=labels)
        whole = seconds(lambda data=data: str(posecal.evaluate(data, threads=1)), times)
        row(f"N=10, 3,000 clips of T=25, K=16, {number:,} sequences: the report", whole, 1, "reports")
        took = seconds(lambda data=data: str(posecal.evaluate(data, by="horizon", threads=1)), times)
        row(f"N=10, 3,000 clips of T=25, K=16, {number:,} sequences: by horizon", took, took / whole, "reports")


def against_plain(times: int) -> None:
    """Compare with the plain NumPy formulas, in numbers and in time."""
    x, y = REPORTS[0].poses()
    cores = tuple(dict.fromkeys((1, available_cores())))
    for fast, plain in zip(fast_errors(x, y, 1), plain_errors(x, y), strict=True):
        np.testing.assert_allclose(fast, plain, rtol=1e-4, atol=1e-3)
    plain_time = seconds(lambda: plain_errors(x, y), max(1, times // 2))
    row("minMPJPE + PCK + 3 ECE, plain NumPy", plain_time, 1, "× faster than plain")
    for threads in cores:
        ours = seconds(partial(fast_errors, x, y, threads), times, threads)
        row(f"minMPJPE + PCK + 3 ECE, blocks, {threads} thread(s)", ours, plain_time / ours, "× faster than plain")
    difference = np.abs(fast_procrustes(x, y, 1) - plain_procrustes(x, y)).max()
    svd_time = seconds(lambda: plain_procrustes(x, y), max(1, times // 2))
    row(f"Procrustes, batched SVD (differs by {difference:.1e} mm at most)", svd_time, 1, "× faster than SVD")
    for threads in cores:
        ours = seconds(partial(fast_procrustes, x, y, threads), times, threads)
        row(f"Procrustes, blocks, {threads} thread(s)", ours, svd_time / ours, "× faster than SVD")


PARTS: dict[str, Callable[[int], None]] = {
    "plain": against_plain,
    "families": families,
    "reports": reports,
    "batches": batches,
    "horizons": horizons,
}


def main() -> None:
    """Run all comparisons."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--times", type=int, default=5)
    options.add_argument("--parts", nargs="+", choices=PARTS, default=[*PARTS])
    asked = options.parse_args()
    print(f"float32; NumPy {np.__version__}, {available_cores()} cores")
    for part in asked.parts:
        print(f"\n{part}")
        PARTS[part](asked.times)


if __name__ == "__main__":
    main()
