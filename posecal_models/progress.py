"""Progress of trainings and samplings on stderr: bars on a terminal, else a line per epoch."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text

from posecal.errors import PoseFileError, refuse_unreadable
from posecal.metrics.likelihood import SMALLEST_DEVIATION
from posecal_models.train import Training, TrainingProgress

__all__ = ["TrainingProgressBar", "note_on_selection", "progress_bar", "read_losses", "training_progress"]


def _losses(progress: TrainingProgress) -> str:
    losses = dict(progress.losses)
    if progress.validation is not None:
        losses["validation"] = progress.validation
    return ", ".join(f"{name} {value:.4g}" for name, value in losses.items())


class TrainingProgressBar(Progress):
    """Two lines: epoch, time left, learning rate, steps and a bar; below them the losses.

    The bar fills the rest of the line; the text is never shortened for it.

    Parameters
    ----------
    run : Training
        The training.
    console : Console
        The terminal.
    """

    def __init__(self, run: Training, console: Console) -> None:
        self._run = run
        self._losses = ""
        no_wrap = Column(no_wrap=True)
        super().__init__(
            TextColumn("{task.description}"),
            TimeRemainingColumn(table_column=no_wrap),
            TextColumn("left"),
            TextColumn("learning rate {task.fields[rate]:.2g}"),
            MofNCompleteColumn(table_column=no_wrap),
            BarColumn(bar_width=None),
            console=console,
            expand=True,
        )
        schedule = run.schedule
        self._steps = self.add_task(
            self._epoch(), total=schedule.total_steps, completed=run.step, rate=schedule.learning_rate
        )

    def show(self, progress: TrainingProgress) -> None:
        """Show the progress of the training."""
        self._losses = _losses(progress)
        rate = progress.learning_rate
        self.update(self._steps, completed=progress.step, description=self._epoch(), rate=rate)

    def get_renderables(self) -> Iterable[RenderableType]:
        """Yield the two lines."""
        yield self.make_tasks_table(self.tasks)
        if self._losses:
            yield Text(self._losses, no_wrap=True, overflow="ellipsis")

    def _epoch(self) -> str:
        return f"epoch {self._run.epoch + (not self._run.finished)} of {self._run.config.train.epochs}"


@contextmanager
def training_progress(run: Training) -> Iterator[Callable[[TrainingProgress], None]]:
    """Show a training's losses, learning rate and time left.

    Parameters
    ----------
    run : Training
        The training. Only the main process shows anything.

    Yields
    ------
    callable
        For :meth:`posecal_models.train.Training.run`.
    """
    if not run.processes.is_main:
        yield lambda _: None
        return
    if note := note_on_selection(run):
        print(note, file=sys.stderr, flush=True)  # noqa: T201
    if sys.stderr.isatty():
        with TrainingProgressBar(run, Console(stderr=True)) as bar:
            yield bar.show
        return
    last_epoch = run.epoch

    def print_epoch(progress: TrainingProgress) -> None:
        nonlocal last_epoch
        if progress.epoch > last_epoch:
            last_epoch = progress.epoch
            line = f"step {progress.step:,} of {progress.steps:,}, epoch {progress.epoch}: {_losses(progress)}"
            line += f", learning rate {progress.learning_rate:.2g}"
            print(line, file=sys.stderr, flush=True)  # noqa: T201

    yield print_epoch


def note_on_selection(run: Training) -> str:
    """Say where the weights are selected by a likelihood that has no bound.

    Parameters
    ----------
    run : Training
        The training.

    Returns
    -------
    str
        A note, where a cGNF's weights are selected by its loss on poses that don't vary in every direction; else empty.
    """
    if run.validation is None or run.config.model.kind != "cgnf" or run.config.train.selection != "loss":
        return ""
    poses = run.validation.poses.cpu().flatten(1).double()  # Apple GPUs have no double precision
    variances = torch.linalg.eigvalsh(poses.T.cov())
    fixed = int((variances < SMALLEST_DEVIATION**2).sum())
    if not fixed or len(poses) <= len(variances):
        return ""
    return (
        f"note: the validation poses don't vary in {fixed} of {len(variances)} directions (standard deviation below "
        f"{SMALLEST_DEVIATION} mm), so that the likelihood that selects the weights has no bound. train.selection = "
        "energy-score selects them by samples."
    )


@contextmanager
def progress_bar(description: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on a terminal; nothing elsewhere.

    Parameters
    ----------
    description : str
        The text beside the bar.
    total : int
        Number of items.

    Yields
    ------
    callable
        Takes the number of items done.
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(description, total=total)
        yield lambda done: bar.update(task, completed=done)


def read_losses(folder: Path) -> npt.NDArray[np.void]:
    """Read the loss curve of a training.

    Parameters
    ----------
    folder : Path
        Folder of the training, with its ``losses.csv``.

    Returns
    -------
    structured ndarray
        A row per epoch: ``epoch``, ``step``, ``learning_rate``, ``training_loss``, ``validation_loss``.

    Raises
    ------
    PoseFileError
        Where the file is missing or holds no epoch.
    """
    path = folder / "losses.csv"
    sentence = "can't be read ({}); expected the losses.csv of a training."
    with refuse_unreadable(path, sentence), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of an empty file
        rows: npt.NDArray[np.void] = np.genfromtxt(path, delimiter=",", names=True, ndmin=1)
        numbers = [rows[name] for name in ("step", "training_loss", "validation_loss")]
        if np.isinf(numbers).any() or np.isnan(numbers[1]).any():
            raise ValueError("a loss is no number")
    if not len(rows):
        raise PoseFileError(f"{path}: holds no epoch; expected the losses.csv of a training. Train longer.")
    return rows
