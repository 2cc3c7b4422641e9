"""Remarks of which several become one: the counts of batches and shards add up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from posecal.errors import first_few


@dataclass(frozen=True)
class Count:
    """A number of things, perhaps of all that were looked at.

    Examples
    --------
    >>> str(Count(1, "frame")), str(Count(1200, "hypothesis", "hypotheses")), str(Count(1, "frame", of=20))
    ('1 frame', '1,200 hypotheses', '1 of 20 frames')
    """

    number: int
    one: str
    many: str = ""
    of: int | None = None

    def __add__(self, other: Any) -> Count:
        return replace(self, number=self.number + other.number, of=None if self.of is None else self.of + other.of)

    def __str__(self) -> str:
        is_one = self.number == 1 and self.of is None
        total = "" if self.of is None else f" of {self.of:,}"
        return f"{self.number:,}{total} {self.one if is_one else self.many or f'{self.one}s'}"


@dataclass(frozen=True)
class Example:
    """Text that differs between remarks of one kind; that of the first is kept.

    Attributes
    ----------
    text : str
        The text.
    names : int
        How many things it names; 0 for text that names none.
    more : int
        How many things of the remark it does not name.

    Examples
    --------
    >>> str(Example.of(["a", "b", "c", "d"]) + Example.of(["e", "f"]))
    'a, b, c and 3 more'
    """

    text: str
    names: int = 0
    more: int = 0

    @classmethod
    def of(cls, names: Sequence[object], few: int = 3) -> Example:
        """Name the first few things, and count the others."""
        return cls(first_few(names[:few], few), min(len(names), few), max(0, len(names) - few))

    def __add__(self, other: Any) -> Example:
        return replace(self, more=self.more + (other.names + other.more if self.names else 0))

    def __str__(self) -> str:
        return f"{self.text} and {self.more:,} more" if self.more else self.text


class Remark(str):
    """A sentence of words, counts and examples.

    Parameters
    ----------
    *parts : str, Count or Example
        Two remarks whose words are equal are of one kind.

    Examples
    --------
    >>> batches = (1, "9"), (2, "11")
    >>> lost = [Remark(Count(n, "frame"), " left out (first: ", Example(first), ").") for n, first in batches]
    >>> join_remarks(["few joints", *lost])
    ('few joints', '3 frames left out (first: 9).')
    """

    parts: tuple[str | Count | Example, ...]

    def __new__(cls, *parts: str | Count | Example) -> Remark:
        """Make the text of the parts."""
        remark = super().__new__(cls, "".join(map(str, parts)))
        remark.parts = parts
        return remark

    def __getnewargs__(self) -> tuple[Any, ...]:
        return self.parts

    @property
    def kind(self) -> tuple[object, ...]:
        """What remarks of one kind have in common."""
        return tuple(part if isinstance(part, str) else type(part) for part in self.parts)

    def with_counts(self, other: Remark) -> Remark:
        """Add the counts of another remark of this kind."""
        pairs = zip(self.parts, other.parts, strict=True)
        return Remark(*(a if isinstance(a, str) else a + b for a, b in pairs))

    def with_total(self, number: int) -> Remark:
        """Set of how many frames the counts are."""
        return Remark(*(replace(p, of=number) if isinstance(p, Count) and p.of is not None else p for p in self.parts))


def join_remarks(remarks: Iterable[str], n_frames: int | None = None) -> tuple[str, ...]:
    """Give each remark once, in their order; counts of one kind add up, of so many frames if that is given."""
    found: dict[object, str] = {}
    for remark in remarks:
        if not isinstance(remark, Remark):
            found.setdefault(remark, remark)
            continue
        known = found.get(remark.kind)
        joined = known.with_counts(remark) if isinstance(known, Remark) else remark
        found[remark.kind] = joined if n_frames is None else joined.with_total(n_frames)
    return tuple(found.values())


def remark_as_json(remark: str) -> object:
    """Give a remark as JSON can hold it."""
    if not isinstance(remark, Remark):
        return remark
    return [part if isinstance(part, str) else vars(part) for part in remark.parts]


def remark_of_json(stored: Any) -> str:
    """Read what :func:`remark_as_json` gave."""
    if isinstance(stored, str):
        return stored
    return Remark(*(p if isinstance(p, str) else Example(**p) if "text" in p else Count(**p) for p in stored))
