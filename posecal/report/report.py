"""How is an evaluation handed on? As text, Markdown, CSV, JSON, a data frame, or saved sums."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from posecal.calibration import DEFINITIONS, LEVELS
from posecal.data.arrays import FloatArray
from posecal.engine.storage import save_totals
from posecal.errors import PoseDataError, did_you_mean
from posecal.report.findings import Findings
from posecal.report.rows import Row
from posecal.report.sheets import report_sheet

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Format", "Report", "Row"]

Format = Literal["text", "markdown", "csv", "json"]


class Report(Findings):
    """The numbers of an evaluation, with their definitions, and how they are written.

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
                lines += list(zip(self.totals.spec.joints, curve.coverage, strict=True))
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
            "hypotheses": self.totals.spec.n_hypotheses,
            "poses": int(self.totals.poses.sum()),
            "joints": list(self.totals.spec.joints),
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
        save_totals(self.totals, path)


def _plain(row: Row) -> dict[str, object]:
    return {**asdict(row), **{key: _or_none(getattr(row, key)) for key in ("value", "low", "high")}}


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
