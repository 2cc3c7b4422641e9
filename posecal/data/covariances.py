"""Standard deviations and covariances of many poses: their factors, and log densities of normal deviations."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Literal

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.stored_poses import Rows

Kind = Literal["sigma", "covariance", "full"]
"""Standard deviations of coordinates, covariances of joints, or one of the whole pose."""

_SYMMETRY = 1e-3
"""How far from symmetric a covariance may be, as a correlation."""

_SMALLEST = 1e-12
"""A covariance is singular where a coordinate keeps no more than this share of its variance once those before it are
known: 1 less the squared multiple correlation, which no unit changes."""


def fixed_joints(spread: FloatArray, kind: Kind, d: int) -> BoolArray:
    """Find the joints that don't move, (C, m, K): their deviations or variances are all 0, or NaN."""
    if kind == "sigma":
        still = (spread == 0) | np.isnan(spread)
        return still if spread.ndim == 3 else np.asarray(still.all(axis=-1))
    variances = np.diagonal(spread, axis1=-2, axis2=-1)
    still = (variances == 0) | np.isnan(variances)
    return np.asarray(still.reshape(*spread.shape[:2], -1, d).all(axis=-1))


def joints_of(spread: FloatArray, kind: Kind, joints: Rows, d: int) -> FloatArray:
    """Keep the deviations or covariances of some joints."""
    if kind != "full":
        return spread[:, :, joints]
    places = (joints[:, None] * d + np.arange(d)).ravel()
    return spread[:, :, places[:, None], places]


def full_covariance(spread: FloatArray, kind: Kind, d: int) -> FloatArray:
    """Write deviations or covariances as those of whole poses, (C, m, KD, KD); 0 for joints that don't move."""
    if kind == "full":
        return np.where(np.isnan(spread), 0, spread)
    c, m, k = spread.shape[:3]
    of_joints = spread
    if kind == "sigma":
        with np.errstate(over="ignore", invalid="ignore"):  # of frames that are refused
            variances = np.broadcast_to((spread if spread.ndim == 4 else spread[..., None]) ** 2, (c, m, k, d))
            of_joints = variances[..., None] * np.eye(d)
    full = np.zeros((c, m, k, d, k, d))
    joints = np.arange(k)
    full[:, :, joints, :, joints] = np.where(np.isnan(of_joints), 0, of_joints).transpose(2, 0, 1, 3, 4)
    return full.reshape(c, m, k * d, k * d)


def decoupled(spread: FloatArray, kind: Kind, joints: BoolArray, d: int) -> FloatArray:
    """Give joints (m, K) deviations or variances of 1 and no covariance with others."""
    if kind == "sigma":
        return np.where(joints if spread.ndim == 3 else joints[..., None], 1, spread)
    if kind == "covariance":
        return np.where(joints[..., None, None], np.eye(d), spread)
    places = np.repeat(joints, d, axis=-1)
    return np.where(places[..., None] | places[..., None, :], np.eye(spread.shape[-1]), spread)


def factored(spread: FloatArray, kind: Kind, d: int) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Factor covariances.

    Returns
    -------
    factor : array
        Deviations (C, m, K, D), or lower triangles (C, m, K, D, D) or (C, m, KD, KD); 0 for joints that don't move.
    fixed : bool array (C, m, K)
        Those joints.
    bad : bool array (m,)
        Frames in which some other joint has none.
    """
    fixed = fixed_joints(spread, kind, d)
    factor: FloatArray
    if kind == "sigma":
        factor = np.where(fixed[..., None], 0, spread if spread.ndim == 4 else np.repeat(spread[..., None], d, axis=-1))
        wrong = ~((factor > 0) & (factor < np.inf)).all(axis=-1) & ~fixed
        return factor, fixed, np.asarray(wrong.any(axis=(0, 2)))
    still = fixed[..., None] if kind == "covariance" else np.repeat(fixed, d, axis=-1)
    size = spread.shape[-1]
    on_axis = np.broadcast_to(still, spread.shape[:-1])
    matrix = np.where(on_axis[..., None] | on_axis[..., None, :], np.eye(size), spread)
    deviation = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 0))
    with np.errstate(invalid="ignore"):  # what is not finite is wrong too
        allowed = _SYMMETRY * deviation[..., None] * deviation[..., None, :]
        wrong = ~(np.abs(matrix - matrix.swapaxes(-1, -2)) <= allowed).all(axis=(-1, -2))
    matrix = np.where(wrong[..., None, None], np.eye(size), matrix)
    factor = _cholesky(matrix)
    left, own = (np.diagonal(some, axis1=-2, axis2=-1) for some in (factor, matrix))
    wrong |= ~(left**2 > _SMALLEST * np.abs(own)).all(axis=-1)
    factor = np.where(on_axis[..., None] | on_axis[..., None, :], 0, factor)
    return factor, fixed, np.asarray(wrong.swapaxes(0, 1).reshape(wrong.shape[1], -1).any(axis=-1))


def _cholesky(matrix: FloatArray) -> FloatArray:
    """Lower triangles of matrices (…, n, n); 0 for those that have none, whatever the others are."""
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        factor = np.zeros_like(matrix)
        for place in np.ndindex(matrix.shape[:-2]):
            with suppress(np.linalg.LinAlgError):
                factor[place] = np.linalg.cholesky(matrix[place])
        return factor


def times(factor: FloatArray, z: FloatArray, kind: Kind, shape: tuple[int, int]) -> FloatArray:
    """Multiply standard normal numbers (m, N, KD) by the factors of one component, as (m, N, K, D)."""
    of_joints = z.reshape(*z.shape[:2], *shape)
    if kind == "sigma":
        return factor[:, None] * of_joints
    if kind == "covariance":
        return np.asarray(np.einsum("mkij,mnkj->mnki", factor, of_joints))
    return (z @ factor.swapaxes(-1, -2)).reshape(of_joints.shape)


def normal_log_density(away: FloatArray, factor: FloatArray, kind: Kind) -> FloatArray:
    """Log density of normal deviations (C, m, K, D), (C, m)."""
    z: FloatArray
    scale: FloatArray
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # of frames that are refused
        if kind == "sigma":
            z, scale = away / factor, factor
        else:
            away = away.reshape(*away.shape[:2], -1) if kind == "full" else away
            z = np.linalg.solve(_without_zeros(factor), away[..., None])[..., 0]
            scale = np.diagonal(factor, axis1=-2, axis2=-1)
        terms = -0.5 * (z**2 + math.log(2 * math.pi)) - np.log(scale)
    return np.asarray(terms.reshape(*terms.shape[:2], -1).sum(axis=-1))


def _without_zeros(factor: FloatArray) -> FloatArray:
    """Put 1 on the diagonal where it is 0, so that frames which are refused don't stop the others."""
    size = np.arange(factor.shape[-1])
    filled = factor.copy()
    filled[..., size, size] = np.where(factor[..., size, size] == 0, 1, factor[..., size, size])
    return filled


def log_sum(terms: FloatArray) -> FloatArray:
    """Logarithm of the sum over components of exponentials, (C, m) to (m,)."""
    most = terms.max(axis=0)
    most = np.where(np.isneginf(most), 0, most)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(most + np.log(np.exp(terms - most).sum(axis=0)))
