"""Pictures of several models: accuracy against calibration."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from posecal.errors import PoseDataError, printable
from posecal.plot.style import GREEN, given, ink, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import BboxBase

    from posecal.stats.comparison import PairedModels


BOTH = "min_mpjpe", "ece"
"""The metrics of the two axes."""

CAPTION = "Bars: 95 % over sequences. Green: ECEs up to the 95 % quantile of a calibrated sampler's, by sign-flips."


def accuracy_and_calibration(comparison: PairedModels, *, ax: Axes | None = None) -> Axes:
    """Draw minMPJPE against the ECE of each model.

    Parameters
    ----------
    comparison : Comparison
        The models.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: a point per model, with the interval of its minMPJPE, and the region of the ECEs that a calibrated
        sampler would show.

    Raises
    ------
    PoseDataError
        Where the models report no minMPJPE or no ECE.
    """
    ax = given(ax)
    for name in BOTH:
        if name not in comparison.metrics:
            raise PoseDataError(f"comparison: no {name}; expected both min_mpjpe and ece.")
    limit = comparison.feasible()
    if not math.isnan(limit):
        ax.axvspan(0, limit, color=GREEN, alpha=0.12, lw=0, gid="feasible")
    markers = "osD^vP*X"
    for number, name in enumerate(comparison.names):
        x, y = comparison.value("ece", name), comparison.value("min_mpjpe", name)
        interval = comparison.interval("min_mpjpe", name)
        if not math.isnan(interval.low):
            ax.plot([x, x], [interval.low, interval.high], color=ink(), lw=0.8, zorder=1)
        ax.plot(x, y, marker=markers[number % len(markers)], color=ink(), ms=5, ls="", gid=name)
        about = ax.annotate(printable(name), (x, y), xytext=(6, 3), textcoords="offset points", fontsize="small")
        about.set_in_layout(False)
    most = max(comparison.value("ece", name) for name in comparison.names)
    unit = comparison.metrics["min_mpjpe"].unit
    ax.set(xlabel="ECE (exchangeable)", ylabel=f"minMPJPE [{unit}]" if unit else "minMPJPE")
    right = 1.35 * max(most, 0.03 if math.isnan(limit) else limit)
    ax.set_xlim(0, right)
    if not math.isnan(limit):
        within = limit > right / 2  # and no place beside it
        words = "calibrated, but for chance " if within else " ◂ calibrated, but for chance"
        side = "right" if within else "left"
        at = ax.get_xaxis_transform()
        ax.text(limit, 0.01, words, transform=at, ha=side, va="bottom", fontsize="small", color=GREEN)
    _place_names(ax)
    return ax


def _place_names(ax: Axes) -> None:
    """Put each model's name beside its point, where it covers the fewest names, bars and points of others."""
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

    ax.autoscale_view()
    others: list[BboxBase] = []
    for line in ax.lines:
        places = ax.transData.transform(np.asarray(line.get_xydata()))
        room = 4 if line.get_gid() else 2  # a point, or a bar
        others.append(Bbox([places.min(axis=0) - room, places.max(axis=0) + room]))
    others += [text.get_window_extent() for text in ax.texts if not isinstance(text, Annotation)]
    for name in (text for text in ax.texts if isinstance(text, Annotation)):
        covered = {}
        for side, rise in product((6, -6), (3, -10, 15, -22, 27, -34)):
            name.set(position=(side, rise), ha="left" if side > 0 else "right")
            box = name.get_window_extent()
            outside = box.x0 < ax.bbox.x0 or box.x1 > ax.bbox.x1
            covered[side, rise] = outside * len(others) + box.count_overlaps(others)
        best = min(covered, key=covered.__getitem__)
        name.set(position=best, ha="left" if best[0] > 0 else "right")
        others.append(name.get_window_extent())


def draw_comparison(
    comparison: PairedModels | Mapping[str, PairedModels],
    *,
    title: str | None = None,
    size: tuple[float, float] | None = None,
    style: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw :func:`accuracy_and_calibration` as a figure with its caption, without a display.

    Parameters
    ----------
    comparison : Comparison or mapping
        The models. Several comparisons, by their titles, stand side by side, but for those that lack one of the two
        metrics.
    title, size, style
        As for :func:`posecal.plot.draw`.

    Returns
    -------
    matplotlib Figure
        Ready to be saved.

    Raises
    ------
    PoseDataError
        As :func:`accuracy_and_calibration` does, and for a size or style that is none.
    """
    titled = comparison if isinstance(comparison, Mapping) else {"": comparison}
    shown = {name: one for name, one in titled.items() if {*BOTH} <= {*one.metrics}} or titled
    with new_figure(size or (4.4 * len(shown), 3.1), style, title) as figure:
        for ax, (name, one) in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown.items(), strict=True):
            accuracy_and_calibration(one, ax=ax)
            ax.set_title(printable(name), fontsize="medium")
        figure.draw_without_rendering()  # lays the axes out
        for ax in figure.axes:
            _place_names(ax)
        signatures = dict.fromkeys(f"signature: {one.totals[0].signature}" for one in shown.values())
        figure.set_label("\n".join([CAPTION, *signatures]))
    return figure
