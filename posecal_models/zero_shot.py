"""Zero-shot experiments: densities given sets of observed nodes that are not in the training set.

The paper's experiment (supplement B.2): three models of the triple pendulum, evaluated on p(x | c1, c2, c3); the cGNF
is trained with at most two observed nodes. And the same in the toy world of jointly Gaussian poses, where the true
posterior is known: by how many nats an estimator's negative log density exceeds that of the true posterior.

The data come from the folder ``toy`` of a checkout, which is not installed with the package.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.data.training_set import seeded_generator
from posecal_models.estimators.amortized_posterior import AmortizedPosterior
from posecal_models.estimators.cgnf.flow import FlowSize
from posecal_models.estimators.cgnf.graph import PoseGraph
from posecal_models.estimators.cgnf.model import CGNF

__all__ = ["PENDULUM_MODELS", "LogDensity", "Pendulum", "PoseWorldRow", "fit", "pendulum", "pose_world"]

Batch = tuple[Tensor, Tensor, Tensor]
"""Poses (M, K, D), keypoints (M, K, 2) and which are observed (M, K)."""

_CHAIN = PoseGraph(("x1", "x2", "x3"), (-1, 0, 1), root="x0")
_SIZE = FlowSize(blocks=8, hidden=48, context=10, embedding=32)

PENDULUM_MODELS: dict[str, tuple[tuple[int, ...], ...]] = {
    "CNF, trained on p(x | c1, c2, c3)": ((0, 1, 2),),
    "CNF, trained on p(x | c1)": ((0,),),
    "cGNF, trained with at most two observed": tuple(
        nodes for count in range(3) for nodes in combinations(range(3), count)
    ),
}
"""The three models, with the sets of nodes that are observed in their training."""


def fit(
    estimator: CGNF | AmortizedPosterior,
    draw: Callable[[torch.Generator], Batch],
    *,
    steps: int,
    seed: int = 0,
    learning_rate: float = 2e-3,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Train an estimator on newly drawn batches.

    Parameters
    ----------
    estimator : CGNF or AmortizedPosterior
        The estimator to train. The standardizer and ActNorms of a cGNF are set from a first batch, the linear part of
        an amortised posterior from a hundred.
    draw : callable
        Draws a batch with a generator.
    steps : int
        Steps of Adam, with a learning rate that falls to 0 along a cosine.
    seed : int
        Seed of the batches.
    learning_rate : float
        Initial learning rate.
    progress : callable, optional
        Called with the number of steps done.

    Raises
    ------
    PoseDataError
        Where the loss is no longer finite.
    """
    if isinstance(estimator, AmortizedPosterior):
        batches = zip(*(draw(seeded_generator(seed, steps, part)) for part in range(100)), strict=True)
        poses, keypoints, observed = map(torch.cat, batches)
        estimator.fit(poses, Context(keypoints, observed))
    else:
        poses, keypoints, observed = draw(seeded_generator(seed, steps))
        estimator.standardizer.fit(poses, keypoints, observed)
        flow, standardizer = estimator.flow, estimator.standardizer
        flow.initialise_actnorm(standardizer.poses(poses)[:, None], estimator.embed(Context(keypoints, observed)))
    optimizer = torch.optim.Adam(estimator.parameters(), learning_rate, fused=True)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = learning_rate * 0.5 * (1 + math.cos(math.pi * step / steps))
        poses, keypoints, observed = draw(seeded_generator(seed, step))
        optimizer.zero_grad(set_to_none=False)
        loss = -estimator(Context(keypoints, observed)).log_prob(poses).mean()
        if not loss.isfinite():
            raise PoseDataError(
                f"zero-shot: the loss is {float(loss.detach()):.4g} at step {step}. Lower the learning rate."
            )
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(estimator.parameters(), 1.0)
        optimizer.step()
        if progress is not None:
            progress(step + 1)
    estimator.eval()


def _observed(sets: Sequence[tuple[int, ...]], rows: int, nodes: int, generator: torch.Generator) -> Tensor:
    """Draw the observed nodes: one of the sets for each row."""
    masks = torch.zeros(len(sets), nodes, dtype=torch.bool)
    for index, members in enumerate(sets):
        masks[index, list(members)] = True
    return masks[torch.randint(len(sets), (rows,), generator=generator)]


