"""The command line: arguments, exit codes, and nothing else.

Exit codes: 0 done, 2 a wrong call, 3 the files can't be evaluated (one message on stderr), 130 interrupted.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, TypeVar, cast

import typer

if TYPE_CHECKING:
    from posecal.joining import Join
    from posecal.pairs import PosePairs
    from posecal.protocol import Protocol
    from posecal.report import Format, Report

__all__ = ["main"]

P = ParamSpec("P")
R = TypeVar("R")

app = typer.Typer(
    name="posecal",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Can the uncertainty of a multi-hypothesis 3D human pose model be trusted? "
    "Start with [bold]posecal demo[/bold], or [bold]posecal evaluate hyps.npz gt.npz[/bold].",
)
plot_app = typer.Typer(no_args_is_help=True, help="Draw a saved result, or some poses.", rich_markup_mode="rich")
app.add_typer(plot_app, name="plot")


class Form(StrEnum):
    """How a report is written."""

    text = "text"
    markdown = "markdown"
    csv = "csv"
    json = "json"


class Where(StrEnum):
    """Which joints are scored."""

    all = "all"
    occluded = "occluded"
    visible = "visible"


class Missing(StrEnum):
    """What happens to frames that only one file has."""

    error = "error"
    skip = "skip"


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


READING, WRITING = "How the files are read", "What is written"


def _option(help: str, *names: str, panel: str = "Options", **more: Any) -> Any:  # noqa: A002
    return typer.Option(*names, help=help, rich_help_panel=panel, **more)


Hypotheses = Annotated[Path, typer.Argument(help="Hypotheses, (N, M, K, 3): .npz or .npy.", show_default=False)]
Truth = Annotated[Path, typer.Argument(help="True poses, (M, K, 3): .npz or .npy.", show_default=False)]
Result = Annotated[Path, typer.Argument(help="A result of evaluate --save.", show_default=False)]
Output = Annotated[Path, _option("The file to write.", "--output", "-o", show_default=False)]

Axes = Annotated[str | None, _option("Layout of the hypotheses, such as MNKD or MN(DK).", panel=READING)]
TruthAxes = Annotated[str | None, _option("Layout of the truth, such as MDK.", panel=READING)]
Unit = Annotated[str | None, _option("mm, cm, m, or the mm in one unit (1/0.0036).", panel=READING)]
TruthUnit = Annotated[str | None, _option("The same, for the truth alone.", panel=READING)]
JointNames = Annotated[str | None, _option("Names for joints without: h36m-17, h36m-16, ….", panel=READING)]
RootJoint = Annotated[str | None, _option("The joint to subtract: a name, an index, or none.", panel=READING)]
MissingFrames = Annotated[Missing, _option("Frames that only one file has.", "--missing", panel=READING)]

By = Annotated[
    list[str] | None,
    _option("Group by a label, such as action; spread: terciles of the predicted spread. Repeatable."),
]
Formats = Annotated[Form, _option("How the report is written.", "--format", panel=WRITING)]
PerJoint = Annotated[bool, _option("Add a table per joint.", "--per-joint", panel=WRITING)]
Definitions = Annotated[bool, _option("Add the full definition of every number.", "--definitions", panel=WRITING)]
Plot = Annotated[Path | None, _option("Draw the reliability diagram: .svg, .png or .pdf.", panel=WRITING)]
Html = Annotated[Path | None, _option("Write one self-contained page.", panel=WRITING)]


@app.command()
@guarded
def evaluate(
    hypotheses: Hypotheses,
    truth: Truth,
    by: By = None,
    where: Annotated[Where, _option("Which joints to score.")] = Where.all,
    joints: Annotated[str, _option("all, a joint set, names with commas, or common: those in both files.")] = "all",
    metrics: Annotated[str, _option("default, all, or names with commas.")] = "default",
    preset: Annotated[str | None, _option("A published protocol; see posecal presets.")] = None,
    options: Annotated[
        list[str] | None,
        _option("Any option that posecal presets lists. Repeatable.", "--set", metavar="OPTION=VALUE"),
    ] = None,
    axes: Axes = None,
    truth_axes: TruthAxes = None,
    unit: Unit = None,
    truth_unit: TruthUnit = None,
    joint_names: JointNames = None,
    root_joint: RootJoint = None,
    missing: MissingFrames = Missing.error,
    form: Formats = Form.text,
    per_joint: PerJoint = False,
    definitions: Definitions = False,
    save: Annotated[Path | None, _option("Keep the result (sums, not hypotheses), .npz.", panel=WRITING)] = None,
    plot: Plot = None,
    html: Html = None,
    threads: Annotated[int | None, _option("Threads.", min=1, show_default="one per core")] = None,
) -> None:
    """Evaluate hypotheses against the truth: accuracy, calibration and spread, each with its definition."""
    _check_outputs(save=save, plot=plot, html=html)
    from posecal.evaluation import add_up
    from posecal.joining import Join
    from posecal.report import Report

    protocol = _protocol(preset, options or [], where, joints, metrics)
    shared: Literal["same", "common"] = "common" if joints == "common" else "same"
    how = Join(axes, truth_axes, unit, truth_unit, joint_names, root_joint, missing.value, shared)
    pairs = _pairs(hypotheses, truth, how)
    with _progress(len(pairs.truth)) as advance:
        totals = add_up(pairs, protocol, by=by or (), threads=threads, progress=advance)
    report = Report(totals, by or ())
    if save is not None:
        report.save(save)
    _write(report, form, per_joint, definitions, plot, html, hypotheses.name)


@app.command()
@guarded
def report(
    result: Result,
    by: By = None,
    form: Formats = Form.text,
    per_joint: PerJoint = False,
    definitions: Definitions = False,
    plot: Plot = None,
    html: Html = None,
) -> None:
    """Write the report of a saved result, without the hypotheses."""
    _check_outputs(plot=plot, html=html)
    _write(_load(result, by or []), form, per_joint, definitions, plot, html, result.name)


@app.command()
@guarded
def merge(
    results: Annotated[list[Path], typer.Argument(help="Saved results of shards of one test set.", show_default=False)],
    output: Output,
) -> None:
    """Add the results of shards: the same numbers as one run over everything."""
    _check_outputs(output=output)
    from posecal.totals import Totals

    whole = Totals.merged([Totals.load(path) for path in results], [path.name for path in results])
    whole.save(output)
    typer.echo(f"{output}: {whole.poses.sum():,} poses of {len(results)} results.", err=True)


@app.command()
@guarded
def presets() -> None:
    """List the published protocols with every option that they set, and all options."""
    from posecal.tables import protocols_as_text

    typer.echo(protocols_as_text(_width(), colour=sys.stdout.isatty()), color=True)


@app.command()
@guarded
def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Where to leave files.")] = Path("posecal-demo"),
) -> None:
    """Make a world where the truth is known, evaluate three samplers on it, and say what to notice."""
    from posecal.demo import run_demo

    run_demo(folder, typer.echo)


@plot_app.command("reliability")
@guarded
def plot_reliability(result: Result, output: Output) -> None:
    """Calibration curves against the diagonal."""
    _draw(result, "reliability", output)


@plot_app.command("joints")
@guarded
def plot_joints(result: Result, output: Output) -> None:
    """The signed area of every joint, on a skeleton."""
    _draw(result, "joints", output)


@plot_app.command("errors")
@guarded
def plot_errors(result: Result, output: Output) -> None:
    """MinMPJPE against the number of hypotheses."""
    _draw(result, "errors", output)


@plot_app.command("correct")
@guarded
def plot_correct(result: Result, output: Output) -> None:
    """PCK and CPS against the threshold."""
    _draw(result, "correct", output)


@plot_app.command("poses")
@guarded
def plot_poses(
    hypotheses: Hypotheses,
    truth: Truth,
    output: Output,
    frames: Annotated[
        str | None, _option("Frame ids or numbers, with commas.", show_default="5, evenly spaced")
    ] = None,
    joint: Annotated[str, _option("The joint whose hypotheses are shown as points.")] = "RWrist",
    most: Annotated[int, _option("How many hypotheses to draw.", min=1)] = 50,
    axes: Axes = None,
    truth_axes: TruthAxes = None,
    unit: Unit = None,
    truth_unit: TruthUnit = None,
    joint_names: JointNames = None,
    root_joint: RootJoint = None,
    missing: MissingFrames = Missing.error,
) -> None:
    """Skeletons in 3D: hypotheses grey, truth blue, one joint's hypotheses pink."""
    _check_outputs(plot=output)
    from posecal.joining import Join
    from posecal.plot import draw_poses, frames_of, save

    pairs = _pairs(hypotheses, truth, Join(axes, truth_axes, unit, truth_unit, joint_names, root_joint, missing.value))
    save(draw_poses(pairs, frames_of(pairs, frames), cloud=joint, most=most), output)


