"""The page on the toy problems: its examples run, its commands and pictures exist."""

import doctest
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from toy.__main__ import app

PAGE = Path(__file__).parents[2] / "docs" / "toy.md"
COMMANDS = [
    shlex.split(line)[3:]
    for block in re.findall(r"```bash\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    for line in block.splitlines()
    if line.startswith("python -m toy")
]


@pytest.mark.slow
def test_the_examples_of_the_page_run() -> None:
    failed, tried = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8", optionflags=doctest.ELLIPSIS)
    assert tried > 5
    assert failed == 0


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_commands_are_known_with_all_their_options(command: list[str]) -> None:
    shown = CliRunner().invoke(app, [*command[:1], "--help"], env={"COLUMNS": "200"})
    assert shown.exit_code == 0
    for option in command[1:]:
        if option.startswith("-"):
            assert option in shown.stdout


def test_pictures_are_there_and_small() -> None:
    pictures = re.findall(r"\]\((pictures/toy/[\w-]+\.png)\)", PAGE.read_text(encoding="utf-8"))
    assert len(pictures) == 7
    assert sum((PAGE.parent / picture).stat().st_size for picture in pictures) < 600_000
