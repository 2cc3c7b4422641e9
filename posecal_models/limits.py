"""Which numbers may a setting have? Limits that stand beside the fields of a dataclass, and the one check of them."""

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
    """The numbers that a setting may have, written ``views: Annotated[int, Limit(1)]``.

    Attributes
    ----------
    low, high : float
        Both are allowed. Without ``high`` an integer must fit into 32 bits, and a float be finite.
    words : str
        What a message calls them; made from low and high where not given.
    """

    low: float
    high: float = math.inf
    words: str = ""

    def problem(self, value: float) -> str:
        """Say what is expected instead of a value, or nothing where it fits."""
        high = _LARGEST if isinstance(value, int) and math.isinf(self.high) else self.high
        if self.low <= value <= high and math.isfinite(value):
            return ""
        if isinstance(value, int) and value > high:
            return f"at most {high:,}"
        return self.words or (f"{self.low:g} or more" if math.isinf(self.high) else f"{self.low:g} to {self.high:g}")


def check_limits(settings: Any, table: str) -> None:
    """Refuse settings outside the limits that stand beside their fields.

    Parameters
    ----------
    settings : dataclass instance
        Whose fields are checked.
    table : str
        What messages call it.

    Raises
    ------
    PoseDataError
        Where a number is outside; all of them at once.

    Examples
    --------
    >>> from posecal_models.config import DataConfig  # its fields have limits, and it calls this
    >>> DataConfig(views=0)
    Traceback (most recent call last):
    posecal.errors.PoseDataError: data.views: 0; expected 1 or more.
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
