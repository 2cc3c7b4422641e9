"""What commands have in common: options in data classes, exit codes, progress and the terminal."""

from __future__ import annotations

import errno
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
import typer
from typer.testing import CliRunner

from posecal.cli import running
from tests.helpers.shell import run

# --- declaring a command --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Size:
    width: Annotated[int, typer.Option(help="Columns.")] = 3
    unit: Annotated[Literal["px", "mm"] | None, typer.Option("--in", help="Unit.")] = None


@dataclass(frozen=True)
class Box(Size):
    """Fields of a base class come first."""

    depth: Annotated[list[str] | None, typer.Option(help="Repeatable.")] = None


def application(seen: list[object]) -> typer.Typer:
    app = typer.Typer()

    @running.command(app, "draw", "Draw a box.")
    def draw_box(name: str, *, times: int = 1, box: Box) -> None:
        """Not shown, because there is another text."""
        seen.extend((name, times, box))

    @running.command(app)
    def nothing() -> None:
        """Do nothing."""

    assert draw_box.__name__ == "draw_box"
    return app


def test_a_parameter_of_a_data_class_is_an_option_per_field() -> None:
    seen: list[object] = []
    words = ["draw", "b", "--width=5", "--in=mm", "--depth=1", "--depth=2"]
    assert CliRunner().invoke(application(seen), words).exit_code == 0
    assert seen == ["b", 1, Box(5, "mm", ["1", "2"])]
    seen.clear()
    assert CliRunner().invoke(application(seen), ["draw", "b", "--times=2"]).exit_code == 0
    assert seen == ["b", 2, Box()]


def test_help_is_that_of_the_command_and_of_each_option() -> None:
    text = CliRunner().invoke(application([]), ["draw", "--help"]).stdout
    assert "Draw a box." in text
    assert text.index("--times") < text.index("--width") < text.index("--in") < text.index("--depth")
    assert "Do nothing." in CliRunner().invoke(application([]), ["--help"]).stdout


# --- exit codes -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["evaluate", "hyps.npz", "gt.npz", "--metrics=mpjpe"], 0),
        (["--version"], 0),
        (["evaluate", "--help"], 0),
        ([], 2),
        (["evaluate", "hyps.npz"], 2),
        (["evaluate", "hyps.npz", "gt.npz", "--metrics=mpjp"], 2),
        (["--explain", "mpjp"], 2),
        (["evaluate", "hyps.npz", "none.npz"], 3),
        (["evaluate", "hyps.npz", "gt.npz", "--by=none"], 3),
        (["merge", "gt.npz", "-o", "x.npz"], 3),
    ],
)
def test_exit_codes_tell_wrong_calls_from_files_that_can_not_be_evaluated(words: list[str], code: int) -> None:
    assert run(*words).exit_code == code


def test_an_error_of_the_system_is_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "here")

    monkeypatch.setattr("posecal.evaluate", fails, raising=False)
    monkeypatch.setattr("os.dup2", lambda *_: None)
    failed = run("evaluate", "hyps.npz", "gt.npz")
    assert (failed.exit_code, failed.stdout) == (3, "")
    assert failed.stderr == "posecal: No space left on device: here.\n"


def test_a_fault_of_posecal_s_own_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("posecal.evaluate", fails, raising=False)
    with pytest.raises(ZeroDivisionError):
        run("evaluate", "hyps.npz", "gt.npz")


@pytest.mark.slow
def test_an_interruption_is_said_and_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("posecal.evaluate", interrupted, raising=False)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    stopped = run("evaluate", "hyps.npz", "gt.npz", "--save=s.npz")
    assert (stopped.exit_code, stopped.stdout, stopped.stderr) == (130, "", "posecal: interrupted.\n")
    assert not Path("s.npz").exists()


def test_a_reader_that_left_is_no_message(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise OSError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr("posecal.evaluate", fails, raising=False)
    gone = run("evaluate", "hyps.npz", "gt.npz")
    assert (gone.exit_code, gone.stdout, gone.stderr) == (1, "", "")


# --- the terminal ---------------------------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_shown_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    with running.progress() as bar:
        first, second = bar("[b] one", 40), bar("two")
        assert first is not None
        assert second is not None
        first(10)
        second(5, 20)
        shown = running.sys.stderr
    text = shown.getvalue()  # type: ignore[attr-defined]
    assert "[b] one" in text
    assert "25%" in text


@pytest.mark.parametrize("stream", [io.StringIO, lambda: None], ids=["pipe", "closed"])
def test_there_is_no_progress_in_a_pipe(stream: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", stream())
    with running.progress() as bar:
        assert bar("evaluating", 40) is None
        assert bar("applying") is None


@pytest.mark.parametrize(("stream", "colour"), [(Terminal(), True), (io.StringIO(), False), (None, False)])
def test_text_is_as_wide_as_the_terminal_and_in_its_colours(
    stream: io.StringIO | None, colour: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "70")
    monkeypatch.setattr("sys.stdout", stream)
    assert running.terminal() == {"width": 70, "colour": colour}
