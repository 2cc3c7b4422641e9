"""Run the tests against mutants: ``python -m tests.mutation --help``."""

# ruff: noqa: T201
from __future__ import annotations

import argparse
import json
import os
import random
import re
import shlex
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from tests import mutation
from tests.mutation.mutants import Mutant, mutants_of
from tests.mutation.runner import BaselineError, Outcome, Runner

_OF_METRICS = ("test_definitions.py", "test_laws.py", "test_registry.py", "test_stacked_means.py")
_OF_METRICS += ("test_wrong_arguments.py",)

ALSO = {
    "posecal/calibration/": (
        "test_definitions.py",
        "test_laws.py",
        "test_registry.py",
        "test_stacked_means.py",
        "test_wrong_arguments.py",
    ),
    "posecal/data/": ("test_layout.py", "test_pose_data.py", "test_unreadable_files.py"),
    "posecal/engine/": ("test_definitions.py", "test_laws.py"),
    "posecal/geometry/": ("test_definitions.py", "test_laws.py"),
    "posecal/metrics/": (
        "test_definitions.py",
        "test_laws.py",
        "test_registry.py",
        "test_stacked_means.py",
        "test_wrong_arguments.py",
    ),
    "posecal/data/covariances.py": ("test_gaussian.py", "test_draws.py"),
    "posecal/calibration/curve.py": ("test_error.py",),
    "posecal/calibration/ranks.py": ("test_exactness.py",),
    "posecal/engine/accumulate.py": ("test_averaged.py", "test_batches.py", "test_call.py", "test_failures.py"),
    "posecal/engine/chunks.py": ("test_batches.py",),
    "posecal/engine/metric.py": ("test_own_metrics.py", "test_stacked_means.py"),
    "posecal/engine/prepare.py": ("test_batches.py", "test_call.py", "test_failures.py"),
    "posecal/evaluation/": ("test_batches.py", "test_call.py", "test_failures.py"),
    "posecal/report/report.py": ("test_sheet.py", "test_text.py"),
    "posecal/report/table.py": ("test_report.py",),
    "posecal/stats/jackknife.py": ("test_uncertainty.py",),
    "posecal/stats/remarks.py": ("test_summary.py",),
    "posecal/stats/resampling.py": ("test_uncertainty.py",),
    "posecal/stats/same_poses.py": ("test_comparison_refusals.py",),
    "posecal/metrics/uncertainty.py": ("test_orders.py",),
    "posecal/registry.py": ("test_own_metrics.py", "test_registering.py", "test_explain.py"),
}
"""Test files, wherever they lie, that check every module of a folder, or another one, beside each module's own."""

DEFAULT = (
    *("posecal/metrics", "posecal/calibration", "posecal/geometry", "posecal/stats", "posecal/engine"),
    *("posecal/registry.py", "posecal/report/summary.py", "posecal/report/sentences.py", "posecal/report/evidence.py"),
    *("posecal/report/table.py", "posecal/report/explain.py"),
    *("posecal/data/checks.py", "posecal/data/units.py", "posecal/data/match.py", "posecal/data/declarations.py"),
)
"""What computes, says, checks and matches: the modules of a run that names none."""
EACH = 5
"""Mutants of each of them."""


def find_tests(path: str, root: Path) -> list[str]:
    """Test files of a module, with those of :data:`ALSO`.

    The one that mirrors its path; without it those of its name; without them those that import it.
    """
    module = Path(path)
    package, stem = module.parent, module.stem
    if stem == "__init__":
        package, stem = package.parent, package.name
    mirror = Path("tests", *package.parts[1:], f"test_{stem}.py")
    found = [mirror] if (root / mirror).exists() else _named(f"test_{stem}.py", root)
    found = found or _importing(".".join(package.parts), stem, root)
    for folder, names in ALSO.items():
        found += [test for name in names if path.startswith(folder) for test in _named(name, root)]
    if not found:
        raise SystemExit(f"{path}: no test file of its name or that imports it; expected one. Name some with --tests.")
    return [str(test) for test in dict.fromkeys(found)]


def _importing(package: str, name: str, root: Path) -> list[Path]:
    whole = rf"\b{re.escape(f'{package}.{name}'.lstrip('.'))}\b(?!\.\w+ import)"
    pattern = re.compile(rf"{whole}|from {re.escape(package)} import [^\n]*\b{name}\b" if package else whole)
    return [test for test in _named("test_*.py", root) if pattern.search((root / test).read_text(encoding="utf-8"))]


def _named(name: str, root: Path) -> list[Path]:
    return sorted(test.relative_to(root) for test in (root / "tests").rglob(name))


def survivors(file: Path) -> dict[tuple[str, str, str, str], str]:
    """Accepted survivors and the reason of each."""
    entries = tomllib.loads(file.read_text(encoding="utf-8")).get("survivor", []) if file.exists() else []
    return {(entry["file"], entry["within"], entry["line"], entry["change"]): entry["reason"] for entry in entries}


