"""Runs of a command on changed files, in processes of their own that may be ended."""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import io
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection, wait
from pathlib import Path
from random import Random
from typing import Any

from posecal.errors import PosecalError
from tests.robustness import files, library_files
from tests.robustness.files import Case

SECONDS, BYTES = 10.0, 10**9
"""The longest time and the most memory that a command may take."""

BUSY = 30
"""How many times as long it may take on a machine that is busy, as long as it computes no longer."""

IN_CHILD = {".c3d", ".h5", ".mat"}
"""Files that are read in a child process, each of which takes half a second: they are changed a fifth as often."""


@dataclass(frozen=True)
class Outcome:
    """What came of one changed file.

    Attributes
    ----------
    number : int
        Which.
    kind : str
        ``same`` (what it gives of the file as it was), ``other`` (other numbers), ``refused``, ``wrong call``, or a
        fault: ``traceback``, ``warning``, ``left a file``, ``damaged, and accepted``, ``memory``, ``hang``, ``crash``.
    case, change, words : str
        The command, the change, and what was said.
    seconds : float
        Time.
    """

    number: int
    kind: str
    case: str
    change: str
    words: str
    seconds: float

    @property
    def is_fault(self) -> bool:
        """Whether a command must never end so."""
        return self.kind not in {"same", "other", "refused", "wrong call"}


class Workshop:
    """A folder with all files, in which commands run on changed ones.

    Parameters
    ----------
    folder : Path
        An empty one.
    seed : int
        Of all changes.
    libraries : bool
        Whether to make files of extras and of estimators too.
    """

    def __init__(self, folder: Path, seed: int, *, libraries: bool = True) -> None:
        self.folder, self.seed = folder, seed
        os.chdir(folder)
        files.write_core(folder)
        files.write_foreign(folder)
        cases: list[Case] = [*files._core(), *(library_files.library_cases(folder) if libraries else ())]
        self.cases = [*[case for case in cases if Path(case.file).suffix not in IN_CHILD] * 4, *cases]
        self.wholes = {case.file: (folder / case.file).read_bytes() for case in self.cases}
        self.there = self._listing()
        self.clean = self._stored(self.there)
        self.plain: dict[str, bytes] = {}

    def _listing(self) -> set[Path]:
        return {path for path in self.folder.rglob("*") if path.is_file()}

    def _stored(self, paths: set[Path]) -> dict[Path, tuple[int, int]]:
        return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in paths}

    def changed(self, number: int) -> tuple[Case, Any, bytes]:
        """Give the case of a number, the change, and the changed file."""
        chance = Random(f"{self.seed}/{number}")
        case = self.cases[number % len(self.cases)]
        change = chance.choice(case.changes)
        return case, change, change(self.wholes[case.file], chance)

    def run(self, number: int) -> Outcome:
        """Run a command on a changed file, and put all files back."""
        case, change, contents = self.changed(number)
        if case.name not in self.plain:
            code, said, given = self._call(case, self.wholes[case.file])
            assert code == 0 or case.words[0] in {"train", "convert"}, (case.name, code, said)
            self.plain[case.name] = given
        start, base = time.perf_counter(), _reset_peak()
        code, said, given = self._call(case, contents)
        seconds, grown = time.perf_counter() - start, _peak() - base
        exact, same = case.exact(change), given == self.plain[case.name]
        kind = {0: "same" if same else "other", 2: "wrong call", 3: "refused"}.get(code, "traceback")
        if kind == "traceback":
            pass
        elif "Warning:" in said:
            kind = "warning"
        elif code and given.startswith(b"left"):
            kind = "left a file"
        elif code == 0 and exact and not same:
            kind = "damaged, and accepted"
        elif grown > BYTES:
            kind, said = "memory", f"{grown:,} bytes; {said}"
        return Outcome(number, kind, case.name, getattr(change, "__name__", "?"), said, seconds)

    def _call(self, case: Case, contents: bytes) -> tuple[int, str, bytes]:
        """Run a command; give the exit code, stderr, and stdout with all outputs."""
        path = self.folder / case.file
        path.write_bytes(contents)
        before = self._stored({path})
        out, err = io.StringIO(), io.StringIO()
        code = 1
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
                warnings.simplefilter("always")
                _command(case)
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
        except PosecalError as error:
            code = 3
            err.write(str(error))
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            err.write("".join(traceback.format_exception(error)[-12:]))
        written = {new for new in self._listing() if self.clean.get(new) != self._stored({new})[new] and new != path}
        if before != self._stored({path}):
            written.add(path)
        outputs = b"".join(
            new.name.encode() + new.read_bytes() for new in sorted(written) if new.suffix in {".npz", ".json"}
        )
        given = b"left" * bool(written and code) + out.getvalue().encode("utf-8", "replace") + outputs
        self._put_back(written | {path}, case)
        return code, err.getvalue(), given

    def _put_back(self, paths: set[Path], case: Case) -> None:
        for path in paths:
            if path in self.there and str(path.relative_to(self.folder)) in self.wholes:
                path.write_bytes(self.wholes[str(path.relative_to(self.folder))])
            else:
                path.unlink(missing_ok=True)
        shutil.rmtree(self.folder / "out", ignore_errors=True)
        self.clean |= self._stored({path for path in paths if path.exists()})


