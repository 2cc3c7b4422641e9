"""Losses and learning rate of a training as scalars for TensorBoard."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.train import Training, TrainingProgress

__all__ = ["summary_writer", "tensorboard_log"]


def summary_writer() -> type[Any]:
    """Import the class that writes TensorBoard's files.

    Returns
    -------
    type
        ``torch.utils.tensorboard.SummaryWriter``.

    Raises
    ------
    PoseDataError
        Where the package ``tensorboard`` is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as problem:
        raise PoseDataError(
            f"tensorboard: can't be imported ({problem}); expected the package of that name. "
            'Install it with pip install "posecal[tensorboard]".'
        ) from problem
    return SummaryWriter


@contextmanager
def tensorboard_log(run: Training, folder: Path | None) -> Iterator[Callable[[TrainingProgress], None]]:
    """Write a training's losses and learning rate for TensorBoard.

    Parameters
    ----------
    run : Training
        The training. Only the main process writes.
    folder : Path or None
        Where TensorBoard looks for files; a resumed training goes on in the same curves. None: nothing is written.

    Yields
    ------
    callable
        For :meth:`posecal_models.train.Training.run`: writes after each step whose losses were read, and the validation
        loss after each epoch.

    Raises
    ------
    PoseDataError
        Where the package ``tensorboard`` is not installed.
    PoseFileError
        Where the folder can't be written.
    """
    if folder is None or not run.processes.is_main:
        yield lambda _: None
        return
    writer_class, epoch, steps_read = summary_writer(), run.epoch, len(run.step_losses)
    try:
        writer = writer_class(str(folder), purge_step=run.step + 1)
    except OSError as problem:
        raise PoseFileError(f"{folder}: can't be written ({problem.strerror}).") from problem

    def write(progress: TrainingProgress) -> None:
        nonlocal epoch, steps_read
        if len(run.step_losses) > steps_read:
            steps_read = len(run.step_losses)
            for name, value in progress.losses.items():
                writer.add_scalar(f"training/{name}", value, progress.step)
            writer.add_scalar("learning rate", progress.learning_rate, progress.step)
        if progress.epoch > epoch and progress.validation is not None:
            writer.add_scalar("validation/loss", progress.validation, progress.step)
        epoch = progress.epoch

    with writer:
        yield write
