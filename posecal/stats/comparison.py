"""Which of two models is better, and is it more than chance? The same poses, paired by sequence.

The difference of two models is far surer than either number, because both meet the same easy and hard sequences. So
every metric's difference is left-one-sequence-out, and its interval and p-value come from that. Models whose numbers
were not made alike, or on other poses, are refused.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from itertools import combinations

import numpy as np

from posecal.engine.metric import SUM_OF_TRUE_POSES, Metric
from posecal.engine.totals import Totals, difference_of_signatures
from posecal.errors import PoseDataError
from posecal.registry import metrics_of
from posecal.stats.leave_one_out import without
from posecal.stats.resampling import Interval, holm, jackknife, paired_p
from posecal.stats.uncertainty import null

__all__ = ["Comparison", "Difference", "compare"]

LEVEL = 0.05
"""Differences with an adjusted p-value below this count in the ranks."""


@dataclass(frozen=True)
class Difference:
    """How one metric differs between two models.

    Attributes
    ----------
    metric : str
        Name in snake case.
    first, second : str
        The two models.
    value : float
        The first's number minus the second's; where 0 is best, how much further from 0 the first's is.
    low, high : float
        95 % interval of the difference, over repetitions of the sequences.
    p : float
        Two-sided p-value, adjusted for the number of pairs of models (Holm).
    better : str or None
        The model that is better beyond chance; None where neither is, or where no direction is better.
    """

    metric: str
    first: str
    second: str
    value: float
    low: float
    high: float
    p: float
    better: str | None


@dataclass(frozen=True)
class Comparison:
    """Several models on the same poses.

    Attributes
    ----------
    names : tuple of str
        The models.
    totals : tuple of Totals
        Their sums.
    metrics : dict of Metric
        What all of them report.
    differences : tuple of Difference
        Of every pair of models, for every metric.
    """

    names: tuple[str, ...]
    totals: tuple[Totals, ...]
    metrics: dict[str, Metric]
    differences: tuple[Difference, ...]

    def value(self, metric: str, model: str) -> float:
        """Give a model's number."""
        return self.totals[self.names.index(model)].value(self.metrics[metric])

    def interval(self, metric: str, model: str) -> Interval:
        """Give the 95 % interval of a model's number; NaN for calibration errors, which have none."""
        found, totals = self.metrics[metric], self.totals[self.names.index(model)]
        if found.deviation is not None:
            return Interval(math.nan, math.nan, math.nan, 0)
        return jackknife(totals.value(found), without(totals, found))

    def feasible(self, metric: str = "ece") -> float:
        """Give the largest calibration error that a calibrated sampler would show here: its 95 % quantile.

        Each model's own deviations give one; this is the smallest, a guide for the eye. Whether a model is beyond it by
        chance says :meth:`calibrated`.
        """
        return min(null(totals, self.metrics[metric]).high for totals in self.totals)

    def calibrated(self, metric: str = "ece") -> list[str]:
        """Name the models whose calibration error is not beyond what chance would show them."""
        tests = [null(totals, self.metrics[metric]).p for totals in self.totals]
        return [name for name, p in zip(self.names, tests, strict=True) if p >= LEVEL]

    def rank(self, metric: str, model: str) -> int:
        """Give a model's rank: 1 and how many are better beyond chance."""
        beaten = [d for d in self.differences if d.metric == metric and model in (d.first, d.second)]
        return 1 + sum(d.better is not None and d.better != model for d in beaten)

    def render(self, form: str) -> str:
        """Write the comparison as ``json`` (values, ranks and all differences) or ``csv`` (the differences)."""
        if form == "csv":
            text = io.StringIO()
            writer = csv.DictWriter(text, [field.name for field in fields(Difference)], lineterminator="\n")
            writer.writeheader()
            writer.writerows(asdict(difference) for difference in self.differences)
            return text.getvalue().rstrip("\n")
        values = [
            {"metric": name, "model": model, "value": _plain(self.value(name, model)), "rank": self.rank(name, model)}
            for name in self.metrics
            for model in self.names
        ]
        differences = [{key: _plain(value) for key, value in asdict(d).items()} for d in self.differences]
        about = {"signature": self.totals[0].signature, "models": self.names, "values": values}
        return json.dumps({**about, "differences": differences}, ensure_ascii=False, indent=1)


