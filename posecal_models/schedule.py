"""How fast does a training learn at each step, and when does it stop?"""

from __future__ import annotations

import math
from dataclasses import dataclass

from posecal_models.config import TrainConfig

__all__ = ["Schedule"]


@dataclass
class Schedule:
    """The learning rate of a training, with the memory that it needs.

    Attributes
    ----------
    config : TrainConfig
        Start, kind and patience.
    total_steps : int
        Steps of the whole training.
    best : float
        The lowest loss of an epoch so far.
    waited : int
        Epochs since then, or since the last drop.
    drops : int
        How often the learning rate fell on a plateau.

    Examples
    --------
    >>> schedule = Schedule(TrainConfig(patience=1), total_steps=100)
    >>> for loss in (3.0, 2.0, 2.5, 2.5):
    ...     schedule.after_epoch(loss)
    >>> schedule.learning_rate(step=50)  # 1e-3, dropped once: two epochs without a new best are more than 1
    0.0001
    """

    config: TrainConfig
    total_steps: int
    best: float = math.inf
    waited: int = 0
    drops: int = 0

    def learning_rate(self, step: int) -> float:
        """Give the learning rate of a step, counted from 0."""
        start = self.config.learning_rate
        if self.config.schedule == "cosine":
            return start * 0.5 * (1 + math.cos(math.pi * step / max(1, self.total_steps)))
        if self.config.schedule == "exponential":
            return start * 0.96 ** (step // 100_000)
        return start * 0.1**self.drops

    def after_epoch(self, loss: float) -> None:
        """Take an epoch's loss into account."""
        if loss < self.best:
            self.best, self.waited = loss, 0
            return
        self.waited += 1
        if self.waited > self.config.patience:
            self.drops, self.waited = self.drops + 1, 0

    @property
    def finished(self) -> bool:
        """Whether the third plateau was reached."""
        return self.config.schedule == "plateau" and self.drops >= 3
