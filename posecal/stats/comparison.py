"""Comparison of models on the same poses, paired by sequence: differences, intervals, p-values and ranks.

Both models meet the same easy and hard sequences, so their difference is less uncertain than either number: every
metric's difference is jackknifed over sequences, and its interval and p-value come from that. Which model is better is
said by p-values that are adjusted for the number of tests. Models whose numbers were not made alike, or on other poses,
are refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from posecal.calibration.error import FEW_HYPOTHESES
from posecal.data.arrays import FloatArray
from posecal.data.texts import frame_of
from posecal.engine.metric import Metric
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, did_you_mean, for_python, printable
from posecal.metrics.likelihood import LIKELIHOODS
from posecal.registry import metrics_of, unmeasured
from posecal.stats.heterogeneity import SHOWN, sequences_differ
from posecal.stats.jackknife import Interval, jackknife, leave_one_out, sequence_sizes
from posecal.stats.multiplicity import PRIMARY, adjust, default_primary
from posecal.stats.pairs import Difference, Pair, pairs
from posecal.stats.remarks import likelihood_is_unbounded, remarks_on_chance, remarks_on_numbers, remarks_on_sequences
from posecal.stats.resampling import LEVEL, MIN_SEQUENCES, Null
from posecal.stats.same_poses import PosesThatCount, not_compared, poses_that_count
from posecal.stats.uncertainty import effective_hypotheses, measured_spec, null, weights_allow_no_test

if TYPE_CHECKING:
    import pandas as pd

_DEPEND_ON_NUMBER = ("calibration", "rank_tests", "scores")
"""Families whose numbers weights move by more, the smaller the effective number of hypotheses is."""

_ALIKE = 1.1
"""Effective numbers of weighted hypotheses are alike up to this ratio."""

T = TypeVar("T")


@dataclass(frozen=True, repr=False)
class PairedModels:
    """Several models on the same poses; each number is computed when it is asked for, once.

    Attributes
    ----------
    names : tuple of str
        The models.
    totals : tuple of Totals
        Their sums.
    chosen : tuple of str
        Primary metrics; none for those of the default.
    """

    names: tuple[str, ...]
    totals: tuple[Totals, ...]
    chosen: tuple[str, ...] = ()
    _memory: dict[Hashable, Any] = field(default_factory=dict, init=False, compare=False)

    def __repr__(self) -> str:
        first = self.totals[0]
        return (
            f"<{type(self).__name__} of {printable(', '.join(self.names))}: M = {first.poses.sum():,}, {first.units()}>"
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a careful reader should know: about the tests, and about the data of each model, after its name.

        A remark on the data of all models stands once.
        """
        return self.remarks_in(for_python)

    def remarks_in(self, words: Callable[[str], str]) -> tuple[str, ...]:
        """Give the remarks, with options named by ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`."""
        models: dict[str, list[str]] = {}
        for name, totals in zip(self.names, self.totals, strict=True):
            for remark in (
                *totals.remarks,
                *remarks_on_sequences(totals),
                *remarks_on_numbers(totals, self.metrics),
                *self._remarks_on_chance(name, totals),
            ):
                models.setdefault(words(remark), []).append(name)
        of_data = (
            remark if len(some) == len(self.names) else f"{', '.join(some)}: {remark}"
            for remark, some in models.items()
        )
        return (*map(words, self._remarks_on_tests), *of_data)

    def _remarks_on_chance(self, name: str, totals: Totals) -> Iterator[str]:
        differ = ("sequences differ", name)
        yield from remarks_on_chance(
            self.metrics,
            lambda metric: self.test(metric, name),
            lambda: self._once(differ, lambda: sequences_differ(totals, self.metrics)),
            SHOWN,
        )

    @cached_property
    def _remarks_on_tests(self) -> list[str]:
        """Say why there are no p-values, and why other metrics than usual are the primary ones."""
        remarks, first = [], self.totals[0]
        if first.n_sequences < MIN_SEQUENCES:
            remarks.append(
                f"no p-values on {first.units()}, and no model is called better; expected at least {MIN_SEQUENCES}. "
                "With fewer, one of two equal models is ahead in all of them in more than 5 % of cases."
            )
        if self._weights_differ:
            effective = map(effective_hypotheses, self.totals)
            numbers = ", ".join(f"{n:.1f} of {name}" for name, n in zip(self.names, effective, strict=True))
            remarks.append(
                "no p-values of calibration, rank tests and scores, and no model is called better in them: effective N "
                f"is {numbers}, and weights move these numbers by more, the smaller it is; expected at least "
                f"{FEW_HYPOTHESES} of weighted hypotheses, and alike within {_ALIKE - 1:.0%}."
            )
        if {*LIKELIHOODS} & self.metrics.keys() and self._likelihood_is_unbounded:
            remarks.append(
                "no p-values of likelihoods, and no model is called better in them: they have no bound here."
            )
        lack = "" if self.chosen else unmeasured(PRIMARY[0], first.protocol, first.spec)
        if lack and PRIMARY[0] not in self.metrics:
            remarks.append(f"primary metrics: {', '.join(self.primary)}; {PRIMARY[0]} {lack}")
        return remarks + not_compared({name: self._counted(name) for name in self.metrics}, self.names)

    @cached_property
    def _weights_differ(self) -> bool:
        """Whether some hypotheses have unequal weights, and effective numbers that are small or differ."""
        if not any(totals.spec.has_weights for totals in self.totals):
            return False
        numbers = [effective_hypotheses(totals) for totals in self.totals]
        return any(map(weights_allow_no_test, self.totals)) or max(numbers) > _ALIKE * min(numbers)

    @cached_property
    def _likelihood_is_unbounded(self) -> bool:
        return any(map(likelihood_is_unbounded, self.totals))

    @cached_property
    def metrics(self) -> dict[str, Metric]:
        """The metrics that all models report, by name."""
        fewest = sorted(self.totals, key=effective_hypotheses)  # of the first of them all levels must be known
        known = [metrics_of(totals.protocol, measured_spec(totals), own=totals.own_metrics) for totals in fewest]
        names = [{name: metric.statistic.name for name, metric in some.items()} for some in known]  # of one density
        return {n: m for n, m in known[0].items() if all(other.get(n) == m.statistic.name for other in names)}

    @cached_property
    def primary(self) -> tuple[str, ...]:
        """The metrics that the comparison rests on: the chosen ones, else the energy score and the ECE."""
        return self.chosen or default_primary(self.metrics)

    def value(self, metric: str, model: str) -> float:
        """Give a model's number."""
        one, totals = self._find(metric, model)
        return self._once(("value", metric, model), lambda: totals.value(one))

    def interval(self, metric: str, model: str) -> Interval:
        """Give the 95 % interval of a model's number; NaN for calibration errors, which have none."""
        if self._find(metric, model)[0].deviation is not None:
            return Interval(math.nan, math.nan, math.nan, math.nan, 0)
        value, without, sizes = self.value(metric, model), self._without(metric, model), self._sizes(metric, model)
        return jackknife(value, without, sizes, self.metrics[metric].bounds)

    def differences_of(self, metric: str) -> tuple[Difference, ...]:
        """Give the differences of every pair of models for one metric."""
        return self._once(("differences", metric), lambda: tuple(self._compare(metric)))

    @property
    def differences(self) -> tuple[Difference, ...]:
        """The differences of every pair of models, for every metric."""
        return tuple(difference for metric in self.metrics for difference in self.differences_of(metric))

    @property
    def table(self) -> pd.DataFrame:
        """The differences as a data frame: a row for each metric and pair of models."""
        columns = [column.name for column in fields(Difference)]
        table = frame_of([tuple(asdict(difference).values()) for difference in self.differences], columns)
        table.attrs = {"remarks": list(self.remarks)}
        return table

    def feasible(self, metric: str = "ece") -> float:
        """Give the largest calibration error that a calibrated sampler would show here: its 95 % quantile.

        Each model's own deviations give nearly the same one; this is their median, a guide for the eye. Whether a model
        is beyond it by chance says :meth:`calibrated`. Models that repeat one hypothesis have none, nor models whose
        hypotheses are so much too wide for their number that it can't be known.
        """
        highs = [high for name in self.names if not math.isnan(high := self.test(metric, name).high)]
        untested = any(map(weights_allow_no_test, self.totals)) or not highs
        return math.nan if untested else float(np.median(highs))

    def has_test(self, metric: str = "ece") -> bool:
        """Whether some model's calibration error has a p-value, and weights allow one of all models."""
        tested = any(not math.isnan(self.test(metric, name).p) for name in self.names)
        return tested and not any(map(weights_allow_no_test, self.totals))

    def calibrated(self, metric: str = "ece") -> list[str]:
        """Name the models whose calibration error is not beyond what chance would show them.

        Models that repeat one hypothesis have no test, and are not among them.

        Raises
        ------
        PoseDataError
            With too few sequences for a test, and for a metric that has none.
        """
        p = {name: self.test(metric, name).p for name in self.names}
        if not self.has_test(metric):
            what = f"{self.totals[0].units()}; expected at least {MIN_SEQUENCES}"
            if any(map(weights_allow_no_test, self.totals)):
                what = f"weighted hypotheses of so small an effective N; expected at least {FEW_HYPOTHESES}"
            raise PoseDataError(f"calibrated: {metric} has no test on {what}.")
        return [name for name, value in p.items() if value >= LEVEL]

    def test(self, metric: str, model: str) -> Null:
        """Test a model's calibration error, or another number that has a test, against a calibrated sampler's.

        Raises
        ------
        PoseDataError
            For a metric that has none.
        """
        one, totals = self._find(metric, model)
        if one.deviation is None:
            tested = [name for name, other in self.metrics.items() if other.deviation is not None]
            raise PoseDataError(f"test: {metric} is no calibration error or rank test. {did_you_mean(metric, tested)}")
        return self._once(("null", metric, model), lambda: null(totals, one))

    def rank(self, metric: str, model: str) -> int:
        """Give a model's rank: 1 and how many are better beyond chance."""
        self._find(metric, model)
        pairs = [pair for pair in self.differences_of(metric) if model in (pair.first, pair.second)]
        return 1 + sum(pair.better not in (None, model) for pair in pairs)

    def _find(self, metric: str, model: str) -> tuple[Metric, Totals]:
        if metric not in self.metrics:
            raise PoseDataError(f"{metric} is not in the comparison. {did_you_mean(metric, self.metrics)}")
        if model not in self.names:
            raise PoseDataError(f"{model} is not in the comparison. {did_you_mean(model, self.names)}")
        return self.metrics[metric], self.totals[self.names.index(model)]

    def _once(self, key: Hashable, compute: Callable[[], T]) -> T:
        if key not in self._memory:
            self._memory[key] = compute()
        value: T = self._memory[key]
        return value

    def _without(self, metric: str, model: str) -> FloatArray:
        one, totals = self._find(metric, model)
        return self._once(("without", metric, model), lambda: leave_one_out(totals, one))

    def _sizes(self, metric: str, model: str) -> FloatArray:
        one, totals = self._find(metric, model)
        return self._once(("sizes", metric, model), lambda: sequence_sizes(totals, one))

    def _compare(self, metric: str) -> Iterator[Difference]:
        direction, primary = self._find(metric, self.names[0])[0].direction, metric in self.primary
        for pair, adjusted in zip(self._paired(metric), self._adjusted(primary)[metric], strict=True):
            yield pair.difference(metric, direction, adjusted, primary=primary)

    def _adjusted(self, primary: bool) -> dict[str, list[float]]:
        """Give the adjusted p-values of the primary metrics, or of all."""
        names = self.primary if primary else tuple(self.metrics)
        return self._once(
            ("adjusted", names), lambda: adjust({name: [pair.p for pair in self._paired(name)] for name in names})
        )

    def _paired(self, metric: str) -> list[Pair]:
        """Give the difference of every pair of models; unknown where other poses count in each."""
        return self._once(
            ("pairs", metric),
            lambda: [p if self._counted(metric).alike(p.first, p.second) else p.unknown() for p in self._pairs(metric)],
        )

    def _counted(self, metric: str) -> PosesThatCount:
        statistic = self.metrics[metric].statistic
        models = dict(zip(self.names, self.totals, strict=True))
        return self._once(("counted", statistic.name), lambda: poses_that_count(models, statistic))

    def _pairs(self, metric: str) -> Iterator[Pair]:
        sizes = np.max([self._sizes(metric, name) for name in self.names], axis=0)
        values = {name: self.value(metric, name) for name in self.names}
        without = {name: self._without(metric, name) for name in self.names}
        one = self._find(metric, self.names[0])[0]
        untested = (self._weights_differ and one.family in _DEPEND_ON_NUMBER) or (
            metric in LIKELIHOODS and self._likelihood_is_unbounded
        )
        for pair in pairs(one.direction, values, without, sizes):
            yield replace(pair, p=math.nan) if untested else pair
