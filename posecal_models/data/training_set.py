"""What does a training step see? Batches of poses with freshly detected keypoints, drawn where the network computes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.data.detector import Detector
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.masks import SHARES, Augmentation, hide

__all__ = ["TrainingSet", "draw_graphs", "seeded"]


def seeded(device: torch.device | str, *numbers: int) -> torch.Generator:
    """Give a generator that depends on some numbers alone, such as a seed, an epoch and a step.

    Parameters
    ----------
    device : torch.device or str
        Where it draws.
    *numbers : int
        Non-negative.

    Returns
    -------
    torch.Generator
        The same for the same numbers, unrelated for others.

    Examples
    --------
    >>> one, same, other = (torch.rand(1, generator=seeded("cpu", 0, step)) for step in (7, 7, 8))
    >>> bool(one == same), bool(one == other)
    (True, False)
    """
    mixed = 0x9E3779B97F4A7C15
    for number in numbers:
        mixed = ((mixed ^ (number + 0x165667B19E3779F9)) * 0xBF58476D1CE4E5B9) % 2**64
        mixed ^= mixed >> 29
    return torch.Generator(device).manual_seed(mixed % 2**63)


class TrainingSet:
    """Poses and keypoints as tensors, in an estimator's order of joints.

    Parameters
    ----------
    data : LiftingSet
        The pairs.
    joints, keypoint_joints : sequence of str
        The order wanted.
    detector : Detector, optional
        Draws the keypoints' noise anew for every batch; keypoints are taken as they are where it is not given.
    device : torch.device or str
        Where everything lies.

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
            raise PoseDataError("training data: 0 poses; expected some.")
        finite = self.poses.isfinite().all(-1).all(-1)
        if not finite.all():
            raise PoseDataError(
                f"training data: {int((~finite).sum()):,} of {len(finite):,} poses are not finite. Leave them out."
            )

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def device(self) -> torch.device:
        """Where the tensors lie."""
        return self.poses.device

    def batch(self, rows: Tensor, generator: torch.Generator) -> tuple[Context, Tensor]:
        """Take some poses and detect their keypoints.

        Parameters
        ----------
        rows : Tensor
            (B,), integer.
        generator : torch.Generator
            Of the detector's noise.

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
    """Give every pose several sets of observed keypoints, the paper's five in turn.

    Parameters
    ----------
    context : Context
        Keypoints of B poses.
    truth : Tensor
        (B, K, 3), mm.
    graphs_per_pose : int
        Sets of each pose.
    first : int
        Which of the five comes first; pose i starts i further.
    augmentation : str
        See :func:`posecal_models.data.masks.hide`.
    generator : torch.Generator
        The source of randomness.
    root : bool
        Whether the first keypoint is that of the root, which is never hidden.

    Returns
    -------
    context, truth
        Of B * graphs_per_pose graphs, those of one pose together.
    """
    poses = len(truth)
    rows = torch.arange(poses, device=truth.device).repeat_interleave(graphs_per_pose)
    turn = torch.arange(graphs_per_pose, device=truth.device).repeat(poses)
    start = rows * (graphs_per_pose % len(SHARES) != 0)
    share = torch.tensor(SHARES, device=truth.device)[(turn + start + first) % len(SHARES)]
    graphs = context[rows]
    first_hidden = int(root)
    kind: Augmentation = "released" if augmentation == "released" else "paper"
    some = hide(graphs.observed[:, first_hidden:], share, generator, kind=kind)
    observed = torch.cat([graphs.observed[:, :first_hidden], some], dim=1)
    return Context(graphs.keypoints, observed, graphs.sigma), truth[rows]
