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
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from posecal.errors import PoseDataError
from posecal_models import training_state
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.cuda_graph import RecordedStep
from posecal_models.data.fresh_views import FreshViews
from posecal_models.data.masks import remove_keypoints
from posecal_models.data.training_set import TrainingSet, draw_graphs, seeded_generator
from posecal_models.distributed import ProcessGroup
from posecal_models.estimators.registry import ReferenceEstimator
from posecal_models.objectives import build_objective
from posecal_models.schedule import Schedule
from posecal_models.training_folder import CHECKPOINT
from posecal_models.training_state import selection_loss
from posecal_models.validation import validation_losses

__all__ = ["Training", "TrainingProgress"]

_ORDER, _BATCH = 1, 2

_STEPS_BETWEEN_READS = 50
"""Steps of a GPU after which the losses are read, which needs a synchronisation."""


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
        Losses of the last step; of a GPU, of the last step whose losses were read.
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
    estimator : ReferenceEstimator
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
    best : dict of str to Tensor
        The weights with the lowest validation loss.
    step_losses : list of float
        The loss of every step so far.
    epoch_losses : list of tuple of float
        Epoch, step, learning rate, training and validation loss, of every epoch so far.
    """

    def __init__(
        self,
        estimator: ReferenceEstimator,
        config: Config,
        data: TrainingSet | FreshViews,
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
        self.parameters = {name: p for name, p in estimator.named_parameters() if p.requires_grad}
        if self.processes.size > 1 and data.device.type == "cuda":
            nn.SyncBatchNorm.convert_sync_batchnorm(estimator)  # type: ignore[no-untyped-call]
        self.average: AveragedModel | None = None
        if config.train.average:
            self.average = AveragedModel(estimator, multi_avg_fn=get_ema_multi_avg_fn(config.train.average))  # type: ignore[no-untyped-call]
        self.objective = build_objective(estimator, config.train)
        if self.objective.one_process and self.processes.size > 1:
            raise PoseDataError(f"processes: {self.processes.size} of a training with a critic; expected one.")
        self._losses: nn.Module = self.objective
        if self.processes.size > 1:
            self._losses = DistributedDataParallel(self.objective)
        self._learning_rate = torch.tensor(config.train.learning_rate, device=data.device)
        self.optimizer = torch.optim.AdamW(
            self.parameters.values(),
            self._learning_rate,
            betas=(config.train.beta1, config.train.beta2),
            weight_decay=config.train.weight_decay,
            fused=True,
            capturable=True,
        )
        self._loss_names: list[str] = []
        self._update: Callable[..., Tensor] = self.update
        if config.train.cuda_graph:
            self._update = RecordedStep(self.update, data.device)
        self.steps_per_epoch = config.train.steps_per_epoch or math.ceil(len(data) / config.train.batch)
        self.schedule = Schedule(config.train, self.steps_per_epoch * config.train.epochs)
        self.step = self.epoch = 0
        self.best: dict[str, Tensor] = {}
        self.step_losses: list[float] = []
        self._unread: list[Tensor] = []
        self._last_losses: dict[str, float] = {}
        self._last_rate = config.train.learning_rate
        self.epoch_losses: list[tuple[float, ...]] = []
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
            self.one_step()
            if self.step % self.steps_per_epoch == 0:
                self._end_epoch()
                self.save()
                saved = time.monotonic()
            elif time.monotonic() - saved > self.config.train.checkpoint_seconds:
                self.save()
                saved = time.monotonic()
            if on_step is not None:
                on_step(self._progress())
        self.save()

    @property
    def estimate(self) -> ReferenceEstimator:
        """The estimator that is validated and saved: with the moving average of the weights, where there is one."""
        return self.estimator if self.average is None else cast(ReferenceEstimator, self.average.module)

    @property
    def finished(self) -> bool:
        """Whether all epochs are done or the schedule stops."""
        return self.epoch >= self.config.train.epochs or self.schedule.finished

    def _rows(self, step: int) -> Tensor:
        """Return the poses of a step, from consecutive random permutations of the training set."""
        batch, poses = self.config.train.batch, len(self.data)
        positions = torch.arange(step * batch, (step + 1) * batch)
        rows = torch.empty_like(positions)
        for index in torch.unique(positions // poses).tolist():
            if self._order is None or self._order[0] != index:
                generator = seeded_generator(self.config.train.seed, _ORDER, index)
                self._order = (index, torch.randperm(poses, generator=generator))
            selected = positions // poses == index
            rows[selected] = self._order[1][positions[selected] % poses]
        return rows.to(self.data.device)

    def one_step(self) -> None:
        """Run the next step.

        Raises
        ------
        PoseDataError
            Where a loss or a gradient is no longer finite; on a GPU, of any step since the losses were last read.
        """
        config, cgnf = self.config.train, self.config.model.kind == "cgnf"
        generator = seeded_generator(config.seed, _BATCH, self.step)
        context, truth = self.data.batch(self._rows(self.step), generator)
        graphs = config.graphs_per_pose if cgnf else 1
        if cgnf:
            context, truth = draw_graphs(
                context,
                truth,
                graphs_per_pose=graphs,
                first=self.step,
                augmentation=config.augmentation,
                generator=generator,
                root=self.config.model.origin == "root",
            )
        elif self.config.data.missing_share:
            context = remove_keypoints(context, self.config.data.missing_share, generator)
        if self.step == 0 and not self.config.model.start:
            self.objective.initialise(context, truth)
        poses = self.processes.rows(len(truth) // graphs)
        rows = slice(poses.start * graphs, poses.stop * graphs)
        context, truth = context[rows], truth[rows]
        noise = self.objective.noise(truth, generator)
        self.estimator.train()
        self._last_rate = self.schedule.learning_rate
        self._learning_rate.fill_(self._last_rate)
        self.objective.before_step(context, truth, noise, self._last_rate)
        device = self.data.device
        with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
            torch.manual_seed(generator.initial_seed() ^ self.processes.rank)  # of dropout
            inputs = [context.keypoints, context.observed, context.sigma, truth, *([] if noise is None else [noise])]
            self._unread.append(self._update(*inputs))
        if self.average is not None:
            self.average.update_parameters(self.estimator)
        self.step += 1
        self.schedule.after_step()
        if device.type == "cpu" or len(self._unread) >= _STEPS_BETWEEN_READS:
            self.read_losses()

    def update(
        self, keypoints: Tensor, observed: Tensor, sigma: Tensor, truth: Tensor, noise: Tensor | None = None
    ) -> Tensor:
        """Update the weights: forward and backward pass, clipping and Adam, without a synchronisation.

        Parameters
        ----------
        keypoints, observed, sigma : Tensor
            The context of this process's graphs.
        truth : Tensor
            Their poses, mm.
        noise : Tensor, optional
            The random numbers of the loss.

        Returns
        -------
        Tensor
            The losses, and the gradient's norm.
        """
        options = {"graphs_per_pose": self.config.train.graphs_per_pose} if self.config.model.kind == "cgnf" else {}
        self.optimizer.zero_grad()
        losses = self._losses(Context(keypoints, observed, sigma), truth, noise, **options)
        losses["loss"].backward()
        parameters, clip = self.parameters.values(), self.config.train.clip
        norm = nn.utils.clip_grad_norm_(parameters, clip if self.config.train.clip_by == "norm" else math.inf)
        if self.config.train.clip_by == "value":
            nn.utils.clip_grad_value_(parameters, clip)
        self.optimizer.step()
        self._loss_names = list(losses)
        return torch.stack([*(loss.detach() for loss in losses.values()), norm])

    def read_losses(self) -> None:
        """Read the losses of the last steps, and check that all are finite.

        Raises
        ------
        PoseDataError
            Where one is not.
        """
        if not self._unread:
            return
        first = self.step - len(self._unread)
        losses = []
        for step, (*numbers, norm) in enumerate(self.processes.mean(torch.stack(self._unread)).tolist(), first):
            self._last_losses = dict(zip(self._loss_names, numbers, strict=True))
            self._check_finite(step, self._last_losses, norm)
            losses.append(self._last_losses["loss"])
        self.step_losses += losses
        self._unread = []  # not before: weights that a loss made useless are never saved

    def _check_finite(self, step: int, losses: dict[str, float], norm: float) -> None:
        if all(map(math.isfinite, losses.values())) and math.isfinite(norm):
            return
        broken = [name for name, p in self.parameters.items() if p.grad is not None and not p.grad.isfinite().all()]
        raise PoseDataError(
            f"training: at step {step:,} (epoch {self.epoch + 1}) "
            + ", ".join(f"{name} is {value:.6g}" for name, value in losses.items())
            + f", the gradient's norm {norm:.6g}, not finite in {len(broken)} of {len(self.parameters)} tensors"
            + (f" (first: {broken[0]})" if broken else "")
            + f". {self._advice()} or check the poses of this batch."
        )

    def _advice(self) -> str:
        checkpoint = f"The checkpoint in {self.folder} is from before. " if (self.folder / CHECKPOINT).exists() else ""
        return f"{checkpoint}Lower train.learning_rate ({self._last_rate:.3g})"

    def _end_epoch(self) -> None:
        self.read_losses()
        self.epoch += 1
        recent = self.step_losses[-self.steps_per_epoch :]
        train = sum(recent) / len(recent)
        validation = self._validate()
        last = (
            float(self.epoch),
            float(self.step),
            self._last_rate,
            train,
            math.nan if validation is None else validation,
        )
        self.epoch_losses.append(last)
        if min(self.epoch_losses, key=selection_loss) is last:
            self.best = {name: t.detach().clone() for name, t in self.estimate.state_dict().items()}
        self.schedule.after_epoch(selection_loss(last))

    def _validate(self) -> float | None:
        if self.validation is None:
            return None
        local_losses = validation_losses(self.estimate, self.validation, self.config.train)
        losses = {name: self.processes.broadcast(float(loss)) for name, loss in local_losses.items()}
        if not all(map(math.isfinite, losses.values())):
            raise PoseDataError(
                f"validation: after step {self.step:,} (epoch {self.epoch}) "
                + ", ".join(f"{name} is {value:.6g}" for name, value in losses.items())
                + f". {self._advice()} or check the poses of data.validation_subjects."
            )
        return losses.get("selection", losses["loss"])

    def _progress(self) -> TrainingProgress:
        return TrainingProgress(
            self.epoch,
            self.step,
            self.schedule.total_steps,
            self._last_rate,
            self._last_losses,
            self.epoch_losses[-1][-1] if self.epoch_losses and self.validation is not None else None,
        )

    def save(self) -> None:
        """Write checkpoint, weights and loss curve, all or none; see :func:`posecal_models.training_state.save`."""
        self.read_losses()
        if self.processes.is_main:
            training_state.save(self)

    def resume(self) -> None:
        """Load the checkpoint in the folder; see :func:`posecal_models.training_state.resume`."""
        training_state.resume(self)
