"""What is on the sheet of a report, a comparison, a recalibration, or the list of presets?

One screen for a report by default: what its numbers say, then accuracy, calibration and spread over all poses, each
number with how sure it is and what it is in a few words.
"""

from __future__ import annotations

import math
from dataclasses import fields

from posecal.block import FloatArray
from posecal.comparison import Comparison
from posecal.conclusion import verdict
from posecal.metric import Metric
from posecal.protocol import PRESETS, Protocol
from posecal.recalibration import RadiusMap, SpreadMap
from posecal.registry import GROUPS
from posecal.report import Report, Row
from posecal.tables import Sheet, Table
from posecal.totals import Totals

__all__ = ["comparison_sheet", "presets_sheet", "radius_sheet", "report_sheet", "spread_sheet"]

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


def report_sheet(report: Report, *, joints: bool = False, definitions: bool = False) -> Sheet:
    """Lay out a report.

    Parameters
    ----------
    report : Report
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
        sentences=verdict(report),
        tables=tables(report, joints=joints),
        definitions=definitions_of(report) if definitions else [],
        footer=f"signature: {report.signature}",
    )


def number(value: float, unit: str = "") -> str:
    """Write a number: three digits after the point for lengths, five for shares and errors of shares."""
    if math.isnan(value):
        return "–"
    return f"{value:z.3f} {unit}" if unit else f"{value:z.5f}"


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
    floors = [row for row in report.rows if row.metric == f"{metric.name}_floor"]
    brief = metric.brief + "".join(f"; {row.value:.4f} if frames were independent" for row in floors)
    return metric.label, value, _sureness(report, metric), ARROWS[metric.direction], brief


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
    return f"{found.mean:.3f}, below {found.high:.3f}; {_p(p)}"


def _p(value: float) -> str:
    return "p < 0.001" if value < 0.001 else f"p = {value:.3f}"


def _group_row(group: str, rows: dict[str, Row], names: list[str]) -> tuple[str, ...]:
    poses = max(row.poses for row in rows.values())
    return group, f"{poses:,}", *(_short(rows[name].value, rows[name].unit) for name in names)


def _short(value: float, unit: str) -> str:
    return "–" if math.isnan(value) else f"{value:z.1f}" if unit else f"{value:z.3f}"


def definitions_of(report: Report) -> list[tuple[str, str]]:
    """Give the label and the full definition of every number of the first tables."""
    return [(metric.label, metric.definition) for metric in headline(report)]


# --- other sheets ---------------------------------------------------------------------------------------------------


def presets_sheet() -> Sheet:
    """Lay out the presets with every option that they set, then all options."""
    presets: list[tuple[str, ...]] = [
        (preset.name, preset.source, "\n".join(f"{k} = {v}" for k, v in preset.options.items()), preset.note)
        for preset in PRESETS.values()
    ]
    options: list[tuple[str, ...]] = [
        (
            option.name,
            str(option.default),
            " | ".join(option.metadata["choices"]) if "choices" in option.metadata else option.metadata["form"],
            option.metadata["about"],
        )
        for option in fields(Protocol)
    ]
    return Sheet(
        "Published protocols, each with the options that it sets, and all options",
        tables=[
            Table("Presets", (("preset", False), ("follows", False), ("sets", False), ("note", False)), presets),
            Table(
                "Options", (("option", False), ("default", False), ("values", False), ("what it says", False)), options
            ),
        ],
    )


def comparison_sheet(comparison: Comparison) -> Sheet:
    """Lay out a comparison: two models with their differences, or more with their ranks."""
    metrics = {name: metric for name, metric in comparison.metrics.items() if _compared(metric)}
    names = comparison.names
    if len(names) == 2:
        columns = [("metric", False), *((name, True) for name in names), ("difference", True)]
        columns += [("95 % interval", False), ("p", False), ("better", False)]
        rows = []
        for name, metric in metrics.items():
            found = next(d for d in comparison.differences if d.metric == name)
            digits = 2 if metric.unit else 4
            values = (number(comparison.value(name, model), metric.unit) for model in names)
            sure = "" if math.isnan(found.low) else f"{found.low:+.{digits}f} to {found.high:+.{digits}f}"
            p = "" if math.isnan(found.p) else _p(found.p)
            rows.append((metric.label, *values, f"{found.value:+.{digits}f}", sure, p, found.better or ""))
    else:
        columns = [("metric", False), *((f"{name} (rank)", True) for name in names)]
        rows = []
        for name, metric in metrics.items():
            cells = []
            for model in names:
                rank = f" ({comparison.rank(name, model)})" if metric.direction != "none" else ""
                cells.append(number(comparison.value(name, model), metric.unit) + rank)
            rows.append((metric.label, *cells))
    poses, sequences = int(comparison.totals[0].poses.sum()), len(set(comparison.totals[0].cells["sequence"].tolist()))
    return Sheet(
        f"{' against '.join(names)} · the same M = {poses:,} poses, paired by {sequences:,} sequences",
        sentences=_said(comparison),
        tables=[Table("Comparison", tuple(columns), rows)],
        footer=f"signature: {comparison.totals[0].signature}",
    )


def _compared(metric: Metric) -> bool:
    return metric.headline or metric.family in {"scores", "battery"}


def _said(comparison: Comparison) -> list[str]:
    """What the two axes, accuracy and calibration, say of the models."""
    found = []
    for name in ("min_mpjpe", "ece", "energy_score"):
        if name not in comparison.metrics:
            continue
        label = comparison.metrics[name].label
        winners = [m for m in comparison.names if all(comparison.rank(name, o) > 1 for o in comparison.names if o != m)]
        best = [model for model in winners if comparison.rank(name, model) == 1]
        found.append(f"{label}: {best[0]} is best beyond chance." if best else f"{label}: none is best beyond chance.")
    if "ece" in comparison.metrics and not math.isnan(limit := comparison.feasible()):
        calibrated = [model for model in comparison.names if comparison.value("ece", model) <= limit]
        found.append(
            f"ECE that chance allows here: up to {limit:.3f}; so calibrated: {', '.join(calibrated) or 'none'}."
        )
    return found


def spread_sheet(found: SpreadMap, judged: tuple[Totals, Totals, list[FloatArray]] | None = None) -> Sheet:
    """Lay out a fitted spread factor, and what it does to held-out sequences."""
    moving = [(joint, factor) for joint, factor in zip(found.joints, found.factors, strict=True) if factor != 1]
    factors = {round(factor, 9) for _, factor in moving}
    words, tables = [], []
    rows: list[tuple[str, ...]]
    if len(factors) == 1:
        words.append(f"Spread factor {moving[0][1]:.4f} for all joints, fitted on {found.poses:,} poses.")
    else:
        words.append(f"A spread factor for each of {len(moving)} joints, fitted on {found.poses:,} poses.")
        rows = [(joint, f"{factor:.4f}") for joint, factor in moving]
        tables.append(Table("Factors", (("joint", False), ("factor", True)), rows))
    if judged is None:
        words.append("Not judged: --split says what it does to sequences that it was not fitted on.")
    else:
        before, after = Report(judged[0]), Report(judged[1])
        names = ("ece", "signed_area", "coverage_50", "coverage_90", "radius_50", "min_mpjpe", "mpjpe")
        rows = [
            (
                before.metrics[name].label,
                number(before.value(name), before.metrics[name].unit),
                number(after.value(name), after.metrics[name].unit),
            )
            for name in names
        ]
        columns = ((f"held out, {len(judged[2])} parts", False), ("before", True), ("after", True))
        tables.append(Table("Held-out sequences", columns, rows))
        cost = after.value("min_mpjpe") - before.value("min_mpjpe")
        if cost > 0:
            words.append(f"It costs {cost:.1f} mm of minMPJPE, which rewards a spread that is too narrow.")
    return Sheet("Recalibrated spread", words, tables)


def radius_sheet(found: RadiusMap, held_out: FloatArray | None = None) -> Sheet:
    """Lay out fitted radii, and the share of held-out truths that they hold."""
    unit = "standard deviations" if found.scaled else "mm"
    columns = [("joint", False), (f"radius, {unit}", True)]
    rows: list[tuple[str, ...]] = []
    for place, (joint, radius) in enumerate(zip(found.joints, found.radii, strict=True)):
        if not math.isnan(radius):
            held = () if held_out is None else (f"{held_out[place]:.3f}",)
            rows.append((joint, f"{radius:.2f}", *held))
    words = [f"Radii about the median that hold {1 - found.alpha:.0%} of the truths of {found.poses:,} poses."]
    if held_out is None:
        words.append("Not judged: --split says how many truths they hold in sequences that they were not fitted on.")
    else:
        columns.append(("held-out coverage", True))
    return Sheet("Conformal radii", words, [Table("Radii", tuple(columns), rows)])
