"""Differences of one metric between two models on the same sequences, with intervals and p-values."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.engine.metric import Direction
from posecal.stats.jackknife import Interval, jackknife, paired_p
from posecal.stats.resampling import LEVEL, MIN_SEQUENCES

VALUE, DISTANCE = "value", "distance from 0"
"""What is compared: numbers, or how far from 0 they are, where 0 is best."""

ROUNDING, NOTHING = 1e-6, 1e-9
"""A difference of less than this share of the numbers, or less than this, is one of rounding: no test."""


LEVEL_OF_OTHERS = 0.02
"""Adjusted p-values of metrics that are not primary are called significant below this: so at most 7 % of comparisons of
equally good models name a better one, in primary metrics or others."""


@dataclass(frozen=True)
class Difference:
    """How one metric differs between two models.

    Attributes
    ----------
    metric : str
        Name in snake case.
    first, second : str
        The two models.
    compared : str
        What is compared: ``value``, or ``distance from 0`` where 0 is best.
    value : float
        The first's number minus the second's, or its distance from 0 minus the second's.
    low, high : float
        95 % interval of the difference, over repetitions of the sequences.
    p : float
        Two-sided p-value of this difference alone; NaN with fewer than six sequences.
    p_adjusted : float
        The same, adjusted by Holm's method: of a primary metric for the primary metrics and pairs of models, of
        another for all metrics and pairs.
    better : str or None
        The model that is better beyond chance: ``p_adjusted`` is below 0.05 for a primary metric, 0.02 for another.
        None where neither is, or where no direction is better.
    primary : bool
        Whether the metric is a primary one.
    """

    metric: str
    first: str
    second: str
    compared: str
    value: float
    low: float
    high: float
    p: float
    p_adjusted: float
    better: str | None
    primary: bool


@dataclass(frozen=True)
class Pair:
    """The difference of two models in one metric, before its p-value is adjusted.

    Attributes
    ----------
    first, second : str
        The two models.
    value : float
        The first's number minus the second's, or its distance from 0 minus the second's where 0 is best.
    interval : Interval
        Of the value.
    p : float
        As of a :class:`Difference`.
    """

    first: str
    second: str
    value: float
    interval: Interval
    p: float

    def unknown(self) -> Pair:
        """Give the same pair without a difference, where the two numbers are of other poses."""
        nothing = Interval(math.nan, math.nan, math.nan, math.nan, self.interval.sequences)
        return Pair(self.first, self.second, math.nan, nothing, math.nan)

    def difference(self, metric: str, direction: Direction, adjusted: float, *, primary: bool) -> Difference:
        """Say which model is better, by the adjusted p-value."""
        better = None
        if adjusted < (LEVEL if primary else LEVEL_OF_OTHERS) and direction != "none":
            better = self.second if (self.value < 0) == (direction == "higher") else self.first
        compared = DISTANCE if direction == "zero" else VALUE
        models, ends = (self.first, self.second), (self.interval.low, self.interval.high)
        return Difference(metric, *models, compared, self.value, *ends, self.p, adjusted, better, primary)


def pairs(
    direction: Direction, values: Mapping[str, float], without: Mapping[str, FloatArray], sizes: FloatArray
) -> Iterator[Pair]:
    """Give the difference of every pair of models.

    Parameters
    ----------
    direction : str
        Of the metric; where it is ``zero``, the distances from 0 are compared.
    values : mapping of float
        Each model's number.
    without : mapping of arrays (S,)
        The same with each sequence left out.
    sizes : array (S,)
        Poses of each sequence that count, the most of any model.

    Yields
    ------
    Pair
        In the order of the models.

    Examples
    --------
    Six sequences of which each moves the difference alike: without scatter, as unlikely as six signs that agree.

    >>> without = {"a": np.full(6, 2.0), "b": np.full(6, 1.0)}
    >>> (pair,) = pairs("lower", {"a": 2.0, "b": 1.0}, without, np.ones(6))
    >>> pair.value, pair.p
    (1.0, 0.03125)
    """
    if direction == "zero":
        values = {name: abs(value) for name, value in values.items()}
        without = {name: np.abs(some) for name, some in without.items()}
    for a, b in combinations(values, 2):
        difference = values[a] - values[b]
        interval = jackknife(difference, without[a] - without[b], sizes)
        is_rounding = abs(difference) <= max(ROUNDING * max(abs(values[a]), abs(values[b])), NOTHING)
        yield Pair(a, b, difference, interval, _p_value(interval, is_rounding))


def _p_value(interval: Interval, is_rounding: bool) -> float:
    """Two-sided p-value of a difference, never 0: with no scatter at all it is that of signs that all agree."""
    if interval.sequences < MIN_SEQUENCES or math.isnan(interval.error):
        return math.nan
    p = 1.0 if is_rounding else paired_p(interval)
    return p if p > 0 else max(0.5 ** (interval.sequences - 1), sys.float_info.min)
