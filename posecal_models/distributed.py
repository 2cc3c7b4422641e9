"""How do several processes train one estimator? Each takes its share of every batch, and gradients are added up.

Started by ``torchrun``; every process draws the same whole batch and takes its rows, so that any number of processes
computes the same gradient as one (:mod:`posecal_models.whole_batch` has what is not a sum over rows). They begin with
the first process's numbers, and its validation loss counts for all, so that they can't part.
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
from posecal_models.whole_batch import sharing

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

    def check_batch(self, poses: int) -> None:
        """Refuse a batch of which some process would have no share.

        Parameters
        ----------
        poses : int
            Of the whole batch.

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
    def sharing(self, poses: int) -> Iterator[slice]:
        """Share a batch; what needs the whole of it, such as batch norm, sees the whole meanwhile.

        Parameters
        ----------
        poses : int
            Of the whole batch.

        Yields
        ------
        slice
            This process's rows.
        """
        rows = self.share(poses)
        if self.size == 1:
            yield rows
            return
        with sharing(rows, poses):
            yield rows

    def accumulate(self, tensors: Iterable[Tensor], share: float) -> None:
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

    @torch.no_grad()
    def follow(self, tensors: Iterable[Tensor]) -> None:
        """Replace every process's tensors by those of the leading one, in place."""
        if self.size > 1:
            for tensor in tensors:
                torch_distributed.broadcast(tensor, 0)

    def agree(self, value: float) -> float:
        """Give the leading process's number, whatever the others found."""
        if self.size == 1:
            return value
        number = torch.tensor([value], dtype=torch.float64, device=self.device)
        self.follow([number])
        return float(number)


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
