"""How long will it take? A progress bar for loops, on stderr, on a terminal only."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar

__all__ = ["Track", "all_of", "bar"]

T = TypeVar("T")


class Track(Protocol):
    """What may stand around a loop: gives the items one after the other."""

    def __call__(self, items: Sequence[T], /) -> Iterable[T]:
        """Give every item."""


def all_of(items: Sequence[T], /) -> Iterable[T]:
    """Give every item, and show nothing.

    Parameters
    ----------
    items : sequence
        What to loop over.

    Returns
    -------
    iterable
        The same.

    Examples
    --------
    >>> list(all_of([1, 2]))
    [1, 2]
    """
    return items


def bar(label: str) -> Track:
    """Make a wrapper that shows a bar for the loop.

    Parameters
    ----------
    label : str
        What is being done.

    Returns
    -------
    callable
        A :class:`Track`; silent where stderr is not a terminal.
    """
    from rich.console import Console
    from rich.progress import track

    def shown(items: Sequence[T], /) -> Iterable[T]:
        console = Console(stderr=True)
        return track(items, label, console=console, transient=True, disable=not sys.stderr.isatty())

    return shown
