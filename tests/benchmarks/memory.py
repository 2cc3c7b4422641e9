"""Peak memory of ``posecal evaluate`` for a file larger than memory should have to hold.

    python tests/benchmarks/memory.py --gigabytes 4

Writes hypotheses of so many gigabytes (N=200, K=17, float32) into a temporary folder, in either order of the axes and
compressed, evaluates each in a process of its own, and prints the most memory that this process held at any time
(``ru_maxrss``, so mapped pages count).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.data.skeleton import JOINT_SETS, Skeleton
from posecal.data.write import Archive

N, K = 200, 17
KINDS = ("NMKD", "MNKD", "compressed")
CYCLE = 60
"""Poses repeat after so many: within what zip looks back on, so that compressing them takes no time."""

Array = npt.NDArray[np.float32]


def poses_of(gigabytes: float) -> int:
    """Give the number of poses of a file of this size."""
    return round(gigabytes * 1e9 / (N * K * 3 * 4))


def cycle(which: int) -> Array:
    """Give the repeating poses of a hypothesis, or of the truth (-1), in whole mm."""
    moved = np.random.default_rng([7, which + 1]).integers(-60, 61, (CYCLE, K, 3))
    moved[:, 0] = 0
    return (Skeleton(JOINT_SETS["h36m-17"]).rest_pose + moved).astype(np.float32)


def write(folder: Path, gigabytes: float, kind: str) -> tuple[Path, Path]:
    """Write hypotheses and truth, piece by piece."""
    poses = poses_of(gigabytes)
    names = np.array(JOINT_SETS["h36m-17"])
    sequence = np.char.add("s", (np.arange(poses) * 20 // poses).astype(np.str_))
    hypotheses, truth = folder / f"{kind}.npz", folder / "gt.npz"
    np.savez(truth, truth=np.resize(cycle(-1), (poses, K, 3)), unit="mm", joints=names, sequence=sequence)

    def pieces() -> Iterator[Array]:
        if kind == "MNKD":
            repeated = np.stack([cycle(n) for n in range(N)], axis=1)
            for start in range(0, poses, CYCLE):
                yield repeated[: poses - start]
        else:
            for n in range(N):
                yield np.resize(cycle(n), (poses, K, 3))

    shape = (poses, N, K, 3) if kind == "MNKD" else (N, poses, K, 3)
    with hypotheses.open("wb") as file, Archive(file, compressed=kind == "compressed") as archive:
        archive.add_pieces("hypotheses", shape, np.dtype(np.float32), pieces())
        archive.add("axes", np.array("MNKD" if kind == "MNKD" else "NMKD"))
        archive.add("unit", np.array("mm"))
        archive.add("joints", names)
    return hypotheses, truth


WATCH = (
    "import resource, subprocess, sys; done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL); "
    "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(done.returncode)"
)
"""A small process in between: a child is counted with what its parent held when it was started."""


def peak(*words: str | Path) -> float:
    """Run posecal, and give the most memory that it held, in MB (10⁶ bytes)."""
    command = [sys.executable, "-c", WATCH, sys.executable, "-m", "posecal", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return int(done.stdout) * 1024 / 1e6


def main() -> None:
    """Write, evaluate and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=4.0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--metrics", default="default")
    parser.add_argument("--threads", default="2")
    parser.add_argument("--folder", type=Path, help="Where temporary files go.")
    said = parser.parse_args()
    for kind in said.kinds:
        with tempfile.TemporaryDirectory(dir=said.folder) as folder:
            files = write(Path(folder), said.gigabytes, kind)
            start = time.perf_counter()
            found = peak("evaluate", *files, "--metrics", said.metrics, "--threads", said.threads)
            took = time.perf_counter() - start
        print(
            f"{kind:10}  {said.gigabytes:g} GB, M = {poses_of(said.gigabytes):,} poses, metrics {said.metrics}: "
            f"peak {found:,.0f} MB, {took:,.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
