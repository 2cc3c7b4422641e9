"""Closed-form calibration curves of samplers with a wrong spread, mean or dimension."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from toy import curves, figures
from toy.experiments.result import Result
from toy.table import table

__all__ = ["run"]

Floats = npt.NDArray[np.float64]

PANELS: dict[str, dict[str, tuple[float, float, int, int]]] = {
    "wrong spread σ/σ*": {f"{s:g}": (s, 0.0, 3, 3) for s in (4.0, 2.0, 1.25, 0.8, 0.5, 0.25)},
    "wrong mean ‖μ* − μ‖/σ*": {f"{o:g}": (1.0, o, 3, 3) for o in (0.5, 1.25, 2.0)},
    "wrong dimension: truth in model": {f"{t} in {d}": (1.0, 0.0, d, t) for t, d in ((1, 3), (2, 3))},
}
"""For each panel its title, and for each curve its label with spread, offset, D and D*."""


def run(rng: np.random.Generator, *, poses: int = 100_000) -> Result:
    """Compute the closed-form curves and their ECEs.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of randomness of the check by simulation.
    poses : int
        Number of truths, and of hypotheses, in it.

    Returns
    -------
    Result
        ECE and coverage of each curve.
    """
    rows: list[list[str | float]] = []
    panels, errors = [], []
    fine = np.linspace(0, 1, 401)
    for title, cases in PANELS.items():
        lines = {}
        for label, (spread, offset, D, truth_D) in cases.items():
            exact = curves.coverage(spread=spread, offset=offset, D=D, truth_D=truth_D)
            drawn = curves.simulated_coverage(spread=spread, offset=offset, D=D, truth_D=truth_D, draws=poses, rng=rng)
            errors.append(_largest_error(drawn, spread=spread, offset=offset, D=D, truth_D=truth_D, draws=poses))
            ece = curves.ece(spread=spread, offset=offset, D=D, truth_D=truth_D)
            rows.append([f"{title} {label}", ece, float(exact[10]), float(exact[18])])
            lines[label] = curves.coverage(fine, spread=spread, offset=offset, D=D, truth_D=truth_D)
        panels.append((title, lines))
    text = [
        table("closed-form calibration curves, D = 3 unless stated", ["", "ECE", "ω(0.5)", "ω(0.9)"], rows),
        f"check: {len(rows)} curves at 19 levels against {poses:,} draws: within {max(errors):.1f} standard errors",
    ]
    return Result("\n".join(text), figures.curves(panels, fine))


def _largest_error(drawn: Floats, *, spread: float, offset: float, D: int, truth_D: int, draws: int) -> float:
    """Compute the largest error of a simulated curve, in standard errors, at the inner levels."""
    q, step = curves.LEVELS[1:-1], 1e-5
    near = [
        curves.coverage(q + shift, spread=spread, offset=offset, D=D, truth_D=truth_D) for shift in (-step, 0, step)
    ]
    slope = (near[2] - near[0]) / (2 * step)
    error = np.sqrt((near[1] * (1 - near[1]) + slope**2 * q * (1 - q)) / draws)
    # A share close to 0 or 1 is a whole number of draws, so half a draw is added to its error.
    return float((np.abs(drawn[1:-1] - near[1]) / (error + 0.5 / draws)).max())
