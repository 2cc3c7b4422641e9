"""Write tables of docs/evidence.md anew: ``python -m tests.evidence [NAME …]``."""

from __future__ import annotations

import argparse
import re
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from tests.evidence import Table

PAGE = Path(__file__).parents[2] / "docs/evidence.md"


def tables() -> dict[str, Table]:
    """Give the tables of all modules of this package, by name."""
    names = [m.name for m in iter_modules([str(Path(__file__).parent)]) if not m.name.startswith(("_", "test_"))]
    modules = [import_module(f"tests.evidence.{name}") for name in sorted(names)]
    return {table.name: table for module in modules for table in module.TABLES}


def markdown(table: Table, replicates: int) -> str:
    """Compute a table, as Markdown."""
    rows = [table.columns, ("---",) * len(table.columns), *table.rows(replicates)]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows)


def with_table(text: str, name: str, table: str) -> str:
    """Put a table between its markers."""
    before, marker, rest = text.partition(f"<!-- table: {name} -->\n")
    if not marker:
        raise ValueError(f"{PAGE.name} has no <!-- table: {name} -->")
    _, end, after = rest.partition("<!-- end -->")
    return f"{before}{marker}\n{table}\n\n{end}{after}"


def markers(text: str) -> list[str]:
    """Give the names of the tables that a page has markers for."""
    return re.findall(r"<!-- table: (\S+) -->", text)


def main() -> None:
    """Write the tables that are named, or all."""
    known = tables()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(known))
    for name in parser.parse_args().names or known:
        table = markdown(known[name], known[name].replicates)
        PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), name, table), encoding="utf-8")


if __name__ == "__main__":
    main()
