"""Does a cGNF know what it was never shown? Densities given sets of observed nodes that training left out.

The paper's experiment (supplement B.2): three models of the triple pendulum, judged on p(x | c1, c2, c3), of which the
cGNF has seen at most two nodes observed. And the same question where the answer is known: in the toy world of jointly
Gaussian poses, how many nats is the cGNF above the true posterior?

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
from posecal_models.cgnf.flow import FlowSize
from posecal_models.cgnf.model import CGNF
from posecal_models.contract import Context
from posecal_models.data.training_set import seeded
from posecal_models.graph import PoseGraph

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
"""The three models by the sets of nodes that they see observed in training."""


def fit(
    estimator: CGNF,
    draw: Callable[[torch.Generator], Batch],
    *,
    steps: int,
    seed: int = 0,
    learning_rate: float = 2e-3,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Train a cGNF on batches that are drawn as it goes.

    Parameters
    ----------
    estimator : CGNF
        What is trained. Its standardizer and ActNorms are set from a first batch.
    draw : callable
        Gives a batch, drawn with a generator.
    steps : int
        Steps of Adam, with a learning rate that falls to 0 along a cosine.
    seed : int
        Of the batches.
    learning_rate : float
        At the start.
    progress : callable, optional
        Is told how many steps are done.

    Raises
    ------
    PoseDataError
        Where the loss is no longer finite.
    """
    poses, keypoints, observed = draw(seeded("cpu", seed, steps))
    estimator.standardizer.fit(poses, keypoints, observed)
    flow, standardizer = estimator.flow, estimator.standardizer
    evidence = estimator.evidence(Context(keypoints, observed))
    flow.initialise_actnorm(standardizer.poses(poses)[:, None], evidence)
    optimizer = torch.optim.Adam(estimator.parameters(), learning_rate, fused=True)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = learning_rate * 0.5 * (1 + math.cos(math.pi * step / steps))
        poses, keypoints, observed = draw(seeded("cpu", seed, step))
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
    """Draw which nodes are observed: one of the sets for each row."""
    table = torch.zeros(len(sets), nodes, dtype=torch.bool)
    for index, members in enumerate(sets):
        table[index, list(members)] = True
    return table[torch.randint(len(sets), (rows,), generator=generator)]


@dataclass(frozen=True)
class LogDensity:
    """Held-out log densities log p(x | c1, c2, c3), nats, x in m, of M poses.

    Attributes
    ----------
    mean, standard_error : float
        Over held-out pendulums; not finite where one pose's is not.
    median : float
        Over poses.
    lost : int
        Poses so improbable that their latents overflow double precision; their log density counts as minus infinity.
    poses : int
        M.
    """

    mean: float
    standard_error: float
    median: float
    lost: int
    poses: int

    @classmethod
    def of(cls, nats: Tensor) -> LogDensity:
        """Sum up the log densities (pendulums, timesteps) of held-out poses, NaN where a latent overflowed."""
        known = torch.where(nats.isfinite(), nats, -math.inf)
        each = known.mean(1)
        return cls(
            mean=float(each.mean()),
            standard_error=float(each.std()) / math.sqrt(len(each)),
            median=float(np.median(known.numpy())),
            lost=int((~nats.isfinite()).sum()),
            poses=nats.numel(),
        )

    def __str__(self) -> str:
        if not self.lost:
            return f"{self.mean:.2f} ± {self.standard_error:.2f} nats"
        median = f"median {self.median:.3g} nats, " if math.isfinite(self.median) else ""
        return f"{median}{self.lost:,} of {self.poses:,} poses below what double precision holds"


