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
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
import numpy.typing as npt

from posecal.block import FloatArray
from posecal.calibration import DEFINITIONS, LEVELS, CalibrationCurve, Definition, OverJoints, perfect_sampler
from posecal.calibration.table import curve_of, summary
from posecal.cells import label_name
from posecal.errors import PoseDataError, did_you_mean
from posecal.metric import Curve, Metric
from posecal.registry import curves_of, metrics_of
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
        self.by = tuple(dict.fromkeys(label_name(entry) for entry in by))
        self.metrics: dict[str, Metric] = metrics_of(totals.protocol, totals.subject)
        self._curves: dict[str, Curve] = curves_of(totals.protocol, totals.subject)
        self.groups: dict[str | None, Cells] = {None: None}
        for label in self.by:
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
        if not totals.sequences:
            found.append("no sequence labels: frames are taken as independent.")
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
        for metric in self.metrics.values():
            if metric.by_joint is not None:
                values = self.totals.by_joint(metric)
                counts = np.broadcast_to(
                    self.totals.counts[metric.by_joint[0].name].sum(axis=0)[: len(values)], values.shape
                )
                for joint, value, poses in zip(self.totals.subject.joints, values, counts, strict=True):
                    if not math.isnan(value):
                        row = self._row(metric, None, None)
                        yield replace(row, joint=joint, value=float(value), poses=int(poses))
        yield from self._floors()

    def _row(self, metric: Metric, group: str | None, cells: Cells) -> Row:
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
        raise PoseDataError(
            f"{metric} (group {group}, joint {joint}) is not in the report. {did_you_mean(metric, known)}"
        )

    def calibration(self, definition: Definition = "exchangeable", group: str | None = None) -> CalibrationCurve:
        """Give the calibration curves of a group of poses.

        Parameters
        ----------
        definition : str
            One of :data:`posecal.calibration.DEFINITIONS`.
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
        name = f"inside_{definition}"
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
            "rows": [{**asdict(row), "value": _or_none(row.value)} for row in self.rows],
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
        """
        if form == "json":
            return json.dumps(self.to_dict(), ensure_ascii=False, indent=1)
        if form == "csv":
            text = io.StringIO()
            writer = csv.DictWriter(text, [field.name for field in fields(Row)], lineterminator="\n")
            writer.writeheader()
            writer.writerows(asdict(row) for row in self.rows)
            return text.getvalue().rstrip("\n")
        from posecal.tables import as_markdown, as_text

        return (as_text if form == "text" else as_markdown)(self, joints=joints, full=definitions)

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


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
