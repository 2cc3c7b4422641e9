"""Gaussians of true poses, and the constraints that these obey, from sums of moments of each cell.

The mean and covariance of the poses of all other sequences follow from sums of coordinates and of their products, so
that they are the same in one run, in batches and of shards that are merged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.engine.sums import Counts, Indices, split_by, sum_by

SMALLEST_SHARE = 1e-8
"""A direction whose variance is below this share of the largest one's is degenerate."""


@dataclass(frozen=True)
class Constraints:
    """Constraints that true poses obey, so that they have no density.

    Attributes
    ----------
    directions, bones : int
        How many directions poses don't vary in (fixed coordinates, and those that follow from others), and how many
        bones have one length within each sequence.
    of_directions, of_bones : int
        How many there are.
    """

    directions: int
    bones: int
    of_directions: int
    of_bones: int


def moments(x: FloatArray) -> FloatArray:
    """Coordinates (B, d) and the products of all pairs of them, (B, d + d (d + 1) / 2)."""
    first, second = np.triu_indices(x.shape[1])
    return np.concatenate([x, x[:, first] * x[:, second]], axis=1)


def gaussian_log_density(
    sums: FloatArray, counts: Counts, sequence: Indices, d: int, deviation: float = 0.0
) -> FloatArray:
    """Sum over the poses of each cell the log density under the Gaussian of all other sequences.

    Parameters
    ----------
    sums : array (C, d + d (d + 1) / 2)
        Of :func:`moments`.
    counts : array (C,)
        Poses.
    sequence : array of int (C,)
        The sequence of each cell, 0 … S - 1.
    d : int
        Coordinates.
    deviation : float
        A direction with a standard deviation below this is degenerate as well.

    Returns
    -------
    array (C,)
        Nats; NaN where the poses without a sequence are not more than d, or don't vary in some direction.
    """
    nothing, found = np.full(len(sums), np.nan), np.zeros(len(sums))
    x, xx = _centred(sums, counts, d)
    for cells in split_by(sequence, int(sequence.max(initial=-1)) + 1):
        n = counts.sum() - counts[cells].sum()
        if n <= d:
            return nothing
        mean = (x.sum(axis=0) - x[cells].sum(axis=0)) / n
        covariance = (xx.sum(axis=0) - xx[cells].sum(axis=0) - n * np.outer(mean, mean)) / (n - 1)
        if _is_degenerate(np.linalg.eigvalsh(covariance), deviation).any():
            return nothing
        own = _about(mean, x[cells], xx[cells], counts[cells])[1]
        constant = d * math.log(2 * math.pi) + np.linalg.slogdet(covariance)[1]
        found[cells] = -(counts[cells] * constant + np.einsum("cij,ji->c", own, np.linalg.inv(covariance))) / 2
    return found


def constraints(
    sums: FloatArray, lengths: FloatArray, counts: Counts, sequence: Indices, d: int, deviation: float = 0.0
) -> Constraints | None:
    """Find the constraints that true poses obey.

    Parameters
    ----------
    sums, counts, sequence, d, deviation
        As for :func:`gaussian_log_density`.
    lengths : array (C, 2, E)
        Sums of the lengths of E bones and of their squares.

    Returns
    -------
    Constraints or None
        None where there are no more poses than coordinates.
    """
    number = int(counts.sum())
    if number <= d:
        return None
    variances = np.linalg.eigvalsh(_centred(sums, counts, d)[1].sum(axis=0) / (number - 1))
    of_sequence, poses = (sum_by(sequence, int(sequence.max()) + 1, values) for values in (lengths, counts))
    within = (of_sequence[:, 1] - of_sequence[:, 0] ** 2 / np.maximum(poses, 1)[:, None]).sum(axis=0) / number
    is_rigid = within < max(deviation**2, SMALLEST_SHARE * variances[-1])
    return Constraints(int(_is_degenerate(variances, deviation).sum()), int(is_rigid.sum()), d, lengths.shape[2])


def _is_degenerate(variances: FloatArray, deviation: float) -> npt.NDArray[np.bool_]:
    """Find the degenerate ones among ascending variances along principal directions."""
    return np.asarray(variances < max(deviation**2, SMALLEST_SHARE * variances[-1]))


def _centred(sums: FloatArray, counts: Counts, d: int) -> tuple[FloatArray, FloatArray]:
    """Sums of deviations from the mean of all, (C, d), and of their products, (C, d, d)."""
    products = np.empty((len(sums), d, d))
    first, second = np.triu_indices(d)
    products[:, first, second] = products[:, second, first] = sums[:, d:]
    x = sums[:, :d]
    return _about(x.sum(axis=0) / max(int(counts.sum()), 1), x, products, counts)


def _about(point: FloatArray, x: FloatArray, xx: FloatArray, counts: Counts) -> tuple[FloatArray, FloatArray]:
    """Move sums of coordinates and of their products to deviations from a point."""
    number, cross = np.asarray(counts, dtype=np.float64)[:, None], x[:, :, None] * point
    products = xx - cross - cross.swapaxes(1, 2) + number[:, None] * np.outer(point, point)
    return np.asarray(x - number * point), np.asarray(products)
