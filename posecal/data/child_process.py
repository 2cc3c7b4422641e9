"""Reading by compiled libraries in a child process, which a damaged file may crash or keep busy without end.

HDF5, MATLAB files and C3D have no checksums, and their libraries believe what a file says of its own structure. In a
child process that costs no more than the file.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

from posecal.errors import PosecalError, PoseFileError, refuse_unreadable

T = TypeVar("T")

SECONDS, BYTES_PER_SECOND = 7.0, 1 << 20
"""How long the reading of a file may take: so many seconds of a processor, and one more for each so many bytes."""

_BUSY = 10
"""How many times as long a busy machine may take."""

_MEMORY, _TIMES = 1 << 30, 64
"""How many bytes the child may take: so many, and so many times those of the file."""


def seconds_for(path: Path) -> float:
    """Give how many seconds of a processor the reading of a file may take."""
    return SECONDS + path.stat().st_size / BYTES_PER_SECOND


def run_in_child(path: Path, function: Callable[..., T], *arguments: Any) -> T:
    """Call a function that reads a file in a Python of its own, with limits of time and memory.

    Parameters
    ----------
    path : Path
        The file, to which the limits are proportional.
    function : callable
        One of a module, so that the child can import it.
    *arguments
        What it is called with; they and the result are pickled.

    Returns
    -------
    object
        What the function gives.

    Raises
    ------
    PoseFileError
        Where the child ends by itself, or takes too long.
    PosecalError
        What the function raises, and whatever else as a refusal of the file.
    """
    with refuse_unreadable(path):
        seconds, size = seconds_for(path), path.stat().st_size
    request = pickle.dumps((path, seconds, size, function, arguments))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", f"from {__name__} import _serve; _serve()"]
    most = seconds * _BUSY if hasattr(signal, "SIGXCPU") else seconds  # where processor time is not limited
    try:
        child = subprocess.run(command, input=request, capture_output=True, env=environment, timeout=most)
    except subprocess.TimeoutExpired:
        raise PoseFileError(f"{path.name}: reading it takes more than {most:.0f} s. Is it damaged?") from None
    if hasattr(signal, "SIGXCPU") and child.returncode == -signal.SIGXCPU:
        raise PoseFileError(f"{path.name}: reading it takes more than {seconds:.0f} s. Is it damaged?")
    try:
        result = pickle.loads(child.stdout)  # noqa: S301 (of our own child)
    except (EOFError, pickle.UnpicklingError):
        raise PoseFileError(f"{path.name}: its library crashes on it. It is damaged: copy it again.") from None
    if isinstance(result, PosecalError):
        raise result
    return result  # type: ignore[no-any-return]


def _serve() -> None:
    """Answer one request: read a function and its arguments, write what it gives or how it refuses."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    path, seconds, size, function, arguments = pickle.loads(sys.stdin.buffer.read())  # noqa: S301 (of our own parent)
    _limit("RLIMIT_CORE", 0)
    _limit("RLIMIT_DATA", _MEMORY + _TIMES * size)
    _limit("RLIMIT_CPU", math.ceil(time.process_time() + seconds))
    try:
        with refuse_unreadable(path):
            result = function(*arguments)
    except PosecalError as refusal:
        result = refusal
    with answer:
        pickle.dump(result, answer, protocol=pickle.HIGHEST_PROTOCOL)
    answer.close()
    os._exit(0)  # without the clean-up of a library that a damaged file may have confused


def _limit(name: str, most: int) -> None:
    with contextlib.suppress(ImportError, AttributeError, ValueError, OSError):  # not on every system
        import resource

        kind = getattr(resource, name)
        resource.setrlimit(kind, (most, resource.getrlimit(kind)[1]))


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Interrupt Python code that computes too long, where signals reach it: in the main thread, on Unix.

    Raises
    ------
    TimeoutError
        After so many seconds of a processor.
    """

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"it takes more than {seconds:.0f} s")

    try:
        before = signal.signal(signal.SIGPROF, interrupt)
    except (AttributeError, ValueError):
        yield
        return
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
