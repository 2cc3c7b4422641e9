"""What commands have in common: how they are declared, exit codes, checks of outputs, progress and output."""

from __future__ import annotations

import errno
import functools
import inspect
import os
import shlex
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, get_type_hints

import typer

from posecal.errors import PosecalError, PoseFileError, for_command_line, printable, reason

if TYPE_CHECKING:
    from posecal.report.sheet import Sheet

Bar = Callable[..., Callable[..., object] | None]
"""From what is done, and of how much, to what is called with how much of it is done, and of how much."""


def command(
    app: typer.Typer, name: str | None = None, about: str | None = None
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a function a command of an application; what posecal refuses is one message and an exit code.

    A parameter whose type is a data class stands for an option per field.
    """

    def add(function: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(function, eval_str=True)
        parameters = signature.parameters.values()
        groups: dict[str, Any] = {p.name: p.annotation for p in parameters if is_dataclass(p.annotation)}
        options: list[inspect.Parameter] = []
        for parameter in parameters:
            if kind := groups.get(parameter.name):
                hints = get_type_hints(kind, include_extras=True)
                parts = [parameter.replace(name=f.name, default=f.default) for f in fields(kind)]
                options += [part.replace(annotation=hints[part.name]) for part in parts]
            else:
                options.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

        @functools.wraps(function)
        def run(**given: Any) -> None:
            for group, kind in groups.items():
                given[group] = kind(**{field.name: given.pop(field.name) for field in fields(kind)})
            with exit_codes():
                function(**given)

        run.__signature__ = signature.replace(parameters=options)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in options}
        app.command(name, help=about)(run)
        return function

    return add


@contextmanager
def exit_codes() -> Iterator[None]:
    """Turn what posecal refuses, and interruptions, into one message and an exit code."""
    try:
        yield
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one would cut the exit code off
        typer.echo("posecal: interrupted.", err=True)
        raise typer.Exit(130) from None
    except PosecalError as error:
        typer.echo(f"posecal: {for_command_line(error.message)}", err=True)
        raise typer.Exit(3) from None
    except OSError as error:
        if error.errno in {None, errno.EPIPE}:
            raise
        say(f"posecal: {error.strerror}{f': {error.filename}' if error.filename else ''}.")
        with suppress(OSError, AttributeError):  # Python would fail once more on what stdout could not take
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(3) from None


@contextmanager
def of_results(*paths: Path) -> Iterator[None]:
    """Refuse saved results whose members don't fit each other: edited and given a digest anew, for posecal writes none.

    Raises
    ------
    PoseFileError
        For what can be raised by numbers that are none.
    """
    try:
        yield
    except (PosecalError, UnicodeError):
        raise
    except (ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError) as error:
        names = ", ".join(path.name for path in paths)
        raise PoseFileError(
            f"{names}: its members don't fit each other ({reason(error)}). Evaluate again. If nobody edited it, report "
            "this as a fault of posecal."
        ) from error


@contextmanager
def wrong_call() -> Iterator[None]:
    """Turn what posecal refuses whatever the files hold into a wrong call."""
    try:
        yield
    except PosecalError as error:
        raise typer.BadParameter(for_command_line(error.message)) from None


def check_outputs(*inputs: Path | str | None, **outputs: Path | None) -> None:
    """Refuse, before any work is done, what could not be written after it, or would overwrite what is read.

    Inputs may be of the form ``FILE.py:NAME``. The output ``plot`` must be a picture.
    """
    from posecal.data.write import check_writable

    files = [Path(entry.rpartition(":")[0]) if isinstance(entry, str) else entry for entry in inputs if entry]
    used = {path.resolve(): "read" for path in files}
    for kind, path in outputs.items():
        if path is None:
            continue
        if kind == "plot":
            from posecal.plot import check_suffix

            with wrong_call():
                check_suffix(path)
        if path.resolve() in used:
            raise typer.BadParameter(printable(f"{path} is {used[path.resolve()]} already; expected another name."))
        check_writable(path)
        if kind == "plot":
            check_writable(path.with_name(f"{path.name}.txt"))
        used[path.resolve()] = "written"


def say(text: str) -> None:
    """Write a line to stderr, with what a terminal can't show of names escaped."""
    typer.echo(printable(text), err=True)


def show(sheet: Sheet) -> None:
    """Write a sheet to stdout, for a terminal."""
    typer.echo(sheet.text(**terminal()))


def terminal() -> dict[str, Any]:
    """Give the width of stdout, of a pipe what COLUMNS says or 120, and whether it has colours."""
    return {"width": shutil.get_terminal_size((120, 40)).columns, "colour": _is_terminal(sys.stdout)}


def call() -> str:
    """Give the command as it was typed, so that a shell takes it again."""
    return shlex.join(["posecal", *sys.argv[1:]])


def _is_terminal(stream: TextIO | None) -> bool:
    return stream is not None and stream.isatty()  # a stream that was closed is none


@contextmanager
def progress() -> Iterator[Bar]:
    """Show progress bars on a terminal, on stderr; nothing in a pipe."""
    if not _is_terminal(sys.stderr):
        yield lambda *_: None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bars:

        def bar(what: str, total: int | None = None) -> Callable[..., object]:
            task = bars.add_task(escape(printable(what)), total=total)
            return lambda done, total=None: bars.update(task, completed=done, total=total)

        yield bar
