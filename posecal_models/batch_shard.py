"""Batch norm, dropout and noise of a batch that is split over processes.

Within :func:`batch_shard` a process holds some rows of a batch, and the functions here compute as if it held all: batch
norm takes the statistics of all rows, and noise is drawn for all rows, of which each process takes its own. Outside of
it, and in a training of one process, they are PyTorch's own.
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

__all__ = ["BatchNorm", "batch_shard", "draw_rows", "dropout"]


@dataclass(frozen=True)
class _Shard:
    rows: slice
    poses: int

    @property
    def weight(self) -> float:
        return float(self.rows.stop - self.rows.start) / self.poses


_shard: ContextVar[_Shard | None] = ContextVar("shard", default=None)


@contextmanager
def batch_shard(rows: slice, poses: int) -> Iterator[None]:
    """Declare that this process holds some rows of a batch, and other processes the rest.

    Parameters
    ----------
    rows : slice
        This process's poses; at least one.
    poses : int
        Size of the batch.
    """
    token = _shard.set(_Shard(rows, poses))
    try:
        yield
    finally:
        _shard.reset(token)


def draw_rows(draw: Callable[[int], Tensor], poses: int, *, axis: int = 0) -> Tensor:
    """Draw random numbers for this process's poses, the same for each pose as in a single process.

    Parameters
    ----------
    draw : callable
        Takes a number of poses and draws for as many.
    poses : int
        Number of this process's poses.
    axis : int
        The axis of the poses in the result.

    Returns
    -------
    Tensor
        Of this many poses.

    Examples
    --------
    >>> def draw(poses):
    ...     return torch.rand(poses, generator=torch.Generator().manual_seed(0))
    >>> with batch_shard(slice(3, 5), 5):
    ...     rows = draw_rows(draw, 2)
    >>> bool((rows == draw(5)[3:5]).all())
    True
    """
    shard = _shard.get()
    return draw(poses) if shard is None else draw(shard.poses).narrow(axis, shard.rows.start, poses)


def dropout(features: Tensor, probability: float, *, training: bool) -> Tensor:
    """Set a share of the features to 0 in training, and scale up the others.

    Parameters
    ----------
    features : Tensor
        (M, F).
    probability : float
        The share that is set to 0.
    training : bool
        Where false, features are returned as they are.

    Returns
    -------
    Tensor
        (M, F).
    """
    if not training or _shard.get() is None:
        return functional.dropout(features, probability, training)
    width = features.shape[1:]

    def draw(poses: int) -> Tensor:
        return functional.dropout(features.new_ones(poses, *width), probability)

    return features * draw_rows(draw, len(features))


class _Mean(torch.autograd.Function):
    """The mean over the processes, weighted by their rows.

    A process's loss is a mean over its own rows, and the loss of the batch is the weighted mean of those. So the
    gradient is the weighted mean of the processes' gradients.
    """

    @staticmethod
    def forward(ctx: Any, local: Tensor, weight: float) -> Tensor:
        ctx.weight = weight
        return _weighted_sum(local, weight)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        return _weighted_sum(gradients[0], ctx.weight), None


def _mean(local: Tensor, shard: _Shard) -> Tensor:
    mean: Tensor = _Mean.apply(local, shard.weight)  # type: ignore[no-untyped-call]
    return mean


def _weighted_sum(local: Tensor, weight: float) -> Tensor:
    total = local * weight
    torch_distributed.all_reduce(total)
    return total


class BatchNorm(nn.BatchNorm1d):
    """Batch norm with the statistics of the full batch, on any device and for shards of any sizes.

    Notes
    -----
    ``torch.nn.SyncBatchNorm`` needs GPUs, and its gradient is that of shards of equal size.
    """

    def forward(self, features: Tensor) -> Tensor:
        """Normalise (M, F) features, each over the poses of the batch."""
        shard = _shard.get()
        if shard is None or not self.training:
            return super().forward(features)
        mean = _mean(features.mean(0), shard)
        variance = _mean((features - mean).square().mean(0), shard)
        self._update_running_statistics(mean.detach(), variance.detach() * (shard.poses / (shard.poses - 1)))
        normalised = (features - mean) * torch.rsqrt(variance + self.eps)
        return normalised * self.weight + self.bias

    def _update_running_statistics(self, mean: Tensor, variance: Tensor) -> None:
        for running, current in ((self.running_mean, mean), (self.running_var, variance)):
            if running is not None and self.momentum is not None:
                running.lerp_(current, self.momentum)
        if self.num_batches_tracked is not None:
            self.num_batches_tracked.add_(1)
