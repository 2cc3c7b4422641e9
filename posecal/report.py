"""What does an evaluation say? Tidy rows, each with its definition, and a signature.

A :class:`Report` reads sums (:class:`posecal.totals.Totals`) and computes what is asked of it: rows, curves, and
their renderings as text, Markdown, CSV and JSON.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, cast, get_args

import numpy as np
import numpy.typing as npt

from posecal.block import FloatArray
from posecal.calibration import (
    DEFINITIONS,
    LEVELS,
    CalibrationCurve,
    Definition,
    OverJoints,
    perfect_sampler,
    signed_area,
)
from posecal.calibration.ranks import known_definition
from posecal.calibration.table import curve_of, summary
from posecal.cells import label_name
from posecal.errors import PoseDataError, did_you_mean
from posecal.inference import FEWEST, Null, holm
from posecal.metric import Curve, Metric
from posecal.metrics.guide import sparsification
from posecal.metrics.score_table import Reliability, reliability_of_counts
from posecal.registry import curves_of, metrics_of, sights_of
from posecal.sureness import independent_poses, interval, joint_null, null, unbiased_squared_error
from posecal.totals import Totals

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Format", "Report", "Row"]

Format = Literal["text", "markdown", "csv", "json"]
Cells = npt.NDArray[np.bool_] | None


@dataclass(frozen=True)
class Row:
    """One reported number.

    Attributes
    ----------
    metric : str
        Name in snake case.
    label : str
        Name for people.
    group : str or None
        The poses it is over, as ``label=value``; None for all.
    joint : str or None
        The joint it is about; None for the summary over joints.
    value : float
        The number; NaN where nothing counts.
    unit : str
        ``mm``, ``mm/frame``, ``mm/s`` or empty.
    direction : str
        ``lower`` or ``higher`` is better, ``zero`` is best, or ``none``.
    definition : str
        What it is, in one line.
    poses : int
        How many poses count in it.
    low, high : float
        A 95 % interval over repetitions of the sequences; NaN where there is none. Calibration errors have none: for
        them the rows ``…_null``, ``…_null_95`` and ``…_p`` say what a calibrated sampler would show.
    """

    metric: str
    label: str
    group: str | None
    joint: str | None
    value: float
    unit: str
    direction: str
    definition: str
    poses: int
    low: float = math.nan
    high: float = math.nan


class Report:
    """The numbers of an evaluation, with their definitions.

    Parameters
    ----------
    totals : Totals
        The sums.
    by : sequence of str
        Labels to group by, beside the numbers over all poses.

    Raises
    ------
    PoseDataError
        For a label that the sums don't hold.
    """

    def __init__(self, totals: Totals, by: Sequence[str] = ()) -> None:
        self.totals = totals
        self.by = tuple(dict.fromkeys(label_name(entry) for entry in ((by,) if isinstance(by, str) else by)))
        self.metrics: dict[str, Metric] = metrics_of(totals.protocol, totals.subject)
        self._curves: dict[str, Curve] = curves_of(totals.protocol, totals.subject)
        self.groups: dict[str | None, Cells] = {None: None}
        self._nulls: dict[tuple[str, str | None], Null] = {}
        self.sights: dict[str, dict[str, Metric]] = {}
        for label in self.by:
            if label == "sight":
                self.sights = sights_of(totals.protocol, totals.subject)
            else:
                self.groups |= {f"{label}={value}": cells for value, cells in totals.groups(label)}

    # --- numbers ----------------------------------------------------------------------------------------------

    @property
    def signature(self) -> str:
        """One line that tells whether two reports can be compared: only if it is the same."""
        return self.totals.signature

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a careful reader should know about the data."""
        totals, found = self.totals, list(self.totals.remarks)
        sequences = len(set(totals.cells["sequence"].tolist()))
        if not totals.sequences:
            found.append("no sequence labels: frames are taken as independent. In a video they are not.")
        elif sequences < FEWEST:
            found.append(
                f"{sequences} sequences allow no test: even if all of them err alike, chance would do that in "
                f"{2 / 2**sequences:.0%} of cases. At least {FEWEST} are needed for a p-value."
            )
        n = totals.subject.n_hypotheses
        if n < 2:
            found.append("calibration and spread need at least 2 hypotheses; there is 1.")
        elif n < 20 and any(metric.family == "calibration" for metric in self.metrics.values()):
            found.append(
                f"N = {n} hypotheses are few: look at what a perfect sampler would show before reading an ECE (paper)."
            )
        return tuple(found)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """All numbers: over all poses, per joint, and per group."""
        return tuple(self._all_rows())

    def _all_rows(self) -> Iterator[Row]:
        for group, cells in self.groups.items():
            for metric in self.metrics.values():
                yield self._row(metric, group, cells)
        for sight, metrics in self.sights.items():
            for metric in metrics.values():
                yield self._row(metric, f"sight={sight}", None)
        for metric in self.metrics.values():
            if metric.by_joint is not None:
                values = self.totals.by_joint(metric)
                whole = replace(self._row(metric, None, None), low=math.nan, high=math.nan)
                counts = np.broadcast_to(
                    self.totals.counts[metric.by_joint[0].name].sum(axis=0)[: len(values)], values.shape
                )
                for joint, value, poses in zip(self.totals.subject.joints, values, counts, strict=True):
                    if not math.isnan(value):
                        yield replace(whole, joint=joint, value=float(value), poses=int(poses))
        yield from self._floors()
        yield from self._tests()
        yield from self._worth()

    def _row(self, metric: Metric, group: str | None, cells: Cells) -> Row:
        sure = None if metric.deviation is not None else interval(self.totals, metric, cells)
        return Row(
            metric=metric.name,
            label=metric.label,
            group=group,
            joint=None,
            value=self.totals.value(metric, cells),
            unit=metric.unit,
            direction=metric.direction,
            definition=metric.definition,
            poses=self.totals.count(metric.statistic, cells),
            low=math.nan if sure is None else sure.low,
            high=math.nan if sure is None else sure.high,
        )

    def _floors(self) -> Iterator[Row]:
        """What a perfect sampler's ECE would be with this N, M and K, for each ECE that is reported."""
        for definition in DEFINITIONS:
            name = "ece" if definition == "exchangeable" else f"ece_{definition}"
            if name not in self.metrics:
                continue
            metric = self.metrics[name]
            counts = self.totals.counts[metric.statistic.name].sum(axis=0)[:-1]
            poses, joints = int(counts.max(initial=0)), int((counts > 0).sum())
            if not poses:
                continue
            over = cast(OverJoints, self.totals.protocol.summary_over_joints)
            n = self.totals.subject.n_hypotheses
            floor = perfect_sampler(n, poses, joints, definition, over)
            about = (
                f"N={n}, {poses:,} independent poses and {joints} independent joints (more where they are correlated)"
            )
            for ending, words, value in (
                ("", "expected", floor.mean),
                ("_95", "95 % quantile of the", floor.high),
            ):
                yield replace(
                    self._row(metric, None, None),
                    metric=f"{name}_floor{ending}",
                    label=f"{metric.label} of a perfect sampler{', 95 %' if ending else ''}",
                    value=value,
                    direction="none",
                    definition=f"{words} {metric.label} of a perfect sampler: {about}; {definition} definition",
                )

    def definition(self, metric: str) -> str:
        """Give the definition of a metric.

        Raises
        ------
        PoseDataError
            Where it is not in the report.
        """
        if metric not in self.metrics:
            raise PoseDataError(f"{metric} is not in the report. {did_you_mean(metric, self.metrics)}")
        return self.metrics[metric].definition

    def null(self, metric: str, group: str | None = None) -> Null:
        """Give what a calibrated sampler would show for a calibration error, by sequence sign-flips.

        Parameters
        ----------
        metric : str
            The name of a calibration error or of a test of the battery.
        group : str, optional
            ``label=value``; all poses by default.

        Returns
        -------
        Null
            With NaN p where there are too few sequences.

        Raises
        ------
        PoseDataError
            Where the report has no such error.
        """
        found = self.metrics.get(metric)
        if found is None or found.deviation is None or group not in self.groups:
            known = [name for name, metric in self.metrics.items() if metric.deviation is not None]
            raise PoseDataError(f"{metric} (group {group}) is no calibration error here. {did_you_mean(metric, known)}")
        key = metric, group
        if key not in self._nulls:
            self._nulls[key] = null(self.totals, found, self.groups[group])
        return self._nulls[key]

    def joint_tests(self) -> dict[str, tuple[float, float]]:
        """Test each joint's own calibration curve.

        Returns
        -------
        dict
            By joint: its signed area, and its p-value by sequence sign-flips, adjusted for the number of joints
            (Holm). Empty without calibration, or with too few sequences.
        """
        metric = self.metrics.get("ece") or self.metrics.get("signed_area")
        if metric is None or metric.by_joint is None:
            return {}
        areas = signed_area(self.totals.mean(metric.statistic)[:-1])
        scored = [k for k, area in enumerate(areas) if not np.isnan(area)]
        adjusted = holm([joint_null(self.totals, metric, k).p for k in scored])
        joints = self.totals.subject.joints
        return {joints[k]: (float(areas[k]), p) for k, p in zip(scored, adjusted, strict=True) if not math.isnan(p)}

    def battery(self) -> dict[str, tuple[Null, float]]:
        """Give the tests of the battery: what each shows, and its p-value adjusted for their number (Holm)."""
        names = [name for name, metric in self.metrics.items() if metric.family == "battery"]
        nulls = [self.null(name) for name in names]
        adjusted = holm([null.p for null in nulls])
        return {name: (null, p) for name, null, p in zip(names, nulls, adjusted, strict=True)}

    def _tests(self) -> Iterator[Row]:
        """What a calibrated sampler would show for each calibration error, and the p-value."""
        how = "random signs of whole sequences"
        for name, metric in self.metrics.items():
            if metric.deviation is None:
                continue
            found = self.null(name)
            words = (
                ("null", "of a calibrated sampler", found.mean, f"mean of {metric.label} over {how}"),
                ("null_95", "of a calibrated sampler, 95 %", found.high, f"95 % quantile of {metric.label} over {how}"),
                (
                    "p",
                    "p-value",
                    found.p,
                    f"share of {how} that make {metric.label} as large; {found.sequences} sequences",
                ),
            )
            for ending, label, value, definition in words:
                yield replace(
                    self._row(metric, None, None),
                    metric=f"{name}_{ending}",
                    label=f"{metric.label}, {label}",
                    value=value,
                    direction="none",
                    definition=definition,
                )

    def _worth(self) -> Iterator[Row]:
        """How many independent poses these are worth, and the squared error without what chance adds."""
        metric = self.metrics.get("ece")
        if metric is None:
            return
        statistic = metric.statistic
        row = self._row(metric, None, None)
        yield replace(
            row,
            metric="effective_poses",
            label="effective number of poses",
            value=independent_poses(self.totals, statistic),
            direction="none",
            definition="independent poses whose calibration curves would vary as much as those of the sequences do",
        )
        yield replace(
            row,
            metric="squared_error",
            label="squared error of the curves, unbiased",
            value=unbiased_squared_error(self.totals, statistic),
            direction="lower",
            definition="mean over joints and q of (ω_k(q) − q)² − its variance over sequences; exchangeable definition",
        )

    def value(self, metric: str, group: str | None = None, joint: str | None = None) -> float:
        """Give one number.

        Parameters
        ----------
        metric : str
            Its name.
        group : str, optional
            ``label=value``; all poses by default.
        joint : str, optional
            A joint; the summary over joints by default.

        Returns
        -------
        float
            The number.

        Raises
        ------
        PoseDataError
            Where the report has no such number.
        """
        for row in self.rows:
            if (row.metric, row.group, row.joint) == (metric, group, joint):
                return row.value
        known = sorted({row.metric for row in self.rows})
        where = "".join(f" {word} {said}" for word, said in (("of", group), ("at", joint)) if said is not None)
        raise PoseDataError(f"{metric}{where} is not in the report. {did_you_mean(metric, known)}")

    def calibration(self, definition: Definition = "exchangeable", group: str | None = None) -> CalibrationCurve:
        """Give the calibration curves of a group of poses.

        Parameters
        ----------
        definition : str
            One of :data:`posecal.calibration.ranks.DEFINITIONS`.
        group : str, optional
            ``label=value``; all poses by default.

        Returns
        -------
        CalibrationCurve
            A curve per joint; NaN for joints that don't count.

        Raises
        ------
        PoseDataError
            Where the report has no such curves.
        """
        name = f"inside_{known_definition(definition)}"
        if name not in self.totals.sums or group not in self.groups:
            raise PoseDataError(f"calibration: the report has no {definition} curves of {group or 'its poses'}.")
        return curve_of(self._mean(name, self.groups[group]), definition)

    def summary_curve(self, definition: Definition = "exchangeable", group: str | None = None) -> FloatArray:
        """Give the one curve (Q,) that stands for all joints: the one that the ECE is made from."""
        curve = self.calibration(definition, group)
        over = cast(OverJoints, self.totals.protocol.summary_over_joints)
        return summary(np.concatenate([curve.coverage, curve.pooled[None]]), over)

    def curve(self, name: str) -> tuple[Curve, FloatArray]:
        """Give a curve and its values.

        Parameters
        ----------
        name : str
            ``errors_by_n``, ``pck_curve`` or ``cps_curve``.

        Returns
        -------
        tuple of Curve and array (T,)
            What it is, and its values.

        Raises
        ------
        PoseDataError
            Where the report has no such curve.
        """
        if name not in self._curves or name not in self.totals.sums:
            raise PoseDataError(f"curve: {name!r} is not in the report; it holds {', '.join(self.totals.sums)}.")
        curve = self._curves[name]
        return curve, self.totals.mean(curve.statistic)

    def rank_curves(self, test: str) -> FloatArray:
        """Give the curves of a test of the battery, (R, Q): one, or one per coordinate.

        Raises
        ------
        PoseDataError
            Where the report has no such test.
        """
        if test not in self.metrics or self.metrics[test].family != "battery":
            known = [name for name, metric in self.metrics.items() if metric.family == "battery"]
            raise PoseDataError(f"{test} is no test in the report. {did_you_mean(test, known)}")
        curves = self.totals.mean(self.metrics[test].statistic).reshape(-1, LEVELS.size)
        return curves[~np.isnan(curves).any(axis=1)]

    def sparsification(self) -> tuple[FloatArray, FloatArray]:
        """Give the mean error left when poses are dropped, by spread and by error; see :mod:`posecal.metrics.guide`.

        Raises
        ------
        PoseDataError
            Where the report kept no spreads and errors.
        """
        if "spread_and_error" not in self.totals.kept:
            raise PoseDataError(
                "sparsification: the report kept no spreads and errors; they are among the default metrics."
            )
        kept = self.totals.kept["spread_and_error"]
        return sparsification(kept[:, 0], kept[:, 1])

    def event_reliability(self) -> Reliability:
        """Give the isotonic reliability of the event that the median pose is right at every joint.

        Raises
        ------
        PoseDataError
            Where the report has no Brier score.
        """
        if "brier_miscalibration" not in self.metrics:
            raise PoseDataError("event: the report has no Brier score. Evaluate with --scores.")
        return reliability_of_counts(self.totals.mean(self.metrics["brier_miscalibration"].statistic))

    def _mean(self, name: str, cells: Cells) -> FloatArray:
        statistic = next(s for metric in self.metrics.values() for s in metric.statistics if s.name == name)
        return self.totals.mean(statistic, cells)

    # --- renderings -------------------------------------------------------------------------------------------

    def frame(self) -> pd.DataFrame:
        """Give the rows as a pandas data frame."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self.rows], columns=[field.name for field in fields(Row)])

    def to_dict(self) -> dict[str, object]:
        """Give the report as plain data, in the documented schema of its JSON."""
        curves = []
        for definition in DEFINITIONS:
            if f"inside_{definition}" not in {s.name for metric in self.metrics.values() for s in metric.statistics}:
                continue
            for group in self.groups:
                curve = self.calibration(definition, group)
                lines: list[tuple[str | None, FloatArray]] = [(None, self.summary_curve(definition, group))]
                lines += list(zip(self.totals.subject.joints, curve.coverage, strict=True))
                curves += [
                    {
                        "definition": definition,
                        "group": group,
                        "joint": joint,
                        "levels": LEVELS.tolist(),
                        "coverage": [_or_none(value) for value in values],
                    }
                    for joint, values in lines
                    if not np.isnan(values).all()
                ]
        return {
            "posecal": self.totals.version,
            "signature": self.signature,
            "hypotheses": self.totals.subject.n_hypotheses,
            "poses": int(self.totals.poses.sum()),
            "joints": list(self.totals.subject.joints),
            "rows": [_plain(row) for row in self.rows],
            "curves": curves,
        }

    def render(self, form: Format = "text", *, joints: bool = False, definitions: bool = False) -> str:
        """Write the report as text.

        Parameters
        ----------
        form : str
            ``text``, ``markdown``, ``csv`` (the tidy rows) or ``json`` (rows and curves).
        joints : bool
            In text and Markdown, add the table per joint.
        definitions : bool
            In text and Markdown, add the full definition of every number.

        Returns
        -------
        str
            The whole text.

        Raises
        ------
        PoseDataError
            For another form.
        """
        if form == "json":
            return json.dumps(self.to_dict(), ensure_ascii=False, indent=1)
        if form == "csv":
            text = io.StringIO()
            writer = csv.DictWriter(text, [field.name for field in fields(Row)], lineterminator="\n")
            writer.writeheader()
            writer.writerows(asdict(row) for row in self.rows)
            return text.getvalue().rstrip("\n")
        if form not in get_args(Format):
            raise PoseDataError(f"format: {form!r} is not known. {did_you_mean(form, get_args(Format))}")
        from posecal.sheets import report_sheet

        sheet = report_sheet(self, joints=joints, definitions=definitions)
        return sheet.text() if form == "text" else sheet.markdown()

    def __str__(self) -> str:
        return self.render("text")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Keep the sums in a file, from which any report can be made later.

        Raises
        ------
        PoseFileError
            Where the file can't be written.
        """
        self.totals.save(path)


def _plain(row: Row) -> dict[str, object]:
    return {**asdict(row), **{key: _or_none(getattr(row, key)) for key in ("value", "low", "high")}}


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
