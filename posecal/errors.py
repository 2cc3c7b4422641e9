"""Exceptions, the wording of their messages, and text that a terminal can show.

Every message follows one shape::

    <which>: <what is, with numbers>; expected <what should be>. <what to do>

The argument or the file comes first, then the actual value, then an action where there is one. Arguments to be changed
are named with :func:`option`, which users of Python read as parameters and those of the command line as flags.
Independent problems are collected and raised together by :func:`raise_all`.
"""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from numbers import Integral
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

_OPTION = re.compile("\ue000([^\ue001]*)\ue001([^\ue002]*)\ue002")
"""An option in a message: as a parameter and as a flag, between private characters of Unicode."""

_SEPARATORS = re.compile(r"[-_@\s]")
"""Characters that don't count where a misspelt name is compared with the known ones."""

_MOST_NAMED = 12
"""How many known names, and how many problems, a message has at most."""

UNPRINTABLE = re.compile("[\\x00-\\x1f\\x7f-\\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]")
"""Characters that steer a terminal, reorder text, or are no text in UTF-8 or XML."""

_ITEM = "\n  - "
"""The only line break of a message, before each of several problems."""

_LONG_WORD = re.compile(r"(\S{160})\S{100,}(\S{60})")
"""Names that are shortened in a message."""

_FLAGS = {
    "joints": "--joint-names",
    "shared_joints": "--joints",
    "n_hypotheses": "--hypotheses",
    "reference": "--skill",
    "preranks": "--prerank",
    'metrics="scores"': "--scores",
    'metrics="rank_tests"': "--rank-tests",
    "gallery=False": "--no-gallery",
    "by_joint=True": "a Metric made with by_joint=True",
}
"""Flags that are called otherwise than their parameters, or than a parameter with a value."""

_PROTOCOL = frozenset(
    (
        *("align", "align_best", "auc", "auc_range", "average", "best", "cps_align", "cps_best", "cps_joints"),
        *("cps_unit", "deviation", "ece_over", "failure_threshold", "frames", "mm_alone", "mm_threshold", "mode"),
        *("pck_best", "pck_joints", "pck_relative", "pck_rule", "pck_threshold", "root", "scale", "segment"),
        *("single_pose", "trials", "velocity"),
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


def printable(text: str) -> str:
    r"""Write characters that a terminal or a file of text can't show as Python does in a string.

    Examples
    --------
    >>> print(printable(f"RWrist {chr(27)}[31m"))
    RWrist \x1b[31m
    """
    return UNPRINTABLE.sub(lambda match: repr(match[0])[1:-1], text)


class PosecalError(Exception):
    """Anything that posecal refuses. The message is for the user; the command line prints it as it is."""

    problems: Sequence[str] = ()
    """The messages of which :func:`raise_all` made one."""

    @property
    def message(self) -> str:
        """The message with its options as :func:`option` gives them: to be part of another one, or to be printed.

        Names are printable, and the middle of very long ones is left out.
        """
        items = super().__str__().split(_ITEM)[: _MOST_NAMED + 2]
        return _ITEM.join(_LONG_WORD.sub(r"\1…\2", printable(item)) for item in items)

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
        more = len(messages) - _MOST_NAMED
        shown = messages if more <= 0 else [*messages[:_MOST_NAMED], f"{more:,} more."]
        several = _ITEM.join([f"{len(messages)} problems:", *shown])
        raised = error(messages[0] if len(messages) == 1 else several)
        raised.problems = messages
        raise raised


@contextmanager
def refuse_unreadable(
    path: str | os.PathLike[str],
    sentence: str = "can't be read ({}). Was it cut off? Copy it again.",
    name: str | None = None,
) -> Iterator[None]:
    """Turn whatever the reading of a file can raise into a refusal: the file may be of any kind, and damaged anywhere.

    Parameters
    ----------
    path : path
        The file.
    sentence : str
        What the message says of one that is there and can't be read; ``{}`` stands for the reason.
    name : str, optional
        What the message calls it, such as a member of the file; the file's name by default.

    Raises
    ------
    PoseFileError
        For anything that is not refused already.
    """
    try:
        yield
    except PosecalError:
        raise
    except FileNotFoundError:
        raise PoseFileError(f"{path}: no such file.") from None
    except IsADirectoryError:
        raise PoseFileError(f"{path}: is a folder; expected a file.") from None
    except OSError as error:
        if error.strerror is None:
            raise PoseFileError(f"{name or Path(path).name}: {sentence.format(reason(error))}") from None
        raise PoseFileError(f"{path}: can't be read ({error.strerror}).") from None
    except Exception as error:  # noqa: BLE001 (zipfile, zlib, tokenize, NumPy, … each raise what they like)
        raise PoseFileError(f"{name or Path(path).name}: {sentence.format(reason(error))}") from None


def reason(error: BaseException) -> str:
    """Describe in some words what a library raised."""
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    words = " ".join(str(error).split())
    return (words if len(words) <= 200 else f"{words[:199]}…") or "it is cut off or damaged"


def checked_type(value: object, name: str, kind: type[T]) -> T:
    """Give a value that is of a class.

    Parameters
    ----------
    value : object
        What was passed.
    name : str
        What messages call it.
    kind : type
        The class.

    Returns
    -------
    object
        The same value.

    Raises
    ------
    PoseDataError
        For a value of another class.
    """
    if not isinstance(value, kind):
        raise PoseDataError(f"{name}: {type(value).__name__}; expected {kind.__name__}.")
    return value


def checked_integer(value: object, name: str, least: int) -> int:
    """Give a whole number that is not too small.

    Parameters
    ----------
    value : object
        What was passed.
    name : str
        What messages call it.
    least : int
        The smallest that is allowed.

    Returns
    -------
    int
        The number.

    Raises
    ------
    PoseDataError
        For anything else.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise PoseDataError(f"{name}: {value!r}; expected a whole number, at least {least}.")
    return int(value)


def first_few(items: Sequence[object], few: int = 3) -> str:
    """Name the first few of many, for a message: ``a, b, c and 9 more``."""
    shown = ", ".join(str(item) for item in items[:few])
    return shown if len(items) <= few else f"{shown} and {len(items) - few:,} more"


def is_among(word: object, known: Container[object]) -> bool:
    """Whether a word, or None, is known; nothing else is, hashable or not."""
    return (word is None or isinstance(word, str)) and word in known


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """End a message with the nearest known word, or with the known ones when none is near.

    Case and the characters ``_``, ``-``, ``@`` and space don't count. More than twelve words are sorted and cut.

    Examples
    --------
    >>> did_you_mean("minMPJPE", ["ece", "min_mpjpe"]), did_you_mean("x", ["ece", "min_mpjpe"])
    ('Did you mean min_mpjpe?', 'Known: ece, min_mpjpe.')
    """
    known = list(known)
    plain = {_SEPARATORS.sub("", name).lower(): name for name in sorted(known, reverse=True)}
    near = get_close_matches(_SEPARATORS.sub("", str(word)).lower(), plain, n=1)
    if near:
        return f"Did you mean {plain[near[0]]}?"
    if len(known) > _MOST_NAMED:
        return f"Known: {', '.join(sorted(known)[:_MOST_NAMED])}, …, and {len(known) - _MOST_NAMED} more."
    return f"Known: {', '.join(known) or 'none'}."
