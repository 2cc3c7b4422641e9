"""Write the tables of docs/metrics.md anew, from the metrics themselves: ``python docs/generate.py``."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import cast

from posecal.engine.metric import Family
from posecal.engine.protocol import CHOICES, Protocol
from posecal.report.explain import metrics_table

PAGE = Path(__file__).with_name("metrics.md")


def table(*rows: Iterable[str]) -> str:
    """Write a table as Markdown, of which the first row is the head."""
    head, *body = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *body))


def metrics(family: Family) -> str:
    """Write the table of a family of metrics."""
    return table(("metric", "definition", "unit", "best", "options that change it"), *metrics_table(family))


def options(_: str) -> str:
    """Write the table of all options."""
    rows = (
        (
            f"`{option.name}`",
            f"`{option.default}`",
            _values(option.name, option.metadata["form"]),
            option.metadata["about"],
        )
        for option in fields(Protocol)
    )
    return table(("option", "default", "values", "what it sets"), *rows)


def _values(option: str, form: str) -> str:
    return ", ".join(f"`{choice}`" for choice in CHOICES[option]) if option in CHOICES else form


def generated(text: str) -> str:
    """Replace what stands between the markers ``<!-- metrics: family -->`` or ``<!-- options: all -->`` and the end."""
    tables = {"metrics": lambda family: metrics(cast(Family, family)), "options": options}
    return re.sub(
        r"(<!-- (metrics|options): (\w+) -->\n).*?(<!-- end -->)",
        lambda marked: f"{marked[1]}\n{tables[marked[2]](marked[3])}\n\n{marked[4]}",
        text,
        flags=re.DOTALL,
    )


if __name__ == "__main__":
    PAGE.write_text(generated(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
