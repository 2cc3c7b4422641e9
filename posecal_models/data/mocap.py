"""Motion capture without images: poses in world coordinates, projected into virtual cameras.

A file of poses is an ``.npz`` with ``poses`` (M, K, 3) in world coordinates with z up, ``joints``, ``unit``,
``subject`` and ``clip_id``; optional are ``frame``, ``description`` and ``axes``, the layout of ``poses``. A clip is
identified by subject and ``clip_id``: two people may have clips of the same name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from posecal.data.joint_names import joint_keys
from posecal.data.skeleton import Skeleton
from posecal.data.units import millimetres_per
from posecal.errors import PoseDataError
from posecal_models.data.bones import Bones
from posecal_models.data.cameras import cameras_around
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.npz import joint_names, pose_array, read_npz, text_array, text_value
from posecal_models.data.unit_checks import check_millimetres

__all__ = ["MocapPoses", "vary_bone_lengths"]


class MocapPoses:
    """Motion capture poses in world coordinates.

    Parameters
    ----------
    path : str or Path
        An ``.npz`` as described in this module.

    Attributes
    ----------
    joints : tuple of str
        K names, the root included.
    poses : ndarray
        (M, K, 3), mm, z up.
    subject, clip, frame, description : ndarray of str
        (M,) labels.
    sequence : ndarray of str
        (M,): the clip's name, with the subject's name and a slash before it where people share names of clips.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file can't be read, a pose is not finite, two frames of a clip have the same name, labels are missing,
        or poses look like metres where mm are expected.
    """

    def __init__(self, path: str | Path) -> None:
        members = read_npz(path, required=("poses", "joints", "unit", "subject", "clip_id"))
        self.joints = joint_names(members["joints"], f"{path}: joints")
        poses = pose_array(members, "poses", self.joints, path) * millimetres_per(
            text_value(members, "unit", path, "mm")
        )
        if Skeleton(self.joints).root is None:
            raise PoseDataError(f"{path}: no Hip among {', '.join(self.joints)}; expected the root among the joints.")
        if (up := text_value(members, "up", path, "z")) != "z":
            raise PoseDataError(f"{path}: up is {up}; expected z. Rotate the poses.")
        check_millimetres(poses, f"{path}: poses", "Store unit = 'm' in it.")
        shape = (len(poses),)
        subject = text_array(members["subject"], f"{path}: subject", shape)
        self.poses = poses
        self.subject = np.array([f"S{s.lstrip('0') or '0'}" if s.isdecimal() else s for s in subject.tolist()], np.str_)
        self.clip = text_array(members["clip_id"], f"{path}: clip_id", shape)
        self.frame = text_array(members.get("frame", np.arange(len(poses))), f"{path}: frame", shape)
        self.description = text_array(members.get("description", self.clip), f"{path}: description", shape)
        self.sequence = self._sequences()
        self._check_frames(path)

    def _sequences(self) -> npt.NDArray[np.str_]:
        clips = set(zip(self.subject.tolist(), self.clip.tolist(), strict=True))
        if len(clips) == len({name for _, name in clips}):
            return self.clip
        return np.array([f"{s}/{c}" for s, c in zip(self.subject.tolist(), self.clip.tolist(), strict=True)])

    def _check_frames(self, path: str | Path) -> None:
        broken = ~np.isfinite(self.poses).all(-1)
        if broken.any():
            row, joint = (int(index) for index in np.argwhere(broken)[0])
            raise PoseDataError(
                f"{path}: poses are not finite in {int(broken.any(-1).sum()):,} of {len(self.poses):,} frames (first: "
                f"clip {self.sequence[row]}, frame {self.frame[row]}, joint {self.joints[joint]}). Leave them out."
            )
        counts = Counter(zip(self.sequence.tolist(), self.frame.tolist(), strict=True))
        if repeated := [names for names, count in counts.items() if count > 1]:
            raise PoseDataError(
                f"{path}: {len(repeated):,} frames occur more than once (first: clip {repeated[0][0]}, frame "
                f"{repeated[0][1]}); expected each frame of a clip once. Number them."
            )

    def project(
        self,
        *,
        views: int = 4,
        every: int = 1,
        subjects: Iterable[str] | None = None,
        exclude: Iterable[str] = (),
        body_variation: float = 0.0,
        seed: int = 0,
    ) -> LiftingSet:
        """Project the poses into virtual cameras around each clip.

        Parameters
        ----------
        views : int
            Cameras around each clip.
        every : int
            Frame step: every n-th frame of a clip is used.
        subjects, exclude : iterable of str, optional
            Subjects to use, default all, and subjects to leave out.
        body_variation : float
            Standard deviation of the log of each bone's length. Above 0 every pose has other bone lengths: with few
            people in the training set an estimator overfits to their bones. 0: bone lengths as captured.
        seed : int
            Seed of the camera positions; those of a clip depend only on the seed and the clip's name (in ``sequence``).

        Returns
        -------
        LiftingSet
            Poses in the cameras' frames with exact keypoints, all observed.

        Raises
        ------
        PoseDataError
            Where no pose is left, or a subject is unknown.
        """
        known = set(self.subject.tolist())
        selected = (known if subjects is None else set(subjects)) - set(exclude)
        named = (set() if subjects is None else set(subjects)) | set(exclude)
        if missing := sorted(named - known):
            raise PoseDataError(
                f"subjects: {', '.join(missing)} not there; expected some of {', '.join(sorted(known))}."
            )
        root = joint_keys(self.joints).index("Hip")
        others = [k for k in range(len(self.joints)) if k != root]
        all_rows: list[npt.NDArray[np.intp]] = []
        poses, keypoints, cameras = [], [], []
        for subject, clip in dict.fromkeys(zip(self.subject.tolist(), self.clip.tolist(), strict=True)):
            if subject not in selected:
                continue
            rows = np.flatnonzero((self.clip == clip) & (self.subject == subject))
            generator = np.random.default_rng([seed, *str(self.sequence[rows[0]]).encode(errors="surrogatepass")])
            clip_cameras = cameras_around(self.poses[rows, root], generator, views=views)
            rows = rows[::every]
            for index, camera in enumerate(clip_cameras):
                all_rows.append(rows)
                in_world = self.poses[rows]
                if body_variation > 0:
                    in_world = vary_bone_lengths(in_world, self.joints, body_variation, generator)
                relative = in_world - in_world[:, root, None]
                poses.append(camera.rotate(relative)[:, others].astype(np.float32))
                keypoints.append(camera.project(in_world)[:, others].astype(np.float32))
                cameras += [str(index)] * len(rows)
        if not all_rows:
            raise PoseDataError(f"subjects: none of {', '.join(sorted(known))} is left.")
        rows = np.concatenate(all_rows)
        names = tuple(self.joints[k] for k in others)
        camera_names = np.array(cameras)
        return LiftingSet(
            joints=names,
            poses=np.concatenate(poses),
            keypoint_joints=names,
            keypoints=np.concatenate(keypoints),
            observed=np.ones((len(rows), len(others)), bool),
            sigma=np.zeros((len(rows), len(others)), np.float32),
            frame_id=np.array(
                [f"{c}/{f}/{v}" for c, f, v in zip(self.sequence[rows], self.frame[rows], cameras, strict=True)]
            ),
            sequence=self.sequence[rows],
            subject=self.subject[rows],
            action=self.description[rows],
            camera=camera_names,
            root=self.joints[root],
        )


def vary_bone_lengths(
    poses: npt.NDArray[np.float64], joints: Sequence[str], spread: float, generator: np.random.Generator
) -> npt.NDArray[np.float64]:
    r"""Vary the bone lengths of every pose, keeping the directions of the bones.

    .. math:: l'_b = l_b \exp\left( s \, (z + z_b) / \sqrt 2 \right)

    with one z for the person and one for each bone, left and right alike.

    Parameters
    ----------
    poses : ndarray
        (M, K, 3), mm.
    joints : sequence of str
        K names, the root included.
    spread : float
        s, the standard deviation of the log of a bone's length.
    generator : numpy.random.Generator
        The source of randomness.

    Returns
    -------
    ndarray
        (M, K, 3), mm, with the root unchanged.

    Examples
    --------
    >>> leg = np.array([[[0.0, 0, 900], [0, 0, 450], [0, 0, 0]]])
    >>> other = vary_bone_lengths(leg, ("Hip", "RKnee", "RFoot"), 0.1, np.random.default_rng(0))
    >>> bool(other[0, :, :2].any()), float(other[0, 0, 2])  # straight as before, with the hip in place
    (False, 900.0)
    """
    bones = Bones(joints)
    normal = generator.standard_normal((len(poses), bones.kinds)) + generator.standard_normal((len(poses), 1))
    factor = np.exp(spread * normal / np.sqrt(2))
    return bones.stretch(torch.from_numpy(poses), torch.from_numpy(factor)).numpy()
