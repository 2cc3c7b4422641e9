"""The page of a leaderboard: its cells are the numbers of the comparison, best first."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from posecal.evaluation.entries import Entry
from posecal.report.comparison import Comparison
from posecal.report.sheet import Sheet
from posecal.report.standings import COLUMNS, standings_rows, standings_sheet
from tests.helpers.boards import ABOUT, METRICS
from tests.helpers.comparisons import MODELS, X, Y, totals_of

POINT = np.repeat(X.mean(axis=0)[None], len(X), axis=0)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    models = {**MODELS, "point": POINT}
    return Comparison(tuple(models), tuple(totals_of(x, Y, METRICS) for x in models.values()))


def entries_of(comparison: Comparison) -> list[Entry]:
    entry = Entry(**{**ABOUT, "name": ""}, hypotheses_sha256="0123456789abcdef" * 4, result_sha256="f" * 64)
    return [replace(entry, name=name) for name in comparison.names]


@pytest.fixture(scope="module")
def sheet(comparison: Comparison) -> Sheet:
    return standings_sheet("16 people", entries_of(comparison), comparison)


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", text)]


def test_a_row_holds_the_numbers_of_its_model(sheet: Sheet, comparison: Comparison) -> None:
    table = sheet.tables[0]
    assert table.headings == ("model", "rank", "energy score ↓", "ECE ↓", "minMPJPE ↓", "signed area 0")
    for (name, rank, score, ece, error, _), model in zip(table.rows, comparison.names, strict=True):
        assert (name, int(rank)) == (model, comparison.rank("energy_score", model))
        for cell, metric in ((score, "energy_score"), (error, "min_mpjpe")):
            interval = comparison.interval(metric, model)
            expected = [comparison.value(metric, model), interval.low, interval.high]
            np.testing.assert_allclose(numbers(cell), expected, atol=0.51)
        value, p = numbers(ece)[0], comparison.test("ece", model).p
        assert value == pytest.approx(comparison.value("ece", model), abs=5.1e-4)
        assert ("(p " in ece) == (p == p)
    assert "(p = 0.008)" in table.rows[1][3]  # the narrow one, on 8 sequences


def test_what_is_the_same_for_all_sequences_has_no_interval(sheet: Sheet) -> None:
    score, ece, _, area = sheet.tables[0].rows[3][2:]  # of a point, which no truth is within
    assert "(" in score
    assert re.fullmatch(r"0\.\d{3}", ece)
    assert re.fullmatch(r"-0\.\d{3}", area)


def test_the_best_of_each_metric_are_bold(sheet: Sheet, comparison: Comparison) -> None:
    bold = {(row, column) for row, column in sheet.tables[0].best}
    names = ["energy_score", "ece", "min_mpjpe", "signed_area"]
    first = {
        (row, 2 + column)
        for row, model in enumerate(comparison.names)
        for column, name in enumerate(names)
        if comparison.rank(name, model) == 1 and any(comparison.rank(name, other) > 1 for other in comparison.names)
    }
    assert bold == first != set()


def test_sources_and_pairs_follow(sheet: Sheet, comparison: Comparison) -> None:
    _, sources, pairs = sheet.tables
    assert sources.rows[0] == ("right", "example.org/model", "v1.0", "–", "0123456789ab")
    assert len(pairs.rows) == 2 * 6
    assert sheet.title == "16 people · M = 48 poses in 8 sequences · N = 12"
    assert sheet.definitions[1] == (
        "rank",
        "by the energy score: 1, and one more for each model that is better beyond chance.",
    )
    assert f"No miscalibration shown on average: {', '.join(comparison.calibrated())}." in sheet.sentences


def test_long_names_of_commits_are_cut(comparison: Comparison) -> None:
    entries = [replace(entry, commit="0123456789abcdef0", preset="cgnf") for entry in entries_of(comparison)]
    assert standings_sheet("a", entries, comparison).tables[1].rows[0][2:4] == ("0123456789ab", "cgnf")


def test_one_model_stands_without_pairs(comparison: Comparison) -> None:
    one = Comparison(comparison.names[:1], comparison.totals[:1])
    sheet = standings_sheet("16 people", entries_of(one), one)
    assert [table.title for table in sheet.tables] == ["Models", "Sources"]
    assert [term for term, _ in sheet.definitions] == ["in brackets"]
    assert sheet.sentences == ["No miscalibration shown on average: right."]


def test_the_tidy_rows_hold_every_metric_of_every_model(comparison: Comparison) -> None:
    rows = list(standings_rows("16 people", comparison))
    assert [(row["metric"], row["model"]) for row in rows] == [
        (metric, model) for metric in comparison.metrics for model in comparison.names
    ]
    assert tuple(rows[0]) == COLUMNS
    (row,) = (row for row in rows if (row["metric"], row["model"]) == ("ece", "narrow"))
    test = comparison.test("ece", "narrow")
    assert (row["value"], row["p"], row["primary"], row["unit"]) == (
        comparison.value("ece", "narrow"),
        test.p,
        True,
        "",
    )
    assert (row["test_set"], row["rank"]) == ("16 people", comparison.rank("ece", "narrow"))
    (row,) = (row for row in rows if (row["metric"], row["model"]) == ("min_mpjpe", "off"))
    interval = comparison.interval("min_mpjpe", "off")
    assert (row["low"], row["high"], row["unit"], row["primary"]) == (interval.low, interval.high, "mm", False)
    assert np.isnan(row["p"])


def test_a_paper_has_units_in_headings_a_table_for_each_metric_and_sources_as_definitions(
    sheet: Sheet, comparison: Comparison
) -> None:
    entries = entries_of(comparison)
    paper = standings_sheet("16 people", entries, comparison, paper=True)
    models, *pairs = paper.tables
    assert models.headings == ("model", "rank", "energy score [mm] ↓", "ECE ↓", "minMPJPE [mm] ↓", "signed area")
    assert models.rows == [tuple(cell.replace(" mm", "") for cell in row) for row in sheet.tables[0].rows]
    assert [table.headings[0] for table in pairs] == ["energy score [mm] ↓", "ECE ↓"]
    said = dict(paper.definitions)
    assert all(
        entries[0].source in said[name] and entries[0].hypotheses_sha256[:12] in said[name] for name in comparison.names
    )
