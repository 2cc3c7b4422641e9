"""What does a person see while a training runs? Two lines on a terminal, a line an epoch elsewhere, both on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text

from posecal.errors import PoseFileError
from posecal_models.train import Progress as Standing
from posecal_models.train import Training

__all__ = ["TrainingBar", "counted", "read_losses", "shown"]


def _losses(standing: Standing) -> str:
    losses = dict(standing.losses)
    if standing.validation is not None:
        losses["validation"] = standing.validation
    return ", ".join(f"{name} {value:.4g}" for name, value in losses.items())


class TrainingBar(Progress):
    """Two lines: epoch, time left, learning rate, steps and a bar; and below it the losses.

    The bar takes what room the line has; what is said never gives way to it.

    Parameters
    ----------
    run : Training
        What is shown.
    console : Console
        Where.
    """

    def __init__(self, run: Training, console: Console) -> None:
        self._run = run
        self._losses = ""
        whole = Column(no_wrap=True)
        super().__init__(
            TextColumn("{task.description}"),
            TimeRemainingColumn(table_column=whole),
            TextColumn("left"),
            TextColumn("learning rate {task.fields[rate]:.2g}"),
            MofNCompleteColumn(table_column=whole),
            BarColumn(bar_width=None),
            console=console,
            expand=True,
        )
        rate = run.schedule.learning_rate(run.step)
        self._steps = self.add_task(self._epoch(), total=run.schedule.total_steps, completed=run.step, rate=rate)

    def tell(self, standing: Standing) -> None:
        """Show where the training stands."""
        self._losses = _losses(standing)
        rate = standing.learning_rate
        self.update(self._steps, completed=standing.step, description=self._epoch(), rate=rate)

    def get_renderables(self) -> Iterable[RenderableType]:
        """Give the two lines."""
        yield self.make_tasks_table(self.tasks)
        if self._losses:
            yield Text(self._losses, no_wrap=True, overflow="ellipsis")

    def _epoch(self) -> str:
        return f"epoch {self._run.epoch + (not self._run.finished)} of {self._run.config.train.epochs}"


@contextmanager
def shown(run: Training) -> Iterator[Callable[[Standing], None]]:
    """Show a training's losses, learning rate and time left.

    Parameters
    ----------
    run : Training
        What is shown. Only the leading process shows anything.

    Yields
    ------
    callable
        For :meth:`posecal_models.train.Training.run`.
    """
    if not run.crew.leads:
        yield lambda _: None
        return
    if sys.stderr.isatty():
        with TrainingBar(run, Console(stderr=True)) as bar:
            yield bar.tell
        return
    told = [run.epoch]

    def tell(standing: Standing) -> None:
        if standing.epoch > told[0]:
            told[0] = standing.epoch
            line = f"step {standing.step:,} of {standing.steps:,}, epoch {standing.epoch}: {_losses(standing)}"
            line += f", learning rate {standing.learning_rate:.2g}"
            print(line, file=sys.stderr, flush=True)  # noqa: T201

    yield tell


@contextmanager
def counted(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how much of something is done, on a terminal; nothing elsewhere.

    Parameters
    ----------
    what : str
        The words beside the bar.
    total : int
        How much there is.

    Yields
    ------
    callable
        Takes how much is done.
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def read_losses(folder: Path) -> npt.NDArray[np.void]:
    """Read the loss curve of a training.

    Parameters
    ----------
    folder : Path
        Of the training, with its ``losses.csv``.

    Returns
    -------
    structured ndarray
        A row an epoch: ``epoch``, ``step``, ``learning_rate``, ``training_loss``, ``validation_loss``.

    Raises
    ------
    PoseFileError
        Where there is none, or no epoch in it.
    """
    path = folder / "losses.csv"
    try:
        rows: npt.NDArray[np.void] = np.genfromtxt(path, delimiter=",", names=True, ndmin=1)
    except (OSError, ValueError) as problem:
        raise PoseFileError(f"{path}: can't be read ({problem}); expected the losses.csv of a training.") from problem
    if not len(rows) or "validation_loss" not in (rows.dtype.names or ()):
        raise PoseFileError(f"{path}: holds no epoch; expected the losses.csv of a training. Train on.")
    return rows
