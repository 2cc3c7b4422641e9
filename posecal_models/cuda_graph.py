"""Losses and gradients of a batch as a CUDA graph, recorded once and replayed.

A step of a small flow is hundreds of short kernels; launched one by one from Python they take longer to launch than to
run. A graph is launched as one. Batches must keep their shapes, as those of the training loop do.
"""

from __future__ import annotations

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.objectives import Objective

__all__ = ["CudaGraphObjective"]

_WARM_UP = 3


class CudaGraphObjective:
    """An objective whose backward pass is recorded as a CUDA graph at its first batch.

    The graph uses the objective's memory: its own ``backward`` must not be called any more.

    Parameters
    ----------
    objective : Objective
        The objective to record.
    parameters : list of Tensor
        The parameters that it computes gradients of.
    device : torch.device
        A GPU.

    Raises
    ------
    PoseDataError
        Where the device is no GPU.
    """

    def __init__(self, objective: Objective, parameters: list[Tensor], device: torch.device) -> None:
        if device.type != "cuda":
            raise PoseDataError(f"train.cuda_graph: true with the device {device}; expected a GPU. Leave it out.")
        self._objective = objective
        self._parameters = parameters
        self._graph: torch.cuda.CUDAGraph | None = None

    def initialise(self, context: Context, truth: Tensor) -> None:
        """Initialise the estimator with a first batch."""
        self._objective.initialise(context, truth)

    def evaluate(self, context: Context, truth: Tensor, *, generator: torch.Generator) -> dict[str, Tensor]:
        """Compute the losses without gradients."""
        return self._objective.evaluate(context, truth, generator=generator)

    def backward(
        self, context: Context, truth: Tensor, *, generator: torch.Generator, graphs_per_pose: int = 1
    ) -> dict[str, Tensor]:
        """Add the batch's gradients to those of the parameters, which must exist already, and return the losses."""
        if self._graph is None:
            self._context = Context(context.keypoints.clone(), context.observed.clone())
            self._truth = truth.clone()
            self._record(generator, graphs_per_pose)
        if truth.shape != self._truth.shape:
            raise PoseDataError(
                f"batch: {len(truth)} graphs after batches of {len(self._truth)}; expected one size. "
                "Leave train.cuda_graph out."
            )
        self._context.keypoints.copy_(context.keypoints)
        self._context.observed.copy_(context.observed)
        self._truth.copy_(truth)
        if self._graph is not None:
            self._graph.replay()
        return {name: loss.clone() for name, loss in self._losses.items()}

    def _record(self, generator: torch.Generator, graphs_per_pose: int) -> None:
        def step() -> dict[str, Tensor]:
            return self._objective.backward(
                self._context, self._truth, generator=generator, graphs_per_pose=graphs_per_pose
            )

        side_stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        side_stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side_stream):
            for _ in range(_WARM_UP):
                step()
        torch.cuda.current_stream().wait_stream(side_stream)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._losses = step()
        self._graph = graph
        for parameter in self._parameters:  # gradients of warm-up and recording
            if parameter.grad is not None:
                parameter.grad.zero_()