@cache
def _app(name: str) -> Any:
    import typer

    from posecal.cli import app as core

    if name == "posecal":
        return typer.main.get_command(core)
    from posecal_models.cli import app as models

    return typer.main.get_command(models)


def _command(case: Case) -> None:
    if case.command == "python":
        module, function, path = case.words
        getattr(importlib.import_module(module), function)(path, ["S1"])
        return
    _app(case.command).main([*case.words], prog_name=case.command)


def _reset_peak() -> int:
    """Let the peak of memory begin anew, and give what is used now."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS:")


def _peak() -> int:
    return _status("VmHWM:")


def _status(key: str) -> int:
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith(key)) * 1024
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _computed(process: int) -> float:
    """How many seconds of a processor a process and its ended children have taken; all time where that is unknown."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return time.monotonic()


def _hangs(worker: dict[str, Any]) -> bool:
    """Whether a process takes longer than it may."""
    waited = time.monotonic() - worker["since"]
    computes = waited > SECONDS and _computed(worker["process"].pid) - worker["computed"] > SECONDS
    return computes or waited > SECONDS * BUSY


# --- processes ------------------------------------------------------------------------------------------------


def _work(pipe: Connection, seed: int, numbers: list[int]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        os.environ["COLUMNS"] = "200"
        with contextlib.suppress(ImportError):
            import torch

            torch.set_num_threads(1)
        shop = Workshop(Path(folder), seed)
        _limit_memory(4 * BYTES)
        for number in numbers:
            case, change, _ = shop.changed(number)
            pipe.send((number, case.name, getattr(change, "__name__", "?")))
            faulthandler.dump_traceback_later(SECONDS * BUSY - 1)  # where it hangs, before it is ended
            pipe.send(shop.run(number))
            faulthandler.cancel_dump_traceback_later()
        os.chdir("/")
    pipe.send(None)


def _limit_memory(more: int) -> None:
    """Let no call bring the machine down; the peak is compared with less."""
    with contextlib.suppress(ValueError, OSError):
        used = _status("VmData:")
        resource.setrlimit(resource.RLIMIT_DATA, (used + more, resource.getrlimit(resource.RLIMIT_DATA)[1]))


def outcomes(numbers: list[int], seed: int, jobs: int) -> Iterator[Outcome]:
    """Run the cases of these numbers in some processes; one that hangs or dies is replaced."""
    context = multiprocessing.get_context("spawn")
    todo = [numbers[job::jobs] for job in range(jobs)]
    workers: dict[Connection, dict[str, Any]] = {}

    def start(rest: list[int]) -> None:
        here, there = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(there, seed, rest), daemon=True)
        process.start()
        there.close()
        workers[here] = {"process": process, "rest": rest, "at": None, "since": time.monotonic() + 120}

    for rest in filter(None, todo):
        start(rest)
    while workers:
        ready = wait(list(workers), timeout=1.0)
        for pipe in list(workers):
            worker, lost = workers[pipe], ""
            if pipe in ready:
                try:
                    message = pipe.recv()  # type: ignore[union-attr]
                except EOFError:
                    lost = "crash"
                else:
                    if isinstance(message, Outcome):
                        yield message
                        worker["rest"], worker["at"] = worker["rest"][1:], None
                    elif message is None:
                        del workers[pipe]
                        worker["process"].join()
                    else:
                        worker["at"], worker["since"] = message, time.monotonic()
                        worker["computed"] = _computed(worker["process"].pid)
            elif worker["at"] is not None and _hangs(worker):
                lost = "hang"
            if lost:
                worker["process"].kill()
                worker["process"].join()
                del workers[pipe]
                said = f"exit code {worker['process'].exitcode}"
                if worker["at"] is None:
                    raise RuntimeError(f"a process ended by itself: {said}")
                number, case, change = worker["at"]
                yield Outcome(number, lost, case, change, said, time.monotonic() - worker["since"])
                if worker["rest"][1:]:
                    start(worker["rest"][1:])
