"""Tables of the page hold the numbers of the report, the keys to sort by, and places on axes."""

import math

import numpy as np
import pytest

import posecal
from posecal.report.page_tables import MOST_ROWS, joint_table, label_table, metric_table, sequence_table
from posecal.report.report import Report
from tests.helpers.reports import report_of, unlabelled

REPORT = report_of(metrics="all", by=("action",))


def test_a_metric_has_its_value_interval_and_direction() -> None:
    rows = {row[0].text: row for row in metric_table(REPORT).rows}
    assert list(rows) == [metric.label for metric in REPORT.headline_metrics.values()]
    _, value, interval, p, best, about = rows["minMPJPE"]
    low, high = REPORT.interval("min_mpjpe")
    assert (value.text, value.key) == ("56 mm", REPORT["min_mpjpe"])
    assert interval.text == f"{low:.0f} to {high:.0f}"
    assert interval.key == high - low
    assert (p.text, best.text) == ("", "lower")
    assert about.text == REPORT.metrics["min_mpjpe"].brief


def test_intervals_are_drawn_in_proportion_on_one_axis_of_a_family_and_unit() -> None:
    rows = {row[0].text: row for row in metric_table(REPORT).rows}
    drawn = {label: rows[label][2].drawn for label in ("minMPJPE", "MPJPE")}
    one, other = drawn["minMPJPE"], drawn["MPJPE"]
    assert one is not None
    assert other is not None
    assert one.low is not None
    assert one.high is not None
    assert one.low < one.value < one.high <= 100
    assert one.value / other.value == pytest.approx(REPORT["min_mpjpe"] / REPORT["mpjpe"], rel=0.02)
    assert (one.low / one.value) == pytest.approx(REPORT.interval("min_mpjpe")[0] / REPORT["min_mpjpe"], rel=0.02)


def test_a_calibration_error_has_the_range_of_a_calibrated_model_and_p() -> None:
    row = next(row for row in metric_table(REPORT).rows if row[0].text == "ECE")
    test = REPORT.test("ece")
    assert row[2].text == f"to {test.high:.3f} if calibrated"
    assert (row[3].text, row[3].key) == (f"{test.p:.3f}", test.p)
    drawn = row[2].drawn
    assert drawn is not None
    assert (drawn.is_null, drawn.low) == (True, 0)
    assert drawn.high is not None
    assert drawn.value / drawn.high == pytest.approx(REPORT["ece"] / test.high, rel=0.05)


def test_signed_areas_and_coverages_have_their_best_value_marked() -> None:
    rows = {row[0].text: row for row in metric_table(REPORT).rows}
    for label, name, best in (("signed area", "signed_area", 0.0), ("coverage at 80 %", "coverage_80", 0.8)):
        drawn = rows[label][2].drawn
        assert drawn is not None
        assert drawn.best is not None
        assert (drawn.value > drawn.best) == (REPORT[name] > best)


def test_sequences_stand_from_the_largest_ece_to_the_smallest_with_the_numbers_of_a_group() -> None:
    table = sequence_table(REPORT)
    assert table is not None
    grouped = Report(REPORT.totals, by="sequence")
    names = [row[0].text for row in table.rows]
    eces = [grouped.value("ece", f"sequence={name}") for name in names]
    assert eces == sorted(eces, reverse=True)
    assert len(names) == 12
    for row, ece in zip(table.rows, eces, strict=True):
        group = f"sequence={row[0].text}"
        keys = [ece, *(grouped.value(name, group) for name in ("signed_area", "min_mpjpe", "mpjpe"))]
        np.testing.assert_allclose([cell.key for cell in row[3:]], keys, rtol=1e-12)
        assert row[1].text == "3"
        points = np.array([pair.split() for pair in row[2].curve[1:].split("L")], dtype=float)
        np.testing.assert_allclose(1 - points[:, 1] / 40, grouped.summary_curve(group=group), atol=0.002)


def test_there_is_no_table_of_sequences_where_there_are_none() -> None:
    assert sequence_table(unlabelled(poses=12)) is None


def test_groups_and_joints_have_their_numbers_with_intervals() -> None:
    row = next(row for row in label_table(REPORT, "action").rows if row[0].text == "walking")
    assert row[1].text == "12"
    assert row[3].key == REPORT.value("min_mpjpe", "action=walking")
    table = joint_table(REPORT)
    assert table is not None
    head = next(row for row in table.rows if row[0].text == "Head")
    assert head[1].key == REPORT.value("min_mpjpe", joint="Head")
    low, high = REPORT.interval("min_mpjpe", joint="Head")
    assert head[1].hint == f"95 % interval {low:.0f} to {high:.0f}"
    hip = next(row for row in table.rows if row[0].text == "Hip")
    assert [cell.key for cell, (name, _) in zip(hip, table.columns, strict=True) if name == "ECE"] == [None]


def test_of_many_rows_the_worst_are_shown_in_their_order() -> None:
    random = np.random.default_rng(2)
    truth = random.normal(0, 300, (8, MOST_ROWS + 3, 3))

    report = posecal.evaluate(
        truth + random.normal(0, 40, (3, *truth.shape)), truth, unit="mm", axes="NMKD", metrics="ece", root_joint="none"
    )
    table = joint_table(report)
    assert table is not None
    assert len(table.rows) == MOST_ROWS
    assert table.note.startswith(f"The {MOST_ROWS} worst of {MOST_ROWS + 3} by ")
    keys = [int(row[0].key or 0) for row in table.rows]
    assert keys == sorted(keys)
    left_out = {*range(MOST_ROWS + 3)} - {*keys}
    name = next(name for name, m in reversed(report.metrics.items()) if m.in_joint_table)
    values = [abs(report.value(name, joint=joint)) for joint in report.totals.spec.joints]
    values = [0.0 if math.isnan(value) else value for value in values]
    assert max(values[row] for row in left_out) <= min(values[row] for row in keys)
