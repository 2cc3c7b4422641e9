"""Which 3D poses belong to which 2D keypoints? The pairs that estimators are trained and judged on, in memory and in files.

Poses are in millimetres, relative to the root, in the camera's frame: x to the right, y down, z away from the camera.
Keypoints are in pixels, x to the right, y down. One row is one person in one image.
"""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError, PoseFileError, raise_all
from posecal.skeleton import canonical_name
from posecal.units import millimetres_per

__all__ = ["LiftingSet", "Text"]

Floats = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]
Text = npt.NDArray[np.str_]


@dataclass(frozen=True)
class LiftingSet:
    """M poses with their keypoints and labels.

    Attributes
    ----------
    joints : tuple of str
        K names of the poses' joints, the root left out.
    poses : ndarray
        (M, K, 3), mm, relative to the root, camera frame.
    keypoint_joints : tuple of str
        J names of the keypoints.
    keypoints : ndarray
        (M, J, 2), pixels.
    observed : ndarray
        (M, J), bool: which keypoints an estimator may use.
    sigma : ndarray
        (M, J), pixels: the detector's standard deviation.
    frame_id, sequence, subject, action, camera : ndarray of str
        (M,) labels.
    root : str
        The joint that poses are relative to.

    Raises
    ------
    PoseDataError
        Where shapes don't fit together.
    """

    joints: tuple[str, ...]
    poses: Floats
    keypoint_joints: tuple[str, ...]
    keypoints: Floats
    observed: Flags
    sigma: Floats
    frame_id: Text
    sequence: Text
    subject: Text
    action: Text
    camera: Text
    root: str = "Hip"

    def __post_init__(self) -> None:
        many, joints, keypoints = len(self.poses), len(self.joints), len(self.keypoint_joints)
        expected = {
            "poses": (many, joints, 3),
            "keypoints": (many, keypoints, 2),
            "observed": (many, keypoints),
            "sigma": (many, keypoints),
            **dict.fromkeys(("frame_id", "sequence", "subject", "action", "camera"), (many,)),
        }
        raise_all(
            f"{name} {getattr(self, name).shape}: expected {shape} (M={many}, K={joints}, J={keypoints})."
            for name, shape in expected.items()
            if getattr(self, name).shape != shape
        )
        if self.root in self.joints:
            raise PoseDataError(f"joints: {self.root} is the root of these poses; leave it out.")

    def __len__(self) -> int:
        return len(self.poses)

    def take(self, rows: npt.NDArray[np.bool_] | npt.NDArray[np.intp] | slice) -> LiftingSet:
        """Take some of the poses.

        Parameters
        ----------
        rows : ndarray or slice
            Which, as a mask, as indices or as a slice.

        Returns
        -------
        LiftingSet
            Those poses.
        """
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{name: part[rows] for name, part in parts.items() if isinstance(part, np.ndarray)})

    def in_order_of(
        self, joints: Sequence[str] | None = None, keypoint_joints: Sequence[str] | None = None
    ) -> LiftingSet:
        """Bring joints and keypoints into an estimator's order, by name.

        Parameters
        ----------
        joints, keypoint_joints : sequence of str, optional
            The names wanted, in order; as they are where not given. A keypoint that is not there counts as missing.

        Returns
        -------
        LiftingSet
            With these joints and keypoints.

        Raises
        ------
        PoseDataError
            Where a joint is not there.
        """
        result = self
        if joints is not None:
            columns = _columns(self.joints, joints, "joints")
            result = replace(result, joints=tuple(joints), poses=self.poses[:, columns])
        if keypoint_joints is not None:
            index = {canonical_name(name): i for i, name in enumerate(self.keypoint_joints)}
            found = [index.get(canonical_name(name), -1) for name in keypoint_joints]
            if all(i < 0 for i in found):
                raise PoseDataError(
                    f"keypoints: none of {', '.join(keypoint_joints)} is among {', '.join(self.keypoint_joints)}."
                )
            there = np.array([i >= 0 for i in found])
            result = replace(
                result,
                keypoint_joints=tuple(keypoint_joints),
                keypoints=np.where(there[:, None], self.keypoints[:, found], 0),
                observed=self.observed[:, found] & there,
                sigma=self.sigma[:, found],
            )
        return result

    def save(self, path: str | Path) -> None:
        """Write an ``.npz`` that is ground truth for ``posecal evaluate`` and input of ``posecal-models sample``.

        Parameters
        ----------
        path : str or Path
            Where to. The file appears whole or not at all.

        Raises
        ------
        PoseFileError
            Where it can't be written.
        """
        index = {canonical_name(name): i for i, name in enumerate(self.keypoint_joints)}
        seen = [index.get(canonical_name(name), -1) for name in self.joints]
        hidden = ~self.observed[:, seen] | (np.array(seen) < 0)
        root_first = np.concatenate([np.zeros_like(self.poses[:, :1]), self.poses], axis=1)
        members = {
            "truth": root_first.astype(np.float32),
            "axes": np.array("MKD"),
            "unit": np.array("mm"),
            "joints": np.array([self.root, *self.joints]),
            "occluded": np.concatenate([np.zeros_like(hidden[:, :1]), hidden], axis=1),
            "keypoints_2d": self.keypoints,
            "keypoints_sigma": self.sigma,
            "keypoints_observed": self.observed,
            "keypoint_joints": np.array(self.keypoint_joints),
            **{name: getattr(self, name) for name in ("frame_id", "sequence", "subject", "action", "camera")},
        }
        write_npz(path, members)

    @classmethod
    def load(cls, path: str | Path) -> LiftingSet:
        """Read a file of :meth:`save`, or any ground truth file that holds ``keypoints_2d``.

        Parameters
        ----------
        path : str or Path
            An ``.npz`` with ``truth`` and ``keypoints_2d``; ``keypoints_sigma``, ``keypoints_observed`` (else:
            not ``occluded``), ``keypoint_joints`` (else: ``joints``) and the labels are used where they are there.

        Returns
        -------
        LiftingSet
            The pairs, root-relative and without the root.

        Raises
        ------
        PoseFileError, PoseDataError
            Where the file can't be read or lacks something.
        """
        members = read_npz(path, required=("truth", "keypoints_2d", "joints", "unit"))
        joints = tuple(str(name) for name in members["joints"])
        truth = np.asarray(members["truth"], np.float64) * millimetres_per(str(members["unit"]))
        root = next((k for k, name in enumerate(joints) if canonical_name(name) == "Hip"), None)
        if root is not None:
            truth = np.delete(truth - truth[:, root : root + 1], root, axis=1)
        names = tuple(str(name) for name in members.get("keypoint_joints", members["joints"]))
        keypoints = np.asarray(members["keypoints_2d"], np.float32)
        many = len(truth)
        observed = members.get("keypoints_observed")
        if observed is None:
            occluded = members.get("occluded", np.zeros(keypoints.shape[:2], bool))
            observed = ~occluded if occluded.shape == keypoints.shape[:2] else np.ones(keypoints.shape[:2], bool)
        empty = np.full(many, "")
        return cls(
            joints=tuple(name for k, name in enumerate(joints) if k != root),
            poses=truth.astype(np.float32),
            keypoint_joints=names,
            keypoints=keypoints,
            observed=np.asarray(observed, bool),
            sigma=np.asarray(members.get("keypoints_sigma", np.zeros(keypoints.shape[:2])), np.float32),
            frame_id=members.get("frame_id", np.arange(many).astype(str)).astype(str),
            **{name: members.get(name, empty).astype(str) for name in ("sequence", "subject", "action", "camera")},
        )


