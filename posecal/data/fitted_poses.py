"""Poses that a recalibration map was fitted on, by which an evaluation on the same ones is known."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.data.remarks import Count, Remark
from posecal.errors import PoseDataError

Hashes = npt.NDArray[np.uint64]

MOST = 256
"""Of more poses the smallest hashes are kept: which are the same is then found by a sample of them."""

FEWEST_COORDINATES = 9
"""Poses of fewer, such as a joint's angle, may be equal by chance."""


def fitted_hashes(truth: FloatArray) -> Hashes:
    """Hash the true poses of a fit, (H,), ascending; none of poses of few coordinates, which may be equal by chance.

    Parameters
    ----------
    truth : array (M, K, D)
        True poses, mm or another unit of posecal.
    """
    return smallest_hashes(_hashes_of(truth))


def smallest_hashes(hashes: Hashes) -> Hashes:
    """Give each hash once, ascending; of more than :data:`MOST` the smallest."""
    return np.unique(hashes)[:MOST]


def fitted_remarks(hashes: Hashes | None, truth: FloatArray, name: str) -> list[str]:
    """Remark on hypotheses that were recalibrated on the poses on which they are evaluated.

    Parameters
    ----------
    hashes : array (H,) or None
        What :func:`fitted_hashes` gave of the poses of the fit.
    truth : array (M, K, D)
        True poses of the evaluation, in the same unit.
    name : str
        What messages call the hypotheses.

    Examples
    --------
    >>> poses = np.arange(60.0).reshape(6, 5, 2)
    >>> fitted_remarks(fitted_hashes(poses[:4]), poses, "new.npz")[0][27:85]
    'map that was fitted on poses of this evaluation (4 of 6 fr'
    >>> fitted_remarks(fitted_hashes(poses[:4]), poses[4:], "new.npz")
    []
    """
    if hashes is None or not len(hashes):
        return []
    own, is_sample = _hashes_of(truth), len(hashes) == MOST
    sample = own[own <= hashes[-1]] if is_sample else own
    number = round(len(own) * float(np.isin(sample, hashes).mean())) if len(sample) else 0
    if not number:
        return []
    return [
        Remark(
            f"{name}: recalibrated by a map that was fitted on poses of this evaluation ({'about ' * is_sample}",
            Count(number, "frame", of=len(own)),
            "): calibration and scores are better here than on new poses. Compare it on poses that the map was not "
            "fitted on.",
        )
    ]


def as_fitted_hashes(array: npt.NDArray[np.generic], name: str) -> Hashes:
    """Check hashes of a file.

    Raises
    ------
    PoseDataError
        For another type or shape.
    """
    if array.dtype != np.uint64 or array.ndim != 1:
        raise PoseDataError(
            f"{name}: {array.dtype} {array.shape}; expected hashes as posecal recalibrate apply writes them, uint64 "
            "(H,). Rename the member if it is something else."
        )
    return smallest_hashes(array.astype(np.uint64))


def row_hashes(values: npt.NDArray[np.float32] | npt.NDArray[np.str_]) -> Hashes:
    """Hash each row, (M,). Zeros at its end change nothing, so that text of any width has one hash."""
    words = np.ascontiguousarray(values).view(np.uint32).reshape(len(values), -1).astype(np.uint64)
    once, again = _factors(words.shape[1])
    words *= once
    words ^= words >> np.uint64(32)
    return np.asarray((words * again).sum(axis=1, dtype=np.uint64))


def pose_words(truth: FloatArray) -> npt.NDArray[np.float32]:
    """Give poses (M, K, D) in the precision in which equal ones have equal hashes."""
    return truth.astype(np.float32) + np.float32(0)  # -0 as 0


def _hashes_of(truth: FloatArray) -> Hashes:
    if truth[:1].size < FEWEST_COORDINATES:
        return np.zeros(0, dtype=np.uint64)
    return row_hashes(pose_words(truth))


@lru_cache(maxsize=16)
def _factors(number: int) -> Hashes:
    """Give odd random numbers, (2, number), the same ones on each machine."""
    return np.random.PCG64(0).random_raw(2 * number).reshape(number, 2).T | np.uint64(1)
