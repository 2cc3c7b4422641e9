"""Pictures of curves: reliability diagrams, errors by N, PCK and CPS, sparsification, risk–coverage."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from posecal.calibration import DEFINITIONS, Definition
from posecal.errors import PoseDataError, option
from posecal.metrics.best_of import ROUND_SIZES
from posecal.metrics.uncertainty import DROPPED
from posecal.plot.style import FAINT, INK, ORANGE, OVER, OVER_TEXT, UNDER, given

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from posecal.report.report import Report

MOST_POINTS = 500
"""Points of a curve that has one for each pose."""

_BY_SPREAD: dict[str, Any] = {"color": INK, "lw": 1.8, "label": "by predicted spread"}
_BY_ERROR: dict[str, Any] = {"color": UNDER, "lw": 1.4, "ls": (0, (5, 1.5)), "label": "by the error itself"}


def reliability(
    report: Report,
    *,
    definition: Definition | None = None,
    group: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the reliability diagram: how often the truth lies within each ball of the hypotheses.

    Parameters
    ----------
    report : Report
        Holds the curves.
    definition : str, optional
        One of :data:`posecal.calibration.ranks.DEFINITIONS`; by default the first of them that the report holds.
    group : str, optional
        ``label=value``; all poses by default.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: faint lines for the joints, a dark one for the curve that the ECE is made from, and about the
        diagonal the band in which a calibrated sampler's curve would stay, where sequences allow one.

    Raises
    ------
    PoseDataError
        Where the report has no such curve.
    """
    definition = definition or default_definition(report)
    curve, middle = report.calibration(definition, group), report.summary_curve(definition, group)
    ax = given(ax)
    ax.fill_between([0, 1], [0, 1], 1, color=UNDER, alpha=0.07, lw=0, zorder=0)
    ax.fill_between([0, 1], 0, [0, 1], color=OVER, alpha=0.11, lw=0, zorder=0)
    ax.text(0.04, 0.93, "underconfident", color=UNDER, va="top")
    ax.text(0.96, 0.07, "overconfident", color=OVER_TEXT, ha="right")
    for joint, values in zip(report.totals.spec.joints, curve.joints, strict=True):
        if not np.isnan(values).any():
            ax.plot(curve.levels, values, color=FAINT, lw=0.8, zorder=1, gid=f"joint {joint}")
    band = report.test("ece", group).band if definition == "exchangeable" and "ece" in report.metrics else np.nan
    if not np.isnan(band):
        reach = band * np.sqrt(curve.levels * (1 - curve.levels))
        low, high = np.clip(curve.levels - reach, 0, 1), np.clip(curve.levels + reach, 0, 1)
        ax.fill_between(curve.levels, low, high, color=INK, alpha=0.1, lw=0, zorder=1.5, gid="band")
    ax.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=(0, (4, 3)), zorder=2, gid="diagonal")
    over = report.totals.protocol.summary_over_joints
    words = {
        "median": "median of joints",
        "mean": "mean of joints",
        "worst": "worst joint",
        "pooled": "all joints",
    }
    ax.plot(curve.levels, middle, color=INK, lw=2, zorder=3, gid="summary", label=words[over])
    ax.set(xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=np.arange(0, 1.1, 0.25), yticks=np.arange(0, 1.1, 0.25))
    ax.set_xlabel("share of hypotheses within the ball, q")
    ax.set_ylabel("share of truths within it, ω(q)")
    return ax


def default_definition(report: Report) -> Definition:
    """Choose the definition of a reliability diagram: exchangeable, or another that the report holds curves of.

    Raises
    ------
    PoseDataError
        Where it holds none.
    """
    if report.totals.spec.n_hypotheses < 2:
        raise PoseDataError("reliability: calibration needs at least 2 hypotheses; there is 1.")
    known = [definition for definition in DEFINITIONS if f"inside_{definition}" in report.totals.sums]
    if not known:
        wanted = option("metrics", "ece")
        raise PoseDataError(f"reliability: the report has no calibration curves. Evaluate with {wanted}.")
    return known[0]


def errors_by_n(report: Report, *, ax: Axes | None = None) -> Axes:
    """Draw minMPJPE against the number of hypotheses.

    Parameters
    ----------
    report : Report
        Holds the curve.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes.

    Raises
    ------
    PoseDataError
        Where the report has no such curve.
    """
    ax = given(ax)
    curve, values = report.curve("errors_by_n")
    ax.plot(curve.at, values, color=INK, lw=1.8, marker="o", ms=2.5)
    ax.set_xscale("log")
    ticks = [n for n in ROUND_SIZES if n <= curve.at[-1]]
    ax.set_xticks(ticks, [str(n) for n in ticks])
    ax.minorticks_off()
    ax.set(xlabel=curve.axes[0], ylabel=curve.axes[1], ylim=(0, None))
    ax.grid(axis="y", color="#E4E4E4", lw=0.6)
    return ax


