"""Tables of the page: numbers to sort by, intervals to draw, and small curves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posecal.calibration import LEVELS
from posecal.calibration.curve import SUMMARIES
from posecal.data.arrays import FloatArray
from posecal.engine.metric import Metric
from posecal.engine.sums import mean_of
from posecal.report.format import MISSING, NONE, number, short_number, short_p, span

if TYPE_CHECKING:
    from posecal.report.report import Report

MOST_ROWS = 200
"""Rows of a table; of more joints, groups or sequences the worst are shown."""

BETTER = {"lower": "lower", "higher": "higher", "zero": "0", "none": ""}
ROUNDED = 0.0, 0.09  # an interval that supports three digits


@dataclass(frozen=True)
class Drawn:
    """Places on an axis from 0 to 100: a value, its interval, and the best value.

    Attributes
    ----------
    value, start : float
        The value, and where a bar to it begins: at the best value, or at 0.
    low, high, best : float or None
        None where there is none.
    is_null : bool
        Whether the interval is that of a calibrated model.
    """

    value: float
    start: float
    low: float | None
    high: float | None
    best: float | None
    is_null: bool


@dataclass(frozen=True)
class Cell:
    """What stands in a cell: text, the number to sort by, what is drawn, the path of a curve, and a hint."""

    text: str = ""
    key: float | None = None
    drawn: Drawn | None = None
    curve: str = ""
    hint: str = ""


@dataclass(frozen=True)
class PageTable:
    """A table that can be sorted.

    Attributes
    ----------
    title, note : str
        Above it.
    columns : list of (str, bool)
        Headings, and whether a column holds numbers.
    rows : list of lists of Cell
        In each row as many as there are columns.
    """

    title: str
    columns: list[tuple[str, bool]]
    rows: list[list[Cell]]
    note: str = ""


def metric_table(report: Report) -> PageTable:
    """Lay out the headline metrics with their intervals, or what a calibrated model may show."""
    metrics = report.headline_metrics
    adjusted = {name: p for name, (_, p) in report.rank_tests().items()}
    ends: dict[str, tuple[float, float]] = {}
    reach: dict[tuple[bool, str, str], list[float]] = {}
    for name, metric in metrics.items():
        tested = metric.deviation is not None
        ends[name] = (0.0, report.test(name).high) if tested else report.interval(name)
        reach.setdefault((tested, metric.family * (not tested), metric.unit), []).extend([report[name], *ends[name]])
    rows = []
    for name, metric in metrics.items():
        value, (low, high), tested, test = report[name], ends[name], metric.deviation is not None, Cell()
        axis = _axis(metric, reach[tested, metric.family * (not tested), metric.unit])
        text, interval = number(value, metric.unit, (low, high)), span(low, high, metric.unit)
        if tested:
            p = adjusted.get(name, report.test(name).p)
            test = Cell(MISSING if math.isnan(p) else short_p(p), _key(p), hint="adjusted" * (name in adjusted))
            text, interval = number(value, "", ROUNDED), MISSING
            if not math.isnan(high):
                interval = f"to {number(high, '', (0.0, min(high, ROUNDED[1])))} if calibrated"
        drawn = _drawn(value, (low, high), axis, _best(metric), is_null=tested)
        first = Cell(metric.label, hint=report.definition(name)), Cell(text, _key(value))
        rows.append([*first, Cell(interval, _key(high - low), drawn), test, Cell(BETTER[metric.direction])])
        rows[-1].append(Cell(metric.brief))
    columns = [("metric", False), ("value", True), ("95 % interval", False), ("p", True), ("best", False)]
    note = "Drawn: the 95 % interval over sequences; of calibration errors, grey, what a calibrated model may show."
    return PageTable("Metrics", [*columns, ("what it is", False)], rows, note)


def label_table(report: Report, label: str) -> PageTable:
    """Lay out the groups by a label."""
    groups = [group for group in report.groups if group is not None and group.startswith(f"{label}=")]
    known = report.metrics_in(groups[0])
    metrics = {name: metric for name, metric in known.items() if metric.in_group_table}
    columns = [
        _column(m, [report.value(name, group) for group in groups], [report.interval(name, group) for group in groups])
        for name, m in metrics.items()
    ]
    poses = [max(report.count(name, group) for name in metrics or report.metrics_in(group)) for group in groups]
    has_curve = has_curves(report, groups[0])
    curves = [report.summary_curve(group=group) if has_curve else np.full(len(LEVELS), np.nan) for group in groups]
    rows = _rows([group.partition("=")[2] for group in groups], poses, curves, columns)
    return _limited(f"By {label}", [(label, False), *_headings(metrics.values())], rows)


def sequence_table(report: Report) -> PageTable | None:
    """Lay out the sequences from worst to best: by their ECE, or where it is not known by their error."""
    totals = report.totals
    names = [name for name in ("ece", "signed_area", "min_mpjpe", "mpjpe") if name in report.metrics]
    if not totals.has_sequences or totals.n_sequences < 2 or not names:
        return None
    metrics = [report.metrics[name] for name in names]
    values = [np.asarray(m.finish(mean_of(*totals.by_sequence(m.statistic))), dtype=np.float64) for m in metrics]
    order = np.argsort(-np.nan_to_num(np.abs(values[0]), nan=-1.0), kind="stable")
    shown, sequences = order[:MOST_ROWS], np.unique(totals.cells["sequence"])
    curves = np.full((len(shown), len(LEVELS)), np.nan)
    if names[0] == "ece":
        sums, counts = totals.by_sequence(metrics[0].statistic)
        curves = SUMMARIES[totals.protocol.summary_over_joints](mean_of(sums[shown], counts[shown]))
    poses = np.bincount(totals.sequence_of, totals.poses)[shown].astype(int).tolist()
    columns = [_column(m, some[shown].tolist(), [NONE] * len(shown)) for m, some in zip(metrics, values, strict=True)]
    rows = _rows([str(sequences[row]) for row in shown], poses, list(curves), columns)
    title = f"Sequences, worst first by {metrics[0].label}"
    note = "" if len(order) == len(shown) else f"The {len(shown)} worst of {len(order):,}."
    return PageTable(title, [("sequence", False), *_headings(metrics)], rows, note)


def joint_table(report: Report) -> PageTable | None:
    """Lay out the joints."""
    joints = report.totals.spec.joints
    metrics = {name: metric for name, metric in report.metrics.items() if metric.in_joint_table}
    if not metrics:
        return None
    columns = []
    for name, m in metrics.items():
        values = [report.value(name, joint=joint) for joint in joints]
        columns.append(_column(m, values, [report.interval(name, joint=joint) for joint in joints]))
    first = [Cell(joint, float(row)) for row, joint in enumerate(joints)]
    rows = [list(cells) for cells in zip(first, *columns, strict=True)]
    one = report.totals.spec.point[0]
    return _limited(f"By {one}", [(one, False), *_headings(metrics.values())[2:]], rows)


def has_curves(report: Report, group: str | None, definition: str = "exchangeable") -> bool:
    """Whether a report has calibration curves of a group of poses; by occlusion there are none."""
    metrics = report.metrics_in(group).values()
    return any(statistic.name == f"inside_{definition}" for metric in metrics for statistic in metric.statistics)


def path_of(x: FloatArray, y: FloatArray, size: int) -> str:
    """Give the SVG path of a curve in the unit square, drawn into a square of this size; empty where it is not known.

    Examples
    --------
    >>> path_of(np.array([0, 0.5, 1]), np.array([0, 0.75, 1]), 40)
    'M0 40L20 10L40 0'
    """
    if np.isnan(y).any():
        return ""
    points = zip(np.round(size * x, 1).tolist(), np.round(size * (1 - y), 1).tolist(), strict=True)
    return "M" + "L".join(f"{a:g} {b:g}" for a, b in points)


def _rows(
    names: Sequence[str], poses: Sequence[int], curves: Sequence[FloatArray], columns: Sequence[Sequence[Cell]]
) -> list[list[Cell]]:
    first = [Cell(name, float(row)) for row, name in enumerate(names)]
    counts = [Cell(f"{number:,}", float(number)) for number in poses]
    drawn = [Cell(curve=path_of(LEVELS, np.asarray(curve), 40)) for curve in curves]
    return [list(cells) for cells in zip(first, counts, drawn, *columns, strict=True)]


def _headings(metrics: Iterable[Metric]) -> list[tuple[str, bool]]:
    names = [(f"{metric.label} [{metric.unit}]" if metric.unit else metric.label, True) for metric in metrics]
    return [("poses", True), ("curve", False), *names]


def _limited(title: str, columns: list[tuple[str, bool]], rows: list[list[Cell]]) -> PageTable:
    """Keep the rows that are worst by their last column, where there are too many."""
    if len(rows) <= MOST_ROWS:
        return PageTable(title, columns, rows)
    worst = sorted(range(len(rows)), key=lambda row: -abs(rows[row][-1].key or 0))[:MOST_ROWS]
    note = f"The {MOST_ROWS} worst of {len(rows):,} by {columns[-1][0]}."
    return PageTable(title, columns, [rows[row] for row in sorted(worst)], note)


def _column(metric: Metric, values: Sequence[float], intervals: Sequence[tuple[float, float]]) -> list[Cell]:
    """Draw numbers of one metric on one axis."""
    axis, best, cells = _axis(metric, [*values, *(end for both in intervals for end in both)]), _best(metric), []
    for value, both in zip(values, intervals, strict=True):
        interval = span(*both, metric.unit)
        drawn = _drawn(value, both, axis, best)
        hint = f"95 % interval {interval}" if interval else ""
        cells.append(Cell(short_number(value, metric.unit), _key(value), drawn, hint=hint))
    return cells


def _axis(metric: Metric, values: Iterable[float]) -> tuple[float, float]:
    """Give the ends of an axis: the possible ones of shares, 0 and the largest of what is not bounded."""
    low, high = metric.bounds
    if metric.deviation is None and high - low <= 1:
        return low, high
    known = [value for value in values if math.isfinite(value)]
    reach = max(map(abs, known), default=0.0) or 1.0
    return (-reach if min(known, default=0.0) < 0 else 0.0), reach


def _drawn(
    value: float, ends: tuple[float, float], axis: tuple[float, float], best: float | None, *, is_null: bool = False
) -> Drawn | None:
    def place(number: float | None) -> float | None:
        if number is None or math.isnan(number):
            return None
        return round(min(100.0, max(0.0, 100 * (number - axis[0]) / (axis[1] - axis[0]))), 1)

    at, low, high = place(value), *map(place, ends)
    if at is None:
        return None
    if low is None or high is None:
        low = high = None
    return Drawn(at, place(best or 0.0) or 0.0, low, high, place(best), is_null)


def _best(metric: Metric) -> float | None:
    """Give the best value, where it lies within the axis."""
    level = metric.name.removeprefix("coverage_")
    return int(level) / 100 if level.isdecimal() else 0.0 if metric.direction == "zero" else None


def _key(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
