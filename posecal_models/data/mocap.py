"""How do motion captures without images become training data? Poses in a room, seen by virtual cameras.

A file of poses is an ``.npz`` with ``poses`` (M, K, 3) in a room with z up, ``joints``, ``unit``, ``subject`` and
``clip_id``; ``frame`` and ``description`` are used where they are there, and ``axes`` is the layout of ``poses``. What
one subject has under one ``clip_id`` is a clip: two people may have clips of the same name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.data.skeleton import Skeleton, canonical_name
from posecal.data.units import millimetres_per
from posecal.errors import PoseDataError
from posecal_models.data.cameras import cameras_around
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.npz import joint_names, labels, read_npz, stored_poses, word
from posecal_models.data.sizes import check_millimetres

__all__ = ["MocapPoses", "with_other_bodies"]


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
    sequence : ndarray of str
        (M,): the clip's name, after its subject's and a slash in a file where people share names of clips.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file can't be read, or is no such file: one of its poses is not finite, two frames of a clip have the
        same name, labels are missing, or what should be mm looks like metres.
    """

    def __init__(self, path: str | Path) -> None:
        members = read_npz(path, required=("poses", "joints", "unit", "subject", "clip_id"))
        self.joints = joint_names(members["joints"], f"{path}: joints")
        poses = stored_poses(members, "poses", self.joints, path) * millimetres_per(word(members, "unit", path, "mm"))
        if not any(canonical_name(name) == "Hip" for name in self.joints):
            raise PoseDataError(f"{path}: no Hip among {', '.join(self.joints)}; expected the root among the joints.")
        if (up := word(members, "up", path, "z")) != "z":
            raise PoseDataError(f"{path}: up is {up}; expected z. Turn the poses.")
        check_millimetres(poses, f"{path}: poses", "Store unit = 'm' in it.")
        many = (len(poses),)
        subject = labels(members["subject"], f"{path}: subject", many)
        self.poses = poses
        self.subject = np.array([f"S{s.lstrip('0') or '0'}" if s.isdecimal() else s for s in subject.tolist()], np.str_)
        self.clip = labels(members["clip_id"], f"{path}: clip_id", many)
        self.frame = labels(members.get("frame", np.arange(len(poses))), f"{path}: frame", many)
        self.description = labels(members.get("description", self.clip), f"{path}: description", many)
        self.sequence = self._sequences()
        self._check_frames(path)

    def _sequences(self) -> npt.NDArray[np.str_]:
        people = set(zip(self.subject.tolist(), self.clip.tolist(), strict=True))
        if len(people) == len({clip for _, clip in people}):
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
        if twice := [names for names, count in counts.items() if count > 1]:
            raise PoseDataError(
                f"{path}: {len(twice):,} frames are there more than once (first: clip {twice[0][0]}, frame "
                f"{twice[0][1]}); expected each frame of a clip once. Number them."
            )

    def seen_by_cameras(
        self,
        *,
        views: int = 4,
        every: int = 1,
        subjects: Iterable[str] | None = None,
        but_not: Iterable[str] = (),
        body_variation: float = 0.0,
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
        body_variation : float
            Standard deviation of the log of each bone's length. Above 0 every pose is given a body of its own: with few
            people to learn from, an estimator learns their bones instead of bodies. 0: bodies as they were captured.
        seed : int
            Where the cameras stand; a clip's cameras depend on the seed and the clip's name (in ``sequence``) alone.

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
        for subject, clip in dict.fromkeys(zip(self.subject.tolist(), self.clip.tolist(), strict=True)):
            if subject not in wanted:
                continue
            rows = np.flatnonzero((self.clip == clip) & (self.subject == subject))
            generator = np.random.default_rng([seed, *str(self.sequence[rows[0]]).encode()])
            around = cameras_around(self.poses[rows, root], generator, views=views)
            rows = rows[::every]
            for index, camera in enumerate(around):
                chosen.append(rows)
                people = self.poses[rows]
                if body_variation > 0:
                    people = with_other_bodies(people, self.joints, body_variation, generator)
                relative = people - people[:, root, None]
                poses.append(camera.turn(relative)[:, rest].astype(np.float32))
                keypoints.append(camera.project(people)[:, rest].astype(np.float32))
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
                [f"{c}/{f}/{v}" for c, f, v in zip(self.sequence[rows], self.frame[rows], cameras, strict=True)]
            ),
            sequence=self.sequence[rows],
            subject=self.subject[rows],
            action=self.description[rows],
            camera=camera_names,
            root=self.joints[root],
        )


def with_other_bodies(
    poses: npt.NDArray[np.float64], joints: Sequence[str], spread: float, generator: np.random.Generator
) -> npt.NDArray[np.float64]:
    r"""Give every pose other lengths of its bones, the directions as they are.

    .. math:: l'_b = l_b \exp\left( s \, (z + z_b) / \sqrt 2 \right)

    with one z for the person and one for each bone, left and right alike.

    Parameters
    ----------
    poses : ndarray
        (M, K, 3), mm.
    joints : sequence of str
        K names, the root among them.
    spread : float
        s, the standard deviation of the log of a bone's length.
    generator : numpy.random.Generator
        The source of randomness.

    Returns
    -------
    ndarray
        (M, K, 3), mm, the root where it was.

    Examples
    --------
    >>> leg = np.array([[[0.0, 0, 900], [0, 0, 450], [0, 0, 0]]])
    >>> other = with_other_bodies(leg, ("Hip", "RKnee", "RFoot"), 0.1, np.random.default_rng(0))
    >>> bool(other[0, :, :2].any()), float(other[0, 0, 2])  # straight as it was, hanging from the hip
    (False, 900.0)
    """
    skeleton = Skeleton(tuple(joints))
    kinds = [canonical_name(name).removeprefix("L").removeprefix("R") for name in joints]
    names = sorted(set(kinds))
    own = generator.standard_normal((len(poses), len(names))) + generator.standard_normal((len(poses), 1))
    factor = np.exp(spread * own / np.sqrt(2))[:, [names.index(kind) for kind in kinds]]
    changed = poses.copy()
    done = {k for k, parent in enumerate(skeleton.parents) if parent < 0}
    while len(done) < len(joints):
        for child, parent in enumerate(skeleton.parents):
            if child not in done and parent in done:
                bone = poses[:, child] - poses[:, parent]
                changed[:, child] = changed[:, parent] + factor[:, child, None] * bone
                done.add(child)
    return changed
