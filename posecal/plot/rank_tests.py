"""Pictures of rank tests: the difference of each curve from calibration, side by side."""

from __future__ import annotations

import os
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from posecal.calibration import LEVELS
from posecal.errors import PoseDataError, option
from posecal.plot.captions import caption
from posecal.plot.style import FAINT, ORANGE, ink, new_figure
from posecal.stats.resampling import LEVEL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from posecal.report.report import Report


def rank_test(report: Report, test: str, *, ax: Axes) -> Axes:
    """Draw one rank test: the curve's difference from the diagonal, and the band in which a calibrated sampler stays.

    Parameters
    ----------
    report : Report
        Holds the test.
    test : str
        Its name.
    ax : matplotlib Axes
        Where to draw.

    Returns
    -------
    matplotlib Axes
        The axes.

    Raises
    ------
    PoseDataError
        Where the report has no such test.
    """
    curves = report.rank_curves(test)
    null, p = report.rank_tests()[test]
    rejected = p < LEVEL
    if not np.isnan(null.band):
        reach = null.band * np.sqrt(LEVELS * (1 - LEVELS))
        ax.fill_between(LEVELS, -reach, reach, color=ink(), alpha=0.12, lw=0, zorder=0, gid="band")
    ax.axhline(0, color=ink(), lw=0.7, zorder=1)
    colour = ORANGE if rejected else ink()
    for curve in curves:
        many = len(curves) > 1
        ax.plot(
            LEVELS, curve - LEVELS, color=colour if rejected or not many else FAINT, lw=0.5 if many else 1.6, zorder=2
        )
    words = "no test" if np.isnan(p) else "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    ax.set_title(f"{textwrap.fill(report.metrics[test].label, 16)}\n{words}", fontsize="small", color=colour)
    ax.set(xlim=(0, 1), xticks=(0, 0.5, 1))
    ax.tick_params(labelsize="x-small")
    return ax


def draw_rank_tests(
    report: Report,
    *,
    columns: int = 4,
    title: str | None = None,
    size: tuple[float, float] | None = None,
    style: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw all rank tests side by side, without a display.

    Parameters
    ----------
    report : Report
        Holds the tests.
    columns : int
        Pictures in a row.
    title, size, style
        As for :func:`posecal.plot.draw`.

    Returns
    -------
    matplotlib Figure
        Ready to be saved.

    Raises
    ------
    PoseDataError
        Where the report has no rank tests.
    """
    tests = list(report.rank_tests())
    if not tests:
        wanted = option("metrics", "rank_tests")
        raise PoseDataError(f"rank_tests: the report has none. Evaluate with {wanted}.")
    down = -(-len(tests) // columns)
    with new_figure(size or (1.75 * columns, 1.75 * down + 0.3 * bool(title)), style, title) as figure:
        figure.set_label(caption({"": report}, "rank_tests"))
        for number, test in enumerate(tests):
            ax = figure.add_subplot(down, columns, number + 1)
            rank_test(report, test, ax=ax)
            if number % columns == 0:
                ax.set_ylabel("ω(q) − q", fontsize="small")
            if number >= len(tests) - columns:
                ax.set_xlabel("q", fontsize="small")
    return figure
