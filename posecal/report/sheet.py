"""A title, sentences and tables, written for terminals by rich and as Markdown and LaTeX by pandas.

What a terminal or a file of text can't show of names is escaped as the sheet is made.
"""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from posecal.errors import printable
from posecal.report.latex import fitted, grid_of

if TYPE_CHECKING:
    import pandas as pd

GAP = 2
"""Columns of the terminal between two columns of a table."""


_BOUND = re.compile(r"(?<=\d) (?=%)|(?<=\bp) (?=[=<] )|(?<=\bp [=<]) (?=\d)")
"""Blanks at which a terminal's lines don't end."""

_BLANK = "\ue000"
"""Stands for them while lines are broken: rich breaks at every kind of blank."""


def _escaped(value: Any, kept: str = "") -> Any:
    """Escape what can't be shown, but for one character, in text and in lists and tuples of text."""
    if isinstance(value, str):
        return kept.join(map(printable, value.split(kept))) if kept else printable(value)
    return type(value)(_escaped(part, kept) for part in value) if isinstance(value, list | tuple) else value


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes
    ----------
    title : str
        Its heading; the text for a terminal shows the first column's instead.
    headings : sequence of str
        Of the columns.
    rows : sequence of tuples of str
        Cells.
    words : collection of str
        Headings of columns of words, beside the first; all others hold numbers, which are aligned at their right and
        never broken over lines.
    breaks : bool
        Whether line breaks in cells are kept, not escaped.
    best : collection of (int, int)
        Row and column of the cells that LaTeX and Markdown print in bold.
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[tuple[str, ...]]
    words: Collection[str] = ()
    breaks: bool = False
    best: Collection[tuple[int, int]] = ()

    def __post_init__(self) -> None:
        for part in fields(self):
            kept = "\n" if self.breaks else ""
            object.__setattr__(self, part.name, _escaped(getattr(self, part.name), kept))

    @property
    def columns(self) -> list[tuple[str, bool]]:
        """The headings, and whether a column holds numbers."""
        return [(heading, k > 0 and heading not in self.words) for k, heading in enumerate(self.headings)]

    def frame(self, bold: tuple[str, str] = ("", "")) -> pd.DataFrame:
        """Give the table as a pandas data frame of text, with marks around what is bold."""
        import pandas as pd

        rows = [
            [cell.join(bold) if (row, column) in self.best else cell for column, cell in enumerate(cells)]
            for row, cells in enumerate(self.rows)
        ]
        return pd.DataFrame(rows, columns=list(self.headings), dtype=str)

    def parts(self, width: int) -> list[RichTable]:
        """Lay the table out for a terminal: where its numbers don't fit, as several with the same first column."""
        narrowest, widest = [], 0
        for (heading, is_number), *cells in zip(self.columns, *self.rows, strict=True):
            words = [*heading.split(), *(cells if is_number else (word for cell in cells for word in cell.split()))]
            narrowest.append(max(map(cell_len, words), default=0))
            widest += GAP + max(map(cell_len, (heading, *cells)))
        parts: list[list[int]] = [[0]]
        for column in range(1, len(self.columns)):
            if len(parts[-1]) > 1 and sum(narrowest[c] + GAP for c in parts[-1]) + narrowest[column] > width:
                parts.append([0])
            parts[-1].append(column)
        return [self._laid_out(part, narrowest if widest > width + GAP else None) for part in parts]

    def _laid_out(self, part: list[int], widths: list[int] | None) -> RichTable:
        table = RichTable(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
        for column in part:
            heading, is_number = self.columns[column]
            table.add_column(
                Text(heading),
                justify="right" if is_number else "left",
                width=widths[column] if widths and is_number else None,
                overflow="fold",
            )
        for row in self.rows:
            table.add_row(*(Text(row[column]) for column in part))
        return table


@dataclass(frozen=True)
class Sheet:
    """What is shown at once.

    Attributes
    ----------
    title : str
        One line.
    sentences, remarks : lists of str
        Before the tables.
    tables : list of Table
        The numbers.
    definitions : list of (str, str)
        Terms and what they mean.
    footer : str
        A line that is never broken, such as a signature.
    more : str
        In text, a line on what is left out.
    """

    title: str
    sentences: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    definitions: list[tuple[str, str]] = field(default_factory=list)
    footer: str = ""
    more: str = ""

    def __post_init__(self) -> None:
        for part in fields(self):
            object.__setattr__(self, part.name, _escaped(getattr(self, part.name)))

    @property
    def words(self) -> list[str]:
        """The sentences, and the remarks as notes."""
        return [*self.sentences, *(f"note: {remark}" for remark in self.remarks)]

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
        console = Console(file=out, width=width, force_terminal=colour)
        sentences = (Text(_BOUND.sub(_BLANK, words)) for words in self.words)
        console.print(Text(self.title, style="bold"), *sentences, sep="\n")
        for part in (part for table in self.tables for part in table.parts(width)):
            console.print("", part, sep="\n")
        if self.definitions:
            console.print("", *(Text.assemble((term, "bold"), ": ", text) for term, text in self.definitions), sep="\n")
        if self.more:
            console.print("", Text(_BOUND.sub(_BLANK, self.more)), sep="\n")
        elif self.footer:
            console.print()
        if self.footer:
            console.print(Text(self.footer, style="dim"), soft_wrap=True)
        return "\n".join(line.rstrip() for line in out.getvalue().replace(_BLANK, " ").splitlines())

    def markdown(self) -> str:
        """Write the sheet as Markdown, without a final line break."""
        blocks = [_escape(self.title), *map(_escape, self.words)]
        for table in self.tables:
            frame = table.frame(("**", "**")).map(_escape).rename(columns=_escape)
            align = ["right" if is_number else "left" for _, is_number in table.columns]
            blocks += [f"### {_escape(table.title)}"]
            blocks += [frame.to_markdown(index=False, disable_numparse=True, colalign=align)]
        if self.definitions:
            terms = [f"- **{_escape(term)}**: {_escape(meaning)}" for term, meaning in self.definitions]
            blocks += ["### Definitions", "\n".join(terms)]
        return "\n\n".join([*blocks, f"`{self.footer}`"] if self.footer else blocks)

    def latex(self) -> str:
        """Write the tables as LaTeX tabulars that fit a plain article (package booktabs), all else as comments."""
        lines = [f"% {text}" for text in (self.title, *self.words)]
        for table in self.tables:
            parts = fitted(grid_of(table.columns, table.rows, table.best))
            for number, part in enumerate(parts, 1):
                of = f" ({number} of {len(parts)})" if len(parts) > 1 else ""
                lines += ["", f"% {table.title}{of}", part.tabular()]
        lines += ["", *(f"% {term}: {meaning}" for term, meaning in self.definitions), f"% {self.footer}"]
        return "\n".join(lines)


def _escape(text: str) -> str:
    """Write text as Markdown that is no markup and stays in its cell."""
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")
