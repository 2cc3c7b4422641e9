"""Data-parallel training: every process computes a shard of each batch, and gradients are averaged.

Started by ``torchrun``; every process draws the same full batch and takes its rows, so that any number of processes
computes the same gradient as one (:mod:`posecal_models.batch_shard` has what is not a sum over rows). All start with
the main process's parameters and use its validation loss, so that they stay identical.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch import distributed as torch_distributed

from posecal.errors import PoseDataError
from posecal_models.batch_shard import batch_shard

__all__ = ["ProcessGroup", "torchrun_group"]


@dataclass(frozen=True)
class ProcessGroup:
    """The processes of a distributed training, seen from one of them.

    Attributes
    ----------
    rank : int
        Index of this process.
    size : int
        Number of processes.
    device : torch.device
        Device of this process.
    """

    rank: int = 0
    size: int = 1
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def is_main(self) -> bool:
        """Whether this process writes the files and shows the progress."""
        return self.rank == 0

    def rows(self, poses: int) -> slice:
        """Return this process's rows of a batch.

        Parameters
        ----------
        poses : int
            Size of the batch.

        Returns
        -------
        slice
            Contiguous rows; those of all processes make up the batch.

        Examples
        --------
        >>> [ProcessGroup(rank, 3).rows(8) for rank in range(3)]
        [slice(0, 2, None), slice(2, 5, None), slice(5, 8, None)]
        """
        return slice(poses * self.rank // self.size, poses * (self.rank + 1) // self.size)

    def check_batch(self, poses: int) -> None:
        """Check that every process has at least one pose of a batch.

        Parameters
        ----------
        poses : int
            Size of the batch.

        Raises
        ------
        PoseDataError
            Where there are more processes than poses.
        """
        if poses < self.size:
            raise PoseDataError(
                f"train.batch: {poses} for {self.size} processes; expected a pose or more for each. "
                "Raise it, or start fewer processes."
            )

    @contextmanager
    def batch_shard(self, poses: int) -> Iterator[slice]:
        """Split a batch over the processes; batch norm, dropout and noise are those of the full batch meanwhile.

        Parameters
        ----------
        poses : int
            Size of the batch.

        Yields
        ------
        slice
            This process's rows.
        """
        rows = self.rows(poses)
        if self.size == 1:
            yield rows
            return
        with batch_shard(rows, poses):
            yield rows

    def average(self, tensors: Iterable[Tensor], weight: float) -> None:
        """Replace each process's means over its rows by the mean over the full batch, in place.

        Parameters
        ----------
        tensors : iterable of Tensor
            The same ones in every process.
        weight : float
            This process's rows by those of the batch.
        """
        if self.size == 1:
            return
        tensors = list(tensors)
        flat = torch.cat([tensor.flatten() for tensor in tensors]) * weight
        torch_distributed.all_reduce(flat)
        start = 0
        for tensor in tensors:
            tensor.copy_(flat[start : start + tensor.numel()].view_as(tensor))
            start += tensor.numel()

    @torch.no_grad()
    def broadcast(self, tensors: Iterable[Tensor]) -> None:
        """Replace every process's tensors by those of the main process, in place."""
        if self.size > 1:
            for tensor in tensors:
                torch_distributed.broadcast(tensor, 0)

    def broadcast_number(self, value: float) -> float:
        """Return the main process's number in every process."""
        if self.size == 1:
            return value
        number = torch.tensor([value], dtype=torch.float64, device=self.device)
        self.broadcast([number])
        return float(number)


@contextmanager
def torchrun_group(device: torch.device) -> Iterator[ProcessGroup]:
    """Join the processes that ``torchrun`` started, if it did.

    Parameters
    ----------
    device : torch.device
        Device of the gradients: NCCL connects GPUs, Gloo CPUs.

    Yields
    ------
    ProcessGroup
        A single process without ``torchrun``.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield ProcessGroup(device=device)
        return
    if device.type == "cuda":
        device = torch.device("cuda", int(os.environ["LOCAL_RANK"]))
        torch.cuda.set_device(device)
    torch_distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield ProcessGroup(torch_distributed.get_rank(), torch_distributed.get_world_size(), device)
    finally:
        torch_distributed.destroy_process_group()
