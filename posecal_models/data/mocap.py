"""How do motion captures without images become training data? Poses in a room, seen by virtual cameras.

A file of poses is an ``.npz`` with ``poses`` (M, K, 3) in a room with z up, ``joints``, ``unit``, ``subject`` and
``clip_id``; ``frame`` and ``description`` are used where they are there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError
from posecal.skeleton import Skeleton, canonical_name
from posecal.units import millimetres_per
from posecal_models.data.cameras import cameras_around
from posecal_models.data.lifting_set import LiftingSet, read_npz

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
                [f"{c}/{f}/{v}" for c, f, v in zip(self.clip[rows], self.frame[rows], cameras, strict=True)]
            ),
            sequence=self.clip[rows],
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
