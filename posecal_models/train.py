"""How does an estimator learn? The training loop: batches, steps, epochs, checkpoints.

Whatever is random in a step depends on the seed and the step's number alone, so that a training that was interrupted,
by ``kill -9`` or by a power cut, goes on from its last checkpoint to the very result that it would have had.
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

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.checkpoint import read_tensors, save_estimator, write_tensors
from posecal_models.config import Config
from posecal_models.cuda_graph import Recorded
from posecal_models.data.training_set import TrainingSet, draw_graphs, seeded
from posecal_models.distributed import Crew
from posecal_models.estimators import ReferenceEstimator
from posecal_models.objectives import Objective, objective_of
from posecal_models.schedule import Schedule
from posecal_models.training_folder import CHECKPOINT, WEIGHTS, check_same, write_losses

__all__ = ["Progress", "Training"]

_ORDER, _BATCH, _VALIDATION = 1, 2, 3


@dataclass(frozen=True)
class Progress:
    """Where a training stands, for whoever shows it.

    Attributes
    ----------
    epoch, step, steps : int
        Epochs and steps done, and the steps of the whole training.
    learning_rate : float
        Of the last step.
    losses : dict of str to float
        Of the last step.
    validation : float or None
        Loss of the validation poses after the last epoch; none before, and where there are no such poses.
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
        What is trained; on the device where it shall be.
    config : Config
        How.
    data : TrainingSet
        On the same device.
    validation : TrainingSet, optional
        Poses that steer the learning rate and choose the weights that are kept.
    folder : Path
        Where ``checkpoint.safetensors``, ``weights.safetensors`` and ``losses.csv`` go.
    crew : Crew
        The processes that train together.
    digests : dict of str to str
        What tells the data from others, see :func:`posecal_models.training_folder.digests`; kept in the checkpoint.

    Attributes
    ----------
    step, epoch : int
        Done so far.
    """

    def __init__(
        self,
        estimator: ReferenceEstimator,
        config: Config,
        data: TrainingSet,
        *,
        folder: Path,
        validation: TrainingSet | None = None,
        crew: Crew | None = None,
        digests: dict[str, str] | None = None,
    ) -> None:
        self.estimator = estimator
        self.config = config
        self.data = data
        self.validation = validation
        self.folder = folder
        self.crew = crew or Crew()
        self.digests = digests or {}
        self.parameters = {name: p for name, p in estimator.named_parameters() if self._learns(name)}
        self.objective: Objective = objective_of(estimator, config.train)
        if config.train.cuda_graph:
            self.objective = Recorded(self.objective, list(self.parameters.values()), data.device)
        self.optimizer = torch.optim.Adam(self.parameters.values(), lr=config.train.learning_rate, fused=True)
        self.steps_per_epoch = config.train.steps_per_epoch or math.ceil(len(data) / config.train.batch)
        self.schedule = Schedule(config.train, self.steps_per_epoch * config.train.epochs)
        self.step = self.epoch = 0
        self._together = False
        self.best: dict[str, Tensor] = {}
        self._step_losses: list[float] = []
        self._epochs: list[tuple[float, ...]] = []
        self._order: tuple[int, Tensor] | None = None

    def run(self, *, on_step: Callable[[Progress], None] | None = None, most_steps: int | None = None) -> None:
        """Train until the end.

        Parameters
        ----------
        on_step : callable, optional
            Is told the progress after each step.
        most_steps : int, optional
            Stop, with a checkpoint, when so many steps are done.

        Raises
        ------
        PoseDataError
            Where a loss, of training or validation, or a gradient is no longer finite.
        PoseFileError
            Where a file can't be written.
        """
        saved = time.monotonic()
        while not self.finished:
            if most_steps is not None and self.step >= most_steps:
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
        """Whether there is nothing left to learn."""
        return self.epoch >= self.config.train.epochs or self.schedule.finished

    def _learns(self, name: str) -> bool:
        return self.config.model.kind != "gaussian-noise" or not name.startswith("mean.")

    def _rows(self, step: int) -> Tensor:
        """Give the poses of a step: one random order of all poses after another."""
        batch, many = self.config.train.batch, len(self.data)
        wanted = torch.arange(step * batch, (step + 1) * batch)
        rows = torch.empty_like(wanted)
        for turn in torch.unique(wanted // many).tolist():
            if self._order is None or self._order[0] != turn:
                order = torch.randperm(many, generator=seeded("cpu", self.config.train.seed, _ORDER, turn))
                self._order = (turn, order)
            here = wanted // many == turn
            rows[here] = self._order[1][wanted[here] % many]
        return rows.to(self.data.device)

    def _one_step(self) -> dict[str, float]:
        config = self.config.train
        generator = seeded(self.data.device, config.seed, _BATCH, self.step)
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
        if not self._together:
            self.crew.follow(self.estimator.state_dict().values())
            self._together = True

        self.estimator.train()
        learning_rate = self.schedule.learning_rate(self.step)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate
        self.optimizer.zero_grad(set_to_none=False)
        device = self.data.device
        on_gpu = [device] if device.type == "cuda" else []
        with torch.random.fork_rng(devices=on_gpu), self.crew.sharing(len(truth) // graphs) as poses:
            torch.manual_seed(generator.initial_seed())
            mine = slice(poses.start * graphs, poses.stop * graphs)
            losses = self.objective.backward(context[mine], truth[mine], generator=generator, graphs_per_pose=graphs)
        gradients = [p.grad for p in self.parameters.values() if p.grad is not None]
        self.crew.accumulate([*gradients, *losses.values()], (mine.stop - mine.start) / len(truth))
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
            + f". {self._advice(self.step)} or look at the poses of this batch."
        )

    def _advice(self, step: int) -> str:
        kept = f"The checkpoint in {self.folder} is from before. " if (self.folder / CHECKPOINT).exists() else ""
        return f"{kept}Lower train.learning_rate ({self.schedule.learning_rate(step):.3g})"

    def _end_epoch(self) -> None:
        self.epoch += 1
        recent = self._step_losses[-self.steps_per_epoch :]
        train = sum(recent) / len(recent)
        validation = self._validate()
        told = math.nan if validation is None else validation
        rate = self.schedule.learning_rate(self.step - 1)
        self._epochs.append((float(self.epoch), float(self.step), rate, train, told))
        judged = _judged(self._epochs[-1])
        if judged < self.schedule.best:
            self.best = {name: t.detach().clone() for name, t in self.estimator.state_dict().items()}
        self.schedule.after_epoch(judged)

    def _validate(self) -> float | None:
        if self.validation is None:
            return None
        self.estimator.eval()
        generator = seeded(self.validation.device, self.config.train.seed, _VALIDATION)
        rows = torch.arange(len(self.validation), device=self.validation.device)
        context, truth = self.validation.batch(rows, generator)
        found = self.objective.evaluate(context, truth, generator=generator)
        losses = {name: self.crew.agree(float(loss)) for name, loss in found.items()}
        if not all(map(math.isfinite, losses.values())):
            raise PoseDataError(
                f"validation: after step {self.step:,} (epoch {self.epoch}) "
                + ", ".join(f"{name} is {value:.6g}" for name, value in losses.items())
                + f". {self._advice(self.step - 1)} or look at the poses of data.validation_subjects."
            )
        return losses["loss"]

    def _progress(self, losses: dict[str, float]) -> Progress:
        return Progress(
            self.epoch,
            self.step,
            self.schedule.total_steps,
            self.schedule.learning_rate(self.step - 1),
            losses,
            self._epochs[-1][-1] if self._epochs and self.validation is not None else None,
        )

    def save(self) -> None:
        """Write checkpoint, weights and loss curve, each whole or not at all.

        Raises
        ------
        PoseFileError
            Where one can't be written.
        """
        if not self.crew.leads:
            return
        tensors = {f"weights.{name}": tensor for name, tensor in self.estimator.state_dict().items()}
        tensors |= {f"best.{name}": tensor for name, tensor in self.best.items()}
        for name, parameter in self.parameters.items():
            for moment, tensor in self.optimizer.state.get(parameter, {}).items():
                tensors[f"adam.{moment}.{name}"] = tensor
        tensors["losses.steps"] = torch.tensor(self._step_losses, dtype=torch.float64)
        tensors["losses.epochs"] = torch.tensor(self._epochs, dtype=torch.float64).view(-1, 5)
        write_tensors(self.folder / CHECKPOINT, tensors, self._state())
        write_losses(self.folder, self._epochs)
        notes = {"config": self.config.table(), "epochs": self.epoch, "steps": self.step, "poses": len(self.data)}
        if self._epochs:
            notes["weights_of_step"] = int(min(self._epochs, key=_judged)[1])
        save_estimator(self.folder / WEIGHTS, self.estimator, tensors=self.best or None, notes=notes)

    def _state(self) -> dict[str, Any]:
        schedule = self.schedule
        return {
            "training": {"config": self.config.table(), "step": self.step, "epoch": self.epoch, "data": self.digests},
            "schedule": {"best": schedule.best, "waited": schedule.waited, "drops": schedule.drops},
        }

    def resume(self) -> None:
        """Go back to the last checkpoint in the folder.

        The number of epochs may differ from that of the start; a cosine then changes its slope.

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
            raise PoseFileError(f"{path}: holds no training; expected the checkpoint of one.")
        check_same(path, about["training"], self.config, self.digests)
        self.step, self.epoch = about["training"]["step"], about["training"]["epoch"]
        for name in ("best", "waited", "drops"):
            setattr(self.schedule, name, about["schedule"][name])
        self.estimator.load_state_dict(_under("weights.", tensors))
        self.best = _under("best.", tensors)
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


def _under(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _judged(epoch: tuple[float, ...]) -> float:
    """Give what an epoch is judged by: its validation loss, or its training loss where there is none."""
    *_, train, validation = epoch
    return train if math.isnan(validation) else validation
