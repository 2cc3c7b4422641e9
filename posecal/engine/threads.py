"""Tasks on threads, with results in the order of the tasks."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from posecal.errors import PoseDataError

Result = TypeVar("Result")


def run_in_order(tasks: Iterable[Callable[[], Result]], threads: int | None = None) -> Iterator[Result]:
    """Run tasks on threads and yield their results in the order of the tasks.

    Parameters
    ----------
    tasks : iterable of callables
        Started one by one, a few ahead of the last result that was yielded.
    threads : int, optional
        How many; by default one per core that this process may use.

    Yields
    ------
    object
        The result of each task.

    Raises
    ------
    PoseDataError
        For a number of threads that is none.

    Notes
    -----
    NumPy releases the interpreter's lock in its loops, so threads over blocks scale. Results are added up by one thread
    in the order of the poses: numbers don't depend on the number of threads.
    """
    if threads is None:
        threads = available_cores()
    if not hasattr(threads, "__index__") or threads < 1:
        raise PoseDataError(f"threads: {threads!r}; expected a whole number, at least 1.")
    if threads == 1:
        for task in tasks:
            yield task()
        return
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for task in tasks:
                waiting.append(pool.submit(task))
                if len(waiting) > 2 * threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def available_cores() -> int:
    """Give the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
