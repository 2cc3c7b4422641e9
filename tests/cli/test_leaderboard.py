"""``posecal leaderboard``: the same as in Python, with files and exit codes."""

from __future__ import annotations

from pathlib import Path

import posecal
from posecal.errors import for_command_line
from tests.helpers.shell import done, refused

WORDS = ("--source=example.org", "--commit=v1", "--command=sample", "--command=evaluate", "--data=Free.")


def add(name: str, *more: str) -> tuple[str, ...]:
    files = ("--from", f"{name}-result.npz", "--hypotheses", f"{name}.npz")
    return ("leaderboard", "add", "board", *files, "--name", name, "--test-set=demo", *WORDS, *more)


def test_models_are_added_and_shown_in_each_form_and_drawn() -> None:
    for name in ("right", "narrow"):
        done(
            "evaluate",
            f"{name}.npz",
            "true.npz",
            "--metrics=min_mpjpe,ece,energy_score",
            "--no-gallery",
            "--save",
            f"{name}-result.npz",
        )
        done(*add(name))
    board = posecal.leaderboard("board")
    assert done("leaderboard", "board", "--format=json", "--plot=axes.svg").strip() == board.render(
        "json", words=for_command_line
    )
    assert done("leaderboard", "show", "board", "--format=markdown").strip() == board.render(
        "markdown", words=for_command_line
    )
    assert "energy score: right is best beyond chance." in done("leaderboard", "board")
    drawn = Path("axes.svg").read_text(encoding="utf-8")
    assert ">demo<" in drawn
    assert 'id="feasible"' in drawn
    assert board.entries["demo"][0].command == "sample\nevaluate"


def test_the_folder_is_the_current_one_unless_named() -> None:
    assert "right.npz: no right.toml beside it" in refused("leaderboard")
    assert "no such folder" in refused("leaderboard", "nowhere")


def test_what_is_refused_is_one_message_and_writes_nothing() -> None:
    done("evaluate", "right.npz", "true.npz", "--metrics=ece", "--no-gallery", "--save=right-result.npz")
    said = refused(*add("right", "--preset=cgnff"))
    assert "entry: preset 'cgnff' is not known. Did you mean cgnf?" in said
    assert "Missing option" in refused("leaderboard", "add", "board", code=2)
    assert not Path("board").exists()
    words = add("right")
    assert "none/board: can't be made (No such file or directory)." in refused(*words[:2], "none/board", *words[3:])
    assert "true.npz: is no folder" in refused(*words[:2], "true.npz", *words[3:])


def test_help_is_that_of_the_command() -> None:
    assert "add" in done("leaderboard", "--help")
    assert "--from" in done("leaderboard", "add", "--help")
