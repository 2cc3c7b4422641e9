"""How far is a pose from the truth once position, size or rotation don't count?

Each hypothesis is moved onto the truth by the best map of a named family before its errors are measured:

==================  =============================================================================================
``none``            as it stands
``similarity``      scale, rotation (det R = +1) and translation: Procrustes, the PA of PA-MPJPE
``rigid``           rotation and translation, no scale
``reflection``      similarity with mirror images allowed (det R = ±1)
``scale``           least-squares scale about the origin, which is the root of root-relative poses: N-MPJPE
``norm_root``       scale by the ratio of the norms about the origin, ‖y‖ / ‖x‖
``rms_mean``        centred on the mean joint, scaled by the ratio of the root mean squares
==================  =============================================================================================

The best rotation is found without singular value decompositions: the largest eigenvalue of Horn's 4 × 4 matrix by
Newton's method (Theobald 2005), and the rotation straight from the adjugate at that eigenvalue, all hypotheses of
a block side by side. Where the two best rotations nearly tie, those few are decomposed one by one.

References
----------
Horn, J. Opt. Soc. Am. A 4, 629 (1987), doi:10.1364/JOSAA.4.000629; Theobald, Acta Cryst. A61, 478 (2005),
doi:10.1107/S0108767305015266; Umeyama, IEEE TPAMI 13, 376 (1991), doi:10.1109/34.88573.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from posecal.data.arrays import FloatArray, squared_norms
from posecal.errors import PoseDataError, did_you_mean

__all__ = ["ALIGNMENTS", "Alignment", "aligned", "aligned_errors", "best_rotations"]

Alignment = Literal["none", "similarity", "rigid", "reflection", "scale", "norm_root", "rms_mean"]
ALIGNMENTS: tuple[Alignment, ...] = get_args(Alignment)
Symmetric = dict[tuple[int, int], FloatArray]
_ROTATING = ("similarity", "rigid", "reflection")

_TIE = 1e-3
"""Below this relative gap between the best and the other rotations, decompose: there, rounding costs 1e-14 / gap²."""

_FLAT = 1e-6
"""Where the characteristic polynomial is flatter than this, a step of Newton's method would be a step of rounding."""


def aligned_errors(offsets: FloatArray, truth: FloatArray, weights: FloatArray, how: Alignment) -> FloatArray:
    """Distance of each aligned hypothesis from the truth.

    Parameters
    ----------
    offsets : array (B, K, D, n)
        Hypotheses minus truth, mm.
    truth : array (B, K, D)
        True poses, mm.
    weights : array (B, K)
        Share of each joint in the fit; sums to 1 over the joints.
    how : str
        A key of the table above.

    Returns
    -------
    array (B, K, n)
        Errors, mm; lower is better, 0 at best.
    """
    if how == "none":
        return np.sqrt(squared_norms(offsets))
    left = aligned(offsets + truth[..., None], truth, weights, how)
    left -= truth[..., None]
    squares = squared_norms(left)
    return np.sqrt(squares, out=squares)


def aligned(points: FloatArray, truth: FloatArray, weights: FloatArray, how: Alignment) -> FloatArray:
    """Move each hypothesis onto the truth by the best map of a family.

    Parameters
    ----------
    points : array (B, K, D, n)
        Hypotheses, mm.
    truth, weights, how
        As for :func:`aligned_errors`.

    Returns
    -------
    array (B, K, D, n)
        Aligned hypotheses, mm.

    Raises
    ------
    PoseDataError
        For a family that is not known, and for rotations of other than three coordinates.
    """
    if how not in ALIGNMENTS:
        raise PoseDataError(f"align: {how!r} is not known. {did_you_mean(how, ALIGNMENTS)}")
    if how == "none":
        return points.copy()
    if how in _ROTATING:
        return _procrustes(points, truth, weights, scaled=how != "rigid", mirrored=how == "reflection")
    if how == "rms_mean":
        middle: FloatArray = np.einsum("bk,bkdn->bdn", weights, points)[:, None]
        target: FloatArray = np.einsum("bk,bkd->bd", weights, truth)[:, None]
        factor = _ratio(_norms(points - middle, weights), _norms((truth - target)[..., None], weights))
        return (points - middle) * factor + target[..., None]
    if how == "norm_root":
        return points * _ratio(_norms(points, weights), _norms(truth[..., None], weights))
    against: FloatArray = np.einsum("bkd,bkdn->bn", weights[:, :, None] * truth, points)
    return points * _ratio(_norms(points, weights) ** 2, against[:, None, None])


