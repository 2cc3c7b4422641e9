"""Learning-rate schedules and early stopping."""

from __future__ import annotations

import math
from dataclasses import dataclass

from posecal_models.config import TrainConfig

__all__ = ["Schedule"]


@dataclass
class Schedule:
    """The learning rate of a training, and the state that it depends on.

    Attributes
    ----------
    config : TrainConfig
        Initial learning rate, kind and patience.
    total_steps : int
        Steps of the complete training.
    best : float
        The lowest loss of an epoch so far.
    bad_epochs : int
        Epochs since then, or since the last drop.
    drops : int
        Number of drops of the learning rate on a plateau.

    Examples
    --------
    >>> schedule = Schedule(TrainConfig(patience=1), total_steps=100)
    >>> for loss in (3.0, 2.0, 2.5, 2.5):
    ...     schedule.after_epoch(loss)
    >>> schedule.learning_rate(step=50)  # 1e-3, dropped once: two epochs without improvement are more than 1
    0.0001
    """

    config: TrainConfig
    total_steps: int
    best: float = math.inf
    bad_epochs: int = 0
    drops: int = 0

    def learning_rate(self, step: int) -> float:
        """Compute the learning rate of a step, counted from 0."""
        start = self.config.learning_rate
        if self.config.schedule == "cosine":
            return start * 0.5 * (1 + math.cos(math.pi * step / max(1, self.total_steps)))
        if self.config.schedule == "exponential":
            return start * 0.96 ** (step // 100_000)
        if self.config.schedule == "continuous":
            return start * math.pow(0.96, step / 100_000)
        if self.config.schedule == "halved":
            return start * (0.5 if step >= self.total_steps * 150 / 155 else 1)
        return start * 0.1**self.drops

    def after_epoch(self, loss: float) -> None:
        """Update the state with the loss of an epoch."""
        if loss < self.best:
            self.best, self.bad_epochs = loss, 0
            return
        self.bad_epochs += 1
        if self.bad_epochs > self.config.patience:
            self.drops, self.bad_epochs = self.drops + 1, 0

    @property
    def finished(self) -> bool:
        """Whether the third plateau was reached."""
        return self.config.schedule == "plateau" and self.drops >= 3
