"""The rows of a report as a data frame, CSV and JSON, and of a saved result that is read again: the same numbers."""

import csv
import io
import json
import math
import tracemalloc
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import jsonschema
import numpy as np
import pandas as pd
import pytest

import posecal
from posecal.calibration import LEVELS
from posecal.demo import sample
from posecal.engine.storage import load_totals, save_totals
from posecal.errors import for_command_line
from posecal.report.report import Report
from posecal.report.table import AUXILIARY, Row, auxiliary_rows
from tests.helpers.reports import FRAMES, SEQUENCES, N, grouped_report, report_of, unlabelled, world

ROW = ["metric", "label", "group", "joint", "value", "unit", "direction", "definition", "poses", "low", "high"]
CURVE = ["definition", "group", "joint", "levels", "coverage"]


def as_json(report: Report) -> dict[str, Any]:
    """A report's JSON, read by rules that refuse NaN and infinity."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return cast(dict[str, Any], json.loads(report.render("json"), parse_constant=refuse))


# --- JSON -----------------------------------------------------------------------------------------------------


def test_json_has_the_documented_keys_and_no_others() -> None:
    found = as_json(grouped_report())
    assert list(found) == [
        "schema",
        "posecal",
        "signature",
        "hypotheses",
        "poses",
        "joints",
        "remarks",
        "summary",
        "rows",
        "curves",
    ]
    assert {tuple(row) for row in found["rows"]} == {tuple(ROW)}
    assert {tuple(sorted(curve)) for curve in found["curves"]} == {tuple(sorted(CURVE))}


SCHEMA = json.loads(files("posecal.report").joinpath("schema.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    "report",
    [
        lambda: report_of(metrics="all", by=("action", "occlusion")),
        lambda: unlabelled(n=1),
        lambda: unlabelled(poses=1),
        lambda: report_of(metrics="min_mpjpe"),
    ],
)
def test_json_keeps_to_its_published_schema(report: Any) -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.Draft202012Validator(SCHEMA).validate(as_json(report()))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda found: found.pop("remarks"), "'remarks' is a required property"),
        (lambda found: found.update(schema=2), "1 was expected"),
        (lambda found: found.update(more=1), "Additional properties are not allowed"),
        (lambda found: found["rows"][0].update(direction="up"), "'up' is not one of"),
        (lambda found: found["rows"][0].update(group="walking"), "does not match"),
        (lambda found: found["rows"][0].update(poses=1.5), "1.5 is not of type 'integer'"),
        (lambda found: found["rows"][0].update(value="1"), "'1' is not of type 'number', 'null'"),
        (lambda found: found["curves"][0].update(definition="other"), "'other' is not one of"),
    ],
)
def test_the_schema_refuses_what_is_no_report(change: Any, words: str) -> None:
    found = as_json(grouped_report())
    change(found)
    with pytest.raises(jsonschema.ValidationError, match=words):
        jsonschema.Draft202012Validator(SCHEMA).validate(found)


def test_remarks_and_summary_are_in_the_json_as_the_report_gives_them() -> None:
    report = report_of()
    found = as_json(report)
    assert found["schema"] == 1
    assert found["remarks"] == list(report.remarks) != []
    assert found["summary"] == list(report.summary) != []
    assert report.to_dict() == found


def test_json_says_what_was_measured() -> None:
    found = as_json(grouped_report())
    assert found["posecal"] == posecal.__version__
    assert found["signature"] == grouped_report().signature
    assert (found["hypotheses"], found["poses"]) == (N, SEQUENCES * FRAMES)
    assert found["joints"] == list(posecal.JOINT_SETS["h36m-17"])


def test_rows_are_named_in_snake_case_and_have_known_directions_and_units() -> None:
    rows = as_json(report_of(metrics="all"))["rows"]
    for row in rows:
        assert row["metric"].isascii()
        assert row["metric"].replace("_", "a").isalnum()
        assert row["metric"] == row["metric"].lower()
        assert row["direction"] in {"lower", "higher", "zero", "none"}
        assert row["unit"] in {"", "mm", *(f"mm/{of}{power}" for of in ("frame", "s") for power in ("", "²", "³"))}
    named = {row["metric"] for row in rows}
    promised = {"min_mpjpe", "mpjpe", "pa_min_mpjpe", "pck", "auc", "cps", "ece", "ece_paper", "ece_reference"}
    assert promised | {"signed_area", "coverage_90", "diversity"} <= named


def test_every_number_is_in_the_json_once() -> None:
    keys = [(row["metric"], row["group"], row["joint"]) for row in as_json(grouped_report())["rows"]]
    assert len(keys) == len(set(keys))


def test_json_gives_nothing_where_nothing_is_known() -> None:
    rows = as_json(unlabelled(n=1))["rows"]
    (row,) = (row for row in rows if row["metric"] == "min_mpjpe" and row["joint"] is None)
    assert row["value"] > 0
    assert all(row["low"] is None for row in as_json(unlabelled(n=1, poses=1))["rows"])
    assert not any(isinstance(value, float) and math.isnan(value) for row in rows for value in row.values())


def test_the_curves_of_the_json_make_the_reported_ece() -> None:
    """The exchangeable ECE is the mean gap between the median joint's curve and the diagonal."""
    found = as_json(grouped_report())
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


