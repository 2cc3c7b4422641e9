"""Poses as another tool wrote them, with what its file says about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.errors import PoseDataError, first_few, option

AXES = ("x", "y", "z")


@dataclass
class Tracks:
    """Poses of a file, frame by frame.

    Attributes
    ----------
    poses : array (M, K, D) or (N, M, K, D)
        Coordinates; NaN where a joint is not known.
    joints : sequence of str
        K names; empty where the file names none.
    unit : str
        As the file states it, else empty.
    fps : float
        Frames per second, 0 where the file does not say.
    frame_id : sequence of str
        Names of the frames; empty where they are numbered from 0.
    confidence : array (M, K) or (N, M, K), or None
        Of the detector.
    labels : dict
        Labels of the frames, by name.
    beside : dict
        What else an array's file declares of its frames, joints or hypotheses, by the names that posecal reads.
    assumed : list of str
        What the file does not say and was assumed.
    axes : str
        The layout of the poses as the file states it, else empty.
    is_array : bool
        Whether the poses are an array whose layout may be declared; else they are laid out already.
    """

    poses: FloatArray
    joints: Sequence[str] = ()
    unit: str = ""
    fps: float = 0.0
    frame_id: Sequence[str] = ()
    confidence: FloatArray | None = None
    labels: dict[str, npt.NDArray[np.generic]] = field(default_factory=dict)
    beside: dict[str, npt.NDArray[np.generic]] = field(default_factory=dict)
    assumed: list[str] = field(default_factory=list)
    axes: str = ""
    is_array: bool = False


def by_joint(columns: dict[tuple[str, str], FloatArray], name: str) -> tuple[list[str], FloatArray]:
    """Put columns (joint, axis) together as poses, (M, K, D), in the order in which the joints come.

    Raises
    ------
    PoseDataError
        Where there is none, or joints have other axes than the first.
    """
    joints = list(dict.fromkeys(joint for joint, _ in columns))
    axes = [axis for axis in AXES if any(axis == own for _, own in columns)]
    if not joints or not axes:
        angles = f"of a table of angles pass {option('like', 'angles')}"
        raise PoseDataError(
            f"{name}: no columns of joints' coordinates, such as Hip_x, Hip_y, Hip_z; expected some. Or {angles}."
        )
    lacking = [f"{joint}_{axis}" for joint in joints for axis in axes if (joint, axis) not in columns]
    if lacking:
        raise PoseDataError(f"{name}: lacks {first_few(lacking)}; expected {', '.join(axes)} of each joint.")
    return joints, np.stack([[columns[joint, axis] for axis in axes] for joint in joints]).transpose(2, 0, 1)