def pck_curves(report: Report, *, ax: Axes | None = None) -> Axes:
    """Draw the shares of correct joints (PCK) and of correct poses (CPS) against the threshold.

    Parameters
    ----------
    report : Report
        Holds the curves.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes.

    Raises
    ------
    PoseDataError
        Where the report has no such curves.
    """
    ax = given(ax)
    pck, shares = report.curve("pck_curve")
    cps, poses_right = report.curve("cps_curve")
    ax.plot(pck.at, shares, color=UNDER, lw=1.8, label="joints (PCK)", gid="pck_curve")
    ax.plot(
        cps.at,
        poses_right,
        color=ORANGE,
        lw=1.8,
        ls=(0, (5, 1.5)),
        label="whole poses, aligned (CPS)",
        gid="cps_curve",
    )
    ax.axvline(report.totals.protocol.pck_threshold, color=FAINT, lw=0.8, zorder=0)
    ax.set(xlim=(0, 300), ylim=(0, 1), xlabel="threshold τ [mm]", ylabel="share within τ")
    ax.grid(axis="y", color="#E4E4E4", lw=0.6)
    ax.legend(loc="lower right")
    return ax


def sparsification(report: Report, *, ax: Axes | None = None) -> Axes:
    """Draw the error that is left when the most uncertain poses are dropped.

    Parameters
    ----------
    report : Report
        Holds the curves.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: dropping by the predicted spread, by the error itself, and at random.

    Raises
    ------
    PoseDataError
        Where the report has no spreads and errors.
    """
    ax = given(ax)
    by_spread, by_error = report.sparsification()
    ax.axhline(1, color=FAINT, lw=1, ls=(0, (2, 2)))
    ax.plot(DROPPED, by_spread, gid="by_spread", **_BY_SPREAD)
    ax.plot(DROPPED, by_error, gid="by_error", **_BY_ERROR)
    ax.set(xlim=(0, 1), ylim=(0, 1.15), xlabel="share of poses dropped", ylabel="mean error of the rest / of all")
    ax.text(0.02, 1.02, "at random", color="#777777", fontsize=7.5)
    ax.legend(loc="lower left")
    return ax


def risk_coverage(report: Report, *, ax: Axes | None = None) -> Axes:
    """Draw the mean error of the poses that are kept, against their share.

    Parameters
    ----------
    report : Report
        Holds the curves.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: keeping poses by the predicted spread, by the error itself, and at random.

    Raises
    ------
    PoseDataError
        Where the report has no spreads and errors.
    """
    ax = given(ax)
    coverage, by_spread, by_error = report.risk_coverage()
    ax.axhline(by_error[-1], color=FAINT, lw=1, ls=(0, (2, 2)))
    shown = np.unique(np.linspace(0, len(coverage) - 1, MOST_POINTS).astype(int))
    for curve, name, style in ((by_spread, "by_spread", _BY_SPREAD), (by_error, "by_error", _BY_ERROR)):
        ax.plot(coverage[shown], curve[shown], gid=name, **style)
    unit = report.totals.spec.unit
    error = f"mean error of the poses kept [{unit}]" if unit else "mean error of the poses kept"
    ax.set(xlim=(0, 1), xlabel="coverage: share of poses kept", ylabel=error)
    ax.set_ylim(0, 1.1 * max(by_spread[shown].max(), by_error[-1]))
    ax.text(0.02, by_error[-1], "at random", color="#777777", fontsize=7.5, va="bottom")
    ax.legend(loc="lower right")
    return ax


def event_reliability(report: Report, *, ax: Axes | None = None) -> Axes:
    """Draw how often the median pose is right at every joint, against the probability that the hypotheses give it.

    Parameters
    ----------
    report : Report
        Holds the counts: the proper scores must be among its metrics.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: the isotonic frequency, and below it bars for the shares of poses.

    Raises
    ------
    PoseDataError
        Where the report has no Brier score.
    """
    ax = given(ax)
    isotonic = report.event_reliability()
    ax.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=(0, (4, 3)))
    ax.step(isotonic.predicted, isotonic.observed, where="mid", color=INK, lw=1.8, gid="isotonic")
    share = 0.15 * isotonic.weight / isotonic.weight.max(initial=1e-9)
    ax.vlines(isotonic.predicted, 0, share, color=UNDER, lw=1.2, alpha=0.6, gid="weights")
    ax.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
    ax.set_xlabel("predicted: share of hypotheses near their median")
    ax.set_ylabel("observed: share of truths near it")
    return ax
