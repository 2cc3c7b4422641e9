"""Each situation gives its right values, remarks and refusals, in Python and on the command line alike."""

from pathlib import Path

import pytest

from tests.situations.__main__ import PAGE, generated
from tests.situations.cases import SITUATIONS, Situation
from tests.situations.run import Outcome, of_command_line, of_python

EACH = pytest.mark.parametrize("situation", SITUATIONS, ids=lambda situation: situation.name)


def check(outcome: Outcome, situation: Situation, right: dict[str, float]) -> None:
    said = outcome.refusal if situation.is_refused else "\n".join(outcome.remarks)
    assert bool(outcome.refusal) == situation.is_refused, outcome.refusal
    for words in situation.says:
        assert words in said
    for name, value in right.items():
        assert outcome.values[name] == pytest.approx(value, rel=2e-5), name


@EACH
def test_the_command_line_gives_the_right_values(situation: Situation, tmp_path: Path) -> None:
    right = situation.write(tmp_path)
    check(of_command_line(situation, tmp_path), situation, right)


@EACH
def test_python_gives_the_right_values(situation: Situation, tmp_path: Path) -> None:
    right = situation.write(tmp_path)
    check(of_python(situation, tmp_path), situation, right)


def test_the_table_in_the_docs_is_what_the_command_writes() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert generated(page) == page
