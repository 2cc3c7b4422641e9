"""Pictures of a report, a comparison or poses: reliability diagrams and others, ``ax`` in, ``ax`` out.

They draw what is given. The functions that begin with ``draw`` make a figure without a display, of any size and style.
Its label is its caption, which :func:`save` writes into a text file beside it.
"""

from __future__ import annotations

import math
import os
import textwrap
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from posecal.errors import PoseDataError, did_you_mean, printable
from posecal.plot.captions import caption
from posecal.plot.comparison import accuracy_and_calibration, draw_comparison
from posecal.plot.curves import (
    errors_by_n,
    event_reliability,
    pck_curves,
    reliability,
    risk_coverage,
    sparsification,
)
from posecal.plot.horizon import draw_horizon, horizon
from posecal.plot.intervals import draw_intervals, intervals
from posecal.plot.live import view
from posecal.plot.pose_figures import draw_poses, frames_of, poses
from posecal.plot.rank_tests import draw_rank_tests, rank_test
from posecal.plot.skeletons import signed_areas
from posecal.plot.style import caption_of, check_suffix, figure_bytes, new_figure, save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from posecal.report.report import Report

__all__ = [
    "KINDS",
    "accuracy_and_calibration",
    "caption_of",
    "check_suffix",
    "draw",
    "draw_comparison",
    "draw_horizon",
    "draw_intervals",
    "draw_poses",
    "draw_rank_tests",
    "errors_by_n",
    "event_reliability",
    "figure_bytes",
    "frames_of",
    "horizon",
    "intervals",
    "pck_curves",
    "poses",
    "rank_test",
    "reliability",
    "risk_coverage",
    "save",
    "signed_areas",
    "sparsification",
    "view",
]

KINDS: dict[str, tuple[Callable[..., Any], str]] = {
    "reliability": (reliability, "calibration curves against the diagonal"),
    "joints": (signed_areas, "the signed area of every joint, on a skeleton"),
    "errors": (errors_by_n, "minMPJPE against the number of hypotheses"),
    "pck": (pck_curves, "PCK and CPS against the threshold"),
    "sparsification": (sparsification, "the error left when the most uncertain poses are dropped"),
    "risk_coverage": (risk_coverage, "the error of the poses that are kept by their predicted spread"),
    "event": (event_reliability, "reliability of: the median pose is right at every joint"),
    "rank_tests": (draw_rank_tests, "rank tests for what the ECE can't see"),
    "horizon": (draw_horizon, "coverage, errors and spread against the horizon of a prediction"),
}
"""The pictures of a report, by the words of ``posecal plot``: functions of axes, but the last two of a figure."""


OWN_PANELS = ("rank_tests", "horizon")
"""Pictures of one model in several panels."""

TOGETHER = ("reliability", "errors", "pck", "sparsification", "risk_coverage")
"""Pictures that show several models in one panel."""

COLUMNS = 4
"""Most panels of a figure beside each other."""


def draw(
    report: Report | Mapping[str, Report],
    kind: str = "reliability",
    *,
    panels: bool = False,
    title: str | None = None,
    size: tuple[float, float] | None = None,
    style: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a report, or several for comparison, as a figure with its caption, without a display.

    Parameters
    ----------
    report : Report, or mapping of Report
        The numbers; of several models by their names.
    kind : str
        A key of :data:`KINDS`.
    panels : bool
        Of several models, whether each has a panel of its own; curves are in one panel by default, all else never.
    title : str, optional
        Above the picture.
    size : tuple of two floats, optional
        Width and height in inches.
    style : str or path, optional
        A style of Matplotlib, by its name or as an ``.mplstyle`` file; it changes posecal's.

    Returns
    -------
    matplotlib Figure
        Ready to be saved. Its label is the caption.

    Raises
    ------
    PoseDataError
        Where a report lacks what the picture shows, for another kind, and for a size or style that is none.
    PoseFileError
        For a file of a style that can't be read.

    Examples
    --------
    >>> import numpy as np
    >>> from posecal.evaluation import evaluate
    >>> random = np.random.default_rng(0)
    >>> truth = random.normal(0, 100, (40, 2, 3))
    >>> reports = {
    ...     name: evaluate(truth + random.normal(0, sigma, (20, 40, 2, 3)), truth, unit="mm", axes="NMKD")
    ...     for name, sigma in {"ours": 30.0, "theirs": 60.0}.items()
    ... }
    >>> figure = draw(reports, size=(3.3, 3.6))
    >>> caption_of(figure).partition(" (")[0]  # the truth is always central
    'ours: ECE 0.4309'
    """
    reports = dict(report) if isinstance(report, Mapping) else {"": report}
    for one in reports.values():
        if not hasattr(one, "rank_tests"):
            raise PoseDataError(f"report: {type(one).__name__}; expected Report.")
    if not reports:
        raise PoseDataError("report: none; expected at least one.")
    if str(kind) not in KINDS:
        raise PoseDataError(f"kind: {kind!r} is not known. {did_you_mean(kind, KINDS)}")
    if kind in OWN_PANELS:
        if len(reports) > 1:
            raise PoseDataError(f"report: {len(reports)} models; expected one, since its numbers have a panel each.")
        figure: Figure = KINDS[kind][0](*reports.values(), title=title, size=size, style=style)
        return figure
    together = len(reports) > 1 and kind in TOGETHER and not panels
    number = 1 if together else len(reports)
    down = math.ceil(number / COLUMNS)
    across = math.ceil(number / down)
    wide, tall = (3.5, 3.5) if kind in {"reliability", "joints", "event"} else (4.4, 3.1)
    if number > 1 and kind != "joints":
        wide, tall = 0.8 * wide, 0.8 * tall
    longest = max(map(len, reports))
    in_a_row = max(1, min(len(reports), int((size or (wide, tall))[0] / (0.45 + 0.06 * longest))))  # names of a legend
    extra = 0.3 * bool(title) + together * (0.1 + 0.15 * math.ceil(len(reports) / in_a_row))
    layout = "compressed" if kind in {"reliability", "event"} else "constrained"  # of axes that are squares
    with new_figure(size or (wide * across, tall * down + extra), style, title, layout=layout) as figure:
        axes = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
        if together:
            KINDS[kind][0](reports, ax=axes[0, 0])
            figure.set_label(caption(reports, kind, together=True))
            figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=in_a_row)
            return figure
        letters = max(1, int(10 * (size[0] / across if size else wide)))
        for at, (ax, (name, one)) in enumerate(zip(axes.flat, reports.items(), strict=False)):
            KINDS[kind][0](one, ax=ax)
            if name:
                ax.set_title(textwrap.fill(printable(name), letters), fontsize="medium")
            if number > 1:
                lowest, first = at + across >= number, at % across == 0
                ax.set(xlabel=ax.get_xlabel() if lowest else "", ylabel=ax.get_ylabel() if first else "")
                ax.tick_params(labelbottom=lowest, labelleft=first)
                for label in (ax.xaxis.label, ax.yaxis.label):
                    label.set_fontsize("small")
        figure.set_label(caption(reports, kind))
        for ax in axes.flat[number:]:
            ax.set_axis_off()
        if kind in {"errors", "risk_coverage"}:  # from 0 to above all curves
            axes[0, 0].set_ylim(0, 1.05 * max(ax.dataLim.ymax for ax in axes.flat[:number]))
    return figure
