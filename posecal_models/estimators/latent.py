"""Poses that a network makes of standard normal latents: samples without a density."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.contract import standard_normal

__all__ = ["LatentPoses"]

_ROWS = 2**14
"""Samples that pass through the network at once, without gradients."""


class LatentPoses:
    """The distributions of decoded standard normal latents.

    Parameters
    ----------
    decode : callable
        From latents (n, M, L) to poses (n, M, K, 3), mm.
    latents : int
        L.
    like : Tensor
        (M, ...): a tensor on the device and of the type of the latents.
    no_density : str
        Why there is no log density, for its message.
    """

    def __init__(self, decode: Callable[[Tensor], Tensor], latents: int, like: Tensor, no_density: str) -> None:
        self._decode = decode
        self._latents = latents
        self._like = like
        self._no_density = no_density

    def sample(self, n: int, *, generator: torch.Generator | None = None, temperature: float = 1.0) -> Tensor:
        """Draw n hypotheses of each pose; the temperature multiplies the latents."""
        poses = len(self._like)
        latents = temperature * standard_normal((n, poses, self._latents), self._like, generator)
        return torch.cat([self._decode(part) for part in torch.split(latents, max(1, _ROWS // max(1, poses)))])

    def mode(self) -> Tensor:
        """Return the poses of latent 0, (M, K, 3), mm."""
        return self._decode(self._like.new_zeros(1, len(self._like), self._latents))[0]

    def log_prob(self, truth: Tensor) -> Tensor:
        """Raise an error: the density is not known.

        Raises
        ------
        PoseDataError
            Always.
        """
        raise PoseDataError(f"log_prob of {len(truth)} poses: {self._no_density} Measure samples.")
