"""What is on the sheet of a recalibration? What was fitted, and what it does to held-out sequences."""

from __future__ import annotations

import math

from posecal.data.arrays import FloatArray
from posecal.engine.totals import Totals
from posecal.recalibration.dispersion import SpreadMap
from posecal.recalibration.radius import RadiusMap
from posecal.report.findings import Findings
from posecal.report.format import counted, number
from posecal.report.tables import Sheet, Table

__all__ = ["radius_sheet", "spread_sheet"]


def spread_sheet(found: SpreadMap, judged: tuple[Totals, Totals, list[FloatArray]] | None = None) -> Sheet:
    """Lay out a fitted spread factor, and what it does to held-out sequences."""
    moving = [(joint, factor) for joint, factor in zip(found.joints, found.factors, strict=True) if factor != 1]
    factors = {round(factor, 9) for _, factor in moving}
    words, tables = [], []
    rows: list[tuple[str, ...]]
    if len(factors) == 1:
        words.append(f"Spread factor {moving[0][1]:.4f} for all joints, fitted on {counted(found.poses, 'pose')}.")
    else:
        words.append(f"A spread factor for each of {len(moving)} joints, fitted on {counted(found.poses, 'pose')}.")
        rows = [(joint, f"{factor:.4f}") for joint, factor in moving]
        tables.append(Table("Factors", (("joint", False), ("factor", True)), rows))
    if judged is None:
        words.append("Not judged: --split says what it does to sequences that it was not fitted on.")
    else:
        before, after = Findings(judged[0]), Findings(judged[1])
        names = ("ece", "signed_area", "coverage_50", "coverage_90", "radius_50", "min_mpjpe", "mpjpe")
        rows = [
            (
                before.metrics[name].label,
                number(before.value(name), before.metrics[name].unit),
                number(after.value(name), after.metrics[name].unit),
            )
            for name in names
        ]
        columns = ((f"held out, {len(judged[2])} parts", False), ("before", True), ("after", True))
        tables.append(Table("Held-out sequences", columns, rows))
        cost = after.value("min_mpjpe") - before.value("min_mpjpe")
        if cost > 0:
            words.append(f"It costs {cost:.1f} mm of minMPJPE, which rewards a spread that is too narrow.")
    return Sheet("Recalibrated spread", words, tables)


def radius_sheet(found: RadiusMap, held_out: FloatArray | None = None) -> Sheet:
    """Lay out fitted radii, and the share of held-out truths that they hold."""
    unit = "standard deviations" if found.scaled else "mm"
    columns = [("joint", False), (f"radius, {unit}", True)]
    rows: list[tuple[str, ...]] = []
    for place, (joint, radius) in enumerate(zip(found.joints, found.radii, strict=True)):
        if not math.isnan(radius):
            held = () if held_out is None else (f"{held_out[place]:.3f}",)
            rows.append((joint, f"{radius:.2f}", *held))
    words = [f"Radii about the median that hold {1 - found.alpha:.0%} of the truths of {found.poses:,} poses."]
    if held_out is None:
        words.append("Not judged: --split says how many truths they hold in sequences that they were not fitted on.")
    else:
        columns.append(("held-out coverage", True))
    return Sheet("Conformal radii", words, [Table("Radii", tuple(columns), rows)])
