"""Pairs of files of hypotheses and of truth, by what the stars of two patterns stand for."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

from posecal.data.remote import files_of_pattern
from posecal.engine.cells import natural_key
from posecal.errors import PoseDataError, first_few

Star = tuple[str, ...]
"""What the stars of a pattern stand for in the name of a file."""


def is_pattern(source: object) -> bool:
    """Whether this stands for several files."""
    return isinstance(source, str) and "*" in source and not os.path.exists(source)


def pair_files(*patterns: str) -> list[tuple[str, ...]]:
    """Pair the files of several patterns whose stars stand for the same; a name without stars goes with every one.

    Parameters
    ----------
    *patterns : str
        Paths or addresses, of hypotheses first: ``hyps/*.npz`` and ``gt/*.npz``.

    Returns
    -------
    list of tuples of str
        In the natural order of what the stars stand for.

    Raises
    ------
    PoseDataError
        Where no file fits, a file has no partner, or the patterns have other numbers of stars.

    See Also
    --------
    evaluate_shards : which evaluates them as one test set.

    Examples
    --------
    Names without stars are one pair.

    >>> pair_files("hyps.npz", "gt.npz")
    [('hyps.npz', 'gt.npz')]
    """
    found = {pattern: _files(pattern) for pattern in patterns if is_pattern(pattern)}
    if not found:
        return [patterns]
    if len({len(_stars(pattern)) for pattern in found}) > 1:
        counts = " and ".join(f"{pattern} has {len(_stars(pattern))}" for pattern in found)
        raise PoseDataError(f"{counts} stars; expected as many, which stand for the same.")
    every = {star: None for files in found.values() for star in files}
    for pattern, files in found.items():
        lacking = ["-".join(star) for star in every if star not in files]
        if lacking:
            raise PoseDataError(
                f"{pattern}: no file for {len(lacking):,} of {len(every):,} values of the stars (first: "
                f"{first_few(lacking)}); expected one for each file of the other pattern."
            )
    ordered = sorted(every, key=lambda star: [natural_key(part) for part in star])
    return [tuple(found[p][star] if p in found else p for p in patterns) for star in ordered]


def _files(pattern: str) -> dict[Star, str]:
    """Give the files of a pattern, by what its stars stand for."""
    files = files_of_pattern(pattern)
    if not files:
        raise PoseDataError(f"{pattern}: no file; expected some of names like it.")
    parts = re.split(r"(\*+)", _place(pattern))
    words = re.compile(
        "".join(r"([^/\\]*)" if part == "*" else "(.*)" if "*" in part else re.escape(part) for part in parts)
    )
    found: dict[Star, str] = {}
    for file in files:
        match = words.fullmatch(_place(file))
        if match is not None:
            found[match.groups()] = file
    return found


def _place(address: str) -> str:
    """Leave out the protocol, and slashes that some have twice."""
    return address.rpartition("://")[2].lstrip("/")


def _stars(pattern: str) -> Sequence[str]:
    return re.findall(r"\*+", pattern)
