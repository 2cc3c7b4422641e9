"""What of a batch can't be computed share by share? Its statistics and its random draws, where processes part it.

While :func:`sharing` lasts, a process holds some rows of a batch, and what stands here computes as if it held all:
batch norm takes the statistics of all rows, and noise is drawn for all rows, of which each process keeps its own.
Outside of it, and in a training of one process, everything is PyTorch's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch import distributed as torch_distributed
from torch.nn import functional

__all__ = ["BatchNorm", "drawn", "dropout", "sharing"]


@dataclass(frozen=True)
class _Share:
    rows: slice
    poses: int

    @property
    def weight(self) -> float:
        return float(self.rows.stop - self.rows.start) / self.poses


_share: ContextVar[_Share | None] = ContextVar("share", default=None)


@contextmanager
def sharing(rows: slice, poses: int) -> Iterator[None]:
    """Say that this process holds some rows of a batch, and other processes the others.

    Parameters
    ----------
    rows : slice
        This process's poses; at least one.
    poses : int
        Of the whole batch.
    """
    before = _share.set(_Share(rows, poses))
    try:
        yield
    finally:
        _share.reset(before)


def drawn(draw: Callable[[int], Tensor], poses: int, *, axis: int = 0) -> Tensor:
    """Draw something for the poses at hand, the same for each as if one process held them all.

    Parameters
    ----------
    draw : callable
        Takes a number of poses and draws for as many.
    poses : int
        How many are at hand.
    axis : int
        Which axis of what is drawn is the poses'.

    Returns
    -------
    Tensor
        Of this many poses.

    Examples
    --------
    >>> def draw(poses):
    ...     return torch.rand(poses, generator=torch.Generator().manual_seed(0))
    >>> with sharing(slice(3, 5), 5):
    ...     mine = drawn(draw, 2)
    >>> bool((mine == draw(5)[3:5]).all())
    True
    """
    share = _share.get()
    return draw(poses) if share is None else draw(share.poses).narrow(axis, share.rows.start, poses)


def dropout(features: Tensor, hidden: float, *, training: bool) -> Tensor:
    """Set a share of the features to 0 in training, and scale up the others.

    Parameters
    ----------
    features : Tensor
        (M, F).
    hidden : float
        How many of them.
    training : bool
        Nothing happens otherwise.

    Returns
    -------
    Tensor
        (M, F).
    """
    if not training or _share.get() is None:
        return functional.dropout(features, hidden, training)
    width = features.shape[1:]
    return features * drawn(lambda poses: functional.dropout(features.new_ones(poses, *width), hidden), len(features))


class _Mean(torch.autograd.Function):
    """The mean over the processes, weighted by their rows.

    A process's loss is a mean over its own rows, and the loss of the batch is the weighted mean of those. So what the
    losses of all processes say of this mean comes back as their weighted mean too.
    """

    @staticmethod
    def forward(ctx: Any, mine: Tensor, weight: float) -> Tensor:
        ctx.weight = weight
        return _weighted_sum(mine, weight)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        return _weighted_sum(gradients[0], ctx.weight), None


def _mean(mine: Tensor, share: _Share) -> Tensor:
    mean: Tensor = _Mean.apply(mine, share.weight)  # type: ignore[no-untyped-call]
    return mean


def _weighted_sum(mine: Tensor, weight: float) -> Tensor:
    total = mine * weight
    torch_distributed.all_reduce(total)
    return total


class BatchNorm(nn.BatchNorm1d):
    """Batch norm with the statistics of the whole batch, on any device and for shares of any sizes.

    Notes
    -----
    ``torch.nn.SyncBatchNorm`` needs GPUs, and its gradient is that of equal shares.
    """

    def forward(self, features: Tensor) -> Tensor:
        """Normalise (M, F) features, each over the poses of the batch."""
        share = _share.get()
        if share is None or not self.training:
            return super().forward(features)
        mean = _mean(features.mean(0), share)
        variance = _mean((features - mean).square().mean(0), share)
        self._remember(mean.detach(), variance.detach() * (share.poses / (share.poses - 1)))
        normalised = (features - mean) * torch.rsqrt(variance + self.eps)
        return normalised * self.weight + self.bias

    def _remember(self, mean: Tensor, variance: Tensor) -> None:
        for running, found in ((self.running_mean, mean), (self.running_var, variance)):
            if running is not None and self.momentum is not None:
                running.lerp_(found, self.momentum)
        if self.num_batches_tracked is not None:
            self.num_batches_tracked.add_(1)