@pytest.mark.parametrize("asked", [False, True])
def test_there_is_a_curve_for_each_definition_group_and_joint(asked: bool) -> None:
    """At the joints of groups only where they are asked for: of many groups they would be most of the file."""
    report = report_of(metrics="ece, ece_paper", by=("action",))
    found = json.loads(report.render("json", joints=asked))["curves"]
    assert report.to_dict(joints=asked)["curves"] == found
    groups = [None, "action=sitting", "action=standing", "action=walking"]
    joints = [None, *posecal.JOINT_SETS["h36m-17"][1:]]  # the root is always at 0
    keys = {(c["definition"], c["group"], c["joint"]) for c in found}
    wanted = ((g, j) for g in groups for j in joints if asked or g is None or j is None)
    assert keys == {(d, *at) for at in wanted for d in ("exchangeable", "paper")}
    assert len(found) == len(keys)
    assert {tuple(c["levels"]) for c in found} == {tuple(LEVELS.tolist())}
    assert {len(c["coverage"]) for c in found} == {LEVELS.size}


def test_json_has_a_line_for_each_row_and_each_curve() -> None:
    report = grouped_report()
    lines = report.render("json").splitlines()
    assert [json.loads(line.rstrip(",")) for line in lines if line.startswith('  {"metric"')] == as_json(report)["rows"]
    assert sum(line.startswith('  {"definition"') for line in lines) == len(as_json(report)["curves"])