def _plain(value: object) -> object:
    return None if isinstance(value, float) and math.isnan(value) else value


def compare(totals: Sequence[Totals], names: Sequence[str]) -> Comparison:
    """Compare models on the same poses.

    Parameters
    ----------
    totals : sequence of Totals
        Two or more, made alike.
    names : sequence of str
        What the models are called.

    Returns
    -------
    Comparison
        Values, differences and ranks.

    Raises
    ------
    PoseDataError
        Where two were not made alike or not on the same poses; all differences at once.
    """
    if len(totals) < 2:
        raise PoseDataError(f"compare: {len(totals)} model; expected at least 2.")
    names = [name if names.index(name) == at else f"{name} #{at + 1}" for at, name in enumerate(names)]
    first = totals[0]
    for name, other in zip(names[1:], totals[1:], strict=True):
        if other.signature != first.signature:
            raise PoseDataError(
                f"{names[0]} and {name} were not made alike: {difference_of_signatures(first, other)}. "
                "Evaluate both with the same options; --hypotheses takes as many hypotheses of each."
            )
        _check_same_poses(first, other, names[0], name)
    known = [metrics_of(t.protocol, t.spec) for t in totals]
    shared = {name: metric for name, metric in known[0].items() if all(name in other for other in known)}
    pairs = list(combinations(range(len(totals)), 2))
    differences = []
    for metric in shared.values():
        values = [t.value(metric) for t in totals]
        left_out = [without(t, metric) for t in totals]
        if metric.direction == "zero":  # nearer to 0 is better: the distances from it are compared
            values, left_out = [abs(value) for value in values], [np.abs(some) for some in left_out]
        found = [jackknife(values[a] - values[b], left_out[a] - left_out[b]) for a, b in pairs]
        adjusted = holm([paired_p(interval) for interval in found])
        for (a, b), interval, p in zip(pairs, found, adjusted, strict=True):
            better = None
            if p < LEVEL and (least := _better(metric, values[a], values[b])) is not None:
                better = names[a] if least else names[b]
            difference = values[a] - values[b]
            differences.append(
                Difference(metric.name, names[a], names[b], difference, interval.low, interval.high, p, better)
            )
    return Comparison(tuple(names), tuple(totals), shared, tuple(differences))


def _better(metric: Metric, first: float, second: float) -> bool | None:
    """Whether the first number is the better one; None where no direction is."""
    if metric.direction == "none":
        return None
    return (first < second) == (metric.direction != "higher")


def _check_same_poses(first: Totals, other: Totals, name: str, other_name: str) -> None:
    """Refuse two evaluations of other poses.

    Raises
    ------
    PoseDataError
        Where sequences, numbers of poses, or the true poses differ.
    """
    counts = [t.by_sequence(SUM_OF_TRUE_POSES) for t in (first, other)]
    labels = [sorted(set(t.cells["sequence"].tolist())) for t in (first, other)]
    if labels[0] != labels[1] or not np.array_equal(counts[0][1], counts[1][1]):
        poses = [int(t.poses.sum()) for t in (first, other)]
        raise PoseDataError(
            f"{name} and {other_name} hold other poses: {poses[0]:,} in {first.units()} and {poses[1]:,} in "
            f"{other.units()}. Compare models on the same frames; --missing skip may have left some out."
        )
    scale = np.abs(counts[0][0]).max() + 1
    if np.abs(counts[0][0] - counts[1][0]).max() > 1e-4 * scale:
        raise PoseDataError(f"{name} and {other_name} were held against different true poses; expected the same.")
