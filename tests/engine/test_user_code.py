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
        ("{}/own.py:number", r"'number' in .*own\.py is of type int; expected a function that takes poses\.$"),
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
    with pytest.raises(
        PoseDataError, match=r"'own' in .*own\.py is of type Metric; expected a function that takes poses\.$"
    ):
        load_function(f"{tmp_path}/own.py:own", "metric")


def test_a_file_is_run_once_for_all_of_its_names_and_again_where_it_has_changed(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text("a = b = lambda pool: pool\n")
    assert load_function(f"{own}:a", "prerank")[1] is load_function(f"{own}:b", "metric")[1]
    own.write_text("a = lambda pool: 2\n")
    assert load_function(f"{own}:a", "prerank")[1](1) == 2


def test_a_file_whose_code_can_not_read_a_file_is_not_said_to_be_unreadable(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("open('/none/at/all')\n")
    with pytest.raises(PoseDataError, match=r"own\.py can't be run \(FileNotFoundError"):
        load_function(f"{tmp_path}/own.py:a", "metric")
