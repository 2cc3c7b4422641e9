"""How do motion captures without images become training data? Poses in a room, seen by virtual cameras.

A file of poses is an ``.npz`` with ``poses`` (M, K, 3) in a room with z up, ``joints``, ``unit``, ``subject`` and
``clip_id``; ``frame`` and ``description`` are used where they are there.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError
from posecal.skeleton import canonical_name
from posecal.units import millimetres_per
from posecal_models.data.cameras import cameras_around
from posecal_models.data.lifting_set import LiftingSet, read_npz

__all__ = ["MocapPoses"]


class MocapPoses:
    """Poses of people in a room.

    Parameters
    ----------
    path : str or Path
        An ``.npz`` as this module describes.

    Attributes
    ----------
    joints : tuple of str
        K names, the root among them.
    poses : ndarray
        (M, K, 3), mm, z up.
    subject, clip, frame, description : ndarray of str
        (M,) labels.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file can't be read, or is no such file.
    """

    def __init__(self, path: str | Path) -> None:
        members = read_npz(path, required=("poses", "joints", "unit", "subject", "clip_id"))
        self.joints = tuple(str(name) for name in members["joints"])
        poses = np.asarray(members["poses"], np.float64) * millimetres_per(str(members["unit"]))
        if poses.ndim != 3 or poses.shape[1:] != (len(self.joints), 3):
            raise PoseDataError(f"{path}: poses {poses.shape}; expected (M, {len(self.joints)}, 3).")
        if not any(canonical_name(name) == "Hip" for name in self.joints):
            raise PoseDataError(f"{path}: no Hip among {', '.join(self.joints)}; expected the root among the joints.")
        if str(members.get("up", "z")) != "z":
            raise PoseDataError(f"{path}: up is {members['up']}; expected z. Turn the poses.")
        self.poses = poses
        self.subject = np.array([f"S{int(s)}" if str(s).isdigit() else str(s) for s in members["subject"]])
        self.clip = members["clip_id"].astype(str)
        self.frame = members.get("frame", np.arange(len(poses))).astype(str)
        self.description = members.get("description", self.clip).astype(str)

    def seen_by_cameras(
        self,
        *,
        views: int = 4,
        every: int = 1,
        subjects: Iterable[str] | None = None,
        but_not: Iterable[str] = (),
        seed: int = 0,
    ) -> LiftingSet:
        """Project the poses into cameras that stand around each clip.

        Parameters
        ----------
        views : int
            Cameras around each clip.
        every : int
            Only every so manieth frame of a clip.
        subjects, but_not : iterable of str, optional
            Only these subjects, and none of those.
        seed : int
            Where the cameras stand; a clip's cameras depend on the seed and the clip's name alone.

        Returns
        -------
        LiftingSet
            Poses in the cameras' frames with keypoints where the joints are: no noise, all observed.

        Raises
        ------
        PoseDataError
            Where no pose is left, or a subject is not there.
        """
        known = set(self.subject.tolist())
        wanted = (known if subjects is None else set(subjects)) - set(but_not)
        unknown = (set() if subjects is None else set(subjects)) | set(but_not)
        if missing := sorted(unknown - known):
            raise PoseDataError(f"subjects: {', '.join(missing)} not there; there are {', '.join(sorted(known))}.")
        root = next(k for k, name in enumerate(self.joints) if canonical_name(name) == "Hip")
        rest = [k for k in range(len(self.joints)) if k != root]
        chosen: list[npt.NDArray[np.intp]] = []
        poses, keypoints, cameras = [], [], []
        for clip in dict.fromkeys(self.clip.tolist()):
            rows = np.flatnonzero(self.clip == clip)
            if self.subject[rows[0]] not in wanted:
                continue
            generator = np.random.default_rng([seed, *clip.encode()])
            around = cameras_around(self.poses[rows, root], generator, views=views)
            rows = rows[::every]
            for index, camera in enumerate(around):
                chosen.append(rows)
                relative = self.poses[rows] - self.poses[rows, root][:, None]
                poses.append(camera.turn(relative)[:, rest].astype(np.float32))
                keypoints.append(camera.project(self.poses[rows])[:, rest].astype(np.float32))
                cameras += [str(index)] * len(rows)
        if not chosen:
            raise PoseDataError(f"subjects: none of {', '.join(sorted(known))} is left.")
        rows = np.concatenate(chosen)
        names = tuple(self.joints[k] for k in rest)
        camera_names = np.array(cameras)
        return LiftingSet(
            joints=names,
            poses=np.concatenate(poses),
            keypoint_joints=names,
            keypoints=np.concatenate(keypoints),
            observed=np.ones((len(rows), len(rest)), bool),
            sigma=np.zeros((len(rows), len(rest)), np.float32),
            frame_id=np.array(
                [f"{c}/{f}/{v}" for c, f, v in zip(self.clip[rows], self.frame[rows], cameras, strict=True)]
            ),
            sequence=self.clip[rows],
            subject=self.subject[rows],
            action=self.description[rows],
            camera=camera_names,
            root=self.joints[root],
        )
