"""Run commands on damaged and edited files: ``python -m tests.robustness --help``."""

# ruff: noqa: T201
from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.robustness.runner import Outcome, Workshop, outcomes


def main() -> int:
    """Run the cases that are asked for, print the faults, and count what came of all."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness", description=__doc__)
    parser.add_argument("--count", type=int, default=20_000, help="how many changed files")
    parser.add_argument("--start", type=int, default=0, help="the number of the first")
    parser.add_argument("--seed", type=int, default=0, help="of all changes")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument(
        "--keep", type=Path, help="an empty folder: make the file of --start, with all others, and stop"
    )
    asked = parser.parse_args()
    if asked.keep:
        asked.keep.mkdir(exist_ok=True)
        shop = Workshop(asked.keep.resolve(), asked.seed)
        case, change, contents = shop.changed(asked.start)
        (shop.folder / case.file).write_bytes(contents)
        print(f"cd {asked.keep} && {case.command} {' '.join(case.words)}    # {case.file}: {change.__name__}")
        return 0
    counts, faults, start = Counter[str](), [], time.perf_counter()
    slowest: list[Outcome] = []
    for one in outcomes([*range(asked.start, asked.start + asked.count)], asked.seed, asked.jobs):
        counts[one.kind] += 1
        slowest = sorted([*slowest, one], key=lambda outcome: -outcome.seconds)[:5]
        if one.is_fault:
            faults.append(one)
            print(described(one, asked.seed), flush=True)
    print(f"{sum(counts.values()):,} files in {time.perf_counter() - start:.0f} s: {dict(counts)}")
    for one in slowest:
        print(f"slow: {one.seconds:.2f} s, {one.number}, {one.case}, {one.change}")
    return bool(faults)


def described(one: Outcome, seed: int) -> str:
    """Say what went wrong, and how to make the very file again."""
    again = f"python -m tests.robustness --seed {seed} --start {one.number} --keep FOLDER"
    return f"{one.kind}: {one.case}, {one.change}\n  {again}\n  {one.words.strip()}"


if __name__ == "__main__":
    tempfile.tempdir = None
    raise SystemExit(main())
