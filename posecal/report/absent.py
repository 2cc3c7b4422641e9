"""Why a number of a report is NaN: the reason that stands in its row, and in a remark of what is shown."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from posecal.calibration.error import FEW_HYPOTHESES, SINCE
from posecal.calibration.ranks import DEFINITIONS
from posecal.calibration.standardized import NAME
from posecal.engine.measure import HAS_SPREAD
from posecal.engine.metric import Metric
from posecal.engine.sums import Cells
from posecal.engine.totals import Totals
from posecal.errors import first_few
from posecal.stats.resampling import MIN_SEQUENCES
from posecal.stats.uncertainty import are_points, weights_allow_no_test

if TYPE_CHECKING:
    from posecal.report.report import Report

NO_RANK = "all hypotheses equal the truth at every joint that counts"
NO_RANGE = "the true poses of the other sequences have no range; expected several"

_OF_HYPOTHESES = frozenset({"calibration", "rank_tests", "scores", "sharpness"})
"""Families that need several hypotheses of a pose."""

_SHOWN = 6
"""How many numbers a remark names."""

_UNDEFINED = {
    "failure_auroc": "no pose fails, or every pose does",
    "spread_error_correlation": "all poses that count have one spread, or one error",
    "ause": "the errors are all 0",
    "log_likelihood_skill": "climatology gives the true poses no density (a remark says why)",
}
"""Numbers that some poses leave undefined."""

_UNCOUNTED = {
    "tarp_box": NO_RANGE,
    "apde": "every clip is alone in its set of truths, or lacks frames or joints",
    "mmade": "every clip is alone in its set of truths, or lacks frames or joints",
    "mmfde": "every clip is alone in its set of truths, or lacks frames or joints",
}
"""Numbers that leave out poses for reasons of their own."""


def why_absent(report: Report, name: str, group: str | None = None) -> str:
    """Say why a number is NaN.

    Parameters
    ----------
    report : Report
        The numbers.
    name : str
        Of a metric or of a number beside one.
    group : str, optional
        ``label=value``; all poses by default.

    Returns
    -------
    str
        Without a full stop; empty where the number is known. Few numbers are computed to know it.
    """
    row = report.auxiliary.get(name)
    metric = report.metrics_in(group)[name if row is None else row.metric]
    counts = report.count(metric.name, group) > 0
    may_lack = row is not None or not counts or name in _UNDEFINED or SINCE in metric.definition
    if not may_lack or not math.isnan(report.value(name, group)):
        return ""
    if SINCE in metric.definition:
        return metric.definition.partition(SINCE)[2]
    if not counts:
        return _why_nothing_counts(report, metric, group)
    if row is None:
        return _UNDEFINED[name]
    if row.key in {"effective_poses", "squared_error"}:
        return "fewer than two sequences have poses that count"
    return _why_untested(report, metric, group)


def with_reason(definition: str, reason: str) -> str:
    """End the definition of a number with the reason that it is NaN, where there is one that it does not say."""
    return definition if not reason or SINCE in definition else f"{definition}{SINCE}{reason}"


def _why_nothing_counts(report: Report, metric: Metric, group: str | None) -> str:
    totals, cells = report.totals, report.groups[group]
    of_group = "" if group is None else " of the group"
    if group is not None and group.startswith("occlusion="):
        return f"no joint that counts is {group.partition('=')[2]}"
    if not (totals.poses if cells is None else totals.poses[cells]).any():
        return f"no pose{of_group} counts"
    if earlier := metric.statistic.earlier:
        return f"no {earlier + 1} frames{of_group} follow one another in a sequence"
    if metric.name in _UNCOUNTED:
        return _UNCOUNTED[metric.name]
    if metric.family in _OF_HYPOTHESES and not _have_spread(totals, cells):
        return f"no pose{of_group} has several hypotheses"
    if metric.family in {"calibration", "rank_tests"} and group is None and joints_without_a_rank(totals)[1]:
        return NO_RANK
    if len(totals.spec.joints) == 1:
        return "it needs several joints; there is one"
    return f"no pose{of_group} has the joints or frames that it needs"


def _why_untested(report: Report, metric: Metric, group: str | None) -> str:
    totals, cells = report.totals, report.groups[group]
    test = report.test(metric.name, group)
    if test.sequences < MIN_SEQUENCES:
        return f"a test needs {MIN_SEQUENCES} sequences that count"
    if are_points(totals, metric, cells):
        return "the hypotheses of each pose are all the same"
    if weights_allow_no_test(totals):
        return f"weights leave an effective N below {FEW_HYPOTHESES}"
    return "nothing tells how much frames resemble each other"


def _have_spread(totals: Totals, cells: Cells) -> bool:
    """Whether some pose has several hypotheses that count."""
    spread = totals.sums.get(HAS_SPREAD.name)
    return spread is None or bool((spread if cells is None else spread[cells]).any())


def joints_without_a_rank(totals: Totals) -> tuple[list[str], bool]:
    """Name the joints at which all hypotheses equal the truth in every pose, and say whether all that count do."""
    counts, ranks = totals.counts, f"inside_{DEFINITIONS[0]}"
    if not {NAME, ranks} <= counts.keys() or not _have_spread(totals, None):
        return [], False
    counted = counts[NAME].any(axis=0)
    empty = np.asarray(counted & ~counts[ranks][:, :-1].any(axis=0))
    return [totals.spec.joints[k] for k in np.flatnonzero(empty)], bool(empty.any() and (empty == counted).all())


def remarks_on_absence(report: Report) -> Iterator[str]:
    """Name the main numbers that are NaN over all poses, and say why, where no other remark does."""
    totals = report.totals
    asks = totals.protocol.asks_for
    has_steps = totals.has_sequences and totals.poses.sum() > totals.n_sequences
    absent: dict[str, list[str]] = {}
    for name, metric in report.headline_metrics.items():
        known = SINCE in metric.definition or name == "log_likelihood_skill"
        known |= (has_steps and metric.statistic.earlier == 1) or (name in _UNDEFINED and not asks(name, metric.family))
        reason = "" if known else why_absent(report, name)
        if reason not in {"", NO_RANK}:
            absent.setdefault(reason, []).append(name)
    yield from (f"{first_few(names, _SHOWN)}: no value, because {reason}." for reason, names in absent.items())
