"""Pictures of rank tests: the difference of each curve from calibration, side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posecal.calibration import LEVELS
from posecal.errors import PoseDataError, option
from posecal.plot.style import FAINT, INK, ORANGE, STYLE
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
        ax.fill_between(LEVELS, -reach, reach, color="#E4E4E4", lw=0, zorder=0, gid="band")
    ax.axhline(0, color=INK, lw=0.7, zorder=1)
    colour = ORANGE if rejected else INK
    for curve in curves:
        many = len(curves) > 1
        ax.plot(
            LEVELS, curve - LEVELS, color=colour if rejected or not many else FAINT, lw=0.5 if many else 1.6, zorder=2
        )
    words = "no test" if np.isnan(p) else "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    ax.set_title(f"{report.metrics[test].label}\n{words}", fontsize=7.5, color=colour)
    ax.set(xlim=(0, 1), xticks=(0, 0.5, 1))
    ax.tick_params(labelsize=6.5)
    return ax


def draw_rank_tests(report: Report, *, columns: int = 4) -> Figure:
    """Draw all rank tests side by side, without a display.

    Parameters
    ----------
    report : Report
        Holds the tests.
    columns : int
        Pictures in a row.

    Returns
    -------
    matplotlib Figure
        Ready to be saved.

    Raises
    ------
    PoseDataError
        Where the report has no rank tests.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    tests = list(report.rank_tests())
    if not tests:
        wanted = option("metrics", "rank_tests")
        raise PoseDataError(f"rank_tests: the report has none. Evaluate with {wanted}.")
    down = -(-len(tests) // columns)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.75 * columns, 1.75 * down + 0.55))
        for number, test in enumerate(tests):
            ax = figure.add_subplot(down, columns, number + 1)
            rank_test(report, test, ax=ax)
            if number % columns == 0:
                ax.set_ylabel("ω(q) − q", fontsize=7.5)
            if number >= len(tests) - columns:
                ax.set_xlabel("q", fontsize=7.5)
        height = figure.get_figheight()
        figure.subplots_adjust(
            left=0.09, right=0.99, top=1 - 0.4 / height, bottom=0.72 / height, wspace=0.42, hspace=0.75
        )
        words = (
            "Exchangeable ranks of the truth by each pre-rank, minus uniform; grey: 95 % band by sequence sign-flips; "
            f"p adjusted for the number of tests (Holm); orange: below 0.05.\n{report.signature}"
        )
        figure.text(0.02, 0.06 / height, words, fontsize=5.2, va="bottom", linespacing=1.4, color="#444444")
    return figure
