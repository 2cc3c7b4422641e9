"""Supplement A.2: the mean that minimises minMPJPE."""

from __future__ import annotations

import numpy as np

from toy import figures
from toy import mean as nearest
from toy.experiments.result import Result
from toy.progress import progress_bar
from toy.table import check, table

__all__ = ["run"]

CASES = ((2, 1.0), (10, 0.5), (10, 1.0), (200, 1.0))
"""Hypotheses N and spreads σ/σ*."""


def run(rng: np.random.Generator, *, poses: int = 100_000) -> Result:
    """Compute E[z*], fit the sigmoid, and solve for the root of the derivative of minMPJPE.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of randomness of the check by simulation.
    poses : int
        Number of truths in it.

    Returns
    -------
    Result
        The fits with their errors, and the offset of the best mean for a skewed truth.
    """
    offset, span = np.linspace(-6, 6, 121), np.linspace(-2, 2, 81)
    z, fits, skewed = {}, {}, {}
    for N, s in progress_bar(CASES, "nearest hypotheses"):
        z[N, s] = nearest.expected_z(offset, sigma=s, truth_sigma=1.0, N=N)
        fits[N, s] = nearest.fit_sigmoid(offset, z[N, s])
        skewed[N, s] = nearest.best_offset_skewed(sigma=s, N=N)
    text = [
        table(
            "E[z*] at offsets to ∓6 σ*, and the sigmoid C (2 S(k a) − 1) fitted to it",
            ["", "C", "limit of E[z*]", "k σ*", "largest error", "rms error"],
            [
                [
                    f"N = {N}, σ = {s:g} σ*",
                    *(fits[N, s].scale, nearest.largest_of(N), fits[N, s].slope),
                    *(fits[N, s].largest_error, fits[N, s].rms_error),
                ]
                for N, s in CASES
            ],
        ),
        table(
            "(E[x] − μ)/σ* at the lowest squared minMPJPE",
            ["", "Gaussian truth", "exponential truth"],
            [[f"N = {N}, σ = {s:g} σ*", "0 (symmetry)", skewed[N, s]] for N, s in CASES],
        ),
    ]
    exact = float(nearest.expected_z(1.0, sigma=1.0, truth_sigma=1.0, N=10))
    drawn = nearest.simulated_z(1.0, sigma=1.0, truth_sigma=1.0, N=10, poses=poses, rng=rng)
    text.append(check("E[z*] at offset σ*, N = 10, σ = σ*", exact, drawn))
    derivative = {
        "Gaussian truth": span - nearest.expected_z(span, sigma=1.0, truth_sigma=1.0, N=10),
        "exponential truth": span - nearest.expected_z_skewed(span, sigma=1.0, N=10),
    }
    roots = {"Gaussian truth": 0.0, "exponential truth": skewed[10, 1.0]}
    return Result("\n".join(text), figures.mean(offset, z, fits, span, derivative, roots))