def _norms(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted root mean squares over joints, (B, 1, 1, n)."""
    squares = np.einsum("bk,bkdn,bkdn->bn", weights, points, points)
    return np.asarray(np.sqrt(squares)[:, None, None])


def _ratio(under: FloatArray, over: FloatArray) -> FloatArray:
    """Divide; where there is nothing to divide by (a pose in one point), leave the size as it is."""
    under, over = np.broadcast_arrays(under, over)
    return np.divide(over, under, out=np.ones_like(over), where=under > 0)


def _procrustes(
    points: FloatArray, truth: FloatArray, weights: FloatArray, *, scaled: bool, mirrored: bool
) -> FloatArray:
    B, K, D, n = points.shape
    if D != 3:
        raise PoseDataError(
            f"align: points with {D} coordinates; expected 3 to rotate. "
            "Ask for metrics that don't align, such as min_mpjpe."
        )
    wide = points.astype(np.float64).reshape(B, K, 3 * n)
    shares = weights.astype(np.float64)
    target = np.einsum("bk,bkd->bd", shares, truth.astype(np.float64))
    centred = truth - target[:, None]

    # One product gives the covariance with the centred truth and, in the last row, the mean of the points.
    left = np.concatenate([shares[:, :, None] * centred, shares[:, :, None]], axis=2).transpose(0, 2, 1)
    product = (left @ wide).reshape(B, 4, 3, n)
    covariance, middle = product[:, :3], product[:, 3]

    rotation, overlap = best_rotations(covariance, mirrored=mirrored)
    if scaled:
        size = (shares[:, None] @ np.square(wide, out=wide)).reshape(B, 3, n).sum(axis=1)
        size -= np.square(middle).sum(axis=1)
        rotation *= _ratio(size, overlap)[:, None, None]
    shift = target[:, :, None] - np.einsum("bijn,bjn->bin", rotation, middle)
    return _apply(rotation.astype(points.dtype), shift.astype(points.dtype), points)


def _apply(rotation: FloatArray, shift: FloatArray, points: FloatArray) -> FloatArray:
    """Map (B, K, 3, n) points by (B, 3, 3, n) matrices and (B, 3, n) shifts."""
    moved = np.empty_like(points)
    step = np.empty_like(points[:, :, 0])
    for i in range(3):
        out = moved[:, :, i]
        np.multiply(points[:, :, 0], rotation[:, None, i, 0], out=out)
        for j in (1, 2):
            np.multiply(points[:, :, j], rotation[:, None, i, j], out=step)
            out += step
        out += shift[:, None, i]
    return moved


def best_rotations(covariance: FloatArray, *, mirrored: bool = False) -> tuple[FloatArray, FloatArray]:
    r"""Find the rotations that turn points onto a target best.

    .. math:: R = \arg\max_R \operatorname{tr}(R^\top F), \qquad F = \sum_k w_k\, y_k x_k^\top

    Parameters
    ----------
    covariance : array (B, 3, 3, n)
        F: weighted products of target coordinates (second axis) and point coordinates (third axis), mm².
    mirrored : bool
        Whether R may mirror, det R = -1.

    Returns
    -------
    rotation : array (B, 3, 3, n)
        R, in double.
    overlap : array (B, n)
        tr(RᵀF), mm²; over the squared size of the points it is the best scale.
    """
    F = covariance
    determinant = _determinant(F)
    if mirrored:
        F = F * np.where(determinant < 0, -1.0, 1.0)[:, None, None]
        determinant = np.abs(determinant)
    size = np.sqrt(np.einsum("bijn,bijn->bn", F, F))
    size[size == 0] = 1
    F = F / size[:, None, None]
    horn = _horn_matrix(F)
    eigenvalue = _largest_eigenvalue(horn, _determinant(F))
    rotation, gap = _rotation_at(horn, eigenvalue)
    ties = np.nonzero(~(gap > _TIE))
    if ties[0].size:
        tied = F[ties[0], :, :, ties[1]]
        rotation[ties[0], :, :, ties[1]] = turned = _rotations_by_svd(tied)
        eigenvalue[ties] = np.einsum("tij,tij->t", turned, tied)
    if mirrored:
        rotation *= np.where(_determinant(covariance) < 0, -1.0, 1.0)[:, None, None]
    return rotation, eigenvalue * size


def _determinant(F: FloatArray) -> FloatArray:
    (a, b, c), (d, e, f), (g, h, i) = (F[:, row].swapaxes(0, 1) for row in range(3))
    return np.asarray(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def _horn_matrix(F: FloatArray) -> Symmetric:
    """Horn's symmetric, traceless 4 × 4 matrix, its entries by (row, column)."""
    (xx, yx, zx), (xy, yy, zy), (xz, yz, zz) = (F[:, row].swapaxes(0, 1) for row in range(3))
    upper = {
        (0, 0): xx + yy + zz,
        (0, 1): yz - zy,
        (0, 2): zx - xz,
        (0, 3): xy - yx,
        (1, 1): xx - yy - zz,
        (1, 2): xy + yx,
        (1, 3): zx + xz,
        (2, 2): yy - xx - zz,
        (2, 3): yz + zy,
        (3, 3): zz - xx - yy,
    }
    return upper | {(j, i): entry for (i, j), entry in upper.items()}


def _minors(m: Symmetric) -> tuple[dict[tuple[int, int], FloatArray], dict[tuple[int, int], FloatArray]]:
    """2 × 2 minors of the upper two rows and of the lower two, by their columns."""
    pairs = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))

    def minors(r: int, s: int) -> dict[tuple[int, int], FloatArray]:
        return {(c, d): m[r, c] * m[s, d] - m[r, d] * m[s, c] for c, d in pairs}

    return minors(0, 1), minors(2, 3)


