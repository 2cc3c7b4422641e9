"""Report: numbers, intervals, tests and curves of an evaluation, computed from its sums when they are asked for."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast, get_args

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import find_joint
from posecal.engine.cells import label_name
from posecal.engine.metric import Metric
from posecal.engine.storage import save_totals
from posecal.engine.sums import Cells
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, checked_integer, checked_type, did_you_mean, for_python, is_among, option
from posecal.metrics.occlusion import OCCLUSION, occlusion_metrics_of
from posecal.registry import metrics_of, unmeasured
from posecal.report import curves, notebook
from posecal.report.summary import remarks, summarize
from posecal.report.table import (
    AuxiliaryRow,
    Row,
    as_csv,
    as_dict,
    as_frame,
    as_json,
    auxiliary_number,
    auxiliary_rows,
    definition_of,
    tidy_rows,
)
from posecal.report.text import report_sheet, short_title
from posecal.stats.jackknife import Interval
from posecal.stats.resampling import Null, holm
from posecal.stats.uncertainty import interval, joint_intervals, joint_p_values, measured_spec, null

if TYPE_CHECKING:
    import pandas as pd

Format = Literal["text", "markdown", "latex", "csv", "json"]
T = TypeVar("T")


class Report:
    """The numbers of an evaluation, with their definitions, intervals and tests.

    Each is computed when it is asked for, and remembered. A report pickles; it holds sums, and a few poses at most.

    Parameters
    ----------
    totals : Totals
        The sums.
    by : str or sequence of str
        Labels to group by, beside the numbers over all poses.

    Attributes
    ----------
    groups : dict
        By ``label=value``, the indices of the cells of each group, or None where all cells have poses in it; None
        itself stands for all poses.

    Raises
    ------
    PoseDataError
        For a label that the sums don't hold.

    Examples
    --------
    >>> import numpy as np
    >>> from posecal.evaluation import evaluate
    >>> report = evaluate(np.full((2, 8, 2, 3), 4.0), np.full((8, 2, 3), 1.0), unit="mm")
    >>> round(report["mpjpe"], 3)
    5.196
    """

    def __init__(self, totals: Totals, by: str | Sequence[str] = ()) -> None:
        self.totals = checked_type(totals, "totals", Totals)
        given: object = by
        entries = given if isinstance(given, Iterable) and not isinstance(given, str) else (given,)
        self.by = tuple(dict.fromkeys(label_name(checked_type(entry, "by", str)) for entry in entries))
        self.groups: dict[str | None, Cells] = {None: None}
        self._occlusion: dict[str | None, dict[str, Metric]] = {}
        self._memory: dict[Hashable, Any] = {}
        for label in self.by:
            if label != "occlusion":
                self.groups |= {f"{label}={value}": cells for value, cells in totals.groups(label)}
                continue
            for which, metrics in occlusion_metrics_of(totals.protocol, measured_spec(totals)).items():
                if any(metric.statistic.name not in totals.sums for metric in metrics.values()):
                    raise PoseDataError(
                        f"by: this result holds no numbers by occlusion. Evaluate with {option('by', 'occlusion')}."
                    )
                self.groups[f"occlusion={which}"], self._occlusion[f"occlusion={which}"] = None, metrics

    def __reduce__(self) -> tuple[type[Report], tuple[Totals, tuple[str, ...]]]:
        return type(self), (self.totals, self.by)

    @cached_property
    def metrics(self) -> dict[str, Metric]:
        """The metrics by name, in the order of the report."""
        return metrics_of(self.totals.protocol, measured_spec(self.totals), own=self.totals.own_metrics)

    @cached_property
    def auxiliary(self) -> dict[str, AuxiliaryRow]:
        """The numbers beside the metrics, such as the p-values of calibration errors, by name."""
        return auxiliary_rows(self.metrics)

    def metrics_in(self, group: str | None) -> dict[str, Metric]:
        """Give the metrics of a group, which by occlusion are others."""
        if not is_among(group, self.groups):
            known = [name for name in self.groups if name is not None]
            raise PoseDataError(f"group: {group!r} is not in the report. {did_you_mean(str(group), known)}")
        return self._occlusion.get(group, self.metrics)

    @property
    def headline_metrics(self) -> dict[str, Metric]:
        """The metrics of the first tables: the headlines, and those that were asked for by name or family."""
        asks = self.totals.protocol.asks_for
        return {name: metric for name, metric in self.metrics.items() if metric.headline or asks(name, metric.family)}

    @property
    def signature(self) -> str:
        """One line that is equal for two reports exactly where their numbers can be compared."""
        return self.totals.signature

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a careful reader should know about the data and about what can be tested on them."""
        return remarks(self)

    @property
    def summary(self) -> tuple[str, ...]:
        """The calibration of the model in sentences."""
        return tuple(summarize(self))

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """Every number, with its interval and definition; computes all that is not computed yet."""
        return tuple(tidy_rows(self))

    @property
    def table(self) -> pd.DataFrame:
        """The rows as a pandas data frame; remarks and signature are in its ``attrs``."""
        table = as_frame(self.rows)
        table.attrs = {"remarks": list(self.remarks), "signature": self.signature}
        return table

    # --- numbers ----------------------------------------------------------------------------------------------

    calibration = curves.calibration
    summary_curve = curves.summary_curve
    curve = curves.curve
    rank_curves = curves.rank_curves
    sparsification, risk_coverage = curves.sparsification, curves.risk_coverage
    event_reliability = curves.event_reliability

    def __getitem__(self, name: str) -> float:
        """Give a number over all poses; see :meth:`value`."""
        return self.value(name)

    def value(self, name: str, group: str | None = None, joint: str | None = None) -> float:
        """Give one number.

        Parameters
        ----------
        name : str
            Of a metric, or of a number beside one, such as ``ece_p``.
        group : str, optional
            ``label=value``; all poses by default.
        joint : str, optional
            A joint; the summary over joints by default.

        Returns
        -------
        float
            The number; NaN where nothing counts.

        Raises
        ------
        PoseDataError
            Where the report has no such number.
        """
        metric, cells = self._find(name, group)
        if joint is not None:
            return float(self._joint_values(name, group)[self._joint(joint)])
        if name in self.auxiliary:
            return self.once(("value", name, group), lambda: auxiliary_number(self, self.auxiliary[name], group))[0]
        return self.once(("value", name, group), lambda: self.totals.value(metric, cells))

    def interval(self, name: str, group: str | None = None, joint: str | None = None) -> tuple[float, float]:
        """Give the 95 % interval of a number over repetitions of the sequences.

        Parameters
        ----------
        name, group, joint
            As for :meth:`value`.

        Returns
        -------
        low, high : float
            Within the possible range; NaN with fewer than three sequences, and for calibration errors, which are never
            below 0 and have a :meth:`test` instead.
        """
        metric, cells = self._find(name, group)
        if name in self.auxiliary or metric.deviation is not None:
            return math.nan, math.nan
        if joint is None:
            value = self.value(name, group)
            both: Interval = self.once(("interval", name, group), lambda: interval(self.totals, metric, cells, value))
            return both.low, both.high
        self._joint_values(name, group)
        low, high = self.once(("intervals", name, group), lambda: joint_intervals(self.totals, metric, cells))
        return float(low[self._joint(joint)]), float(high[self._joint(joint)])

    def test(self, name: str, group: str | None = None) -> Null:
        """Compare a calibration error with those of calibrated samplers, by random signs of entire sequences.

        Parameters
        ----------
        name : str
            A calibration error or a rank test.
        group : str, optional
            ``label=value``; all poses by default.

        Returns
        -------
        Null
            The observed error, mean and 95 % quantile of a calibrated sampler's, p-value and band; NaN p with too few
            sequences.
        """
        metric, cells = self._find(name, group)
        if name in self.auxiliary or metric.deviation is None:
            tested = [name for name, metric in self.metrics.items() if metric.deviation is not None]
            raise PoseDataError(f"test: {name} is no calibration error or rank test. {did_you_mean(name, tested)}")
        return self.once(("test", name, group), lambda: null(self.totals, metric, cells))

    def rank_tests(self) -> dict[str, tuple[Null, float]]:
        """Give each rank test with its p-value, adjusted for their number (Holm)."""
        tests = {name: self.test(name) for name, metric in self.metrics.items() if metric.family == "rank_tests"}
        adjusted = holm([test.p for test in tests.values()])
        return {name: (test, p) for (name, test), p in zip(tests.items(), adjusted, strict=True)}

    def joint_tests(self) -> dict[str, tuple[float, float]]:
        """Test the calibration curve of each joint.

        Returns
        -------
        dict
            By joint: its signed area, and its p-value by random signs of entire sequences, adjusted for the number of
            joints (Holm). Empty without calibration, or with too few sequences.
        """
        metric = self.metrics.get("ece") or self.metrics.get("signed_area")
        if metric is None:
            return {}
        areas = self.calibration().joint_signed_area()
        p = self.once(("joint p",), lambda: joint_p_values(self.totals, metric))
        tested = zip(self.totals.spec.joints, areas.tolist(), holm(p.tolist()), strict=True)
        return {joint: (area, q) for joint, area, q in tested if not math.isnan(q)}

    def scalars(self) -> dict[str, float]:
        """Give the headline metrics over all poses as plain floats by name, for a logger."""
        return {name: float(self[name]) for name in self.headline_metrics}

    def count(self, name: str, group: str | None = None, joint: str | None = None) -> int:
        """Give the number of poses that count in a number: at a joint, or at the joint where most do."""
        metric, cells = self._find(name, group)
        if joint is None:
            row = OCCLUSION.index(str(group).partition("=")[2]) if group in self._occlusion else None
            return self.totals.count(metric.statistic, cells, row)
        counts = self.totals.counts[metric.statistics[-1].name]
        at_joints = (counts if cells is None else counts[cells]).sum(axis=0)
        return int(at_joints[self._joint(joint)] if at_joints.ndim else at_joints)

    def definition(self, name: str, group: str | None = None) -> str:
        """Give the definition of a number, in one line, and why it is NaN where it is."""
        metric, _ = self._find(name, group)
        return definition_of(self, metric, name, group)

    # --- written ----------------------------------------------------------------------------------------------

    def to_dict(self, *, joints: bool = False) -> dict[str, object]:
        """Give the report as plain data, by the JSON schema ``posecal/report/schema.json``; see :meth:`render`."""
        return as_dict(self, joints=joints)

    def render(
        self,
        form: Format = "text",
        *,
        all: bool = False,  # noqa: A002
        joints: bool = False,
        definitions: bool = False,
        width: int = 120,
        colour: bool = False,
        words: Callable[[str], str] = for_python,
    ) -> str:
        """Write the report.

        Parameters
        ----------
        form : str
            ``text``, ``markdown``, ``latex`` (tables for a paper), ``csv`` (rows, remarks) or ``json`` (rows, curves).
        all : bool
            In text, Markdown and LaTeX, show more than the main metrics, and what each is.
        joints, definitions : bool
            In text, Markdown and LaTeX, add the table per joint, and the definition of every number. In JSON,
            ``joints`` adds the calibration curves of groups at each joint.
        width, colour : int and bool
            Of text: columns of the terminal, and whether to use its colours.
        words : callable
            How remarks name options: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.

        Returns
        -------
        str
            Without a final line break.
        """
        if form == "json":
            return as_json(self, words, joints=joints)
        if form == "csv":
            return as_csv(self, words)
        if form not in get_args(Format):
            raise PoseDataError(f"format: {form!r} is not known. {did_you_mean(form, get_args(Format))}")
        how = {"all": all, "joints": joints, "definitions": definitions, "paper": form == "latex"}
        sheet = report_sheet(self, **how, words=words)
        if form == "text":
            return sheet.text(checked_integer(width, "width", 1), colour=colour)
        return sheet.markdown() if form == "markdown" else sheet.latex()

    def __str__(self) -> str:
        return self.render("text")

    def __repr__(self) -> str:
        return short_title(self)

    plot, view, _repr_html_ = notebook.plot, notebook.view, notebook.fragment

    def save(self, path: str | os.PathLike[str], *, gallery: bool = True) -> None:
        """Write sums and gallery, from which any report can be made later; PoseFileError where that can't be."""
        save_totals(self.totals if gallery else replace(self.totals, gallery=None), path)

    def once(self, key: Hashable, compute: Callable[[], T]) -> T:
        """Compute what is not remembered."""
        if key not in self._memory:
            self._memory[key] = compute()
        return cast(T, self._memory[key])

    def _find(self, name: str, group: str | None) -> tuple[Metric, Cells]:
        """Look up a metric, or that of an auxiliary number, and the cells of a group."""
        metrics = self.metrics_in(group)
        key = self.auxiliary[name].metric if is_among(name, self.auxiliary) else name
        if not is_among(key, metrics):
            of, similar = f" of {group}" if group else "", did_you_mean(name, [*metrics, *self.auxiliary])
            absent = (
                "" if is_among(name, self.metrics) else unmeasured(str(name), self.totals.protocol, self.totals.spec)
            )
            raise PoseDataError(f"metric: {name!r} {absent or f'is not in the report{of}. {similar}'}")
        return metrics[key], self.groups[group]

    def _joint_values(self, name: str, group: str | None) -> FloatArray:
        metric, cells = self._find(name, group)
        if name in self.auxiliary or metric.by_joint is None:
            known = [name for name, metric in self.metrics.items() if metric.by_joint is not None]
            raise PoseDataError(f"joint: {name} has no values per joint. {did_you_mean(name, known)}")
        return self.once(("joints", name, group), lambda: self.totals.by_joint(metric, cells))

    def _joint(self, joint: object) -> int:
        known = self.once("joint numbers", lambda: {name: k for k, name in enumerate(self.totals.spec.joints)})
        word = joint if isinstance(joint, str) else ""
        number = known[word] if word in known else find_joint(word, self.totals.spec.joints)
        if number is None:
            raise PoseDataError(f"joint: {joint!r} is not in the report. {did_you_mean(joint, known)}")
        return number
