"""The interface of training objectives."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from posecal_models.contract import Context

__all__ = ["Objective"]


class Objective(nn.Module):
    """A training loss, a mean over the poses of a batch.

    A call gives the losses by name, ``loss`` among them, which is minimised. Where it gives ``selection`` too, for
    validation poses, that selects the weights that are saved.
    """

    one_process = False
    """Whether what :meth:`before_step` trains is that of one process."""

    def initialise(self, context: Context, truth: Tensor) -> None:
        """Initialise the estimator with a first batch; nothing, where that is not needed."""

    def noise(self, truth: Tensor, generator: torch.Generator) -> Tensor | None:
        """Draw the random numbers of the loss of a batch, so that the loss itself is a function of its inputs."""
        del truth, generator
        return None

    def before_step(self, context: Context, truth: Tensor, noise: Tensor | None, learning_rate: float) -> None:
        """Train what the loss itself consists of, such as a critic; nothing, where there is none."""

    def state(self) -> dict[str, Tensor]:
        """Return what a checkpoint has to hold of it."""
        return {}

    def load_state(self, tensors: Mapping[str, Tensor]) -> None:
        """Load what :meth:`state` returned."""
