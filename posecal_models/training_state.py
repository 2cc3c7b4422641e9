"""The state of a training in its folder: written whole, and loaded to go on to the same result."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from posecal.data.write import written_together
from posecal.errors import PoseFileError, refuse_unreadable
from posecal_models.checkpoint import read_tensors, save_estimator, write_tensors
from posecal_models.moments import load_moments, moments
from posecal_models.training_folder import CHECKPOINT, WEIGHTS, check_same, write_losses

if TYPE_CHECKING:
    from posecal_models.train import Training

__all__ = ["resume", "save", "selection_loss"]


def save(training: Training) -> None:
    """Write checkpoint, weights and loss curve, all or none.

    Parameters
    ----------
    training : Training
        Whose losses are all read.

    Raises
    ------
    PoseFileError
        Where one can't be written.
    """
    tensors = {f"weights.{name}": tensor for name, tensor in training.estimator.state_dict().items()}
    tensors |= {f"best.{name}": tensor for name, tensor in training.best.items()}
    if training.average is not None:
        tensors |= {f"average.{name}": tensor for name, tensor in training.average.state_dict().items()}
    tensors |= moments(training.optimizer, training.parameters)
    tensors |= {f"objective.{name}": tensor for name, tensor in training.objective.state().items()}
    tensors["losses.steps"] = torch.tensor(training.step_losses, dtype=torch.float64)
    tensors["losses.epochs"] = torch.tensor(training.epoch_losses, dtype=torch.float64).view(-1, 5)
    notes = {
        "config": training.config.table(),
        "epochs": training.epoch,
        "steps": training.step,
        "poses": len(training.data),
    }
    if training.epoch_losses:
        notes["weights_of_step"] = int(min(training.epoch_losses, key=selection_loss)[1])
    with written_together():
        write_tensors(training.folder / CHECKPOINT, tensors, _state(training))
        write_losses(training.folder, training.epoch_losses)
        half = training.config.train.precision == "half"
        save_estimator(
            training.folder / WEIGHTS, training.estimate, tensors=training.best or None, notes=notes, half=half
        )


def _state(training: Training) -> dict[str, Any]:
    return {
        "training": {
            "config": training.config.table(),
            "step": training.step,
            "epoch": training.epoch,
            "data": training.digests,
        },
        "schedule": training.schedule.state_dict(),
    }


def resume(training: Training) -> None:
    """Load the checkpoint in the folder.

    The number of epochs may differ from that at the start; a cosine schedule then changes its slope.

    Parameters
    ----------
    training : Training
        As it was before its first step.

    Raises
    ------
    PoseFileError
        Where there is none, or it is damaged.
    PoseDataError
        Where it is of another configuration or of other data.
    """
    path = training.folder / CHECKPOINT
    tensors, about = read_tensors(path, device=training.data.device)
    if "training" not in about:
        raise PoseFileError(f"{path}: holds no training; expected a checkpoint.")
    with refuse_unreadable(path, "holds no complete training ({}). Give another folder."):
        check_same(path, about["training"], training.config, training.digests)
        training.step, training.epoch = about["training"]["step"], about["training"]["epoch"]
        training.schedule.load_state_dict(about["schedule"], training.step)
        training.estimator.load_state_dict(_with_prefix("weights.", tensors))
        training.best = _with_prefix("best.", tensors)
        if training.average is not None:
            training.average.load_state_dict(_with_prefix("average.", tensors))
        load_moments(training.optimizer, training.parameters, tensors)
        training.objective.load_state(_with_prefix("objective.", tensors))
        training.step_losses = tensors["losses.steps"].tolist()
        training.epoch_losses = [tuple(row) for row in tensors["losses.epochs"].tolist()]


def _with_prefix(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def selection_loss(epoch: tuple[float, ...]) -> float:
    """Return the loss that weights are selected by: that of validation, or of training where there is none.

    Parameters
    ----------
    epoch : tuple of float
        One of :attr:`Training.epoch_losses`.

    Returns
    -------
    float
        Lower is better.
    """
    *_, train, validation = epoch
    return train if math.isnan(validation) else validation
