"""The sheets of comparisons: primary metrics first, values with ranks, differences of pairs, what p is adjusted for."""

from __future__ import annotations

import math
import re
from itertools import combinations
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import for_command_line
from posecal.report.comparison import MOST_PAIRS, Comparison, compare_totals, comparison_sheet
from posecal.report.format import short_p
from posecal.report.sheet import Table
from posecal.stats.pairs import Difference
from tests.helpers.comparisons import METRICS
from tests.helpers.latex import rows_of
from tests.helpers.reports import report_of, unlabelled
from tests.situations.people import JOINTS, about, people

TESTED = ["difference", "95 % interval", "p", "adjusted p", "better"]
SPREADS = {"right": 1.0, "narrow": 0.5, "wide": 2.5}


def comparison_of(*names: str, metrics: str = METRICS, primary: tuple[str, ...] = ()) -> Comparison:
    return compare_totals([report_of(SPREADS[name], metrics=metrics).totals for name in names], names, primary)


def row_of(table: Table, label: str) -> tuple[str, ...]:
    (row,) = (row for row in table.rows if row[0] == label)
    return row


def digits_of(difference: Difference) -> int:
    """Digits after the point that write the interval's width to two significant ones, at most four."""
    return max(0, min(4, 1 - math.floor(math.log10(difference.high - difference.low))))


def shown(difference: Difference) -> tuple[str, ...]:
    """The cells of a difference."""
    low, high, digits = difference.low, difference.high, digits_of(difference)
    p = (short_p(difference.p), short_p(difference.p_adjusted))
    interval = f"{low:+.{digits}f} to {high:+.{digits}f}"
    return f"{difference.value:+.{digits}f}", interval, *p, difference.better or ""


def test_two_models_stand_with_their_difference() -> None:
    comparison = comparison_of("right", "narrow")
    sheet = comparison_sheet(comparison)
    assert sheet.title == "right against narrow · the same M = 36 poses, paired by 12 sequences"
    primary, others = sheet.tables
    assert list(primary.headings) == ["primary metric", "", "right", "narrow", *TESTED]
    assert list(others.headings) == ["other metric", "", "right", "narrow", *TESTED]
    assert [row[0] for row in primary.rows] == ["energy score", "ECE"]
    (difference,) = comparison.differences_of("energy_score")
    digits = digits_of(difference)
    values = [f"{comparison.value('energy_score', name):.{digits}f} mm" for name in ("right", "narrow")]
    assert row_of(primary, "energy score") == ("energy score", "↓", *values, *shown(difference))
    (difference,) = comparison.differences_of("ece")
    assert row_of(primary, "ECE")[4:] == shown(difference)
    (difference,) = comparison.differences_of("pck")
    assert row_of(others, "PCK 150 mm")[1] == "↑"
    assert row_of(others, "PCK 150 mm")[4:] == shown(difference)
    assert "ECE: right is best beyond chance." in sheet.sentences
    assert "No miscalibration shown on average: right." in sheet.sentences
    assert sheet.footer == f"signature: {comparison.totals[0].signature}"


def test_more_models_stand_with_their_ranks_and_then_in_pairs() -> None:
    names = ["right", "narrow", "wide"]
    comparison = comparison_of(*names)
    primary, others, pairs = comparison_sheet(comparison).tables
    assert list(primary.headings) == ["primary metric", "", *(f"{name} (rank)" for name in names)]
    digits = max(map(digits_of, comparison.differences_of("ece")))
    ranked = tuple(f"{comparison.value('ece', n):.{digits}f} ({comparison.rank('ece', n)})" for n in names)
    assert row_of(primary, "ECE")[2:] == ranked
    assert not any("(" in cell for cell in row_of(others, "coverage at 90 %")[2:])
    assert list(pairs.headings) == ["pair", "models", *TESTED]
    labels = ["energy score", "ECE"]
    between = [f"{a} − {b}" for a, b in combinations(names, 2)]
    assert [row[:2] for row in pairs.rows] == [(label, models) for label in labels for models in between]
    for difference, row in zip(comparison.differences_of("ece"), pairs.rows[3:], strict=True):
        assert row[2:] == shown(difference)


@pytest.mark.parametrize("form", ["text", "markdown", "latex"])
def test_three_models_stand_with_p_and_interval_in_every_form(form: str) -> None:
    comparison = comparison_of("right", "narrow", "wide")
    text = getattr(comparison_sheet(comparison), form)().replace("$-$", "-")
    for difference in comparison.differences_of("energy_score"):
        for cell in shown(difference)[:2]:
            assert cell in text
    assert text.count("adjusted p") >= 2


