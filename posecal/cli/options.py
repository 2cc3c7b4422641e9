"""Options that several commands take: alone, or as data classes of options with what is made of them."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from posecal.cli import running
from posecal.errors import PoseFileError, for_command_line

if TYPE_CHECKING:
    from posecal.data.pose_data import PoseData
    from posecal.engine.protocol import Protocol
    from posecal.report.report import Report


def option(help: str, *names: str, panel: str = "Options", **more: Any) -> Any:  # noqa: A002
    """Declare an option with its help and the panel that it stands in."""
    return typer.Option(*names, help=help, rich_help_panel=panel, **more)


def argument(help: str, **more: Any) -> Any:  # noqa: A002
    """Declare an argument with its help."""
    return typer.Argument(help=help, show_default=False, **more)


reading = partial(option, panel="How the files are read")
writing = partial(option, panel="What is written")

Hypotheses = Annotated[Path, argument("Hypotheses, (N, M, K, 3): .npz or .npy.")]
Truth = Annotated[Path, argument("True poses, (M, K, 3): .npz or .npy.")]
Result = Annotated[Path, argument("A result of evaluate --save.")]
Output = Annotated[Path, option("The file to write.", "--output", "-o", show_default=False)]
Threads = Annotated[int | None, option("Threads.", min=1, show_default="one per core")]
By = Annotated[list[str] | None, option("Group by a label, predicted_spread (terciles) or occlusion. Repeatable.")]
OwnMetrics = Annotated[list[str] | None, option("Add your own metric. Repeatable.", "--metric", metavar="FILE.py:NAME")]
Form = Annotated[Literal["text", "markdown", "csv", "json", "latex"], writing("How it is written.", "--format")]
Gallery = Annotated[bool, writing("Keep some twelve poses, the worst, in the result and on the page.")]
Labels = Annotated[str | None, option("Names of the models, with commas.", show_default="those of the files")]


def model_names(files: list[Path]) -> list[str]:
    """Call models by their files' names, or by their paths where two files are called alike."""
    stems = [path.stem for path in files]
    names = stems if len(set(stems)) == len(stems) else [str(path.with_suffix("")) for path in files]
    return [name if names.index(name) == k else f"{name} #{k + 1}" for k, name in enumerate(names)]


def named(files: list[Path], labels: str | None) -> dict[str, Path]:
    """Give each file the name of its model: its label, or that of the file."""
    names = model_names(files) if labels is None else [name.strip() for name in labels.split(",")]
    if len(names) != len(files) or len({*names}) < len(names):
        raise typer.BadParameter(f"--labels: {labels!r}; expected {len(files)} different names, with commas.")
    return dict(zip(names, files, strict=True))


@dataclass(frozen=True)
class FigureOptions:
    """How a figure looks; the names are those of the parameters of :func:`posecal.plot.draw`."""

    title: Annotated[str | None, writing("What stands above.")] = None
    size: Annotated[
        tuple[float, float] | None, writing("Inches across and down.", metavar="WIDTH HEIGHT", show_default=False)
    ] = None
    style: Annotated[str | None, writing("A style of Matplotlib, or an .mplstyle file.")] = None

    def given(self) -> dict[str, Any]:
        """Give them all; a size or a style that is none is a wrong call."""
        from posecal.errors import PoseDataError
        from posecal.plot.style import check_size, style_parameters

        try:
            check_size(self.size)
            style_parameters(self.style)
        except PoseDataError as error:
            raise typer.BadParameter(for_command_line(error.message)) from None
        return {"title": self.title, "size": self.size, "style": self.style}


@dataclass(frozen=True)
class HypothesesOptions:
    """How hypotheses are read; the names are those of the parameters of :class:`posecal.PoseData`."""

    axes: Annotated[str | None, reading("Layout of the hypotheses, such as MNKD or MN(DK).")] = None
    unit: Annotated[str | None, reading("mm, cm, m, the mm in one unit (1/0.0036); deg, rad, px or none.")] = None
    joints: Annotated[str | None, reading("Names for joints without: h36m-17, h36m-16, ….", "--joint-names")] = None
    root_joint: Annotated[str | None, reading("The joint to subtract, LHip+RHip, RWrist,LWrist, or none.")] = None

    def given(self) -> dict[str, Any]:
        """Give those that were given; what they can't be is a wrong call."""
        from posecal.data.declarations import Declarations

        given = {name: value for name, value in vars(self).items() if value is not None}
        with running.wrong_call():
            later = {"skeleton", "draws", "seed"}  # of which the first is a file
            Declarations(**{name: value for name, value in given.items() if name not in later})
        return given


