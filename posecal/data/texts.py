"""JSON and tables as text in which every character can be shown."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from posecal.errors import UNPRINTABLE, printable

if TYPE_CHECKING:
    import pandas as pd


def printable_table(table: pd.DataFrame) -> pd.DataFrame:
    """Escape the characters in a table that a terminal or a file of text can't show."""
    return table.map(lambda value: printable(value) if isinstance(value, str) else value)


def text_frame(rows: Sequence[object], columns: Sequence[str]) -> pd.DataFrame:
    """Give a pandas data frame whose text may hold what UTF-8 can't write, as file names may: PyArrow refuses that."""
    import pandas as pd

    with pd.option_context("mode.string_storage", "python"):
        return pd.DataFrame(rows, columns=list(columns))


def json_text(value: object, indent: int | None = None) -> str:
    r"""Write JSON whose characters all can be shown; what can't is escaped, and read back as it was.

    Examples
    --------
    >>> print(json_text(["RWrist " + chr(0x9B)]))
    ["RWrist \u009b"]
    """
    text = json.dumps(value, ensure_ascii=False, indent=indent)
    return UNPRINTABLE.sub(lambda match: match[0] if match[0] == "\n" else f"\\u{ord(match[0]):04x}", text)


def json_lines(about: Mapping[str, object]) -> str:
    """Write a mapping as JSON, a list or an iterator with a line for each of its items.

    Examples
    --------
    >>> print(json_lines({"poses": 2, "rows": iter([{"a": 1}, {"a": 2}]), "none": []}))
    {
     "poses": 2,
     "rows": [
      {"a": 1},
      {"a": 2}
     ],
     "none": [
     ]
    }
    """

    def pieces() -> Iterator[str]:
        for number, (key, value) in enumerate(about.items()):
            yield f"{',' if number else '{'}\n {json_text(key)}: "
            if isinstance(value, list | Iterator):
                yield "["
                yield from (f"{',' * (k > 0)}\n  {json_text(item)}" for k, item in enumerate(value))
                yield "\n ]"
            else:
                yield json_text(value)

    return "".join(pieces()) + "\n}"