def test_of_many_models_only_pairs_with_the_best_one_are_shown() -> None:
    names = [f"m{number}" for number in range(7)]
    totals = [report_of(spread, metrics="pck, ece").totals for spread in (1.4, 1.3, 1.0, 1.2, 1.5, 1.6, 1.7)]
    comparison = compare_totals(totals, names, ["pck", "ece"])
    assert len(comparison.differences_of("ece")) > MOST_PAIRS
    *_, pairs = comparison_sheet(comparison).tables
    best = max(names, key=lambda name: comparison.value("pck", name))
    rows = [row[1].split(" − ") for row in pairs.rows]
    assert len(rows) == 2 * 6
    assert all(best in models for models in rows[:6])
    best = min(names, key=lambda name: comparison.value("ece", name))
    assert all(best in models for models in rows[6:])
    six = compare_totals(totals[:6], names[:6], ["pck", "ece"])
    assert len(comparison_sheet(six).tables[-1].rows) == 2 * MOST_PAIRS


def test_the_model_nearest_to_zero_is_the_best_one_of_metrics_that_are_best_at_zero() -> None:
    spreads = (0.4, 0.5, 0.6, 1.0, 1.6, 1.8, 2.0)
    totals = [report_of(spread, metrics="signed_area").totals for spread in spreads]
    comparison = compare_totals(totals, list("abcdefg"))
    nearest = min("abcdefg", key=lambda name: abs(comparison.value("signed_area", name)))
    assert comparison.value("signed_area", "a") < comparison.value("signed_area", nearest)
    assert all(nearest in row[1].split(" − ") for row in comparison_sheet(comparison).tables[-1].rows)


def test_what_p_is_adjusted_for_stands_below() -> None:
    def rule(comparison: Comparison) -> str:
        return dict(comparison_sheet(comparison).definitions)["adjusted p"]

    pair = comparison_of("right", "narrow")
    n = len(pair.metrics)
    assert rule(pair).startswith(f"Holm's, primary metrics over 2 tests, others over all {n} tests (metrics × pairs")
    three = comparison_of("right", "narrow", "wide", primary=("crps",))
    assert rule(three).startswith(f"Holm's, primary metrics over 3 tests, others over all {3 * n} tests (metrics")
    alone = comparison_of("right", "narrow", metrics="mpjpe")
    assert rule(alone).startswith("Holm's, primary metrics over 1 test (metrics × pairs of models). A model is called")


def test_metrics_that_are_best_at_zero_say_that_distances_are_compared() -> None:
    definitions = dict(comparison_sheet(comparison_of("right", "narrow")).definitions)
    assert definitions["signed area"] == "best at 0; differences are of the distances from 0."
    assert len(comparison_sheet(comparison_of("right", "narrow", metrics="mpjpe")).definitions) == 1


@pytest.mark.parametrize("form", ["markdown", "latex"])
def test_the_best_is_bold_with_its_ties_where_one_is_beaten(form: str) -> None:
    comparison = comparison_of("right", "narrow", "wide")
    text = getattr(comparison_sheet(comparison), form)()
    bold = re.compile({"markdown": r"\*\*([^*]+)\*\*", "latex": r"\\textbf\{([^}]+)\}"}[form])
    for name in ("ece", "pa_min_mpjpe", "crps"):
        label = comparison.metrics[name].label
        line = next(line for line in text.splitlines() if line.removeprefix("| ").startswith(f"{label} "))
        ranks = [comparison.rank(name, model) for model in comparison.names]
        assert max(ranks) > 1
        assert [cell[-2] for cell in bold.findall(line)] == ["1"] * ranks.count(1)
    tied = compare_totals([comparison.totals[0]] * 2, ["a", "b"])
    assert set(bold.findall(getattr(comparison_sheet(tied), form)())) <= {"adjusted p", "signed area"}  # terms


def test_a_paper_has_a_row_per_model_or_per_metric_where_they_are_many() -> None:
    comparison = comparison_of("right", "narrow", "wide", metrics="default,scores")
    rows = rows_of(comparison_sheet(comparison, paper=True).latex())
    pairs = next(at for at, row in enumerate(rows) if row[-1] == "adjusted p")
    (head, *models), (others, *values) = rows[:4], rows[4:pairs]
    assert head[0] == "model"
    assert head[2] == r"ECE $\downarrow$"
    assert [row[0] for row in models] == ["right", "narrow", "wide"]
    assert others == ["other metric", *comparison.names]
    by_label = {row[0]: row[1:] for row in values}
    ranks = [comparison.rank("pa_min_mpjpe", name) for name in comparison.names]
    bold = [cell.startswith(r"\textbf") for cell in by_label[r"PA-minMPJPE [mm] $\downarrow$"]]
    assert {*ranks} > {1}
    assert bold == [rank == 1 for rank in ranks]
    for cell, name in zip(by_label[r"PCK 150 mm [\%] $\uparrow$"], comparison.names, strict=True):
        shown = float(cell.removeprefix(r"\textbf{").removesuffix("}"))
        assert abs(shown - 100 * comparison.value("pck", name)) < 0.06
    for row, name in zip(models, comparison.names, strict=True):
        assert row[2].startswith(r"\textbf") is (comparison.rank("ece", name) == 1)
    at = next(at for at, row in enumerate(rows) if at >= pairs and row[0] == r"ECE $\downarrow$")
    for row, one in zip(rows[at + 1 : at + 4], comparison.differences_of("ece"), strict=True):
        assert row[0] == f"{one.first} $-$ {one.second}"
        value, low, high = re.findall(r"[-+][.\d]+", row[1].replace("$-$", "-"))
        assert [value, low, high] == [f"{x:+.{len(value) - 3}f}" for x in (one.value, one.low, one.high)]
        assert row[2] == short_p(one.p_adjusted).replace("<", "$<$")


