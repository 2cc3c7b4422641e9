"""How long will it take? A progress bar around a loop, on stderr, on a terminal only."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import TypeVar

__all__ = ["bar"]

T = TypeVar("T")


def bar(items: Sequence[T], label: str) -> Iterable[T]:
    """Give every item, and show how far one has come.

    Parameters
    ----------
    items : sequence
        What to loop over.
    label : str
        What is being done.

    Returns
    -------
    iterable
        The items; nothing is shown where stderr is not a terminal.

    Examples
    --------
    >>> list(bar([1, 2], "counting"))
    [1, 2]
    """
    if not sys.stderr.isatty():
        return items
    from rich.console import Console
    from rich.progress import track

    return track(items, label, console=Console(stderr=True), transient=True)
