"""Tables as LaTeX tabulars (package booktabs) that fit the text of a plain article.

A table that is too wide is set smaller, has its words folded over lines, is transposed, or is cut
into several with the same first column: the first of these that is enough.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

TEXT, GAP = 32.7, 1.1
"""Width of the text of an article of A4 or letter paper at 11 pt, and the gap between two columns, in em."""

SMALLEST = 0.92
"""Size of letters of a table that is too wide, ``\\small``."""

SMALL = re.compile(r"(?<=\S) (\([^()]*\))$")
"""Of a cell of numbers, what is set small: the interval or the p-value in parentheses at its end."""

SMALLER, BOLDER = 0.83, 1.16
"""Relative widths of small and of bold letters."""

MOST_LETTERS = 10
"""A longer heading of numbers has several lines."""

MOST_LINES = 3
"""Of a folded cell."""

_SYMBOLS = {
    "↓": "downarrow",
    "↑": "uparrow",
    "ω": "omega",
    "τ": "tau",
    "∫": "int",
    "≤": "le",
    "√": "surd",
    "‖": "Vert",
    "…": "dots",
}
BOLD, NUMBERS, WORDS, SMALLS = "\ue010\ue011", "\ue012\ue014", "\ue013\ue015", "\ue016\ue017"
"""Begin and end of bold text, of numbers' headings and of words in several lines, and of small text, until LaTeX is
written: Unicode's private characters."""

BREAK = "\ue018"
"""A line break in them."""

LATEX = str.maketrans(
    {"\u00a0": "~", "−": "$-$", "<": "$<$", ">": "$>$", **{letter: rf"$\{name}$" for letter, name in _SYMBOLS.items()}}
    | dict(zip(BOLD, (r"\textbf{", "}"), strict=True))
    | dict(zip(NUMBERS, (r"\shortstack[r]{", "}"), strict=True))
    | dict(zip(WORDS, (r"\begin{tabular}[t]{@{}l@{}}", r"\end{tabular}"), strict=True))
    | dict(zip(SMALLS, (r"{\footnotesize ", "}"), strict=True))
    | {BREAK: r"\\{}"}
)
"""Letters that LaTeX knows by other names."""

_WIDTHS = {
    letter: width
    for width, letters in {
        0.28: "ijl.,:;'|[]",
        0.34: " \u00a0-",
        0.40: "()tfrsI",
        0.45: "cez",
        0.50: "0123456789aog–↓↑/",
        0.53: "kqvxyJ",
        0.73: "wBCFGLPRSTZ",
        0.78: "ADEHKNOQUVXY+−<>=≤",
        0.84: "m%",
        0.92: "M",
        1.03: "W",
    }.items()
    for letter in letters
}
"""In em of the letters that LaTeX has by default, rounded up; of all others 0.56."""


