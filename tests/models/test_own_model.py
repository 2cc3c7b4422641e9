"""An estimator of one's own: the example of docs/models.md, run as printed."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from posecal_models.data.detector import Detector
from posecal_models.data.mocap import MocapPoses

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs" / "models.md"


def example() -> str:
    """The Python block of the docs that defines an estimator of one's own."""
    blocks = re.findall(r"```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), flags=re.DOTALL)
    return next(block for block in blocks if "class Nearest" in block)


def test_the_example_is_short():
    assert len(example().splitlines()) <= 30


@pytest.mark.slow
@pytest.mark.skipif(not DOCS.exists(), reason="an installed package has no docs")
def test_the_example_runs_and_posecal_evaluates_it(motion_file, tmp_path):
    seen = MocapPoses(motion_file)
    for name, subjects in (("train", ["S1", "S2", "S3"]), ("test", ["S4"])):
        Detector().detect_set(seen.project(subjects=subjects, views=2)).save(tmp_path / f"{name}.npz")
    (tmp_path / "own.py").write_text(example(), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "own.py"], cwd=tmp_path, env=environment, check=True)
    command = [sys.executable, "-m", "posecal", "evaluate", "hyps.npz", "test.npz", "--format", "json"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True)
    report = json.loads(done.stdout)
    assert report["hypotheses"] == 20
    assert 0 < next(row["value"] for row in report["rows"] if row["metric"] == "min_mpjpe") < 500
