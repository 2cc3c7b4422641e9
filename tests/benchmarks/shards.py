"""Many files as one test set: the same numbers, the time with more workers, the merge of many results, and a large set.

    python tests/benchmarks/shards.py equality              # every row against one run, by shards and executors
    python tests/benchmarks/shards.py clips                 # the same of clips of predicted motion
    python tests/benchmarks/shards.py workers --most 4      # time against the number of processes
    python tests/benchmarks/shards.py merge --shards 10000  # time and memory of merging saved results
    python tests/benchmarks/shards.py sizes                 # what a cell and a pose take, and the time of each pass
    python tests/benchmarks/shards.py large --gigabytes 20  # a set in pieces: time, peak memory, time of reading alone

Each prints a table in Markdown. ``large`` writes shards of a gigabyte into a temporary folder, evaluates them in other
processes, and deletes them.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

import posecal
from posecal.data.write import Archive
from posecal.engine.merge import merge_tree
from posecal.engine.pose_hashes import MOST_HASHES
from posecal.engine.totals import Totals
from posecal.evaluation.shard_passes import Method, Shard, Task, accumulate, summarize
from posecal.stats.skill import MOST_POSES
from tests.helpers import sharded_clips
from tests.helpers.sharded import OPTIONS, cuts, frames, largest_difference

JOINTS = posecal.JOINT_SETS["h36m-17"]
N, K, D = 200, 17, 3
PER_POSE = N * K * D * 4


@contextmanager
def executor(kind: str) -> Iterator[Callable[..., Any]]:
    """Give the map of an executor."""
    if kind == "this process":
        yield map
    elif kind == "2 threads":
        with ThreadPoolExecutor(2) as threads:
            yield threads.map
    elif kind == "2 processes":
        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
            yield pool.map
    else:
        from distributed import Client, LocalCluster

        with (
            LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            yield client.get_executor().map


def equality(most: int) -> None:
    """Compare every row of the full report with one run."""
    world, shards = frames(M=most, S=16, N=12), cuts(M=most, S=16)
    one = posecal.evaluate(world.data(), **OPTIONS)
    print(f"| {most:,} poses in shards | executor | rows | largest relative difference |\n|---|---|---|---|")
    for kind in ("this process", "2 threads", "2 processes", "Dask, 2 workers"):
        with executor(kind) as apply:
            for name, parts in shards.items():
                found = posecal.evaluate_shards([world.data(rows) for rows in parts], map=apply, **OPTIONS)
                rows, difference = largest_difference(one, found)
                print(f"| {name} | {kind} | {rows} | {difference:.1e} |", flush=True)


def clips() -> None:
    """Compare every row of the full report of clips by horizon with one run."""
    print("| 16 clips in shards | executor | rows | largest relative difference |\n|---|---|---|---|")
    for kind in ("this process", "2 processes", "Dask, 2 workers"):
        with executor(kind) as apply:
            for name, parts in sharded_clips.CUTS.items():
                order = np.concatenate([np.arange(sharded_clips.C)[part] for part in parts])
                one = posecal.evaluate(sharded_clips.clips(order), **sharded_clips.OPTIONS)
                shards = [sharded_clips.clips(part) for part in parts]
                found = posecal.evaluate_shards(shards, map=apply, **sharded_clips.OPTIONS)
                rows, difference = largest_difference(one, found)
                print(f"| {name} | {kind} | {rows} | {difference:.1e} |", flush=True)


def write_shard(folder: Path, number: int, poses: int) -> tuple[str, str]:
    """Write hypotheses and truth of some poses, a gigabyte for 24,510; they repeat, so that writing takes no time."""
    random = np.random.default_rng(number)
    truth = (random.normal(0, 200, (K, D)) + np.cumsum(random.normal(0, 8, (poses, K, D)), axis=0)).astype(np.float32)
    noise = random.normal(0, 50, (N, 1, K, D)).astype(np.float32)
    names = np.array([f"{number}/{m:06d}" for m in range(poses)])
    about: dict[str, Any] = {"unit": "mm", "joints": np.array(JOINTS), "frame_id": names}
    paths = folder / f"hyps-{number:04d}.npz", folder / f"gt-{number:04d}.npz"
    sequence = np.array([f"{number} {m * 8 // poses}" for m in range(poses)])
    np.savez(paths[1], truth=truth, sequence=sequence, **about)
    offset = (random.normal(0, 40, (poses, K, D)) + truth).astype(np.float32)
    spread = random.uniform(0.5, 1.5, (poses, 1, 1)).astype(np.float32)
    with paths[0].open("wb") as file, Archive(file) as archive:
        pieces = (offset + spread * one for one in noise)
        archive.add_pieces("hypotheses", (N, poses, K, D), np.dtype(np.float32), pieces)
        for name, value in {**about, "axes": np.array("NMKD")}.items():
            archive.add(name, np.asarray(value))
    return str(paths[0]), str(paths[1])


def workers(most: int, poses: int) -> None:
    """Time an evaluation against the number of processes."""
    with tempfile.TemporaryDirectory() as folder:
        pairs = [write_shard(Path(folder), number, poses) for number in range(8)]
        print("| workers | seconds | poses a second |\n|---|---|---|")
        for number in range(1, most + 1):
            with ProcessPoolExecutor(number, mp_context=multiprocessing.get_context("spawn")) as pool:
                list(pool.map(abs, range(number)))
                start = time.perf_counter()
                posecal.evaluate_shards(pairs, map=pool.map)
                seconds = time.perf_counter() - start
            print(f"| {number} | {seconds:.1f} | {8 * poses / seconds:,.0f} |", flush=True)


def merge(number: int) -> None:
    """Time the merge of so many results of one sequence each, and of as many parts of 16 sequences."""
    world = frames(M=64, S=4, N=50)
    first = posecal.evaluate(world.data(), metrics="default").totals
    print("| results | cells of each | cells of the sum | seconds of a core | MB of the sum | peak MB beyond before |")
    print("|---|---|---|---|---|---|")
    for what in ("the same sequences", "sequences of their own"):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        start = time.process_time()
        total = merge_tree(copies(first, number, what))
        seconds = time.process_time() - start
        size = sum(values.nbytes for values in (*total.sums.values(), *total.counts.values(), *total.per_pose.values()))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        row = f"{number:,}, of {what} | {len(first.poses)} | {len(total.poses):,} | {seconds:.1f} | {size / 1e6:,.0f}"
        print(f"| {row} | {peak / 1e3:,.0f} |", flush=True)


def copies(totals: Totals, number: int, what: str) -> Iterator[Totals]:
    """Give as many results, each of other poses."""
    random = np.random.default_rng(0)
    for one in range(number):
        hashes = np.sort(random.integers(1, 2**63, (len(totals.pose_hashes), 2)).astype(np.uint64), axis=0)
        cells = dict(totals.cells)
        if what == "sequences of their own":
            cells["sequence"] = np.array([f"{one} {name}" for name in cells["sequence"]])
        yield replace(totals, cells=cells, pose_hashes=hashes)


def sizes(poses: int) -> None:
    """Measure what a cell and a pose take, and how long each pass over a shard is."""
    with tempfile.TemporaryDirectory() as folder:
        pair = write_shard(Path(folder), 0, poses)
        shard, method = Shard("shard", *pair), Method(posecal.Protocol(), threads=1)
        start = time.process_time()
        summary = summarize(shard, method, is_pooled=True)
        first = time.process_time() - start
        start = time.process_time()
        totals = accumulate(Task("shard", ((shard, None),)), replace(method, prepared=summary.prepared))
        second = time.process_time() - start
        assert totals is not None
        assert summary.pool is not None
        posecal.save_totals(totals, Path(folder, "result.npz"))
        stored = Path(folder, "result.npz").stat().st_size
    cells = len(totals.poses)
    of_cells = sum(values.nbytes for values in (*totals.sums.values(), *totals.counts.values())) / cells
    of_poses = (sum(values.nbytes for values in totals.per_pose.values()) + totals.cell_of.nbytes) / poses
    rows = {
        "a cell of the default metrics": f"{of_cells:,.0f} bytes",
        "a pose, for rank correlation and sparsification": f"{of_poses:,.0f} bytes",
        "a pose, by which shards that share it are found": f"{summary.keys.nbytes / poses:,.0f} bytes",
        "hashes in a result, at most": f"{16 * MOST_HASHES:,} bytes",
        "poses that climatology samples, at most": f"{summary.pool.truth[0].nbytes * MOST_POSES / 1e6:.1f} MB",
        f"a saved result of {poses:,} poses in {cells} cells": f"{stored:,} bytes",
        "first pass, a pose": f"{1e6 * first / poses:,.0f} µs of a core",
        "second pass, a pose": f"{1e6 * second / poses:,.0f} µs of a core",
    }
    print("| what | measured |\n|---|---|")
    for what, size in rows.items():
        print(f"| {what} | {size} |")


def forget(pairs: Sequence[tuple[str, str]]) -> None:
    """Let the system drop its copies of the files in memory, so that they are read from the disk."""
    os.sync()
    for path in (path for pair in pairs for path in pair):
        with open(path, "rb") as file:
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def large(gigabytes: int, processes: int) -> None:
    """Evaluate a set of so many gigabytes in pieces of one."""
    poses = round(1e9 / PER_POSE)
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        pairs = [write_shard(Path(folder), number, poses) for number in range(gigabytes)]
        print(f"wrote {gigabytes} GB in {time.perf_counter() - start:,.0f} s", flush=True)
        forget(pairs)
        start = time.perf_counter()
        for path, _ in pairs:
            with open(path, "rb", buffering=0) as file:
                while file.read(1 << 24):
                    pass
        reading = time.perf_counter() - start
        forget(pairs)
        command = [sys.executable, "-m", "posecal", "evaluate", f"{folder}/hyps-*.npz", f"{folder}/gt-*.npz"]
        start = time.perf_counter()
        subprocess.run([*command, "--workers", str(processes)], check=True, stdout=subprocess.DEVNULL)
        seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    print("| GB | poses | processes | seconds | reading alone | peak memory of the largest process |")
    print("|---|---|---|---|---|---|")
    total = f"{gigabytes} | {gigabytes * poses:,} | {processes} | {seconds:,.0f} | {reading:,.0f} | {peak:,.0f} MB"
    print(f"| {total} |", flush=True)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("equality", "clips", "workers", "merge", "sizes", "large"))
    parser.add_argument("--poses", type=int, default=2400, help="of equality, and of each of 8 shards of workers")
    parser.add_argument("--most", type=int, default=4, help="workers")
    parser.add_argument("--shards", type=int, default=10_000, help="results that are merged")
    parser.add_argument("--gigabytes", type=int, default=20)
    options = parser.parse_args()
    if options.what == "equality":
        equality(options.poses)
    elif options.what == "clips":
        clips()
    elif options.what == "workers":
        workers(options.most, options.poses)
    elif options.what == "merge":
        merge(options.shards)
    elif options.what == "sizes":
        sizes(options.poses)
    else:
        large(options.gigabytes, options.most)


if __name__ == "__main__":
    main()
