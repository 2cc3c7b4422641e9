"""Files of the pose world for ``posecal evaluate``.

``hyps.npz`` and ``gt.npz``: uncompressed archives of plain arrays, each with its axes, unit, joint names and frame
ids, so that no options are needed on the command line. Lengths are float32 millimetres in the camera frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from posecal.data.write import write_file
from posecal.errors import PoseFileError
from toy.faults import Case, Fault

__all__ = ["make_folder", "write_case"]


def make_folder(path: Path) -> None:
    """Create a folder in an existing one; do nothing where it exists.

    Parameters
    ----------
    path : Path
        The folder.

    Raises
    ------
    PoseFileError
        Where it can't be created.
    """
    try:
        path.mkdir(exist_ok=True)
    except OSError as error:
        raise PoseFileError(f"{path}: can't be made ({error.strerror}). Make the folder above it first.") from error


def write_case(folder: Path, case: Case, fault: Fault, N: int) -> tuple[npt.NDArray[np.float32], ...]:
    """Draw hypotheses with one fault and write them and their truth.

    Parameters
    ----------
    folder : Path
        Folder of ``hyps.npz`` and ``gt.npz``; created if it does not exist.
    case : Case
        A scene and its exact posterior.
    fault : Fault
        The fault of the hypotheses.
    N : int
        Number of hypotheses.

    Returns
    -------
    hypotheses : ndarray, shape (N, M, K, 3)
        As written, mm.
    truth : ndarray, shape (M, K, 3)
        As written, mm.

    Raises
    ------
    PoseFileError
        Where the folder can't be created or written to.

    Notes
    -----
    ``gt.npz`` also holds ``sequence``; ``action``, which is ``open`` where every keypoint of a sequence is observed and
    ``occluded`` otherwise; ``occluded`` (M, K), the joints without a keypoint; and ``keypoints_2d`` (M, K, V), mm, NaN
    where there is none.
    """
    make_folder(folder)
    hypotheses, truth = (drawn.astype(np.float32) for drawn in fault.apply(case, N))
    scene = case.scene
    sequence = np.array([f"s{number:03d}" for number in scene.sequence])
    frame_id = np.array([f"{name}/{t:04d}" for name, t in zip(sequence, scene.frame, strict=True)])
    unit, joints = np.array("mm"), np.array(case.world.joints)

    def save_hypotheses(file: BinaryIO) -> None:
        axes = np.array("NMKD")
        np.savez(file, hypotheses=hypotheses, axes=axes, unit=unit, joints=joints, frame_id=frame_id)

    def save_truth(file: BinaryIO) -> None:
        np.savez(
            file,
            truth=truth,
            axes=np.array("MKD"),
            unit=unit,
            joints=joints,
            frame_id=frame_id,
            sequence=sequence,
            action=np.where(scene.observed.all(axis=1), "open", "occluded"),
            occluded=~scene.observed,
            keypoints_2d=scene.keypoints.astype(np.float32),
        )

    write_file(folder / "hyps.npz", save_hypotheses)
    write_file(folder / "gt.npz", save_truth)
    return hypotheses, truth
