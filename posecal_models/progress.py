"""What does a person see while a training runs? A bar on a terminal, a line an epoch elsewhere, both on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from posecal.errors import PoseFileError
from posecal_models.train import Progress as Standing
from posecal_models.train import Training

__all__ = ["counted", "read_losses", "shown"]


def _words(standing: Standing, epoch: int) -> str:
    losses = ", ".join(f"{name} {value:.4g}" for name, value in standing.losses.items())
    validation = "" if standing.validation is None else f", validation {standing.validation:.4g}"
    return f"epoch {epoch}: {losses}{validation}, learning rate {standing.learning_rate:.2g}"


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
        columns = (
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
        )
        with Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task("", total=run.schedule.total_steps, completed=run.step)
            yield lambda s: bar.update(task, completed=s.step, description=_words(s, s.epoch + 1))
        return
    told = [run.epoch]

    def tell(standing: Standing) -> None:
        if standing.epoch > told[0]:
            told[0] = standing.epoch
            line = f"step {standing.step:,} of {standing.steps:,}, {_words(standing, standing.epoch)}"
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
