"""How do the numbers look? Reliability diagrams and the rest: ``ax`` in, ``ax`` out.

Everything here draws what a report, a curve or an array of poses holds, and computes nothing. Pictures that need a
file go through :func:`draw`, which never touches a display. The colours tell over- from underconfidence for
colour-blind readers too.
"""

from __future__ import annotations

import io
import os
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from posecal.block import FloatArray
from posecal.calibration import Definition
from posecal.errors import PoseDataError, PoseFileError, did_you_mean, first_few
from posecal.io import written_whole
from posecal.pairs import PosePairs
from posecal.report import Report
from posecal.skeleton import Skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.axes3d import Axes3D

__all__ = ["KINDS", "correct", "draw", "draw_poses", "errors_by_n", "poses", "reliability", "save", "signed_areas"]

UNDER, OVER, INK, FAINT = "#0072B2", "#CC79A7", "#222222", "#B8B8B8"
"""Underconfident, overconfident, text and the main line, what stands behind."""

SUFFIXES = (".svg", ".png", ".pdf")

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.labelsize": 9,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "figure.dpi": 110,
    "savefig.dpi": 200,
    "svg.fonttype": "none",
    "svg.hashsalt": "posecal",
    "pdf.fonttype": 42,
}


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.gca()


def reliability(
    report: Report,
    *,
    definition: Definition = "exchangeable",
    group: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the reliability diagram: how often the truth lies within each ball of the hypotheses.

    Parameters
    ----------
    report : Report
        Holds the curves.
    definition : str
        One of :data:`posecal.calibration.DEFINITIONS`.
    group : str, optional
        ``label=value``; all poses by default.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: faint lines for the joints, a dark one for the curve that the ECE is made from.

    Raises
    ------
    PoseDataError
        Where the report has no such curve.
    """
    ax = _axes(ax)
    curve = report.calibration(definition, group)
    middle = report.summary_curve(definition, group)
    ax.fill_between([0, 1], [0, 1], 1, color=UNDER, alpha=0.07, lw=0, zorder=0)
    ax.fill_between([0, 1], 0, [0, 1], color=OVER, alpha=0.11, lw=0, zorder=0)
    ax.text(0.04, 0.93, "underconfident", color=UNDER, va="top")
    ax.text(0.96, 0.07, "overconfident", color="#9C4A78", ha="right")
    for joint, values in zip(report.totals.subject.joints, curve.coverage, strict=True):
        if not np.isnan(values).any():
            ax.plot(curve.levels, values, color=FAINT, lw=0.8, zorder=1, gid=f"joint {joint}")
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


def _reliability_caption(report: Report) -> str:
    ece = report.value("ece")
    metric = report.metrics["ece"]
    return f"ECE {ece:.4f}: {metric.definition}. Signed area {_signed(report.value('signed_area'), 4)}."


def signed_areas(report: Report, *, ax: Axes | None = None) -> Axes:
    """Draw the signed area of every joint on a standing skeleton.

    Parameters
    ----------
    report : Report
        Holds the numbers.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: a disc per joint, its area growing with the size of the signed area, in the colour of its side.

    Raises
    ------
    PoseDataError
        Where the report has no signed areas, or its joints have no place on a person.
    """
    ax = _axes(ax)
    report.value("signed_area")
    joints = report.totals.subject.joints
    skeleton = Skeleton(joints)
    at = skeleton.rest_pose[:, [0, 2]] * [2.0, 1.0]  # from the front, and broad, so that the numbers have room
    for parent, child in skeleton.bones:
        ax.plot(*at[[parent, child]].T, color=FAINT, lw=3, solid_capstyle="round", zorder=1)
    values = {row.joint: row.value for row in report.rows if row.metric == "signed_area" and row.joint is not None}
    for joint, (x, y) in zip(joints, at, strict=True):
        value = values.get(joint)
        if value is None:
            ax.scatter(x, y, s=14, color="white", edgecolor=INK, lw=0.8, zorder=3)
            continue
        area = 20 + 1800 * abs(value)
        ax.scatter(x, y, s=area, color=OVER if value < 0 else UNDER, edgecolor="white", lw=0.8, zorder=2, gid=joint)
        side = -1 if x < 0 else 1
        ax.annotate(
            _signed(value, 3),
            (x, y),
            xytext=(side * (3 + np.sqrt(area / np.pi)), 0),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            fontsize=7,
            zorder=4,
        )
    ax.set_aspect("equal")
    ax.margins(0.2, 0.05)
    ax.axis("off")
    for side_name, place in (("right side", 0.08), ("left side", 0.92)):
        ax.text(place, 0.98, side_name, transform=ax.transAxes, ha="center", fontsize=7.5, color="#666666")
    for word, y, colour in (("overconfident", 0.32, "#9C4A78"), ("underconfident", 0.26, UNDER)):
        ax.text(0.5, y, word, transform=ax.transAxes, ha="center", color=colour)
    return ax


def _signed(value: float, digits: int) -> str:
    return f"{value:+.{digits}f}".replace("-", "−")


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
    ax = _axes(ax)
    curve, values = report.curve("errors_by_n")
    ax.plot(curve.at, values, color=INK, lw=1.8, marker="o", ms=2.5)
    ax.set_xscale("log")
    ticks = [n for n in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000) if n <= curve.at[-1]]
    ax.set_xticks(ticks, [str(n) for n in ticks])
    ax.minorticks_off()
    ax.set(xlabel=curve.axes[0], ylabel=curve.axes[1], ylim=(0, None))
    ax.grid(axis="y", color="#E4E4E4", lw=0.6)
    return ax


def correct(report: Report, *, ax: Axes | None = None) -> Axes:
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
    ax = _axes(ax)
    pck, shares = report.curve("pck_curve")
    cps, poses_right = report.curve("cps_curve")
    ax.plot(pck.at, shares, color=UNDER, lw=1.8, label="joints (PCK)", gid="pck_curve")
    ax.plot(
        cps.at,
        poses_right,
        color="#D55E00",
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


def poses(
    hypotheses: FloatArray,
    truth: FloatArray,
    joints: Sequence[str],
    *,
    cloud: str | None = None,
    most: int = 50,
    ax: Axes3D | None = None,
) -> Axes3D:
    """Draw one pose in three dimensions: its hypotheses, the truth, and the cloud of one joint.

    Parameters
    ----------
    hypotheses : array (N, K, 3)
        Hypotheses, mm; thin and grey.
    truth : array (K, 3)
        The true pose, mm; blue.
    joints : sequence of str
        K names; the bones follow from them.
    cloud : str, optional
        The joint whose hypotheses are shown as pink points.
    most : int
        How many hypotheses are drawn, evenly chosen.
    ax : matplotlib Axes3D, optional
        Where to draw; new axes by default.

    Returns
    -------
    matplotlib Axes3D
        The axes, with the person upright: up is where the head is.
    """
    if ax is None:
        from matplotlib import pyplot as plt

        ax = plt.figure().add_subplot(projection="3d")
    skeleton = Skeleton(tuple(joints))
    turn = _upright(truth, skeleton)
    shown = hypotheses[np.linspace(0, len(hypotheses) - 1, min(most, len(hypotheses))).astype(int)] @ turn
    true = truth @ turn
    for pose in shown:
        for bone in skeleton.bones:
            ax.plot(*pose[list(bone)].T, color="#8C8C8C", lw=0.4, alpha=0.35, zorder=1)
    if cloud is not None:
        points = shown[:, list(joints).index(cloud)]
        ax.scatter(*points.T, s=4, color=OVER, alpha=0.8, lw=0, zorder=3, depthshade=False)
    for bone in skeleton.bones:
        ax.plot(*true[list(bone)].T, color=UNDER, lw=1.8, solid_capstyle="round", zorder=4)
    centre = (true.max(axis=0) + true.min(axis=0)) / 2
    reach = 0.56 * (true.max(axis=0) - true.min(axis=0)).max()
    ax.set(xlim=centre[0] + reach * np.array([-1, 1]), ylim=centre[1] + reach * np.array([-1, 1]))
    ax.set_zlim(centre[2] - reach, centre[2] + reach)
    ax.set_box_aspect((1, 1, 1), zoom=1.6)
    ax.view_init(elev=8, azim=-62)
    ax.set_axis_off()
    return ax


def _upright(truth: FloatArray, skeleton: Skeleton) -> FloatArray:
    """A rotation of the axes, (3, 3), that puts the axis from the feet to the head upwards."""
    at = {name: place for place, name in enumerate(skeleton.joints)}
    top = next((at[name] for name in ("Head", "Neck/Nose", "Thorax") if name in at), None)
    low = [at[name] for name in ("LFoot", "RFoot", "LKnee", "RKnee", "Hip") if name in at][:2]
    if top is None or not low:
        return np.eye(3)
    upwards = truth[top] - truth[low].mean(axis=0)
    axis = int(np.abs(upwards).argmax())
    sign = float(np.sign(upwards[axis])) or 1.0
    turn = np.zeros((3, 3))
    first, second = ((axis + 1) % 3, (axis + 2) % 3)
    turn[first, 0], turn[second, 1], turn[axis, 2] = 1.0, sign, sign
    return turn


KINDS: dict[str, tuple[Callable[..., Axes], str]] = {
    "reliability": (reliability, "calibration curves against the diagonal"),
    "joints": (signed_areas, "the signed area of every joint, on a skeleton"),
    "errors": (errors_by_n, "minMPJPE against the number of hypotheses"),
    "correct": (correct, "PCK and CPS against the threshold"),
}
"""The pictures that a report can be drawn as."""


def _caption(kind: str, report: Report) -> str:
    if kind == "reliability":
        return _reliability_caption(report)
    if kind == "joints":
        return (
            "∫ (ω_k(q) − q) dq of each joint k, exchangeable definition, "
            f"N={report.totals.subject.n_hypotheses}. A disc grows with the size of its joint's area."
        )
    if kind == "errors":
        return f"{report.curve('errors_by_n')[0].definition}."
    return f"Joints: {report.curve('pck_curve')[0].definition}. Poses: {report.curve('cps_curve')[0].definition}."


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
        Where the report lacks what the picture shows.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        square = kind in {"reliability", "joints"}
        width, height, columns = (3.7, 3.7, 74) if square else (4.4, 3.1, 90)
        lines = [line for text in (_caption(kind, report), report.signature) for line in textwrap.wrap(text, columns)]
        below = 0.1 + 0.112 * len(lines)
        height += below
        figure = Figure(figsize=(width, height))
        ax = figure.add_subplot()
        KINDS[kind][0](report, ax=ax)
        ax.set_anchor("N")
        if title:
            ax.set_title(title)
        labels = 0.1 if kind == "joints" else 0.45
        figure.subplots_adjust(
            left=0.04 if kind == "joints" else 0.15,
            right=0.96,
            top=1 - (0.3 if title else 0.1) / height,
            bottom=(below + labels) / height,
        )
        figure.text(0.03, 0.06 / height, "\n".join(lines), fontsize=5.6, va="bottom", linespacing=1.35, color="#444444")
    return figure


def frames_of(pairs: PosePairs, text: str | None, some: int = 5) -> list[int]:
    """Give the numbers of the poses that a user names by frame id or by number; evenly spaced ones by default.

    Raises
    ------
    PoseDataError
        For a name that no pose has.
    """
    if text is None:
        last = len(pairs.truth) - 1
        return sorted({last * (2 * place + 1) // (2 * some) for place in range(some)})
    places = {name: place for place, name in enumerate(pairs.frame_id.tolist())}
    found = []
    for word in (part.strip() for part in text.split(",")):
        if word not in places and not (word.isdecimal() and int(word) < len(places)):
            raise PoseDataError(
                f"frames: {word!r} is neither a frame id nor a number below {len(places):,}. "
                f"The first are {first_few(list(places))}."
            )
        found.append(places[word] if word in places else int(word))
    return found


def draw_poses(
    pairs: PosePairs, frames: Sequence[int], *, cloud: str | None = None, most: int = 50, columns: int = 5
) -> Figure:
    """Draw some poses with their hypotheses, side by side, without a display.

    Parameters
    ----------
    pairs : PosePairs
        Hypotheses and truth.
    frames : sequence of int
        The numbers of the poses.
    cloud, most
        As for :func:`poses`.
    columns : int
        Pictures in a row.

    Returns
    -------
    matplotlib Figure
        Ready to be saved.

    Raises
    ------
    PoseDataError
        For a joint that the poses don't have.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    if cloud is not None and cloud not in pairs.joints:
        raise PoseDataError(f"joint: {cloud!r} is not among the joints. {did_you_mean(cloud, pairs.joints)}")
    across = min(columns, len(frames))
    down = -(-len(frames) // across)
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(1.9 * across, 2.7 * down + 0.25))
        for place, frame in enumerate(frames):
            ax = figure.add_subplot(down, across, place + 1, projection="3d")
            poses(
                pairs.stored.read(frame, frame + 1)[:, 0],
                pairs.truth[frame],
                pairs.joints,
                cloud=cloud,
                most=most,
                ax=cast("Axes3D", ax),
            )
            ax.set_title(str(pairs.frame_id[frame]), fontsize=7, y=1.0)
        edge = 0.25 / figure.get_figheight()
        figure.subplots_adjust(left=0, right=1, top=0.96, bottom=edge, wspace=0, hspace=0.08)
        words = f"blue: truth · grey: {min(most, pairs.shape[0])} of {pairs.shape[0]} hypotheses"
        words += f" · pink: {cloud}" if cloud else ""
        figure.text(0.02, 0.3 * edge, words, fontsize=6.5, color="#444444")
    return figure


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure into a file, whole or not at all.

    Parameters
    ----------
    figure : matplotlib Figure
        What is written.
    path : path
        Ends with ``.svg``, ``.png`` or ``.pdf``.

    Raises
    ------
    PoseFileError
        For another ending, or where the file can't be written.
    """
    contents = figure_bytes(figure, check_suffix(path))
    written_whole(path, lambda file: file.write(contents))


def figure_bytes(figure: Figure, suffix: str) -> bytes:
    """Give the contents of a picture file, the same for the same figure."""
    import matplotlib as mpl

    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(suffix, {})
    file = io.BytesIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(file, format=suffix[1:], metadata=undated)
    return file.getvalue()


def check_suffix(path: str | os.PathLike[str]) -> str:
    """Give the ending of a picture's name.

    Raises
    ------
    PoseFileError
        Where it is no picture that can be drawn.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise PoseFileError(f"{path}: {suffix or 'no ending'}; expected a name that ends with .svg, .png or .pdf.")
    return suffix
