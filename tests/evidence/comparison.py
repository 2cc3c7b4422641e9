"""How often a comparison names a better model where none is, and how often it finds one that is better.

Sequences are drawn from a pool on which three models were evaluated. Each model is wrong by a place and a spread of its
own in every sequence, of one law, and which model's sums of a sequence count as whose is drawn too: so the models are
exchangeable, whatever the pool.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals
from posecal.report.comparison import Comparison, compare_totals
from posecal.stats.pairs import LEVEL_OF_OTHERS
from posecal.stats.resampling import LEVEL, holm
from tests.evidence import Table
from tests.helpers.samplers import pairs_of, sequences
from tests.helpers.sums import accumulate

MODELS = ("a", "b", "c")
METRICS = ("default, scores", "all")
SIZES = (8, 20, 40)
POOL, FRAMES, JOINTS, HYPOTHESES = 400, 4, 4, 12


@dataclass(frozen=True)
class Pool:
    """Sums of all models over each of many sequences, (models, sequences, …), and values per pose."""

    first: Totals
    sums: dict[str, npt.NDArray[np.float64]]
    counts: dict[str, npt.NDArray[np.int64]]
    per_pose: dict[str, npt.NDArray[np.float64]]

    def totals(self, model: npt.NDArray[np.intp], sequence: npt.NDArray[np.intp]) -> Totals:
        """Give the sums over some sequences, each as one of the models has them."""
        values = {name: some[model, sequence] for name, some in self.per_pose.items()}
        return replace(
            self.first,
            cells={"sequence": sequences(len(sequence), len(sequence))},
            poses=self.first.poses[sequence],
            sums={name: some[model, sequence] for name, some in self.sums.items()},
            counts={name: some[model, sequence] for name, some in self.counts.items()},
            per_pose={name: some.reshape(-1, *some.shape[2:]) for name, some in values.items()},
            cell_of=np.repeat(np.arange(len(sequence)), FRAMES),
            pose_hashes=self.first.pose_hashes[:0],
        )


@cache
def pool(better: float = 1.0) -> Pool:
    """Evaluate the models; the first one's errors of place are smaller by a factor."""
    random = np.random.default_rng(17)
    sequence = np.repeat(np.arange(POOL), FRAMES)
    difficulty = random.lognormal(0, 0.5, POOL)[sequence, None, None]
    centre = random.normal(0, 300, (len(sequence), JOINTS, 3))
    truth = centre + 40 * difficulty * random.standard_normal(centre.shape)
    labels = {"sequence": sequences(len(sequence), POOL)}
    protocol, totals = Protocol(metrics="all"), []
    for share in (better, 1.0, 1.0):
        bias = share * difficulty * random.normal(0, 30, (POOL, JOINTS, 3))[sequence]
        spread = 40 * difficulty * random.lognormal(0, 0.3, POOL)[sequence, None, None]
        hypotheses = centre + bias + spread * random.standard_normal((HYPOTHESES, *centre.shape))
        totals.append(accumulate(pairs_of(hypotheses, truth, labels=labels), protocol, threads=1))
    parts = {kind: [getattr(each, kind) for each in totals] for kind in ("sums", "counts", "per_pose")}
    stacked = {kind: {name: np.stack([one[name] for one in some]) for name in some[0]} for kind, some in parts.items()}
    shape = len(MODELS), POOL, FRAMES
    per_pose = {name: some.reshape(*shape, *some.shape[2:]) for name, some in stacked["per_pose"].items()}
    return Pool(totals[0], stacked["sums"], stacked["counts"], per_pose)


def exchangeable(size: int, replicate: int) -> Comparison:
    """Compare three exchangeable models."""
    random = np.random.default_rng([size, replicate])
    chosen = random.choice(POOL, size, replace=False)
    roles = random.permuted(np.tile(np.arange(len(MODELS)), (size, 1)), axis=1)
    return compare_totals([pool().totals(role, chosen) for role in roles.T], MODELS)


def part_of(comparison: Comparison, models: int, metrics: str) -> Comparison:
    """Compare the first models by some of the metrics; what is known of each model is not computed again."""
    totals = [replace(some, protocol=Protocol(metrics=metrics)) for some in comparison.totals[:models]]
    part = compare_totals(totals, MODELS[:models])
    known = {key: value for key, value in comparison._memory.items() if key[0] in {"value", "without", "sizes"}}
    part._memory.update(known)
    return part


def names_one_alone(comparison: Comparison) -> bool:
    """Whether some metric names a better model by p adjusted for the pairs of models only, as in posecal 0.1.0."""
    tested = [name for name, metric in comparison.metrics.items() if metric.direction != "none"]
    p = ([d.p for d in comparison.differences_of(name)] for name in tested)
    return any(value < LEVEL for values in p for value in holm(values))


def false_winners(replicates: int) -> list[tuple[str, ...]]:
    """Count comparisons of exchangeable models in which a better one is named."""
    rows = []
    for size in SIZES:
        counts = np.zeros((2, len(METRICS), 3), dtype=int)
        numbers = [0] * len(METRICS)
        for replicate in range(replicates):
            whole = exchangeable(size, replicate)
            for models in (3, 2):
                for place, metrics in enumerate(METRICS[::-1]):
                    part = whole if (models, metrics) == (3, "all") else part_of(whole, models, metrics)
                    winners = [d for d in part.differences if d.better is not None]
                    numbers[place] = len(part.metrics)
                    counts[models - 2, place] += names_one_alone(part), any(d.primary for d in winners), bool(winners)
        rows += [
            (str(size), str(models), str(numbers[place]), *(f"{n / replicates:.1%}" for n in counts[models - 2, place]))
            for models in (2, 3)
            for place in range(len(METRICS))[::-1]
        ]
    return rows


def found(replicates: int) -> list[tuple[str, ...]]:
    """Count comparisons in which a model with smaller errors of place is found to be better."""
    rows = []
    for size in SIZES:
        counts = np.zeros(5, dtype=int)
        for replicate in range(replicates):
            chosen = np.random.default_rng([size, replicate]).choice(POOL, size, replace=False)
            totals = [pool(0.75).totals(np.full(size, model), chosen) for model in (0, 1)]
            comparison = part_of(compare_totals(totals, MODELS[:2]), 2, METRICS[0])
            other = compare_totals(comparison.totals, MODELS[:2], ["min_mpjpe"])
            (score,), (accuracy,) = (comparison.differences_of(name) for name in ("energy_score", "min_mpjpe"))
            (rest,) = other.differences_of("energy_score")
            p = (score.p, score.p_adjusted, rest.p_adjusted, accuracy.p, accuracy.p_adjusted)
            counts += np.array(p) < (LEVEL, LEVEL, LEVEL_OF_OTHERS, LEVEL, LEVEL_OF_OTHERS)
        rows.append((str(size), *(f"{n / replicates:.0%}" for n in counts)))
    return rows


TABLES = [
    Table(
        "false-winners",
        (
            "sequences",
            "models",
            "metrics",
            "some metric names a better one, 0.1.0",
            "a primary metric does, now",
            "some metric does, now",
        ),
        false_winners,
        300,
    ),
    Table(
        "winners",
        (
            "sequences",
            "energy score, p alone",
            "energy score, primary",
            "energy score, not primary",
            "minMPJPE, p alone",
            "minMPJPE, not primary",
        ),
        found,
        300,
    ),
]
