"""Whether models can be compared: made alike, on the same poses, and by as many of them in each metric."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posecal.engine.measure import SUM_OF_TRUE_POSES
from posecal.engine.merge import difference_of_signatures, different_metrics
from posecal.engine.metric import Statistic
from posecal.engine.sums import Counts, sum_by
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, option


def check_comparable(first: Totals, other: Totals, name: str, other_name: str) -> None:
    """Refuse two evaluations that were not made alike, or not of the same poses.

    Raises
    ------
    PoseDataError
        Where their options, joints, numbers of hypotheses, own metrics or poses differ.
    """
    if other.signature != first.signature:
        differ_in_n = other.spec.n_hypotheses != first.spec.n_hypotheses
        hint = f"; {option('n_hypotheses')} takes as many hypotheses of each" if differ_in_n else ""
        raise PoseDataError(
            f"{name} and {other_name} were not made alike: {difference_of_signatures(first, other)}. "
            f"Evaluate both with the same options{hint}."
        )
    if metrics := different_metrics(first, other):
        raise PoseDataError(f"{name} and {other_name} define {metrics} differently; expected the same metrics.")
    check_same_poses(first, other, name, other_name)


def check_same_poses(first: Totals, other: Totals, name: str, other_name: str) -> None:
    """Refuse two evaluations of other poses.

    Raises
    ------
    PoseDataError
        Where the sequences, their numbers of poses, or their true poses differ.
    """
    both = (first, other)
    labels = [np.unique(totals.cells["sequence"]).tolist() for totals in both]
    poses = [np.bincount(totals.sequence_of, totals.poses).tolist() for totals in both]
    if labels[0] != labels[1] or poses[0] != poses[1]:
        numbers = [f"{totals.poses.sum():,} in {totals.units()}" for totals in both]
        raise PoseDataError(
            f"{name} and {other_name} hold other poses: {numbers[0]} and {numbers[1]}. Compare models on the same "
            f"frames, in the same sequences; {option('missing', 'skip')} may have left some out."
        )
    key = SUM_OF_TRUE_POSES.name
    sums = [sum_by(totals.sequence_of, totals.n_sequences, totals.sums[key]) for totals in both]
    counts = [sum_by(totals.sequence_of, totals.n_sequences, totals.counts[key]) for totals in both]
    differs = np.abs(sums[0] - sums[1]).max() > 1e-4 * (np.abs(sums[0]).max() + 1)
    if differs or not np.array_equal(counts[0], counts[1]):
        raise PoseDataError(f"{name} and {other_name} were evaluated against different true poses; expected the same.")


@dataclass(frozen=True)
class PosesThatCount:
    """How many poses count in a statistic of each model.

    Attributes
    ----------
    numbers : mapping of int
        By model: at the joint where they differ most.
    like : mapping of str
        By model: the first model of which as many poses count in every sequence, at every joint.
    """

    numbers: Mapping[str, int]
    like: Mapping[str, str]

    def alike(self, first: str, second: str) -> bool:
        """Whether as many poses count of two models in every sequence."""
        return self.like[first] == self.like[second]


def poses_that_count(models: Mapping[str, Totals], statistic: Statistic) -> PosesThatCount:
    """Count the poses of each model of which a statistic is known.

    A model's own hypotheses decide: where all weight lies on one, say, the spread of a pose is not known.

    Parameters
    ----------
    models : mapping of Totals
        By name, on the same poses.
    statistic : Statistic
        Of which they hold sums or values.
    """
    counts = {name: _of_sequences(totals, statistic) for name, totals in models.items()}
    like = {
        name: next(other for other, some in counts.items() if np.array_equal(own, some)) for name, own in counts.items()
    }
    whole = np.stack([some.sum(axis=0).reshape(-1) for some in counts.values()])
    joint = int(np.ptp(whole, axis=0).argmax())
    return PosesThatCount(dict(zip(counts, whole[:, joint].tolist(), strict=True)), like)


def _of_sequences(totals: Totals, statistic: Statistic) -> Counts:
    """Count poses in each sequence, (S,) or (S, J)."""
    if statistic.per_pose:
        cells = totals.cell_of[totals.known_poses(statistic)]
        return np.bincount(totals.sequence_of[cells], minlength=totals.n_sequences)
    return sum_by(totals.sequence_of, totals.n_sequences, totals.of_cells(statistic)[1])


def not_compared(counted: Mapping[str, PosesThatCount], models: Sequence[str]) -> list[str]:
    """Say in one remark which metrics are not compared, since other poses count in each model; none where all are.

    Parameters
    ----------
    counted : mapping of PosesThatCount
        By metric.
    models : sequence of str
        Their names.
    """
    metrics: dict[tuple[int, ...], list[str]] = {}
    for name, poses in counted.items():
        if len(set(poses.like.values())) > 1:
            metrics.setdefault(tuple(poses.numbers[model] for model in models), []).append(name)
    if not metrics:
        return []
    parts = "; ".join(
        f"{', '.join(names)} ({', '.join(f'{n:,} of {model}' for n, model in zip(numbers, models, strict=True))})"
        for numbers, names in metrics.items()
    )
    return [
        f"not compared, since they count other poses of each model: {parts}. A pose whose weight lies on one "
        "hypothesis, or that has only one, has no spread, score or calibration, and models that give up their spread "
        "on hard poses would win; expected two or more hypotheses of each pose."
    ]
