"""Exceptions and the wording of their messages.

Every message follows one shape::

    <which>: <what is, with numbers>; expected <what should be>. <what to do>

The argument or the file comes first, then the actual value, then an action where there is one. Arguments to be changed
are named with :func:`option`, which users of Python read as parameters and those of the command line as flags.
Independent problems are collected and raised together by :func:`raise_all`.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from typing import Any, TypeVar

T = TypeVar("T")

_OPTION = re.compile("\ue000([^\ue001]*)\ue001([^\ue002]*)\ue002")
"""An option in a message: as a parameter and as a flag, between private characters of Unicode."""

_FLAGS = {
    "joints": "--joint-names",
    "shared_joints": "--joints",
    "n_hypotheses": "--hypotheses",
    "reference": "--skill",
    "preranks": "--prerank",
    'metrics="scores"': "--scores",
    'metrics="rank_tests"': "--rank-tests",
}
"""Flags that are called otherwise than their parameters, or than a parameter with a value."""

_PROTOCOL = frozenset(
    (
        *("align", "align_best", "auc", "average", "best", "cps_align", "cps_best", "cps_joints", "cps_unit"),
        *("deviation", "ece_over", "frames", "mode", "pck_best", "pck_joints", "pck_rule", "pck_threshold", "root"),
        *("scale", "velocity"),
    )
)
"""Options of a protocol that have no flag of their own."""


def option(name: str, value: object = None) -> str:
    """Name an option in a message: ``axes="MNKD"`` for Python, ``--axes MNKD`` on the command line.

    Parameters
    ----------
    name : str
        The parameter.
    value : object, optional
        What to set it to.

    Returns
    -------
    str
        To be put into a message; :func:`for_python` and :func:`for_command_line` make words of it.

    Examples
    --------
    >>> for_python(f"Pass {option('truth_axes', 'MDK')}."), for_command_line(f"Pass {option('truth_axes', 'MDK')}.")
    ('Pass truth_axes="MDK".', 'Pass --truth-axes MDK.')
    """
    shown = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
    parameter = name if value is None else f"{name}={shown}"
    word = "" if value is None or value is True else shlex.quote(str(value))
    if parameter in _FLAGS:
        flag = _FLAGS[parameter]
    elif name in _PROTOCOL:
        flag = f"--set {name}={word}" if word else f"--set {name}"
    else:
        flag = f"{_FLAGS.get(name, '--' + name.replace('_', '-'))} {word}".rstrip()
    return f"\ue000{parameter}\ue001{flag}\ue002"


def for_python(text: str) -> str:
    """Write the options in a message as parameters."""
    return _OPTION.sub(r"\1", text)


def for_command_line(text: str) -> str:
    """Write the options in a message as flags."""
    return _OPTION.sub(r"\2", text)


class PosecalError(Exception):
    """Anything that posecal refuses. The message is for the user; the command line prints it as it is."""

    problems: Sequence[str] = ()
    """The messages of which :func:`raise_all` made one."""

    @property
    def message(self) -> str:
        """The message with its options as :func:`option` gives them: to be part of another one, or to be printed."""
        return super().__str__()

    def __str__(self) -> str:
        return for_python(self.message)


class PoseDataError(PosecalError, ValueError):
    """Arrays, options or labels that can't be evaluated."""


class PoseFileError(PosecalError, OSError):
    """A file that can't be read or written."""


def attempt(problems: list[str | PosecalError], function: Callable[..., T], *arguments: Any) -> T | None:
    """Call a function; where it refuses, add that to the problems and give None."""
    try:
        return function(*arguments)
    except PosecalError as error:
        problems.append(error)
        return None


def raise_all(problems: Iterable[str | PosecalError], error: type[PosecalError] = PoseDataError) -> None:
    """Raise one error that lists every problem; do nothing where there is none.

    Parameters
    ----------
    problems : iterable of str or PosecalError
        Messages in the shape that the module names. Where one is of a file, so is the error.
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
    messages: list[str] = []
    for problem in problems:
        messages += [problem] if isinstance(problem, str) else problem.problems or [problem.message]
        error = PoseFileError if isinstance(problem, PoseFileError) else error
    if messages:
        several = "\n  - ".join([f"{len(messages)} problems:", *messages])
        raised = error(messages[0] if len(messages) == 1 else several)
        raised.problems = messages
        raise raised


def first_few(items: Sequence[object], few: int = 3) -> str:
    """Name the first few of many, for a message: ``a, b, c and 9 more``."""
    shown = ", ".join(str(item) for item in items[:few])
    return shown if len(items) <= few else f"{shown} and {len(items) - few:,} more"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """End a message with the nearest known word, or with all of them when none is near."""
    known = list(known)
    near = get_close_matches(word, known, n=1)
    return f"Did you mean {near[0]}?" if near else f"Known: {', '.join(known) or 'none'}."
