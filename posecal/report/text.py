"""The printed page of a report and the list of presets."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import fields
from itertools import groupby
from typing import TYPE_CHECKING

from posecal.data.root import root_name
from posecal.engine.metric import Metric
from posecal.engine.presets import PRESETS
from posecal.engine.protocol import CHOICES, Protocol
from posecal.errors import for_python, option
from posecal.report.absent import why_absent
from posecal.report.format import ARROWS, MISSING, NONE, as_printed, counted, number, short_number, short_p, span
from posecal.report.sheet import Sheet, Table
from posecal.report.summary import remarks
from posecal.stats.resampling import MESH

if TYPE_CHECKING:
    from posecal.report.report import Report

Words = Callable[[str], str]

FAMILIES = {
    "accuracy": "Accuracy",
    "calibration": "Calibration",
    "rank_tests": "Rank test",
    "scores": "Proper score",
    "sharpness": "Sharpness",
}
"""Titles of tables, by family."""

TOGETHER = ("accuracy", "calibration", "sharpness")
"""Families that are one table where their main metrics alone are shown."""

WHAT = "what it is"


def report_sheet(
    report: Report,
    *,
    all: bool = False,  # noqa: A002
    joints: bool = False,
    definitions: bool = False,
    paper: bool = False,
    words: Words = for_python,
) -> Sheet:
    """Lay out a report: by default one screen of what its numbers say and the main metrics.

    Parameters
    ----------
    report : Report
        The numbers; only those that are shown are computed.
    all, joints, definitions, words
        As for :meth:`posecal.Report.render`.
    paper : bool
        Whether units and directions stand in headings, as papers print them, and PCK and AUC are in per cent.

    Returns
    -------
    Sheet
        To be written as text, Markdown, LaTeX or HTML.
    """
    known = [*report.headline_metrics.values()]
    shown = known if all else [metric for metric in known if _is_main(report, metric)] or known
    families = [[family] for family in FAMILIES]
    if not all:
        families = [[*TOGETHER], *(each for each in families if each[0] not in TOGETHER)]
    tables = []
    for some in families:
        metrics = [metric for family in some for metric in shown if metric.family == family]
        if metrics:
            title = FAMILIES[some[0]] if len(some) == 1 else "Metric"
            tables.append(_metrics(report, title, metrics, what=all and not paper, paper=paper))
    tables += [_by_label(report, label, paper=paper) for label in report.by]
    others = [metric.label for metric in known if metric not in shown]
    notes = list(remarks(report, words))
    if joints and any(metric.in_joint_table for metric in report.metrics.values()):
        tables.append(_by_joint(report, paper=paper))
    elif joints:
        notes.append("no table of joints: none of these metrics has a number for each.")
    return Sheet(
        title=report_title(report),
        sentences=list(report.summary),
        remarks=notes,
        tables=tables,
        definitions=[
            (metric.label, report.definition(metric.name)) for metric in shown if definitions or (all and paper)
        ],
        more=f"{words(option('all', True))}: what each number is, and {_listed(others)}." if others else "",
        footer=f"signature: {report.signature}",
    )


def _listed(labels: list[str]) -> str:
    """Name some metrics in a line; of those that differ in a number the first words once."""
    groups = groupby(labels, key=lambda label: label[: re.search(r"\d|$", label).start()])  # type: ignore[union-attr]
    return ", ".join(first + ", ".join(label.removeprefix(first) for label in some) for first, some in groups)


def _is_main(report: Report, metric: Metric) -> bool:
    totals = report.totals
    asked = totals.protocol.asks_for(metric.name, metric.family)
    return asked or metric.in_group_table or metric.name in {own.name for own in totals.own_metrics}


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


def _metrics(report: Report, title: str, metrics: list[Metric], *, what: bool, paper: bool) -> Table:
    """Lay out metrics with their intervals, what a calibrated model has, and p-values: of rank tests the adjusted ones.

    Columns without an entry are left out.
    """
    adjusted = {name: p for name, (_, p) in report.rank_tests().items() if name in {m.name for m in metrics}}
    headings = (title, "", "value", "95 % interval", "if calibrated", "up to", "adjusted p" if adjusted else "p", WHAT)
    rows = []
    for metric in metrics:
        interval, expected, brief = NONE, ("", "", ""), metric.brief
        if metric.deviation is None:
            interval = shown = report.interval(metric.name)
            if not math.isnan(metric.calibrated):
                expected = (f"{metric.calibrated:.3g}", "", "")
        else:
            test, expected = report.test(metric.name), (MISSING, MISSING, "no test")
            p, shown = adjusted.get(metric.name, test.p), (0.0, min(0.09, test.high))  # three digits or more
            if not math.isnan(p):
                expected = (number(test.mean, "", shown), number(test.high, "", shown), short_p(p))
            if f"{metric.name}_floor" in report.auxiliary and len(report.totals.spec.joints) <= MESH:
                brief += f"; calibrated, independent frames: {report[f'{metric.name}_floor']:.4f}"
        if reason := why_absent(report, metric.name):
            brief += f"; none, since {reason}"
        label, unit, scale = as_printed(metric) if paper else (metric.label, metric.unit, 1.0)
        low, high = scale * interval[0], scale * interval[1]
        shown = (low, high) if metric.deviation is None else shown
        value, ends = number(scale * report[metric.name], unit, shown), span(low, high, unit)
        row = (label, ARROWS[metric.direction], value, ends, *expected, brief)
        rows.append(_for_paper(row, unit) if paper else row)
    if paper:
        headings = (title, "", "value (95 % interval)", *headings[3:])
    kept = [k for k in range(len(headings)) if any(row[k] for row in rows) and (what or headings[k] != WHAT)]
    return Table(title, [headings[k] for k in kept], [tuple(row[k] for k in kept) for row in rows], ("", WHAT))


def _for_paper(row: tuple[str, ...], unit: str) -> tuple[str, ...]:
    """Make one column of a number and its interval, and of what a calibrated model has and its limit."""
    label, _, value, ends, mean, limit, p, brief = row
    value = value.removesuffix(f" {unit}") + (f" ({ends})" if ends else "")
    mean += f" (up to {limit})" if limit not in {"", MISSING} else ""
    return label, "", value, "", mean, "", p, brief


def _by_label(report: Report, label: str, *, paper: bool) -> Table:
    groups = [group for group in report.groups if (group or "").startswith(f"{label}=")]
    metrics = {n: m for n, m in report.metrics_in(groups[0]).items() if m.in_group_table}
    rows = []
    for group in groups:
        poses = max(report.count(name, group) for name in metrics or report.metrics_in(group))
        values = (_short(report.value(name, group), metric, paper=paper) for name, metric in metrics.items())
        rows.append((str(group).partition("=")[2], f"{poses:,}", *values))
    return Table(f"By {label}", (label, "poses", *(_heading(m, paper=paper) for m in metrics.values())), rows)


def _short(value: float, metric: Metric, *, paper: bool) -> str:
    _, unit, scale = as_printed(metric) if paper else ("", metric.unit, 1.0)
    return short_number(scale * value, unit)


def _heading(metric: Metric, *, paper: bool) -> str:
    """Name a column of a wide table, with the unit where that is not the usual one or a paper prints it."""
    if paper:
        return as_printed(metric)[0]
    return f"{metric.label} [{metric.unit}]" if metric.unit not in {"", "mm"} else metric.label


def _by_joint(report: Report, *, paper: bool) -> Table:
    metrics = {name: metric for name, metric in report.metrics.items() if metric.in_joint_table}
    rows = [
        (joint, *(_short(report.value(n, joint=joint), metric, paper=paper) for n, metric in metrics.items()))
        for joint in report.totals.spec.joints
    ]
    return Table("By joint", ("joint", *(_heading(m, paper=paper) for m in metrics.values())), rows)


def presets_sheet() -> Sheet:
    """Lay out the published protocols with every option that they set, then all options."""
    presets = [
        (preset.name, preset.source, "\n".join(f"{k} = {v}" for k, v in preset.options.items()), preset.note)
        for preset in PRESETS.values()
    ]
    options = []
    for field in fields(Protocol):
        values = " | ".join(CHOICES.get(field.name, ())) or field.metadata["form"]
        options.append((field.name, str(field.default), values, field.metadata["about"]))
    headings = ("preset", "follows", "sets", "note"), ("option", "default", "values", "what it says")
    return Sheet(
        "Published protocols, each with the options that it sets, and all options",
        tables=[
            Table("Presets", headings[0], presets, headings[0], breaks=True),
            Table("Options", headings[1], options, headings[1]),
        ],
    )