@dataclass(frozen=True)
class LogDensity:
    """Held-out log densities log p(x | c1, c2, c3), nats, x in m, of M poses.

    Attributes
    ----------
    mean, standard_error : float
        Over held-out pendulums; not finite where that of a single pose is not.
    median : float
        Over poses.
    overflows : int
        Poses so improbable that their latents overflow double precision; their log density counts as minus infinity.
    poses : int
        M.
    """

    mean: float
    standard_error: float
    median: float
    overflows: int
    poses: int

    @classmethod
    def of(cls, nats: Tensor) -> LogDensity:
        """Summarise the log densities (pendulums, timesteps) of held-out poses, NaN where a latent overflowed."""
        log_density = torch.where(nats.isfinite(), nats, -math.inf)
        pendulum_means = log_density.mean(1)
        return cls(
            mean=float(pendulum_means.mean()),
            standard_error=float(pendulum_means.std()) / math.sqrt(len(pendulum_means)),
            median=float(np.median(log_density.numpy())),
            overflows=int((~nats.isfinite()).sum()),
            poses=nats.numel(),
        )

    def __str__(self) -> str:
        if not self.overflows:
            return f"{self.mean:.2f} ± {self.standard_error:.2f} nats"
        median = f"median {self.median:.3g} nats, " if math.isfinite(self.median) else ""
        return f"{median}{self.overflows:,} of {self.poses:,} poses below the range of double precision"


@dataclass(frozen=True)
class Pendulum:
    """The zero-shot experiment on the pendulum.

    Attributes
    ----------
    log_density : dict of str to LogDensity
        Log densities of each model.
    truth, keypoints : ndarray
        Held-out poses (M, 3, 2) and their observations, m.
    samples : dict of str to ndarray
        Samples of each model for these poses, (n, M, 3, 2), m.
    """

    log_density: dict[str, LogDensity]
    truth: npt.NDArray[np.float32]
    keypoints: npt.NDArray[np.float32]
    samples: dict[str, npt.NDArray[np.float32]]


