"""Alignment of poses: errors once position, size or rotation don't count.

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

The best rotation is computed without singular value decompositions, all hypotheses of a block side by side: the sum
of the singular values of the 3 × 3 covariance is the largest root of a quartic (Horn 1987), found by Newton's method
(Theobald 2005), and with it the rotation is a polynomial of the covariance (Markley 1993). Where the two best
rotations nearly tie, those few are decomposed one by one.

References
----------
Horn, J. Opt. Soc. Am. A 4, 629 (1987), doi:10.1364/JOSAA.4.000629; Markley, J. Astronaut. Sci. 41, 261 (1993);
Theobald, Acta Cryst. A61, 478 (2005), doi:10.1107/S0108767305015266; Umeyama, IEEE TPAMI 13, 376 (1991),
doi:10.1109/34.88573.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from posecal.data.arrays import FloatArray, squared_norms
from posecal.errors import PoseDataError, did_you_mean

Alignment = Literal["none", "similarity", "rigid", "reflection", "scale", "norm_root", "rms_mean"]
ALIGNMENTS: tuple[Alignment, ...] = get_args(Alignment)
_ROTATING = ("similarity", "rigid", "reflection")

FEWEST_JOINTS: dict[Alignment, int] = {"similarity": 3, "rigid": 2, "reflection": 3, "rms_mean": 2}
"""Joints of fewer of which an alignment is perfect whatever the pose; 1 for the others."""

_TIE = 1e-4
"""Below this relative gap between the best and the other rotations, decompose: there, rounding costs 1e-16 / gap²."""


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
        Errors, mm; lower is better, 0 at best; NaN for poses of so few joints that every pose fits.

    Raises
    ------
    PoseDataError
        For a family that is not known, and for rotations of other than three coordinates.
    """
    if how not in ALIGNMENTS:
        raise PoseDataError(f"align: {how!r} is not known. {did_you_mean(how, ALIGNMENTS)}")
    if how in _ROTATING and offsets.shape[2] != 3:
        raise PoseDataError(
            f"align: points with {offsets.shape[2]} coordinates; expected 3 to rotate. "
            "Ask for metrics that don't align, such as min_mpjpe."
        )
    squares = squared_norms(offsets if how == "none" else _residuals(offsets, truth, weights, how))
    squares[np.count_nonzero(weights, axis=1) < FEWEST_JOINTS.get(how, 0)] = np.nan
    return np.sqrt(squares, out=squares)


def _residuals(offsets: FloatArray, truth: FloatArray, weights: FloatArray, how: Alignment) -> FloatArray:
    """Aligned hypotheses minus truth, in the hypothesis's own frame, (B, K, D, n): s (x - m) - Rᵀ (y - μ).

    With m - μ the mean of the offsets this is s (x - y) + (s - Rᵀ) (y - μ) - s (m - μ), so large coordinates of which
    only the difference counts never meet.
    """
    B, K, D, n = offsets.shape
    centred = how in _ROTATING or how == "rms_mean"
    shares, target = weights.astype(np.float64)[..., None], truth.astype(np.float64)
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 0.5)  # to 1 in double, too
    if centred:
        target = target - (shares * target).sum(axis=1, keepdims=True)
    weighted = np.concatenate([shares * target, shares], axis=2).swapaxes(1, 2)
    size_of_target = (shares * target**2).sum(axis=(1, 2))[:, None]

    # One product gives the covariance of the offsets with the truth and, in the last row, their mean.
    wide = offsets.astype(np.float64).reshape(B, K, D * n)
    moments = (weighted @ wide).reshape(B, D + 1, D, n)
    size = (shares.swapaxes(1, 2) @ np.square(wide, out=wide)).reshape(B, D, n).sum(axis=1)
    size += 2 * np.einsum("bddn->bn", moments[:, :D]) + size_of_target
    if centred:
        size -= np.square(moments[:, D]).sum(axis=1)
    covariance = np.empty((D, D, B, n))
    own: FloatArray = (weighted[:, :D] @ target).transpose(1, 2, 0)[..., None]
    np.add(moments[:, :D].transpose(1, 2, 0, 3), own, out=covariance)

    if how in _ROTATING:
        rotation, overlap = best_rotations(covariance, mirrored=how == "reflection")
    else:
        rotation, overlap = np.eye(D)[..., None, None], np.einsum("ddbn->bn", covariance)
    if how in {"norm_root", "rms_mean"}:
        factor = np.sqrt(_ratio(size, size_of_target))
    else:
        factor = np.ones_like(size) if how == "rigid" else _ratio(size, overlap)

    # Another product gives the rotated truth and the shift.
    maps = np.zeros((B, D + 1, D, n), dtype=offsets.dtype)
    maps[:, :D] = -rotation.transpose(2, 0, 1, 3)
    np.einsum("bddn->bdn", maps[:, :D])[...] += factor[:, None]
    if centred:
        maps[:, D] = -factor[:, None] * moments[:, D]
    points = np.concatenate([target, np.ones_like(shares)], axis=2, dtype=offsets.dtype)
    residuals: FloatArray = points @ maps.reshape(B, D + 1, D * n)
    flat = offsets.reshape(B, K, D * n)
    residuals += flat if how == "rigid" else flat * np.tile(factor.astype(offsets.dtype), (1, D))[:, None]
    return residuals.reshape(offsets.shape)


