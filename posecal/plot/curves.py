"""Pictures of curves: reliability diagrams, errors by N, PCK and CPS, sparsification, risk–coverage.

All but the reliability of an event take several reports, by the names of their models, each in a colour of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import cycle, product
from typing import TYPE_CHECKING, Any

import numpy as np

from posecal.calibration import DEFINITIONS, LEVELS, Definition
from posecal.errors import PoseDataError, option, printable
from posecal.metrics.best_of import ROUND_SIZES
from posecal.metrics.uncertainty import DROPPED
from posecal.plot.style import FAINT, ORANGE, OVER, OVER_TEXT, UNDER, given, ink

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from posecal.report.report import Report

MOST_POINTS = 500
"""Points of a curve that has one for each pose."""

_SUMMARIES = {
    "median": "median of joints",
    "mean": "mean of joints",
    "worst": "worst joint",
    "pooled": "all joints",
}

_ORDERS = ("by_spread", "by_error")
"""By what poses are dropped or kept."""

_BY_SPREAD: dict[str, Any] = {"lw": 1.8, "label": "by predicted spread"}
_BY_ERROR: dict[str, Any] = {"color": UNDER, "lw": 1.4, "ls": (0, (5, 1.5)), "label": "by the error itself"}
_CORRECT: tuple[dict[str, Any], dict[str, Any]] = (
    {"color": UNDER, "lw": 1.8, "label": "joints (PCK)"},
    {"color": ORANGE, "lw": 1.8, "ls": (0, (5, 1.5)), "label": "whole poses, aligned (CPS)"},
)


def _models(
    report: Report | Mapping[str, Report], main: Mapping[str, Any], second: Mapping[str, Any] | None = None
) -> Iterator[tuple[Report, dict[str, Any], dict[str, Any]]]:
    """Give each report with the styles of its main and its second line: of several models in the colour of the model.

    The label of the main line is then the model's name, and the second line has none.
    """
    second = second or {}
    if not isinstance(report, Mapping):
        yield report, {"color": ink(), **main}, {**second}
        return
    import matplotlib as mpl

    colours = cycle(mpl.rcParams["axes.prop_cycle"].by_key().get("color", [ink()]))
    for (name, one), colour in zip(report.items(), colours, strict=False):
        yield one, {**main, "color": colour, "label": printable(name)}, {**second, "color": colour, "label": None}


def reliability(
    report: Report | Mapping[str, Report],
    *,
    definition: Definition | None = None,
    group: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the reliability diagram: how often the truth lies within each ball of the hypotheses.

    Parameters
    ----------
    report : Report, or mapping of Report
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
        diagonal the band in which a calibrated sampler's curve would stay, where sequences allow one. Of several
        models: the curve of each in its colour, and the widest of their bands.

    Raises
    ------
    PoseDataError
        Where the report has no such curve.
    """
    several = isinstance(report, Mapping)
    ax = given(ax)
    ax.fill_between([0, 1], [0, 1], 1, color=UNDER, alpha=0.07, lw=0, zorder=0)
    ax.fill_between([0, 1], 0, [0, 1], color=OVER, alpha=0.11, lw=0, zorder=0)
    widest = np.nan
    for one, style, _ in _models(report, {"lw": 2, "zorder": 3}):
        wanted = definition or default_definition(one)
        curve, middle = one.calibration(wanted, group), one.summary_curve(wanted, group)
        for joint, values in zip(one.totals.spec.joints, () if several else curve.joints, strict=not several):
            if not np.isnan(values).any():
                ax.plot(curve.levels, values, color=FAINT, lw=0.8, zorder=1, gid=f"joint {joint}")
        if wanted == "exchangeable" and "ece" in one.metrics:
            widest = np.fmax(widest, one.test("ece", group).band)
        label = {"label": _SUMMARIES[one.totals.protocol.summary_over_joints]} | style
        gid = f"summary {label['label']}" if several else "summary"
        ax.plot(curve.levels, middle, gid=gid, **label)
    if not np.isnan(widest):
        reach = widest * np.sqrt(LEVELS * (1 - LEVELS))
        low, high = np.clip(LEVELS - reach, 0, 1), np.clip(LEVELS + reach, 0, 1)
        ax.fill_between(LEVELS, low, high, color=ink(), alpha=0.1, lw=0, zorder=1.5, gid="band")
    ax.plot([0, 1], [0, 1], color=ink(), lw=0.8, ls=(0, (4, 3)), zorder=2, gid="diagonal")
    ax.set(xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=np.arange(0, 1.1, 0.25), yticks=np.arange(0, 1.1, 0.25))
    ax.set_xlabel("share of hypotheses within the ball, q")
    ax.set_ylabel("share of truths within it, ω(q)")
    _name_sides(ax)
    return ax


