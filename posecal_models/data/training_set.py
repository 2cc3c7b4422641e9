"""Training batches: poses with newly simulated detections, on the device of the training."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.data.detector import Detector
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.masks import SHARES, Augmentation, mask_keypoints

__all__ = ["TrainingSet", "draw_graphs", "seeded_generator"]


def seeded_generator(*numbers: int) -> torch.Generator:
    """Create a random generator of the CPU from several numbers, such as a seed, an epoch and a step.

    Random numbers are drawn on the CPU and moved, so that a seed gives the same ones on every device.

    Parameters
    ----------
    *numbers : int
        Non-negative.

    Returns
    -------
    torch.Generator
        The same for the same numbers, independent for others.

    Examples
    --------
    >>> one, same, other = (torch.rand(1, generator=seeded_generator(0, step)) for step in (7, 7, 8))
    >>> bool(one == same), bool(one == other)
    (True, False)
    """
    hashed = 0x9E3779B97F4A7C15
    for number in numbers:
        hashed = ((hashed ^ (number + 0x165667B19E3779F9)) * 0xBF58476D1CE4E5B9) % 2**64
        hashed ^= hashed >> 29
    return torch.Generator().manual_seed(hashed % 2**63)


class TrainingSet:
    """Poses and keypoints as tensors, in an estimator's order of joints.

    Parameters
    ----------
    data : LiftingSet
        The pairs.
    joints, keypoint_joints : sequence of str
        The order of joints and keypoints.
    detector : Detector, optional
        Noise model, drawn anew for every batch; keypoints are used as they are where not given.
    device : torch.device or str
        Device of the tensors.

    Raises
    ------
    PoseDataError
        Where there is no pose, or one is not finite.
    """

    def __init__(
        self,
        data: LiftingSet,
        joints: Sequence[str],
        keypoint_joints: Sequence[str],
        *,
        detector: Detector | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        ordered = data.in_order_of(joints, keypoint_joints)
        self.poses = torch.from_numpy(ordered.poses).to(device)
        self.keypoints = torch.from_numpy(ordered.keypoints).to(device)
        self.observed = torch.from_numpy(ordered.observed).to(device)
        self.sigma = torch.from_numpy(ordered.sigma).to(device)
        self.detector = detector
        if not len(self.poses):
            raise PoseDataError("training data: 0 poses; expected 1 or more.")
        finite = self.poses.isfinite().all(-1).all(-1)
        if not finite.all():
            raise PoseDataError(
                f"training data: {int((~finite).sum()):,} of {len(finite):,} poses are not finite. Leave them out."
            )

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        return self.poses.device

    def batch(self, rows: Tensor, generator: torch.Generator) -> tuple[Context, Tensor]:
        """Select poses and simulate the detection of their keypoints.

        Parameters
        ----------
        rows : Tensor
            (B,), integer.
        generator : torch.Generator
            The source of the detector's noise.

        Returns
        -------
        context : Context
            B keypoint sets, pixels.
        truth : Tensor
            (B, K, 3), mm.
        """
        keypoints = self.keypoints[rows]
        if self.detector is None:
            return Context(keypoints, self.observed[rows], self.sigma[rows]), self.poses[rows]
        return self.detector.detect(keypoints, generator), self.poses[rows]


def draw_graphs(
    context: Context,
    truth: Tensor,
    *,
    graphs_per_pose: int,
    first: int,
    augmentation: str,
    generator: torch.Generator,
    root: bool = False,
) -> tuple[Context, Tensor]:
    """Draw several sets of observed keypoints of every pose, the paper's five in turn.

    Parameters
    ----------
    context : Context
        Keypoints of B poses.
    truth : Tensor
        (B, K, 3), mm.
    graphs_per_pose : int
        Number of sets of each pose.
    first : int
        Index of the first of the five; pose i starts i further.
    augmentation : str
        See :func:`posecal_models.data.masks.mask_keypoints`.
    generator : torch.Generator
        The source of randomness.
    root : bool
        Whether the first keypoint is that of the root, which is never removed.

    Returns
    -------
    context, truth
        Of B * graphs_per_pose graphs; those of one pose are consecutive.
    """
    poses = len(truth)
    rows = torch.arange(poses, device=truth.device).repeat_interleave(graphs_per_pose)
    graph = torch.arange(graphs_per_pose, device=truth.device).repeat(poses)
    start = rows * (graphs_per_pose % len(SHARES) != 0)
    share = torch.tensor(SHARES, device=truth.device)[(graph + start + first) % len(SHARES)]
    graphs = context[rows]
    first_maskable = int(root)
    kind: Augmentation = "released" if augmentation == "released" else "paper"
    masked = mask_keypoints(graphs.observed[:, first_maskable:], share, generator, kind=kind)
    observed = torch.cat([graphs.observed[:, :first_maskable], masked], dim=1)
    return Context(graphs.keypoints, observed, graphs.sigma), truth[rows]
