"""Options that several commands take, each declared once."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer


class Form(StrEnum):
    """How a report is written."""

    text = "text"
    markdown = "markdown"
    csv = "csv"
    json = "json"
    latex = "latex"


class Where(StrEnum):
    """Which joints are scored."""

    all = "all"
    occluded = "occluded"
    visible = "visible"


class Missing(StrEnum):
    """What happens to frames that only one file has."""

    error = "error"
    skip = "skip"


READING, WRITING = "How the files are read", "What is written"


def option(help: str, *names: str, panel: str = "Options", **more: Any) -> Any:  # noqa: A002
    """Declare an option with its help and the panel that it stands in."""
    return typer.Option(*names, help=help, rich_help_panel=panel, **more)


Hypotheses = Annotated[Path, typer.Argument(help="Hypotheses, (N, M, K, 3): .npz or .npy.", show_default=False)]
Truth = Annotated[Path, typer.Argument(help="True poses, (M, K, 3): .npz or .npy.", show_default=False)]
Result = Annotated[Path, typer.Argument(help="A result of evaluate --save.", show_default=False)]
Output = Annotated[Path, option("The file to write.", "--output", "-o", show_default=False)]

By = Annotated[
    list[str] | None,
    option(
        "Group by a label, such as action; predicted_spread: terciles of it; occlusion: occluded and visible joints. "
        "Repeatable."
    ),
]
MetricNames = Annotated[
    str | None, option("default, rank_tests, scores, all, or names, with commas.", "--metrics", show_default="default")
]
OwnMetrics = Annotated[
    list[str] | None,
    option("Add a metric of your own, a function or a Metric. Repeatable.", "--metric", metavar="FILE.py:NAME"),
]
Scored = Annotated[Where | None, option("Which joints to score.", "--where", show_default="all")]
PresetName = Annotated[str | None, option("A published protocol; see posecal presets.", "--preset")]
Settings = Annotated[
    list[str] | None, option("Any option that posecal presets lists. Repeatable.", "--set", metavar="OPTION=VALUE")
]
Threads = Annotated[int | None, option("Threads.", min=1, show_default="one per core")]
Formats = Annotated[Form, option("How the report is written.", "--format", panel=WRITING)]
PerJoint = Annotated[bool, option("Add a table per joint.", "--per-joint", panel=WRITING)]
Definitions = Annotated[bool, option("Add the full definition of every number.", "--definitions", panel=WRITING)]
Plot = Annotated[Path | None, option("Draw the reliability diagram: .svg, .png or .pdf.", panel=WRITING)]
Html = Annotated[Path | None, option("Write one self-contained page.", panel=WRITING)]

DATA: dict[str, tuple[Any, Any]] = {
    "axes": (str | None, option("Layout of the hypotheses, such as MNKD or MN(DK).", panel=READING)),
    "truth_axes": (str | None, option("Layout of the truth, such as MDK.", panel=READING)),
    "unit": (str | None, option("mm, cm, m, or the mm in one unit (1/0.0036).", panel=READING)),
    "truth_unit": (str | None, option("The same, for the truth alone.", panel=READING)),
    "joints": (str | None, option("Names for joints without: h36m-17, h36m-16, ….", "--joint-names", panel=READING)),
    "root_joint": (str | None, option("The joint to subtract: a name, an index, or none.", panel=READING)),
    "missing": (Missing | None, option("Frames that only one file has.", panel=READING, show_default="error")),
    "n_hypotheses": (
        int | None,
        option("Take only the first so many hypotheses.", "--hypotheses", min=1, panel=READING),
    ),
}
"""The flags that describe the files, by the parameters of :class:`posecal.PoseData` that they set."""


def describes_data(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the flags of :data:`DATA`, all or those named; it gets them as one mapping, ``described``."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        flags = {name: flag for name, flag in DATA.items() if not names or name in names}

        @functools.wraps(command)
        def run(**arguments: Any) -> None:
            given = {name: arguments.pop(name) for name in flags}
            described = {n: getattr(v, "value", v) for n, v in given.items() if v is not None}
            command(**arguments, described=described)

        signature = inspect.signature(command, eval_str=True)
        own = [parameter for parameter in signature.parameters.values() if parameter.name != "described"]
        added = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[kind, flag])
            for name, (kind, flag) in flags.items()
        ]
        parameters = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in own]
        place = next((k for k, p in enumerate(parameters) if p.name == "form"), len(parameters))
        parameters[place:place] = added
        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return run

    return decorate
