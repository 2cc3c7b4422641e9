"""Progress bar around a loop, on stderr, on a terminal only."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import TypeVar

__all__ = ["progress_bar"]

T = TypeVar("T")


def progress_bar(items: Sequence[T], label: str) -> Iterable[T]:
    """Iterate over items with a progress bar.

    Parameters
    ----------
    items : sequence
        The items of the loop.
    label : str
        The text beside the bar.

    Returns
    -------
    iterable
        The items; nothing is shown where stderr is not a terminal.

    Examples
    --------
    >>> list(progress_bar([1, 2], "counting"))
    [1, 2]
    """
    if not sys.stderr.isatty():
        return items
    from rich.console import Console
    from rich.progress import track

    return track(items, label, console=Console(stderr=True), transient=True)
