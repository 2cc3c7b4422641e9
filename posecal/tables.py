"""How does a report look to a person? The same few tables as text for a terminal and as Markdown.

One screen by default: accuracy, calibration and spread over all poses, each number with what it is in a few words.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, fields

from rich import box
from rich.console import Console
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text

from posecal.metric import Metric
from posecal.protocol import PRESETS, Protocol
from posecal.report import Report

__all__ = [
    "Table",
    "as_markdown",
    "as_text",
    "definitions",
    "headline",
    "number",
    "protocols_as_text",
    "tables",
    "title",
]

FAMILIES = {"accuracy": "Accuracy", "calibration": "Calibration", "spread": "Spread"}
ARROWS = {"lower": "↓", "higher": "↑", "zero": "0", "none": ""}
BY_GROUP = ("min_mpjpe", "mpjpe", "pa_min_mpjpe", "pck", "ece", "signed_area", "coverage_90", "radius_50")
BY_JOINT = ("min_mpjpe", "mpjpe", "ece", "signed_area", "coverage_50", "coverage_90", "radius_50", "radius_90")


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes
    ----------
    title : str
        Its heading.
    columns : tuple of (str, bool)
        Headings, and whether a column holds numbers.
    rows : list of tuples of str
        Cells.
    """

    title: str
    columns: tuple[tuple[str, bool], ...]
    rows: list[tuple[str, ...]]


def number(value: float, unit: str = "") -> str:
    """Write a number: three digits after the point for lengths, five for shares and errors of shares."""
    if math.isnan(value):
        return "–"
    return f"{value:.3f} {unit}" if unit else f"{value:.5f}"


def title(report: Report) -> str:
    """Say in one line what was measured."""
    totals = report.totals
    subject, poses = totals.subject, int(totals.poses.sum())
    sequences = len(set(totals.cells["sequence"].tolist()))
    of = f" in {sequences:,} sequences" if totals.sequences else ""
    origin = "as given" if subject.root is None else f"relative to {subject.joints[subject.root]}"
    where = "" if totals.protocol.where == "all" else f", {totals.protocol.where} joints only"
    return (
        f"posecal {totals.version} · N = {subject.n_hypotheses} hypotheses · M = {poses:,} poses{of} · "
        f"K = {len(subject.joints)} joints, {origin}{where}"
    )


def headline(report: Report) -> list[Metric]:
    """Choose the metrics of the first table: the headlines, or all that were asked for by name."""
    asked = report.totals.protocol.metrics not in {"default", "all"}
    return [metric for metric in report.metrics.values() if metric.headline or asked]


def tables(report: Report, *, joints: bool = False) -> list[Table]:
    """Make the tables of a report.

    Parameters
    ----------
    report : Report
        The numbers.
    joints : bool
        Whether to add the table per joint.

    Returns
    -------
    list of Table
        One per family of metrics, then one per label to group by, then the one per joint.
    """
    shown = headline(report)
    found: list[Table] = []
    columns: tuple[tuple[str, bool], ...]
    for family, name in FAMILIES.items():
        rows = [metric for metric in shown if metric.family == family]
        if rows and family == "calibration":
            columns = (
                (name, False),
                ("value", True),
                ("perfect sampler", True),
                ("", False),
                ("what it is", False),
            )
            found.append(Table(name, columns, [_calibration_row(report, metric) for metric in rows]))
        elif rows:
            columns = ((name, False), ("value", True), ("", False), ("what it is", False))
            found.append(Table(name, columns, [_row(report, metric) for metric in rows]))
    for label in report.by:
        names = [name for name in BY_GROUP if name in report.metrics]
        columns = ((label, False), ("poses", True), *((report.metrics[name].label, True) for name in names))
        groups = [group for group in report.groups if group is not None and group.startswith(f"{label}=")]
        found.append(Table(f"By {label}", columns, [_group_row(report, group, names) for group in groups]))
    if joints:
        names = [name for name in BY_JOINT if name in report.metrics]
        columns = (("joint", False), *((report.metrics[name].label, True) for name in names))
        values = {(row.metric, row.joint): row.value for row in report.rows if row.joint is not None}
        found.append(
            Table(
                "By joint",
                columns,
                [
                    (
                        joint,
                        *(_short(values.get((name, joint), math.nan), report.metrics[name].unit) for name in names),
                    )
                    for joint in report.totals.subject.joints
                ],
            )
        )
    return found


def _row(report: Report, metric: Metric) -> tuple[str, ...]:
    return metric.label, number(report.value(metric.name), metric.unit), ARROWS[metric.direction], metric.brief


