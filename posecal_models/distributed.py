"""Processes of a data-parallel training, started by ``torchrun``.

Every process draws the same batch and takes its rows; :class:`torch.nn.parallel.DistributedDataParallel` averages the
gradients, :class:`torch.nn.SyncBatchNorm` the batch statistics of GPUs. The main process's validation loss is used by
all, so that they stay identical.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch import distributed as torch_distributed

from posecal.errors import PoseDataError

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
            Size of the batch, a multiple of the number of processes.

        Returns
        -------
        slice
            Contiguous rows; those of all processes make up the batch.

        Examples
        --------
        >>> [ProcessGroup(rank, 3).rows(6) for rank in range(3)]
        [slice(0, 2, None), slice(2, 4, None), slice(4, 6, None)]
        """
        share = poses // self.size
        return slice(share * self.rank, share * (self.rank + 1))

    def check_batch(self, poses: int) -> None:
        """Check that all processes have equally many poses of a batch, so that the mean gradient is that of the batch.

        Parameters
        ----------
        poses : int
            Size of the batch.

        Raises
        ------
        PoseDataError
            Where the processes can't share it equally.
        """
        if poses % self.size:
            raise PoseDataError(
                f"train.batch: {poses} for {self.size} processes; expected a multiple of {self.size}, equally many "
                "poses for each."
            )

    def check_cuda_graph(self, recorded: bool) -> None:
        """Refuse the recording of a step that several processes share."""
        if recorded and self.size > 1:
            raise PoseDataError(f"train.cuda_graph: true for {self.size} processes; expected one. Leave it out.")

    def mean(self, numbers: Tensor) -> Tensor:
        """Average numbers of the shares of a batch over the processes."""
        if self.size == 1:
            return numbers
        total = numbers.clone()
        torch_distributed.all_reduce(total)
        return total / self.size

    def broadcast(self, value: float) -> float:
        """Return the main process's number in every process."""
        if self.size == 1:
            return value
        number = torch.tensor([value], device=self.device)
        torch_distributed.broadcast(number, 0)
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
        torch_distributed.init_process_group("nccl", device_id=device)
    else:
        torch_distributed.init_process_group("gloo")
    try:
        yield ProcessGroup(torch_distributed.get_rank(), torch_distributed.get_world_size(), device)
    finally:
        torch_distributed.destroy_process_group()
