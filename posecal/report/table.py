"""Tidy rows: each number of a report with its label, definition and interval, the one source of CSV and JSON.

A row is a metric over all poses, over a group of them, or at one joint; or an auxiliary number beside a metric, such as
the mean error of a calibrated sampler and the p-value of a calibration error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from posecal.calibration import DEFINITIONS, Definition, perfect_sampler
from posecal.data.arrays import FloatArray
from posecal.data.texts import frame_of, json_lines, printable_table
from posecal.engine.metric import Direction, Metric
from posecal.errors import PoseDataError, for_python
from posecal.report.absent import why_absent, with_reason
from posecal.report.format import counted
from posecal.report.summary import remarks
from posecal.stats.uncertainty import effective_hypotheses, effective_sample_size, unbiased_squared_error

if TYPE_CHECKING:
    import pandas as pd

    from posecal.report.report import Report

SCHEMA = 1
"""Version of the JSON schema, ``posecal/report/schema.json``."""


@dataclass(frozen=True)
class Row:
    """One reported number.

    Attributes
    ----------
    metric : str
        Name in snake case.
    label : str
        Name for people.
    group : str or None
        The poses it is over, as ``label=value``; None for all.
    joint : str or None
        The joint it is about; None for the summary over joints.
    value : float
        The number; NaN where nothing counts.
    unit : str
        ``mm``, ``mm/frame``, ``mm/s``, … or empty.
    direction : str
        ``lower`` or ``higher`` is better, ``zero`` is best, or ``none``.
    definition : str
        What it is, in one line.
    poses : int
        Number of poses that count in it.
    low, high : float
        A 95 % interval over repetitions of the sequences; NaN where there is none. Calibration errors have none: for
        them the rows ``…_null``, ``…_null_95`` and ``…_p`` say what a calibrated sampler would show.
    """

    metric: str
    label: str
    group: str | None
    joint: str | None
    value: float
    unit: str
    direction: Direction
    definition: str
    poses: int
    low: float = math.nan
    high: float = math.nan


_COLUMNS = [field.name for field in fields(Row)]


@dataclass(frozen=True)
class AuxiliaryRow:
    """Description of a number that is reported beside a metric.

    Attributes
    ----------
    label, definition, direction, range, reading, source, unit : str
        As of a :class:`posecal.engine.metric.Metric`; in :data:`AUXILIARY`, ``{}`` stands for the metric's label.
    name : str
        Of the row: the metric's name and the key in :data:`AUXILIARY`, or the key alone.
    metric, key : str
        The metric that it stands beside, and its key in :data:`AUXILIARY`.
    """

    label: str
    definition: str
    range: str
    reading: str
    source: str = "posecal"
    direction: Direction = "none"
    unit: str = ""
    name: str = ""
    metric: str = ""
    key: str = ""


_NULL_READING = (
    "Compare the error with it. The model is made calibrated by a map of its ranks, and what its sequences deviate by "
    "then is given random signs, so that models on the same test set have nearly the same number. An error below the "
    "95 % quantile (…_null_95) may be chance."
)
_P_READING = (
    "Small: a calibrated sampler would hardly ever show such an error on this data. Large: no miscalibration is shown, "
    "which with few sequences is all that can be. None with fewer than six sequences. Over several tests read the "
    "adjusted one, which holds the chance of any false rejection among them at its level."
)
_FLOOR_READING = (
    "What N and M alone cost: the definitions of the paper and of its script are biased at finite N, and every curve "
    "scatters at finite M. Frames and joints are taken as independent; where they are not, as in video, a perfect "
    "sampler shows more, and …_null is the number to compare an error with."
)
_FLIPS = "posecal; Canay, Romano and Shaikh, doi:10.3982/ECTA13081"
_HOLM = f"{_FLIPS}; Holm, Scand. J. Stat. 6, 65 (1979)"
_ERRORS = "0 to about 0.5"
_PROBABILITY = "1 over the number of sign patterns (at most 2000, fewer of a mesh or of fewer than 12 sequences) to 1"
_SIGNS = "random signs of entire sequences"

AUXILIARY = {
    "null": AuxiliaryRow(
        "{} of a calibrated sampler",
        f"mean of {{}} over {_SIGNS}, of a model made calibrated",
        _ERRORS,
        _NULL_READING,
        _FLIPS,
    ),
    "null_95": AuxiliaryRow(
        "{} of a calibrated sampler (95 % quantile)",
        f"95 % quantile of {{}} over {_SIGNS}, of a model made calibrated",
        _ERRORS,
        _NULL_READING,
        _FLIPS,
    ),
    "p": AuxiliaryRow("p-value of {}", f"share of {_SIGNS} that make {{}} as large", _PROBABILITY, _P_READING, _HOLM),
    "p_adjusted": AuxiliaryRow(
        "adjusted p-value of {}",
        f"share of {_SIGNS} that make {{}} as large, adjusted for all tests (Holm)",
        _PROBABILITY,
        _P_READING,
        _HOLM,
    ),
    "floor": AuxiliaryRow("{} of a perfect sampler", "expected {} of a perfect sampler", _ERRORS, _FLOOR_READING),
    "floor_95": AuxiliaryRow(
        "{} of a perfect sampler (95 % quantile)",
        "95 % quantile of the {} of a perfect sampler",
        _ERRORS,
        _FLOOR_READING,
    ),
    "effective_poses": AuxiliaryRow(
        "effective number of poses",
        "independent poses whose calibration curves would vary as much as those of the sequences do",
        "about 1 to the number of poses",
        "Frames of a video resemble their neighbours: as many independent poses would say as much about calibration. "
        "It is estimated from how the sequences differ, so of few sequences it is rough.",
    ),
    "squared_error": AuxiliaryRow(
        "unbiased squared error of the curves",
        "mean over joints and q of (ω_k(q) − q)² − its variance over sequences; exchangeable definition",
        "about 0 (calibrated; by chance a little below) to about 0.3",
        "Unlike an ECE it does not grow as data shrink: what chance adds to the squared distance from the diagonal is "
        "subtracted.",
        direction="lower",
    ),
}
"""The numbers beside metrics: by the ending of their names, or by their names."""

ECE_OF: dict[Definition, str] = {d: "ece" if d == "exchangeable" else f"ece_{d}" for d in DEFINITIONS}
"""The name of the ECE of each definition."""


def auxiliary_rows(metrics: Mapping[str, Metric]) -> dict[str, AuxiliaryRow]:
    """Describe the numbers that are reported beside some metrics.

    Parameters
    ----------
    metrics : mapping of Metric
        Metrics by name.

    Returns
    -------
    dict of AuxiliaryRow
        By name, with the labels of the metrics filled in.
    """
    rows = {}
    for metric in metrics.values():
        keys: tuple[str, ...] = ()
        if metric.deviation is not None:
            keys = ("null", "null_95", "p")
            keys += ("p_adjusted",) if metric.family == "rank_tests" else ()
            keys += ("floor", "floor_95") if metric.name in ECE_OF.values() else ()
            keys += ("effective_poses", "squared_error") if metric.name == "ece" else ()
        for key in keys:
            row = AUXILIARY[key]
            name = f"{metric.name}_{key}" if "{}" in row.definition else key
            label, definition = row.label.format(metric.label), row.definition.format(metric.label)
            rows[name] = replace(row, name=name, metric=metric.name, key=key, label=label, definition=definition)
    return rows


def auxiliary_number(report: Report, row: AuxiliaryRow, group: str | None) -> tuple[float, str]:
    """Compute an auxiliary number, and say what its definition depends on.

    Raises
    ------
    PoseDataError
        For a group of poses, where it is known over all poses only.
    """
    totals, metric = report.totals, report.metrics[row.metric]
    if row.key in {"null", "null_95", "p"}:
        test = report.test(row.metric, group)
        value = {"null": test.mean, "null_95": test.high, "p": test.p}[row.key]
        return value, f"; {totals.units(test.sequences)}" if row.key == "p" else ""
    if group is not None:
        raise PoseDataError(f"group: {row.name} is known over all poses only; expected no group.")
    if row.key == "p_adjusted":
        tests = report.rank_tests()
        return tests[row.metric][1], f"; {len(tests)} tests"
    if row.key == "effective_poses":
        return effective_sample_size(totals, metric.statistic), ""
    if row.key == "squared_error":
        return unbiased_squared_error(totals, metric.statistic), ""
    definition = next(definition for definition, ece in ECE_OF.items() if ece == row.metric)
    counts, n = totals.effective_sample_size(metric.statistic)[:-1], max(2, round(effective_hypotheses(totals)))
    poses, joints = round(counts.max(initial=0)), int((counts > 0).sum())
    detail = (
        f": N={n}, {counted(poses, 'independent pose')} and {counted(joints, 'independent joint')} "
        f"(more where they are correlated); {definition} definition"
    )
    if not poses:
        return math.nan, detail
    floor = perfect_sampler(n, poses, joints, definition, totals.protocol.summary_over_joints)
    return floor.mean if row.key == "floor" else floor.high, detail


def definition_of(report: Report, metric: Metric, name: str, group: str | None) -> str:
    """Define a number of a metric or beside it, and say why it is NaN where it is."""
    definition = metric.definition
    if name in report.auxiliary:
        row = report.auxiliary[name]
        detail = report.once(("value", name, group), lambda: auxiliary_number(report, row, group))[1]
        definition = row.definition + detail
    return with_reason(definition, why_absent(report, name, group))


def tidy_rows(report: Report) -> Iterator[Row]:
    """Give every number of a report: by group, each metric with the numbers beside it; then each metric at each joint.

    Parameters
    ----------
    report : Report
        The numbers, which are computed here where they are not yet.

    Yields
    ------
    Row
        In groups, of the auxiliary numbers only the test of the ECE, where there are enough sequences for one.
    """
    beside = {name: [row for row in report.auxiliary.values() if row.metric == name] for name in report.metrics}
    for group in report.groups:
        for metric in report.metrics_in(group).values():
            yield _row(report, metric, group)
            for row in beside.get(metric.name, []):
                if group is None or _is_test_of_ece(report, row, group):
                    yield _row(report, row, group)
    for metric in report.metrics.values():
        for joint in report.totals.spec.joints if metric.by_joint is not None else ():
            if not math.isnan(report.value(metric.name, joint=joint)):
                yield _row(report, metric, joint=joint)


def _is_test_of_ece(report: Report, row: AuxiliaryRow, group: str) -> bool:
    wanted = row.metric == "ece" and row.key in {"null", "null_95", "p"}
    return wanted and not math.isnan(report.test("ece", group).p)


def _row(report: Report, entry: Metric | AuxiliaryRow, group: str | None = None, joint: str | None = None) -> Row:
    name, value = entry.name, report.value(entry.name, group, joint)
    definition = with_reason(report.definition(name, group), "it is not defined for these poses" * math.isnan(value))
    about = entry.unit, entry.direction, definition, report.count(name, group, joint)
    return Row(name, entry.label, group, joint, value, *about, *report.interval(name, group, joint))


def as_dict(report: Report, *, joints: bool = False) -> dict[str, object]:
    """Give a report as plain data, by the JSON schema ``posecal/report/schema.json``."""
    parts = _parts(report, for_python, joints=joints)
    return {key: list(part) if isinstance(part, Iterator) else part for key, part in parts.items()}


def as_json(report: Report, words: Callable[[str], str] = for_python, *, joints: bool = False) -> str:
    """Write :func:`as_dict` as JSON, with a line for each row and each curve."""
    return json_lines(_parts(report, words, joints=joints))


def _parts(report: Report, words: Callable[[str], str], *, joints: bool) -> dict[str, object]:
    """Give the parts of the JSON; rows and curves one by one, since there may be hundreds of thousands."""
    return {
        "schema": SCHEMA,
        "posecal": report.totals.version,
        "signature": report.signature,
        "hypotheses": report.totals.spec.n_hypotheses,
        "poses": int(report.totals.poses.sum()),
        "joints": list(report.totals.spec.joints),
        "remarks": list(remarks(report, words)),
        "summary": list(report.summary),
        "rows": ({name: _or_none(getattr(row, name)) for name in _COLUMNS} for row in report.rows),
        "curves": _curves(report, joints=joints),
    }


def _curves(report: Report, *, joints: bool) -> Iterator[dict[str, object]]:
    """Give the summary curves of all poses and of the groups, the joints' of all poses, and where asked of groups."""
    for definition, group in product(DEFINITIONS, report.groups):
        statistics = {s.name for metric in report.metrics_in(group).values() for s in metric.statistics}
        if f"inside_{definition}" in statistics:
            curves = report.calibration(definition, group)
            about = {"definition": definition, "group": group, "levels": curves.levels.tolist()}
            values_of: dict[str | None, FloatArray] = {None: report.summary_curve(definition, group)}
            if joints or group is None:
                values_of |= dict(zip(report.totals.spec.joints, curves.joints, strict=True))
            for joint, values in values_of.items():
                if not np.isnan(values).any():
                    yield {**about, "joint": joint, "coverage": values.tolist()}


def as_frame(rows: Iterable[Row]) -> pd.DataFrame:
    """Give rows as a pandas data frame."""
    return frame_of([[getattr(row, name) for name in _COLUMNS] for row in rows], _COLUMNS)


def as_csv(report: Report, words: Callable[[str], str] = for_python) -> str:
    """Write the rows of a report as CSV, and a row for each remark; what can't be shown of names is escaped."""
    notes = [Row("remark", "remark", None, None, math.nan, "", "none", text, 0) for text in remarks(report, words)]
    return str(printable_table(as_frame((*report.rows, *notes))).to_csv(index=False, lineterminator="\n")).rstrip("\n")


def _or_none(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value
