"""Which spread minimises minMPJPE, over dimensions and hypotheses? Figure 1b."""

from __future__ import annotations

import numpy as np

from toy import best_of, pictures
from toy.experiments.result import Result
from toy.progress import bar
from toy.table import check, table

__all__ = ["run"]

TRUTH_SIGMA = 0.5
DIMENSIONS, HYPOTHESES = 45, 200
"""The point that is like a pose: 15 joints of 3 coordinates, and the paper's number of hypotheses."""


def _axis(last: int, grid: int) -> list[int]:
    """Log-spaced from 1, rounded, each once."""
    return sorted({round(value) for value in np.geomspace(1, last, grid).tolist()})


def run(rng: np.random.Generator, *, poses: int = 100_000, grid: int = 20) -> Result:
    """Compute the map and the bars.

    Parameters
    ----------
    rng : numpy.random.Generator
        For the simulated check.
    poses : int
        Truths in it.
    grid : int
        Points per axis, log-spaced from 1 to 100 dimensions and 1 to 500 hypotheses, and rounded.

    Returns
    -------
    Result
        The map as a table, and the optimum against the oracle at the point that is like a pose.
    """
    rows, columns = _axis(100, grid), _axis(500, grid)
    cells = [(D, N) for D in rows for N in columns]
    spreads = [best_of.optimal_sigma(N=N, D=D, truth_sigma=TRUTH_SIGMA) for D, N in bar(cells, "optimal spreads")]
    sigma = np.array(spreads).reshape(len(rows), len(columns))

    best = best_of.optimal_sigma(N=HYPOTHESES, D=DIMENSIONS, truth_sigma=TRUTH_SIGMA)

    def error(spread: float, nodes: int) -> float:
        expected = best_of.expected_min_mpjpe(spread, N=HYPOTHESES, D=DIMENSIONS, truth_sigma=TRUTH_SIGMA, nodes=nodes)
        return float(expected)

    found = {}
    for name, spread in (("optimum", best), ("oracle", TRUTH_SIGMA)):
        nll = best_of.nll(spread, D=DIMENSIONS, truth_sigma=TRUTH_SIGMA)
        found[name] = (spread, error(spread, 48), error(spread, 128), nll)
    shown = slice(None, None, max(1, len(columns) // 7))
    text = [
        table(
            f"minMPJPE-optimal σ (rows: dimensions D; columns: hypotheses N); the truth's is {TRUTH_SIGMA}",
            ["D", *map(str, columns[shown])],
            [[str(D), *(f"{s:.4f}" for s in row[shown])] for D, row in zip(rows, sigma, strict=True)],
        ),
        table(
            f"D = {DIMENSIONS}, N = {HYPOTHESES}",
            ["", "σ", "minMPJPE", "128 nodes", "NLL (nats)", "per dimension"],
            [
                [name, f"{spread:.4f}", f"{coarse:.6f}", f"{fine:.6f}", f"{nll:.2f}", f"{nll / DIMENSIONS:.4f}"]
                for name, (spread, coarse, fine, nll) in found.items()
            ],
        ),
    ]
    for name, (spread, coarse, *_) in found.items():
        drawn = best_of.simulated_min_mpjpe(
            spread, N=HYPOTHESES, D=DIMENSIONS, poses=poses, rng=rng, truth_sigma=TRUTH_SIGMA
        )
        text.append(check(f"minMPJPE of the {name}", coarse, drawn))
    figure = pictures.sigma_map(
        rows,
        columns,
        sigma,
        truth_sigma=TRUTH_SIGMA,
        marked=(DIMENSIONS, HYPOTHESES),
        min_mpjpe=(found["optimum"][1], found["oracle"][1]),
        nll=(found["optimum"][3], found["oracle"][3]),
    )
    return Result("\n".join(text), figure)
