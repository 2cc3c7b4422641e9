"""A report as JSON, CSV, text and Markdown, and a saved result that is read again: the same numbers."""

import csv
import io
import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

import posecal
from posecal.calibration import LEVELS
from posecal.demo import sample
from posecal.engine.storage import load_totals, save_totals
from posecal.report.report import Report, Row
from tests.helpers.reports import FRAMES, SEQUENCES, N, report_of, unlabelled, world

ROW = ["metric", "label", "group", "joint", "value", "unit", "direction", "definition", "poses", "low", "high"]
CURVE = ["definition", "group", "joint", "levels", "coverage"]


def as_json(report: Report) -> dict[str, Any]:
    """A report's JSON, read by rules that refuse NaN and infinity."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return cast(dict[str, Any], json.loads(report.render("json"), parse_constant=refuse))


def some() -> Report:
    return report_of(by=("action", "occlusion"))


# --- JSON -----------------------------------------------------------------------------------------------------


def test_json_has_the_documented_keys_and_no_others() -> None:
    found = as_json(some())
    assert list(found) == ["posecal", "signature", "hypotheses", "poses", "joints", "rows", "curves"]
    assert {tuple(row) for row in found["rows"]} == {tuple(ROW)}
    assert {tuple(curve) for curve in found["curves"]} == {tuple(CURVE)}


def test_json_says_what_was_measured() -> None:
    found = as_json(some())
    assert found["posecal"] == posecal.__version__
    assert found["signature"] == some().signature
    assert (found["hypotheses"], found["poses"]) == (N, SEQUENCES * FRAMES)
    assert found["joints"] == list(posecal.JOINT_SETS["h36m-17"])


def test_rows_are_named_in_snake_case_and_have_known_directions_and_units() -> None:
    rows = as_json(report_of(metrics="all"))["rows"]
    for row in rows:
        assert row["metric"].isascii()
        assert row["metric"].replace("_", "a").isalnum()
        assert row["metric"] == row["metric"].lower()
        assert row["direction"] in {"lower", "higher", "zero", "none"}
        assert row["unit"] in {"", "mm", "mm/frame", "mm/s"}
    named = {row["metric"] for row in rows}
    promised = {"min_mpjpe", "mpjpe", "pa_min_mpjpe", "pck", "auc", "cps", "ece", "ece_paper", "ece_reference"}
    assert promised | {"signed_area", "coverage_90", "diversity"} <= named


def test_every_number_is_in_the_json_once() -> None:
    keys = [(row["metric"], row["group"], row["joint"]) for row in as_json(some())["rows"]]
    assert len(keys) == len(set(keys))


def test_json_gives_nothing_where_nothing_is_known() -> None:
    rows = as_json(unlabelled(n=1))["rows"]
    (row,) = (row for row in rows if row["metric"] == "min_mpjpe" and row["joint"] is None)
    assert row["value"] > 0
    assert all(row["low"] is None for row in as_json(unlabelled(n=1, poses=1))["rows"])
    assert not any(isinstance(value, float) and math.isnan(value) for row in rows for value in row.values())


def test_the_curves_of_the_json_make_the_reported_ece() -> None:
    """The exchangeable ECE is the mean gap between the median joint's curve and the diagonal."""
    found = as_json(some())
    joints = [
        curve["coverage"]
        for curve in found["curves"]
        if curve["definition"] == "exchangeable" and curve["group"] is None and curve["joint"] is not None
    ]
    (ece,) = (
        row["value"] for row in found["rows"] if (row["metric"], row["group"], row["joint"]) == ("ece", None, None)
    )
    median = np.median(np.array(joints), axis=0)
    np.testing.assert_allclose(np.abs(median - LEVELS).mean(), ece, atol=1e-12)


def test_there_is_a_curve_for_each_definition_group_and_joint() -> None:
    found = as_json(report_of(metrics="ece, ece_paper", by=("action",)))["curves"]
    groups = [None, "action=sitting", "action=standing", "action=walking"]
    joints = [None, *posecal.JOINT_SETS["h36m-17"][1:]]  # the root is always at 0
    keys = {(c["definition"], c["group"], c["joint"]) for c in found}
    assert keys == {(d, g, j) for d in ("exchangeable", "paper") for g in groups for j in joints}
    assert len(found) == len(keys)
    assert {tuple(c["levels"]) for c in found} == {tuple(LEVELS.tolist())}
    assert {len(c["coverage"]) for c in found} == {LEVELS.size}


