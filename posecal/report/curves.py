"""Curves of an evaluation: the methods of :class:`posecal.Report` that give what pictures are drawn from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posecal.calibration import LEVELS, CalibrationCurve, Definition
from posecal.calibration.curve import curve_of
from posecal.calibration.ranks import known_definition
from posecal.data.arrays import FloatArray
from posecal.engine.metric import Curve
from posecal.errors import PoseDataError, did_you_mean, is_among, option
from posecal.metrics.brier import Reliability, reliability
from posecal.metrics.risk_coverage import risk_coverage as risk_coverage_curves
from posecal.metrics.uncertainty import sparsification as sparsification_curves
from posecal.registry import curves_of, lacks
from posecal.stats.uncertainty import measured_spec

if TYPE_CHECKING:
    from posecal.report.report import Report


def calibration(report: Report, definition: Definition = "exchangeable", group: str | None = None) -> CalibrationCurve:
    """Give the calibration curves of a group of poses.

    Parameters
    ----------
    definition : str
        One of :data:`posecal.calibration.ranks.DEFINITIONS`.
    group : str, optional
        ``label=value``; all poses by default.

    Returns
    -------
    CalibrationCurve
        A curve per joint; NaN for joints that don't count.

    Raises
    ------
    PoseDataError
        Where the report has no such curves.
    """
    name = f"inside_{known_definition(definition)}"
    statistics = {s.name: s for metric in report.metrics_in(group).values() for s in metric.statistics}
    if name not in statistics:
        raise PoseDataError(f"calibration: the report has no {definition} curves of {group or 'its poses'}.")
    mean = report.once((name, group), lambda: report.totals.averaged(statistics[name], report.groups[group]))
    return curve_of(mean, definition, measured_spec(report.totals).n_in_balls)


def summary_curve(report: Report, definition: Definition = "exchangeable", group: str | None = None) -> FloatArray:
    """Give the curve (Q,) that stands for all joints, of which the ECE is made; see :meth:`calibration`."""
    return report.calibration(definition, group).summary(report.totals.protocol.summary_over_joints)


def curve(report: Report, name: str) -> tuple[Curve, FloatArray]:
    """Give a curve and its values, (T,).

    Parameters
    ----------
    name : str
        ``errors_by_n``, ``pck_curve`` or ``cps_curve``.

    Raises
    ------
    PoseDataError
        Where the report has no such curve.
    """
    curves = curves_of(report.totals.protocol, report.totals.spec)
    if not is_among(name, curves):
        lacking = lacks(name, report.totals.protocol, report.totals.spec)
        unknown = f"{name!r} is not known. {did_you_mean(name, curves)}"
        raise PoseDataError(f"curve: {f'{name} {lacking}' if lacking else unknown}")
    if name not in report.totals.sums:
        raise PoseDataError(f"curve: the report has no {name}; it is among the default metrics.")
    return curves[name], report.totals.averaged(curves[name].statistic)


def rank_curves(report: Report, test: str) -> FloatArray:
    """Give the curves of a rank test, (R, Q): one, or one per coordinate.

    Raises
    ------
    PoseDataError
        Where the report has no such test.
    """
    if not is_among(test, report.rank_tests()):
        raise PoseDataError(f"test: {test} is no rank test of the report. {did_you_mean(test, report.rank_tests())}")
    curves = report.totals.averaged(report.metrics[test].statistic).reshape(-1, LEVELS.size)
    return curves[~np.isnan(curves).any(axis=1)]


def sparsification(report: Report) -> tuple[FloatArray, FloatArray]:
    """Give the mean error left when poses are dropped, by spread and by error.

    Raises
    ------
    PoseDataError
        Where the report has no spreads and errors.
    """
    return sparsification_curves(*_spreads_and_errors(report, "sparsification"))


def risk_coverage(report: Report) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give the share of poses that is kept, and the mean error of those, by spread and by error.

    Raises
    ------
    PoseDataError
        Where the report has no spreads and errors.
    """
    return risk_coverage_curves(*_spreads_and_errors(report, "risk_coverage"))


def _spreads_and_errors(report: Report, what: str) -> FloatArray:
    """Give the predicted spread and the error of every pose, (2, M)."""
    values = report.totals.per_pose.get("predicted_spread_and_error")
    if values is None:
        raise PoseDataError(f"{what}: the report has no spreads and errors; they are among the default metrics.")
    return values.T


def event_reliability(report: Report) -> Reliability:
    """Give the isotonic reliability of the event that the median pose is right at every joint.

    Raises
    ------
    PoseDataError
        Where the report has no Brier score.
    """
    if "brier_miscalibration" not in report.metrics:
        raise PoseDataError(f"event: the report has no Brier score. Evaluate with {option('metrics', 'scores')}.")
    return reliability(report.totals.mean(report.metrics["brier_miscalibration"].statistic))
