"""The command line: arguments and exit codes. Everything else is done by the public functions.

Exit codes: 0 done, 2 a wrong call, 3 the files can't be evaluated (one message on stderr), 130 interrupted.
"""

from __future__ import annotations

import sys
from io import TextIOWrapper
from typing import Annotated

import typer

from posecal.cli import compare, convert, evaluate, leaderboard, plots, recalibrate
from posecal.cli.running import command, exit_codes, wrong_call

app = typer.Typer(
    name="posecal",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Can the uncertainty of a multi-hypothesis 3D human pose model be trusted? "
    "Start with [bold]posecal demo[/bold], or [bold]posecal evaluate hyps.npz gt.npz[/bold].",
)


@app.callback(invoke_without_command=True)
def options(
    *,
    version: Annotated[bool, typer.Option("--version", help="The version.")] = False,
    explain: Annotated[str | None, typer.Option(metavar="METRIC", help="What a metric is, how to read it.")] = None,
) -> None:
    """Give the options of posecal itself; they act by themselves."""
    if not version and explain is None:
        return
    with exit_codes():
        if version:
            from posecal import __version__

            typer.echo(f"posecal {__version__}")
        if explain is not None:
            from posecal.report.explain import explain as explanation

            with wrong_call():
                page = explanation(explain)
            typer.echo(page)
        raise typer.Exit


command(app)(evaluate.evaluate)
command(app)(evaluate.report)
command(app)(compare.compare)
app.add_typer(leaderboard.app, name="leaderboard")
app.add_typer(recalibrate.app, name="recalibrate")
app.add_typer(plots.app, name="plot")
command(app)(plots.view)
command(app)(convert.convert)
command(app)(evaluate.merge)
command(app)(evaluate.presets)
command(app)(evaluate.demo)


def main() -> None:
    """Run the command line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a letter that the terminal lacks is no reason to stop
    app(prog_name="posecal")
