"""Number formatting for tables and sentences: units and significant digits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posecal.engine.metric import Metric

MISSING = "–"


NONE = math.nan, math.nan


ARROWS = {"lower": "↓", "higher": "↑", "zero": "0", "none": ""}
"""What is best, by the direction of a metric."""

PER_CENT = frozenset(f"{prefix}{name}" for prefix in ("", "pa_", "n_") for name in ("pck", "auc"))
"""Metrics that papers print in per cent."""


def as_printed(metric: Metric) -> tuple[str, str, float]:
    """Give the heading of a metric in a paper, with unit and direction, and the unit and scale that its numbers are in.

    Examples
    --------
    >>> from posecal.registry import metrics_of
    >>> from posecal.engine.protocol import Protocol
    >>> from posecal.engine.scope import DataSpec
    >>> metrics = metrics_of(Protocol(), DataSpec(5, ("Hip", "Knee"), 0))
    >>> as_printed(metrics["min_mpjpe"]), as_printed(metrics["auc"])
    (('minMPJPE [mm] ↓', 'mm', 1.0), ('AUC of PCK [%] ↑', '%', 100.0))
    """
    unit, scale = ("%", 100.0) if metric.name in PER_CENT else (metric.unit, 1.0)
    arrow = ARROWS[metric.direction].replace("0", "")
    return " ".join(filter(None, (metric.label, f"[{unit}]" if unit else "", arrow))), unit, scale


def number(value: float, unit: str = "", interval: tuple[float, float] = NONE) -> str:
    """Write a number with the digits that its interval supports; without one three after the point, five without unit.

    Examples
    --------
    >>> number(77.91234, "mm"), number(77.91234, "mm", (71.2, 85.3)), number(0.0312346), number(float("nan"))
    ('77.912 mm', '78 mm', '0.03123', '–')
    """
    if math.isnan(value):
        return MISSING
    return f"{value:z.{supported_digits(*interval, 3 if unit else 5)}f} {unit}".rstrip()


def supported_digits(low: float, high: float, most: int) -> int:
    """Digits after the point that write the width of an interval to two significant ones, at most so many.

    Examples
    --------
    >>> supported_digits(71.2, 85.3, 3), supported_digits(0.03, 0.04, 5), supported_digits(*NONE, 3)
    (0, 3, 3)
    """
    width = high - low
    return max(0, min(most, 1 - math.floor(math.log10(width)))) if 0 < width < math.inf else most


def short_number(value: float, unit: str = "") -> str:
    """Write a number of a wide table: one digit after the point with a unit, three without.

    Examples
    --------
    >>> short_number(77.91234, "mm"), short_number(0.0312346)
    ('77.9', '0.031')
    """
    return MISSING if math.isnan(value) else f"{value:z.{1 if unit else 3}f}"


def span(low: float, high: float, unit: str = "") -> str:
    """Write an interval with the digits that its width supports; empty where there is none.

    Examples
    --------
    >>> span(77.01, 78.99, "mm"), span(71.2, 85.3, "mm"), span(0.03, 0.041)
    ('77.0 to 79.0', '71 to 85', '0.030 to 0.041')
    """
    digits = supported_digits(low, high, 3 if unit else 5)
    return "" if math.isnan(low) else f"{low:z.{digits}f} to {high:z.{digits}f}"


def p_value(value: float) -> str:
    """Write a p-value for a sentence.

    Examples
    --------
    >>> p_value(0.0005), p_value(0.25)
    ('p < 0.001', 'p = 0.250')
    """
    return "p < 0.001" if value < 0.001 else f"p = {value:.3f}"


def short_p(value: float) -> str:
    """Write a p-value for a table.

    Examples
    --------
    >>> short_p(0.0005), short_p(0.25)
    ('< 0.001', '0.250')
    """
    return p_value(value).removeprefix("p ").removeprefix("= ")


def counted(number: int, one: str, many: str = "") -> str:
    """Write how many there are of something.

    Examples
    --------
    >>> counted(1, "pose"), counted(2000, "pose"), counted(2, "hypothesis", "hypotheses")
    ('1 pose', '2,000 poses', '2 hypotheses')
    """
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def several(names: Sequence[str], most: int = 6) -> str:
    """Name up to so many of a few things, and count the others.

    Examples
    --------
    >>> several(["Head", "Hip", "Neck"]), several(["Head", "Hip", "Neck"], most=2)
    ('Head, Hip and Neck', 'Head, Hip and 1 more')
    """
    if len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return ", ".join(names[:-1]) + (" and " if len(names) > 1 else "") + names[-1]