def test_letters_of_other_alphabets_stay_as_they_are() -> None:
    here = world()
    report = posecal.evaluate(
        sample(here, 3), here.truth, labels={"sequence": here.sequence, "action": here.action}, by=["action"]
    )
    assert "τ" in report.render("json")


# --- CSV and frames -------------------------------------------------------------------------------------------


def test_csv_reads_back_as_the_frame() -> None:
    frame = some().frame()
    assert list(frame.columns) == ROW
    assert len(frame) == len(some().rows)
    words = {"group": object, "joint": object, "unit": object}
    back = pd.read_csv(io.StringIO(some().render("csv")), keep_default_na=False, na_values=["nan"], dtype=words)
    for column in ("group", "joint"):
        back[column] = back[column].mask(back[column] == "", None)
        frame[column] = frame[column].astype(object).mask(frame[column].isna(), None)
    pd.testing.assert_frame_equal(back, frame, check_dtype=False)


def test_csv_has_one_line_per_row_under_its_heading() -> None:
    lines = list(csv.reader(io.StringIO(some().render("csv"))))
    assert lines[0] == ROW == [field.name for field in fields(Row)]
    assert len(lines) == 1 + len(some().rows)


# --- kept and read again --------------------------------------------------------------------------------------


def read_again(report: Report, folder: Path) -> Report:
    report.save(folder / "result.npz")
    return Report(load_totals(folder / "result.npz"), report.by)


@pytest.mark.parametrize("form", ["text", "markdown"])
def test_a_saved_result_reads_the_same_later(form: Any, tmp_path: Path) -> None:
    report = report_of(metrics="all", by=("action",))
    again = read_again(report, tmp_path)
    assert again.render(form, joints=True, definitions=True) == report.render(form, joints=True, definitions=True)
    assert again.remarks == report.remarks


@pytest.mark.parametrize("form", ["csv", "json"])
def test_a_saved_result_holds_the_same_numbers_later(form: Any, tmp_path: Path) -> None:
    assert read_again(some(), tmp_path).render(form) == some().render(form)


def test_a_result_read_twice_and_saved_again_is_the_same_file(tmp_path: Path) -> None:
    some().save(tmp_path / "one.npz")
    save_totals(load_totals(tmp_path / "one.npz"), tmp_path / "two.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_a_result_is_small(tmp_path: Path) -> None:
    report_of(metrics="all").save(tmp_path / "result.npz")
    assert (tmp_path / "result.npz").stat().st_size < 300_000


# --- what a person sees ---------------------------------------------------------------------------------------


def test_the_default_report_fits_a_screen() -> None:
    lines = str(report_of()).splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines[:-1])) <= 120  # the signature must stay one line


def test_it_begins_with_what_was_measured_and_ends_with_the_signature() -> None:
    lines = str(report_of()).splitlines()
    assert lines[0] == (
        f"posecal {posecal.__version__} · N = 12 hypotheses · M = 36 poses in 12 sequences · K = 17 joints, "
        "relative to Hip"
    )
    assert lines[-1] == f"signature: {report_of().signature}"


def test_every_ece_stands_with_its_definition_and_what_a_perfect_sampler_shows() -> None:
    text = str(report_of())
    (line,) = (line for line in text.splitlines() if line.startswith("ECE  "))
    assert "exchangeable; median of 16 joints (no root); " in line
    floor = report_of().value("ece_floor")
    assert f"{floor:.4f} if" in text
    (line,) = (line for line in text.splitlines() if line.startswith("ECE (paper)"))
    assert f"{report_of().value('ece_paper'):.5f}" in line


def test_markdown_has_a_table_for_each_family_label_and_joint() -> None:
    text = some().render("markdown", joints=True, definitions=True)
    headings = [line.removeprefix("### ") for line in text.splitlines() if line.startswith("### ")]
    assert headings == ["Accuracy", "Calibration", "Spread", "By action", "By occlusion", "By joint", "Definitions"]
    for table in text.split("### ")[1:-1]:
        bars = {line.count("|") for line in table.splitlines() if line.startswith("|")}
        assert len(bars) == 1


def test_a_label_with_a_bar_stays_in_its_cell() -> None:
    here = world()
    report = posecal.evaluate(
        sample(here, 3),
        here.truth,
        labels={"sequence": here.sequence, "action": np.char.add(here.action, "|x<b>\ny")},
        by=["action"],
    )
    (line,) = (line for line in report.render("markdown").splitlines() if "sitting" in line)
    assert line.startswith("| sitting\\|x&lt;b> y | ")
