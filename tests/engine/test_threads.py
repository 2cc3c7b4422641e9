"""Tasks on threads: results, their order, and errors."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

from posecal.engine import threads as threads_module
from posecal.engine.threads import available_cores, run_in_order
from posecal.errors import PoseDataError


def number(value: int, gate: threading.Event | None = None) -> Callable[[], int]:
    def run() -> int:
        if gate is not None:
            gate.wait(10)
        return value

    return run


@pytest.mark.parametrize("threads", [1, 2, 5, None])
def test_results_come_in_the_order_of_the_tasks(threads: int | None) -> None:
    assert list(run_in_order((number(i) for i in range(40)), threads)) == list(range(40))


def test_a_slow_first_task_does_not_let_later_ones_pass() -> None:
    gate = threading.Event()

    def tasks() -> Iterator[Callable[[], int]]:
        yield number(0, gate)
        yield number(1)
        gate.set()
        yield number(2)

    assert list(run_in_order(tasks(), 2)) == [0, 1, 2]


def test_tasks_are_taken_only_a_few_ahead() -> None:
    taken: list[int] = []

    def tasks() -> Iterator[Callable[[], int]]:
        for i in range(100):
            taken.append(i)
            yield number(i)

    results = run_in_order(tasks(), 2)
    assert next(results) == 0
    assert len(taken) <= 2 * 2 + 1
    results.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_in_a_task_comes_out_and_stops_the_rest(threads: int) -> None:
    def fail() -> int:
        raise PoseDataError("truth: a test")

    taken: list[int] = []

    def tasks() -> Iterator[Callable[[], int]]:
        yield fail
        for i in range(100):
            taken.append(i)
            yield number(i)

    with pytest.raises(PoseDataError, match="truth: a test"):
        list(run_in_order(tasks(), threads))
    assert len(taken) < 100


@pytest.mark.parametrize("threads", [0, -1, 1.0, "2"])
def test_a_number_of_threads_that_is_none_is_refused(threads: object) -> None:
    with pytest.raises(PoseDataError, match=r"threads: .*; expected a whole number, at least 1\."):
        next(run_in_order([number(1)], threads))  # type: ignore[arg-type]


def test_without_a_mask_of_cores_all_cores_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(threads_module.os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(threads_module.os, "cpu_count", lambda: 7)
    assert available_cores() == 7
    monkeypatch.setattr(threads_module.os, "cpu_count", lambda: None)
    assert available_cores() == 1
