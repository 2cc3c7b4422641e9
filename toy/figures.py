"""Figures of the Gaussian toy results.

Every function returns a :class:`matplotlib.figure.Figure` in the colours of :mod:`toy.style`, and computes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from toy.landscape import Landscape
from toy.mean import SigmoidFit
from toy.style import CONFIDENCE, DEPTH, FAINT, GOLD, INK, OVER, UNDER, style

__all__ = ["collapse", "curves", "landscape", "mean", "sigma_map"]

Floats = npt.NDArray[np.float64]


def _plot_bars(ax: Axes, values: tuple[float, float], label: str) -> None:
    bars = ax.bar(["optimum", "oracle"], values, color=[OVER, GOLD], edgecolor=INK, linewidth=0.6)
    ax.bar_label(bars, [f"{value:.3g}" for value in values], padding=1, fontsize=7)
    ax.tick_params("x", labelsize=7)
    ax.set_title(label)
    ax.margins(y=0.12)


def sigma_map(
    dimensions: Sequence[int],
    hypotheses: Sequence[int],
    sigma: Floats,
    *,
    truth_sigma: float,
    marker: tuple[int, int],
    min_mpjpe: tuple[float, float],
    nll: tuple[float, float],
) -> Figure:
    """Plot Figure 1b: the map of minMPJPE-optimal spreads, and the optimum against the oracle.

    Parameters
    ----------
    dimensions, hypotheses : sequence of int
        The D and N of the rows and columns, increasing.
    sigma : ndarray, shape (D, N)
        Optimal spreads.
    truth_sigma : float
        The true spread, in the same unit.
    marker : tuple of int
        D and N of a typical pose.
    min_mpjpe, nll : tuple of float
        Of the optimum and of the oracle at that point.

    Returns
    -------
    Figure
        A map and two bar plots.
    """
    with style():
        figure = Figure(figsize=(6.4, 2.7))
        map_ax, error_ax, nll_ax = figure.subplots(1, 3, width_ratios=[2.6, 1, 1])
        norm = TwoSlopeNorm(truth_sigma, 0, 1.5 * truth_sigma)
        image = map_ax.pcolormesh(
            hypotheses, dimensions, sigma, cmap=CONFIDENCE, norm=norm, shading="gouraud", rasterized=True
        )
        map_ax.contour(hypotheses, dimensions, sigma, levels=[truth_sigma], colors=INK, linewidths=1)
        map_ax.plot(marker[1], marker[0], "o", color=GOLD, markeredgecolor=INK, markersize=7)
        alignment = {"textcoords": "offset points", "ha": "right", "va": "center"}
        map_ax.annotate("a 3D pose", (marker[1], marker[0]), (-8, 0), **alignment)
        map_ax.text(0.3, 0.36, "overconfident", transform=map_ax.transAxes)
        map_ax.text(0.97, 0.06, "underconfident", transform=map_ax.transAxes, ha="right")
        map_ax.set(xscale="log", yscale="log")
        for axis, name, ticks in (
            (map_ax.xaxis, "hypotheses N", [1, 5, 20, 100, 500]),
            (map_ax.yaxis, "dimensions D", [1, 3, 10, 30, 100]),
        ):
            axis.set_label_text(name)
            axis.set_ticks(ticks, [str(tick) for tick in ticks])
        map_ax.minorticks_off()
        map_ax.set_title("σ that minimises minMPJPE")
        colours = figure.colorbar(image, ax=map_ax, aspect=25, pad=0.02)
        colours.set_ticks([0, truth_sigma / 2, truth_sigma, 1.5 * truth_sigma])
        colours.ax.set_yticklabels(["0", f"{truth_sigma / 2:g}", f"σ* = {truth_sigma:g}", f"{1.5 * truth_sigma:g}"])
        colours.ax.axhline(truth_sigma, color=INK, linewidth=1)
        _plot_bars(error_ax, min_mpjpe, "minMPJPE")
        _plot_bars(nll_ax, nll, "NLL (nats)")
        error_ax.set_xlabel(f"D = {marker[0]}, N = {marker[1]}")
        nll_ax.set_xlabel(f"D = {marker[0]}, N = {marker[1]}")
    return figure


def landscape(surface: Landscape, N: int) -> Figure:
    """Plot Figure 1d: minMPJPE and ECE over mean and spread, and minMPJPE along the valley of the ECE.

    Parameters
    ----------
    surface : Landscape
        Both surfaces and the valley.
    N : int
        Number of hypotheses of minMPJPE.

    Returns
    -------
    Figure
        Two maps and a curve.
    """
    with style():
        figure = Figure(figsize=(6.6, 2.5))
        axes = figure.subplots(1, 3, width_ratios=[1, 1, 0.8])
        for ax, values, title in (
            (axes[0], surface.min_mpjpe, f"minMPJPE of {N}"),
            (axes[1], surface.ece, "ECE"),
        ):
            filled = ax.contourf(surface.mu, surface.sigma, values, levels=14, cmap=DEPTH)
            ax.plot(surface.mu, surface.valley, color=OVER, label="least ECE for each μ")
            ax.plot(*surface.lowest_min_mpjpe, "s", color="white", markeredgecolor=INK, label="lowest minMPJPE")
            ax.plot(surface.truth_mu, surface.truth_sigma, "*", color=GOLD, markeredgecolor=INK, markersize=11,
                    label="truth")  # fmt: skip
            ax.set(xlabel="mean μ", ylabel="spread σ", title=title)
            bar = figure.colorbar(filled, ax=ax, aspect=25, pad=0.02)
            bar.ax.locator_params(nbins=5)
        axes[0].legend(loc="upper center", handlelength=1.2, labelcolor="white")
        axes[2].plot(surface.mu, surface.valley_min_mpjpe, color=OVER)
        axes[2].plot(
            surface.truth_mu, surface.valley_min_mpjpe.min(), "*", color=GOLD, markeredgecolor=INK, markersize=11
        )
        axes[2].set(xlabel="mean μ", ylabel="minMPJPE", title="along the valley")
    return figure


def collapse(
    spread: Floats, mpjpe: Floats, squared: Floats, *, point: Floats, skewed_mpjpe: Floats, skewed_squared: Floats
) -> Figure:
    """Plot supplement A.1: the mean MPJPE over the spread, and the point of collapse for a skewed truth.

    Parameters
    ----------
    spread : ndarray, shape (A,)
        σ/σ*.
    mpjpe, squared : ndarray, shape (A,)
        Mean MPJPE and mean squared error, as multiples of the collapsed model's.
    point : ndarray, shape (B,)
        Points of the collapsed model, in units of the exponential truth's mean.
    skewed_mpjpe, skewed_squared : ndarray, shape (B,)
        Their expected distance and squared distance.

    Returns
    -------
    Figure
        Two plots.
    """
    with style():
        figure = Figure(figsize=(5.2, 2.3))
        left, right = figure.subplots(1, 2)
        left.plot(spread, mpjpe, color=OVER, label="mean MPJPE")
        left.plot(spread, squared, color=UNDER, linestyle="--", label="mean squared error")
        left.plot(0, 1, "o", color=OVER, clip_on=False, zorder=3)
        left.annotate("lowest", (0, 1), (4, -8), textcoords="offset points")
        left.axvline(1, ymax=0.6, color=GOLD, label="oracle")  # up to the legend
        left.set_ylim(0.2, 5.2)
        left.set(xlabel="spread σ/σ*", ylabel="error / collapsed model's", title="Gaussian truth, any D")
        left.legend(loc="upper left")
        right.fill_between(point, np.exp(-point), color="#E8E8E8", linewidth=0, label="the truth's density")
        right.plot(point, skewed_mpjpe, color=OVER, label="mean MPJPE")
        right.plot(point, skewed_squared, color=UNDER, linestyle="--", label="mean squared error")
        minima = ((skewed_mpjpe, OVER, "the median", -11), (skewed_squared, UNDER, "the mean", 7))
        for values, colour, label, offset in minima:
            lowest = values.argmin()
            right.plot(point[lowest], values[lowest], "o", color=colour)
            right.annotate(label, (point[lowest], values[lowest]), (0, offset), textcoords="offset points", ha="center")
        right.set(xlabel="where the model collapses to", ylabel="expected error", title="exponential truth")
        right.set(xlim=(0, 3), ylim=(0, 4.2))
        right.legend(loc="upper left")
    return figure


def mean(
    offset: Floats,
    z: Mapping[tuple[int, float], Floats],
    fits: Mapping[tuple[int, float], SigmoidFit],
    span: Floats,
    derivative: Mapping[str, Floats],
    roots: Mapping[str, float],
) -> Figure:
    """Plot supplement A.2: E[z*] with its sigmoids, their errors, and the roots of the derivative.

    Parameters
    ----------
    offset : ndarray, shape (A,)
        E[x] − μ, in units of σ*.
    z : mapping
        E[z*], (A,), for each (N, σ/σ*).
    fits : mapping
        The sigmoid fitted to each.
    span : ndarray, shape (B,)
        Offsets of the last plot, in units of σ*.
    derivative : mapping
        E[x] − μ − σ E[z*] at them, (B,), for each truth by its name.
    roots : mapping
        Its roots.

    Returns
    -------
    Figure
        Three plots.
    """
    colours = [FAINT, UNDER, OVER, GOLD, INK]
    with style():
        figure = Figure(figsize=(6.9, 2.4))
        left, middle, right = figure.subplots(1, 3)
        for colour, (key, values) in zip(colours, z.items(), strict=False):
            left.plot(offset, values, color=colour, label=f"N = {key[0]}, σ = {key[1]:g} σ*")
            left.plot(offset, fits[key](offset), color=INK, linestyle=":", linewidth=0.9)
            middle.plot(offset, fits[key](offset) - values, color=colour)
        left.plot([], [], color=INK, linestyle=":", linewidth=0.9, label="scaled sigmoid")
        left.set(xlabel="(E[x] − μ) / σ*", ylabel="E[z*]", title="the nearest hypothesis")
        left.legend(loc="upper left", fontsize=6, handlelength=1.2)
        left.margins(y=0.4)
        middle.axhline(0, color=INK, linewidth=0.6)
        middle.set(xlabel="(E[x] − μ) / σ*", ylabel="sigmoid − E[z*]", title="error of the sigmoid")
        right.axhline(0, color=INK, linewidth=0.6)
        for colour, (name, values) in zip((UNDER, OVER), derivative.items(), strict=False):
            right.plot(span, values, color=colour, label=name)
            right.plot(roots[name], 0, "o", color=colour, markeredgecolor=INK)
        right.set(xlabel="(E[x] − μ) / σ*", ylabel="a − σ E[z*], in σ*", title="slope of squared minMPJPE")
        right.legend(loc="upper left")
    return figure


def curves(panels: Sequence[tuple[str, Mapping[str, Floats]]], levels: Floats) -> Figure:
    """Plot closed-form calibration curves.

    Parameters
    ----------
    panels : sequence of (title, curves)
        For each kind of error, its name and its curves (Q,) by their labels.
    levels : ndarray, shape (Q,)
        The levels, increasing.

    Returns
    -------
    Figure
        One reliability diagram for each panel.
    """
    with style():
        figure = Figure(figsize=(2.25 * len(panels), 2.5))
        for ax, (title, lines) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
            ax.fill_between([0, 1], [0, 1], 0, color=OVER, alpha=0.08, linewidth=0)
            ax.fill_between([0, 1], [0, 1], 1, color=UNDER, alpha=0.08, linewidth=0)
            ax.plot([0, 1], [0, 1], color=INK, linewidth=0.8)
            for label, line in lines.items():
                ax.plot(levels, line, color=UNDER if line.mean() > levels.mean() else OVER)
                crossing = np.searchsorted(levels + line, 1.0)  # the intersection with the other diagonal
                ax.text(
                    levels[crossing], line[crossing], label, fontsize=6.5, ha="center", va="center",
                    bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"},
                )  # fmt: skip
            if all(line.mean() < levels.mean() for line in lines.values()):
                ax.text(0.03, 0.94, "underconfident", color=UNDER, va="center")
            if all(line.mean() > levels.mean() for line in lines.values()):
                ax.text(0.97, 0.06, "overconfident", color=OVER, va="center", ha="right")
            ax.set(xlabel="quantile q", ylabel="share of truths ω(q)", title=title, xlim=(0, 1), ylim=(0, 1))
            ax.set_aspect("equal")
            ax.set_xticks([0, 0.5, 1])
            ax.set_yticks([0, 0.5, 1])
    return figure
