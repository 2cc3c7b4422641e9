"""Poses in the viewer of rerun, frame by frame: hypotheses grey, truth blue."""

from __future__ import annotations

import os
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.pose_data import PoseData
from posecal.data.root import AnyRoot, origin
from posecal.data.skeleton import Skeleton
from posecal.data.stored_poses import sample_rows
from posecal.data.write import check_writable, write_file
from posecal.errors import PoseDataError, PoseFileError, checked_integer, checked_type, printable
from posecal.plot.pose_figures import upright_of_most

LOOKS = {"hypotheses": ((140, 140, 140), 0.7), "truth": ((0, 114, 178), 2.0)}
"""Colour and radius, in points of the screen."""

_LOOKED_AT = 50


def view(
    data: PoseData, *, frames: Iterable[int] | None = None, most: int = 50, path: str | os.PathLike[str] | None = None
) -> None:
    """Show poses in the viewer of rerun, one after another, or write them into a file for it.

    Parameters
    ----------
    data : PoseData
        Hypotheses and truth, in two or three dimensions.
    frames : iterable of int, optional
        The numbers of the poses; all by default.
    most : int
        How many hypotheses of a pose are shown, evenly chosen.
    path : path, optional
        A file that ends with ``.rrd``; without one the viewer opens.

    Raises
    ------
    PoseDataError
        For one coordinate, and where rerun is not installed: it comes with the extra ``view``.
    PoseFileError
        For another ending, and where the file can't be written.
    """
    n, m, _, d = checked_type(data, "data", PoseData).shape
    if d not in (2, 3):
        raise PoseDataError(f"truth: D = {d}; expected 2 or 3 coordinates to show.")
    if path is not None and Path(check_writable(path)).suffix != ".rrd":
        raise PoseFileError(f"{path}: expected a name that ends with .rrd.")
    chosen = np.linspace(0, n - 1, min(checked_integer(most, "most", 1), n)).astype(int)
    try:
        rerun: Any = import_module("rerun")
    except ImportError:
        raise PoseDataError("view: rerun is not installed. pip install 'posecal[view]' brings it.") from None
    recording = rerun.RecordingStream("posecal")
    if path is None:
        recording.spawn()
    stream = None if path is None else recording.binary_stream()
    skeleton = Skeleton(data.joints, data.parents)
    turn = upright_of_most(_rooted(data.truth[sample_rows(m, _LOOKED_AT)], data.root), skeleton)
    for frame in range(m) if frames is None else frames:
        recording.set_time("pose", sequence=frame)
        recording.log("frame", rerun.TextLog(printable(str(data.frame_id[frame]))))
        poses = {"hypotheses": data.hypotheses.read(frame, frame + 1)[chosen, 0], "truth": data.truth[[frame]]}
        for name, some in poses.items():
            points = _rooted(some, data.root) @ turn
            bones = points[:, np.array(skeleton.bones, dtype=int).reshape(-1, 2)].reshape(-1, 2, d)
            _log(rerun, recording, name, bones, points.reshape(-1, d))
    recording.flush()
    if path is not None and stream is not None:
        contents: bytes = stream.read() or b""
        write_file(path, lambda file: file.write(contents))


def _rooted(poses: FloatArray, root: AnyRoot) -> FloatArray:
    """Give poses as they are evaluated."""
    return poses if root is None else poses - origin(poses, root)


def _log(rerun: Any, recording: Any, name: str, bones: FloatArray, joints: FloatArray) -> None:
    """Log lines (n, 2, D) and points (n, D), those that are finite."""
    colour, radius = LOOKS[name]
    lines, points = (getattr(rerun, f"{kind}{joints.shape[1]}D") for kind in ("LineStrips", "Points"))
    bones, joints = bones[np.isfinite(bones).all(axis=(1, 2))], joints[np.isfinite(joints).all(axis=1)]
    recording.log(f"{name}/bones", lines(bones, colors=colour, radii=-radius))  # negative: in points of the screen
    recording.log(f"{name}/joints", points(joints, colors=colour, radii=-1.5 * radius))
