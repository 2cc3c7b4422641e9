"""A training step as a CUDA graph, recorded once and replayed.

A step of a small flow is thousands of short kernels; launched one by one from Python they take longer to launch than to
run. A graph is launched as one. Forward and backward pass, clipping and Adam are all in it.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from posecal.errors import PoseDataError

__all__ = ["RecordedStep"]

_WARM_UP = 3


class RecordedStep:
    """A function of tensors that is recorded as a CUDA graph at its fourth call; the first three run as they are.

    Parameters
    ----------
    step : callable
        Takes tensors of the same shapes at each call, and gives a tensor. It must not synchronise.
    device : torch.device
        A GPU.

    Raises
    ------
    PoseDataError
        Where the device is no GPU of CUDA.
    """

    def __init__(self, step: Callable[..., Tensor], device: torch.device) -> None:
        if device.type != "cuda":
            raise PoseDataError(f"train.cuda_graph: true with the device {device}; expected cuda. Leave it out.")
        self._step = step
        self._calls = 0
        self._inputs: tuple[Tensor, ...] = ()
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self, *inputs: Tensor) -> Tensor:
        """Run the step."""
        if self._calls < _WARM_UP:
            return self._warm_up(*inputs)
        if self._graph is None:
            self._inputs = tuple(tensor.clone() for tensor in inputs)
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph):
                self._result = self._step(*self._inputs)
        for static, tensor in zip(self._inputs, inputs, strict=True):
            static.copy_(tensor)
        self._graph.replay()
        return self._result.clone()

    def _warm_up(self, *inputs: Tensor) -> Tensor:
        """Run a step on a stream of its own, as a recording needs it before."""
        self._calls += 1
        side_stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        side_stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side_stream):
            result = self._step(*inputs)
        torch.cuda.current_stream().wait_stream(side_stream)
        return result