def _calibration_row(report: Report, metric: Metric) -> tuple[str, ...]:
    label, value, arrow, brief = _row(report, metric)
    return label, value, _perfect(report, metric), arrow, brief


def _perfect(report: Report, metric: Metric) -> str:
    floors = {row.metric: row.value for row in report.rows if "_floor" in row.metric}
    if f"{metric.name}_floor" in floors:
        return f"{floors[f'{metric.name}_floor']:.4f} (< {floors[f'{metric.name}_floor_95']:.4f})"
    return {"signed_area": "0"}.get(metric.name, "")


def _group_row(report: Report, group: str, names: list[str]) -> tuple[str, ...]:
    rows = {row.metric: row for row in report.rows if row.group == group and row.joint is None}
    cells = report.groups[group]
    poses = int(report.totals.poses[cells].sum())
    shown = (_short(rows[name].value, rows[name].unit) for name in names)
    return group.partition("=")[2], f"{poses:,}", *shown


def _short(value: float, unit: str) -> str:
    return "–" if math.isnan(value) else f"{value:.1f}" if unit else f"{value:.3f}"


def definitions(report: Report) -> list[tuple[str, str]]:
    """Give the label and the full definition of every number of the first tables."""
    return [(metric.label, metric.definition) for metric in headline(report)]


def as_text(
    report: Report,
    *,
    joints: bool = False,
    full: bool = False,
    width: int = 120,
    colour: bool = False,
) -> str:
    """Write a report for a terminal.

    Parameters
    ----------
    report : Report
        The numbers.
    joints, full : bool
        As ``joints`` and ``definitions`` of :meth:`posecal.Report.render`.
    width : int
        Columns of the terminal.
    colour : bool
        Whether to use its colours.

    Returns
    -------
    str
        The text, without a final line break.
    """
    out = io.StringIO()
    console = Console(
        file=out, width=width, force_terminal=colour, no_color=not colour, highlight=False, soft_wrap=False
    )
    console.print(Text(title(report), style="bold"))
    for table in tables(report, joints=joints):
        console.print()
        drawn = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style="bold")
        for heading, is_number in table.columns:
            dim = "dim" if heading == "what it is" else ""
            drawn.add_column(Text(heading), justify="right" if is_number else "left", style=dim, overflow="fold")
        for row in table.rows:
            drawn.add_row(*(Text(cell) for cell in row))
        console.print(drawn)
    if full:
        console.print()
        for label, definition in definitions(report):
            console.print(Text.assemble((label, "bold"), ": ", definition))
    console.print()
    console.print(Text(f"signature: {report.signature}", style="dim"), soft_wrap=True)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines())


def as_markdown(report: Report, *, joints: bool = False, full: bool = False) -> str:
    """Write a report as Markdown.

    Parameters
    ----------
    report, joints, full
        As for :func:`as_text`.

    Returns
    -------
    str
        The text, without a final line break.
    """
    lines = [title(report)]
    for table in tables(report, joints=joints):
        lines += ["", f"### {table.title}", ""]
        lines.append("| " + " | ".join(_escaped(heading) for heading, _ in table.columns) + " |")
        lines.append("|" + "|".join("---:" if is_number else "---" for _, is_number in table.columns) + "|")
        lines += ["| " + " | ".join(_escaped(cell) for cell in row) + " |" for row in table.rows]
    if full:
        lines += ["", "### Definitions", ""]
        lines += [f"- **{_escaped(label)}**: {_escaped(definition)}" for label, definition in definitions(report)]
    return "\n".join([*lines, "", f"`{report.signature}`"])


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def protocols_as_text(width: int = 120, *, colour: bool = False) -> str:
    """List the presets with every option that they set, then all options.

    Parameters
    ----------
    width : int
        Columns of the terminal.
    colour : bool
        Whether to use its colours.

    Returns
    -------
    str
        The text, without a final line break.
    """
    out = io.StringIO()
    console = Console(file=out, width=width, force_terminal=colour, no_color=not colour, highlight=False)
    for preset in PRESETS.values():
        console.print(Text.assemble((preset.name, "bold"), "  ", (preset.source, "dim")))
        for name, value in preset.options.items():
            console.print(Text(f"  {name} = {value}"), soft_wrap=True)
        if preset.note:
            console.print(Padding(Text(preset.note, style="dim"), (0, 0, 0, 2)))
        console.print()
    table = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style="bold")
    for heading in ("option", "default", "values", "what it says"):
        table.add_column(heading, overflow="fold")
    for option in fields(Protocol):
        values = " | ".join(option.metadata["choices"]) if "choices" in option.metadata else option.metadata["form"]
        table.add_row(*(Text(str(cell)) for cell in (option.name, option.default, values, option.metadata["about"])))
    console.print(table)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines())
