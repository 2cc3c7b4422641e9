"""Pictures of a report, a comparison or poses: reliability diagrams and others, ``ax`` in, ``ax`` out.

They draw what is given, and compute nothing. The functions that begin with ``draw`` make a figure without a display;
:func:`save` writes it.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from posecal.errors import PoseDataError, did_you_mean, printable
from posecal.plot.comparison import accuracy_and_calibration, draw_comparison
from posecal.plot.curves import (
    default_definition,
    errors_by_n,
    event_reliability,
    pck_curves,
    reliability,
    risk_coverage,
    sparsification,
)
from posecal.plot.intervals import draw_intervals, intervals
from posecal.plot.live import view
from posecal.plot.rank_tests import draw_rank_tests, rank_test
from posecal.plot.skeletons import draw_poses, frames_of, poses, signed_areas, with_sign
from posecal.plot.style import STYLE, check_suffix, figure_bytes, save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from posecal.report.report import Report

__all__ = [
    "KINDS",
    "accuracy_and_calibration",
    "check_suffix",
    "draw",
    "draw_comparison",
    "draw_intervals",
    "draw_poses",
    "draw_rank_tests",
    "errors_by_n",
    "event_reliability",
    "figure_bytes",
    "frames_of",
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
}
"""The pictures of a report, by the words of ``posecal plot``: functions of axes, but ``rank_tests`` of a figure."""


def draw(report: Report, kind: str = "reliability", *, title: str | None = None) -> Figure:
    """Draw a report as a figure with its caption, without a display.

    Parameters
    ----------
    report : Report
        The numbers.
    kind : str
        A key of :data:`KINDS`.
    title : str, optional
        Above the picture.

    Returns
    -------
    matplotlib Figure
        Ready to be saved.

    Raises
    ------
    PoseDataError
        Where the report lacks what the picture shows, and for another kind.
    """
    if not hasattr(report, "rank_tests"):
        raise PoseDataError(f"report: {type(report).__name__}; expected Report.")
    if str(kind) not in KINDS:
        raise PoseDataError(f"kind: {kind!r} is not known. {did_you_mean(kind, KINDS)}")
    if kind == "rank_tests":
        return draw_rank_tests(report)
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure()
        ax = figure.add_subplot()
        KINDS[kind][0](report, ax=ax)
        square = kind in {"reliability", "joints", "event"}
        width, height, columns = (3.7, 3.7, 74) if square else (4.4, 3.1, 90)
        lines = [line for text in (_caption(kind, report), report.signature) for line in textwrap.wrap(text, columns)]
        below = 0.1 + 0.112 * len(lines)
        height += below
        figure.set_size_inches(width, height)
        ax.set_anchor("N")
        if title:
            ax.set_title(printable(title))
        labels = 0.1 if kind == "joints" else 0.45
        figure.subplots_adjust(
            left=0.04 if kind == "joints" else 0.15,
            right=0.96,
            top=1 - (0.3 if title else 0.1) / height,
            bottom=(below + labels) / height,
        )
        figure.text(0.03, 0.06 / height, "\n".join(lines), fontsize=5.6, va="bottom", linespacing=1.35, color="#444444")
    return figure


def _caption(kind: str, report: Report) -> str:
    if kind == "reliability":
        return _reliability_caption(report)
    if kind == "joints":
        return (
            "∫ (ω_k(q) − q) dq of each joint k, exchangeable definition, "
            f"N={report.totals.spec.n_hypotheses}. A disc grows with the size of its joint's area."
        )
    if kind == "errors":
        return f"{report.curve('errors_by_n')[0].definition}."
    if kind == "sparsification":
        return f"AUSE {report.value('ause'):.3f}: {report.definition('ause')}."
    if kind == "risk_coverage":
        return _risk_coverage_caption(report)
    if kind == "event":
        return f"{report.definition('brier')}. Isotonic regression, equal p pooled."
    return f"Joints: {report.curve('pck_curve')[0].definition}. Poses: {report.curve('cps_curve')[0].definition}."


def _risk_coverage_caption(report: Report) -> str:
    words = []
    for name in ("aurc", "excess_aurc", "failure_auroc"):
        if not math.isnan(value := report.value(name)):
            metric = report.metrics[name]
            words.append(f"{metric.label} {value:.3f} {metric.unit}".rstrip())
            words[-1] += f" (failure rate {report.value('failure_rate'):.4f})" * (name == "failure_auroc")
    return f"{', '.join(words)}. AURC: {report.definition('aurc')}."


def _reliability_caption(report: Report) -> str:
    definition = default_definition(report)
    metric = report.metrics.get("ece" if definition == "exchangeable" else f"ece_{definition}")
    words = f"{definition.capitalize()} definition."
    if metric is not None:
        words = f"{metric.label} {report.value(metric.name):.4f}: {metric.definition}."
    if "signed_area" in report.metrics:
        words += f" Signed area {with_sign(report.value('signed_area'), 4)}."
    words += " Grey: each joint; dashed: a calibrated sampler."
    if metric is None or definition != "exchangeable" or math.isnan((null := report.test(metric.name)).p):
        return words
    return (
        f"{words} Band: 95 % of calibrated samplers, by sign-flips of {report.totals.units(null.sequences)}; "
        f"their mean ECE {null.mean:.4f}, p = {null.p:.3f}."
    )
