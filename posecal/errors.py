"""What went wrong, said so that the reader knows what to do next.

Every message follows one shape::

    <which>: <what is, with numbers>; expected <what should be>. <what to do>

The argument or the file comes first, then the actual value, then an action where there is one.
Independent problems are collected and raised together by ``raise_all``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

__all__ = ["PoseDataError", "PoseFileError", "PosecalError", "raise_all"]


class PosecalError(Exception):
    """Anything that posecal refuses. The message is for the user; the command line prints it as it is."""


class PoseDataError(PosecalError, ValueError):
    """Arrays, options or labels that can't be evaluated."""


class PoseFileError(PosecalError, OSError):
    """A file that can't be read or written."""


def raise_all(problems: Iterable[str], error: type[PosecalError] = PoseDataError) -> None:
    """Raise one error that lists every problem; do nothing where there is none.

    Parameters
    ----------
    problems : iterable of str
        Messages in the shape that the module names.
    error : type
        The class to raise.

    Examples
    --------
    >>> raise_all([])
    >>> raise_all(["truth: 0 poses.", "unit: 'inch'; expected mm, cm or m."])
    Traceback (most recent call last):
    posecal.errors.PoseDataError: 2 problems:
      - truth: 0 poses.
      - unit: 'inch'; expected mm, cm or m.
    """
    found = list(problems)
    if len(found) == 1:
        raise error(found[0])
    if found:
        raise error("\n  - ".join([f"{len(found)} problems:", *found]))


def first_few(items: Sequence[object], few: int = 3) -> str:
    """Name the first few of many, for a message: ``a, b, c and 9 more``."""
    shown = ", ".join(str(item) for item in items[:few])
    return shown if len(items) <= few else f"{shown} and {len(items) - few:,} more"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """End a message with the nearest known word, or with all of them when none is near."""
    known = list(known)
    near = get_close_matches(word, known, n=1)
    return f"Did you mean {near[0]}?" if near else f"Known: {', '.join(known) or 'none'}."
