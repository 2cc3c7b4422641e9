"""Augmentation of training data: random removal of keypoints."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from posecal_models.contract import Context

__all__ = ["SHARES", "Augmentation", "mask_keypoints", "remove_keypoints"]

Augmentation = Literal["paper", "released"]

SHARES = (1.0, 0.2, 0.4, 0.6, 0.8)
"""The five graphs of a pose: all observed keypoints, and these shares of them."""


def mask_keypoints(
    observed: Tensor, share: Tensor, generator: torch.Generator, *, kind: Augmentation = "paper"
) -> Tensor:
    """Remove keypoints at random until a share of them is left.

    Parameters
    ----------
    observed : Tensor
        (M, K), bool.
    share : Tensor
        (M,), between 0 and 1: the share that remains observed.
    generator : torch.Generator
        The source of randomness, of the CPU.
    kind : str
        ``paper``: this share of the observed keypoints remains, at least one. ``released``: the rest of all K keypoints
        is removed, observed or not.

    Returns
    -------
    Tensor
        (M, K), bool: the keypoints that remain observed.

    Notes
    -----
    Differs from the published code: ``released`` is that of the code, ``paper`` that of the paper's text.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, section 4, "Loss".

    Examples
    --------
    >>> observed = torch.tensor([[True, True, True, True, True, False, False, False, False, False]])
    >>> masked = mask_keypoints(observed, torch.tensor([0.4]), torch.Generator().manual_seed(0))
    >>> int(masked.sum()), bool((masked & ~observed).any())  # 0.4 * 5 observed
    (2, False)
    """
    keypoints = observed.shape[1]
    order = torch.rand(observed.shape, generator=generator).to(observed.device)
    if kind == "released":
        removed = torch.round((1 - share) * keypoints)
        return observed & (order.argsort(1).argsort(1) >= removed[:, None])
    remaining = torch.round(share * observed.sum(1)).clamp(min=1)
    rank = order.masked_fill(~observed, 2).argsort(1).argsort(1)
    return observed & (rank < remaining[:, None])


def remove_keypoints(context: Context, share: float, generator: torch.Generator) -> Context:
    """Remove keypoints of some images altogether: neither their position nor their σ is left.

    Parameters
    ----------
    context : Context
        Keypoints of M poses.
    share : float
        Share of these images. Each of their keypoints is removed with a probability that is uniform between 0 and 1.
    generator : torch.Generator
        The source of randomness, of the CPU.

    Returns
    -------
    Context
        With σ infinite where a keypoint was removed.
    """
    poses, keypoints = context.observed.shape
    chosen = torch.rand((poses, 1), generator=generator) < share
    probability = torch.rand((poses, 1), generator=generator)
    removed = (chosen & (torch.rand((poses, keypoints), generator=generator) < probability)).to(context.observed.device)
    sigma = torch.zeros_like(context.keypoints[..., 0]) if context.sigma is None else context.sigma
    return Context(context.keypoints, context.observed & ~removed, torch.where(removed, torch.inf, sigma))
