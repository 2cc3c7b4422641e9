"""Training batches of motion capture in which every pose has a new camera, and other people's limbs and bones.

Projection costs nothing, so that no image is seen twice: thirteen people in four fixed cameras are few.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import normalize

from posecal.data.joint_names import joint_keys
from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.data.bones import Bones
from posecal_models.data.cameras import CAMERA_HEIGHT, H36M_CENTRE, H36M_FOCAL, ring_around
from posecal_models.data.detector import Detector
from posecal_models.data.mocap import MocapPoses
from posecal_models.settings import DataConfig

__all__ = ["FreshViews"]

_EXCHANGES = (
    ("pelvis", (("LHip", "LKnee", "LFoot"), ("RHip", "RKnee", "RFoot"))),
    ("shoulders", (("LShoulder", "LElbow", "LWrist"),)),
    ("shoulders", (("RShoulder", "RElbow", "RWrist"),)),
)
"""What is exchanged together, in which frame: a limb's first joint, and those that follow it."""
_FRAMES = {"pelvis": ("LHip", "RHip", "Hip", "Spine"), "shoulders": ("LShoulder", "RShoulder", "Spine", "Thorax")}
"""A frame's joints: left, right, and two along the trunk, from below."""


class FreshViews:
    """Poses of motion capture, seen from a new camera in every batch.

    Parameters
    ----------
    mocap : MocapPoses
        World coordinates with z up.
    rows : ndarray
        (M,), the frames to use.
    joints, keypoint_joints : sequence of str
        The order of joints and keypoints.
    detector : Detector
        Noise model of the keypoints.
    body_variation : float
        See :func:`posecal_models.data.mocap.vary_bone_lengths`.
    mirror : bool
        Whether half of the images are mirror images.
    limb_exchange : float
        Probability of a pose to have the legs, or an arm, of another pose of the batch, in the frame of its pelvis or
        its shoulders.
    device : torch.device or str
        Device of the tensors.

    Notes
    -----
    A camera stands as in :func:`posecal_models.data.cameras.cameras_around`: on a ring around the clip's path at a
    random azimuth, 5 m from its middle and more for long paths, 1.5 m high, both varied by 10 %, looking at the middle.
    """

    def __init__(
        self,
        mocap: MocapPoses,
        rows: npt.NDArray[np.intp],
        joints: Sequence[str],
        keypoint_joints: Sequence[str],
        *,
        detector: Detector,
        body_variation: float = 0.0,
        mirror: bool = False,
        limb_exchange: float = 0.0,
        device: torch.device | str = "cpu",
    ) -> None:
        names = joint_keys(mocap.joints)
        self.detector, self.body_variation = detector, body_variation
        self.mirror, self.limb_exchange = mirror, limb_exchange
        self._root = names.index("Hip")
        self._joints = [names.index(name) for name in joint_keys(joints)]
        self._keypoints = [names.index(name) for name in joint_keys(keypoint_joints)]
        self._mirrored = [names.index(_other_side(name, names)) for name in names]
        self._bones = Bones(mocap.joints)
        self._names = {name: k for k, name in enumerate(names)}
        needed = {*(j for _, limbs in _EXCHANGES for limb in limbs for j in limb), *chain(*_FRAMES.values())}
        if limb_exchange and (missing := sorted(needed - set(names))):
            raise PoseDataError(
                f"data.limb_exchange: the poses have no {', '.join(missing)}; expected the joints of Human3.6M, or 0."
            )
        self.poses = torch.from_numpy(mocap.poses[rows]).to(device, torch.float32)
        if not len(self.poses):
            raise PoseDataError("training data: 0 poses; expected 1 or more.")
        middles, radii = _paths(mocap.poses[rows, self._root], mocap.sequence[rows])
        self._middles, self._radii = middles.to(device), radii.to(device)

    def __len__(self) -> int:
        return len(self.poses)

    @classmethod
    def from_config(
        cls,
        mocap: MocapPoses,
        config: DataConfig,
        joints: Sequence[str],
        keypoint_joints: Sequence[str],
        *,
        device: torch.device | str = "cpu",
    ) -> FreshViews:
        """Build from settings: all people but those held out; otherwise as the class.

        Returns
        -------
        FreshViews
            With the frames of the training set.
        """
        held_out = np.isin(mocap.subject, (*config.test_subjects, *config.validation_subjects))
        return cls(
            mocap,
            np.flatnonzero(~held_out)[:: config.every],
            joints,
            keypoint_joints,
            detector=config.detector,
            body_variation=config.body_variation,
            mirror=config.mirror,
            limb_exchange=config.limb_exchange,
            device=device,
        )

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        return self.poses.device

    def batch(self, rows: Tensor, generator: torch.Generator) -> tuple[Context, Tensor]:
        """Select poses, vary them, and simulate an image of each.

        Parameters
        ----------
        rows : Tensor
            (B,), integer.
        generator : torch.Generator
            The source of all randomness, of the CPU.

        Returns
        -------
        context : Context
            B keypoint sets, pixels.
        truth : Tensor
            (B, K, 3), mm, in the cameras' frames.
        """
        poses = self._exchange_limbs(self.poses[rows], generator)
        poses = self._vary_bones(poses, generator)
        rotation, position = self._cameras(rows, generator)
        in_camera = (poses - position[:, None]) @ rotation.mT
        if self.mirror:
            mirrored = (torch.rand(len(rows), generator=generator) < 0.5).to(self.device)[:, None, None]
            flip = torch.tensor([-1.0, 1.0, 1.0], device=self.device)
            in_camera = torch.where(mirrored, in_camera[:, self._mirrored] * flip, in_camera)
        depth = in_camera[..., 2:].clamp(min=1.0)
        centre = torch.tensor(H36M_CENTRE, device=self.device)
        keypoints = in_camera[..., :2] / depth * H36M_FOCAL + centre
        truth = in_camera - in_camera[:, self._root, None]
        return self.detector.detect(keypoints[:, self._keypoints], generator), truth[:, self._joints]

    def _cameras(self, rows: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Draw a level camera for each pose: rotation (B, 3, 3), of which rows are its axes, and position (B, 3)."""
        random = torch.rand((len(rows), 3), generator=generator).to(self.device)
        azimuth = 2 * torch.pi * random[:, 0]
        distance = self._radii[rows] * (0.9 + 0.2 * random[:, 1])
        height = CAMERA_HEIGHT * (0.9 + 0.2 * random[:, 2])
        middle = self._middles[rows]
        position = torch.stack(
            [middle[:, 0] + distance * azimuth.cos(), middle[:, 1] + distance * azimuth.sin(), height], dim=1
        )
        ahead = middle - position
        right = torch.linalg.cross(ahead, torch.tensor([0.0, 0.0, 1.0], device=self.device).expand_as(ahead))
        axes = torch.stack([right, torch.linalg.cross(ahead, right), ahead], dim=1)
        return normalize(axes, dim=-1), position

    def _vary_bones(self, poses: Tensor, generator: torch.Generator) -> Tensor:
        if not self.body_variation:
            return poses
        own = torch.randn((len(poses), self._bones.kinds), generator=generator)
        normal = (own + torch.randn((len(poses), 1), generator=generator)) / 2**0.5
        return self._bones.stretch(poses, (self.body_variation * normal).exp().to(self.device))

    def _exchange_limbs(self, poses: Tensor, generator: torch.Generator) -> Tensor:
        """Give poses both legs, or an arm, of other poses, turned as pelvis or shoulders are."""
        if not self.limb_exchange:
            return poses
        at, result = self._names, poses.clone()
        for frame, limbs in _EXCHANGES:
            left, right, below, above = (poses[:, at[name]] for name in _FRAMES[frame])
            axes = _frame(left - right, above - below)
            partner = torch.randperm(len(poses), generator=generator).to(self.device)
            exchanged = (torch.rand((len(poses), 1), generator=generator) < self.limb_exchange).to(self.device)
            turn = axes @ axes[partner].mT
            for first, *others in limbs:
                for name in others:
                    bone = poses[partner, at[name]] - poses[partner, at[first]]
                    moved = poses[:, at[first]] + (turn @ bone[..., None])[..., 0]
                    result[:, at[name]] = torch.where(exchanged, moved, result[:, at[name]])
        return result


def _frame(across: Tensor, upwards: Tensor) -> Tensor:
    """Return orthonormal axes as columns (B, 3, 3): across the body, upwards, and their cross product."""
    x = normalize(across, dim=-1)
    y = normalize(upwards - (upwards * x).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def _other_side(name: str, names: Sequence[str]) -> str:
    other = {"L": "R", "R": "L"}.get(name[0], "") + name[1:]
    return other if other in names else name


def _paths(roots: npt.NDArray[np.floating], sequence: npt.NDArray[np.str_]) -> tuple[Tensor, Tensor]:
    """Middle (M, 3) of the clip's path, and distance (M,) of its cameras, mm."""
    middles, radii = np.empty_like(roots), np.empty(len(roots))
    for name in dict.fromkeys(sequence.tolist()):
        rows = sequence == name
        middles[rows], radii[rows] = ring_around(roots[rows])
    return torch.from_numpy(middles).float(), torch.from_numpy(radii).float()
