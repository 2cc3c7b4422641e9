"""The training loop: batches, steps, epochs, checkpoints.

All random numbers of a step depend on the seed and the step's number alone, so that a training that was interrupted, by
``kill -9`` or by a power cut, resumes from its last checkpoint and ends with the same result as without interruption.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from posecal.data.write import written_together
from posecal.errors import PoseDataError, PoseFileError, refuse_unreadable
from posecal_models.checkpoint import read_tensors, save_estimator, write_tensors
from posecal_models.config import Config
from posecal_models.cuda_graph import CudaGraphObjective
from posecal_models.data.training_set import TrainingSet, draw_graphs, seeded_generator
from posecal_models.distributed import ProcessGroup
from posecal_models.estimators.registry import ReferenceEstimator
from posecal_models.objectives import Objective, build_objective
from posecal_models.schedule import Schedule
from posecal_models.training_folder import CHECKPOINT, WEIGHTS, check_same, write_losses

__all__ = ["Training", "TrainingProgress"]

_ORDER, _BATCH, _VALIDATION = 1, 2, 3


@dataclass(frozen=True)
class TrainingProgress:
    """The progress of a training, for display.

    Attributes
    ----------
    epoch, step, steps : int
        Epochs and steps done, and the steps of the complete training.
    learning_rate : float
        Learning rate of the last step.
    losses : dict of str to float
        Losses of the last step.
    validation : float or None
        Validation loss after the last epoch; None before, and where there are no validation poses.
    """

    epoch: int
    step: int
    steps: int
    learning_rate: float
    losses: dict[str, float]
    validation: float | None


class Training:
    """A training that can be stopped and resumed at any time.

    Parameters
    ----------
    estimator : CGNF, SimpleBaseline or GaussianNoise
        The estimator to train, on the device of the training.
    config : Config
        The configuration.
    data : TrainingSet
        The training set, on the same device.
    validation : TrainingSet, optional
        Poses that control the learning rate and select the weights that are saved.
    folder : Path
        Folder of ``checkpoint.safetensors``, ``weights.safetensors`` and ``losses.csv``.
    processes : ProcessGroup
        The processes of a distributed training.
    digests : dict of str to str
        Digests of the data, see :func:`posecal_models.training_folder.digests`; saved in the checkpoint.

    Attributes
    ----------
    step, epoch : int
        Steps and epochs done so far.
    """

    def __init__(
        self,
        estimator: ReferenceEstimator,
        config: Config,
        data: TrainingSet,
        *,
        folder: Path,
        validation: TrainingSet | None = None,
        processes: ProcessGroup | None = None,
        digests: dict[str, str] | None = None,
    ) -> None:
        self.estimator = estimator
        self.config = config
        self.data = data
        self.validation = validation
        self.folder = folder
        self.processes = processes or ProcessGroup()
        self.digests = digests or {}
        self.parameters = {name: p for name, p in estimator.named_parameters() if self._is_trainable(name)}
        self.objective: Objective = build_objective(estimator, config.train)
        if config.train.cuda_graph:
            self.objective = CudaGraphObjective(self.objective, list(self.parameters.values()), data.device)
        self.optimizer = torch.optim.Adam(self.parameters.values(), lr=config.train.learning_rate, fused=True)
        self.steps_per_epoch = config.train.steps_per_epoch or math.ceil(len(data) / config.train.batch)
        self.schedule = Schedule(config.train, self.steps_per_epoch * config.train.epochs)
        self.step = self.epoch = 0
        self._synchronised = False
        self.best: dict[str, Tensor] = {}
        self._step_losses: list[float] = []
        self._epochs: list[tuple[float, ...]] = []
        self._order: tuple[int, Tensor] | None = None

    def run(self, *, on_step: Callable[[TrainingProgress], None] | None = None, max_steps: int | None = None) -> None:
        """Train until the end.

        Parameters
        ----------
        on_step : callable, optional
            Called with the progress after each step.
        max_steps : int, optional
            Stop, with a checkpoint, when this many steps are done.

        Raises
        ------
        PoseDataError
            Where a loss, of training or validation, or a gradient is no longer finite.
        PoseFileError
            Where a file can't be written.
        """
        saved = time.monotonic()
        while not self.finished:
            if max_steps is not None and self.step >= max_steps:
                break
            losses = self._one_step()
            if self.step % self.steps_per_epoch == 0:
                self._end_epoch()
                self.save()
                saved = time.monotonic()
            elif time.monotonic() - saved > self.config.train.checkpoint_seconds:
                self.save()
                saved = time.monotonic()
            if on_step is not None:
                on_step(self._progress(losses))
        self.save()

    @property
    def finished(self) -> bool:
        """Whether all epochs are done or the schedule stops."""
        return self.epoch >= self.config.train.epochs or self.schedule.finished

    def _is_trainable(self, name: str) -> bool:
        return self.config.model.kind != "gaussian-noise" or not name.startswith("mean.")

    def _rows(self, step: int) -> Tensor:
        """Return the poses of a step, from consecutive random permutations of the training set."""
        batch, poses = self.config.train.batch, len(self.data)
        positions = torch.arange(step * batch, (step + 1) * batch)
        rows = torch.empty_like(positions)
        for index in torch.unique(positions // poses).tolist():
            if self._order is None or self._order[0] != index:
                generator = seeded_generator("cpu", self.config.train.seed, _ORDER, index)
                self._order = (index, torch.randperm(poses, generator=generator))
            selected = positions // poses == index
            rows[selected] = self._order[1][positions[selected] % poses]
        return rows.to(self.data.device)

    def _one_step(self) -> dict[str, float]:
        config = self.config.train
        generator = seeded_generator(self.data.device, config.seed, _BATCH, self.step)
        context, truth = self.data.batch(self._rows(self.step), generator)
        graphs = config.graphs_per_pose if self.config.model.kind == "cgnf" else 1
        if self.config.model.kind == "cgnf":
            context, truth = draw_graphs(
                context,
                truth,
                graphs_per_pose=graphs,
                first=self.step,
                augmentation=config.augmentation,
                generator=generator,
                root=self.config.model.origin == "root",
            )
        if self.step == 0 and not self.config.model.start:
            self.objective.initialise(context, truth)
        if not self._synchronised:
            self.processes.broadcast(self.estimator.state_dict().values())
            self._synchronised = True

        self.estimator.train()
        learning_rate = self.schedule.learning_rate(self.step)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate
        self.optimizer.zero_grad(set_to_none=False)
        device = self.data.device
        gpus = [device] if device.type == "cuda" else []
        with torch.random.fork_rng(devices=gpus), self.processes.batch_shard(len(truth) // graphs) as poses:
            torch.manual_seed(generator.initial_seed())
            rows = slice(poses.start * graphs, poses.stop * graphs)
            losses = self.objective.backward(context[rows], truth[rows], generator=generator, graphs_per_pose=graphs)
        gradients = [p.grad for p in self.parameters.values() if p.grad is not None]
        self.processes.average([*gradients, *losses.values()], (rows.stop - rows.start) / len(truth))
        norm = torch.nn.utils.clip_grad_norm_(self.parameters.values(), config.clip)
        values = {name: float(loss) for name, loss in losses.items()}
        self._check_finite(values, float(norm))
        self.optimizer.step()
        self.step += 1
        self._step_losses.append(values["loss"])
        return values

    def _check_finite(self, losses: dict[str, float], norm: float) -> None:
        if all(map(math.isfinite, losses.values())) and math.isfinite(norm):
            return
        broken = [name for name, p in self.parameters.items() if p.grad is not None and not p.grad.isfinite().all()]
        raise PoseDataError(
            f"training: at step {self.step:,} (epoch {self.epoch + 1}) "
            + ", ".join(f"{name} is {value:.6g}" for name, value in losses.items())
            + f", the gradient's norm {norm:.6g}, not finite in {len(broken)} of {len(self.parameters)} tensors"
            + (f" (first: {broken[0]})" if broken else "")
            + f". {self._advice(self.step)} or check the poses of this batch."
        )

    def _advice(self, step: int) -> str:
        checkpoint = f"The checkpoint in {self.folder} is from before. " if (self.folder / CHECKPOINT).exists() else ""
        return f"{checkpoint}Lower train.learning_rate ({self.schedule.learning_rate(step):.3g})"

    def _end_epoch(self) -> None:
        self.epoch += 1
        recent = self._step_losses[-self.steps_per_epoch :]
        train = sum(recent) / len(recent)
        validation = self._validate()
        rate = self.schedule.learning_rate(self.step - 1)
        validation_loss = math.nan if validation is None else validation
        self._epochs.append((float(self.epoch), float(self.step), rate, train, validation_loss))
        loss = _selection_loss(self._epochs[-1])
        if loss < self.schedule.best:
            self.best = {name: t.detach().clone() for name, t in self.estimator.state_dict().items()}
        self.schedule.after_epoch(loss)

    def _validate(self) -> float | None:
        if self.validation is None:
            return None
        self.estimator.eval()
        generator = seeded_generator(self.validation.device, self.config.train.seed, _VALIDATION)
        rows = torch.arange(len(self.validation), device=self.validation.device)
        context, truth = self.validation.batch(rows, generator)
        local_losses = self.objective.evaluate(context, truth, generator=generator)
        losses = {name: self.processes.broadcast_number(float(loss)) for name, loss in local_losses.items()}
        if not all(map(math.isfinite, losses.values())):
            raise PoseDataError(
                f"validation: after step {self.step:,} (epoch {self.epoch}) "
                + ", ".join(f"{name} is {value:.6g}" for name, value in losses.items())
                + f". {self._advice(self.step - 1)} or check the poses of data.validation_subjects."
            )
        return losses["loss"]

    def _progress(self, losses: dict[str, float]) -> TrainingProgress:
        return TrainingProgress(
            self.epoch,
            self.step,
            self.schedule.total_steps,
            self.schedule.learning_rate(self.step - 1),
            losses,
            self._epochs[-1][-1] if self._epochs and self.validation is not None else None,
        )

    def save(self) -> None:
        """Write checkpoint, weights and loss curve, all or none.

        Raises
        ------
        PoseFileError
            Where one can't be written.
        """
        if not self.processes.is_main:
            return
        tensors = {f"weights.{name}": tensor for name, tensor in self.estimator.state_dict().items()}
        tensors |= {f"best.{name}": tensor for name, tensor in self.best.items()}
        for name, parameter in self.parameters.items():
            for moment, tensor in self.optimizer.state.get(parameter, {}).items():
                tensors[f"adam.{moment}.{name}"] = tensor
        tensors["losses.steps"] = torch.tensor(self._step_losses, dtype=torch.float64)
        tensors["losses.epochs"] = torch.tensor(self._epochs, dtype=torch.float64).view(-1, 5)
        notes = {"config": self.config.table(), "epochs": self.epoch, "steps": self.step, "poses": len(self.data)}
        if self._epochs:
            notes["weights_of_step"] = int(min(self._epochs, key=_selection_loss)[1])
        with written_together():
            write_tensors(self.folder / CHECKPOINT, tensors, self._state())
            write_losses(self.folder, self._epochs)
            save_estimator(self.folder / WEIGHTS, self.estimator, tensors=self.best or None, notes=notes)

    def _state(self) -> dict[str, Any]:
        schedule = self.schedule
        return {
            "training": {"config": self.config.table(), "step": self.step, "epoch": self.epoch, "data": self.digests},
            "schedule": {"best": schedule.best, "waited": schedule.bad_epochs, "drops": schedule.drops},
        }

    def resume(self) -> None:
        """Load the checkpoint in the folder.

        The number of epochs may differ from that at the start; a cosine schedule then changes its slope.

        Raises
        ------
        PoseFileError
            Where there is none, or it is damaged.
        PoseDataError
            Where it is of another configuration or of other data.
        """
        path = self.folder / CHECKPOINT
        tensors, about = read_tensors(path, device=self.data.device)
        if "training" not in about:
            raise PoseFileError(f"{path}: holds no training; expected a checkpoint.")
        with refuse_unreadable(path, "holds no complete training ({}). Give another folder."):
            check_same(path, about["training"], self.config, self.digests)
            self.step, self.epoch = about["training"]["step"], about["training"]["epoch"]
            schedule = about["schedule"]
            self.schedule.best, self.schedule.bad_epochs = schedule["best"], schedule["waited"]
            self.schedule.drops = schedule["drops"]
            self.estimator.load_state_dict(_with_prefix("weights.", tensors))
            self.best = _with_prefix("best.", tensors)
            for name, parameter in self.parameters.items():
                moments = {
                    moment: tensors[f"adam.{moment}.{name}"]
                    for moment in ("step", "exp_avg", "exp_avg_sq")
                    if f"adam.{moment}.{name}" in tensors
                }
                if moments:
                    self.optimizer.state[parameter] = moments
            self._step_losses = tensors["losses.steps"].tolist()
            self._epochs = [tuple(row) for row in tensors["losses.epochs"].tolist()]

    @property
    def step_losses(self) -> list[float]:
        """The loss of every step so far."""
        return list(self._step_losses)


def _with_prefix(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _selection_loss(epoch: tuple[float, ...]) -> float:
    """Return the loss that weights are selected by: that of validation, or of training where there is none."""
    *_, train, validation = epoch
    return train if math.isnan(validation) else validation
