"""Bias of the paper's and the reference's calibration curves at finite N.

For a perfect sampler of a three-dimensional isotropic Gaussian, the probability that the truth is inside the q-ball of
its hypotheses, by simulation of the hypotheses and exact integration over the truth: given the hypotheses, the truth's
distance from their centre has a noncentral χ distribution with three degrees of freedom, in closed form. The result is
the table ``posecal/calibration/finite_n.json``.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
from scipy.special import erf

from posecal.calibration import LEVELS
from posecal.data.arrays import FloatArray
from toy.progress import progress_bar

SIZES = (*range(2, 21), 22, 25, 28, 32, 36, 40, 45, 50, 56, 64, 80, 100, 128, 160, 200, 256, 400, 700, 1000)
"""The N of the table."""

RANKS = 40
"""Above this N the paper's distribution of ranks is stored at this many shares instead of at every rank."""


def probability_within(radius: FloatArray, offset: FloatArray) -> FloatArray:
    """Compute the probability that a standard Gaussian point in 3D is within a radius of an offset centre.

    Parameters
    ----------
    radius : array (..., T)
        Radii, in standard deviations.
    offset : array (...)
        Distance of the centre from the mean, above 0.

    Returns
    -------
    array (..., T)
        Probabilities.
    """
    a = offset[..., None]
    near, far = (radius - a) / np.sqrt(2), (radius + a) / np.sqrt(2)
    tails = (np.exp(-(near**2)) - np.exp(-(far**2))) / (a * np.sqrt(2 * np.pi))
    return np.asarray((erf(near) + erf(far)) / 2 - tails)


def bias(n_hypotheses: int, draws: int, seed: int = 0) -> dict[str, FloatArray]:
    """Compute the bias of the paper's distribution of ranks and of the reference's curve at its levels.

    Parameters
    ----------
    n_hypotheses : int
        N.
    draws : int
        Number of sets of hypotheses.
    seed : int
        Random seed.

    Returns
    -------
    dict
        ``paper``: G(r) - (r+1)/(N+1) at equally spaced shares (r+1)/(N+1), where G(r) is the probability that at most
        r hypotheses are nearer than the truth; ``reference``: ω(q) - q at the 21 levels.
    """
    random = np.random.default_rng([seed, n_hypotheses])
    ranks = (np.arange(n_hypotheses) + 1) / (n_hypotheses + 1)
    totals = {"paper": np.zeros(n_hypotheses), "reference": np.zeros(LEVELS.size)}
    done = 0
    while done < draws:
        batch = min(draws - done, max(1, 2_000_000 // n_hypotheses))
        points = random.standard_normal((batch, 3, n_hypotheses))
        ordered = np.sort(points, axis=-1)
        upper, lower = ordered[..., n_hypotheses // 2], ordered[..., (n_hypotheses - 1) // 2]
        for name, centre in (("paper", (upper + lower) / 2), ("reference", lower)):
            distances = np.sort(np.linalg.norm(points - centre[..., None], axis=1), axis=-1)
            if name == "reference":
                distances = np.quantile(distances, LEVELS, axis=-1).T
            totals[name] += probability_within(distances, np.linalg.norm(centre, axis=1)).sum(axis=0)
        done += batch
    paper = totals["paper"] / draws - ranks
    if n_hypotheses > RANKS:
        shares = np.arange(1, RANKS + 1) / (RANKS + 1)
        paper = np.interp(shares, ranks, paper)
    return {"paper": paper, "reference": totals["reference"] / draws - LEVELS}


def write_table(path: Path, draws: int = 400_000, seed: int = 0) -> None:
    """Write the table of biases for all :data:`SIZES`, atomically.

    Parameters
    ----------
    path : Path
        Output file.
    draws : int
        Number of sets of hypotheses for each N.
    seed : int
        Random seed.
    """
    table: dict[str, dict[str, list[float]]] = {"paper": {}, "reference": {}}
    for n in progress_bar(SIZES, "ranks"):
        for name, row in bias(n, draws, seed).items():
            table[name][str(n)] = [round(float(value), 6) for value in row]
    note = f"bias of a perfect sampler, isotropic Gaussian in 3D; python -m toy rank-law, {draws} draws, seed {seed}"
    lines = [f'"about": {json.dumps(note)}']
    for name, rows in table.items():
        body = ",\n".join(f'  "{n}": {json.dumps(row)}' for n, row in rows.items())
        lines.append(f'"{name}": {{\n{body}\n}}')
    part = path.with_name(path.name + ".part")
    part.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    os.replace(part, path)


if __name__ == "__main__":
    write_table(Path(__file__).parents[1] / "posecal" / "calibration" / "finite_n.json")
