"""A leaderboard is what ``compare`` gives of the same results, best first."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from runpy import run_path

import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.evaluation.rankings import Leaderboard
from tests.helpers.boards import ABOUT, board_of, saved


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    board = board_of(tmp_path_factory.mktemp("board"))
    alone = saved(board / "result", "narrow", align="rigid")
    posecal.add_entry(board, alone, hypotheses=alone, **{**ABOUT, "name": "narrow", "test_set": "16 people, rigid"})
    alone.unlink()
    return board


@pytest.fixture(scope="module")
def board(folder: Path) -> Leaderboard:
    return posecal.leaderboard(folder)


def test_models_are_those_of_compare_with_its_tests(board: Leaderboard, folder: Path) -> None:
    models = {name: folder / f"{name}-16-people.npz" for name in ("off", "right", "narrow")}
    expected = posecal.compare(models)
    found = board.comparisons["16 people"]
    assert {d.metric: d.p_adjusted for d in found.differences if {d.first, d.second} == {"right", "off"}} == {
        d.metric: d.p_adjusted for d in expected.differences if {d.first, d.second} == {"right", "off"}
    }
    assert [found.value("ece", name) for name in models] == [expected.value("ece", name) for name in models]


def test_models_stand_best_first_by_the_first_primary_metric(board: Leaderboard) -> None:
    comparison = board.comparisons["16 people"]
    scores = [comparison.value("energy_score", name) for name in comparison.names]
    assert scores == sorted(scores)
    assert [entry.name for entry in board.entries["16 people"]] == list(comparison.names) == ["right", "narrow", "off"]


def test_other_protocols_are_another_test_set(board: Leaderboard) -> None:
    assert repr(board) == "<Leaderboard: 3 on 16 people, 1 on 16 people, rigid>"
    assert board.comparisons["16 people, rigid"].totals[0].protocol.align == "rigid"


@pytest.mark.parametrize(("form", "parts"), [("text", "\n\n\n"), ("markdown", "`\n\n"), ("latex", "median\n\n")])
def test_pages_of_all_test_sets_are_written_one_after_another(board: Leaderboard, form: str, parts: str) -> None:
    pages = board.render(form).split(parts)
    assert len(pages) == 2
    assert all("16 people" in page for page in pages)
    assert str(board) == board.render("text")


def test_csv_is_the_table_with_remarks_last(board: Leaderboard) -> None:
    rows = list(csv.DictReader(io.StringIO(board.render("csv"))))
    remarks = [row for row in rows if row["metric"] == "remark"]
    assert rows[len(board.table) :] == remarks
    assert [float(row["value"]) for row in rows[: len(board.table)]] == pytest.approx(list(board.table["value"]))
    expected = [(name, text) for name, one in board.comparisons.items() for text in one.remarks]
    assert [(row["test_set"], row["model"]) for row in remarks] == expected


def test_json_holds_entries_numbers_and_differences(board: Leaderboard) -> None:
    found = json.loads(board.render("json"))
    assert [entry["name"] for entry in found["entries"]] == ["right", "narrow", "off", "narrow"]
    assert found["entries"][0].items() >= {**ABOUT, "preset": ""}.items()
    assert len(found["values"]) == len(board.table)
    assert len(found["differences"]) == len(board.comparisons["16 people"].differences)
    assert {row["test_set"] for row in found["differences"]} == {"16 people"}
    assert found["primary"]["16 people"] == ["energy_score", "ece"]
    assert "align=rigid" in found["signatures"]["16 people, rigid"]
    assert None in [row["p"] for row in found["values"]]


def test_a_form_is_one_of_a_few(board: Leaderboard) -> None:
    with pytest.raises(
        PoseDataError, match=r"^format: 'htm' is not known\. Known: text, csv, json, latex, markdown\.$"
    ):
        board.render("htm")


def test_the_tables_of_the_documentation_are_those_of_its_folder() -> None:
    page = Path(__file__).parents[2] / "docs" / "leaderboard.md"
    text, generated = page.read_text(encoding="utf-8"), run_path(str(page.with_name("generate.py")))["generated"]
    assert text == generated(text), "run python docs/generate.py"
    assert text.count("| cGNF ") == 2  # among models and sources


def test_the_folder_of_the_documentation_is_small() -> None:
    folder = Path(__file__).parents[2] / "docs" / "leaderboard"
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1.5e6
