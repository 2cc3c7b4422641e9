"""Simulations behind the statistics: each table of docs/evidence.md, and the test that it would fail if untrue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """One table of docs/evidence.md.

    Attributes
    ----------
    name : str
        Between its markers in the page: ``<!-- table: NAME -->`` and ``<!-- end -->``.
    columns : tuple of str
        Headings.
    rows : callable
        From the number of replicates to the rows, each with as many cells as there are columns.
    replicates : int
        As many as the page shows; the tests pass fewer.
    """

    name: str
    columns: tuple[str, ...]
    rows: Callable[[int], list[tuple[str, ...]]]
    replicates: int
