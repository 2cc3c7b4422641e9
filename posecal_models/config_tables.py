"""Parsed TOML as dataclasses of settings, with all problems together."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from posecal.errors import PoseDataError, did_you_mean

__all__ = ["from_table"]

_T = TypeVar("_T")


def from_table(cls: type[_T], table: dict[str, Any], prefix: str, problems: list[str]) -> _T | None:
    """Build a dataclass of settings, and those within it, from nested tables.

    Parameters
    ----------
    cls : type
        A dataclass.
    table : dict
        Settings by name.
    prefix : str
        What stands before their names in messages, such as ``train.``.
    problems : list of str
        Unknown names and invalid values are added here.

    Returns
    -------
    object or None
        With defaults for settings that are not given; None where there is a problem.
    """
    hints = get_type_hints(cls)
    values: dict[str, Any] = {}
    before = len(problems)
    for name, value in table.items():
        where = f"{prefix}{name}"
        if name not in hints:
            problems.append(f"config: {where} is not known. {did_you_mean(name, hints)}")
        elif dataclasses.is_dataclass(hints[name]):
            if isinstance(value, dict):
                values[name] = from_table(hints[name], value, f"{where}.", problems)
            else:
                problems.append(f"config: {where} is {value!r}; expected a table.")
        else:
            values[name] = _value(hints[name], value, where, problems)
    if len(problems) > before:
        return None
    try:
        return cls(**values)
    except PoseDataError as problem:
        problems.append(f"config: {problem}")
        return None


def _value(hint: Any, value: Any, where: str, problems: list[str]) -> Any:
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            problems.append(f"config: {where} is {value!r}; expected one of {', '.join(get_args(hint))}.")
        return value
    if get_origin(hint) is tuple:
        if not isinstance(value, (list, tuple)) or not all(isinstance(item, str) for item in value):
            problems.append(f"config: {where} is {value!r}; expected a list of names.")
            return ()
        return tuple(value)
    # integers beyond the range of a float are refused
    number = isinstance(value, float) or (type(value) is int and abs(value) < 2**1000)
    fits = number if hint is float else type(value) is hint
    if not fits:
        problems.append(f"config: {where} is {value!r}; expected {hint.__name__}.")
    return float(value) if hint is float and number else value
