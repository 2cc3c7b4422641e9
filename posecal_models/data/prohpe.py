"""Reader of ProHPE's Human3.6M: a pickle of poses, HRNet keypoints and the Gaussians fitted to their heat maps.

It maps subject, action, subaction and camera, nested in this order, to a table with ``3d_gt`` (F, 51), all x, then y,
then z of 17 joints in mm in the camera's frame; ``2d_hrnet`` (F, 32), all x, then y of MPII's 16 joints in pixels;
``gaussfit`` (F, 112): for each of these joints amplitude, x, y, sigma x, angle, sigma y and fit error; and ``imgpath``.

A keypoint counts as occluded where either sigma is above 5 pixels.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from posecal.data.pickles import read_pickle
from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError, PoseFileError
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.npz import numeric_array
from posecal_models.data.unit_checks import check_millimetres

__all__ = ["KeypointJoin", "read_prohpe"]

KeypointJoin = Literal["by-name", "as-released"]

_SIGMA_X, _SIGMA_Y = 3, 5
_COLUMNS = {"3d_gt": 51, "2d_hrnet": 32, "gaussfit": 112}
_KEYS = (*_COLUMNS, "imgpath")


def read_prohpe(
    path: str | Path, *, every: int = 1, threshold: float = 5.0, join: KeypointJoin = "by-name"
) -> LiftingSet:
    """Read ProHPE's pickle, with the safe reader of :mod:`posecal.data.pickles`.

    Parameters
    ----------
    path : str or Path
        The merged pickle.
    every : int
        Frame step: every n-th frame of each video is used.
    threshold : float
        Keypoints with a larger σ count as missing, pixels.
    join : str
        ``by-name``: each keypoint and its flag belong to the joint of the same name; joints that MPII lacks are
        missing. ``as-released``: keypoints by name, but flags by position, as in the published code: the flag of MPII's
        joint i is used for Human3.6M's joint i + 1, and Head counts as missing. In that code Neck/Nose and Spine, which
        MPII lacks, count as observed; here they are missing, because the file has no keypoints of them.

    Returns
    -------
    LiftingSet
        Poses relative to the hip; keypoints of the joints of both sets.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file has another structure, or its poses look like metres.

    Notes
    -----
    Differs from the published code: that is ``as-released``, where the flag of a right wrist removes a left shoulder.

    References
    ----------
    Wehrbein et al. 2021, arXiv:2107.13788.
    """
    videos = list(_videos(read_pickle(path), path))
    if not videos:
        raise PoseDataError(f"{path}: no video with frames; expected one or more.")
    h36m, mpii = joint_set("h36m-17"), joint_set("mpii-16")
    parts = [_part(table, name, every, path) for name, table in videos]
    poses, keypoints, sigma = (np.concatenate([part[i] for part in parts]) for i in range(3))
    check_millimetres(poses, f"{path}: 3d_gt")
    for values, key in ((keypoints, "2d_hrnet"), (sigma, "gaussfit")):
        if np.abs(values[~np.isnan(values)]).max(initial=0) > np.finfo(np.float32).max:
            raise PoseDataError(f"{path}: {key} holds numbers beyond single precision; expected pixels.")
    frames = [frame for part in parts for frame in part[3]]
    labels = [name for (name, _), part in zip(videos, parts, strict=True) for _ in part[3]]
    pairs = LiftingSet(
        joints=h36m[1:],
        poses=(poses[:, 1:] - poses[:, :1]).astype(np.float32),
        keypoint_joints=mpii,
        keypoints=keypoints.astype(np.float32),
        observed=sigma <= threshold,
        sigma=sigma.astype(np.float32),
        frame_id=np.array(frames),
        sequence=np.array([f"{subject} {action} {sub}" for subject, action, sub, _ in labels]),
        subject=np.array([subject for subject, *_ in labels]),
        action=np.array([action for _, action, *_ in labels]),
        camera=np.array([camera for *_, camera in labels]),
    ).in_order_of(keypoint_joints=h36m)
    if join == "by-name":
        return pairs
    observed = np.insert(sigma <= threshold, 0, True, axis=1)  # the hip, which the other joints are relative to
    observed[:, h36m.index("Head")] = False
    observed &= np.isfinite(pairs.keypoints).all(-1)
    return LiftingSet(**{**vars(pairs), "observed": observed})


def _videos(tree: Any, path: str | Path) -> list[tuple[tuple[str, str, str, str], dict[str, Any]]]:
    videos = []
    try:
        for subject, actions in tree.items():
            for action, subactions in actions.items():
                for subaction, cameras in subactions.items():
                    for camera, table in cameras.items():
                        if missing := [key for key in _KEYS if not isinstance(table, dict) or key not in table]:
                            raise KeyError(f"{subject}/{action}/{subaction}/{camera} lacks {', '.join(missing)}")
                        if len(table["imgpath"]):
                            videos.append(((str(subject), str(action), str(subaction), str(camera)), table))
    except (AttributeError, KeyError, TypeError) as problem:
        raise PoseFileError(
            f"{path}: not subject, action, subaction, camera ({problem.args[0]}); expected ProHPE's merged pickle."
        ) from problem
    return videos


def _part(
    table: dict[str, Any], name: tuple[str, str, str, str], every: int, path: str | Path
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64], list[str]]:
    """Extract every n-th frame of a video: poses, keypoints, the larger sigma, frame ids."""
    frames = len(table["imgpath"])
    arrays = {}
    for key, columns in _COLUMNS.items():
        which = f"{path}: {'/'.join(name)}: {key}"
        array = numeric_array(table[key], which)
        if array.shape[:1] != (frames,) or array.size != frames * columns:
            raise PoseDataError(f"{which} {array.shape}; expected ({frames}, {columns}).")
        arrays[key] = array.reshape(frames, columns)[::every].astype(np.float64)
    fits = arrays["gaussfit"].reshape(-1, 16, 7)
    return (
        arrays["3d_gt"].reshape(-1, 3, 17).transpose(0, 2, 1),
        arrays["2d_hrnet"].reshape(-1, 2, 16).transpose(0, 2, 1),
        np.maximum(fits[..., _SIGMA_X], fits[..., _SIGMA_Y]),
        [str(image).replace("\\", "/").lstrip("/").rsplit(".", 1)[0] for image in table["imgpath"]][::every],
    )
