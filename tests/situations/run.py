"""Run a situation through the command line and through Python."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from typer.testing import CliRunner

import posecal
from posecal.cli import app
from tests.situations.cases import Situation


class Outcome(NamedTuple):
    """What posecal says: a refusal, or remarks and values by name (``step=last min_mpjpe`` of a group)."""

    refusal: str
    remarks: tuple[str, ...]
    values: Mapping[str, float]


def flags(options: Mapping[str, Any]) -> list[str]:
    """Give parameters of :func:`posecal.evaluate` as flags."""
    words: list[str] = []
    for name, value in options.items():
        if name == "protocol" and isinstance(value, dict):
            words += [word for key, text in value.items() for word in ("--set", f"{key}={text}")]
        else:
            flag = {"protocol": "preset", "root_joint": "root-joint"}.get(name, name.replace("_", "-"))
            words += [f"--{flag}", str(value)]
    return words


def command(situation: Situation) -> str:
    """Give the command of a situation."""
    return " ".join(["posecal evaluate hyps.npz gt.npz", *flags(situation.options)])


def of_command_line(situation: Situation, folder: Path) -> Outcome:
    """Run the command, and read what it writes as JSON."""
    files = [str(folder / "hyps.npz"), str(folder / "gt.npz")]
    done = CliRunner().invoke(app, ["evaluate", *files, *flags(situation.options), "--format", "json"])
    if done.exit_code:
        assert done.exit_code == 3, done.output
        return Outcome(done.stderr, (), {})
    report = json.loads(done.stdout)
    return Outcome("", tuple(report["remarks"]), _values(report["rows"]))


def of_python(situation: Situation, folder: Path) -> Outcome:
    """Call :func:`posecal.evaluate` with the same files."""
    options = dict(situation.options)
    if isinstance(options.get("protocol"), dict):
        options["protocol"] = posecal.Protocol(**options["protocol"])
    try:
        report = posecal.evaluate(folder / "hyps.npz", folder / "gt.npz", **options)
    except posecal.PosecalError as error:
        return Outcome(str(error), (), {})
    return Outcome("", tuple(report.remarks), _values(json.loads(report.render("json"))["rows"]))


def _values(rows: list[dict[str, Any]]) -> dict[str, float]:
    return {
        f"{row['group']} {row['metric']}" if row["group"] else str(row["metric"]): row["value"]
        for row in rows
        if row["joint"] is None
    }