def _name_sides(ax: Axes) -> None:
    """Write what a curve above and below the diagonal is, where the fewest curves cross the words."""
    for word, colour, over in (("underconfident", UNDER, False), ("overconfident", OVER_TEXT, True)):
        text = ax.text(0.5, 0.5, word, color=colour, ha="right" if over else "left", va="bottom" if over else "top")
        box = text.get_window_extent()
        width, height = 1.1 * box.width / ax.bbox.width, 1.1 * box.height / ax.bbox.height
        crossed = {}
        for away, rise in product((0.04, 0.08, 0.13), np.arange(0.07, 0.4, 0.06)):
            across = np.linspace(away - 0.03, away + width, 20)
            crossed[away, rise] = 0.0
            for line in ax.lines:
                levels, shares = np.asarray(line.get_xydata(), dtype=np.float64).T
                values = np.interp(1 - across if over else across, levels, shares)
                values = values if over else 1 - values
                crossed[away, rise] += line.get_linewidth() * (values.max() > rise and values.min() < rise + height)
        away, rise = min(crossed, key=crossed.__getitem__)
        text.set_position((1 - away, rise) if over else (away, 1 - rise))


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


def errors_by_n(report: Report | Mapping[str, Report], *, ax: Axes | None = None) -> Axes:
    """Draw minMPJPE against the number of hypotheses.

    Parameters
    ----------
    report : Report, or mapping of Report
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
    largest = 1
    for one, style, _ in _models(report, {"lw": 1.8, "marker": "o", "ms": 2.5}):
        curve, values = one.curve("errors_by_n")
        ax.plot(curve.at, values, **style)
        ax.set(xlabel=curve.axes[0], ylabel=curve.axes[1])
        largest = max(largest, int(curve.at[-1]))
    ax.set_xscale("log")
    ticks = [n for n in ROUND_SIZES if n <= largest]
    ax.set_xticks(ticks, [str(n) for n in ticks])
    ax.minorticks_off()
    ax.set_ylim(0, None)
    ax.grid(axis="y", color="#E4E4E4", lw=0.6)
    return ax


def pck_curves(report: Report | Mapping[str, Report], *, ax: Axes | None = None) -> Axes:
    """Draw the shares of correct joints (PCK) and of correct poses (CPS) against the threshold.

    Parameters
    ----------
    report : Report, or mapping of Report
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
    joints, whole = _CORRECT
    for one, first, second in _models(report, joints, whole):
        for name, style in (("pck_curve", first), ("cps_curve", second)):
            curve, shares = one.curve(name)
            ax.plot(curve.at, shares, gid=name, **style)
        ax.axvline(one.totals.protocol.pck_threshold, color=FAINT, lw=0.8, zorder=0)
    ax.set(xlim=(0, 300), ylim=(0, 1), xlabel="threshold τ [mm]", ylabel="share within τ")
    ax.grid(axis="y", color="#E4E4E4", lw=0.6)
    if not isinstance(report, Mapping):
        ax.legend(loc="lower right")
    return ax


def sparsification(report: Report | Mapping[str, Report], *, ax: Axes | None = None) -> Axes:
    """Draw the error that is left when the most uncertain poses are dropped.

    Parameters
    ----------
    report : Report, or mapping of Report
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
    ax.axhline(1, color=FAINT, lw=1, ls=(0, (2, 2)))
    for one, *styles in _models(report, _BY_SPREAD, _BY_ERROR):
        for curve, name, style in zip(one.sparsification(), _ORDERS, styles, strict=True):
            ax.plot(DROPPED, curve, gid=name, **style)
    ax.set(xlim=(0, 1), ylim=(0, 1.15), xlabel="share of poses dropped", ylabel="mean error of the rest / of all")
    ax.text(0.02, 1.02, "at random", color="#777777", fontsize="small")
    if not isinstance(report, Mapping):
        ax.legend(loc="lower left")
    return ax


def risk_coverage(report: Report | Mapping[str, Report], *, ax: Axes | None = None) -> Axes:
    """Draw the mean error of the poses that are kept, against their share.

    Parameters
    ----------
    report : Report, or mapping of Report
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
    highest, overall, unit = 0.0, 0.0, ""
    for one, *styles in _models(report, _BY_SPREAD, _BY_ERROR):
        coverage, *curves = one.risk_coverage()
        shown = np.unique(np.linspace(0, len(coverage) - 1, MOST_POINTS).astype(int))
        for curve, name, style in zip(curves, _ORDERS, styles, strict=True):
            ax.plot(coverage[shown], curve[shown], gid=name, **style)
        overall, unit = float(curves[1][-1]), one.totals.spec.unit
        ax.axhline(overall, color=styles[1]["color"] if isinstance(report, Mapping) else FAINT, lw=1, ls=(0, (2, 2)))
        highest = max(highest, overall, float(curves[0][shown].max()))
    error = f"mean error of the poses kept [{unit}]" if unit else "mean error of the poses kept"
    ax.set(xlim=(0, 1), ylim=(0, 1.1 * highest), xlabel="coverage: share of poses kept", ylabel=error)
    ax.text(0.02, overall, "at random", color="#777777", fontsize="small", va="bottom")
    if not isinstance(report, Mapping):
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
    ax.plot([0, 1], [0, 1], color=ink(), lw=0.8, ls=(0, (4, 3)))
    ax.step(isotonic.predicted, isotonic.observed, where="mid", color=ink(), lw=1.8, gid="isotonic")
    share = 0.15 * isotonic.weight / isotonic.weight.max(initial=1e-9)
    ax.vlines(isotonic.predicted, 0, share, color=UNDER, lw=1.2, alpha=0.6, gid="weights")
    ax.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
    ax.set_xlabel("predicted share of hypotheses near it, p")
    ax.set_ylabel("observed share of truths near the median")
    return ax
