"""Functions and metrics of the user's own are loaded from Python files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posecal.engine.metric import Metric
from posecal.engine.user_code import load_function
from posecal.errors import PoseDataError


def test_a_prerank_is_loaded_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def span(pool):\n    return pool.max(axis=(1, 2)) - pool.min(axis=(1, 2))\n")
    name, prerank = load_function(f"{tmp_path}/own.py:span", "prerank")
    assert name == "span"
    np.testing.assert_array_equal(prerank(np.array([[[1.0, 2]], [[5, 3]]])), [1, 2])


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("own.py", r"prerank: 'own.py'; expected FILE\.py:NAME"),
        ("own.txt:span", r"expected FILE\.py:NAME"),
        ("own.py:a b", r"expected FILE\.py:NAME"),
        ("{}/none.py:span", r"none\.py can't be read \(No such file or directory\)"),
        ("{}/own.py:other", r"own\.py has no function 'other'; expected one that takes poses"),
        ("{}/own.py:number", r"own\.py has no function 'number'"),
    ],
)
def test_a_prerank_that_is_not_there_is_refused(tmp_path: Path, entry: str, words: str) -> None:
    (tmp_path / "own.py").write_text("number = 3\n")
    with pytest.raises(PoseDataError, match=words):
        load_function(entry.format(tmp_path), "prerank")


def test_a_prerank_file_that_fails_is_refused(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def span(pool:\n")
    with pytest.raises(PoseDataError, match=r"own\.py can't be run \(SyntaxError"):
        load_function(f"{tmp_path}/own.py:span", "prerank")


def test_a_file_that_leaves_python_is_refused(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("import sys\nsys.exit('enough')\n")
    with pytest.raises(PoseDataError, match=r"metric: .*own\.py can't be run \(SystemExit: enough\)"):
        load_function(f"{tmp_path}/own.py:span", "metric")


def test_an_instance_of_a_class_that_is_named_does_as_well(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(
        "from posecal.engine.metric import Metric\n"
        "def error(hypotheses, truth):\n    'An error.'\n    return abs(hypotheses - truth).mean(axis=(0, 2, 3))\n"
        "own = Metric.from_function(error)\n"
    )
    assert load_function(f"{tmp_path}/own.py:own", "metric", Metric)[1].name == "error"
    with pytest.raises(PoseDataError, match=r"own\.py has no function 'own'"):
        load_function(f"{tmp_path}/own.py:own", "metric")