def _largest_eigenvalue(horn: Symmetric, determinant: FloatArray) -> FloatArray:
    """Largest root of λ⁴ - 2 λ² - 8 det(F) λ + det(horn), ‖F‖ = 1: Newton from above, which can't overshoot."""
    u, v = _minors(horn)
    constant = u[0, 1] * v[2, 3] - u[0, 2] * v[1, 3] + u[0, 3] * v[1, 2]
    constant += u[1, 2] * v[0, 3] - u[1, 3] * v[0, 2] + u[2, 3] * v[0, 1]
    linear = -8 * determinant
    root = np.full_like(determinant, np.sqrt(3))
    for _ in range(60):
        squared = root * root
        value = squared * (squared - 2) + linear * root + constant
        slope = 4 * root * (squared - 1) + linear
        step = np.divide(value, slope, out=np.zeros_like(value), where=slope > _FLAT)
        root -= step
        if np.abs(step).max() < 1e-14:
            break
    return root


def _rotation_at(horn: Symmetric, eigenvalue: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation from the adjugate of (horn - λ), which is a multiple of the quaternion's q qᵀ, and its trace."""
    m = {(i, j): entry - eigenvalue if i == j else entry for (i, j), entry in horn.items()}
    u, v = _minors(m)

    def cofactor(row: int, minors: dict[tuple[int, int], FloatArray], a: int, b: int, c: int) -> FloatArray:
        return m[row, a] * minors[b, c] - m[row, b] * minors[a, c] + m[row, c] * minors[a, b]

    # Cofactor (i, j): the signed minor without row i and column j, from the pair of rows that comes ready.
    q00 = cofactor(1, v, 1, 2, 3)
    q01 = -cofactor(1, v, 0, 2, 3)
    q02 = cofactor(1, v, 0, 1, 3)
    q03 = -cofactor(1, v, 0, 1, 2)
    q11 = cofactor(0, v, 0, 2, 3)
    q12 = -cofactor(0, v, 0, 1, 3)
    q13 = cofactor(0, v, 0, 1, 2)
    q22 = cofactor(3, u, 0, 1, 3)
    q23 = -cofactor(3, u, 0, 1, 2)
    q33 = cofactor(2, u, 0, 1, 2)
    trace = q00 + q11 + q22 + q33
    one = np.divide(1, trace, out=np.zeros_like(trace), where=trace != 0)
    rows = (
        (q00 + q11 - q22 - q33, 2 * (q12 - q03), 2 * (q13 + q02)),
        (2 * (q12 + q03), q00 - q11 + q22 - q33, 2 * (q23 - q01)),
        (2 * (q13 - q02), 2 * (q23 + q01), q00 - q11 - q22 + q33),
    )
    rotation = np.stack([np.stack([entry * one for entry in row], axis=1) for row in rows], axis=1)
    return rotation, np.abs(trace)


def _rotations_by_svd(F: FloatArray) -> FloatArray:
    """Best rotations for (n, 3, 3) matrices one by one."""
    left, _, right = np.linalg.svd(F)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)
