"""Figure 1b: the spread that minimises minMPJPE, over dimensions and hypotheses."""

from __future__ import annotations

import numpy as np

from toy import best_of, figures
from toy.experiments.result import Result
from toy.progress import progress_bar
from toy.table import check, table

__all__ = ["run"]

TRUTH_SIGMA = 0.5
DIMENSIONS, HYPOTHESES = 45, 200
"""A typical pose: 15 joints of 3 coordinates, and the paper's number of hypotheses."""


def _axis(last: int, grid: int) -> list[int]:
    """Return distinct log-spaced integers from 1."""
    return sorted({round(value) for value in np.geomspace(1, last, grid).tolist()})


def run(rng: np.random.Generator, *, poses: int = 100_000, grid: int = 20) -> Result:
    """Compute the map and the bars.

    Parameters
    ----------
    rng : numpy.random.Generator
        The source of randomness of the check by simulation.
    poses : int
        Number of truths in it.
    grid : int
        Points per axis, log-spaced from 1 to 100 dimensions and 1 to 500 hypotheses, and rounded.

    Returns
    -------
    Result
        The map as a table, and the optimum against the oracle for a typical pose.
    """
    rows, columns = _axis(100, grid), _axis(500, grid)
    cells = [(D, N) for D in rows for N in columns]
    spreads = [
        best_of.optimal_sigma(N=N, D=D, truth_sigma=TRUTH_SIGMA) for D, N in progress_bar(cells, "optimal spreads")
    ]
    sigma = np.array(spreads).reshape(len(rows), len(columns))

    best = best_of.optimal_sigma(N=HYPOTHESES, D=DIMENSIONS, truth_sigma=TRUTH_SIGMA)

    def error(spread: float, nodes: int) -> float:
        expected = best_of.expected_min_mpjpe(spread, N=HYPOTHESES, D=DIMENSIONS, truth_sigma=TRUTH_SIGMA, nodes=nodes)
        return float(expected)

    models = {}
    for name, spread in (("optimum", best), ("oracle", TRUTH_SIGMA)):
        nll = best_of.nll(spread, D=DIMENSIONS, truth_sigma=TRUTH_SIGMA)
        models[name] = (spread, error(spread, 48), error(spread, 128), nll)
    selected = slice(None, None, max(1, len(columns) // 7))
    text = [
        table(
            f"minMPJPE-optimal σ (rows: dimensions D; columns: hypotheses N); the truth's is {TRUTH_SIGMA}",
            ["D", *map(str, columns[selected])],
            [[str(D), *(f"{s:.4f}" for s in row[selected])] for D, row in zip(rows, sigma, strict=True)],
        ),
        table(
            f"D = {DIMENSIONS}, N = {HYPOTHESES}",
            ["", "σ", "minMPJPE", "128 nodes", "NLL (nats)", "per dimension"],
            [
                [name, f"{spread:.4f}", f"{coarse:.6f}", f"{fine:.6f}", f"{nll:.2f}", f"{nll / DIMENSIONS:.4f}"]
                for name, (spread, coarse, fine, nll) in models.items()
            ],
        ),
    ]
    for name, (spread, coarse, *_) in models.items():
        drawn = best_of.simulated_min_mpjpe(
            spread, N=HYPOTHESES, D=DIMENSIONS, poses=poses, rng=rng, truth_sigma=TRUTH_SIGMA
        )
        text.append(check(f"minMPJPE of the {name}", coarse, drawn))
    figure = figures.sigma_map(
        rows,
        columns,
        sigma,
        truth_sigma=TRUTH_SIGMA,
        marker=(DIMENSIONS, HYPOTHESES),
        min_mpjpe=(models["optimum"][1], models["oracle"][1]),
        nll=(models["optimum"][3], models["oracle"][3]),
    )
    return Result("\n".join(text), figure)
