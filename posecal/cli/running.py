"""What commands have in common: turn refusals into exit codes, read pairs, show progress, write reports."""

from __future__ import annotations

import functools
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar, cast

import typer

from posecal.cli.options import Form, Where

if TYPE_CHECKING:
    from posecal.joining import Join
    from posecal.pairs import PosePairs
    from posecal.protocol import Protocol
    from posecal.report import Format, Report
    from posecal.tables import Sheet

__all__ = ["check_outputs", "guarded", "progress", "protocol_of", "read_pairs", "say", "write_report"]

P = ParamSpec("P")
R = TypeVar("R")


def guarded(command: Callable[P, R]) -> Callable[P, R]:
    """Turn what posecal refuses into one message and an exit code."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        from posecal.errors import PosecalError

        try:
            return command(*args, **kwargs)
        except PosecalError as error:
            typer.echo(f"posecal: {error}", err=True)
            raise typer.Exit(3) from None
        except KeyboardInterrupt:
            typer.echo("posecal: interrupted.", err=True)
            raise typer.Exit(130) from None

    return run


def check_outputs(**paths: Path | None) -> None:
    """Refuse, before any work is done, what could not be written after it; ``plot`` must be a picture."""
    from posecal.io import check_writable

    for kind, path in paths.items():
        if path is not None:
            check_writable(path)
            if kind == "plot":
                from posecal.plot import check_suffix

                check_suffix(path)


def read_pairs(hypotheses: Path, truth: Path, how: Join, most: int | None = None) -> PosePairs:
    """Open two files and join them."""
    from posecal.io import read_poses
    from posecal.joining import join

    pairs = join(read_poses(hypotheses, "hypotheses"), read_poses(truth, "truth"), how)
    return pairs if most is None else pairs.with_hypotheses(most)


def protocol_of(
    preset: str | None, options: list[str], where: Where = Where.all, joints: str = "all", metrics: str = "default"
) -> Protocol:
    """Give the protocol of a preset, changed by options and flags."""
    from posecal.protocol import Protocol
    from posecal.protocol import preset as named

    start = Protocol() if preset is None else named(preset).protocol
    said = {}
    for entry in options:
        key, equals, value = entry.partition("=")
        if not equals:
            raise typer.BadParameter(f"{entry!r}: expected OPTION=VALUE, such as best=sequence.", param_hint="--set")
        said[key.strip()] = value.strip()
    if where is not Where.all:
        said["where"] = where.value
    if joints not in {"all", "common"}:
        said["joints"] = joints
    if metrics != "default":
        said["metrics"] = metrics
    return start.changed(said)


def write_report(
    report: Report,
    form: Form,
    *,
    joints: bool,
    definitions: bool,
    plot: Path | None,
    html: Path | None,
    name: str,
) -> None:
    """Write a report to stdout and into the files that were asked for; remarks go to stderr."""
    if plot is not None:
        from posecal.plot import draw, save

        save(draw(report, title=name), plot)
    if html is not None:
        from posecal.html import write_html

        write_html(report, html, name)
    if form is Form.text:
        from posecal.sheets import report_sheet

        say(report_sheet(report, joints=joints, definitions=definitions))
    else:
        typer.echo(report.render(cast("Format", form.value), joints=joints, definitions=definitions))
    for remark in report.remarks:
        typer.echo(f"note: {remark}", err=True)


def say(sheet: Sheet) -> None:
    """Write a sheet to stdout: as wide as the terminal and in its colours, or plainly into a pipe."""
    terminal = sys.stdout.isatty()
    columns = shutil.get_terminal_size((120, 40)).columns if terminal else 120
    typer.echo(sheet.text(columns, colour=terminal), color=terminal)


@contextmanager
def progress(total: int, what: str = "evaluating") -> Iterator[Callable[[int], object] | None]:
    """Show a progress bar on a terminal, on stderr; nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)
