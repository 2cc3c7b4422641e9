"""Supplement A.1: the mean MPJPE over the spread, and its collapse to a point."""

from __future__ import annotations

import math

import numpy as np

from toy import best_of, curves, figures
from toy.collapse import exponential_mpjpe, exponential_squared_error, mean_mpjpe, mean_squared_error
from toy.experiments.result import Result
from toy.table import check, table

__all__ = ["run"]


def run(rng: np.random.Generator, *, poses: int = 200_000) -> Result:
    """Compute the mean MPJPE over the spread, and the point of collapse.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of randomness of the check by simulation.
    poses : int
        Number of truths in it.

    Returns
    -------
    Result
        Errors, and the point of collapse for a skewed truth.
    """
    spread, point = np.linspace(0, 2, 101), np.linspace(0, 3, 601)
    rows: list[list[str | float]] = []
    for D in (1, 3, 45):
        at = [float(error) for error in mean_mpjpe([0, 0.5, 1, 2], D=D)]
        rows.append([f"D = {D}", *at, at[2] / at[0]])
    mpjpe, squared = exponential_mpjpe(point), exponential_squared_error(point)
    text = [
        table(
            "expected mean MPJPE of hypotheses N(μ*, σ² I), truth N(μ*, I)",
            ["", "σ = 0", "σ = 0.5", "σ = 1 (oracle)", "σ = 2", "oracle / collapsed"],
            rows,
        ),
        table(
            "where the collapsed model is, truth exponential with mean 1",
            ["", "at", "which is the truth's", "expected error"],
            [
                ["mean MPJPE", float(point[mpjpe.argmin()]), f"median, {math.log(2):.4f}", float(mpjpe.min())],
                ["mean squared error", float(point[squared.argmin()]), "mean, 1", float(squared.min())],
            ],
        ),
        f"ECE of a collapsed model: {curves.ece(spread=0.0):.4f} at 21 levels, 0.5 in the limit of many",
    ]
    exact = float(mean_mpjpe(0.5, D=45))
    drawn = best_of.simulated_min_mpjpe(0.5, N=1, D=45, poses=poses, rng=rng, truth_sigma=1.0)
    text.append(check("mean MPJPE at D = 45, σ = 0.5", exact, drawn))
    over_spread = mean_mpjpe(spread, D=3), mean_squared_error(spread, D=3)
    figure = figures.collapse(
        spread,
        *(errors / errors[0] for errors in over_spread),
        point=point,
        skewed_mpjpe=mpjpe,
        skewed_squared=squared,
    )
    return Result("\n".join(text), figure)