@pytest.mark.slow
def test_json_of_many_groups_is_small_and_so_is_the_memory_that_it_takes() -> None:
    groups = 100
    random = np.random.default_rng(0)
    truth = random.normal(0, 300, (2 * groups, 5, 3))
    report = posecal.evaluate(
        truth + random.normal(0, 40, (4, 2 * groups, 5, 3)),
        truth,
        unit="mm",
        labels={"action": np.arange(2 * groups) // 2, "sequence": np.arange(2 * groups) % 7},
        by="action",
    )
    tracemalloc.start()
    try:
        text = report.render("json")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(text) < 16_000 * groups
    assert peak < 5e6 + 150_000 * groups


def test_letters_of_other_alphabets_stay_as_they_are() -> None:
    here = world()
    report = posecal.evaluate(
        sample(here, 3), here.truth, labels={"sequence": here.sequence, "action": here.action}, axes="NMKD", unit="mm"
    )
    assert "τ" in report.render("json")


# --- data frame and CSV -------------------------------------------------------------------------------------------


def test_csv_reads_back_as_the_table_and_the_remarks() -> None:
    frame = grouped_report().table
    assert list(frame.columns) == ROW
    assert len(frame) == len(grouped_report().rows)
    assert frame.attrs == {"remarks": list(grouped_report().remarks), "signature": grouped_report().signature}
    words = {"group": object, "joint": object, "unit": object}
    back = pd.read_csv(io.StringIO(grouped_report().render("csv")), dtype=words)
    back["unit"] = back["unit"].fillna("")
    for column in ("group", "joint", "unit"):
        back[column] = back[column].astype(object).mask(back[column].isna(), None)
        frame[column] = frame[column].astype(object).mask(frame[column].isna(), None)
    remarks = back[back["metric"] == "remark"]
    assert list(remarks["definition"]) == list(grouped_report().remarks) != []
    assert remarks["value"].isna().all()
    assert (remarks["poses"] == 0).all()
    pd.testing.assert_frame_equal(back[back["metric"] != "remark"], frame, check_dtype=False)
    assert frame["poses"].dtype.kind == "i"
    assert ",36,," in grouped_report().render("csv")


def test_a_table_that_the_user_changes_is_not_the_report_s() -> None:
    table = grouped_report().table
    table["value"] = 0.0
    assert (grouped_report().table["value"] != 0).any()


def test_csv_has_one_line_per_row_under_its_heading() -> None:
    lines = list(csv.reader(io.StringIO(grouped_report().render("csv"))))
    assert lines[0] == ROW == [field.name for field in fields(Row)]
    assert len(lines) == 1 + len(grouped_report().rows) + len(grouped_report().remarks)


def test_remarks_in_files_name_flags_where_they_are_asked_to() -> None:
    report = unlabelled()
    assert any("root_joint" in remark for remark in report.remarks)
    assert "--root-joint" in report.render("csv", words=for_command_line)
    assert "--root-joint" in json.loads(report.render("json", words=for_command_line))["remarks"][0]
    assert "--root-joint" not in report.render("json") + report.render("csv")


# --- numbers beside metrics -----------------------------------------------------------------------------------


def test_every_number_beside_a_metric_is_described() -> None:
    report = report_of(metrics="all")
    assert {row.key for row in report.auxiliary.values()} == set(AUXILIARY)
    for name, row in report.auxiliary.items():
        assert name == row.name
        assert row.metric in report.metrics
        assert "{}" not in row.label + row.definition
        assert row.definition in report.definition(name)
        assert all((row.label, row.range, row.reading, row.source))


def test_which_numbers_stand_beside_which_metrics() -> None:
    beside = report_of(metrics="all").auxiliary
    assert {beside[name].metric for name in ("ece_p", "ece_floor", "effective_poses", "squared_error")} == {"ece"}
    names = set(auxiliary_rows(report_of(metrics="all").metrics))
    errors = {"ece", "ece_paper", "ece_reference"}
    assert {name for name in names if name.endswith("_floor")} == {f"{name}_floor" for name in errors}
    tests = {name.removesuffix("_p_adjusted") for name in names if name.endswith("_p_adjusted")}
    assert tests == set(report_of(metrics="all").rank_tests())
    assert {name.removesuffix("_p") for name in names if name.endswith("_p")} == tests | {
        *errors,
        *(f"{name}_{ending}" for name in errors for ending in ("mean", "worst")),
    }
    assert {"effective_poses", "squared_error"} <= names
    assert auxiliary_rows({"mpjpe": report_of().metrics["mpjpe"]}) == {}


# --- saved and read again --------------------------------------------------------------------------------------


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
    assert read_again(grouped_report(), tmp_path).render(form) == grouped_report().render(form)


def test_a_result_read_twice_and_saved_again_is_the_same_file(tmp_path: Path) -> None:
    grouped_report().save(tmp_path / "one.npz")
    save_totals(load_totals(tmp_path / "one.npz"), tmp_path / "two.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_a_result_is_small(tmp_path: Path) -> None:
    report_of(metrics="all").save(tmp_path / "result.npz")
    assert (tmp_path / "result.npz").stat().st_size < 300_000