def options() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutation",
        description=mutation.__doc__,
        epilog=f"Without modules: {EACH} mutants of each in {', '.join(DEFAULT)}.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("modules", nargs="*", help="files or folders, relative to the root (default: see below)")
    parser.add_argument("--sample", type=int, metavar="N", help="at most N mutants of each module, drawn at random")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (default 0)")
    parser.add_argument("--tests", type=shlex.split, help="test files or folders, instead of those of the modules")
    parser.add_argument("--strings", action="store_true", help="change texts too")
    parser.add_argument("--jobs", type=int, default=1, help="mutants at a time (default 1)")
    parser.add_argument("--limit", type=float, help="seconds per mutant (default 3 runs without a fault, and 10 s)")
    parser.add_argument("--least", type=float, default=90, help="share that must be killed, in %% (default 90)")
    parser.add_argument("--report", type=Path, metavar="FILE.json", help="write every mutant and its outcome")
    parser.add_argument("--list", action="store_true", help="print the mutants and run nothing")
    parser.add_argument("--root", type=Path, default=Path(), help="of the tree (default: the current folder)")
    parser.add_argument("--survivors", type=Path, default=Path(__file__).with_name("survivors.toml"))
    said = parser.parse_args()
    if not said.modules:
        said.modules, said.sample = list(DEFAULT), said.sample or EACH
    return said


def drawn(mutants: list[Mutant], most: int | None, seed: int) -> list[Mutant]:
    """Some of the mutants, in their order."""
    if most is None or most >= len(mutants):
        return mutants
    return [mutants[index] for index in sorted(random.Random(seed).sample(range(len(mutants)), most))]


def described(mutant: Mutant) -> str:
    """One line for a mutant."""
    return f"{mutant.path}:{mutant.line} {mutant.within}: {mutant.change}"


def totals(outcomes: Iterable[Outcome]) -> tuple[int, int, Counter[str]]:
    """How many were killed, of how many that are not accepted, and each result's number."""
    counts = Counter(outcome.result for outcome in outcomes)
    return counts["killed"] + counts["timeout"], counts.total() - counts["accepted"], counts


def main() -> int:
    """Run the tests against the mutants of the modules; the exit status is 1 where too few were killed."""
    said = options()
    os.environ |= {"OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    root, accepted = said.root.resolve(), survivors(said.survivors)
    folders = [root / path for path in said.modules]
    files = [file for path in folders for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])]
    outcomes: list[tuple[Mutant, Outcome]] = []
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        runner = Runner(root, Path(folder).resolve())
        plan: list[tuple[str, list[Mutant], list[str]]] = []
        for path in [file.relative_to(root).as_posix() for file in files]:
            source = (runner.tree(0) / path).read_text(encoding="utf-8")
            mutants = drawn(list(mutants_of(path, source, said.strings)), said.sample, said.seed)
            outcomes += [(mutant, Outcome("accepted")) for mutant in mutants if mutant.key in accepted]
            mutants = [mutant for mutant in mutants if mutant.key not in accepted]
            if said.list:
                print(*map(described, mutants), sep="\n")
            elif mutants:
                doctests = [path] if ">>>" in source else []
                plan.append((path, mutants, said.tests or [*find_tests(path, root), *doctests]))
        for path, mutants, tests in plan:
            try:
                seconds = runner.baseline(tests)
            except BaselineError as error:
                print(f"{path}: {error}", file=sys.stderr)
                return 2
            print(f"{path}: {len(mutants)} mutants, {seconds:.1f} s without a fault: {' '.join(tests)}", flush=True)
            for mutant, outcome in runner.judge(mutants, tests, said.limit or 3 * seconds + 10, said.jobs):
                outcomes.append((mutant, outcome))
                if outcome.result == "survived":
                    print(f"SURVIVED {described(mutant)}\n         {mutant.text}", flush=True)
    if said.list:
        return 0
    for path in dict.fromkeys(mutant.path for mutant, _ in outcomes):
        killed, judged, _ = totals(outcome for mutant, outcome in outcomes if mutant.path == path)
        print(f"{path}: {killed} of {judged} killed")
    killed, judged, counts = totals(outcome for _, outcome in outcomes)
    share = 100 * killed / judged if judged else 100.0
    if said.report:
        rows = [{**mutant._asdict(), **outcome._asdict()} for mutant, outcome in outcomes]
        rows = [{name: value for name, value in row.items() if name != "source"} for row in rows]
        said.report.write_text(json.dumps({"killed": share, "mutants": rows}, indent=1), encoding="utf-8")
    words = ", ".join(f"{counts[word]} {word}" for word in ("killed", "timeout", "survived", "accepted"))
    print(f"{words} - {share:.1f} % killed")
    return int(share < said.least)


if __name__ == "__main__":
    sys.exit(main())
