"""Pictures of central intervals over time, against the truth: one coordinate of one joint."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from posecal.calibration.intervals import CentralIntervals
from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.joint_names import find_joint
from posecal.data.root import origin, resting_joints, root_name
from posecal.data.stored_poses import Rows
from posecal.errors import PoseDataError, did_you_mean, first_few, printable
from posecal.plot.style import ORANGE, UNDER, given, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from posecal.data.pose_data import PoseData

SHADES = {0.9: "#DCDCDC", 0.5: "#AFAFAF"}
"""Levels of the intervals that are drawn, the widest first, and their colours."""

AXES = "xyz"
"""Names of coordinates."""


def intervals(
    hypotheses: FloatArray,
    truth: FloatArray,
    *,
    unit: str | float = "none",
    at: FloatArray | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the central 50 % and 90 % intervals of one coordinate over time, and the truth.

    Parameters
    ----------
    hypotheses : array (N, M)
        Hypotheses of the coordinate.
    truth : array (M,)
        The true coordinate; blue, and orange where it lies outside the wider interval.
    unit : str or float
        ``deg`` or ``rad`` for angles, which are drawn without jumps; any other is the same.
    at : array (M,), optional
        Time, or the number of each frame; 0, 1, … by default.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes; the title says how many truths the wider interval holds. Fewer than 19 hypotheses span less than
        90 %: the interval is that of all, and has the share that it holds for a perfect sampler as its name.

    Notes
    -----
    See :mod:`posecal.calibration.intervals`.
    """
    ax = given(ax)
    frames = np.arange(len(truth)) if at is None else at
    found = CentralIntervals.of(hypotheses, truth, [*SHADES], unit)
    for (level, (low, high)), colour in zip(found.ends.items(), SHADES.values(), strict=False):
        name = f"{100 * level:.0f} % interval"
        ax.fill_between(frames, low, high, color=colour, lw=0, gid=name, label=name)
    widest = max(found.ends)
    low, high = found.ends[widest]
    outside = (found.truth < low) | (found.truth > high)
    ax.plot(frames, found.truth, color=UNDER, lw=1.4, label="truth", gid="truth")
    points: dict[str, Any] = {"ls": "", "marker": "o", "ms": 2.6, "color": ORANGE}
    ax.plot(frames[outside], found.truth[outside], label="truth outside", gid="outside", **points)
    share = 1 - outside.sum() / max(np.isfinite(found.truth).sum(), 1)
    ax.set_title(f"{100 * share:.0f} % within the {100 * widest:.0f} % interval", fontsize="small")
    ax.margins(x=0)
    return ax


def draw_intervals(
    data: PoseData,
    *,
    joint: str | None = None,
    coordinate: str | None = None,
    sequence: str | None = None,
    columns: int = 3,
    title: str | None = None,
    size: tuple[float, float] | None = None,
    style: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw :func:`intervals` of some sequences side by side, without a display.

    Parameters
    ----------
    data : PoseData
        Hypotheses and truth; positions relative to the root are drawn so.
    joint : str, optional
        Its name or number; the first that is no root by default.
    coordinate : str, optional
        ``x``, ``y``, ``z`` or a number; the first by default.
    sequence : str, optional
        Names of sequences with commas, or ``all``; the first by default. Without sequences all frames are drawn.
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
        For a joint, a coordinate or a sequence that the data don't have, and a size that is none.
    """
    k, d = _joint(data, joint), _coordinate(coordinate, data.shape[3])
    parts = _sequences(data, sequence)
    across = min(columns, len(parts))
    down = -(-len(parts) // across)
    hypotheses, truth, counted = _values(data, np.concatenate([*parts.values()]), k, d)
    rate, start = data.fps, 0
    best = (4.4, 3.1) if len(parts) == 1 else (2.3 * across, 1.75 * down + 0.6)
    with new_figure(size or best, style, title) as figure:
        panels = figure.subplots(down, across, squeeze=False, sharey=True)
        for ax, (name, rows) in zip(panels.flat, parts.items(), strict=False):
            these = slice(start, start := start + len(rows))
            x = np.where(counted[these], hypotheses[:, these], np.nan)
            frames = (data.order[rows] - data.order[rows[0]]) / (1 if rate is None else rate)
            intervals(x, truth[these], unit=data.unit or "none", at=frames, ax=ax)
            ax.set_title(f"{printable(name)}\n{ax.get_title()}".lstrip("\n"), fontsize="small")
        for ax in panels.flat[len(parts) :]:
            ax.set_axis_off()
        for ax in panels.flat[max(len(parts) - across, 0) : len(parts)]:  # the lowest of each column
            ax.set_xlabel("frame" if rate is None else "time [s]")
        figure.supylabel(_label(data, k, d), fontsize="medium")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize="small")
        figure.set_label(
            f"{_label(data, k, d)}: central intervals of N={data.shape[0]} hypotheses in grey, the truth in blue, in "
            f"orange where it lies outside the wider interval; {', '.join(filter(None, parts)) or 'all frames'}."
        )
    return figure


def _joint(data: PoseData, joint: str | None) -> int:
    if joint is None:
        return next((k for k in range(len(data.joints)) if k not in set(resting_joints(data.root))), 0)
    at = find_joint(joint, data.joints)
    if at is None:
        raise PoseDataError(f"joint: {joint!r} is not among the joints. {did_you_mean(joint, data.joints)}")
    return at


def _coordinate(coordinate: str | None, number: int) -> int:
    word = "0" if coordinate is None else str(coordinate).strip().lower()
    d = AXES.find(word) if word in [*AXES] else int(word) if word.isdecimal() else number
    if d >= number:
        raise PoseDataError(
            f"coordinate: {coordinate!r}; expected one of {', '.join([*AXES[:number]])}, or its number."
        )
    return d


def _sequences(data: PoseData, sequence: str | None) -> dict[str, Rows]:
    """The numbers of the poses of each sequence, in the order of time."""
    labels = data.labels.get("sequence")
    if labels is None:
        if sequence is not None:
            raise PoseDataError(f"sequence: {sequence!r}; expected none, since the truth has no label sequence.")
        return {"": np.arange(len(data.truth))}
    names = list(dict.fromkeys(labels.tolist()))
    wanted = names[:1] if sequence is None else names if sequence == "all" else [w.strip() for w in sequence.split(",")]
    for name in wanted:
        if name not in names:
            raise PoseDataError(f"sequence: {name!r} is not known. The first are {first_few(names)}.")
    return {name: np.flatnonzero(labels == name) for name in wanted}


def _values(data: PoseData, rows: Rows, k: int, d: int) -> tuple[FloatArray, FloatArray, BoolArray]:
    """One coordinate of some poses as they are evaluated: hypotheses (N, m), truth (m,), and whether it counts (m,)."""
    hypotheses, truth = data.hypotheses.select(rows).read(0, len(rows)), data.truth[rows]
    if data.root is not None:
        hypotheses, truth = hypotheses - origin(hypotheses, data.root), truth - origin(truth, data.root)
    counted = np.ones(len(rows), dtype=bool) if data.where is None else data.where[rows, k]
    return hypotheses[:, :, k, d], truth[:, k, d], counted


def _label(data: PoseData, k: int, d: int) -> str:
    words = data.joints[k] if data.shape[3] == 1 else f"{data.joints[k]}, {AXES[d]}"
    if data.root is not None:
        words += f" relative to {root_name(data.root, data.joints)}"
    return f"{words} [{data.unit}]" if data.unit else words
