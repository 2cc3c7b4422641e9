"""Tests against mutants, in forked processes and copies of the tree."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import resource
import shutil
import signal
import sys
import time
import warnings
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.mutation.mutants import Mutant

_NOT_COPIED = shutil.ignore_patterns(
    ".git", ".venv", ".nox", ".*_cache", ".hypothesis", "_build", "build", "dist", "*.egg-info"
)
_MEMORY = 8 << 30
"""Bytes that the tests of one mutant may use; one that asks for more fails with a MemoryError."""
_OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", "-W", "ignore::pytest.PytestWarning")


class Outcome(NamedTuple):
    """What the tests said of a mutant."""

    result: str
    """killed, timeout, survived or accepted."""
    test: str = ""
    """The first test that failed, if one did."""


class BaselineError(Exception):
    """Tests that fail without any fault."""


class Recorder:
    """pytest plugin: what killed the most mutants so far runs first, and the first failure is written down."""

    def __init__(self, kills: Counter[str], note: Path) -> None:
        self.kills = kills
        self.note = note

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: -self.kills[item.nodeid])

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.note.write_text(report.nodeid, encoding="utf-8")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.note.write_text(report.nodeid, encoding="utf-8")


class Runner:
    """Runs tests in forked processes, so that Python, pytest and libraries are imported once.

    ``tree0`` stays as it was copied; the others, one for each job, hold one mutant at a time.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        self.folder = folder
        self.root = root
        self.packages = {entry.stem for entry in root.iterdir() if entry.is_dir() or entry.suffix == ".py"}
        self.kills: Counter[str] = Counter()
        self.seconds: dict[str, float] = {}
        shutil.copytree(root, self.tree(0), ignore=_NOT_COPIED)

    def tree(self, number: int) -> Path:
        """Folder of a copy of the tree."""
        return self.folder / f"tree{number}"

    def baseline(self, tests: list[str]) -> float:
        """Run each test file without a fault, once for all modules; give the seconds of all of them."""
        for test in tests:
            if test not in self.seconds:
                self.seconds[test] = self._without_fault(test)
        if not any(self.seconds[test] for test in tests):
            raise BaselineError(f"no quick test in:\n  {' '.join(tests)}")
        return sum(self.seconds[test] for test in tests)

    def _without_fault(self, test: str) -> float:
        """Run one test file; import the libraries that it uses here; give the seconds, 0 where none of it is quick."""
        began = time.monotonic()
        self._start(0, [test], limit=3600, learn=True)
        _, status = self._wait()
        if status == pytest.ExitCode.NO_TESTS_COLLECTED:
            return 0.0
        if status:
            log = self.tree(0).with_suffix(".log").read_text(encoding="utf-8", errors="replace")
            raise BaselineError(f"exit status {status} without any fault of:\n  {test}\n{log[-3000:]}")
        seconds = time.monotonic() - began
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for name in self.tree(0).with_suffix(".libraries").read_text(encoding="utf-8").split():
                if name not in sys.modules and "pytest" not in name and "xdist" not in name:
                    with contextlib.suppress(Exception):
                        importlib.import_module(name)
        gc.freeze()
        return seconds

    def judge(
        self, mutants: list[Mutant], tests: list[str], limit: float, jobs: int
    ) -> Iterator[tuple[Mutant, Outcome]]:
        """Run tests against the mutants of one module, several at a time; yield each as it ends."""
        queue = deque(mutants)
        free = list(range(1, jobs + 1))
        running: dict[int, tuple[int, Mutant]] = {}
        for number in free:
            if not self.tree(number).exists():
                shutil.copytree(self.tree(0), self.tree(number))
        try:
            while queue or running:
                while queue and free:
                    number, mutant = free.pop(), queue.popleft()
                    self._write(number, mutant)
                    running[self._start(number, tests, limit)] = number, mutant
                process, status = self._wait()
                number, mutant = running.pop(process)
                shutil.copy2(self.tree(0) / mutant.path, self.tree(number) / mutant.path)
                free.append(number)
                note = self.tree(number).with_suffix(".note")
                test = note.read_text(encoding="utf-8") if status > 0 and note.exists() else ""
                self.kills[test] += bool(test)
                yield mutant, Outcome({0: "survived", -signal.SIGALRM: "timeout"}.get(status, "killed"), test)
        finally:
            for process in running:
                os.killpg(process, signal.SIGKILL)

    def _write(self, number: int, mutant: Mutant) -> None:
        file = self.tree(number) / mutant.path
        file.write_text(mutant.source, encoding="utf-8")
        for compiled in file.parent.glob(f"__pycache__/{file.stem}.*.pyc"):
            compiled.unlink()

    def _start(self, number: int, tests: Iterable[str], limit: float, learn: bool = False) -> int:
        tree = self.tree(number)
        tree.with_suffix(".note").unlink(missing_ok=True)
        process = os.fork()
        if process:
            return process
        status = 3
        try:
            status = self._run(tree, tests, limit, learn)
        finally:
            os._exit(status)

    def _run(self, tree: Path, tests: Iterable[str], limit: float, learn: bool) -> int:
        """Run pytest in a child: its own process group, time limit, memory limit, output file and modules."""
        os.setsid()
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, limit)
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
        log = os.open(tree.with_suffix(".log"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.chdir(tree)
        for name in [name for name in sys.modules if name.partition(".")[0] in self.packages]:
            del sys.modules[name]
        sys.path[:] = [str(tree), *(entry for entry in sys.path if Path(entry).resolve() != self.root)]
        importlib.invalidate_caches()
        os.environ["PYTHONPATH"] = str(tree)
        if not learn:  # a compiled mutant would be taken for the next one
            sys.dont_write_bytecode = True
            os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        recorder = Recorder(self.kills, tree.with_suffix(".note"))
        status = int(pytest.main([*_OPTIONS, f"--rootdir={tree}", *tests], plugins=[recorder]))
        if learn:
            libraries = [name for name in sys.modules if name.partition(".")[0] not in self.packages]
            tree.with_suffix(".libraries").write_text("\n".join(libraries), encoding="utf-8")
        return status

    def _wait(self) -> tuple[int, int]:
        """Wait for a child; give its process number and exit status, negative for a signal."""
        process, status = os.wait()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process, signal.SIGKILL)  # commands that its tests left running
        return process, os.waitstatus_to_exitcode(status)
