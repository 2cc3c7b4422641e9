"""Pairs of 3D poses and 2D keypoints, for training and evaluation.

Poses are in millimetres, relative to the root, in the camera's frame: x to the right, y down, z away from the camera.
Keypoints are in pixels, x to the right, y down. One row is one person in one image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.joint_names import match_joints
from posecal.data.skeleton import Skeleton
from posecal.data.units import millimetres_per
from posecal.data.write import write_file, write_members
from posecal.errors import PoseDataError, PoseFileError, raise_all
from posecal_models.data.keypoint_set import Flags, Floats, KeypointSet, Text
from posecal_models.data.npz import Members, boolean_array, joint_names, pose_array, read_npz, text_array, text_value
from posecal_models.data.unit_checks import check_millimetres

__all__ = ["LiftingSet"]


@dataclass(frozen=True)
class LiftingSet:
    """M poses with their keypoints and labels.

    Attributes
    ----------
    joints : tuple of str
        K names of the poses' joints, without the root.
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
    occluded : ndarray or None
        (M, K), bool: hidden joints as declared by a file; where None, those without an observed keypoint.

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
    occluded: Flags | None = None

    def __post_init__(self) -> None:
        many, joints, keypoints = len(self.poses), len(self.joints), len(self.keypoint_joints)
        expected = {
            "poses": (many, joints, 3),
            "keypoints": (many, keypoints, 2),
            "observed": (many, keypoints),
            "sigma": (many, keypoints),
            **dict.fromkeys(("frame_id", "sequence", "subject", "action", "camera"), (many,)),
        }
        if self.occluded is not None:
            expected["occluded"] = (many, joints)
        raise_all(
            f"{name} {getattr(self, name).shape}: expected {shape} (M={many}, K={joints}, J={keypoints})."
            for name, shape in expected.items()
            if getattr(self, name).shape != shape
        )
        if self.root in self.joints:
            raise PoseDataError(f"joints: {self.root} is the root of these poses; leave it out.")

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def images(self) -> KeypointSet:
        """The keypoints without the poses, the input of sampling."""
        return KeypointSet(self.keypoint_joints, self.keypoints, self.observed, self.sigma, self.frame_id)

    def take(self, rows: npt.NDArray[np.bool_] | npt.NDArray[np.intp] | slice) -> LiftingSet:
        """Select poses.

        Parameters
        ----------
        rows : ndarray or slice
            A mask, indices or a slice.

        Returns
        -------
        LiftingSet
            The selected poses.
        """
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        arrays: dict[str, Any] = {name: value[rows] for name, value in values.items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)

    def in_order_of(
        self, joints: Sequence[str] | None = None, keypoint_joints: Sequence[str] | None = None
    ) -> LiftingSet:
        """Reorder joints and keypoints by name.

        Parameters
        ----------
        joints, keypoint_joints : sequence of str, optional
            The names, in the new order; unchanged where not given. Keypoints that the set lacks count as missing.

        Returns
        -------
        LiftingSet
            With these joints and keypoints.

        Raises
        ------
        PoseDataError
            Where the set lacks a joint.
        """
        result = self
        if joints is not None:
            columns = _columns(self.joints, joints, "joints")
            occluded = None if self.occluded is None else self.occluded[:, columns]
            result = replace(result, joints=tuple(joints), poses=self.poses[:, columns], occluded=occluded)
        if keypoint_joints is not None:
            images = self.images.in_order_of(keypoint_joints)
            result = replace(
                result,
                keypoint_joints=images.joints,
                keypoints=images.keypoints,
                observed=images.observed,
                sigma=images.sigma,
            )
        return result

    def save(self, path: str | Path) -> None:
        """Write an ``.npz`` that is ground truth for ``posecal evaluate`` and input of ``posecal-models sample``.

        The root comes first, at 0; keypoints are in the joints' order, NaN and not observed where missing.

        Parameters
        ----------
        path : str or Path
            Output file, written atomically.

        Raises
        ------
        PoseFileError
            Where it can't be written.
        """
        joints = (self.root, *self.joints)
        ordered = self.in_order_of(keypoint_joints=joints)
        occluded = ~ordered.observed[:, 1:] if self.occluded is None else self.occluded
        members = {
            "truth": np.pad(ordered.poses, ((0, 0), (1, 0), (0, 0))),
            "axes": np.array("MKD"),
            "unit": np.array("mm"),
            "joints": np.array(joints),
            "occluded": np.pad(occluded, ((0, 0), (1, 0))),
            "keypoints_2d": ordered.keypoints,
            "keypoints_sigma": ordered.sigma,
            "keypoints_observed": ordered.observed,
            **{name: getattr(self, name) for name in ("frame_id", "sequence", "subject", "action", "camera")},
        }
        write_file(path, lambda file: write_members(file, members))

    @classmethod
    def load(cls, path: str | Path) -> LiftingSet:
        """Read a file of :meth:`save`, or any ground truth file that holds ``keypoints_2d``.

        Parameters
        ----------
        path : str or Path
            An ``.npz`` with ``truth`` (or ``gt``) and ``joints`` besides the members of :meth:`KeypointSet.load`.
            Optional members: ``axes``, the layout, default MKD; ``unit``, default mm; labels. Poses without a hip need
            ``root_relative = True``.

        Returns
        -------
        LiftingSet
            The pairs, root-relative and without the root.

        Raises
        ------
        PoseFileError, PoseDataError
            Where the file can't be read or lacks a member, or its poses look like metres where mm are expected.
        """
        members = read_npz(path, required=("keypoints_2d", "joints"))
        name = "truth" if "truth" in members else "gt"
        if name not in members:
            raise PoseFileError(f"{path}: lacks truth; it holds {', '.join(sorted(members))}.")
        joints = joint_names(members["joints"], f"{path}: joints")
        images = KeypointSet.from_members(members, path)
        truth = pose_array(members, name, joints, path) * millimetres_per(text_value(members, "unit", path, "mm"))
        check_millimetres(truth, f"{path}: {name}", "Store unit = 'm' in it.")
        root = Skeleton(joints).root
        if root is not None:
            truth = np.delete(truth - truth[:, root : root + 1], root, axis=1)
        elif not _is_true(members, "root_relative"):
            raise PoseDataError(
                f"{path}: no joint Hip among {', '.join(joints)}: the poses can't be made relative to it. Store the "
                "hip too, or poses relative to it with a member root_relative = True."
            )
        shape = (len(truth),)
        labels = {
            name: text_array(members[name], f"{path}: {name}", shape) if name in members else np.full(shape, "")
            for name in ("sequence", "subject", "action", "camera")
        }
        pairs = cls(
            joints=tuple(name for k, name in enumerate(joints) if k != root),
            poses=truth.astype(np.float32),
            keypoint_joints=images.joints,
            keypoints=images.keypoints,
            observed=images.observed,
            sigma=images.sigma,
            frame_id=images.frame_id,
            sequence=labels["sequence"],
            subject=labels["subject"],
            action=labels["action"],
            camera=labels["camera"],
        )
        if "occluded" not in members:
            return pairs
        occluded = boolean_array(members["occluded"], f"{path}: occluded")
        if occluded.shape != (len(truth), len(joints)):
            raise PoseDataError(f"{path}: occluded {occluded.shape}; expected {(len(truth), len(joints))}.")
        occluded = occluded if root is None else np.delete(occluded, root, axis=1)
        follows_keypoints = np.array_equal(occluded, ~pairs.in_order_of(keypoint_joints=pairs.joints).observed)
        return pairs if follows_keypoints else replace(pairs, occluded=occluded)


def _columns(available: Sequence[str], names: Sequence[str], which: str) -> list[int]:
    columns, ambiguous = match_joints(tuple(names), tuple(available))
    missing = ambiguous or [name for k, name in enumerate(names) if k not in columns]
    if missing:
        raise PoseDataError(
            f"{which}: {', '.join(missing)} missing among {', '.join(available)}; expected {', '.join(names)}."
        )
    return [columns[k] for k in range(len(names))]


def _is_true(members: Members, name: str) -> bool:
    return name in members and members[name].size > 0 and bool(boolean_array(members[name], name).all())
