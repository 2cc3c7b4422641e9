"""How do tables look to a person? The same sheet as text for a terminal and as Markdown."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from typing import Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

__all__ = ["Sheet", "Table"]


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes
    ----------
    title : str
        Its heading; the text for a terminal shows the first column's instead.
    columns : tuple of (str, bool)
        Headings, and whether a column holds numbers.
    rows : list of tuples of str
        Cells.
    """

    title: str
    columns: tuple[tuple[str, bool], ...]
    rows: list[tuple[str, ...]]


@dataclass(frozen=True)
class Sheet:
    """What is shown at once: a title, what there is to say, tables, definitions, and a line to keep.

    Attributes
    ----------
    title : str
        One line.
    sentences : list of str
        In words, before the tables.
    tables : list of Table
        The numbers.
    definitions : list of (str, str)
        Terms and what they mean.
    footer : str
        A line that must stay whole, such as a signature.
    """

    title: str
    sentences: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    definitions: list[tuple[str, str]] = field(default_factory=list)
    footer: str = ""

    def text(self, width: int = 120, *, colour: bool = False) -> str:
        """Write the sheet for a terminal.

        Parameters
        ----------
        width : int
            Columns of the terminal.
        colour : bool
            Whether to use its colours.

        Returns
        -------
        str
            The text, without a final line break.
        """
        out = io.StringIO()
        console = Console(file=out, width=width, force_terminal=colour, no_color=not colour, highlight=False)
        console.print(Text(self.title, style="bold"))
        for sentence in self.sentences:
            console.print(Text(sentence))
        for table in (part for whole in self.tables for part in _parts(whole, width)):
            console.print()
            drawn = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, header_style="bold")
            for (heading, is_number), place in zip(table.columns, _widths(table, width), strict=True):
                dim = "dim" if heading == "what it is" else ""
                justify: Literal["left", "right"] = "right" if is_number else "left"
                drawn.add_column(Text(heading), justify=justify, style=dim, overflow="fold", width=place)
            for row in table.rows:
                drawn.add_row(*(Text(cell) for cell in row))
            console.print(drawn)
        if self.definitions:
            console.print()
            for term, meaning in self.definitions:
                console.print(Text.assemble((term, "bold"), ": ", meaning))
        if self.footer:
            console.print()
            console.print(Text(self.footer, style="dim"), soft_wrap=True)
        return "\n".join(line.rstrip() for line in out.getvalue().splitlines())

    def markdown(self) -> str:
        """Write the sheet as Markdown, without a final line break."""
        lines = [_escaped(self.title), *(line for sentence in self.sentences for line in ("", _escaped(sentence)))]
        for table in self.tables:
            lines += ["", f"### {_escaped(table.title)}", ""]
            lines.append("| " + " | ".join(_escaped(heading) for heading, _ in table.columns) + " |")
            lines.append("|" + "|".join("---:" if is_number else "---" for _, is_number in table.columns) + "|")
            lines += ["| " + " | ".join(_escaped(cell) for cell in row) + " |" for row in table.rows]
        if self.definitions:
            lines += ["", "### Definitions", ""]
            lines += [f"- **{_escaped(term)}**: {_escaped(meaning)}" for term, meaning in self.definitions]
        return "\n".join([*lines, "", f"`{self.footer}`"] if self.footer else lines)


GAP = 3
"""Columns of the terminal between two columns of a table."""


def _narrowest(table: Table, column: int) -> int:
    """How narrow a column can be: no number is broken over lines, and no word."""
    heading, is_number = table.columns[column]
    cells = [row[column] for row in table.rows]
    pieces = [*heading.split(), *(cells if is_number else (word for cell in cells for word in cell.split()))]
    return max(map(cell_len, pieces), default=0)


def _widths(table: Table, width: int) -> list[int]:
    """Share out the width of the terminal: the widest columns give way first."""
    least = [_narrowest(table, column) for column in range(len(table.columns))]
    cells = [[heading, *(row[column] for row in table.rows)] for column, (heading, _) in enumerate(table.columns)]
    found = [max(cell_len(line) for cell in column for line in (cell.splitlines() or [""])) for column in cells]
    while sum(found) + GAP * (len(found) - 1) > width:
        yielding = [column for column in range(len(found)) if found[column] > least[column]]
        if not yielding:
            break
        found[max(yielding, key=lambda column: found[column])] -= 1
    return found


def _parts(table: Table, width: int) -> list[Table]:
    """Cut a table that is too wide for the terminal into some with the same first column."""
    least = [_narrowest(table, column) for column in range(len(table.columns))]
    parts: list[list[int]] = [[0]]
    for column in range(1, len(least)):
        if len(parts[-1]) > 1 and sum(least[c] + GAP for c in parts[-1]) + least[column] > width:
            parts.append([0])
        parts[-1].append(column)
    return [
        Table(table.title, tuple(table.columns[c] for c in part), [tuple(row[c] for c in part) for row in table.rows])
        for part in parts
    ]


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")