@dataclass(frozen=True)
class Pendulum:
    """The zero-shot experiment on the pendulum.

    Attributes
    ----------
    log_density : dict of str to LogDensity
        Of each model.
    truth, keypoints : ndarray
        Held-out poses (M, 3, 2) and what was seen of them, m.
    samples : dict of str to ndarray
        Of each model, (n, M, 3, 2), m, for the first poses.
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
    shown: int = 4,
    samples: int = 200,
    progress: Callable[[int], None] | None = None,
) -> Pendulum:
    """Train the paper's three models of the triple pendulum and judge them on all nodes observed.

    Parameters
    ----------
    steps, batch : int
        Of each model's training on 50 pendulums of 25 timesteps; the noise of what is observed is drawn anew for
        every batch.
    seed : int
        Of everything.
    shown, samples : int
        For how many held-out poses samples are drawn, and how many.
    progress : callable, optional
        Is told how many steps of all models are done.

    Returns
    -------
    Pendulum
        Log densities on 50 other pendulums.

    Raises
    ------
    PoseDataError
        Where the toy world is not at hand.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, supplement B.2.
    """
    simulate = _toy("toy.pendulum", "simulate")
    training, held_out = (simulate(np.random.default_rng([seed, part])) for part in range(2))
    poses = torch.from_numpy(training.positions[:, :, 1:].reshape(-1, 3, 2)).float()
    truth = torch.from_numpy(held_out.positions[:, :, 1:].reshape(-1, 3, 2)).float()
    seen = torch.from_numpy(held_out.observed.reshape(-1, 3, 2)).float()
    everything = torch.ones(len(truth), 3, dtype=torch.bool)
    pendulums, timesteps = held_out.positions.shape[:2]
    few = slice(len(truth) // (2 * shown), len(truth), len(truth) // shown)
    log_density, drawn = {}, {}
    for index, (name, sets) in enumerate(PENDULUM_MODELS.items()):

        def draw(generator: torch.Generator, sets: tuple[tuple[int, ...], ...] = sets) -> Batch:
            rows = torch.randint(len(poses), (batch,), generator=generator)
            noise = 5e-2 * torch.randn((batch, 3, 2), generator=generator)
            return poses[rows], poses[rows] + noise, _observed(sets, batch, 3, generator)

        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            estimator = CGNF(_SIZE, _CHAIN, origin="none", dimensions=2)
        told = None if progress is None else _after(progress, index * steps)
        fit(estimator, draw, steps=steps, seed=seed, progress=told)
        with torch.inference_mode():
            exact = estimator.double()
            nats = exact(Context(seen.double(), everything)).log_prob(truth.double()).view(pendulums, timesteps)
            generator = torch.Generator().manual_seed(seed)
            some = exact(Context(seen[few].double(), everything[few])).sample(samples, generator=generator)
            drawn[name] = some.float().numpy()
        log_density[name] = LogDensity.of(nats)
    return Pendulum(log_density, truth[few].numpy(), seen[few].numpy(), drawn)


@dataclass(frozen=True)
class PoseWorldRow:
    """How a cGNF does with some number of observed keypoints in the world where the posterior is known.

    Attributes
    ----------
    observed : int
        Keypoints that are observed, of 16.
    trained : bool
        Whether training had as many.
    true_log_density, log_density : float
        Mean log p(x | c) of the true posterior and of the cGNF, nats per pose in mm.
    gap, standard_error : float
        Nats by which the cGNF is above the true posterior's negative log density: an estimate of the Kullback-Leibler
        divergence. 0 is perfect.
    """

    observed: int
    trained: bool
    true_log_density: float
    log_density: float
    gap: float
    standard_error: float


def pose_world(
    *,
    steps: int = 4000,
    batch: int = 200,
    most_observed: int = 8,
    poses: int = 2000,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> list[PoseWorldRow]:
    """Train a cGNF in the toy world of Gaussian poses with few observed keypoints, and judge it with any number.

    Parameters
    ----------
    steps, batch : int
        Of the training; every batch has new poses, and each a number of observed keypoints from 0 to
        ``most_observed``, at random.
    most_observed : int
        Of 16 keypoints.
    poses : int
        M, for each row of the result.
    seed : int
        Of everything.
    progress : callable, optional
        Is told how many steps are done.

    Returns
    -------
    list of PoseWorldRow
        For 0, 4, 8, 12 and 16 observed keypoints.

    Raises
    ------
    PoseDataError
        Where the toy world is not at hand.
    """
    world = _toy("toy.pose_world", "PoseWorld").person("h36m-16")
    mean = torch.from_numpy(world.mean)
    factor = torch.from_numpy(np.linalg.cholesky(world.covariance))

    def draw_poses(rows: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        deviation = torch.randn((rows, len(factor)), generator=generator, dtype=torch.float64) @ factor.T
        x = mean + deviation.view(rows, 16, 3)
        noise = world.keypoint_sigma * torch.randn((rows, 16, 2), generator=generator, dtype=torch.float64)
        return x, x[..., :2] + noise

    def draw_observed(counts: Tensor, generator: torch.Generator) -> Tensor:
        turn = torch.rand((len(counts), 16), generator=generator)
        return turn.argsort(1).argsort(1) < counts[:, None]

    def draw(generator: torch.Generator) -> Batch:
        x, c = draw_poses(batch, generator)
        counts = torch.randint(most_observed + 1, (batch,), generator=generator)
        return x.float(), c.float(), draw_observed(counts, generator)

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        estimator = CGNF(_SIZE, PoseGraph.of_joints(world.joints), origin="none")
    fit(estimator, draw, steps=steps, seed=seed, progress=progress)
    rows = []
    for count in (0, 4, 8, 12, 16):
        generator = seeded("cpu", seed, steps + 1, count)
        x, c = draw_poses(poses, generator)
        observed = draw_observed(torch.full((poses,), count), generator)
        true = torch.from_numpy(world.posterior(c.numpy(), observed.numpy()).log_prob(x.numpy()))
        with torch.inference_mode():
            ours = estimator(Context(c.float(), observed)).log_prob(x.float()).double()
        gap = true - ours
        error = float(gap.std()) / math.sqrt(poses)
        rows.append(
            PoseWorldRow(
                count, count <= most_observed, float(true.mean()), float(ours.mean()), float(gap.mean()), error
            )
        )
    return rows


def _after(progress: Callable[[int], None], before: int) -> Callable[[int], None]:
    return lambda steps: progress(before + steps)


def _toy(module: str, name: str):  # type: ignore[no-untyped-def]
    from importlib import import_module

    try:
        return getattr(import_module(module), name)
    except ImportError as problem:
        raise PoseDataError(
            f"zero-shot: {module} is not at hand; expected the folder toy of posecal's repository. "
            "Run the command in a checkout."
        ) from problem
