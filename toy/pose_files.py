"""Which files does ``posecal evaluate`` read from the pose world?

``hyps.npz`` and ``gt.npz``: uncompressed archives of plain arrays, each with its axes, unit, joint names and frame
ids, so that nothing has to be said on the command line. Lengths are float32 millimetres in the camera frame.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from toy.faults import Case, Fault
from toy.whole_file import make_folder, whole_file

__all__ = ["write_case"]


def write_case(folder: Path, case: Case, fault: Fault, N: int) -> tuple[npt.NDArray[np.float32], ...]:
    """Draw hypotheses with one fault and write them beside their truth.

    Parameters
    ----------
    folder : Path
        Where ``hyps.npz`` and ``gt.npz`` go; made where it is not there.
    case : Case
        A scene and its exact posterior.
    fault : Fault
        What is wrong with the hypotheses.
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
        Where the folder can't be made or written to.

    Notes
    -----
    ``gt.npz`` also holds ``sequence``; ``action``, which is ``open`` where a sequence shows every keypoint and
    ``occluded`` where it does not; ``occluded`` (M, K), the joints without a keypoint; and ``keypoints_2d``
    (M, K, V), mm, NaN where there is none.
    """
    make_folder(folder)
    hypotheses, truth = (drawn.astype(np.float32) for drawn in fault.apply(case, N))
    scene = case.scene
    sequence = np.array([f"s{number:03d}" for number in scene.sequence])
    frame_id = np.array([f"{name}/{t:04d}" for name, t in zip(sequence, scene.frame, strict=True)])
    unit, joints = np.array("mm"), np.array(case.world.joints)
    with whole_file(folder / "gt.npz") as gt, whole_file(folder / "hyps.npz") as hyps:
        np.savez(
            gt,
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
        axes = np.array("NMKD")
        np.savez(hyps, hypotheses=hypotheses, axes=axes, unit=unit, joints=joints, frame_id=frame_id)
    return hypotheses, truth
