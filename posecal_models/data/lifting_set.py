"""Which 3D poses belong to which 2D keypoints? The pairs that estimators are trained and judged on.

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

from posecal.data.skeleton import canonical_name
from posecal.data.units import millimetres_per
from posecal.data.write import write_file
from posecal.errors import PoseDataError, PoseFileError, raise_all
from posecal_models.data.keypoint_set import Flags, Floats, KeypointSet, Text
from posecal_models.data.npz import Members, flags_of, joint_names, labels, read_npz, stored_poses, word
from posecal_models.data.sizes import check_millimetres

__all__ = ["LiftingSet"]


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
    occluded : ndarray or None
        (M, K), bool: joints that a file says were hidden; those without an observed keypoint where it says nothing.

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
        """What an estimator is asked with: the keypoints without the poses."""
        return KeypointSet(self.keypoint_joints, self.keypoints, self.observed, self.sigma, self.frame_id)

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
        taken: dict[str, Any] = {name: part[rows] for name, part in parts.items() if isinstance(part, np.ndarray)}
        return replace(self, **taken)

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
            hidden = None if self.occluded is None else self.occluded[:, columns]
            result = replace(result, joints=tuple(joints), poses=self.poses[:, columns], occluded=hidden)
        if keypoint_joints is not None:
            seen = self.images.in_order_of(keypoint_joints)
            result = replace(
                result,
                keypoint_joints=seen.joints,
                keypoints=seen.keypoints,
                observed=seen.observed,
                sigma=seen.sigma,
            )
        return result

    def save(self, path: str | Path) -> None:
        """Write an ``.npz`` that is ground truth for ``posecal evaluate`` and input of ``posecal-models sample``.

        The root comes first, at 0; keypoints are in the joints' order, NaN and not observed where there is none.

        Parameters
        ----------
        path : str or Path
            Where to. The file appears whole or not at all.

        Raises
        ------
        PoseFileError
            Where it can't be written.
        """
        joints = (self.root, *self.joints)
        seen = self.in_order_of(keypoint_joints=joints)
        members = {
            "truth": np.pad(seen.poses, ((0, 0), (1, 0), (0, 0))),
            "axes": np.array("MKD"),
            "unit": np.array("mm"),
            "joints": np.array(joints),
            "occluded": np.pad(~seen.observed[:, 1:] if self.occluded is None else self.occluded, ((0, 0), (1, 0))),
            "keypoints_2d": seen.keypoints,
            "keypoints_sigma": seen.sigma,
            "keypoints_observed": seen.observed,
            **{name: getattr(self, name) for name in ("frame_id", "sequence", "subject", "action", "camera")},
        }
        write_file(path, lambda file: np.savez(file, **members))

    @classmethod
    def load(cls, path: str | Path) -> LiftingSet:
        """Read a file of :meth:`save`, or any ground truth file that holds ``keypoints_2d``.

        Parameters
        ----------
        path : str or Path
            An ``.npz`` with ``truth`` (or ``gt``) and ``joints`` beside the members of :meth:`KeypointSet.load`.
            ``axes`` is its layout, MKD where the file doesn't say, and ``unit`` its unit, mm where it doesn't. Labels
            are used where they are there. Poses without a hip are taken only where ``root_relative`` is true.

        Returns
        -------
        LiftingSet
            The pairs, root-relative and without the root.

        Raises
        ------
        PoseFileError, PoseDataError
            Where the file can't be read or lacks something, or where its poses look like metres in what should be mm.
        """
        members = read_npz(path, required=("keypoints_2d", "joints"))
        name = "truth" if "truth" in members else "gt"
        if name not in members:
            raise PoseFileError(f"{path}: lacks truth; it holds {', '.join(sorted(members))}.")
        joints = joint_names(members["joints"], f"{path}: joints")
        seen = KeypointSet.of_members(members, path)
        truth = stored_poses(members, name, joints, path) * millimetres_per(word(members, "unit", path, "mm"))
        check_millimetres(truth, f"{path}: {name}", "Store unit = 'm' in it.")
        root = next((k for k, name in enumerate(joints) if canonical_name(name) == "Hip"), None)
        if root is not None:
            truth = np.delete(truth - truth[:, root : root + 1], root, axis=1)
        elif not _is_true(members, "root_relative"):
            raise PoseDataError(
                f"{path}: no joint Hip among {', '.join(joints)}: the poses can't be made relative to it. Store the "
                "hip too, or poses relative to it with a member root_relative = True."
            )
        many = (len(truth),)
        told = {
            label: labels(members[label], f"{path}: {label}", many) if label in members else np.full(many, "")
            for label in ("sequence", "subject", "action", "camera")
        }
        pairs = cls(
            joints=tuple(name for k, name in enumerate(joints) if k != root),
            poses=truth.astype(np.float32),
            keypoint_joints=seen.joints,
            keypoints=seen.keypoints,
            observed=seen.observed,
            sigma=seen.sigma,
            frame_id=seen.frame_id,
            sequence=told["sequence"],
            subject=told["subject"],
            action=told["action"],
            camera=told["camera"],
        )
        if "occluded" not in members:
            return pairs
        hidden = flags_of(members["occluded"], f"{path}: occluded")
        if hidden.shape != (len(truth), len(joints)):
            raise PoseDataError(f"{path}: occluded {hidden.shape}; expected {(len(truth), len(joints))}.")
        hidden = hidden if root is None else np.delete(hidden, root, axis=1)
        told_by_keypoints = np.array_equal(hidden, ~pairs.in_order_of(keypoint_joints=pairs.joints).observed)
        return pairs if told_by_keypoints else replace(pairs, occluded=hidden)


def _columns(have: Sequence[str], want: Sequence[str], which: str) -> list[int]:
    index = {canonical_name(name): i for i, name in enumerate(have)}
    missing = [name for name in want if canonical_name(name) not in index]
    if missing:
        raise PoseDataError(
            f"{which}: {', '.join(missing)} missing among {', '.join(have)}; expected {', '.join(want)}."
        )
    return [index[canonical_name(name)] for name in want]


def _is_true(members: Members, name: str) -> bool:
    return name in members and members[name].size > 0 and bool(flags_of(members[name], name).all())
