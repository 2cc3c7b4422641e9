"""Layouts of stored arrays: which axis is which, turned into (N, M, K, D) once and lazily.

A layout is a word of letters, one per axis, outermost first:

=======  ==========================================================================================
letter   axis
=======  ==========================================================================================
``N``    hypotheses
``M``    poses (frames, or clips where there is a ``T``)
``T``    frames of a clip; clips and their frames together are the poses
``K``    joints
``D``    coordinates
``C``    coordinates with a confidence after them, which is left out
``I``    iterations of a sampler, of which the last counts
``(…)``  several axes flattened into one, such as ``(KD)`` or ``(DK)``
=======  ==========================================================================================

A layout without ``N`` holds one prediction of each pose, one without ``D`` a single coordinate of each joint.

Axes are declared and never guessed: where the numbers of hypotheses and of poses agree, a guess is a wrong number.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError

F = TypeVar("F", bound=np.generic)

HYPOTHESES, TRUTH = "NMKD", "MKD"
"""The paper's layouts."""

_COMMON = ("NMKD", "MNKD", "MKND", "NMDK", "MNDK", "MKDN", "MDKN")


class LazyArray(Protocol):
    """An array with a shape and a dtype that is read part by part."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of every axis."""

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """The type of its numbers."""

    def part(self, where: tuple[slice, ...]) -> npt.NDArray[np.generic]:
        """Read a range, ``slice(start, stop)``, of every axis."""


