"""Errors of the poses of a block: per joint and per pose, of each hypothesis or of one pose made of them.

The error of a hypothesis is the mean over a pose's joints of the distance to the truth. The one pose that is made of
the hypotheses is their mean (``mean_pose``), their per-coordinate median (``median_pose``), their mean weighted by the
model's scores (``weighted_pose``), or one of them (``mode``).
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from posecal.geometry.procrustes import FEWEST_JOINTS, Alignment, aligned_errors

OfPoses = Literal["mean_pose", "median_pose", "weighted_pose", "mode"]
OF_POSES: tuple[OfPoses, ...] = get_args(OfPoses)


def pose_of(block: Block, of: OfPoses, mode: int | None = None) -> FloatArray:
    """Make one pose of the N hypotheses.

    Parameters
    ----------
    block : Block
        B poses.
    of : str
        One of :data:`OF_POSES`.
    mode : int, optional
        For ``mode``, the index of the hypothesis; without it the one of the highest score.

    Returns
    -------
    array (B, K, D, 1)
        Its offset from the truth, mm.

    Raises
    ------
    PoseDataError
        For scores that are not finite, or can't be weights where weights are needed.
    """
    x = block.offsets
    if of == "mean_pose":
        return block.mean_of(x)
    if of == "median_pose":
        return block.median[..., None]
    if of == "weighted_pose":
        total = block.scores.sum(axis=-1, keepdims=True)
        if (block.scores < 0).any() or not total.all():
            raise PoseDataError(
                "hypotheses: scores below 0, or all 0 for a pose; expected weights to take a mean of the hypotheses "
                "with. Store probabilities, or leave the weighted_pose metrics out."
            )
        return block.mean_of(x, (block.scores / total).astype(x.dtype))
    chosen = block.scores.argmax(axis=-1) if mode is None else np.full(x.shape[0], mode)
    return np.take_along_axis(x, chosen[:, None, None, None], axis=-1)


def joint_errors(
    block: Block,
    align: Alignment = "none",
    of: OfPoses | None = None,
    fit: BoolArray | None = None,
    mode: int | None = None,
) -> FloatArray:
    """Distance from the truth per joint, after an alignment, of each hypothesis or of one pose made of them.

    Parameters
    ----------
    block : Block
        B poses.
    align : str
        How each pose is moved onto the truth first; see :mod:`posecal.geometry.procrustes`.
    of : str, optional
        One of :data:`OF_POSES`; each hypothesis by default.
    fit : bool array (K,), optional
        The joints to which the alignment is fitted, of those that are usable; all by default.
    mode : int, optional
        As for :func:`pose_of`.

    Returns
    -------
    array (B, K, n)
        Errors, mm; n is N, or 1 for one pose; NaN for poses with too few joints to align.

    Raises
    ------
    PoseDataError
        For an alignment of angles, or of so few joints that it is perfect whatever the pose.
    """
    if align == "none" and of is None:
        return block.errors
    if align != "none" and block.period is not None:
        raise PoseDataError(f"align: {align}; expected none for angles, which have no place and no size.")
    least = FEWEST_JOINTS.get(align, 1)
    if block.truth.shape[1] < least:
        raise PoseDataError(
            f"align: {align} of poses with {block.truth.shape[1]} joints, which it fits whatever they are; expected at "
            f"least {least} joints, or none."
        )
    key = ("joint_errors", align, of, _bytes(None if align == "none" else fit), mode)

    def compute() -> FloatArray:
        fitted = block if align == "none" else block.fit_block
        offsets = fitted.shortest(fitted.offsets if of is None else pose_of(fitted, of, mode))
        return aligned_errors(offsets, fitted.truth, fitted.joint_weights(fit), align)

    return block.share(key, compute)


def scored_weights(
    block: Block, align: Alignment = "none", joints: BoolArray | None = None, fit: BoolArray | None = None
) -> FloatArray:
    """Give each joint's share in a mean of aligned errors, (B, K); 0 where a pose has too few joints to align."""
    weights = block.joint_weights(joints)
    return weights if align == "none" else weights * ~np.isnan(joint_errors(block, align, None, fit)[:, :1, 0])


def pose_errors(
    block: Block,
    align: Alignment = "none",
    of: OfPoses | None = None,
    body: BoolArray | None = None,
    mode: int | None = None,
    fit: BoolArray | None = None,
) -> FloatArray:
    """Mean over a pose's joints of :func:`joint_errors`.

    Parameters
    ----------
    block, align, of, mode
        As for :func:`joint_errors`.
    body : bool array (K,), optional
        The joints that the mean is over; all by default.
    fit : bool array (K,), optional
        The joints to which the alignment is fitted; those of ``body`` by default.

    Returns
    -------
    array (B, n)
        Errors, mm; NaN for poses without a joint that counts, or with too few to align.
    """
    fit = body if fit is None else fit

    def compute() -> FloatArray:
        weights = block.joint_weights(body)
        errors = (weights[:, None] @ joint_errors(block, align, of, fit, mode))[:, 0]
        errors[~weights.any(axis=1)] = np.nan
        return errors

    key = ("pose_errors", align, of, _bytes(body), _bytes(None if align == "none" else fit), mode)
    return block.share(key, compute)


def sorted_errors(
    block: Block, align: Alignment = "none", body: BoolArray | None = None, fit: BoolArray | None = None
) -> FloatArray:
    """The N errors of each pose in ascending order, (B, N), mm; masks as for :func:`pose_errors`."""
    key = ("sorted_errors", align, _bytes(body), _bytes(None if align == "none" else fit))
    return block.share(key, lambda: np.sort(pose_errors(block, align, body=body, fit=fit), axis=-1))


def _bytes(mask: BoolArray | None) -> bytes | None:
    return None if mask is None else mask.tobytes()


def linked(block: Block, values: FloatArray, body: BoolArray | None = None) -> FloatArray:
    """Take from values (B, ..., N) those of the hypothesis that minMPJPE chooses, (B, ...)."""
    errors = pose_errors(block, body=body)
    chosen = np.where(np.isnan(errors), np.inf, errors).argmin(axis=-1)
    index = chosen.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.take_along_axis(values, index, axis=-1).squeeze(axis=-1))
