"""Bones of a skeleton, whose lengths are varied in training."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from posecal.data.joint_names import joint_keys
from posecal.data.skeleton import Skeleton

__all__ = ["Bones"]


class Bones:
    """Bones of a skeleton, to change their lengths.

    Parameters
    ----------
    joints : sequence of str
        K names, the root included.

    Attributes
    ----------
    kinds : int
        Number of kinds of bones: one for each name, left and right alike.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        parents = Skeleton(tuple(joints)).parents
        names = [key.removeprefix("L").removeprefix("R") for key in joint_keys(joints)]
        ordered = sorted(set(names))
        self.kinds = len(ordered)
        self._kind = [ordered.index(name) for name in names]
        self._parents = [k if parent < 0 else parent for k, parent in enumerate(parents)]
        self._paths = torch.eye(len(joints))  # of each joint, the bones between it and the root
        for _ in joints:
            self._paths = torch.maximum(self._paths, self._paths[self._parents])

    def stretch(self, poses: Tensor, factor: Tensor) -> Tensor:
        """Change the lengths of the bones, keeping their directions and the root.

        Parameters
        ----------
        poses : Tensor
            (M, K, 3).
        factor : Tensor
            (M, kinds).

        Returns
        -------
        Tensor
            (M, K, 3).
        """
        change = (factor[:, self._kind] - 1)[:, :, None] * (poses - poses[:, self._parents])  # 0 of the root
        return poses + self._paths.to(poses) @ change
