"""SimpleBaseline: a residual network from 2D keypoints to 3D joints, a point estimator.

It models neither uncertainty nor missing keypoints: it reads every keypoint, also those that a detector marks as
hidden.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError
from posecal_models.contract import Context, PointEstimate, check_keypoints
from posecal_models.data.standardizer import Origin, Standardizer

__all__ = ["HOURGLASS", "DenseLayer", "ResidualBlock", "SimpleBaseline", "check_all_keypoints", "from_public"]

HOURGLASS = ("Hip", *(name for name in joint_set("h36m-16") if name != "Neck/Nose"))
"""The 16 keypoints of the stacked hourglass network: the hip, but neither neck nor nose."""


class DenseLayer(nn.Module):
    """Linear, batch norm, ReLU, dropout."""

    def __init__(self, features: int, features_out: int, dropout: float, linear: type[nn.Linear] = nn.Linear) -> None:
        super().__init__()
        self.linear = linear(features, features_out)
        self.norm = nn.BatchNorm1d(features_out)
        self.dropout = nn.Dropout(dropout)

    def forward(self, features: Tensor) -> Tensor:
        """Apply the layer, (M, features) to (M, features_out)."""
        result: Tensor = self.dropout(torch.relu(self.norm(self.linear(features))))
        return result


class ResidualBlock(nn.Module):
    """Two layers whose output is added to their input."""

    def __init__(self, width: int, dropout: float, linear: type[nn.Linear] = nn.Linear) -> None:
        super().__init__()
        self.first = DenseLayer(width, width, dropout, linear)
        self.second = DenseLayer(width, width, dropout, linear)

    def forward(self, features: Tensor) -> Tensor:
        """Apply the block, (M, width) to (M, width)."""
        result: Tensor = features + self.second(self.first(features))
        return result


def check_all_keypoints(context: Context, keypoints: tuple[str, ...], estimator: str) -> None:
    """Check the keypoints of an estimator that reads every one, observed or not.

    Parameters
    ----------
    context : Context
        Keypoints of M poses.
    keypoints : tuple of str
        The names that the estimator reads, in order.
    estimator : str
        Its name, for messages.

    Raises
    ------
    PoseDataError
        Where there are more or fewer, or one is not finite (not checked on a GPU, where it would need a
        synchronisation).
    """
    check_keypoints(context, keypoints)
    if context.keypoints.device.type == "cpu" and not context.keypoints.isfinite().all():
        missing = int((~context.keypoints.isfinite().all(-1)).sum())
        raise PoseDataError(
            f"keypoints: {missing:,} of {context.observed.numel():,} are not finite; "
            f"{estimator} reads every keypoint. Give the detector's estimate, or use a cGNF."
        )


class SimpleBaseline(nn.Module):
    """A point estimator of poses from all keypoints.

    Parameters
    ----------
    joints, keypoints : tuple of str
        K joints of the pose, without the root, and J keypoints. Human3.6M's 16 where not given.
    width, residuals : int
        Features of a layer, and number of residual blocks.
    dropout : float
        Dropout probability in training.
    origin : str
        Origin of the keypoints, see :class:`posecal_models.data.standardizer.Standardizer`.

    Notes
    -----
    With 16 keypoints, 15 joints, width 1024 and 2 residual blocks it has 4,288,557 parameters, the paper's number.

    Differs from the published code: none (that of Martinez et al. limits the norm of each weight, the paper's does
    not).

    References
    ----------
    Martinez et al. 2017, arXiv:1705.03098.

    Examples
    --------
    >>> fifteen = tuple(f"joint {k}" for k in range(15))
    >>> estimator = SimpleBaseline(fifteen, ("root", *fifteen))
    >>> sum(p.numel() for p in estimator.parameters())
    4288557
    """

    def __init__(
        self,
        joints: tuple[str, ...] | None = None,
        keypoints: tuple[str, ...] | None = None,
        *,
        width: int = 1024,
        residuals: int = 2,
        dropout: float = 0.5,
        origin: Origin = "observed",
    ) -> None:
        super().__init__()
        self._joints = joint_set("h36m-16") if joints is None else joints
        self._keypoints = self._joints if keypoints is None else keypoints
        self.first = DenseLayer(2 * len(self._keypoints), width, dropout)
        self.residuals = nn.ModuleList(ResidualBlock(width, dropout) for _ in range(residuals))
        self.last = nn.Linear(width, 3 * len(self._joints))
        self.standardizer = Standardizer(len(self._joints), origin=origin)
        for module in self.modules():
            if isinstance(module, nn.Linear):
                nn.init.kaiming_normal_(module.weight)

    @property
    def joints(self) -> tuple[str, ...]:
        """K names: the joints of the poses."""
        return self._joints

    @property
    def keypoints(self) -> tuple[str, ...]:
        """J names: the keypoints of a context."""
        return self._keypoints

    def check(self, context: Context) -> None:
        """Raise an error for keypoints that don't fit this estimator.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels.

        Raises
        ------
        PoseDataError
            Where there are more or fewer, or one is not finite (not checked on a GPU, where it would need a
            synchronisation).
        """
        check_all_keypoints(context, self.keypoints, "SimpleBaseline")

    def standardised_poses(self, context: Context) -> Tensor:
        """Estimate standardised poses.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels; all of them are read, observed or not.

        Returns
        -------
        Tensor
            (M, K, 3), unitless.

        Raises
        ------
        PoseDataError
            As :meth:`check`.
        """
        self.check(context)
        features: Tensor = self.first(self.standardizer.all_keypoints(context).flatten(1))
        for residual in self.residuals:
            features = residual(features)
        poses: Tensor = self.last(features)
        return poses.view(len(poses), -1, 3)

    def forward(self, context: Context) -> PointEstimate:
        """Estimate poses.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels.

        Returns
        -------
        PointEstimate
            (M, K, 3), mm.
        """
        return PointEstimate(self.standardizer.millimetres(self.standardised_poses(context)))


_PUBLIC = {
    r"^w1\.": "first.linear.",
    r"^batch_norm1\.": "first.norm.",
    r"^w2\.": "last.",
    r"^linear_stages\.(\d+)\.w1\.": r"residuals.\1.first.linear.",
    r"^linear_stages\.(\d+)\.batch_norm1\.": r"residuals.\1.first.norm.",
    r"^linear_stages\.(\d+)\.w2\.": r"residuals.\1.second.linear.",
    r"^linear_stages\.(\d+)\.batch_norm2\.": r"residuals.\1.second.norm.",
}


def from_public(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Convert a state dict of the public PyTorch SimpleBaseline to the names used here.

    Parameters
    ----------
    state : mapping of str to Tensor
        Read with ``weights_only=True``.

    Returns
    -------
    dict of str to Tensor
        For ``load_state_dict(..., strict=False)``: without the standardizer, which that code does not have.

    Raises
    ------
    PoseDataError
        Where a name is unknown.

    Examples
    --------
    >>> list(from_public({"linear_stages.0.w2.bias": torch.zeros(1)}))
    ['residuals.0.second.linear.bias']
    """
    renamed = {}
    for name, tensor in state.items():
        for pattern, replacement in _PUBLIC.items():
            if re.match(pattern, name):
                renamed[re.sub(pattern, replacement, name)] = tensor
                break
        else:
            raise PoseDataError(f"checkpoint: {name} is not part of a SimpleBaseline.")
    return renamed
