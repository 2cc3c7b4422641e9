"""2D keypoints of images without poses, the input of sampling.

Keypoints are in pixels, x to the right, y down; they are joined to those of an estimator by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.data.joint_names import match_joints
from posecal.errors import PoseDataError, PoseFileError, first_few, raise_all
from posecal_models.data.npz import Members, boolean_array, joint_names, numeric_array, read_npz, text_array

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
        (M, J), bool: which keypoints were detected.
    sigma : ndarray
        (M, J), pixels: the detector's standard deviation.
    frame_id : ndarray of str
        (M,) names of the images.
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
            With ``keypoints_2d`` (M, J, 2) in pixels and ``keypoint_joints`` or ``joints``. Observed are those of
            ``keypoints_observed``; else all but those of ``occluded``, whose columns are the ``joints``; else all that
            are finite.

        Returns
        -------
        KeypointSet
            The keypoints of the file.

        Raises
        ------
        PoseFileError, PoseDataError
            Where the file can't be read or lacks a member.
        """
        return cls.from_members(read_npz(path, required=("keypoints_2d",)), path)

    @classmethod
    def from_members(cls, members: Members, path: str | Path) -> KeypointSet:
        """Build from the members of an ``.npz``."""
        keypoints = numeric_array(members["keypoints_2d"], f"{path}: keypoints_2d").astype(np.float32)
        name_member = members.get("keypoint_joints", members.get("joints"))
        if name_member is None:
            raise PoseFileError(
                f"{path}: lacks keypoint_joints; expected the names of the {keypoints.shape[1:2]} keypoints."
            )
        names = joint_names(name_member, f"{path}: names of the keypoints")
        if keypoints.ndim != 3 or keypoints.shape[1:] != (len(names), 2):
            raise PoseDataError(
                f"{path}: keypoints_2d {keypoints.shape}; expected (M, {len(names)}, 2), one row for each of "
                f"{first_few(names)}."
            )
        observed: Flags = np.asarray(np.isfinite(keypoints).all(-1))
        if "keypoints_observed" in members:
            observed = boolean_array(members["keypoints_observed"], f"{path}: keypoints_observed")
        elif "occluded" in members and "joints" in members:
            hidden = boolean_array(members["occluded"], f"{path}: occluded")
            hidden_joints = joint_names(members["joints"], f"{path}: joints")
            if hidden.shape != (len(keypoints), len(hidden_joints)):
                raise PoseDataError(
                    f"{path}: occluded {hidden.shape}; expected {(len(keypoints), len(hidden_joints))}."
                )
            for j, column in _columns(names, hidden_joints, str(path)).items():
                observed[:, j] &= ~hidden[:, column]
        sigma = numeric_array(
            members.get("keypoints_sigma", np.zeros(keypoints.shape[:2])), f"{path}: keypoints_sigma"
        ).astype(np.float32)
        frame_id = text_array(
            members.get("frame_id", np.arange(len(keypoints))), f"{path}: frame_id", keypoints.shape[:1]
        )
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

    def missing(self, joints: Sequence[str]) -> list[str]:
        """Name the keypoints that an estimator reads and that this set lacks.

        Parameters
        ----------
        joints : sequence of str
            Names of the estimator's keypoints.

        Returns
        -------
        list of str
            Names of those that count as missing in every image.
        """
        known = _columns(joints, self.joints, "keypoints")
        return [name for k, name in enumerate(joints) if k not in known]

    def in_order_of(self, joints: Sequence[str]) -> KeypointSet:
        """Reorder the keypoints by name.

        Parameters
        ----------
        joints : sequence of str
            The names, in the new order.

        Returns
        -------
        KeypointSet
            With these keypoints; those that this set lacks are NaN and not observed.

        Raises
        ------
        PoseDataError
            Where the set has none of them, or names that may mean several.
        """
        known = _columns(joints, self.joints, "keypoints")
        columns = [known.get(k, -1) for k in range(len(joints))]
        available = np.array(columns) >= 0
        if not available.any():
            raise PoseDataError(f"keypoints: none of {', '.join(joints)} is among {', '.join(self.joints)}.")
        return KeypointSet(
            tuple(joints),
            np.where(available[:, None], self.keypoints[:, columns], np.float32(np.nan)),
            self.observed[:, columns] & available,
            np.where(available, self.sigma[:, columns], np.float32(np.nan)),
            self.frame_id,
        )


def _columns(names: Sequence[str], others: Sequence[str], which: str) -> dict[int, int]:
    """Give the numbers of the same joints in ``others``, by those in ``names``."""
    matched, ambiguous = match_joints(tuple(names), tuple(others))
    if ambiguous:
        raise PoseDataError(f"{which}: {first_few(ambiguous)}; expected names that mean one joint.")
    return matched
