"""Which keypoints does a training graph keep? The augmentation that teaches a cGNF to do with fewer."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

__all__ = ["SHARES", "Augmentation", "hide"]

Augmentation = Literal["paper", "released"]

SHARES = (1.0, 0.2, 0.4, 0.6, 0.8)
"""The five graphs of a pose: all observed keypoints, and these shares of them."""


def hide(observed: Tensor, share: Tensor, generator: torch.Generator, *, kind: Augmentation = "paper") -> Tensor:
    """Take keypoints away at random until a share of them is left.

    Parameters
    ----------
    observed : Tensor
        (M, K), bool.
    share : Tensor
        (M,), between 0 and 1: how many are kept. With 1 all are.
    generator : torch.Generator
        The source of randomness.
    kind : str
        ``paper``: this share of the observed keypoints stays, at least one. ``released``: the rest of the K slots is
        removed, whether a keypoint was observed there or not.

    Returns
    -------
    Tensor
        (M, K), bool: what is left.

    Notes
    -----
    Differs from the published code: it is ``released``, the text is ``paper``.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4, "Loss".

    Examples
    --------
    >>> observed = torch.tensor([[True, True, True, True, True, False, False, False, False, False]])
    >>> kept = hide(observed, torch.tensor([0.4]), torch.Generator().manual_seed(0))
    >>> int(kept.sum()), bool((kept & ~observed).any())  # 0.4 * 5 observed
    (2, False)
    """
    slots = observed.shape[1]
    turn = torch.rand(observed.shape, generator=generator, device=observed.device)
    if kind == "released":
        removed = torch.round((1 - share) * slots)
        return observed & (turn.argsort(1).argsort(1) >= removed[:, None])
    kept = torch.round(share * observed.sum(1)).clamp(min=1)
    rank = turn.masked_fill(~observed, 2).argsort(1).argsort(1)
    return observed & (rank < kept[:, None])
