"""What commands have in common: exit codes, checks of outputs, protocols, progress, and the writing of reports."""

from __future__ import annotations

import errno
import functools
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TextIO, TypeVar

import typer

from posecal.cli.options import Form, Where

if TYPE_CHECKING:
    from posecal.data.pose_data import PoseData
    from posecal.engine.protocol import Protocol
    from posecal.report.report import Report
    from posecal.report.sheet import Sheet

P = ParamSpec("P")
R = TypeVar("R")


def guarded(command: Callable[P, R]) -> Callable[P, R]:
    """Turn what posecal refuses into one message and an exit code."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except KeyboardInterrupt:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one would cut the exit code off
            typer.echo("posecal: interrupted.", err=True)
            raise typer.Exit(130) from None
        except Exception as error:
            from posecal.errors import PosecalError, for_command_line

            if isinstance(error, PosecalError):
                typer.echo(f"posecal: {for_command_line(error.message)}", err=True)
            elif isinstance(error, OSError) and error.errno not in {None, errno.EPIPE}:
                typer.echo(f"posecal: {error.strerror}{f': {error.filename}' if error.filename else ''}.", err=True)
                _drop_output()
            else:
                raise
            raise typer.Exit(3) from None

    return run


def _drop_output() -> None:
    """Let go of what stdout could not take: Python would fail on it once more when it leaves."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def wrong_call() -> Iterator[None]:
    """Turn what posecal refuses whatever the files hold into a wrong call."""
    from posecal.errors import PosecalError, for_command_line

    try:
        yield
    except PosecalError as error:
        raise typer.BadParameter(for_command_line(error.message)) from None


def check_outputs(*inputs: Path | None, **outputs: Path | None) -> None:
    """Refuse, before any work is done, what could not be written after it, or would overwrite what is read.

    The output ``plot`` must be a picture.
    """
    from posecal.data.write import check_writable

    used = {path.resolve(): "read" for path in inputs if path is not None}
    for kind, path in outputs.items():
        if path is None:
            continue
        if kind == "plot":
            from posecal.plot import check_suffix

            with wrong_call():
                check_suffix(path)
        if path.resolve() in used:
            raise typer.BadParameter(f"{path} is {used[path.resolve()]} already; expected another name.")
        check_writable(path)
        used[path.resolve()] = "written"


def read_data(hypotheses: Path, truth: Path, described: Mapping[str, Any]) -> PoseData:
    """Open two files and match them; ``described`` are the flags that describe them."""
    from posecal.data.declarations import Declarations
    from posecal.data.pose_data import PoseData
    from posecal.engine.storage import is_result
    from posecal.errors import PoseFileError

    with wrong_call():
        Declarations(**{name: value for name, value in described.items() if name != "n_hypotheses"})
    for path in (hypotheses, truth):
        if is_result(path):
            raise PoseFileError(
                f"{path.name} is a saved result and holds no poses. posecal report shows it; posecal compare takes "
                "results alone, without a truth."
            )
    return PoseData(hypotheses, truth, **described)


def own_metrics(entries: Sequence[str]) -> list[str]:
    """Register metrics of the user's files, and give their names."""
    from posecal.engine.metric import Metric
    from posecal.engine.user_code import load_function
    from posecal.registry import register

    names = []
    for entry in entries:
        name, metric = load_function(entry, "metric", Metric)
        names.append(register(metric if isinstance(metric, Metric) else Metric.from_function(metric, name=name)).name)
    return names


def protocol_of(
    preset: str | None,
    settings: Sequence[str],
    where: Where | None = None,
    joints: str | None = None,
    metrics: str | None = None,
    groups: list[str] | None = None,
    own: Sequence[str] = (),
) -> Protocol:
    """Give the protocol of a preset, changed by settings and flags; ``own`` are names of the user's rank tests."""
    from posecal.engine.presets import as_protocol
    from posecal.registry import check_names

    changes = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals:
            raise typer.BadParameter(f"{setting!r}: expected OPTION=VALUE, such as best=sequence.", param_hint="--set")
        changes[key.strip()] = value.strip()
    flags = {"where": None if where is None else where.value, "joints": joints, "metrics": metrics}
    changes |= {name: value for name, value in flags.items() if value is not None}
    with wrong_call():
        protocol = as_protocol(preset).changed(changes)
        if groups:
            protocol = as_protocol(protocol, [*protocol.wanted, *groups])
        check_names(protocol, own)
    return protocol


def write_report(
    report: Report,
    form: Form,
    *,
    joints: bool,
    definitions: bool,
    plot: Path | None,
    html: Path | None,
    name: str,
    save: Path | None = None,
) -> None:
    """Make all that was asked for, and only then write it: files, and the report to stdout."""
    files: list[Callable[[], None]] = []
    if save is not None:
        files.append(functools.partial(report.save, save))
    if plot is not None:
        from posecal.plot import draw
        from posecal.plot import save as save_figure

        files.append(functools.partial(save_figure, draw(report, title=name), plot))
    if html is not None:
        from posecal.data.write import write_file
        from posecal.report.html import as_html

        page = as_html(report, name).encode()
        files.append(functools.partial(write_file, html, lambda file: file.write(page)))

    from posecal.errors import for_command_line

    terminal = on_terminal(sys.stdout)
    text = report.render(
        form.value, joints=joints, definitions=definitions, width=columns(), colour=terminal, words=for_command_line
    )
    for write in files:
        write()
    typer.echo(text, color=terminal)


def show(sheet: Sheet, form: Form = Form.text) -> None:
    """Write a sheet to stdout: as wide as the terminal and in its colours, or plainly for a pipe."""
    terminal = on_terminal(sys.stdout)
    typer.echo(
        sheet.text(columns(), colour=terminal) if form is Form.text else sheet.markdown(),
        color=terminal,
    )


def columns() -> int:
    """Give the width of the terminal; of a pipe what COLUMNS says, 120 by default."""
    return shutil.get_terminal_size((120, 40)).columns


def on_terminal(stream: TextIO | None) -> bool:
    """Whether a stream is a terminal; one that was closed is none."""
    return stream is not None and stream.isatty()


@contextmanager
def progress(total: int | None = None, what: str = "evaluating") -> Iterator[Callable[[int], object] | None]:
    """Show a progress bar on a terminal, on stderr; nothing in a pipe."""
    if not on_terminal(sys.stderr):
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)