def _columns(have: Sequence[str], want: Sequence[str], which: str) -> list[int]:
    index = {canonical_name(name): i for i, name in enumerate(have)}
    missing = [name for name in want if canonical_name(name) not in index]
    if missing:
        raise PoseDataError(
            f"{which}: {', '.join(missing)} missing among {', '.join(have)}; expected {', '.join(want)}."
        )
    return [index[canonical_name(name)] for name in want]


def read_npz(path: str | Path, *, required: Sequence[str] = ()) -> dict[str, npt.NDArray[np.generic]]:
    """Read the members of an ``.npz`` file without ever unpickling.

    Parameters
    ----------
    path : str or Path
        The file.
    required : sequence of str
        Members that must be there.

    Returns
    -------
    dict of str to ndarray
        All members.

    Raises
    ------
    PoseFileError
        Where the file is missing, damaged, pickled or lacks a member.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            members = {name: file[name] for name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError, AttributeError) as problem:
        what = "is not there" if not path.exists() else f"can't be read as .npz ({problem})"
        raise PoseFileError(f"{path}: {what}; expected an .npz of plain arrays.") from problem
    missing = [name for name in required if name not in members]
    if missing:
        raise PoseFileError(
            f"{path}: lacks {', '.join(missing)}; it holds {', '.join(sorted(members)) or 'nothing'}."
        )
    return members


def write_npz(path: str | Path, members: dict[str, npt.NDArray[np.generic]]) -> None:
    """Write an ``.npz`` file whole or not at all.

    Parameters
    ----------
    path : str or Path
        Where to.
    members : dict of str to ndarray
        What.

    Raises
    ------
    PoseFileError
        Where it can't be written.
    """
    path = Path(path)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(file, **members)  # type: ignore[arg-type]
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as problem:
        raise PoseFileError(f"{path}: can't be written ({problem.strerror}).") from problem
