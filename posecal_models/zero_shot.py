"""Zero-shot experiments: densities given sets of observed nodes that are not in the training set.

Here in the toy world of jointly Gaussian poses, where the true posterior is known: by how many nats an estimator's
negative log density exceeds that of the true posterior. The paper's own experiment is :mod:`posecal_models.pendulum`.

The data come from the folder ``toy`` of a checkout, which is not installed with the package.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.optim.lr_scheduler import LambdaLR

from posecal.errors import PoseDataError
from posecal_models.adversarial import energy_score
from posecal_models.contract import Context
from posecal_models.data.training_set import seeded_generator
from posecal_models.estimators.amortized_posterior import AmortizedPosterior
from posecal_models.estimators.cgnf.flow import FlowSize
from posecal_models.estimators.cgnf.graph import PoseGraph
from posecal_models.estimators.cgnf.model import CGNF

__all__ = ["PoseWorldRow", "fit", "import_toy", "mean_energy_score", "pose_world", "with_offset"]

Batch = tuple[Tensor, Context]
"""Poses (M, K, D) and their keypoints."""

_SELECTIONS = 10
"""How often weights are selected, where they are."""

_SIZE = FlowSize(blocks=8, hidden=48, context=10, embedding=32)


def fit(
    estimator: CGNF | AmortizedPosterior,
    draw: Callable[[torch.Generator], Batch],
    *,
    steps: int,
    seed: int = 0,
    learning_rate: float = 2e-3,
    validation: Batch | None = None,
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
    validation : tuple of Tensor and Context, optional
        The weights are those of the lowest energy score on these poses, before training and after each tenth of the
        steps; those after the last step where not given.
    progress : callable, optional
        Called with the number of steps done.

    Raises
    ------
    PoseDataError
        Where the loss is no longer finite.
    """
    if isinstance(estimator, AmortizedPosterior):
        parts = [draw(seeded_generator(seed, steps, part)) for part in range(100)]
        estimator.fit(torch.cat([poses for poses, _ in parts]), _joined([context for _, context in parts]))
    else:
        poses, context = draw(seeded_generator(seed, steps))
        estimator.standardizer.fit(poses, context.keypoints, context.observed)
        flow, standardizer = estimator.flow, estimator.standardizer
        flow.initialise_actnorm(standardizer.poses(poses)[:, None], estimator.embed(context))
    best, weights = math.inf, estimator.state_dict()
    optimizer = torch.optim.Adam(estimator.parameters(), learning_rate, fused=True)
    scheduler = LambdaLR(optimizer, lambda step: 0.5 * (1 + math.cos(math.pi * step / max(1, steps))))
    for step in range(steps + 1):
        if validation is not None and (step == steps or step % max(1, steps // _SELECTIONS) == 0):
            score = _validation_score(estimator, validation)
            if score < best:
                best, weights = score, {name: tensor.clone() for name, tensor in estimator.state_dict().items()}
        if step == steps:
            break
        poses, context = draw(seeded_generator(seed, step))
        optimizer.zero_grad(set_to_none=False)
        loss = -estimator(context).log_prob(poses).mean()
        if not loss.isfinite():
            raise PoseDataError(
                f"zero-shot: the loss is {float(loss.detach()):.4g} at step {step}. Lower the learning rate."
            )
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(estimator.parameters(), 1.0)
        optimizer.step()
        scheduler.step()
        if progress is not None:
            progress(step + 1)
    estimator.load_state_dict(weights)
    estimator.eval()


@torch.no_grad()
def _validation_score(estimator: CGNF | AmortizedPosterior, validation: Batch) -> float:
    poses, context = validation
    return mean_energy_score(estimator(context).sample(50, generator=seeded_generator(0)), poses)


def _joined(contexts: Sequence[Context]) -> Context:
    sigma = [context.sigma for context in contexts if context.sigma is not None]
    return Context(
        torch.cat([context.keypoints for context in contexts]),
        torch.cat([context.observed for context in contexts]),
        torch.cat(sigma) if sigma else None,
    )


def mean_energy_score(samples: Tensor, truth: Tensor) -> float:
    """Compute the mean energy score of samples (n, M, K, D) for poses (M, K, D), some poses at a time."""
    parts = zip(torch.split(samples.flatten(2), 100, dim=1), torch.split(truth.flatten(1), 100), strict=True)
    return float(torch.cat([energy_score(drawn, poses) for drawn, poses in parts]).mean())


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

    def __str__(self) -> str:
        gaps = (f"{gap:.2f} ± {error:.2f}" for gap, error in self.gaps.values())
        numbers = [f"{self.observed:8d}", f"{'yes' if self.trained else 'no':>11}", f"{self.true_log_density:10.2f}"]
        return "  ".join([*numbers, *(f"{gap:>19}" for gap in gaps)])


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
    world = import_toy("toy.pose_world", "PoseWorld").person("h36m-16")
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
        return x.float(), Context(c.float(), draw_observed(counts, generator))

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        estimators: dict[str, CGNF | AmortizedPosterior] = {
            "cGNF": CGNF(_SIZE, PoseGraph.from_joints(world.joints), origin="none"),
            "amortised posterior": AmortizedPosterior(
                world.joints, world.joints, origin="none", position=False, components=1, width=64, residuals=1
            ),
        }
    for index, estimator in enumerate(estimators.values()):
        model_progress = None if progress is None else with_offset(progress, index * steps)
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


def with_offset(progress: Callable[[int], None], offset: int) -> Callable[[int], None]:
    """Add the steps of earlier models to those of this one."""
    return lambda steps: progress(offset + steps)


def import_toy(module: str, name: str):  # type: ignore[no-untyped-def]
    """Import a function or class of the folder ``toy``, or raise a PoseDataError that names it."""
    from importlib import import_module

    try:
        return getattr(import_module(module), name)
    except ImportError as problem:
        raise PoseDataError(
            f"zero-shot: {module} can't be imported; expected the folder toy of posecal's repository. "
            "Run the command in a checkout."
        ) from problem
