"""posecal as a user's shell runs it: pipes, terminals, full disks and interruptions."""

import contextlib
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.shell import EVALUATE, ROOT, done, spawned


@pytest.mark.slow
def test_the_module_is_the_command(files: Path) -> None:
    process = spawned(*EVALUATE, "--format=csv", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, err = process.communicate()
    assert (process.returncode, out.decode()) == (0, done(*EVALUATE, "--format=csv"))
    assert err == b""


def test_a_refusal_is_one_line_and_the_exit_code_3() -> None:
    process = spawned("evaluate", "no.npz", "gt.npz", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.communicate() == (b"", b"posecal: no.npz: no such file.\n")
    assert process.returncode == 3


@pytest.mark.slow
def test_a_reader_that_leaves_early_makes_no_noise() -> None:
    """As ``posecal … | head -1`` does: the report is longer than what a pipe holds."""
    process = spawned(*EVALUATE, "--format=json", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline() == b"{\n"
    process.stdout.close()
    err = process.stderr.read().decode()
    process.stderr.close()
    process.wait()
    assert "Traceback" not in err
    assert "Exception" not in err
    assert "Broken" not in err


@pytest.mark.slow
def test_a_full_disk_is_one_message() -> None:
    with open("/dev/full", "wb") as full:
        process = spawned(*EVALUATE, "--save=s.npz", stdout=full, stderr=subprocess.PIPE)
        _, err = process.communicate()
    assert process.returncode == 3
    assert "posecal: No space left on device" in err.decode()
    assert "Traceback" not in err.decode()


@contextlib.contextmanager
def terminal() -> Iterator[tuple[int, int]]:
    """Both ends of a terminal: what a person sees, and what a program writes to."""
    seen, written = pty.openpty()
    try:
        yield seen, written
    finally:
        os.close(seen)
        with contextlib.suppress(OSError):
            os.close(written)


def shown(seen: int) -> bytes:
    """Read what is shown on a terminal until the program has left."""
    found = b""
    with contextlib.suppress(OSError):  # Linux's end of a terminal that nobody writes to
        while piece := os.read(seen, 4096):
            found += piece
    return found


@pytest.mark.slow
def test_progress_is_shown_on_a_terminal_and_cleared() -> None:
    with terminal() as (seen, written):
        process = spawned(*EVALUATE, stdout=subprocess.PIPE, stderr=written)
        os.close(written)
        text = shown(seen)
        out, _ = process.communicate()
    assert process.returncode == 0
    assert b"evaluating" in text
    assert b"\x1b[" in text
    assert out.decode() == done(*EVALUATE)


@pytest.mark.slow
def test_several_models_have_a_bar_each_whatever_their_names() -> None:
    for name in ("[red]one.npz", "two.npz"):
        Path(name).write_bytes(Path("hyps.npz").read_bytes())
    with terminal() as (seen, written):
        process = spawned(
            "compare", "[red]one.npz", "two.npz", "gt.npz", "--format=csv", stdout=subprocess.PIPE, stderr=written
        )
        os.close(written)
        text = shown(seen).decode()
        out, _ = process.communicate()
    assert process.returncode == 0, text
    assert "[red]one" in text
    assert "two" in text
    assert out.decode().startswith("metric,")


@pytest.mark.slow
def test_the_report_on_a_terminal_is_as_wide_as_it_and_in_colour() -> None:
    with terminal() as (seen, written):
        environment = {key: value for key, value in os.environ.items() if key not in {"COLUMNS", "NO_COLOR"}}
        process = subprocess.Popen(
            [sys.executable, "-m", "posecal", "report", "result.npz"],
            env={**environment, "PYTHONPATH": str(ROOT), "TERM": "xterm-256color", "COLUMNS": "70"},
            stdout=written,
            stderr=subprocess.DEVNULL,
        )
        os.close(written)
        text = shown(seen).decode()
        process.wait()
    assert "\x1b[1m" in text
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()
    assert max(len(line) for line in plain if not line.startswith("signature")) <= 70


SLOW = """
import pathlib, time

def slow(pool):
    pathlib.Path("begun").touch()
    time.sleep(0.05)
    return pool[:, 0, 0]
"""
"""A rank test that makes the work last for long, and marks when it has begun."""


@pytest.mark.slow
@pytest.mark.parametrize("threads", ["1", "2"])
def test_an_interruption_exits_with_130_and_leaves_nothing_behind(threads: str) -> None:
    Path("slow.py").write_text(SLOW)
    Path("kept.npz").write_text("what was here before")
    random = np.random.default_rng(1)
    truth = random.normal(0, 300, (400, 17, 3)).astype(np.float32)
    np.save("h.npy", truth + random.normal(0, 40, (60, *truth.shape)).astype(np.float32))
    np.save("g.npy", truth)
    before = {path.name for path in Path().iterdir()}
    words = ("evaluate", "h.npy", "g.npy", "--metrics=min_mpjpe", "--prerank=slow.py:slow", "--save=kept.npz")
    process = spawned(*words, "--html=h.html", "--threads", threads, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while not Path("begun").exists():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=120) == (b"", b"posecal: interrupted.\n")
    assert process.returncode == 130
    assert {path.name for path in Path().iterdir()} == before | {"begun"}
    assert Path("kept.npz").read_text() == "what was here before"
