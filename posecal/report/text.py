"""The printed page of a report and the list of presets."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING

from posecal.data.root import root_name
from posecal.engine.metric import Metric
from posecal.engine.presets import PRESETS
from posecal.engine.protocol import CHOICES, Protocol
from posecal.errors import for_python
from posecal.report.format import MISSING, counted, number, short_number, short_p, span
from posecal.report.sheet import Sheet, Table
from posecal.report.summary import remarks
from posecal.stats.resampling import MESH

if TYPE_CHECKING:
    from posecal.report.report import Report

Words = Callable[[str], str]

FAMILIES = {
    ("accuracy", False): "Accuracy",
    ("calibration", True): "Calibration error",
    ("calibration", False): "Calibration",
    ("rank_tests", True): "Rank test",
    ("scores", False): "Proper score",
    ("sharpness", False): "Sharpness",
}
"""Titles of tables, by family and whether its metrics are tested against a calibrated sampler."""

WHAT = "what it is"
ARROWS = {"lower": "↓", "higher": "↑", "zero": "0", "none": ""}


def report_sheet(
    report: Report, *, joints: bool = False, definitions: bool = False, words: Words = for_python
) -> Sheet:
    """Lay out a report: by default one screen of what its numbers say and the headline metrics.

    Parameters
    ----------
    report : Report
        The numbers; only those that are shown are computed.
    joints, definitions, words
        As for :meth:`posecal.Report.render`.

    Returns
    -------
    Sheet
        To be written as text, Markdown, LaTeX or HTML.
    """
    shown = report.headline_metrics.values()
    tables = []
    for (family, tested), title in FAMILIES.items():
        metrics = [m for m in shown if m.family == family and (m.deviation is not None) == tested]
        if metrics:
            tables.append((_tests if tested else _values)(report, title, metrics))
    tables += [_by_label(report, label) for label in report.by]
    return Sheet(
        title=report_title(report),
        sentences=list(report.summary),
        remarks=list(remarks(report, words)),
        tables=[*tables, _by_joint(report)] if joints else tables,
        definitions=[(metric.label, metric.definition) for metric in shown] if definitions else [],
        footer=f"signature: {report.signature}",
    )


def report_title(report: Report) -> str:
    """Write in one line what was measured."""
    totals = report.totals
    spec, poses = totals.spec, int(totals.poses.sum())
    of = f" in {totals.units()}" if totals.has_sequences else ""
    origin = "as given" if spec.root is None else f"relative to {root_name(spec.root, spec.joints)}"
    where = "" if totals.protocol.where == "all" else f", {totals.protocol.where} joints only"
    return (
        f"posecal {totals.version} · N = {counted(spec.n_hypotheses, 'hypothesis', 'hypotheses')} · "
        f"M = {counted(poses, 'pose')}{of} · K = {counted(len(spec.joints), *spec.point)}, {origin}{where}"
    )


def short_title(report: Report) -> str:
    """Write in one line the size of the data and the three numbers that a model is known by."""
    totals, names = report.totals, [name for name in ("min_mpjpe", "ece", "signed_area") if name in report.metrics]
    shown = {name: report.metrics[name] for name in names or [*report.headline_metrics][:3]}
    numbers = ", ".join(f"{m.label} {short_number(report[n], m.unit)} {m.unit}".rstrip() for n, m in shown.items())
    sizes = f"N={totals.spec.n_hypotheses}, M={int(totals.poses.sum()):,}, K={len(totals.spec.joints)}"
    return f"<posecal Report: {sizes}, {totals.units()}: {numbers}>"


def _values(report: Report, title: str, metrics: list[Metric]) -> Table:
    rows = []
    for metric in metrics:
        interval = report.interval(metric.name)
        value = number(report[metric.name], metric.unit, interval)
        rows.append((metric.label, value, span(*interval, metric.unit), ARROWS[metric.direction], metric.brief))
    return Table(title, (title, "value", "95 % interval", "", WHAT), rows, ("", WHAT))


def _tests(report: Report, title: str, metrics: list[Metric]) -> Table:
    """Lay out errors with those of a calibrated sampler and p-values, of rank tests the adjusted ones."""
    adjusted = {name: p for name, (_, p) in report.rank_tests().items()}
    p_heading = "adjusted p" if any(metric.name in adjusted for metric in metrics) else "p"
    headings = (title, "value", "null mean", "null 95 %", p_heading, "", WHAT)
    rows = []
    for metric in metrics:
        test, brief = report.test(metric.name), metric.brief
        p = adjusted.get(metric.name, test.p)
        known, null = (0.0, min(test.high, 0.09)), (MISSING, MISSING, "no test")  # three digits or more
        if not math.isnan(p):
            null = (number(test.mean, "", known), number(test.high, "", known), short_p(p))
        if f"{metric.name}_floor" in report.auxiliary and len(report.totals.spec.joints) <= MESH:
            brief += f"; calibrated, independent frames: {report[f'{metric.name}_floor']:.4f}"
        rows.append((metric.label, number(report[metric.name], "", known), *null, ARROWS[metric.direction], brief))
    return Table(title, headings, rows, ("", WHAT))


def _by_label(report: Report, label: str) -> Table:
    groups = [group for group in report.groups if (group or "").startswith(f"{label}=")]
    metrics = {n: m for n, m in report.metrics_in(groups[0]).items() if m.in_group_table}
    rows = []
    for group in groups:
        poses = max(report.count(name, group) for name in metrics or report.metrics_in(group))
        values = (short_number(report.value(name, group), metric.unit) for name, metric in metrics.items())
        rows.append((str(group).partition("=")[2], f"{poses:,}", *values))
    return Table(f"By {label}", (label, "poses", *map(_heading, metrics.values())), rows)


def _heading(metric: Metric) -> str:
    """Name a column of a wide table, with the unit where that is not the usual one."""
    return f"{metric.label} [{metric.unit}]" if metric.unit not in {"", "mm"} else metric.label


def _by_joint(report: Report) -> Table:
    metrics = {name: metric for name, metric in report.metrics.items() if metric.in_joint_table}
    rows = [
        (joint, *(short_number(report.value(name, joint=joint), metric.unit) for name, metric in metrics.items()))
        for joint in report.totals.spec.joints
    ]
    return Table("By joint", ("joint", *map(_heading, metrics.values())), rows)


def presets_sheet() -> Sheet:
    """Lay out the published protocols with every option that they set, then all options."""
    presets = [
        (preset.name, preset.source, "\n".join(f"{k} = {v}" for k, v in preset.options.items()), preset.note)
        for preset in PRESETS.values()
    ]
    options = []
    for option in fields(Protocol):
        values = " | ".join(CHOICES.get(option.name, ())) or option.metadata["form"]
        options.append((option.name, str(option.default), values, option.metadata["about"]))
    headings = ("preset", "follows", "sets", "note"), ("option", "default", "values", "what it says")
    return Sheet(
        "Published protocols, each with the options that it sets, and all options",
        tables=[
            Table("Presets", headings[0], presets, headings[0], breaks=True),
            Table("Options", headings[1], options, headings[1]),
        ],
    )
