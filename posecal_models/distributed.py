"""How do several processes train one estimator? Each takes its share of every batch, and gradients are added up.

Started by ``torchrun``; every process draws the same whole batch and takes its rows, so that any number of processes
computes the same gradient as one.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch import distributed as torch_distributed

__all__ = ["Crew", "crew_of_torchrun"]


@dataclass(frozen=True)
class Crew:
    """The processes of a training.

    Attributes
    ----------
    rank : int
        Which one this is.
    size : int
        How many there are.
    device : torch.device
        Where this one computes.
    """

    rank: int = 0
    size: int = 1
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def leads(self) -> bool:
        """Whether this process writes the files and shows the progress."""
        return self.rank == 0

    def share(self, poses: int) -> slice:
        """Give this process's rows of a batch.

        Parameters
        ----------
        poses : int
            Of the whole batch.

        Returns
        -------
        slice
            Contiguous rows; the shares of all processes make up the batch.

        Examples
        --------
        >>> [Crew(rank, 3).share(8) for rank in range(3)]
        [slice(0, 2, None), slice(2, 5, None), slice(5, 8, None)]
        """
        return slice(poses * self.rank // self.size, poses * (self.rank + 1) // self.size)

    def add_up(self, tensors: Iterable[Tensor], share: float) -> None:
        """Replace each process's means over its rows by the mean over the whole batch, in place.

        Parameters
        ----------
        tensors : iterable of Tensor
            The same ones in every process.
        share : float
            This process's rows by those of the batch.
        """
        if self.size == 1:
            return
        tensors = list(tensors)
        flat = torch.cat([tensor.flatten() for tensor in tensors]) * share
        torch_distributed.all_reduce(flat)
        start = 0
        for tensor in tensors:
            tensor.copy_(flat[start : start + tensor.numel()].view_as(tensor))
            start += tensor.numel()

    def wait(self) -> None:
        """Wait until every process has come here."""
        if self.size > 1:
            torch_distributed.barrier()


@contextmanager
def crew_of_torchrun(device: torch.device) -> Iterator[Crew]:
    """Join the processes that ``torchrun`` started, if it did.

    Parameters
    ----------
    device : torch.device
        Where the gradients lie: NCCL connects GPUs, Gloo processors.

    Yields
    ------
    Crew
        One process where there was no ``torchrun``.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Crew(device=device)
        return
    if device.type == "cuda":
        device = torch.device("cuda", int(os.environ["LOCAL_RANK"]))
        torch.cuda.set_device(device)
    torch_distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Crew(torch_distributed.get_rank(), torch_distributed.get_world_size(), device)
    finally:
        torch_distributed.destroy_process_group()
