"""How is VideoPose3D's Human3.6M read? Its two files, 3D poses in the room and 2D keypoints, joined by camera.

``data_3d_h36m.npz`` holds ``positions_3d``: subject to action to (F, 32, 3) in metres, in the room.
``data_2d_h36m_*.npz`` holds ``positions_2d``: subject to action to one (F, 17, 2) in pixels for each camera.
Neither holds the cameras; they are given as subject to a list of :class:`posecal_models.data.cameras.Camera`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError, PoseFileError
from posecal_models.data.cameras import Camera
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.npz import real_numbers
from posecal_models.data.pickles import read_object_npz
from posecal_models.data.sizes import check_millimetres

__all__ = ["OF_32", "read_videopose3d"]

OF_32 = (0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27)
"""Which of Human3.6M's 32 joints are the 17 of the joint set h36m-17."""


def read_videopose3d(
    poses: str | Path,
    keypoints: str | Path,
    cameras: Mapping[str, Sequence[Camera]],
    *,
    every: int = 1,
) -> LiftingSet:
    """Read VideoPose3D's files of Human3.6M.

    Parameters
    ----------
    poses : str or Path
        ``data_3d_h36m.npz``.
    keypoints : str or Path
        ``data_2d_h36m_gt.npz``, ``…_cpn_ft_h36m_dbb.npz`` or another of this form.
    cameras : mapping of str to sequence of Camera
        Those of each subject, in the order of the keypoint file.
    every : int
        Only every so manieth frame.

    Returns
    -------
    LiftingSet
        Poses in each camera's frame, mm. All keypoints count as observed: the files don't say.

    Raises
    ------
    PoseFileError, PoseDataError
        Where a file is not of this form, has other joints, or a subject's cameras are missing.

    Notes
    -----
    Where the two files have not as many frames, the later ones of the longer are left out, as is usual with them.

    References
    ----------
    Pavllo et al. 2019, arXiv:1811.11742.
    """
    rooms = _table(poses, "positions_3d")
    images = _table(keypoints, "positions_2d")
    names = joint_set("h36m-17")
    parts: list[tuple[Any, Any, list[str], str, str, str]] = []
    for subject, actions in rooms.items():
        if subject not in images:
            continue
        if subject not in cameras:
            raise PoseDataError(f"cameras: none for {subject}; expected those of {', '.join(rooms)}.")
        for action, stored in actions.items():
            room = _frames(stored, 32, 3, f"{poses}: {subject} {action}")
            views = images[subject].get(action, [])
            if not isinstance(views, list | tuple | np.ndarray):
                raise PoseFileError(f"{keypoints}: {subject} {action} is no list of views.")
            if len(views) > len(cameras[subject]):
                raise PoseDataError(
                    f"{keypoints}: {subject} {action} has {len(views)} views; "
                    f"{len(cameras[subject])} cameras are given."
                )
            for index, seen_there in enumerate(views):
                view = _frames(seen_there, 17, 2, f"{keypoints}: {subject} {action}, view {index}")
                length = min(len(room), len(view))
                rows = np.arange(0, length, every)
                pose = room[rows][:, OF_32, :3] * 1000
                relative = cameras[subject][index].turn(pose[:, 1:] - pose[:, :1])
                frames = [f"{subject}/{action}/{index}/{row}" for row in rows]
                parts.append((relative, view[rows][..., :2], frames, str(subject), str(action), str(index)))
    if not parts:
        raise PoseDataError(f"{poses} and {keypoints}: no subject and action in common.")
    counts = [len(part[2]) for part in parts]
    turned = np.concatenate([part[0] for part in parts])
    check_millimetres(turned, f"{poses}: positions_3d, times 1000,")
    seen = np.concatenate([part[1] for part in parts]).astype(np.float32)
    return LiftingSet(
        joints=names[1:],
        poses=turned.astype(np.float32),
        keypoint_joints=names,
        keypoints=seen,
        observed=np.asarray(np.isfinite(seen).all(-1)),
        sigma=np.zeros(seen.shape[:2], np.float32),
        frame_id=np.array([frame for part in parts for frame in part[2]]),
        sequence=np.repeat([f"{part[3]} {part[4]}" for part in parts], counts),
        subject=np.repeat([part[3] for part in parts], counts),
        action=np.repeat([part[4].rstrip(" 0123456789") for part in parts], counts),
        camera=np.repeat([part[5] for part in parts], counts),
    )


def _table(path: str | Path, name: str) -> dict[str, Any]:
    members = read_object_npz(path)
    table = members.get(name)
    if not isinstance(table, dict) or not all(isinstance(actions, dict) for actions in table.values()):
        raise PoseFileError(f"{path}: no {name} by subject and action; expected a file of VideoPose3D.")
    return table


def _frames(stored: Any, joints: int, coordinates: int, which: str) -> npt.NDArray[np.float64]:
    """Give the frames of one video, (F, joints, coordinates or more)."""
    array = real_numbers(stored, which)
    if array.ndim != 3 or array.shape[1] != joints or array.shape[2] < coordinates:
        raise PoseDataError(f"{which} {array.shape}; expected (F, {joints}, {coordinates}).")
    return array.astype(np.float64)