def _ratio(under: FloatArray, over: FloatArray) -> FloatArray:
    """Divide; where there is nothing to divide by (a pose in one point), leave the size as it is."""
    under, over = np.broadcast_arrays(under, over)
    return np.divide(over, under, out=np.ones_like(over), where=under > 0)


def best_rotations(covariance: FloatArray, *, mirrored: bool = False) -> tuple[FloatArray, FloatArray]:
    r"""Rotations that turn points onto a target best.

    .. math:: R = \arg\max_R \operatorname{tr}(R^\top F), \qquad F = \sum_k w_k\, y_k x_k^\top

    Parameters
    ----------
    covariance : array (3, 3, ...)
        F: weighted products of target coordinates (first axis) and point coordinates (second axis), mm².
    mirrored : bool
        Whether R may mirror, det R = -1.

    Returns
    -------
    rotation : array (3, 3, ...)
        R, in double.
    overlap : array (...)
        tr(RᵀF), mm²; over the squared size of the points it is the best scale.

    Notes
    -----
    With ‖F‖ = 1, singular values s (the last negative where det F is) and their sum λ, Markley's formula is
    ζ R = ½ (λ² + 1) F + λ cof F - F FᵀF, where ζ = ½ λ (λ² - 1) - det F is the product of the s_i + s_j: the gap that
    a second rotation as good as the best would close.
    """
    size = np.sqrt(np.einsum("ij...,ij...->...", covariance, covariance))
    size[size == 0] = 1
    F = covariance / size
    cofactors = _cofactors(F)
    determinant = np.einsum("j...,j...->...", F[0], cofactors[0])
    sign = np.where(determinant < 0, -1.0, 1.0) if mirrored else np.ones(())
    F *= sign
    determinant *= sign
    total = _sum_of_singular_values(determinant, np.einsum("ij...,ij...->...", cofactors, cofactors))
    half = (total * total - 1) / 2
    gap = half * total - determinant
    rotation = np.einsum("ij...,jk...->ik...", F, np.einsum("ji...,jk...->ik...", F, F))
    np.subtract((half + 1) * F, rotation, out=rotation)
    rotation += total * cofactors
    rotation /= np.where(gap > 0, gap, 1)
    ties = np.nonzero(~(gap > _TIE))
    if ties[0].size:
        tied = np.moveaxis(F[:, :, *ties], -1, 0)
        turned = _rotations_by_svd(tied)
        rotation[:, :, *ties] = np.moveaxis(turned, 0, -1)
        total[ties] = np.einsum("tij,tij->t", turned, tied)
    rotation *= sign
    return rotation, total * size


def _cofactors(F: FloatArray) -> FloatArray:
    """Cofactor matrix: the signed 2 × 2 minors."""
    minors = np.empty_like(F)
    for i, j in np.ndindex(3, 3):
        (r, s), (c, d) = ((i + 1) % 3, (i + 2) % 3), ((j + 1) % 3, (j + 2) % 3)
        np.multiply(F[r, c], F[s, d], out=minors[i, j])
        minors[i, j] -= F[r, d] * F[s, c]
    return minors


def _sum_of_singular_values(determinant: FloatArray, squared_cofactors: FloatArray) -> FloatArray:
    """Largest root of (λ² - 1)² - 8 det(F) λ - 4 ‖cof F‖², ‖F‖ = 1: Newton from above, which can't overshoot."""
    linear, constant = 8 * determinant, 4 * squared_cofactors
    root: FloatArray = np.sqrt(1 + np.sqrt(constant + np.sqrt(3) * np.maximum(linear, 0)))
    for _ in range(40):
        step = root * root
        step -= 1
        slope = 4 * root * step - linear
        step *= step
        step -= linear * root
        step -= constant
        step /= np.maximum(slope, _TIE, out=slope)
        root -= step
        if step.max() < 1e-9:  # the next would be its square
            break
    return root


def _rotations_by_svd(F: FloatArray) -> FloatArray:
    """Best rotations for (n, 3, 3) matrices one by one."""
    left, _, right = np.linalg.svd(F)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)
