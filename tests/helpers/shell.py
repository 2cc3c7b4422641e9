"""A small evaluation's files, and posecal run on them as a user runs it."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

import posecal
from posecal.cli import app
from posecal.demo import sample
from tests.helpers.reports import world

ROOT = Path(__file__).parents[2]
N = 6
JOINTS = posecal.JOINT_SETS["h36m-17"]
Array = np.ndarray[Any, np.dtype[Any]]
EVALUATE = ["evaluate", "hyps.npz", "gt.npz"]

MODELS_SHAPE = 9, 48, 4
MODELS_JOINTS = np.array(["Head", "LWrist", "RKnee", "LFoot"])
"""N, M, K and the joints of three models' files."""


def hypotheses() -> Array:
    return sample(world(), N)


def frame_ids() -> Array:
    return np.array([f"{name}/{number}" for number, name in enumerate(world().sequence)])


def hyps_members() -> dict[str, Any]:
    return {
        "hypotheses": hypotheses(),
        "axes": "NMKD",
        "unit": "mm",
        "joints": np.array(JOINTS),
        "frame_id": frame_ids(),
    }


def gt_members() -> dict[str, Any]:
    here = world()
    return {
        "truth": here.truth.astype(np.float32),
        "unit": "mm",
        "joints": np.array(JOINTS),
        "frame_id": frame_ids(),
        "sequence": here.sequence,
        "action": here.action,
        "occluded": here.occluded,
    }


def run(*words: str | Path) -> Any:
    """Run posecal in this process; whatever it can't answer for is raised."""
    done = CliRunner().invoke(app, [str(word) for word in words], prog_name="posecal")
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


def done(*words: str | Path) -> str:
    """Run what must succeed, and give its stdout."""
    found = run(*words)
    assert found.exit_code == 0, found.stderr
    return found.stdout


def refused(*words: str | Path, code: int = 3) -> str:
    """Run what must be refused: nothing on stdout, nothing written, nothing changed. Give stderr as one line."""
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    found = run(*words)
    assert found.exit_code == code, found.output
    assert found.stdout == ""
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before
    return " ".join(re.sub(r"[│╭╮╰╯─]", " ", found.stderr).split())


def spawned(*words: str | Path, **how: Any) -> subprocess.Popen[bytes]:
    """Run posecal as a user's shell does."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen([sys.executable, "-m", "posecal", *map(str, words)], env=environment, **how)


def rows(text: str) -> dict[tuple[str, str | None, str | None], float | None]:
    """The values of a report in JSON."""
    return {(row["metric"], row["group"], row["joint"]): row["value"] for row in json.loads(text)["rows"]}
