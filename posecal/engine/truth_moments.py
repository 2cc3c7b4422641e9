"""Gaussians of true poses, and the constraints that these obey, from sums of moments of each cell.

The mean and covariance of the poses of all other sequences follow from sums of coordinates and of their products, so
that they are the same in one run, in batches and of shards that are merged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.engine.sums import Counts, Indices, split_by, sum_by

SMALLEST_SHARE = 1e-8
"""Where no deviation says so, a direction whose variance is below this share of the largest one's is degenerate."""

ROUNDING = 1e-14
"""Variances below this share of the largest mean square of a coordinate are lost in the rounding of sums."""


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


def gaussians_of_others(
    sums: FloatArray, counts: Counts, d: int, deviation: float = 0.0
) -> list[tuple[FloatArray, FloatArray]] | None:
    """Mean and covariance of the poses of all sequences but one, for each.

    Parameters
    ----------
    sums : array (S, d + d (d + 1) / 2)
        Of :func:`moments`.
    counts : array (S,)
        Poses.
    d : int
        Coordinates.
    deviation : float
        A direction with a standard deviation below this is degenerate; with 0, one with a variance below
        :data:`SMALLEST_SHARE` of the largest.

    Returns
    -------
    list of S pairs of arrays (d,) and (d, d), or None
        None where the poses without some sequence are not more than d, or don't vary in some direction.
    """
    total, found = sums.sum(axis=0), list[tuple[FloatArray, FloatArray]]()
    for own, number in zip(sums, counts, strict=True):
        n = int(counts.sum() - number)
        if n <= d:
            return None
        mean, covariance = _gaussian(total - own, n, d)
        variances = np.linalg.eigvalsh(covariance)
        if variances[0] < _smallest_variance(variances, total - own, n, d, deviation):
            return None
        found.append((mean, covariance))
    return found


def gaussian_log_density(
    sums: FloatArray, counts: Counts, sequence: Indices, d: int, deviation: float = 0.0
) -> FloatArray:
    """Sum over the poses of each cell the log density under the Gaussian of all other sequences.

    Parameters
    ----------
    sums, counts, d, deviation
        As for :func:`gaussians_of_others`, of C cells.
    sequence : array of int (C,)
        The sequence of each cell, 0 … S - 1.

    Returns
    -------
    array (C,)
        Nats; NaN where there are no such Gaussians.
    """
    number = int(sequence.max(initial=-1)) + 1
    of_sequence, poses = sum_by(sequence, number, sums), sum_by(sequence, number, counts)
    gaussians = gaussians_of_others(of_sequence, poses, d, deviation)
    if gaussians is None:
        return np.full(len(sums), np.nan)
    found = np.zeros(len(sums))
    for cells, (mean, covariance) in zip(split_by(sequence, number), gaussians, strict=True):
        constant = d * math.log(2 * math.pi) + np.linalg.slogdet(covariance)[1]
        white = np.linalg.inv(np.linalg.cholesky(covariance))
        for cell in cells:
            about_mean = _products(sums[cell], d) - np.outer(sums[cell, :d], mean)
            about_mean -= np.outer(mean, sums[cell, :d] - counts[cell] * mean)
            found[cell] = -(counts[cell] * constant + np.vdot(white, white @ about_mean)) / 2
    return found


def own_log_density(sums: FloatArray, n: int, d: int) -> float:
    """Mean log density of n poses under the Gaussian of themselves, from the sums of their moments, in nats."""
    covariance = _gaussian(sums, n, d)[1] * (n - 1) / n
    return float(-(d * math.log(2 * math.pi * math.e) + np.linalg.slogdet(covariance)[1]) / 2)


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
    total = sums.sum(axis=0)
    variances = np.linalg.eigvalsh(_gaussian(total, number, d)[1])
    smallest = _smallest_variance(variances, total, number, d, deviation)
    of_sequence, poses = (sum_by(sequence, int(sequence.max()) + 1, values) for values in (lengths, counts))
    within = (of_sequence[:, 1] - of_sequence[:, 0] ** 2 / np.maximum(poses, 1)[:, None]).sum(axis=0) / number
    is_rigid = within < (deviation**2 if deviation else smallest)
    return Constraints(int((variances < smallest).sum()), int(is_rigid.sum()), d, lengths.shape[2])


def _smallest_variance(variances: FloatArray, sums: FloatArray, n: int, d: int, deviation: float) -> float:
    """Give the variance below which a direction is degenerate, from ascending ones along principal directions."""
    if not deviation:
        return SMALLEST_SHARE * float(variances[-1])
    return max(deviation**2, ROUNDING * float(_products(sums, d).max()) / n)


def _gaussian(sums: FloatArray, n: int, d: int) -> tuple[FloatArray, FloatArray]:
    """Mean (d,) and covariance (d, d), with n - 1, of n poses from the sums of their moments."""
    mean = sums[:d] / n
    return mean, (_products(sums, d) - n * np.outer(mean, mean)) / (n - 1)


def _products(sums: FloatArray, d: int) -> FloatArray:
    """Sums of the products of all pairs of d coordinates, (d, d), from those of :func:`moments`."""
    products = np.empty((d, d))
    first, second = np.triu_indices(d)
    products[first, second] = products[second, first] = sums[d:]
    return products
