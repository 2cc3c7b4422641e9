"""Reader of Human3.6M's own .cdf files: poses and their projections.

Under each subject's folder, ``D3_Positions_mono`` holds a pose of 32 joints per frame, in mm in the camera's frame, and
``D2_Positions`` its projection in pixels, in files such as ``Directions 1.54138969.cdf``. Reading them needs the
package cdflib, which is not installed with posecal. The data set is licensed by its authors.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.data.child_process import seconds_for, time_limit
from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError, PoseFileError, refuse_unreadable
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.unit_checks import check_millimetres
from posecal_models.data.videopose3d import OF_32

__all__ = ["TEST_SUBJECTS", "TRAINING_SUBJECTS", "read_human36m"]

TRAINING_SUBJECTS = ("S1", "S5", "S6", "S7", "S8")
TEST_SUBJECTS = ("S9", "S11")


def read_human36m(
    folder: str | Path, *, subjects: Sequence[str] | None = None, every: int = 4, test_every: int = 64
) -> LiftingSet:
    """Read Human3.6M from its own files.

    Parameters
    ----------
    folder : str or Path
        Folder of the subjects' folders: ``folder/S1/**/D3_Positions_mono/*.cdf``.
    subjects : sequence of str, optional
        Subjects to read; those of the paper that exist where not given.
    every, test_every : int
        Frame step of the training subjects, and of S9 and S11; defaults as in the paper.

    Returns
    -------
    LiftingSet
        Poses and the exact projections of their joints; all observed.

    Raises
    ------
    PoseFileError, PoseDataError
        Where cdflib is not installed, there are no such files, or one can't be read.

    Notes
    -----
    S11's Directions in camera 54138969 does not exist; missing files are skipped.

    References
    ----------
    Ionescu et al. 2014, doi:10.1109/TPAMI.2013.248.
    """
    folder = Path(folder)
    names = subjects or [name for name in (*TRAINING_SUBJECTS, *TEST_SUBJECTS) if (folder / name).is_dir()]
    joints = joint_set("h36m-17")
    poses, keypoints, frames, labels = [], [], [], []
    for subject in names:
        step = test_every if subject in TEST_SUBJECTS else every
        for path in sorted((folder / subject).glob("**/D3_Positions_mono/*.cdf")):
            match = re.fullmatch(r"(.+)\.(\d+)\.cdf", path.name)
            if match is None or match[1].startswith("_ALL"):
                continue
            pose = _read(path, 3)[::step][:, OF_32]
            projection = path.parent.parent / "D2_Positions" / path.name
            poses.append(pose[:, 1:] - pose[:, :1])
            keypoints.append(_read(projection, 2)[::step][:, OF_32])
            if len(keypoints[-1]) != len(pose):
                raise PoseDataError(f"{projection}: {len(keypoints[-1])} frames; expected {len(pose)} as in {path}.")
            frames += [f"{subject}/{match[1]}/{match[2]}/{row * step}" for row in range(len(pose))]
            labels += [(subject, match[1], match[2])] * len(pose)
    if not labels:
        raise PoseFileError(
            f"{folder}: no D3_Positions_mono/*.cdf below {', '.join(names) or 'any subject'}; "
            "expected Human3.6M's folders."
        )
    relative = np.concatenate(poses)
    check_millimetres(relative, f"{folder}: D3_Positions_mono")
    projections = np.concatenate(keypoints).astype(np.float32)
    return LiftingSet(
        joints=joints[1:],
        poses=relative.astype(np.float32),
        keypoint_joints=joints,
        keypoints=projections,
        observed=np.ones(projections.shape[:2], bool),
        sigma=np.zeros(projections.shape[:2], np.float32),
        frame_id=np.array(frames),
        sequence=np.array([f"{subject} {action}" for subject, action, _ in labels]),
        subject=np.array([subject for subject, *_ in labels]),
        action=np.array([re.sub(r" \d+$", "", action) for _, action, _ in labels]),
        camera=np.array([camera for *_, camera in labels]),
    )


def _read(path: Path, dimensions: int) -> npt.NDArray[np.float64]:
    """Read the poses of one file, (F, 32, dimensions)."""
    try:
        import cdflib
    except ImportError as problem:
        raise PoseFileError(f"{path}: reading .cdf needs cdflib. Install it: pip install cdflib.") from problem
    unreadable = refuse_unreadable(path, "can't be read as .cdf ({}).")
    with unreadable, time_limit(seconds_for(path)), np.errstate(invalid="raise"):
        values = np.asarray(cdflib.CDF(path).varget("Pose"), float)
    if values.shape[-1:] != (32 * dimensions,):
        raise PoseDataError(f"{path}: Pose {values.shape}; expected (1, F, {32 * dimensions}).")
    return values.reshape(-1, 32, dimensions)