# --- shared by the commands ------------------------------------------------------------------------------------


def _check_outputs(**paths: Path | None) -> None:
    """Refuse, before any work is done, what could not be written after it."""
    from posecal.io import check_writable

    for option, path in paths.items():
        if path is not None:
            check_writable(path)
            if option == "plot":
                from posecal.plot import check_suffix

                check_suffix(path)


def _pairs(hypotheses: Path, truth: Path, how: Join) -> PosePairs:
    from posecal.io import read_poses
    from posecal.joining import join

    return join(read_poses(hypotheses, "hypotheses"), read_poses(truth, "truth"), how)


def _protocol(name: str | None, options: list[str], where: Where, joints: str, metrics: str) -> Protocol:
    from posecal.protocol import Protocol, preset

    start = Protocol() if name is None else preset(name).protocol
    said = {}
    for option in options:
        key, equals, value = option.partition("=")
        if not equals:
            raise typer.BadParameter(f"{option!r}: expected OPTION=VALUE, such as best=sequence.", param_hint="--set")
        said[key.strip()] = value.strip()
    flags = {"where": where.value, "joints": joints, "metrics": metrics}
    said |= {key: value for key, value in flags.items() if value not in {"all", "common", "default"}}
    if metrics == "all":
        said["metrics"] = "all"
    return start.changed(said)


