"""The sheets of reports, recalibrations and presets: what stands on them, in every form."""

import re
from dataclasses import fields

import numpy as np
import pytest
from rich.cells import cell_len

import posecal
from posecal.demo import sample
from posecal.engine.presets import PRESETS
from posecal.engine.protocol import Protocol
from posecal.errors import for_command_line
from posecal.report import text as text_module
from posecal.report.format import short_p
from posecal.report.report import Report
from posecal.report.text import presets_sheet, report_sheet
from tests.helpers.latex import rows_of
from tests.helpers.reports import grouped_report, report_of, unlabelled, world


def squeezed(text: str) -> str:
    """Text without its spaces and lines."""
    return re.sub(r"[\s─━]+", "", text)


# --- reports --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "most"), [(80, 40), (100, 25), (120, 25)])
@pytest.mark.parametrize("spread", [0.5, 1.0])
def test_the_default_report_fits_a_screen(spread: float, width: int, most: int) -> None:
    *lines, signature = report_of(spread).render(width=width).splitlines()
    assert max(map(cell_len, lines)) <= width
    assert len(lines) - (-cell_len(signature) // width) <= most  # the signature is one line, which a terminal breaks


def test_what_is_left_out_is_named_with_what_shows_it() -> None:
    report = report_of()
    brief, all_numbers = report_sheet(report, words=for_command_line), report_sheet(report, all=True)
    rows = [row[0] for table in brief.tables for row in table.rows]
    hidden = [row[0] for table in all_numbers.tables for row in table.rows if row[0] not in rows]
    assert {"mean-pose MPJPE", "ECE (paper)", "diversity"} < {*hidden}
    assert set(rows) < {row[0] for table in all_numbers.tables for row in table.rows}
    assert brief.more == (
        "--all: what each number is, and mean-pose MPJPE, AUC of PCK, CPS, ECE (paper), coverage at 50 %, 80 %, "
        "radius of 90 %, diversity, rank correlation of spread and error."
    )
    assert brief.more.replace("--all", "all=True") in " ".join(report.render().split())
    assert all_numbers.more == ""


def test_metrics_that_are_asked_for_are_on_the_first_screen() -> None:
    assert [row[0] for row in report_sheet(report_of(metrics="diversity,ece")).tables[0].rows] == ["ECE", "diversity"]
    report = report_of(metrics="default,scores")
    main, scores = report_sheet(report).tables
    assert (main.title, scores.title) == ("Metric", "Proper score")
    assert [row[0] for row in scores.rows] == [m.label for m in report.metrics.values() if m.family == "scores"]


def test_it_begins_with_what_was_measured_and_ends_with_the_signature() -> None:
    lines = str(report_of()).splitlines()
    assert lines[0] == (
        f"posecal {posecal.__version__} · N = 12 hypotheses · M = 36 poses in 12 sequences · K = 17 joints, "
        "relative to Hip"
    )
    assert lines[-1] == f"signature: {report_of().signature}"


def test_every_ece_stands_with_its_definition_and_what_a_perfect_sampler_shows() -> None:
    ece, paper = (cells(report_of(), label) for label in ("ECE", "ECE (paper)"))
    floor = report_of().value("ece_floor")
    assert ece["what it is"] == (
        f"exchangeable; median of 16 joints (no root); calibrated, independent frames: {floor:.4f}"
    )
    assert paper["value"] == f"{report_of().value('ece_paper'):.3f}"


def cells(report: Report, label: str) -> dict[str, str]:
    """The cells of the row of this label, among all numbers."""
    tables = report_sheet(report, all=True).tables
    ((table, row),) = ((table, row) for table in tables for row in table.rows if row[0] == label)
    return dict(zip(table.headings[1:], row[1:], strict=True))


def test_each_number_stands_with_its_interval_direction_and_meaning() -> None:
    report = report_of()
    low, high = report.interval("min_mpjpe")
    brief = report.metrics["min_mpjpe"].brief
    assert 10 < high - low < 100  # two significant digits of the width are no digit after the point
    value = f"{report['min_mpjpe']:.0f} mm"
    assert cells(report, "minMPJPE") == {
        "": "↓",
        "value": value,
        "95 % interval": f"{low:.0f} to {high:.0f}",
        "what it is": brief,
    }
    low, high = report.interval("signed_area")
    assert 0.1 < high - low < 1
    area = cells(report, "signed area")
    assert (area["value"], area["95 % interval"]) == (f"{report['signed_area']:.2f}", f"{low:.2f} to {high:.2f}")
    assert [cells(report, label)["if calibrated"] for label in ("signed area", "coverage at 80 %")] == ["0", "0.8"]


def test_a_calibration_error_stands_with_those_of_a_calibrated_sampler_and_its_p_value() -> None:
    report = report_of()
    test = report.test("ece")
    assert test.high > 0.01  # three digits write it
    expected = ["↓", f"{report['ece']:.3f}", "", f"{test.mean:.3f}", f"{test.high:.3f}", f"{test.p:.3f}"]
    assert [*cells(report, "ECE").values()][:6] == expected
    assert cells(report_of(0.5), "ECE")["p"] == "< 0.001"


def test_a_rank_test_stands_with_its_adjusted_p_value() -> None:
    report = report_of(2.5, metrics="rank_tests")
    (table,) = report_sheet(report).tables
    assert list(table.headings) == ["Rank test", "", "value", "if calibrated", "up to", "adjusted p"]
    for name, (test, p) in report.rank_tests().items():
        row = cells(report, report.metrics[name].label)
        shown = "< 0.001" if p < 0.001 else f"{p:.3f}"
        assert [*row.values()][2:5] == [f"{test.mean:.3f}", f"{test.high:.3f}", shown]


def test_calibration_errors_and_rank_tests_keep_their_own_p_values_side_by_side() -> None:
    report = report_of(2.5, metrics="default, rank_tests")
    headings = {table.title: table.headings[-1] for table in report_sheet(report).tables}
    assert headings == {"Metric": "p", "Rank test": "adjusted p"}
    assert cells(report, "ECE")["p"] == ("< 0.001" if report["ece_p"] < 0.001 else f"{report['ece_p']:.3f}")


@pytest.mark.parametrize("form", ["markdown", "html"])
def test_in_every_form_but_a_paper_s_the_null_its_quantile_and_the_p_value_have_a_column_each(form: str) -> None:
    report = report_of(2.5, metrics="default, rank_tests")
    text = report._repr_html_() if form == "html" else report.render(form)  # type: ignore[arg-type]
    headings = re.sub(r"<[^>]*>|\|", " | ", text).replace("&nbsp;", " ")
    for p in ("p", "adjusted p"):
        assert len(re.findall(rf"\| +if calibrated[ |\n]+\| +up to[ |\n]+\| +{p} ", headings)) == 1


def test_groups_without_numbers_to_show_have_their_poses() -> None:
    table = report_sheet(report_of(metrics="crps", by=("action",))).tables[-1]
    assert list(table.headings) == ["action", "poses"]
    assert [row[1] for row in table.rows] == ["12", "12", "12"]


def test_the_poses_of_a_group_are_those_of_the_number_that_most_count_in() -> None:
    """All but hip and spine, none of them PCK's, are masked in four of the twelve poses of every action."""
    here = world()
    where = np.ones(here.truth.shape[:2], dtype=bool)
    where[::3] = False
    where[::3, [0, 7]] = True
    labels = {"sequence": here.sequence, "action": here.action}
    report = posecal.evaluate(
        sample(here, 3), here.truth, joints="h36m-17", labels=labels, where=where, by="action", axes="NMKD", unit="mm"
    )
    group = "action=sitting"
    assert (report.count("mpjpe", group), report.count("pck", group)) == (12, 8)
    assert [row[1] for row in report_sheet(report).tables[-1].rows] == ["12", "12", "12"]


def test_the_chance_of_a_perfect_sampler_is_left_out_of_a_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    for most, shown in ((17, True), (16, False)):
        monkeypatch.setattr(text_module, "MESH", most)
        assert ("; calibrated, independent frames: 0.0" in cells(report_of(), "ECE")["what it is"]) is shown


def test_where_nothing_can_be_tested_no_p_value_is_shown() -> None:
    ece = cells(unlabelled(), "ECE")
    assert [ece[heading] for heading in ("if calibrated", "up to", "p")] == ["–", "–", "no test"]


def test_remarks_stand_under_the_title_in_every_form() -> None:
    report = unlabelled()
    assert len(report.remarks) >= 3
    text, markdown, latex = (report.render(form, width=1000) for form in ("text", "markdown", "latex"))
    for remark in report.remarks:
        assert f"note: {remark}" in text.splitlines()
        assert f"note: {remark}" in markdown.splitlines()
        assert f"% note: {remark}" in latex.splitlines()
    assert "--root-joint" in report.render("text", words=for_command_line)
    assert "--root-joint" not in text


def test_the_table_of_a_label_has_a_row_per_group_with_its_numbers() -> None:
    (table,) = (table for table in report_sheet(grouped_report()).tables if table.title == "By action")
    names = [name for name, metric in grouped_report().metrics.items() if metric.in_group_table]
    assert list(table.headings) == ["action", "poses", *(grouped_report().metrics[n].label for n in names)]
    for row in table.rows:
        group = f"action={row[0]}"
        assert row[1] == str(grouped_report().count("mpjpe", group)) == "12"
        for name, cell in zip(names, row[2:], strict=True):
            assert cell == f"{grouped_report().value(name, group):.{1 if grouped_report().metrics[name].unit else 3}f}"


def test_the_table_of_occlusion_has_the_numbers_of_occluded_and_visible_joints() -> None:
    (table,) = (table for table in report_sheet(grouped_report()).tables if table.title == "By occlusion")
    assert [row[0] for row in table.rows] == ["occluded", "visible"]
    assert table.rows[0][2] == f"{grouped_report().value('min_mpjpe', 'occlusion=occluded'):.1f}"
    assert table.rows[1][2] == f"{grouped_report().value('min_mpjpe', 'occlusion=visible'):.1f}"
    assert table.rows[0][1] == str(grouped_report().count("mpjpe", "occlusion=occluded"))


def test_the_table_of_joints_has_a_row_per_joint_and_no_number_where_none_counts() -> None:
    table = report_sheet(report_of(), joints=True).tables[-1]
    assert [row[0] for row in table.rows] == list(posecal.JOINT_SETS["h36m-17"])
    names = [name for name, metric in report_of().metrics.items() if metric.in_joint_table]
    column = 1 + names.index("ece")
    assert table.rows[0][column] == "–"
    assert table.rows[3][column] == f"{report_of().value('ece', joint='RFoot'):.3f}"


def test_there_is_no_table_of_joints_without_numbers_of_joints() -> None:
    report = report_of(metrics="energy_score")
    text = report.render(joints=True)
    assert "note: no table of joints: none of these metrics has a number for each." in text.splitlines()
    assert "RFoot" not in text


def test_latex_has_every_table_and_is_ascii_but_for_words() -> None:
    latex = report_of(metrics="all", by=("action",)).render("latex", all=True)
    titles = ["Accuracy", "Calibration", "Rank test", "Proper score", "Sharpness", "By action"]
    assert [title for title in titles if f"% {title}\n" in latex or f"% {title} (1 of " in latex] == titles
    numbers = {row[0]: row for row in reversed(rows_of(latex))}
    low, high = report_of().interval("min_mpjpe")
    assert numbers[r"minMPJPE [mm] $\downarrow$"][1] == f"{report_of()['min_mpjpe']:.0f} ({low:.0f} to {high:.0f})"
    assert "\n% ECE: " in latex  # what it is, in no column


def test_a_paper_has_the_null_and_its_quantile_in_one_column() -> None:
    report = report_of(2.5)
    (head, *rows) = rows_of(report.render("latex"))
    assert head == ["Metric", r"value (95 \% interval)", "if calibrated", "p"]
    test = report.test("ece")
    assert [row[2:] for row in rows if row[0].startswith("ECE")] == [
        [f"{test.mean:.3f} (up to {test.high:.3f})", short_p(test.p).replace("<", "$<$")]
    ]


def test_papers_have_pck_in_per_cent_and_minus_signs() -> None:
    report = report_of(0.5, by=("action",))
    rows = rows_of(report.render("latex"))
    numbers = {row[0]: row[1] for row in reversed(rows)}
    assert float(numbers[r"PCK 150 mm [\%] $\uparrow$"].split()[0]) == pytest.approx(100 * report["pck"], abs=0.5)
    assert numbers["signed area"].startswith("$-$0.")
    (at,) = (at for at, row in enumerate(rows) if row[0] == "action")  # turned: a row is a metric
    (of_actions,) = (row for row in rows[at:] if row[0].startswith("PCK"))
    shown = float(of_actions[rows[at].index("sitting")])
    assert shown == pytest.approx(100 * report.value("pck", "action=sitting"), abs=0.05)


def test_markdown_has_a_table_for_each_family_label_and_joint() -> None:
    text = grouped_report().render("markdown", all=True, joints=True, definitions=True)
    headings = [line.removeprefix("### ") for line in text.splitlines() if line.startswith("### ")]
    assert headings == [
        "Accuracy",
        "Calibration",
        "Sharpness",
        "By action",
        "By occlusion",
        "By joint",
        "Definitions",
    ]
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
        axes="NMKD",
        unit="mm",
    )
    (line,) = (line for line in report.render("markdown").splitlines() if "sitting" in line)
    assert re.match(r"\| sitting\\\|x&lt;b>\\\\ny +\| ", line)


@pytest.mark.parametrize("width", [60, 80, 100])
def test_a_report_is_whole_on_a_narrow_terminal(width: int) -> None:
    sheet = report_sheet(report_of(by=("action", "occlusion")), all=True, joints=True, definitions=True)
    narrow, wide = sheet.text(width), sheet.text(400)
    assert max(map(cell_len, narrow.splitlines()[:-1])) <= width
    numbers = re.compile(r"(?<![\w.])-?\d+\.\d+(?![\w.])")
    assert sorted(numbers.findall(narrow)) == sorted(numbers.findall(wide))


def test_the_presets_are_all_listed_with_what_they_set() -> None:
    text = squeezed(presets_sheet().text(600))
    for preset in PRESETS.values():
        assert preset.name in text
        assert all(f"{key}={value}".replace(" ", "") in text for key, value in preset.options.items())


def test_all_options_are_listed_with_their_defaults_and_values() -> None:
    presets, options = presets_sheet().tables
    assert [row[:2] for row in options.rows] == [(field.name, str(field.default)) for field in fields(Protocol)]
    (root,) = (row for row in options.rows if row[0] == "root")
    assert root[2] == "count | drop"
    assert not any(is_number for table in (presets, options) for _, is_number in table.columns)
