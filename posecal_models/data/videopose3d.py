"""Reader of VideoPose3D's Human3.6M: 3D poses in world coordinates and 2D keypoints, joined by camera.

``data_3d_h36m.npz`` holds ``positions_3d``: by subject and action (F, 32, 3) in metres, in world coordinates.
``data_2d_h36m_*.npz`` holds ``positions_2d``: by subject and action one (F, 17, 2) in pixels for each camera.
Neither holds the cameras; they are given as a list of :class:`posecal_models.data.cameras.Camera` for each subject.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.pickles import read_object_npz
from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError, PoseFileError
from posecal_models.data.cameras import Camera
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.npz import numeric_array
from posecal_models.data.unit_checks import check_millimetres

__all__ = ["OF_32", "read_videopose3d"]

OF_32 = (0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27)
"""Indices, among Human3.6M's 32 joints, of the 17 of the joint set h36m-17."""


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
        ``data_2d_h36m_gt.npz``, ``…_cpn_ft_h36m_dbb.npz`` or another of the same structure.
    cameras : mapping of str to sequence of Camera
        The cameras of each subject, in the order of the keypoint file.
    every : int
        Frame step: every n-th frame is used.

    Returns
    -------
    LiftingSet
        Poses in each camera's frame, mm. All finite keypoints count as observed: the files hold no flags.

    Raises
    ------
    PoseFileError, PoseDataError
        Where a file has another structure or other joints, or a subject's cameras are missing.

    Notes
    -----
    Where the two files have different numbers of frames, the last ones of the longer are left out, as is usual.

    References
    ----------
    Pavllo et al. 2019, arXiv:1811.11742.
    """
    positions_3d = _table(poses, "positions_3d")
    positions_2d = _table(keypoints, "positions_2d")
    names = joint_set("h36m-17")
    parts: list[tuple[Any, Any, list[str], str, str, str]] = []
    for subject, actions in positions_3d.items():
        if subject not in positions_2d:
            continue
        if subject not in cameras:
            raise PoseDataError(f"cameras: none for {subject}; expected those of {', '.join(positions_3d)}.")
        for action, stored_poses in actions.items():
            in_world = _frames(stored_poses, 32, 3, f"{poses}: {subject} {action}")
            views = positions_2d[subject].get(action, [])
            if not isinstance(views, list | tuple | np.ndarray):
                raise PoseFileError(f"{keypoints}: {subject} {action} is no list of views.")
            if len(views) > len(cameras[subject]):
                raise PoseDataError(
                    f"{keypoints}: {subject} {action} has {len(views)} views and {len(cameras[subject])} cameras; "
                    "expected a camera for each view."
                )
            for index, stored_view in enumerate(views):
                view = _frames(stored_view, 17, 2, f"{keypoints}: {subject} {action}, view {index}")
                length = min(len(in_world), len(view))
                rows = np.arange(0, length, every)
                pose = in_world[rows][:, OF_32, :3] * 1000
                relative = cameras[subject][index].rotate(pose[:, 1:] - pose[:, :1])
                frames = [f"{subject}/{action}/{index}/{row}" for row in rows]
                parts.append((relative, view[rows][..., :2], frames, str(subject), str(action), str(index)))
    if not parts:
        raise PoseDataError(f"{poses} and {keypoints}: no subject and action in common.")
    counts = [len(part[2]) for part in parts]
    in_camera = np.concatenate([part[0] for part in parts])
    check_millimetres(in_camera, f"{poses}: positions_3d, times 1000,")
    detections = np.concatenate([part[1] for part in parts]).astype(np.float32)
    return LiftingSet(
        joints=names[1:],
        poses=in_camera.astype(np.float32),
        keypoint_joints=names,
        keypoints=detections,
        observed=np.asarray(np.isfinite(detections).all(-1)),
        sigma=np.zeros(detections.shape[:2], np.float32),
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


def _frames(value: Any, joints: int, coordinates: int, which: str) -> npt.NDArray[np.float64]:
    """Convert the frames of one video to an array, (F, joints, coordinates or more)."""
    array = numeric_array(value, which)
    if array.ndim != 3 or array.shape[1] != joints or array.shape[2] < coordinates:
        raise PoseDataError(f"{which} {array.shape}; expected (F, {joints}, {coordinates}).")
    return array.astype(np.float64)
