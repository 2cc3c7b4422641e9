"""What is on the sheet of a report?

One screen by default: what its numbers say, then accuracy, calibration and spread over all poses, each number with how
sure it is and what it is in a few words.
"""

from __future__ import annotations

import math

from posecal.engine.metric import Metric
from posecal.registry import GROUPS
from posecal.report.findings import Findings
from posecal.report.format import brief_number, counted, number, p_value
from posecal.report.rows import Row
from posecal.report.summary import summarize
from posecal.report.tables import Sheet, Table

__all__ = ["report_sheet"]

FAMILIES = {
    "accuracy": "Accuracy",
    "calibration": "Calibration",
    "rank_tests": "Rank tests",
    "scores": "Proper scores",
    "sharpness": "Sharpness",
}
ARROWS = {"lower": "↓", "higher": "↑", "zero": "0", "none": ""}
BY_GROUP = ("min_mpjpe", "mpjpe", "pa_min_mpjpe", "pck", "ece", "signed_area", "coverage_90", "radius_50")
BY_JOINT = ("min_mpjpe", "mpjpe", "ece", "signed_area", "coverage_50", "coverage_90", "radius_50", "radius_90")


def report_sheet(report: Findings, *, joints: bool = False, definitions: bool = False) -> Sheet:
    """Lay out a report.

    Parameters
    ----------
    report : Findings
        The numbers.
    joints, definitions : bool
        As for :meth:`posecal.Report.render`.

    Returns
    -------
    Sheet
        To be written as text or Markdown.
    """
    return Sheet(
        title=title(report),
        sentences=summarize(report),
        tables=tables(report, joints=joints),
        definitions=definitions_of(report) if definitions else [],
        footer=f"signature: {report.signature}",
    )


def title(report: Findings) -> str:
    """Say in one line what was measured."""
    totals = report.totals
    spec, poses = totals.spec, int(totals.poses.sum())
    of = f" in {totals.units()}" if totals.sequences else ""
    origin = "as given" if spec.root is None else f"relative to {spec.joints[spec.root]}"
    where = "" if totals.protocol.where == "all" else f", {totals.protocol.where} joints only"
    return (
        f"posecal {totals.version} · N = {counted(spec.n_hypotheses, 'hypothesis', 'hypotheses')} · "
        f"M = {counted(poses, 'pose')}{of} · K = {counted(len(spec.joints), 'joint')}, {origin}{where}"
    )


def headline(report: Findings) -> list[Metric]:
    """Choose the metrics of the first tables: the headlines, and what was asked for by name or family."""
    words = set(report.totals.protocol.wanted)
    named = words - set(GROUPS)
    return [
        metric
        for name, metric in report.metrics.items()
        if metric.headline or name in named or metric.family in words or "all" in words
    ]


def tables(report: Findings, *, joints: bool = False) -> list[Table]:
    """Make the tables of a report.

    Parameters
    ----------
    report : Findings
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
            second = {"calibration": "by chance, or 95 %", "rank_tests": "by chance; p adjusted"}.get(
                family, "95 % interval"
            )
            columns = ((name, False), ("value", True), (second, False), ("", False), ("what it is", False))
            found.append(Table(name, columns, [_row(report, metric) for metric in rows]))
    for label in report.by:
        grouped: dict[str, dict[str, Row]] = {}
        for row in report.rows:
            if row.joint is None and row.group is not None and row.group.startswith(f"{label}="):
                grouped.setdefault(row.group.partition("=")[2], {})[row.metric] = row
        names = [name for name in BY_GROUP if all(name in group for group in grouped.values())]
        labels = {row.metric: row.label for rows in grouped.values() for row in rows.values()}
        columns = ((label, False), ("poses", True), *((labels[name], True) for name in names))
        found.append(Table(f"By {label}", columns, [_group_row(*group, names) for group in grouped.items()]))
    if joints:
        names = [name for name in BY_JOINT if name in report.metrics]
        columns = (("joint", False), *((report.metrics[name].label, True) for name in names))
        at_joint = {(row.joint, row.metric): row for row in report.rows}
        every = report.totals.spec.joints
        found.append(Table("By joint", columns, [_joint_row(joint, at_joint, names) for joint in every]))
    return found


def _row(report: Findings, metric: Metric) -> tuple[str, ...]:
    value = number(report.value(metric.name), metric.unit)
    floors = [row for row in report.rows if row.metric == f"{metric.name}_floor"]
    brief = metric.brief + "".join(f"; {row.value:.4f} if frames were independent" for row in floors)
    return metric.label, value, _sureness(report, metric), ARROWS[metric.direction], brief


def _sureness(report: Findings, metric: Metric) -> str:
    """A 95 % interval; for a calibration error what a calibrated sampler would show, and the p-value."""
    if metric.deviation is None:
        row = next(row for row in report.rows if (row.metric, row.group, row.joint) == (metric.name, None, None))
        digits = 1 if metric.unit else 3
        return "" if math.isnan(row.low) else f"{row.low:.{digits}f} to {row.high:.{digits}f}"
    found = report.null(metric.name)
    if math.isnan(found.p):
        return "no test"
    p = report.rank_tests()[metric.name][1] if metric.family == "rank_tests" else found.p
    return f"{found.mean:.3f}, below {found.high:.3f}; {p_value(p)}"


def _group_row(group: str, rows: dict[str, Row], names: list[str]) -> tuple[str, ...]:
    poses = max(row.poses for row in rows.values())
    return group, f"{poses:,}", *(brief_number(rows[name].value, rows[name].unit) for name in names)


def _joint_row(joint: str, rows: dict[tuple[str | None, str], Row], names: list[str]) -> tuple[str, ...]:
    found = (rows.get((joint, name)) for name in names)
    return joint, *("–" if row is None else brief_number(row.value, row.unit) for row in found)


def definitions_of(report: Findings) -> list[tuple[str, str]]:
    """Give the label and the full definition of every number of the first tables."""
    return [(metric.label, metric.definition) for metric in headline(report)]
