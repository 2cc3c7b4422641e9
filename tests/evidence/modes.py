"""In how many poses hypotheses seem to have two modes: few hypotheses, angles and weighted ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from unittest import mock

import numpy as np
import numpy.typing as npt

from posecal.calibration import modes
from posecal.engine.block import Block
from tests.evidence import Table
from tests.evidence.recalibration import two
from tests.helpers.laws import UNIMODAL, Law

Array = npt.NDArray[np.floating]
SIZES = (5, 8, 10, 20, 50, 200)


def _directions(random: np.random.Generator, shape: tuple[int, int], apart: float) -> Array:
    return np.asarray(apart * (random.random(shape) < 0.5) + random.normal(0, 20, shape))


ANGLES: dict[str, Callable[[np.random.Generator, tuple[int, int]], Array]] = {
    "angles, all round": lambda random, shape: random.uniform(-180, 180, shape),
    "angles, over half a circle": lambda random, shape: random.uniform(-90, 90, shape),
    "angles, two directions 120° apart": lambda random, shape: _directions(random, shape, 120),
    "angles, two opposite directions": lambda random, shape: _directions(random, shape, 180),
}
"""Angles (R, N), degrees; those of two directions have a deviation of 20° about each."""

POSITIONS: dict[str, Law] = {
    "uniform": UNIMODAL["uniform"],
    "thin ring": UNIMODAL["thin ring"],
    "two modes, 6 deviations apart": two(6, 0.5),
    "two modes, 8 deviations apart": two(8, 0.5),
    "two modes, 8 deviations apart, 25% in one": two(8, 0.25),
}
WEIGHTED = ("uniform", "two modes, 6 deviations apart")


def of_angles(name: str, N: int, poses: int) -> float:
    """Share of poses in which the summary sees two modes."""
    random = np.random.default_rng(N)
    x = ANGLES[name](random, (poses, N)) + random.uniform(-180, 180, (poses, 1))
    block = Block(x.T[:, :, None, None], np.zeros((poses, 1, 1)), period=360.0)
    return float(modes.two_modes(block.sorted, np.zeros((poses, 1), dtype=int), period=block.period).mean())


def of_weighted(name: str, N: int, poses: int) -> float:
    """The same of 3 N hypotheses whose weights, of Dirichlet's law, leave an effective number of about N or more."""
    random = np.random.default_rng(N)
    weights = random.dirichlet(np.full(3 * N, 0.5), poses)
    enough = 1 / (weights**2).sum(axis=1) >= modes.LEAST_WEIGHTED
    x = POSITIONS[name](random, poses, 3 * N)[:, None]
    return float(modes.two_modes(x, np.zeros((poses, 1), dtype=int), weights)[enough].mean())


def of_positions(name: str, N: int, poses: int) -> float:
    """The same along any direction, with any number of hypotheses."""
    with mock.patch.object(modes, "LEAST", min(SIZES)):
        return float(modes.split_modes(POSITIONS[name](np.random.default_rng(N), poses, N)[:, None]).several.mean())


def _cells(share: Callable[[str, int, int], float], name: str, least: int, poses: int) -> Iterator[str]:
    return (f"{share(name, N, poses):.0%}" if least <= N else "" for N in SIZES)


def rows(replicates: int) -> list[tuple[str, ...]]:
    """Shares of poses with two modes, and what may come by chance."""
    return [
        ("what may come by chance", *(f"{modes.chance_limit(N):.0%}" for N in SIZES)),
        *((name, *_cells(of_positions, name, 0, replicates)) for name in POSITIONS),
        *((name, *_cells(of_angles, name, modes.LEAST, replicates)) for name in ANGLES),
        *((f"weighted, {name}", *_cells(of_weighted, name, modes.LEAST_WEIGHTED, replicates)) for name in WEIGHTED),
    ]


TABLES = [Table("modes", ("poses with two modes", *(f"N = {N}" for N in SIZES)), rows, 4000)]
