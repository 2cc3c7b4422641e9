"""How is a number written? With its unit, and with no more digits than it is worth."""

from __future__ import annotations

import math

__all__ = ["brief_number", "counted", "number", "p_value"]


def number(value: float, unit: str = "") -> str:
    """Write a number: three digits after the point for lengths, five for shares and errors of shares."""
    if math.isnan(value):
        return "–"
    return f"{value:z.3f} {unit}" if unit else f"{value:z.5f}"


def p_value(value: float) -> str:
    """Write a p-value."""
    return "p < 0.001" if value < 0.001 else f"p = {value:.3f}"


def brief_number(value: float, unit: str) -> str:
    """Write a number of a wide table: one digit after the point for lengths, three for shares."""
    return "–" if math.isnan(value) else f"{value:z.1f}" if unit else f"{value:z.3f}"


def counted(number: int, one: str, many: str = "") -> str:
    """Write how many there are of something: ``1 pose``, ``2,000 poses``."""
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"
