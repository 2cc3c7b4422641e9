"""Check of the unit of poses: an error for metres where millimetres are expected."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.data.checks import TINY, metres_message, pose_size
from posecal.data.degenerate import LARGEST
from posecal.errors import PoseDataError

__all__ = ["check_millimetres"]


def check_millimetres(poses: npt.NDArray[np.floating], which: str, advice: str = "") -> None:
    """Raise an error for poses that look like metres.

    Parameters
    ----------
    poses : ndarray
        (M, K, 3), expected in mm. Poses with joints that are NaN are ignored.
    which : str
        Their name in the message.
    advice : str
        The end of the message, with what to do.

    Raises
    ------
    PoseDataError
        Where the median size of the poses is below 10: the root mean square distance of the joints from their centre;
        and for coordinates beyond 10 km.

    Examples
    --------
    >>> check_millimetres(np.array([[[0, 0, 300.0], [0, 0, -300]]]), "m.npz")
    >>> check_millimetres(np.array([[[0, 0, 0.3], [0, 0, -0.3]]]), "m.npz", "Store unit m.")
    Traceback (most recent call last):
    posecal.errors.PoseDataError: m.npz looks like metres: joints lie 0.3 from the middle of the pose; expected...
    """
    if np.abs(poses[~np.isnan(poses)]).max(initial=0) > LARGEST:
        raise PoseDataError(f"{which} has coordinates beyond 10 km ({LARGEST:g} mm); expected poses of persons.")
    size = pose_size(poses)
    if 0 < size < TINY:
        raise PoseDataError(f"{metres_message(which, size)} {advice}".rstrip())
