"""The options that several commands take, each declared once."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

__all__ = [
    "Axes",
    "By",
    "Definitions",
    "Form",
    "Formats",
    "Html",
    "Hypotheses",
    "JointNames",
    "Missing",
    "MissingFrames",
    "Most",
    "Output",
    "PerJoint",
    "Plot",
    "Result",
    "RootJoint",
    "Threads",
    "Truth",
    "TruthAxes",
    "TruthUnit",
    "Unit",
    "Where",
    "option",
]


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


READING, WRITING = "How the files are read", "What is written"


def option(help: str, *names: str, panel: str = "Options", **more: Any) -> Any:  # noqa: A002
    """Declare an option with its help and the panel that it stands in."""
    return typer.Option(*names, help=help, rich_help_panel=panel, **more)


Hypotheses = Annotated[Path, typer.Argument(help="Hypotheses, (N, M, K, 3): .npz or .npy.", show_default=False)]
Truth = Annotated[Path, typer.Argument(help="True poses, (M, K, 3): .npz or .npy.", show_default=False)]
Result = Annotated[Path, typer.Argument(help="A result of evaluate --save.", show_default=False)]
Output = Annotated[Path, option("The file to write.", "--output", "-o", show_default=False)]

Axes = Annotated[str | None, option("Layout of the hypotheses, such as MNKD or MN(DK).", panel=READING)]
TruthAxes = Annotated[str | None, option("Layout of the truth, such as MDK.", panel=READING)]
Unit = Annotated[str | None, option("mm, cm, m, or the mm in one unit (1/0.0036).", panel=READING)]
TruthUnit = Annotated[str | None, option("The same, for the truth alone.", panel=READING)]
JointNames = Annotated[str | None, option("Names for joints without: h36m-17, h36m-16, ….", panel=READING)]
RootJoint = Annotated[str | None, option("The joint to subtract: a name, an index, or none.", panel=READING)]
MissingFrames = Annotated[Missing, option("Frames that only one file has.", "--missing", panel=READING)]
Most = Annotated[int | None, option("Take only the first so many hypotheses.", "--hypotheses", min=1, panel=READING)]

By = Annotated[
    list[str] | None,
    option(
        "Group by a label, such as action; spread: terciles of the predicted spread; occlusion: occluded and visible "
        "joints. Repeatable."
    ),
]
Threads = Annotated[int | None, option("Threads.", min=1, show_default="one per core")]
Formats = Annotated[Form, option("How the report is written.", "--format", panel=WRITING)]
PerJoint = Annotated[bool, option("Add a table per joint.", "--per-joint", panel=WRITING)]
Definitions = Annotated[bool, option("Add the full definition of every number.", "--definitions", panel=WRITING)]
Plot = Annotated[Path | None, option("Draw the reliability diagram: .svg, .png or .pdf.", panel=WRITING)]
Html = Annotated[Path | None, option("Write one self-contained page.", panel=WRITING)]