def pendulum(
    *,
    steps: int = 3000,
    batch: int = 250,
    seed: int = 0,
    examples: int = 4,
    samples: int = 200,
    progress: Callable[[int], None] | None = None,
) -> Pendulum:
    """Train the paper's three models of the triple pendulum and evaluate them with all nodes observed.

    Parameters
    ----------
    steps, batch : int
        Training steps and batch size of each model, on 50 pendulums of 25 timesteps; the observation noise is drawn
        anew for every batch.
    seed : int
        Random seed.
    examples, samples : int
        Number of held-out poses that are sampled, and of samples of each.
    progress : callable, optional
        Called with the number of steps done, over all models.

    Returns
    -------
    Pendulum
        Log densities on 50 other pendulums.

    Raises
    ------
    PoseDataError
        Where the package ``toy`` can't be imported.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, supplement B.2.
    """
    simulate = _import_toy("toy.pendulum", "simulate")
    training, held_out = (simulate(np.random.default_rng([seed, part])) for part in range(2))
    poses = torch.from_numpy(training.positions[:, :, 1:].reshape(-1, 3, 2)).float()
    truth = torch.from_numpy(held_out.positions[:, :, 1:].reshape(-1, 3, 2)).float()
    keypoints = torch.from_numpy(held_out.observed.reshape(-1, 3, 2)).float()
    all_observed = torch.ones(len(truth), 3, dtype=torch.bool)
    pendulums, timesteps = held_out.positions.shape[:2]
    rows = slice(len(truth) // (2 * examples), len(truth), len(truth) // examples)
    log_density, drawn = {}, {}
    for index, (name, sets) in enumerate(PENDULUM_MODELS.items()):

        def draw(generator: torch.Generator, sets: tuple[tuple[int, ...], ...] = sets) -> Batch:
            rows = torch.randint(len(poses), (batch,), generator=generator)
            noise = 5e-2 * torch.randn((batch, 3, 2), generator=generator)
            return poses[rows], poses[rows] + noise, _observed(sets, batch, 3, generator)

        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            estimator = CGNF(_SIZE, _CHAIN, origin="none", dimensions=2)
        model_progress = None if progress is None else _with_offset(progress, index * steps)
        fit(estimator, draw, steps=steps, seed=seed, progress=model_progress)
        with torch.inference_mode():
            double = estimator.double()
            context = Context(keypoints.double(), all_observed)
            nats = double(context).log_prob(truth.double()).view(pendulums, timesteps)
            generator = torch.Generator().manual_seed(seed)
            drawn[name] = double(context[rows]).sample(samples, generator=generator).float().numpy()
        log_density[name] = LogDensity.of(nats)
    return Pendulum(log_density, truth[rows].numpy(), keypoints[rows].numpy(), drawn)


@dataclass(frozen=True)
class PoseWorldRow:
    """Log densities of two estimators and of the true posterior for one number of observed keypoints.

    Attributes
    ----------
    observed : int
        Number of observed keypoints, of 16.
    trained : bool
        Whether this number is in the training set.
    true_log_density : float
        Mean log p(x | c) of the true posterior, nats per pose in mm.
    gaps : dict of str to tuple of float
        By how much the mean of each estimator is lower, and the standard error, nats: an estimate of the
        Kullback-Leibler divergence of the estimator from the true posterior. 0 is best.
    """

    observed: int
    trained: bool
    true_log_density: float
    gaps: dict[str, tuple[float, float]]


def pose_world(
    *,
    steps: int = 4000,
    batch: int = 200,
    max_observed: int = 8,
    poses: int = 2000,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> list[PoseWorldRow]:
    """Train a cGNF and an amortised posterior in the toy world of Gaussian poses, and compare both with the truth.

    Parameters
    ----------
    steps, batch : int
        Training steps and batch size of each; every batch has new poses, each with a random number of observed
        keypoints from 0 to ``max_observed``. They are evaluated with any number.
    max_observed : int
        Maximum number of observed keypoints in training, of 16.
    poses : int
        M, for each row of the result.
    seed : int
        Random seed.
    progress : callable, optional
        Called with the number of steps done, over both.

    Returns
    -------
    list of PoseWorldRow
        For 0, 4, 8, 12 and 16 observed keypoints.

    Raises
    ------
    PoseDataError
        Where the package ``toy`` can't be imported.
    """
    world = _import_toy("toy.pose_world", "PoseWorld").person("h36m-16")
    mean = torch.from_numpy(world.mean)
    factor = torch.from_numpy(np.linalg.cholesky(world.covariance))

    def draw_poses(rows: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        deviation = torch.randn((rows, len(factor)), generator=generator, dtype=torch.float64) @ factor.T
        x = mean + deviation.view(rows, 16, 3)
        noise = world.keypoint_sigma * torch.randn((rows, 16, 2), generator=generator, dtype=torch.float64)
        return x, x[..., :2] + noise

    def draw_observed(counts: Tensor, generator: torch.Generator) -> Tensor:
        order = torch.rand((len(counts), 16), generator=generator)
        return order.argsort(1).argsort(1) < counts[:, None]

    def draw(generator: torch.Generator) -> Batch:
        x, c = draw_poses(batch, generator)
        counts = torch.randint(max_observed + 1, (batch,), generator=generator)
        return x.float(), c.float(), draw_observed(counts, generator)

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        estimators: dict[str, CGNF | AmortizedPosterior] = {
            "cGNF": CGNF(_SIZE, PoseGraph.from_joints(world.joints), origin="none"),
            "amortised posterior": AmortizedPosterior(
                world.joints, world.joints, origin="none", position=False, components=1, width=64, residuals=1
            ),
        }
    for index, estimator in enumerate(estimators.values()):
        model_progress = None if progress is None else _with_offset(progress, index * steps)
        fit(estimator, draw, steps=steps, seed=seed, progress=model_progress)
    rows = []
    for count in (0, 4, 8, 12, 16):
        generator = seeded_generator(seed, steps + 1, count)
        x, c = draw_poses(poses, generator)
        observed = draw_observed(torch.full((poses,), count), generator)
        true = torch.from_numpy(world.posterior(c.numpy(), observed.numpy()).log_prob(x.numpy()))
        gaps = {}
        for name, estimator in estimators.items():
            with torch.inference_mode():
                gap = true - estimator(Context(c.float(), observed)).log_prob(x.float()).double()
            gaps[name] = (float(gap.mean()), float(gap.std()) / math.sqrt(poses))
        rows.append(
            PoseWorldRow(observed=count, trained=count <= max_observed, true_log_density=float(true.mean()), gaps=gaps)
        )
    return rows


def _with_offset(progress: Callable[[int], None], offset: int) -> Callable[[int], None]:
    return lambda steps: progress(offset + steps)


def _import_toy(module: str, name: str):  # type: ignore[no-untyped-def]
    from importlib import import_module

    try:
        return getattr(import_module(module), name)
    except ImportError as problem:
        raise PoseDataError(
            f"zero-shot: {module} can't be imported; expected the folder toy of posecal's repository. "
            "Run the command in a checkout."
        ) from problem
