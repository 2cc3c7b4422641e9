"""Which keypoints were seen in which image? What an estimator is asked with, where nobody knows the poses.

Keypoints are in pixels, x to the right, y down; they are joined to an estimator's by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.data.skeleton import canonical_name
from posecal.errors import PoseDataError, PoseFileError, first_few, raise_all
from posecal_models.data.npz import Members, flags_of, joint_names, labels, read_npz, real_numbers

__all__ = ["Flags", "Floats", "KeypointSet", "Text"]

Floats = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]
Text = npt.NDArray[np.str_]


@dataclass(frozen=True)
class KeypointSet:
    """Keypoints of M images, without their poses.

    Attributes
    ----------
    joints : tuple of str
        J names.
    keypoints : ndarray
        (M, J, 2), pixels.
    observed : ndarray
        (M, J), bool.
    sigma : ndarray
        (M, J), pixels.
    frame_id : ndarray of str
        (M,).
    """

    joints: tuple[str, ...]
    keypoints: Floats
    observed: Flags
    sigma: Floats
    frame_id: Text

    @classmethod
    def load(cls, path: str | Path) -> KeypointSet:
        """Read keypoints from an ``.npz``.

        Parameters
        ----------
        path : str or Path
            With ``keypoints_2d`` (M, J, 2) in pixels and ``keypoint_joints`` or ``joints``. Which are observed comes
            from ``keypoints_observed``; else from ``occluded``, whose columns are the ``joints``; else every finite one
            is.

        Returns
        -------
        KeypointSet
            What it holds.

        Raises
        ------
        PoseFileError, PoseDataError
            Where the file can't be read or lacks something.
        """
        return cls.of_members(read_npz(path, required=("keypoints_2d",)), path)

    @classmethod
    def of_members(cls, members: Members, path: str | Path) -> KeypointSet:
        """Take keypoints out of the members of a file that was read."""
        keypoints = real_numbers(members["keypoints_2d"], f"{path}: keypoints_2d").astype(np.float32)
        named = members.get("keypoint_joints", members.get("joints"))
        if named is None:
            raise PoseFileError(
                f"{path}: lacks keypoint_joints; expected the names of the {keypoints.shape[1:2]} keypoints."
            )
        names = joint_names(named, f"{path}: names of the keypoints")
        if keypoints.ndim != 3 or keypoints.shape[1:] != (len(names), 2):
            raise PoseDataError(
                f"{path}: keypoints_2d {keypoints.shape}; expected (M, {len(names)}, 2), one row for each of "
                f"{first_few(names)}."
            )
        observed: Flags = np.asarray(np.isfinite(keypoints).all(-1))
        if "keypoints_observed" in members:
            observed = flags_of(members["keypoints_observed"], f"{path}: keypoints_observed")
        elif "occluded" in members and "joints" in members:
            hidden = flags_of(members["occluded"], f"{path}: occluded")
            hidden_joints = joint_names(members["joints"], f"{path}: joints")
            column = {canonical_name(name): k for k, name in enumerate(hidden_joints)}
            if hidden.shape != (len(keypoints), len(column)):
                raise PoseDataError(f"{path}: occluded {hidden.shape}; expected {(len(keypoints), len(column))}.")
            for j, name in enumerate(names):
                if canonical_name(name) in column:
                    observed[:, j] &= ~hidden[:, column[canonical_name(name)]]
        sigma = real_numbers(
            members.get("keypoints_sigma", np.zeros(keypoints.shape[:2])), f"{path}: keypoints_sigma"
        ).astype(np.float32)
        frame_id = labels(members.get("frame_id", np.arange(len(keypoints))), f"{path}: frame_id", keypoints.shape[:1])
        problems = [
            f"{path}: {name} {array.shape}; expected {shape}."
            for name, array, shape in (
                ("keypoints_observed", observed, keypoints.shape[:2]),
                ("keypoints_sigma", sigma, keypoints.shape[:2]),
            )
            if array.shape != shape
        ]
        raise_all(problems)
        return cls(names, keypoints, observed, sigma, frame_id)

    def __len__(self) -> int:
        return len(self.keypoints)

    def lacking(self, joints: Sequence[str]) -> list[str]:
        """Name the keypoints that an estimator reads and that are not there.

        Parameters
        ----------
        joints : sequence of str
            The names wanted.

        Returns
        -------
        list of str
            Those of them that would count as missing in every image.
        """
        known = {canonical_name(name) for name in self.joints}
        return [name for name in joints if canonical_name(name) not in known]

    def in_order_of(self, joints: Sequence[str]) -> KeypointSet:
        """Bring the keypoints into an estimator's order, by name.

        Parameters
        ----------
        joints : sequence of str
            The names wanted, in order.

        Returns
        -------
        KeypointSet
            With these keypoints; one that is not there is NaN and not observed.

        Raises
        ------
        PoseDataError
            Where none is there.
        """
        index = {canonical_name(name): i for i, name in enumerate(self.joints)}
        found = [index.get(canonical_name(name), -1) for name in joints]
        there = np.array(found) >= 0
        if not there.any():
            raise PoseDataError(f"keypoints: none of {', '.join(joints)} is among {', '.join(self.joints)}.")
        return KeypointSet(
            tuple(joints),
            np.where(there[:, None], self.keypoints[:, found], np.float32(np.nan)),
            self.observed[:, found] & there,
            np.where(there, self.sigma[:, found], np.float32(np.nan)),
            self.frame_id,
        )