@dataclass(frozen=True)
class MemoryArray:
    """An array in memory, as a :class:`LazyArray`.

    Attributes
    ----------
    array : array
        The array itself.
    """

    array: npt.NDArray[np.generic]

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of every axis."""
        return self.array.shape

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """The type of its numbers."""
        return self.array.dtype

    def part(self, where: tuple[slice, ...]) -> npt.NDArray[np.generic]:
        """Give a view of a range of every axis."""
        return self.array[where]


@dataclass(frozen=True)
class Layout:
    """A declared order of axes.

    Attributes
    ----------
    text : str
        Such as ``NMKD``, ``MKND``, ``MN(DK)``, ``NMKC`` or ``MKD`` (of hypotheses: one of each pose).
    core : str
        The letters that it must have, ``NMKD`` for hypotheses and ``MKD`` for the truth.
    coordinates : int
        D, for splitting ``(KD)``.

    Raises
    ------
    PoseDataError
        For letters that are missing, repeated or not known.

    Examples
    --------
    >>> Layout("MN(DK)", "NMKD").sizes((7, 5, 51))
    {'M': 7, 'N': 5, 'D': 3, 'K': 17}
    >>> Layout("MKC", "NMKD").shape((7, 17, 4))
    (1, 7, 17, 3)
    >>> Layout("NKD", "NMKD")
    Traceback (most recent call last):
    posecal.errors.PoseDataError: axes: 'NKD' lacks M; expected each letter of NMKD once, such as MNKD or MN(DK).
    """

    text: str
    core: str
    coordinates: int = 3

    def __post_init__(self) -> None:
        text = str(self.text)
        letters = re.sub(r"[()]", "", text)
        missing = [letter for letter in self.core if letter not in letters]
        missing = missing if {"M", "K"} & {*missing} else []
        unknown = [letter for letter in letters if letter not in self.core + "TIC"]
        repeated = len(set(letters)) < len(letters) or {"C", "D"} <= set(letters)
        grouped = re.fullmatch(r"(?:[A-Z]|\([A-Z]+\))+", text) and re.search(r"\([^)]*[NMTIC]", text) is None
        if missing or unknown or repeated or not grouped:
            what = f"lacks {', '.join(missing)}" if missing else "is no layout"
            other = "MNKD or MN(DK)" if "N" in self.core else "MDK or M(DK)"
            raise PoseDataError(
                f"axes: {self.text!r} {what}; expected each letter of {self.core} once, such as {other}."
            )

    @cached_property
    def groups(self) -> list[str]:
        """The letters of each stored axis."""
        return [group.strip("()") for group in re.findall(r"[A-Z]|\([A-Z]+\)", self.text)]

    def sizes(self, shape: tuple[int, ...]) -> dict[str, int]:
        """Give the length of each lettered axis of a stored array.

        Raises
        ------
        PoseDataError
            Where the shape does not fit the layout.
        """
        lengths: dict[str, int] = {}
        if len(shape) != len(self.groups):
            raise PoseDataError(
                f"axes: {self.text} names {len(self.groups)} axes; the array has {len(shape)}: {shape}."
            )
        for group, length in zip(self.groups, shape, strict=True):
            if len(group) == 1:
                lengths[group] = length
            elif length % self.coordinates:
                raise PoseDataError(
                    f"axes: ({group}) has length {length}; expected a multiple of {self.coordinates} coordinates."
                )
            else:
                known = {"D": self.coordinates, "K": length // self.coordinates}
                lengths.update({letter: known[letter] for letter in group})
        if "C" in lengths:
            lengths["D"] = lengths.pop("C") - 1
        return {**{letter: 1 for letter in self.core if letter not in lengths}, **lengths}

    def shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Give the shape in the paper's layout, clips and frames joined."""
        sizes = self.sizes(shape)
        sizes["M"] *= sizes.get("T", 1)
        return tuple(sizes[letter] for letter in self.core)

    def without(self, *letters: str) -> str:
        """Give the layout's text without some axes: what the truth's is when it is stored as the hypotheses are."""
        return "".join(letter for letter in self.text if letter not in letters)

    def clip_length(self, shape: tuple[int, ...]) -> int | None:
        """Give T, None where the layout has no clips."""
        return self.sizes(shape).get("T")

    def read(self, array: LazyArray, poses: npt.NDArray[np.intp]) -> npt.NDArray[np.generic]:
        """Read some poses of a stored array, in the paper's layout, and nothing else of it.

        Parameters
        ----------
        array : LazyArray
            As stored.
        poses : array of int (m,)
            Their numbers, counted through the clips; at least one.

        Returns
        -------
        array (N, m, K, D) or (m, K, D)
            A view of an array in memory where the poses are consecutive frames of one clip, else a copy.
        """
        sizes = self.sizes(array.shape)
        frames = sizes.get("T", sizes["M"])
        ends = np.flatnonzero((np.diff(poses) != 1) | (poses[1:] % frames == 0)) + 1
        if not len(ends):
            return self._consecutive(array, sizes, int(poses[0]), len(poses))
        runs = [self._consecutive(array, sizes, int(run[0]), len(run)) for run in np.split(poses, ends)]
        return np.concatenate(runs, axis=self.core.index("M"))

    def store(self, array: npt.NDArray[F], clip_length: int | None = None) -> npt.NDArray[F]:
        """Give an array (N, M, K, D) or (M, K, D) in this layout, as :meth:`read` reads it, without iterations.

        Parameters
        ----------
        array : array (N, M, K, D) or (M, K, D)
            In the paper's layout.
        clip_length : int, optional
            T, where the layout has clips.

        Examples
        --------
        >>> Layout("M(KD)", "MKD").store(np.ones((7, 17, 3))).shape
        (7, 51)
        """
        sizes = dict(zip(self.core, array.shape, strict=True))
        order = self.core
        if clip_length is not None:
            order = order.replace("M", "MT")
            sizes |= {"M": sizes["M"] // clip_length, "T": clip_length}
        groups = [group.replace("C", "D") for group in self.groups if group != "I"]
        order = "".join(letter for letter in order if letter in "".join(groups))
        split = array.reshape([sizes[letter] for letter in order])
        moved = split.transpose([order.index(letter) for letter in "".join(groups)])
        return moved.reshape([math.prod(sizes[letter] for letter in group) for group in groups])

    def _consecutive(self, array: LazyArray, sizes: dict[str, int], first: int, number: int) -> npt.NDArray[np.generic]:
        """Read consecutive frames of one clip, or consecutive poses where there are no clips."""
        frame = "T" if "T" in sizes else "M"
        clip, start = divmod(first, sizes[frame])
        chosen = {"I": slice(sizes.get("I", 1) - 1, sizes.get("I", 1)), "M": slice(clip, clip + 1)}
        chosen[frame] = slice(start, start + number)
        chosen["C"] = slice(0, sizes["D"])
        some = array.part(
            tuple(chosen.get(group, slice(0, size)) for group, size in zip(self.groups, array.shape, strict=True))
        )
        if self.text == self.core:
            return some
        letters = "".join(self.groups).replace("C", "D")
        lengths = {letter: part.stop - part.start for letter, part in chosen.items()}
        split = some.reshape([lengths.get(letter, sizes[letter]) for letter in letters])
        single = {"I", "M"} - {frame}
        split = split.squeeze(axis=tuple(axis for axis, letter in enumerate(letters) if letter in single))
        remaining = [letter for letter in letters if letter not in single]
        core = self.core.replace("M", frame)
        moved = split.transpose([remaining.index(letter) for letter in core if letter in remaining])
        return np.expand_dims(moved, [axis for axis, letter in enumerate(core) if letter not in remaining])


def plausible_layouts(shape: tuple[int, ...], truth: tuple[int, ...]) -> list[str]:
    """Name the common layouts that would fit hypotheses to a truth of shape (M, K, D), one of those that are the same.

    Examples
    --------
    >>> plausible_layouts((200, 7, 17, 3), (7, 17, 3))
    ['NMKD']
    >>> plausible_layouts((7, 7, 17, 3), (7, 17, 3))
    ['NMKD', 'MNKD']
    """
    if len(shape) != 4:
        return []
    fitting = [text for text in _COMMON if tuple(shape[text.index(letter)] for letter in TRUTH) == truth]
    order = {text: "".join(letter for letter, n in zip(text, shape, strict=True) if n > 1) for text in fitting}
    return [text for text in fitting if order[text] not in [order[other] for other in fitting[: fitting.index(text)]]]
