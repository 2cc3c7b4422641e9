"""Pictures of numbers against the horizon of a prediction: coverage, errors and spread at each frame of clips."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from posecal.errors import PoseDataError, option
from posecal.plot.captions import caption
from posecal.plot.style import FAINT, INK, ORANGE, OVER, UNDER, given, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from posecal.report.report import Report

COLOURS = (INK, UNDER, ORANGE, OVER, FAINT)
"""Of the lines, in their order."""

SHARES = ("coverage_50", "coverage_90")
"""The first panel."""

LENGTHS = ("min_mpjpe", "mean_pose_mpjpe", "radius_90", "joint_energy_score")
"""The second panel, as far as they are there."""


def horizon(
    report: Report,
    names: str | Sequence[str] = SHARES,
    *,
    colour: str | None = None,
    label: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw numbers against the horizon, with their 95 % intervals.

    Parameters
    ----------
    report : Report
        Of a result by horizon.
    names : str or sequence of str
        Names of metrics of one unit; those of coverage have their level as a dashed line.
    colour, label : str, optional
        Of a single line, such as that of one of several models; by default by the metric.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes.

    Raises
    ------
    PoseDataError
        Where the report is of poses without horizons, or lacks a number.
    """
    report, ax = by_horizon(report), given(ax)
    names = (names,) if isinstance(names, str) else names
    groups = [group for group in report.groups if group is not None and group.startswith("horizon=")]
    texts = [group.partition("=")[2] for group in groups]
    numbers = [text.removesuffix(" ms") for text in texts]
    try:
        at = [float(number) for number in numbers]
    except ValueError:
        at = [*map(float, range(1, len(texts) + 1))]  # the user's own names, in their order
    is_time = all(text.endswith(" ms") for text in texts)
    for name, own in zip(names, COLOURS, strict=False):
        values = [report.value(name, group) for group in groups]
        low, high = np.array([report.interval(name, group) for group in groups]).T
        line = colour or own
        ax.fill_between(at, low, high, color=line, alpha=0.15, lw=0, zorder=1)
        style: dict[str, Any] = {
            "color": line,
            "lw": 1.6,
            "marker": "o" if len(at) < 3 else "",
            "gid": name,
            "zorder": 2,
        }
        ax.plot(at, values, label=label or report.metrics[name].label, **style)
        if name.startswith("coverage_"):
            ax.axhline(int(name.partition("_")[2]) / 100, color=line, lw=0.8, ls=(0, (4, 3)), zorder=0)
    ax.set_xlabel("horizon [ms]" if is_time else "frame of the clip")
    ax.grid(axis="y", color="#E4E4E4", lw=0.6)
    ax.legend(loc="best", fontsize=7)
    return ax


def by_horizon(report: Report) -> Report:
    """Give a report by horizon, among others.

    Raises
    ------
    PoseDataError
        Where its poses have no label ``horizon``, or were not kept apart by it.
    """
    if "horizon" in report.by:
        return report
    if "horizon" not in report.totals.labels:
        raise PoseDataError(
            f"horizon: the result has no groups by horizon; expected clips, such as {option('axes', 'NMTKD')}, and "
            f"{option('by', 'horizon')}. Evaluate with these."
        )
    return type(report)(report.totals, (*report.by, "horizon"))


def draw_horizon(
    report: Report,
    *,
    title: str | None = None,
    size: tuple[float, float] | None = None,
    style: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw coverage, and beside it errors and spread, against the horizon, without a display.

    Parameters
    ----------
    report : Report
        Of a result by horizon.
    title, size, style
        As for :func:`posecal.plot.draw`.

    Returns
    -------
    matplotlib Figure
        Ready to be saved.

    Raises
    ------
    PoseDataError
        As :func:`horizon`, and where it holds none of these numbers.
    """
    report = by_horizon(report)
    panels = [[name for name in names if name in report.metrics] for names in (SHARES, LENGTHS)]
    panels = [names for names in panels if names]
    if not panels:
        wanted = option("metrics", "default")
        raise PoseDataError(f"horizon: the result has neither coverage nor errors. Evaluate with {wanted}.")
    with new_figure(size or (3.6 * len(panels), 3.0), style, title) as figure:
        figure.set_label(caption({"": report}, "horizon"))
        for names, ax in zip(panels, figure.subplots(1, len(panels), squeeze=False)[0], strict=True):
            horizon(report, names, ax=ax)
            is_share = names[0] in SHARES
            unit = report.metrics[names[0]].unit
            ax.set_ylabel("share of truths within the ball" if is_share else f"error, radius [{unit}]")
            ax.set_ylim(0, 1.02 if is_share else None)
    return figure
