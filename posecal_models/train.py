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
from posecal.io import written_whole
from posecal_models.checkpoint import read_tensors, save_estimator, write_tensors
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.cuda_graph import Recorded
from posecal_models.data.masks import SHARES, hide
from posecal_models.data.training_set import TrainingSet, seeded
from posecal_models.distributed import Crew
from posecal_models.estimators import ReferenceEstimator
from posecal_models.objectives import Objective, objective_of
from posecal_models.schedule import Schedule

__all__ = ["Progress", "Training", "draw_graphs"]

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
    validation : float
        Loss of the validation poses after the last epoch; NaN before.
    """

    epoch: int
    step: int
    steps: int
    learning_rate: float
    losses: dict[str, float]
    validation: float


def draw_graphs(
    context: Context,
    truth: Tensor,
    *,
    graphs_per_pose: int,
    first: int,
    augmentation: str,
    generator: torch.Generator,
) -> tuple[Context, Tensor]:
    """Give every pose several sets of observed keypoints, the paper's five in turn.

    Parameters
    ----------
    context : Context
        Keypoints of B poses.
    truth : Tensor
        (B, K, 3), mm.
    graphs_per_pose : int
        Sets of each pose.
    first : int
        Which of the five comes first; pose i starts i further.
    augmentation : str
        See :func:`posecal_models.data.masks.hide`.
    generator : torch.Generator
        The source of randomness.

    Returns
    -------
    context, truth
        Of B * graphs_per_pose graphs, those of one pose together.
    """
    poses = len(truth)
    rows = torch.arange(poses, device=truth.device).repeat_interleave(graphs_per_pose)
    turn = torch.arange(graphs_per_pose, device=truth.device).repeat(poses)
    start = rows * (graphs_per_pose % len(SHARES) != 0)
    share = torch.tensor(SHARES, device=truth.device)[(turn + start + first) % len(SHARES)]
    graphs = context[rows]
    observed = hide(graphs.observed, share, generator, kind="released" if augmentation == "released" else "paper")
    return Context(graphs.keypoints, observed, graphs.sigma), truth[rows]


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
    ) -> None:
        self.estimator = estimator
        self.config = config
        self.data = data
        self.validation = validation
        self.folder = folder
        self.crew = crew or Crew()
        self.parameters = {name: p for name, p in estimator.named_parameters() if self._learns(name)}
        self.objective: Objective = objective_of(estimator, config.train)
        if config.train.cuda_graph:
            self.objective = Recorded(self.objective, list(self.parameters.values()), data.device)
        self.optimizer = torch.optim.Adam(self.parameters.values(), lr=config.train.learning_rate, fused=True)
        self.steps_per_epoch = config.train.steps_per_epoch or math.ceil(len(data) / config.train.batch)
        self.schedule = Schedule(config.train, self.steps_per_epoch * config.train.epochs)
        self.step = self.epoch = 0
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
            Where a loss or gradient is no longer finite.
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
            )
        if self.step == 0 and not self.config.model.start:
            self.objective.initialise(context, truth)
        poses = self.crew.share(len(truth) // graphs)
        mine = slice(poses.start * graphs, poses.stop * graphs)
        share = (mine.stop - mine.start) / len(truth)

        self.estimator.train()
        learning_rate = self.schedule.learning_rate(self.step)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate
        self.optimizer.zero_grad(set_to_none=False)
        device = self.data.device
        with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
            torch.manual_seed(generator.initial_seed())
            losses = self.objective.backward(context[mine], truth[mine], generator=generator, graphs_per_pose=graphs)
        gradients = [p.grad for p in self.parameters.values() if p.grad is not None]
        self.crew.add_up([*gradients, *losses.values()], share)
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
            + f". The checkpoint in {self.folder} is from before; lower train.learning_rate "
            f"({self.schedule.learning_rate(self.step):.3g}) or look at the poses of this batch."
        )

    def _end_epoch(self) -> None:
        self.epoch += 1
        recent = self._step_losses[-self.steps_per_epoch :]
        train = sum(recent) / len(recent)
        validation = self._validate()
        judged = train if math.isnan(validation) else validation
        if judged < self.schedule.best:
            self.best = {name: t.detach().clone() for name, t in self.estimator.state_dict().items()}
        rate = self.schedule.learning_rate(self.step - 1)
        self._epochs.append((float(self.epoch), float(self.step), rate, train, validation))
        self.schedule.after_epoch(judged)

    def _validate(self) -> float:
        if self.validation is None:
            return math.nan
        self.estimator.eval()
        generator = seeded(self.validation.device, self.config.train.seed, _VALIDATION)
        rows = torch.arange(len(self.validation), device=self.validation.device)
        context, truth = self.validation.batch(rows, generator)
        return float(self.objective.evaluate(context, truth, generator=generator)["loss"])

    def _progress(self, losses: dict[str, float]) -> Progress:
        return Progress(
            self.epoch,
            self.step,
            self.schedule.total_steps,
            self.schedule.learning_rate(self.step - 1),
            losses,
            self._epochs[-1][-1] if self._epochs else math.nan,
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
        write_tensors(self.folder / "checkpoint.safetensors", tensors, self._state())
        self._write_losses()
        notes = {"config": self.config.table(), "epochs": self.epoch, "steps": self.step, "poses": len(self.data)}
        save_estimator(self.folder / "weights.safetensors", self.estimator, tensors=self.best or None, notes=notes)

    def _state(self) -> dict[str, Any]:
        schedule = self.schedule
        return {
            "training": {"config": self.config.table(), "step": self.step, "epoch": self.epoch},
            "schedule": {"best": schedule.best, "waited": schedule.waited, "drops": schedule.drops},
        }

    def _write_losses(self) -> None:
        lines = ["epoch,step,learning_rate,training_loss,validation_loss"]
        lines += [f"{e:.0f},{s:.0f},{rate:.6g},{train:.8g},{val:.8g}" for e, s, rate, train, val in self._epochs]
        text = "\n".join(lines) + "\n"
        written_whole(self.folder / "losses.csv", lambda file: file.write(text.encode()))

    def resume(self) -> None:
        """Go back to the last checkpoint in the folder.

        The number of epochs may differ from that of the start; a cosine then changes its slope.

        Raises
        ------
        PoseFileError
            Where there is none, or it is damaged.
        PoseDataError
            Where it is of another configuration.
        """
        path = self.folder / "checkpoint.safetensors"
        tensors, about = read_tensors(path, device=self.data.device)
        if "training" not in about:
            raise PoseFileError(f"{path}: holds no training; expected the checkpoint of one.")
        before = about["training"]["config"]
        now, default = self.config.table(), Config().table()
        names = [(table, name) for table in ("model", "data", "train") for name in now[table]]
        names.remove(("train", "epochs"))
        changed = [f"{t}.{n}" for t, n in names if _plain(before[t].get(n, default[t][n])) != _plain(now[t][n])]
        if changed:
            raise PoseDataError(
                f"{path}: of another configuration ({', '.join(changed)} differ). "
                "Give the configuration it was started with, or another folder."
            )
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


def _plain(value: Any) -> Any:
    """Turn tuples into lists, as JSON does."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value
