"""Synthetic motion capture: a person with randomly moving limbs, to try the commands without any download.

Bone lengths are constant; each bone rotates about its direction in the rest pose by angles that change smoothly, and
the person turns and walks. It is not realistic enough to train estimators for real people.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.data.skeleton import Skeleton, joint_set

__all__ = ["synthetic_motion"]

Array = npt.NDArray[np.float64]

_SWING = {"Knee": 0.9, "Foot": 0.5, "Elbow": 0.9, "Wrist": 0.9, "Hip": 0.1, "Shoulder": 0.2}


def synthetic_motion(
    *, subjects: int = 4, clips: int = 5, frames: int = 100, seed: int = 0
) -> dict[str, npt.NDArray[np.generic]]:
    """Generate motion capture data.

    Parameters
    ----------
    subjects, clips, frames : int
        People, clips per person, frames per clip (20 per second).
    seed : int
        Random seed.

    Returns
    -------
    dict of str to ndarray
        Members of a file that :class:`posecal_models.data.mocap.MocapPoses` reads: ``poses`` (M, 17, 3) in mm, labels.

    Examples
    --------
    >>> motion = synthetic_motion(subjects=2, clips=1, frames=10)
    >>> motion["poses"].shape, sorted(set(motion["subject"].tolist()))
    ((20, 17, 3), ['S1', 'S2'])
    """
    generator = np.random.default_rng(seed)
    joints = joint_set("h36m-17")
    skeleton = Skeleton(joints)
    poses, labels = [], []
    for subject in range(1, subjects + 1):
        rest = skeleton.rest_pose * generator.normal(1, 0.05)
        for clip in range(1, clips + 1):
            poses.append(_clip(rest, skeleton, frames, generator))
            labels += [(f"S{subject}", f"{subject:02}_{clip:02}", frame) for frame in range(frames)]
    subject_names, clip_names, frame_numbers = zip(*labels, strict=True)
    return {
        "poses": np.concatenate(poses).astype(np.float32),
        "joints": np.array(joints),
        "unit": np.array("mm"),
        "up": np.array("z"),
        "fps": np.array(20.0),
        "subject": np.array(subject_names),
        "clip_id": np.array(clip_names),
        "frame": np.array(frame_numbers),
        "description": np.full(len(labels), "synthetic"),
    }


def _clip(rest: Array, skeleton: Skeleton, frames: int, generator: np.random.Generator) -> Array:
    """Rotate every bone about its rest direction, from the hip outwards."""
    heading = np.cumsum(_smooth(frames, 1, generator)[:, 0] * 0.05) + generator.uniform(0, 2 * np.pi)
    path = np.cumsum(_smooth(frames, 2, generator) * 15, axis=0)
    poses = np.zeros((frames, len(rest), 3))
    rotations = np.tile(np.eye(3), (frames, len(rest), 1, 1))
    rotations[:, 0] = _rotation(np.stack([np.zeros(frames), np.zeros(frames), heading], axis=1))
    order = [child for child, parent in enumerate(skeleton.parents) if parent >= 0]
    for child in order:
        parent = skeleton.parents[child]
        part = skeleton.joints[child].lstrip("LR")
        swing = _rotation(_smooth(frames, 3, generator) * _SWING.get(part, 0.15))
        rotations[:, child] = rotations[:, parent] @ swing
        poses[:, child] = poses[:, parent] + rotations[:, child] @ (rest[child] - rest[parent])
    poses[:, :, :2] += path[:, None]
    poses[:, :, 2] -= poses[:, :, 2].min(axis=1, keepdims=True)
    return poses


def _smooth(frames: int, columns: int, generator: np.random.Generator) -> Array:
    """Draw stationary AR(1) noise of variance 1 with correlation 0.95 from frame to frame, (frames, columns)."""
    noise = generator.standard_normal((frames, columns))
    values = noise.copy()
    for frame in range(1, frames):
        values[frame] = 0.95 * values[frame - 1] + np.sqrt(1 - 0.95**2) * noise[frame]
    return values


def _rotation(vectors: Array) -> Array:
    """Compute the rotation matrices (M, 3, 3) of rotation vectors (M, 3), with angles in radians."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angle[:, 0], 1e-12)).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    rotation: Array = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return rotation