@dataclass(frozen=True)
class DataOptions(HypothesesOptions):
    """How hypotheses and truth are read."""

    truth_axes: Annotated[str | None, reading("Layout of the truth, such as MDK.")] = None
    truth_unit: Annotated[str | None, reading("The unit of the truth alone.")] = None
    skeleton: Annotated[str | None, reading("Names, parents, root: .json, .toml, or a joint set.")] = None
    missing: Annotated[Literal["error", "skip", "part"], reading("Frames that only one has; part: only the truth.")] = (
        "error"
    )
    n_hypotheses: Annotated[int | None, reading("Take only the first so many hypotheses.", "--hypotheses", min=1)] = (
        None
    )
    draws: Annotated[
        int | None, reading("Hypotheses to draw from distributions.", min=1, show_default="200 of each pose")
    ] = None
    seed: Annotated[int | None, reading("The seed of these draws.", min=0, show_default="0")] = None

    def read(self, hypotheses: Path, truth: Path, **more: Any) -> PoseData:
        """Open two files and match them."""
        from posecal.data.pose_data import PoseData
        from posecal.engine.storage import is_result

        given = self.given()
        for path in (hypotheses, truth):
            if is_result(path):
                raise PoseFileError(
                    f"{path.name} is a saved result and holds no poses. posecal report shows it; posecal compare takes "
                    "results alone, without a truth."
                )
        return PoseData(hypotheses, truth, **given, **more)


@dataclass(frozen=True)
class ScoringOptions:
    """What is measured, and by which protocol."""

    where: Annotated[Literal["all", "occluded", "visible"] | None, option("The joints to score; all by default.")] = (
        None
    )
    scored: Annotated[
        str | None,
        option("all, a joint set, names with commas, or common: those in both files.", "--joints", show_default="all"),
    ] = None
    metrics: Annotated[str | None, option("default, rank_tests, scores, all, or names.", show_default="default")] = None
    metric: OwnMetrics = None
    rank_tests: Annotated[bool, option("Add the rank tests, for what the ECE can't see.", "--rank-tests")] = False
    scores: Annotated[bool, option("Add the proper scores.", "--scores")] = False
    preset: Annotated[str | None, option("A published protocol; see posecal presets.")] = None
    settings: Annotated[
        list[str] | None, option("Any option that posecal presets lists. Repeatable.", "--set", metavar="OPTION=VALUE")
    ] = None

    @property
    def matching(self) -> dict[str, Any]:
        """What they ask of the reading of the files."""
        return {"shared_joints": "common"} if self.scored == "common" else {}

    def protocol(self, *added: str, preranks: Collection[str] = ()) -> Protocol:
        """Give the protocol of the preset with all changes; ``added`` are words for more metrics."""
        from posecal.engine.presets import as_protocol
        from posecal.registry import check_names

        changes = {}
        for setting in self.settings or []:
            name, equals, value = setting.partition("=")
            if not equals:
                raise typer.BadParameter(f"--set {setting!r}: expected OPTION=VALUE, such as best=sequence.")
            changes[name.strip()] = value.strip()
        flags = {"where": self.where, "joints": None if self.matching else self.scored, "metrics": self.metrics}
        changes |= {name: value for name, value in flags.items() if value is not None}
        added += ("rank_tests",) * self.rank_tests + ("scores",) * self.scores + register_all(self.metric)
        with running.wrong_call():
            protocol = as_protocol(self.preset).changed(changes)
            protocol = as_protocol(protocol, [*protocol.wanted, *added])
            check_names(protocol, preranks)
        return protocol


def register_all(entries: list[str] | None) -> tuple[str, ...]:
    """Register metrics of the user's files, and give their names."""
    from posecal.engine.metric import Metric
    from posecal.engine.user_code import load_function
    from posecal.registry import register, registered_as

    loaded = [load_function(entry, "metric", Metric) for entry in entries or []]
    metrics = [
        registered_as(m) or (m if isinstance(m, Metric) else Metric.from_function(m, name=name)) for name, m in loaded
    ]
    return tuple((registered_as(metric) or register(metric)).name for metric in metrics)


@dataclass(frozen=True)
class ReportOptions:
    """What is written of a report, and how."""

    form: Form = "text"
    all_metrics: Annotated[bool, writing("Show all numbers, each with what it is.", "--all")] = False
    per_joint: Annotated[bool, writing("Add a table per joint; to JSON, groups' curves.", "--per-joint")] = False
    definitions: Annotated[bool, writing("Add the full definition of every number.", "--definitions")] = False
    plot: Annotated[Path | None, writing("Draw the reliability diagram: .svg, .png or .pdf.")] = None
    html: Annotated[Path | None, writing("Write one self-contained page.")] = None
    gallery: Gallery = True

    def write(self, report: Report, name: str, save: Path | None = None) -> None:
        """Make all that was asked for, and only then write it: files, and the report to stdout."""
        from posecal import plot
        from posecal.data.write import write_file, written_together
        from posecal.report.format import counted

        files: list[Callable[[], object]] = [] if save is None else [partial(report.save, save, gallery=self.gallery)]
        if self.plot is not None:
            files.append(partial(plot.save, plot.draw(report, title=name), self.plot))
        if self.html is not None:
            from posecal.report.html import as_html

            page = as_html(report, name, for_command_line, gallery=self.gallery, command=running.call()).encode()
            files.append(partial(write_file, self.html, lambda file: file.write(page)))
        parts = {"all": self.all_metrics, "joints": self.per_joint, "definitions": self.definitions}
        text = report.render(self.form, **parts, **running.terminal(), words=for_command_line)
        with written_together():
            for write in files:
                write()
        kept = 0 if save is None or not self.gallery or report.totals.gallery is None else len(report.totals.gallery)
        if kept:
            poses = counted(int(report.totals.poses.sum()), "pose")
            running.say(f"{save}: keeps {kept} of the {poses} for pictures. --no-gallery leaves them out.")
        typer.echo(text)
