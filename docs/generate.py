"""Write anew what pages show of posecal itself: ``python docs/generate.py`` tables, ``… commands`` printed output."""

from __future__ import annotations

import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterable
from contextlib import chdir
from dataclasses import fields
from pathlib import Path
from typing import cast

from typer.testing import CliRunner

import posecal
import posecal.cli
from posecal.data.skeleton import JOINT_SET_TABLE, Skeleton
from posecal.engine.metric import Family
from posecal.engine.protocol import CHOICES, Protocol
from posecal.report.explain import metrics_table
from posecal.report.sentences import RULES

COMMANDS = Path(__file__).with_name("commands.md")
PAGES = tuple(Path(__file__).with_name(f"{name}.md") for name in ("metrics", "joints", "report", "leaderboard"))


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


def joint_sets(_: str) -> str:
    """Write the table of all joint sets."""
    rows = (
        (
            f"`{name}`",
            f"`{entry.root}`",
            ", ".join(
                joint if parent < 0 else f"{joint}\N{NO-BREAK SPACE}({parent})"
                for joint, parent in zip(entry.names, Skeleton(entry.names).parents, strict=True)
            ),
            entry.source,
        )
        for name, entry in JOINT_SET_TABLE.items()
    )
    return table(("set", "root", "joints in order, with the number of their parent", "source"), *rows)


def rules(_: str) -> str:
    """Write the decision table of the summary."""
    return table(("about", "rule", "holds where"), *((rule.group, rule.name, rule.when) for rule in RULES))


def models(folder: str) -> str:
    """Write the pages of the test sets of a leaderboard, each under its title."""
    pages = []
    for sheet in posecal.leaderboard(Path(__file__).with_name(folder)).sheets():
        title, _, page = sheet.markdown().partition("\n\n")
        pages.append(f"### {title}\n\n{page.replace('### ', '#### ')}")
    return "\n\n".join(pages)


def _values(option: str, form: str) -> str:
    return ", ".join(f"`{choice}`" for choice in CHOICES[option]) if option in CHOICES else form


def generated(text: str) -> str:
    """Replace what stands between markers such as ``<!-- metrics: family -->`` and ``<!-- end -->``."""
    tables = {
        "metrics": lambda family: metrics(cast(Family, family)),
        "options": options,
        "joint_sets": joint_sets,
        "rules": rules,
        "models": models,
    }
    return re.sub(
        r"(<!-- (metrics|options|joint_sets|rules|models): (\w+) -->\n).*?(<!-- end -->)",
        lambda marked: f"{marked[1]}\n{tables[marked[2]](marked[3])}\n\n{marked[4]}",
        text,
        flags=re.DOTALL,
    )


def printed(command: str) -> str:
    """Run a command of posecal in the current folder, at 100 columns, and return what it prints."""
    program, *words = shlex.split(command)
    if program != "posecal":
        raise ValueError(f"{command}: expected a command of posecal.")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # where the demonstration finds posecal
    environment = {"PATH": path, "COLUMNS": "100", "MPLBACKEND": "Agg", "TERM": "dumb"}
    done = CliRunner().invoke(posecal.cli.app, words, prog_name=program, env=environment)
    if done.exit_code:
        raise ValueError(f"{command}: exit {done.exit_code}\n{done.output}") from done.exception
    return "\n".join(line.rstrip() for line in done.stdout.splitlines()).strip("\n")


def with_output(text: str) -> str:
    """Run the commands of a page in their order, each followed by what it prints."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        return re.sub(
            r"(```console\n\$ (.*)\n)(?:.*\n)*?(```)", lambda block: f"{block[1]}{printed(block[2])}\n{block[3]}", text
        )


if __name__ == "__main__":
    if sys.argv[1:] == ["commands"]:
        COMMANDS.write_text(with_output(COMMANDS.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        for page in PAGES:
            page.write_text(generated(page.read_text(encoding="utf-8")), encoding="utf-8")
        board = posecal.leaderboard(Path(__file__).with_name("leaderboard"))
        pictures, first = Path(__file__).with_name("pictures"), next(iter(board.comparisons.values()))
        reports = {name: posecal.Report(totals) for name, totals in zip(first.names, first.totals, strict=True)}
        posecal.plot.save(posecal.plot.draw_comparison(board.comparisons), pictures / "leaderboard.svg")
        posecal.plot.save(
            posecal.plot.draw(reports, panels=True, size=(9, 5)), pictures / "leaderboard-reliability.svg"
        )