def test_a_paper_s_table_of_two_models_has_their_differences_in_per_cent_too() -> None:
    comparison = comparison_of("right", "wide", metrics="pck", primary=("pck",))
    (_, row) = rows_of(comparison_sheet(comparison, paper=True).latex())[-2:]
    (one,) = comparison.differences_of("pck")
    assert abs(float(row[1].replace("$-$", "-").split()[0]) - 100 * one.value) < 0.5


def test_a_comparison_has_the_remarks_of_its_models_and_no_word_on_calibration_where_frames_differ() -> None:
    random = np.random.default_rng(0)
    y = people(random, 40)
    x = about(random, y, 20)
    models: dict[str, Any] = {"right": x, "other": x + 1, "flipped": x * [1, -1, -1]}
    about_data = {"unit": "mm", "joints": JOINTS, "labels": {"sequence": np.repeat(np.arange(10), 4)}}
    options: dict[str, Any] = {**about_data, "metrics": "min_mpjpe,ece", "primary": "min_mpjpe,ece"}
    sheet = comparison_sheet(posecal.compare(models, y, **options))
    assert sheet.sentences == ["minMPJPE: none is best beyond chance."]
    (remark,) = sheet.remarks
    assert remark.startswith("flipped: coordinate frames differ: negating y and z in hypotheses turns")
    assert sheet.markdown().splitlines()[4] == f"note: {remark}"
    del models["flipped"]
    sheet = comparison_sheet(posecal.compare(models, y, **options))
    assert sheet.remarks == []
    assert [sentence.split(":")[0] for sentence in sheet.sentences] == [
        "minMPJPE",
        "ECE",
        "No miscalibration shown on average",
    ]


def test_models_of_which_none_is_better_have_no_best() -> None:
    totals = report_of(1.0).totals
    sheet = comparison_sheet(compare_totals([totals, totals], ["a", "b"]))
    assert "ECE: none is best beyond chance." in sheet.sentences
    assert "No miscalibration shown on average: a, b." in sheet.sentences
    assert all(row[-1] == "" for table in sheet.tables for row in table.rows)


def test_the_best_model_is_better_than_each_other_one() -> None:
    comparison = compare_totals([report_of(spread).totals for spread in (1.0, 1.0, 0.5)], ["a", "b", "c"])
    assert [comparison.rank("ece", name) for name in "abc"] == [1, 1, 3]
    assert "ECE: none is best beyond chance." in comparison_sheet(comparison).sentences


def test_a_comparison_shows_headlines_scores_rank_tests_and_what_was_chosen() -> None:
    comparison = comparison_of("right", "narrow", metrics="all")
    sheet = comparison_sheet(comparison)
    rows = {row[0] for table in sheet.tables for row in table.rows}
    worst = comparison.metrics["ece_worst"].label
    assert {"minMPJPE", "CRPS", "TARP about a random point"} <= rows
    assert worst not in rows
    assert sheet.sentences[0] == "energy score: right is best beyond chance."
    chosen = comparison_sheet(comparison_of("right", "narrow", metrics="all", primary=("ece_worst",)))
    assert [row[0] for row in chosen.tables[0].rows] == [worst]
    assert chosen.sentences[0] == f"{worst}: right is best beyond chance."


def test_too_few_sequences_have_dashes_for_p_and_a_note() -> None:
    totals = unlabelled().totals
    sheet = comparison_sheet(compare_totals([totals, totals], ["a", "b"]), for_command_line)
    assert {row[6:8] for table in sheet.tables for row in table.rows} == {("–", "–")}
    assert sheet.remarks[0].startswith("no p-values on 5 frames, and no model is called better; expected at least 6.")


def test_models_without_calibration_or_sequences_are_not_called_calibrated() -> None:
    for report in (report_of(metrics="mpjpe"), unlabelled()):
        sheet = comparison_sheet(compare_totals([report.totals, report.totals], ["a", "b"]))
        assert not any(sentence.startswith("No miscalibration") for sentence in sheet.sentences)
