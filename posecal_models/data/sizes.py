"""Do these numbers look like people in millimetres? Metres taken for millimetres would be learned as dwarfs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError

__all__ = ["check_millimetres"]

TINY = 20.0
"""Poses of this size, mm, must be metres: a person's joints lie some 400 mm from their middle, a doll's 50."""


def check_millimetres(poses: npt.NDArray[np.floating], which: str, advice: str = "") -> None:
    """Refuse poses that must be in metres.

    Parameters
    ----------
    poses : ndarray
        (M, K, 3), in what should be mm. Poses with joints that are not finite don't count.
    which : str
        Where they are from.
    advice : str
        What to do, the end of the message.

    Raises
    ------
    PoseDataError
        Where in half of the poses the joints lie less than 20 from the middle of the pose, root mean square.

    Examples
    --------
    >>> check_millimetres(np.array([[[0, 0, 300.0], [0, 0, -300]]]), "m.npz")
    >>> check_millimetres(np.array([[[0, 0, 0.3], [0, 0, -0.3]]]), "m.npz", "Store unit m.")
    Traceback (most recent call last):
    posecal.errors.PoseDataError: m.npz looks like metres: joints lie 0.3 from the middle of the pose; expected...
    """
    some = poses[:: max(1, len(poses) // 500)].astype(np.float64)
    whole = some[np.isfinite(some).all(axis=(1, 2))]
    if not whole.size:
        return
    centred = whole - whole.mean(axis=1, keepdims=True)
    size = float(np.median(np.sqrt(np.square(centred).sum(axis=2).mean(axis=1))))
    if 0 < size < TINY:
        raise PoseDataError(
            f"{which} looks like metres: joints lie {size:.2g} from the middle of the pose; expected some 400 (mm). "
            f"{advice}".rstrip()
        )
