"""Learning-rate schedules and early stopping, by PyTorch's schedulers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch.optim import SGD
from torch.optim.lr_scheduler import LambdaLR, ReduceLROnPlateau

from posecal_models.settings import TrainConfig

__all__ = ["Schedule"]


class Schedule:
    """The learning rate of a training, by a scheduler of PyTorch.

    The scheduler changes that of an optimizer without weights: a number, in double precision, which is known without
    a synchronisation; the training's own optimizer reads it from a tensor on its device.

    Parameters
    ----------
    config : TrainConfig
        Initial learning rate, kind and patience.
    total_steps : int
        Steps of the complete training.

    Examples
    --------
    >>> schedule = Schedule(TrainConfig(patience=1), total_steps=100)
    >>> for loss in (3.0, 2.0, 2.5, 2.5):
    ...     schedule.after_epoch(loss)
    >>> round(schedule.learning_rate, 9)  # 1e-3, dropped once: two epochs without improvement are more than 1
    0.0001
    """

    def __init__(self, config: TrainConfig, total_steps: int) -> None:
        self.config = config
        self.total_steps = total_steps
        self._holder = SGD([torch.zeros(())], config.learning_rate)
        self._scheduler = self._build()

    def _build(self, step: int = 0) -> LambdaLR | ReduceLROnPlateau:
        total = self.total_steps
        factors = {
            "cosine": lambda step: 0.5 * (1 + math.cos(math.pi * step / max(1, total))),
            "exponential": lambda step: 0.96 ** (step // 100_000),
            "continuous": lambda step: 0.96 ** (step / 100_000),
            "halved": lambda step: 0.5 if step >= total * 150 / 155 else 1.0,
        }
        if self.config.schedule == "plateau":
            return ReduceLROnPlateau(self._holder, patience=self.config.patience, threshold=0, eps=0)
        return LambdaLR(self._holder, factors[self.config.schedule], last_epoch=step - 1)

    @property
    def learning_rate(self) -> float:
        """Learning rate of the next step."""
        rate: float = self._holder.param_groups[0]["lr"]
        return rate

    def after_step(self) -> None:
        """Go on to the next step."""
        if isinstance(self._scheduler, LambdaLR):
            self._holder.step()
            self._scheduler.step()

    def after_epoch(self, loss: float) -> None:
        """Take account of the loss of an epoch."""
        if isinstance(self._scheduler, ReduceLROnPlateau):
            self._scheduler.step(loss)

    @property
    def finished(self) -> bool:
        """Whether the third plateau was reached."""
        return self.config.schedule == "plateau" and self.learning_rate < 10**-2.5 * self.config.learning_rate

    def state_dict(self) -> dict[str, Any]:
        """Return the learning rate and the scheduler's state, plain values."""
        return {**self._scheduler.state_dict(), "learning_rate": self.learning_rate}

    def load_state_dict(self, state: Mapping[str, Any], step: int) -> None:
        """Go on from a step with the state before it; but for a plateau's, all follows from the step."""
        if isinstance(self._scheduler, LambdaLR):
            self._scheduler = self._build(step)
            return
        own = dict(state)
        self._holder.param_groups[0]["lr"] = own.pop("learning_rate")
        self._scheduler.load_state_dict(own)
