"""Figures of estimates and trainings, in the style of :mod:`posecal.plot`.

Every function returns a :class:`matplotlib.figure.Figure` and computes nothing. Poses are shown from the camera and
from the side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from posecal.data.skeleton import Skeleton
from posecal.errors import printable
from posecal.plot import reliability
from posecal.plot.style import FAINT, INK, OVER, UNDER
from posecal.report.report import Report

__all__ = ["hypotheses", "losses", "model_sizes", "pendulum", "prior", "reliability_grid"]

Floats = npt.NDArray[np.floating[Any]]

_GOLD = "#E69F00"


def _style() -> AbstractContextManager[None]:
    settings: Any = {
        "font.size": 8,
        "axes.titlesize": 8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.linewidth": 0.6,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "legend.frameon": False,
        "legend.fontsize": 7,
        "svg.fonttype": "none",
        "svg.hashsalt": "posecal",
    }
    return mpl.rc_context(settings)


def reliability_grid(reports: Mapping[str, Report], *, columns: int = 4) -> Figure:
    """Plot a reliability diagram for each estimator.

    Parameters
    ----------
    reports : mapping of str to Report
        Reports by the estimators' names.
    columns : int
        Maximum number of diagrams in a row.

    Returns
    -------
    Figure
        With the exchangeable ECE in each title.
    """
    columns = min(columns, len(reports))
    rows = -(-len(reports) // columns)
    columns = -(-len(reports) // rows)
    with _style():
        figure = Figure(figsize=(2.3 * columns, 2.55 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        for ax in axes.flat[len(reports) :]:
            ax.set_axis_off()
        for index, (name, report) in enumerate(reports.items()):
            ax = axes.flat[index]
            reliability(report, ax=ax)
            ax.set_title(f"{name}\nECE {report.value('ece'):.3f}", loc="left")
            ax.set(xlabel="", ylabel="")
        figure.supxlabel("share of hypotheses within the ball, q", fontsize=8)
        figure.supylabel("share of truths within it, ω(q)", fontsize=8)
    return figure


def model_sizes(rows: Mapping[str, Mapping[str, Sequence[float]]]) -> Figure:
    """Plot ECE and minMPJPE against the number of parameters.

    Parameters
    ----------
    rows : mapping of str to mapping
        For each estimator ``parameters``, one number, and ``ece`` and ``min_mpjpe`` (mm), a number for each sampling
        seed.

    Returns
    -------
    Figure
        A point for each estimator and seed, and a line through their means.
    """
    ordered = sorted(rows.items(), key=lambda row: row[1]["parameters"][0])
    sizes = [row["parameters"][0] for _, row in ordered]
    with _style():
        figure = Figure(figsize=(5.4, 2.4), layout="constrained")
        for ax, (key, label) in zip(
            figure.subplots(1, 2), (("ece", "ECE (exchangeable)"), ("min_mpjpe", "minMPJPE [mm]")), strict=True
        ):
            for size, (_, row) in zip(sizes, ordered, strict=True):
                ax.plot([size] * len(row[key]), row[key], ".", color=INK, markersize=4)
            means = [float(np.mean(row[key])) for _, row in ordered]
            ax.plot(sizes, means, color=INK, linewidth=0.8)
            for size, mean, (name, _) in zip(sizes, means, ordered, strict=True):
                ax.annotate(printable(name), (size, mean), xytext=(5, 4), textcoords="offset points", fontsize=7)
            ax.set(xscale="log", xlabel="parameters", ylabel=label)
            ax.margins(x=0.2, y=0.15)
    return figure


def _plot_bones(ax: Axes, pose: Floats, skeleton: Skeleton, axis: int, **line_style: Any) -> None:
    ends = pose[np.array(skeleton.bones)][..., [axis, 1]] * (1, -1)
    ax.add_collection(LineCollection(list(ends), capstyle="round", **line_style))


def hypotheses(
    columns: Sequence[tuple[str, Floats, Floats]], joints: Sequence[str], *, cloud: str, drawn: int = 50
) -> Figure:
    """Plot hypotheses (grey) against the truth (blue), one joint as pink points.

    Parameters
    ----------
    columns : sequence of (str, ndarray, ndarray)
        For each image a title, hypotheses (N, K, 3) and truth (K, 3), mm, in the camera's frame.
    joints : sequence of str
        K names, the root included.
    cloud : str
        The joint whose hypotheses are shown as points.
    drawn : int
        Number of hypotheses that are shown.

    Returns
    -------
    Figure
        Each image from the camera above, from the side below.
    """
    skeleton, joint = Skeleton(tuple(joints)), list(joints).index(cloud)
    with _style():
        figure = Figure(figsize=(1.35 * len(columns), 3.9), layout="constrained")
        axes = figure.subplots(2, len(columns), sharex=True, sharey=True, squeeze=False)
        for index, (title, poses, truth) in enumerate(columns):
            for row, axis in enumerate((0, 2)):
                ax = axes[row, index]
                for pose in poses[:drawn]:
                    _plot_bones(ax, pose, skeleton, axis, color=FAINT, linewidth=0.4, alpha=0.5, zorder=1)
                _plot_bones(ax, truth, skeleton, axis, color=UNDER, linewidth=1.6, zorder=2)
                points = poses[:drawn, joint]
                ax.plot(points[:, axis], -points[:, 1], ".", color=OVER, markersize=2.5, alpha=0.8)
                _hide_axes(ax)
            axes[0, index].set_title(title, fontsize=6.5)
        axes[0, 0].set_ylabel("from the camera")
        axes[1, 0].set_ylabel("from the side")
        axes[1, 0].plot([-900, -400], [-1150, -1150], color=INK, linewidth=1)
        axes[1, 0].text(-650, -1120, "500 mm", ha="center", va="bottom", fontsize=6)
        figure.supxlabel(f"blue: truth · grey: {drawn} hypotheses · pink: {cloud}", fontsize=7)
    return figure


def _hide_axes(ax: Axes) -> None:
    ax.set(xlim=(-1000, 1000), ylim=(-1250, 1000), aspect="equal", xticks=[], yticks=[])
    for side in ax.spines.values():
        side.set_visible(False)


def prior(poses: Floats, joints: Sequence[str]) -> Figure:
    """Plot poses of the prior, each from the camera and from the side.

    Parameters
    ----------
    poses : ndarray
        (M, K, 3), mm.
    joints : sequence of str
        K names, the root included.

    Returns
    -------
    Figure
        A column for each pose.
    """
    skeleton = Skeleton(tuple(joints))
    colours = {"left": OVER, "right": UNDER, "middle": INK}
    with _style():
        figure = Figure(figsize=(1.1 * len(poses), 3.3), layout="constrained")
        axes = figure.subplots(2, len(poses), sharex=True, sharey=True, squeeze=False)
        for index, pose in enumerate(poses):
            for row, axis in enumerate((0, 2)):
                for parent, child in skeleton.bones:
                    line = pose[[parent, child]]
                    axes[row, index].plot(
                        line[:, axis],
                        -line[:, 1],
                        color=colours[skeleton.side[child]],
                        linewidth=1.4,
                        solid_capstyle="round",
                    )
                _hide_axes(axes[row, index])
        axes[0, 0].set_ylabel("from the camera")
        axes[1, 0].set_ylabel("from the side")
        figure.supxlabel("pink: the left side · blue: the right side", fontsize=7)
    return figure


def losses(curves: Mapping[str, npt.NDArray[np.void]]) -> Figure:
    """Plot the loss curves of trainings.

    Parameters
    ----------
    curves : mapping of str to structured ndarray
        The ``losses.csv`` of each training.

    Returns
    -------
    Figure
        Training and validation loss of each epoch; the first, high ones are outside the axes.
    """
    columns = min(len(curves), 4)
    rows = -(-len(curves) // columns)
    with _style():
        figure = Figure(figsize=(2.6 * columns + 0.4, 2.3 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).flat
        for ax in axes[len(curves) :]:
            ax.set_axis_off()
        for ax, (name, curve) in zip(axes, curves.items(), strict=False):
            ax.plot(curve["step"], curve["training_loss"], color=FAINT, linewidth=1.5, label="training")
            ax.plot(curve["step"], curve["validation_loss"], color=INK, linewidth=1.2, label="validation")
            ax.set_title(name, loc="left")
            ax.set_xlabel("step")
            low, high = np.nanquantile([curve["training_loss"], curve["validation_loss"]], (0, 0.9))
            if high > low:
                ax.set_ylim(low - 0.1 * (high - low), high + 0.6 * (high - low))
        axes[0].set_ylabel("loss")
        axes[0].legend()
    return figure


def pendulum(samples: Mapping[str, Floats], truth: Floats, titles: Mapping[str, str]) -> Figure:
    """Plot the zero-shot experiment: samples of three models around true pendulums.

    Parameters
    ----------
    samples : mapping of str to ndarray
        For each model (n, M, 3, 2), m.
    truth : ndarray
        (M, 3, 2), m; the fixed node is the origin.
    titles : mapping of str to str
        The title of each model's row.

    Returns
    -------
    Figure
        A row for each model, a column for each pendulum.
    """
    colours = (_GOLD, OVER, UNDER)
    with _style():
        figure = Figure(figsize=(1.6 * len(truth), 1.9 * len(samples)), layout="constrained")
        rows = figure.subfigures(len(samples), 1, squeeze=False)[:, 0]
        for row, (name, drawn) in zip(rows, samples.items(), strict=True):
            row.suptitle(titles[name], x=0.02, ha="left", fontsize=7)
            axes = row.subplots(1, len(truth), sharey=True, squeeze=False)[0]
            for column, (ax, nodes) in enumerate(zip(axes, truth, strict=True)):
                for node, colour in enumerate(colours):
                    x, y = drawn[:, column, node].T
                    ax.plot(x, y, ".", color=colour, markersize=2, alpha=0.5, label=f"x{node + 1}")
                chain = np.concatenate([np.zeros((1, 2)), nodes])
                ax.plot(chain[:, 0], chain[:, 1], "o-", color=INK, markersize=3, linewidth=1)
                ax.set(xlim=(-3.2, 3.2), ylim=(-3.2, 3.2), aspect="equal", xticks=(-2, 0, 2), yticks=(-2, 0, 2))
            axes[0].set_ylabel("y (m)", fontsize=8)
        handles, names = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower right", ncols=3, markerscale=3, handletextpad=0.1, fontsize=7)
        figure.supxlabel("x (m)", fontsize=8)
    return figure
