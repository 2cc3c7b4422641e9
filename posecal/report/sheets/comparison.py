"""What is on the sheet of a comparison? Two models with their differences, or more with their ranks."""

from __future__ import annotations

import math

from posecal.engine.metric import Metric
from posecal.report.format import number, p_value
from posecal.report.tables import Sheet, Table
from posecal.stats.comparison import Comparison

__all__ = ["comparison_sheet"]


def comparison_sheet(comparison: Comparison) -> Sheet:
    """Lay out a comparison: two models with their differences, or more with their ranks."""
    metrics = {name: metric for name, metric in comparison.metrics.items() if _compared(metric)}
    names = comparison.names
    if len(names) == 2:
        columns = [("metric", False), *((name, True) for name in names), ("difference", True)]
        columns += [("95 % interval", False), ("p", False), ("better", False)]
        rows = []
        for name, metric in metrics.items():
            found = next(d for d in comparison.differences if d.metric == name)
            digits = 2 if metric.unit else 4
            values = (number(comparison.value(name, model), metric.unit) for model in names)
            sure = "" if math.isnan(found.low) else f"{found.low:+.{digits}f} to {found.high:+.{digits}f}"
            p = "" if math.isnan(found.p) else p_value(found.p)
            rows.append((metric.label, *values, f"{found.value:+.{digits}f}", sure, p, found.better or ""))
    else:
        columns = [("metric", False), *((f"{name} (rank)", True) for name in names)]
        rows = []
        for name, metric in metrics.items():
            cells = []
            for model in names:
                rank = f" ({comparison.rank(name, model)})" if metric.direction != "none" else ""
                cells.append(number(comparison.value(name, model), metric.unit) + rank)
            rows.append((metric.label, *cells))
    first = comparison.totals[0]
    return Sheet(
        f"{' against '.join(names)} · the same M = {first.poses.sum():,} poses, paired by {first.units()}",
        sentences=_said(comparison),
        tables=[Table("Comparison", tuple(columns), rows)],
        footer=f"signature: {first.signature}",
    )


def _compared(metric: Metric) -> bool:
    return metric.headline or metric.family in {"scores", "rank_tests"}


def _said(comparison: Comparison) -> list[str]:
    """What the two axes, accuracy and calibration, say of the models."""
    found = []
    for name in ("min_mpjpe", "ece", "energy_score"):
        if name not in comparison.metrics:
            continue
        label = comparison.metrics[name].label
        winners = [m for m in comparison.names if all(comparison.rank(name, o) > 1 for o in comparison.names if o != m)]
        best = [model for model in winners if comparison.rank(name, model) == 1]
        found.append(f"{label}: {best[0]} is best beyond chance." if best else f"{label}: none is best beyond chance.")
    if "ece" in comparison.metrics and not math.isnan(comparison.feasible()):
        found.append(f"Not miscalibrated beyond chance: {', '.join(comparison.calibrated()) or 'none'}.")
    return found
