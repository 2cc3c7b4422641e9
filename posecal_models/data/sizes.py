"""Do these numbers look like people in millimetres? Metres taken for millimetres would be learned as dwarfs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.data.checks import TINY, metres_message, pose_size
from posecal.errors import PoseDataError

__all__ = ["check_millimetres"]


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
        Where in half of the poses the joints lie less than 10 from the middle of the pose, root mean square.

    Examples
    --------
    >>> check_millimetres(np.array([[[0, 0, 300.0], [0, 0, -300]]]), "m.npz")
    >>> check_millimetres(np.array([[[0, 0, 0.3], [0, 0, -0.3]]]), "m.npz", "Store unit m.")
    Traceback (most recent call last):
    posecal.errors.PoseDataError: m.npz looks like metres: joints lie 0.3 from the middle of the pose; expected...
    """
    size = pose_size(poses)
    if 0 < size < TINY:
        raise PoseDataError(f"{metres_message(which, size)} {advice}".rstrip())
