"""Numbers by horizon of forecasts of a Gaussian process, against the exact curves."""

from __future__ import annotations

import numpy as np

import posecal
from posecal.plot.horizon import horizon
from toy.experiments.result import Result
from toy.motion_world import Forecast, MotionWorld
from toy.style import GOLD, INK, OVER, UNDER, style
from toy.table import table

__all__ = ["FORECASTS", "run"]

FORECASTS = {
    "calibrated": Forecast(),
    "slow to spread": Forecast(correlation=0.96),
    "frames apart": Forecast(is_motion=False),
}
"""By name: the world's own law; that of a process that changes too slowly; the right law of each frame alone."""

HORIZONS = (1, 5, 10, 25)
"""Of the table."""


def run(rng: np.random.Generator, *, clips: int = 200, N: int = 50) -> Result:
    """Evaluate forecasts by horizon, and compare with the exact numbers.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of randomness.
    clips : int
        Number of clips, each a sequence of its own.
    N : int
        Hypotheses of each clip.

    Returns
    -------
    Result
        Coverage and energy scores, and a figure with the exact curves.
    """
    from matplotlib.figure import Figure

    world = MotionWorld()
    observed, truth = world.sample(clips, rng)
    rows: list[list[str | float]] = []
    energies: list[list[str | float]] = []
    with style():
        figure = Figure(figsize=(6.6, 2.9), layout="constrained")
        axes = figure.subplots(1, 2)
        for (name, forecast), colour in zip(FORECASTS.items(), (INK, OVER, UNDER), strict=True):
            hypotheses = world.predict(forecast, observed, N, rng).astype(np.float32)
            report = posecal.evaluate(
                *(hypotheses, truth),
                axes="NMTKD",
                unit="mm",
                root_joint="none",
                by="horizon",
                metrics=["coverage_90", "energy_score", "clip_energy_score"],
            )
            exact = world.coverage(forecast, 0.9, N), world.frame_energies(forecast)
            for ax, metric, curve in zip(axes, ("coverage_90", "energy_score"), exact, strict=True):
                horizon(report, metric, ax=ax, colour=colour, label=name)
                ax.plot(np.arange(world.frames) + 1, curve, color=GOLD, lw=1, ls=(0, (3, 2)), zorder=3)
            for t in HORIZONS:
                group = f"horizon={t}"
                coverage, energy = (report.value(metric, group) for metric in ("coverage_90", "energy_score"))
                rows.append([f"{name}, frame {t}", coverage, exact[0][t - 1], energy, exact[1][t - 1]])
            low, high = report.interval("clip_energy_score")
            energies.append([name, report["clip_energy_score"], low, high, world.clip_energy(forecast)])
        axes[0].plot([], [], color=GOLD, lw=1, ls=(0, (3, 2)), label="exact")
        axes[0].legend(loc="lower right", fontsize=7)
        axes[0].set(ylim=(0.3, 1), ylabel="share of truths in the 90 % ball")
        axes[1].set(ylim=(0, None), ylabel="energy score of the pose [mm]")
        axes[1].get_legend().remove()
    of_frames = table("by horizon", ["", "coverage", "exact", "energy score", "exact"], rows)
    of_clips = table("whole clips", ["", "energy score", "from", "to (95 %)", "exact"], energies)
    return Result(f"{of_frames}\n{of_clips}", figure)
