"""What commands have in common: turn refusals into exit codes, read pairs, show progress, write reports."""

from __future__ import annotations

import errno
import functools
import os
import shutil
import signal
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, ParamSpec, TextIO, TypeVar, cast

import typer

from posecal.cli.options import Form, Missing, Where

if TYPE_CHECKING:
    from posecal.data.match import Declarations
    from posecal.data.pose_data import PoseData
    from posecal.engine.protocol import Protocol
    from posecal.report.report import Format, Report
    from posecal.report.tables import Sheet

__all__ = [
    "check_outputs",
    "guarded",
    "join_of",
    "on_terminal",
    "progress",
    "protocol_of",
    "read_pairs",
    "say",
    "write_report",
    "wrong_call",
]

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
            from posecal.errors import PosecalError

            if isinstance(error, PosecalError):
                typer.echo(f"posecal: {error}", err=True)
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
    from posecal.errors import PosecalError

    try:
        yield
    except PosecalError as error:
        raise typer.BadParameter(str(error)) from None


def check_outputs(*inputs: Path, **outputs: Path | None) -> None:
    """Refuse, before any work is done, what could not be written after it, or would overwrite what is read.

    The output ``plot`` must be a picture.
    """
    from posecal.data.write import check_writable

    taken = {path.resolve(): "read" for path in inputs}
    for kind, path in outputs.items():
        if path is None:
            continue
        if kind == "plot":
            from posecal.plot import check_suffix

            with wrong_call():
                check_suffix(path)
        if path.resolve() in taken:
            raise typer.BadParameter(f"{path} is {taken[path.resolve()]} already; expected another name.")
        check_writable(path)
        taken[path.resolve()] = "written"


def join_of(
    axes: str | None = None,
    truth_axes: str | None = None,
    unit: str | None = None,
    truth_unit: str | None = None,
    joint_names: str | None = None,
    root_joint: str | None = None,
    missing: Missing = Missing.error,
    joints: str | None = None,
) -> Declarations:
    """Give what the flags say of the files."""
    from posecal.data.match import Declarations

    shared: Literal["same", "common"] = "common" if joints == "common" else "same"
    with wrong_call():
        return Declarations(axes, truth_axes, unit, truth_unit, joint_names, root_joint, missing.value, shared)


def read_pairs(hypotheses: Path, truth: Path, how: Declarations, most: int | None = None) -> PoseData:
    """Open two files and join them."""
    from posecal.data.match import join
    from posecal.data.read import read_poses
    from posecal.engine.storage import is_result
    from posecal.errors import PoseFileError

    for path in (hypotheses, truth):
        if is_result(path):
            raise PoseFileError(
                f"{path.name} is a saved result and holds no poses. posecal report shows it; posecal compare takes "
                "results alone, without a truth."
            )
    pairs = join(read_poses(hypotheses, "hypotheses"), read_poses(truth, "truth"), how)
    return pairs if most is None else pairs.with_hypotheses(most)


def protocol_of(
    preset: str | None,
    options: list[str],
    where: Where | None = None,
    joints: str | None = None,
    metrics: str | None = None,
    own: Collection[str] = (),
) -> Protocol:
    """Give the protocol of a preset, changed by options and flags; ``own`` are names of the user's own metrics."""
    from posecal.engine.protocol import Protocol
    from posecal.engine.protocol import preset as named
    from posecal.registry import check_names

    said = {}
    for entry in options:
        key, equals, value = entry.partition("=")
        if not equals:
            raise typer.BadParameter(f"{entry!r}: expected OPTION=VALUE, such as best=sequence.", param_hint="--set")
        said[key.strip()] = value.strip()
    if where is not None:
        said["where"] = where.value
    if joints not in {None, "common"}:
        said["joints"] = joints
    if metrics is not None:
        said["metrics"] = metrics
    with wrong_call():
        protocol = (Protocol() if preset is None else named(preset).protocol).changed(said)
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
    """Make all that was asked for, and only then write it: files, the report to stdout, remarks to stderr."""
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
    if form is Form.text:
        from posecal.report.sheets import report_sheet

        text = _fitted(report_sheet(report, joints=joints, definitions=definitions))
    else:
        text = report.render(cast("Format", form.value), joints=joints, definitions=definitions)
    for write in files:
        write()
    typer.echo(text, color=on_terminal(sys.stdout))
    for remark in report.remarks:
        typer.echo(f"note: {remark}", err=True)


def say(sheet: Sheet) -> None:
    """Write a sheet to stdout."""
    typer.echo(_fitted(sheet), color=on_terminal(sys.stdout))


def _fitted(sheet: Sheet) -> str:
    """Write a sheet as wide as the terminal and in its colours, or plainly for a pipe."""
    terminal = on_terminal(sys.stdout)
    return sheet.text(shutil.get_terminal_size((120, 40)).columns if terminal else 120, colour=terminal)


def on_terminal(stream: TextIO | None) -> bool:
    """Whether a stream is a terminal; one that was closed is none."""
    return stream is not None and stream.isatty()


@contextmanager
def progress(total: int, what: str = "evaluating") -> Iterator[Callable[[int], object] | None]:
    """Show a progress bar on a terminal, on stderr; nothing in a pipe."""
    if not on_terminal(sys.stderr):
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)
