"""Sums that are known, of four cells, and random sums of many."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from posecal.engine.finish import entry
from posecal.engine.metric import Metric, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.engine.totals import Totals

SPEC = DataSpec(7, ("Head", "Hip"), 1, ("sequence", "action"), 25.0)

HEIGHT = Statistic("height", lambda block: block.truth[:, 0, 0])
JOINTS = Statistic("joints", lambda block: block.truth[..., 0], per_joint=True)


def metric(statistic: Statistic = HEIGHT, **changes: object) -> Metric:
    """A metric of which only the parts matter that are tested."""
    words = dict.fromkeys(("name", "label", "unit", "brief", "definition"), "")
    one = Metric(**words, direction="none", family="sharpness", statistic=statistic, finish=entry())
    return replace(one, **changes)  # type: ignore[arg-type]


def totals(protocol: Protocol | None = None, **changes: object) -> Totals:
    """Four cells of 3, 1, 2 and 4 poses in three sequences and two actions.

    Their heights add up to 30, 8, 14 and 0, of as many poses each; of the second joint only cells 0 and 2 have any.
    """
    sums = Totals(
        spec=SPEC,
        protocol=protocol or Protocol(),
        version="1.0",
        cells={"sequence": np.array(["a", "b", "b", "c"]), "action": np.array(["sit", "sit", "walk", "walk"])},
        poses=np.array([3, 1, 2, 4]),
        pose_hashes=np.stack([np.arange(10), np.zeros(10)], axis=1).astype(np.uint64),
    )
    sums.add("height", np.arange(4), np.array([30.0, 8, 14, 0]), np.array([3, 1, 2, 4]))
    columns = np.array([[30.0, 3], [8, 0], [14, 1], [0, 0]])
    sums.add("joints", np.arange(4), columns, np.array([[3, 1], [1, 0], [2, 1], [4, 0]]))
    return replace(sums, **changes)  # type: ignore[arg-type]


SIT, WALK = np.array([0, 1]), np.array([2, 3])


KEPT = Statistic("kept", lambda block: block.truth[:, 0, :2], per_pose=True)


def keeping() -> tuple[Totals, Metric]:
    """Two values of five poses in cells 0, 0, 1, 3 and 3, of which one is not known."""
    values = np.array([[1.0, 2], [3, 4], [5, 6], [7, math.nan], [9, 10]])
    sums = totals(per_pose={"kept": values}, cell_of=np.array([0, 0, 1, 3, 3]))
    return sums, metric(KEPT, finish=lambda values: float(values.sum()))


PAIR = Statistic("pair", lambda block: block.truth[:, 0, :2])


def random_totals(seed: int, C: int = 30, S: int = 7, G: int = 4, protocol: Protocol | None = None) -> Totals:
    """C cells of S sequences and G actions in disorder, some without a pose that counts; two values of each pose."""
    random = np.random.default_rng(seed)
    poses = random.integers(0, 5, C)
    cell_of = random.permutation(np.repeat(np.arange(C), poses))
    values = random.integers(0, 9, (len(cell_of), 2)).astype(float)
    values[random.random(len(values)) < 0.1, 1] = math.nan
    numbers = random.permutation(np.arange(C) % S), random.integers(0, G, C)
    sums = Totals(
        spec=SPEC,
        protocol=protocol or Protocol(),
        version="1.0",
        cells={name: np.char.add(name[0], of.astype(str)) for name, of in zip(SPEC.labels, numbers, strict=True)},
        poses=poses,
        per_pose={"kept": values},
        cell_of=cell_of,
    )
    counts = random.binomial(poses, 0.8)
    sums.add("height", np.arange(C), random.normal(10, 5, C) * counts, counts)
    sums.add("pair", np.arange(C), random.normal(10, 5, (C, 2)) * counts[:, None], counts)
    by_joint = random.binomial(poses[:, None], [[0.9, 0.3]])
    sums.add("joints", np.arange(C), random.normal(10, 5, (C, 2)) * by_joint, by_joint)
    return sums
