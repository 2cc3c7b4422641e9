"""Ranges of numeric settings, as annotations of dataclass fields, and their check."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, get_type_hints

from posecal.errors import raise_all

__all__ = ["LARGEST_SEED", "Limit", "check_limits"]

LARGEST_SEED = 2**63 - 1
_LARGEST = 2**31 - 1


@dataclass(frozen=True)
class Limit:
    """The range of a setting, written ``every: Annotated[int, Limit(1)]``.

    Attributes
    ----------
    low, high : float
        Ends of the range, both included. Without ``high`` an integer must fit into 32 bits, and a float be finite.
    words : str
        The range in words, for messages; derived from low and high where not given.
    """

    low: float
    high: float = math.inf
    words: str = ""

    def problem(self, value: float) -> str:
        """Describe what is expected instead of a value; empty where the value is allowed."""
        high = _LARGEST if isinstance(value, int) and math.isinf(self.high) else self.high
        if self.low <= value <= high and math.isfinite(value):
            return ""
        if isinstance(value, int) and value > high:
            return f"at most {high:,}"
        return self.words or (f"{self.low:g} or more" if math.isinf(self.high) else f"{self.low:g} to {self.high:g}")


def check_limits(settings: Any, table: str) -> None:
    """Check settings against the limits of their fields.

    Parameters
    ----------
    settings : dataclass instance
        The settings.
    table : str
        Their name in messages.

    Raises
    ------
    PoseDataError
        Where a number is out of range; all of them in one error.

    Examples
    --------
    >>> from posecal_models.settings import DataConfig  # its fields have limits, and it calls this function
    >>> DataConfig(every=0)
    Traceback (most recent call last):
    posecal.errors.PoseDataError: data.every: 0; expected 1 or more.
    """
    hints = get_type_hints(type(settings), include_extras=True)
    limits = [
        (field.name, getattr(settings, field.name), limit)
        for field in dataclasses.fields(settings)
        for limit in getattr(hints[field.name], "__metadata__", ())
        if isinstance(limit, Limit)
    ]
    raise_all(
        f"{table}.{name}: {value}; expected {expected}."
        for name, value, limit in limits
        if (expected := limit.problem(value))
    )