@dataclass(frozen=True)
class Grid:
    """Cells of a table, of which a line break begins a line.

    Attributes
    ----------
    columns : list of lists of str
        Each with its heading first.
    is_number : list of bool
        Which columns hold numbers.
    best : collection of (int, int)
        Row, counted from the heading's 0, and column of bold cells.
    """

    columns: Sequence[Sequence[str]]
    is_number: Sequence[bool]
    best: Collection[tuple[int, int]] = ()

    def width(self, column: int, scale: float = 1.0) -> float:
        """Give the width of a column, in em: an upper estimate."""
        return max(
            _width(line, scale, small=row > 0 and self.is_number[column])
            * (BOLDER if (row, column) in self.best else 1)
            for row, cell in enumerate(self.columns[column])
            for line in cell.split("\n")
        )

    def fits(self, text: float = TEXT) -> bool:
        """Say whether it fits a text of a width, at the smallest size."""
        return self._free(range(len(self.columns)), SMALLEST) >= TEXT - text

    def _free(self, columns: Sequence[int], scale: float) -> float:
        return TEXT - GAP * (len(self.columns) - 1) - sum(self.width(column, scale) for column in columns)

    def folded(self) -> Grid | None:
        """Fold the columns of words over lines, where few are enough."""
        words = [column for column, is_number in enumerate(self.is_number) if not is_number]
        free = self._free([column for column, is_number in enumerate(self.is_number) if is_number], SMALLEST)
        columns = list(self.columns)
        for place, column in enumerate(sorted(words, key=self.width)):
            width = min(self.width(column), free / (len(words) - place))
            free -= width
            if width < self.width(column):
                columns[column] = [_wrapped(cell, max(1, int(width / 0.5))) for cell in self.columns[column]]
        too_long = any(cell.count("\n") >= MOST_LINES for column in words for cell in columns[column])
        return None if too_long else replace(self, columns=columns)

    def transposed(self) -> Grid | None:
        """Make its columns rows, where all but the first hold numbers."""
        if not all(self.is_number[1:]):
            return None
        rows = [list(row) for row in zip(*self.columns, strict=True)]
        head = [heading.replace("\n", " ") for heading in rows[0]]
        columns = [head, *([_heading(name), *cells] for name, *cells in rows[1:])]
        return Grid(
            columns, [column > 0 for column in range(len(columns))], {(row, column) for column, row in self.best}
        )

    def cut(self) -> list[Grid]:
        """Give the fewest parts of about as many columns that fit, each with the first column."""
        parts = [self]
        if len(self.columns) < 3:
            return parts
        narrowest = self.width(0, SMALLEST) + GAP + max(self.width(c, SMALLEST) for c in range(1, len(self.columns)))
        text = max(TEXT, narrowest)  # a column that is too wide stands beside another all the same
        for number in range(2, len(self.columns)):
            some = np.array_split(range(1, len(self.columns)), number)
            parts = [self._part([0, *map(int, columns)]) for columns in some]
            if all(part.fits(text) for part in parts):
                break
        return parts

    def _part(self, columns: Sequence[int]) -> Grid:
        best = {(row, columns.index(column)) for row, column in self.best if column in columns}
        return Grid([self.columns[c] for c in columns], [self.is_number[c] for c in columns], best)

    def tabular(self) -> str:
        """Write it as a tabular, at the first size that fits."""
        import pandas as pd

        columns = [[self._cell(row, column) for row in range(len(cells))] for column, cells in enumerate(self.columns)]
        frame: Any = pd.DataFrame(dict(enumerate(cells[1:] for cells in columns)), dtype=str)
        frame.columns = [cells[0] for cells in columns]
        form = f"@{{}}{''.join('r' if is_number else 'l' for is_number in self.is_number)}@{{}}"
        text = frame.to_latex(index=False, escape=True, column_format=form).translate(LATEX).rstrip("\n")
        size = "" if self._free(range(len(columns)), 1.0) >= 0 else r"\small"
        return f"{{{size}\n{text}}}" if size else text

    def _cell(self, row: int, column: int) -> str:
        cell, is_number = self.columns[column][row], self.is_number[column]
        if is_number and row:
            cell = SMALL.sub(lambda found: f" {_between(SMALLS, found[1])}", cell)
        if "\n" in cell:
            cell = _between(NUMBERS if is_number else WORDS, cell.replace("\n", BREAK))
        return _between(BOLD, cell) if (row, column) in self.best else cell


def grid_of(
    headings: Sequence[tuple[str, bool]], rows: Sequence[Sequence[str]], best: Collection[tuple[int, int]]
) -> Grid:
    """Take the cells of a table, with long headings of numbers over several lines.

    Parameters
    ----------
    headings : sequence of (str, bool)
        Of the columns, and whether these hold numbers.
    rows : sequence of tuples of str
        Cells.
    best : collection of (int, int)
        Row and column of bold cells.

    Returns
    -------
    Grid
        Before it is made to fit.
    """
    columns = []
    for column, (heading, is_number) in enumerate(headings):
        cells = [row[column] for row in rows]
        if is_number:  # a hyphen is no minus
            cells = [re.sub(r"(?<!\w)-(?=\d)", "−", cell) for cell in cells]
        letters = max(MOST_LETTERS, *map(len, cells)) if cells else MOST_LETTERS
        columns.append([_heading(heading, letters) if is_number else heading, *cells])
    return Grid(columns, [is_number for _, is_number in headings], {(row + 1, column) for row, column in best})


def fitted(grid: Grid) -> list[Grid]:
    """Lay a table out so that it fits the text, in several parts where it can't otherwise."""
    layouts = [grid, grid.folded(), grid.transposed()]
    return next(([layout] for layout in layouts if layout is not None and layout.fits()), None) or grid.cut()


def _heading(heading: str, letters: int = MOST_LETTERS) -> str:
    """Break a long heading over lines, the direction with its unit, and no parentheses."""
    words = re.sub(r"\([^()]*\)", lambda found: found[0].replace(" ", "\u00a0"), heading.replace("] ", "]\u00a0"))
    return _wrapped(words, letters)


def _wrapped(text: str, letters: int) -> str:
    text = text.replace(" − ", "\u00a0− ")
    return "\n".join(textwrap.wrap(text, letters, break_long_words=False, break_on_hyphens=False))


def _width(text: str, scale: float, *, small: bool) -> float:
    """Estimate the width of a line in em, of which the end may be small."""
    end = SMALL.search(text) if small else None
    parts = [(text[: end.start(1)], scale), (end[1], SMALLER)] if end else [(text, scale)]
    return sum(size * sum(_WIDTHS.get(letter, 0.56) for letter in part) for part, size in parts)


def _between(marks: str, text: str) -> str:
    return f"{marks[0]}{text}{marks[1]}"