def _load(result: Path, by: list[str]) -> Report:
    from posecal.report import Report
    from posecal.totals import Totals

    return Report(Totals.load(result), by)


def _draw(result: Path, kind: str, output: Path) -> None:
    _check_outputs(plot=output)
    from posecal.plot import draw, save

    save(draw(_load(result, []), kind), output)


def _write(
    report: Report, form: Form, joints: bool, definitions: bool, plot: Path | None, html: Path | None, name: str
) -> None:
    """Write a report to stdout and into the files that were asked for; remarks go to stderr."""
    if plot is not None:
        from posecal.plot import draw, save

        save(draw(report, title=name), plot)
    if html is not None:
        from posecal.html import write_html

        write_html(report, html, name)
    if form is Form.text:
        from posecal.tables import as_text

        typer.echo(
            as_text(report, joints=joints, full=definitions, width=_width(), colour=sys.stdout.isatty()),
            color=True,
        )
    else:
        typer.echo(report.render(cast("Format", form.value), joints=joints, definitions=definitions))
    for remark in report.remarks:
        typer.echo(f"note: {remark}", err=True)


def _width() -> int:
    """Columns of the terminal; wide where there is none."""
    import shutil

    return shutil.get_terminal_size((120, 40)).columns if sys.stdout.isatty() else 120


@contextmanager
def _progress(total: int) -> Iterator[Callable[[int], object] | None]:
    """Show a progress bar on a terminal, on stderr; nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("evaluating", total=total)
        yield lambda done: bar.update(task, completed=done)


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
