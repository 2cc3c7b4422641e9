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
from posecal.registry import GROUPS
from posecal.report import Report, Row
from posecal.verdict import verdict

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

FAMILIES = {
    "accuracy": "Accuracy",
    "calibration": "Calibration",
    "battery": "Battery",
    "scores": "Proper scores",
    "spread": "Spread",
}
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
    """Choose the metrics of the first tables: the headlines, and what was asked for by name or family."""
    words = {word.strip() for word in report.totals.protocol.metrics.split(",")}
    named = words - set(GROUPS)
    return [
        metric
        for name, metric in report.metrics.items()
        if metric.headline or name in named or metric.family in words or "all" in words
    ]


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
        if rows:
            second = {"calibration": "by chance, or 95 %", "battery": "by chance"}.get(family, "95 % interval")
            columns = ((name, False), ("value", True), (second, False), ("", False), ("what it is", False))
            found.append(Table(name, columns, [_row(report, metric) for metric in rows]))
    for label in report.by:
        grouped: dict[str, dict[str, Row]] = {}
        for row in report.rows:
            if row.joint is None and row.group is not None and row.group.startswith(f"{label}="):
                grouped.setdefault(row.group.partition("=")[2], {})[row.metric] = row
        names = [name for name in BY_GROUP if all(name in group for group in grouped.values())]
        columns = ((label, False), ("poses", True), *((report.metrics[name].label, True) for name in names))
        found.append(Table(f"By {label}", columns, [_group_row(*group, names) for group in grouped.items()]))
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
    value = number(report.value(metric.name), metric.unit)
    return metric.label, value, _sureness(report, metric), ARROWS[metric.direction], metric.brief


def _sureness(report: Report, metric: Metric) -> str:
    """A 95 % interval; for a calibration error what a calibrated sampler would show, and the p-value."""
    if metric.deviation is None:
        row = next(row for row in report.rows if (row.metric, row.group, row.joint) == (metric.name, None, None))
        digits = 1 if metric.unit else 3
        return "" if math.isnan(row.low) else f"{row.low:.{digits}f} to {row.high:.{digits}f}"
    found = report.null(metric.name)
    if math.isnan(found.p):
        return "no test"
    p = report.battery()[metric.name][1] if metric.family == "battery" else found.p
    shown = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    return f"{found.mean:.3f}, below {found.high:.3f}; {shown}"


def _group_row(group: str, rows: dict[str, Row], names: list[str]) -> tuple[str, ...]:
    poses = max(row.poses for row in rows.values())
    return group, f"{poses:,}", *(_short(rows[name].value, rows[name].unit) for name in names)


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
    for sentence in verdict(report):
        console.print(Text(sentence))
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
    lines = [title(report), *(line for sentence in verdict(report) for line in ("", _escaped(sentence)))]
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
