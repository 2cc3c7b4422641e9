"""The paper's zero-shot experiment (supplement B.2, Figure 4): triple pendulums, with a set of observed nodes held out.

The paper's three flows and the amortised posterior are evaluated on p(x | c1, c2, c3); all but the first flow are
trained with fewer nodes. The data come from the folder ``toy`` of a checkout, which is not installed with the package.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.distributions import Distribution, Independent, Normal

from posecal_models.contract import Context, PoseDistribution
from posecal_models.data.training_set import seeded_generator
from posecal_models.estimators.amortized_posterior import AmortizedPosterior
from posecal_models.estimators.cgnf.flow import FlowSize
from posecal_models.estimators.cgnf.graph import PoseGraph
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.zero_shot import Batch, fit, import_toy, mean_energy_score, with_offset

__all__ = ["MODELS", "OBSERVATIONS", "LogDensity", "Pendulum", "pendulum"]

_CHAIN = PoseGraph(("x1", "x2", "x3"), (-1, 0, 1), root="x0")
_SIZE = FlowSize(blocks=8, hidden=48, context=10, embedding=32)
_NOISE = 5e-2
"""Standard deviation of the observations, m."""
_TRUTH_NOISE = 2e-2
"""Standard deviation of the noise on the poses that the amortised posterior is trained on, m."""
_VALIDATION = 10
"""Pendulums of the 50 for training whose energy score selects the weights of the amortised posterior."""

_AT_MOST_TWO = tuple(nodes for count in range(3) for nodes in combinations(range(3), count))


class _Model(NamedTuple):
    kind: Literal["flow", "posterior", "linear part"]
    sets: tuple[tuple[int, ...], ...]


MODELS: dict[str, _Model] = {
    "CNF, trained on p(x | c1, c2, c3)": _Model("flow", ((0, 1, 2),)),
    "CNF, trained on p(x | c1)": _Model("flow", ((0,),)),
    "cGNF, trained with at most two observed": _Model("flow", _AT_MOST_TWO),
    "amortised posterior, trained with at most two observed": _Model("posterior", _AT_MOST_TWO),
    "its linear part alone, fitted with at most two observed": _Model("linear part", _AT_MOST_TWO),
}
"""The models, with the sets of nodes that are observed in their training."""

OBSERVATIONS = "the observations and their noise, no model"
"""Name of N(c, 0.05² I), which knows neither pendulums nor training."""


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
        Log densities of each model, and of the observations alone.
    energy_score : dict of str to float
        Mean energy scores of samples of the same poses, mm; not finite where a sample is not.
    truth, keypoints : ndarray
        Held-out poses (M, 3, 2) and their observations, m.
    samples : dict of str to ndarray
        Samples of the trained models for these poses, (n, M, 3, 2), m.
    """

    log_density: dict[str, LogDensity]
    energy_score: dict[str, float]
    truth: npt.NDArray[np.float32]
    keypoints: npt.NDArray[np.float32]
    samples: dict[str, npt.NDArray[np.float32]]

    @property
    def lines(self) -> dict[str, str]:
        """A line of text for each model."""
        return {name: f"{name}: {nats}, {self.energy_score[name]:.4g} mm" for name, nats in self.log_density.items()}


