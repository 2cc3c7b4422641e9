"""Figures of people and pendulums.

Every function returns a :class:`matplotlib.figure.Figure` in the colours of :mod:`toy.style`, and computes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from toy.style import FAINT, GOLD, INK, OVER, UNDER, style

__all__ = ["pendulum", "people"]

Floats = npt.NDArray[np.floating]


def people(
    poses: Sequence[tuple[str, Floats, Floats]], bones: Sequence[tuple[int, int]], joint: int, joint_name: str
) -> Figure:
    """Plot hypotheses (grey) and truth (blue) from the front and from the side, one joint as pink points.

    Parameters
    ----------
    poses : sequence of (title, hypotheses, truth)
        Hypotheses (N, K, 3) and truth (K, 3), mm, camera frame.
    bones : sequence of (int, int)
        Pairs of joint indices; -1 is the origin.
    joint : int
        The joint whose hypotheses are shown as points.
    joint_name : str
        The joint's name.

    Returns
    -------
    Figure
        Two views of each pose.
    """
    with style():
        figure = Figure(figsize=(1.45 * 2 * len(poses), 2.9))
        axes = figure.subplots(1, 2 * len(poses), sharey=True)
        for index, (title, hypotheses, truth) in enumerate(poses):
            for ax, axis, view in ((axes[2 * index], 0, "front"), (axes[2 * index + 1], 2, "side")):
                for pose, colour, width, alpha in (*((h, FAINT, 0.5, 0.6) for h in hypotheses[:25]),
                                                   (truth, UNDER, 1.6, 1.0)):  # fmt: skip
                    with_origin = np.concatenate([pose, np.zeros((1, 3))])  # index -1 is the origin
                    for parent, child in bones:
                        ends = with_origin[[parent, child]]
                        ax.plot(ends[:, axis], -ends[:, 1], color=colour, linewidth=width, alpha=alpha,
                                solid_capstyle="round")  # fmt: skip
                cloud = hypotheses[:, joint]
                ax.plot(cloud[:, axis], -cloud[:, 1], ".", color=OVER, markersize=2, alpha=0.6, label=joint_name)
                ax.set_aspect("equal")
                ax.set(xlim=(-620, 620), ylim=(-1080, 860))
                ax.set_title(f"{title}\n{view}" if axis == 0 else f"\n{view}", loc="left")
                ax.set_xlabel("x (mm)" if axis == 0 else "depth (mm)")
        axes[0].set_ylabel("height above the hip (mm)")
        axes[0].legend(loc="lower left", handletextpad=0, borderpad=0, markerscale=2)
    return figure


def pendulum(time: Floats, positions: Floats, observed: Floats, energy: Floats) -> Figure:
    """Plot some pendulums with their observations, and the drift of all energies.

    Parameters
    ----------
    time : ndarray, shape (T,)
        s.
    positions, observed : ndarray, shape (P, T, n + 1, 2) and (P, T, n, 2)
        m.
    energy : ndarray, shape (P, T)
        J.

    Returns
    -------
    Figure
        Three pendulums and a curve for each energy.
    """
    colours = [GOLD, OVER, UNDER]
    shown = np.linspace(0, len(time) - 1, 4).astype(int)
    with style():
        figure = Figure(figsize=(7.0, 2.3))
        axes = figure.subplots(1, 4, width_ratios=[1, 1, 1, 1.15])
        for ax, path, observations, number in zip(axes, positions, observed, range(1, 4), strict=False):
            for t, fade in zip(shown, np.linspace(0.15, 1, len(shown)), strict=True):
                ax.plot(*path[t].T, "-o", color=INK, alpha=fade, linewidth=1, markersize=2.5)
            for node in range(observations.shape[1]):
                ax.plot(*observations[:, node].T, ".", color=colours[node % 3], markersize=3, label=f"c$_{node + 1}$")
            reach = 1.05 * (path.shape[1] - 1)
            ax.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="x (m)", title=f"pendulum {number}")
            ax.set_aspect("equal")
            ax.set_xticks([-2, 0, 2])
        axes[0].set_ylabel("y (m)")
        axes[0].legend(loc="upper left", handletextpad=0, borderpad=0.1, labelspacing=0.2)
        drift = np.abs(energy / energy[:, :1] - 1)[:, 1:]
        axes[3].semilogy(time[1:], np.maximum(drift, 1e-17).T, color=FAINT, linewidth=0.5)
        axes[3].semilogy(time[1:], drift.max(axis=0), color=OVER, label="largest")
        axes[3].set(xlabel="time (s)", ylabel="|E/E(0) − 1|", title=f"energy drift of {len(energy)}")
        axes[3].legend(loc="lower right")
    return figure
