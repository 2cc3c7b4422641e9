"""Figure 1d: minMPJPE and ECE over mean and spread, and their minima."""

from __future__ import annotations

import numpy as np

from toy import best_of, figures
from toy.experiments.result import Result
from toy.landscape import landscape
from toy.progress import progress_bar
from toy.table import check, table

__all__ = ["run"]


def run(rng: np.random.Generator, *, poses: int = 200_000, N: int = 10) -> Result:
    """Compute both surfaces and the valley.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of randomness of the check by simulation.
    poses : int
        Number of truths in it.
    N : int
        Hypotheses of minMPJPE.

    Returns
    -------
    Result
        The minima.
    """
    surface = landscape(
        np.linspace(-2, 2, 40),
        np.linspace(3, 7, 40),
        N=N,
        rows=lambda sigmas: progress_bar(sigmas, "rows of the landscape"),
    )
    mu_step, sigma_step = (float(axis[1] - axis[0]) for axis in (surface.mu, surface.sigma))
    text = [
        table(
            f"1D Gaussian, truth μ* = {surface.truth_mu:g}, σ* = {surface.truth_sigma:g}, 40 × 40 grid",
            ["", "μ", "σ", f"minMPJPE of {N}"],
            [
                ["lowest minMPJPE", *surface.lowest_min_mpjpe, float(surface.min_mpjpe.min())],
                ["lowest in the ECE's valley", *surface.lowest_in_valley, float(surface.valley_min_mpjpe.min())],
                ["step of the grid", mu_step, sigma_step, ""],
            ],
        ),
        f"valley of the ECE: σ from {surface.valley.min():.4f} to {surface.valley.max():.4f} (at μ = ±2), "
        f"where the ECE is {surface.valley_ece.max():.5f}",
    ]
    exact = float(best_of.expected_min_mpjpe(6.0, N=N, D=1, truth_sigma=4.0, offset=1.0))
    drawn = best_of.simulated_min_mpjpe(6.0, N=N, D=1, poses=poses, rng=rng, truth_sigma=4.0, offset=1.0)
    text.append(check("minMPJPE at μ = 1, σ = 6", exact, drawn))
    return Result("\n".join(text), figures.landscape(surface, N))