def pendulum(
    *,
    steps: int = 3000,
    batch: int = 250,
    seed: int = 0,
    examples: int = 4,
    samples: int = 200,
    progress: Callable[[int], None] | None = None,
) -> Pendulum:
    """Train the models of the triple pendulum and evaluate them with all nodes observed.

    Parameters
    ----------
    steps, batch : int
        Training steps and batch size of each model, on 50 pendulums of 25 timesteps; the observation noise is drawn
        anew for every batch.
    seed : int
        Random seed.
    examples, samples : int
        Number of held-out poses that are kept for a figure, and of samples of each pose.
    progress : callable, optional
        Called with the number of steps done, over all models.

    Returns
    -------
    Pendulum
        Log densities and energy scores on 50 other pendulums.

    Raises
    ------
    PoseDataError
        Where the package ``toy`` can't be imported.

    Notes
    -----
    The amortised posterior is trained as on poses: with noise on the poses (20 mm), and weights that the energy score
    of 10 of the 50 pendulums selects, with at most two nodes observed. The flows have all 50.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179, supplement B.2.
    """
    simulate = import_toy("toy.pendulum", "simulate")
    training, held_out = (simulate(np.random.default_rng([seed, part])) for part in range(2))
    poses, truth = (torch.from_numpy(some.positions[:, :, 1:]).float() for some in (training, held_out))
    keypoints = torch.from_numpy(held_out.observed).float()
    context = _context(keypoints.flatten(0, 1), torch.ones(len(truth.flatten(0, 1)), 3, dtype=torch.bool))
    rows = slice(len(context) // (2 * examples), len(context), len(context) // examples)
    scores: dict[str, tuple[LogDensity, float]] = {}
    drawn = {}
    for name, distribution in _distributions(poses, context, steps=steps, batch=batch, seed=seed, progress=progress):
        with torch.inference_mode():
            nats = distribution.log_prob(truth.flatten(0, 1).double()).view(truth.shape[:2])
            some = distribution.sample(samples, generator=torch.Generator().manual_seed(seed))
            scores[name] = LogDensity.of(nats), 1000 * mean_energy_score(some, truth.flatten(0, 1).double())
        if MODELS[name].kind != "linear part":
            drawn[name] = some[:, rows].float().numpy()
    alone: Distribution = Independent(Normal(keypoints.double(), _NOISE), 2)
    some = keypoints + _NOISE * torch.randn((samples, *keypoints.shape), generator=seeded_generator(seed))
    energy = 1000 * mean_energy_score(some.flatten(1, 2), truth.flatten(0, 1))
    scores[OBSERVATIONS] = LogDensity.of(alone.log_prob(truth.double())), energy
    return Pendulum(
        {name: log_density for name, (log_density, _) in scores.items()},
        {name: score for name, (_, score) in scores.items()},
        truth.flatten(0, 1)[rows].numpy(),
        keypoints.flatten(0, 1)[rows].numpy(),
        drawn,
    )


def _distributions(
    poses: Tensor, context: Context, *, steps: int, batch: int, seed: int, progress: Callable[[int], None] | None
) -> Iterator[tuple[str, PoseDistribution]]:
    """Train each model on poses (P, T, 3, 2), and give its distributions of a context, in double precision."""
    for index, (name, model) in enumerate(MODELS.items()):
        is_posterior = model.kind == "posterior"
        known = (poses[:-_VALIDATION] if is_posterior else poses).flatten(0, 1)
        others = poses[-_VALIDATION:].flatten(0, 1)

        def draw(
            generator: torch.Generator,
            known: Tensor = known,
            sets: tuple[tuple[int, ...], ...] = model.sets,
            truth_noise: float = _TRUTH_NOISE * is_posterior,
        ) -> Batch:
            some = known[torch.randint(len(known), (batch,), generator=generator)]
            seen = _observe(some, sets, generator)
            return some + truth_noise * torch.randn(some.shape, generator=generator), seen

        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            estimator: CGNF | AmortizedPosterior
            if model.kind == "flow":
                estimator = CGNF(_SIZE, _CHAIN, origin="none", dimensions=2)
            else:
                names = _CHAIN.joints
                estimator = AmortizedPosterior(
                    names, names, origin="none", position=False, components=4, width=64, residuals=1, joint_dimensions=2
                )
        fit(
            estimator,
            draw,
            steps=0 if model.kind == "linear part" else steps,
            seed=seed,
            validation=(others, _observe(others, model.sets, seeded_generator(seed))) if is_posterior else None,
            progress=None if progress is None else with_offset(progress, index * steps),
        )
        yield name, estimator.double()(context.to("cpu", torch.float64))


def _observe(poses: Tensor, sets: Sequence[tuple[int, ...]], generator: torch.Generator) -> Context:
    """Observe one of the sets of nodes of each pose (M, 3, 2)."""
    noise = _NOISE * torch.randn(poses.shape, generator=generator)
    masks = torch.zeros(len(sets), 3, dtype=torch.bool)
    for index, members in enumerate(sets):
        masks[index, list(members)] = True
    return _context(poses + noise, masks[torch.randint(len(sets), (len(poses),), generator=generator)])


def _context(keypoints: Tensor, observed: Tensor) -> Context:
    """State the noise of what is observed; what is not has none, and is missing."""
    return Context(keypoints, observed, _NOISE * observed)
