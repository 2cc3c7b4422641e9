"""A few poses in whole millimetres, and the files that hold them: every type of number represents them exactly."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.declarations import Declarations
from posecal.data.layout import MemoryArray
from posecal.data.pose_data import PoseData, match_poses
from posecal.data.read import read_poses
from posecal.data.skeleton import JOINT_SETS
from posecal.data.stored_poses import StoredPoses

Array = npt.NDArray[Any]

N, M, K = 5, 7, 17
JOINTS = JOINT_SETS["h36m-17"]
FRAMES = [f"S9/walk/{frame:03d}" for frame in (5, 3, 9, 1, 0, 12, 7)]
OCCLUDED = np.arange(M * K).reshape(M, K) % 5 == 0
SCORES = np.arange(N * M, dtype=float).reshape(N, M)
WORDS = np.array([*"tuvwxyz"])


def truth() -> Array:
    """True poses (7, 17, 3): a standing person who sways, hip at the origin, in whole mm."""
    random = np.random.default_rng(20)
    from posecal.data.skeleton import Skeleton

    poses = Skeleton(JOINTS).rest_pose + random.integers(-90, 91, (M, K, 3))
    poses[:, 0] = 0
    return poses.astype(np.float32)


def hypotheses() -> Array:
    """Hypotheses (5, 7, 17, 3) about them, hip at the origin, in whole mm."""
    random = np.random.default_rng(21)
    found = truth() + random.integers(-120, 121, (N, M, K, 3))
    found[:, :, 0] = 0
    return found.astype(np.float32)


def npy(folder: Path, name: str, array: Any) -> Path:
    """A bare array in a file."""
    np.save(folder / name, array)
    return folder / name


def save(path: Path, **members: Any) -> Path:
    """Write an .npz file."""
    np.savez(path, **members)
    return path


def hypotheses_file(folder: Path, **members: Any) -> Path:
    """Write the hypotheses, with more members or others."""
    return save(folder / "hyps.npz", **{"hypotheses": hypotheses(), **members})


def truth_file(folder: Path, **members: Any) -> Path:
    """Write the truth with the names of its joints, with more members or others."""
    return save(folder / "gt.npz", **{"truth": truth(), "joints": JOINTS, **members})


def member(path: Path, name: str, contents: bytes, method: int = zipfile.ZIP_STORED) -> Path:
    """Write a zip file of one member."""
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr(name, contents)
    return path


def read_data(ours: Path, theirs: Path, how: Declarations | None = None) -> PoseData:
    """Read and join two files."""
    return match_poses(read_poses(ours, "hypotheses"), read_poses(theirs, "truth"), how)


def coordinates(pairs: PoseData) -> Array:
    """All hypotheses of some pairs, (N, M, K, 3)."""
    return pairs.hypotheses.read(0, len(pairs.truth))


def hyps(array: Any = None, **declared: Any) -> StoredPoses:
    """Hypotheses in memory, as a file would declare them."""
    return StoredPoses("hyps.npz", MemoryArray(np.asarray(hypotheses() if array is None else array)), **declared)


def gt(array: Any = None, **declared: Any) -> StoredPoses:
    """True poses in memory, as a file would declare them."""
    return StoredPoses("gt.npz", MemoryArray(np.asarray(truth() if array is None else array)), **declared)


def ids(*names: object) -> Any:
    """Frame ids."""
    return np.array([str(name) for name in names])


def same(data: PoseData, other: PoseData, *, but: tuple[str, ...] = ("names", "remarks")) -> None:
    """Check that everything in two is alike."""
    np.testing.assert_array_equal(coordinates(data), coordinates(other))
    for name, value in vars(data).items():
        if name not in ("hypotheses", "reference", *but):
            np.testing.assert_equal(value, vars(other)[name], err_msg=name)
