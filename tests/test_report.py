"""A report's rows, signature and renderings say the same numbers, now and when it is read again later."""

import csv
import io
import json
import math
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import posecal
from posecal.calibration import LEVELS, perfect_sampler, signed_area
from posecal.demo import make_world, sample
from posecal.errors import PoseDataError
from posecal.inference import holm
from posecal.protocol import Protocol
from posecal.report import Report, Row
from posecal.results import load_totals, save_totals
from posecal.totals import difference_of_signatures
from tests.reports import FRAMES, SEQUENCES, N, report_of, unlabelled, world

ROW = ["metric", "label", "group", "joint", "value", "unit", "direction", "definition", "poses", "low", "high"]
CURVE = ["definition", "group", "joint", "levels", "coverage"]


def as_json(report: Report) -> dict[str, Any]:
    """A report's JSON, read by rules that refuse NaN and infinity."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return cast(dict[str, Any], json.loads(report.render("json"), parse_constant=refuse))


def some() -> Report:
    return report_of(by=("action", "sight"))


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


# --- rows -----------------------------------------------------------------------------------------------------


def test_a_group_s_rows_are_those_of_its_poses_alone() -> None:
    here = world()
    sitting = here.action == "sitting"
    alone = posecal.evaluate(
        sample(here, N)[:, sitting],
        here.truth[sitting],
        joints="h36m-17",
        labels={"sequence": here.sequence[sitting], "action": here.action[sitting]},
    )
    for metric in ("min_mpjpe", "pck", "ece", "ece_paper", "coverage_90", "cps"):
        np.testing.assert_allclose(some().value(metric, "action=sitting"), alone.value(metric), rtol=1e-9)


def test_groups_add_to_the_whole() -> None:
    rows = [row for row in some().rows if row.metric == "mpjpe" and row.joint is None]
    whole = next(row for row in rows if row.group is None)
    parts = [row for row in rows if (row.group or "").startswith("action=")]
    assert sum(row.poses for row in parts) == whole.poses == SEQUENCES * FRAMES
    np.testing.assert_allclose(sum(row.value * row.poses for row in parts), whole.value * whole.poses)


def test_each_number_s_interval_holds_it() -> None:
    held = [row for row in some().rows if not math.isnan(row.low)]
    assert {row.metric for row in held} >= {"min_mpjpe", "coverage_90", "pck"}
    assert all(row.low <= row.value <= row.high for row in held)


def test_a_joint_s_signed_area_has_the_t_interval_of_its_sequences_areas() -> None:
    """Sequences are equally long: the areas are means of the sequences' areas, and their interval is Student's."""
    here, report = world(), report_of(0.5, by=("sequence",))
    groups = [f"sequence={name}" for name in np.unique(here.sequence)]
    areas = np.array([signed_area(report.calibration(group=group).coverage) for group in groups])
    for k, joint in enumerate(posecal.JOINT_SETS["h36m-17"]):
        if k:
            low, high = stats.t(len(groups) - 1).interval(0.95)
            (row,) = (r for r in report.rows if (r.metric, r.group, r.joint) == ("signed_area", None, joint))
            middle, error = areas[:, k].mean(), stats.sem(areas[:, k])
            np.testing.assert_allclose([row.low, row.high], [middle + error * low, middle + error * high], rtol=1e-9)


def test_a_joint_s_ece_has_no_interval() -> None:
    assert all(math.isnan(row.low) for row in some().rows if row.metric == "ece" and row.joint is not None)


def test_a_joint_s_interval_is_over_the_sequences_in_which_it_counts() -> None:
    """The head is masked but in three sequences: Student's t has two degrees of freedom."""
    here = world()
    where = np.ones(here.truth.shape[:2], dtype=bool)
    where[3 * FRAMES :, 10] = False
    names = posecal.JOINT_SETS["h36m-17"]
    report = posecal.evaluate(
        sample(here, 3), here.truth, joints="h36m-17", labels={"sequence": here.sequence}, where=where
    )
    shown = slice(0, 3 * FRAMES)
    alone = posecal.evaluate(
        sample(here, 3)[:, shown], here.truth[shown], joints="h36m-17", labels={"sequence": here.sequence[shown]}
    )
    found, expected = (
        next(row for row in r.rows if (row.metric, row.joint) == ("mpjpe", names[10])) for r in (report, alone)
    )
    np.testing.assert_allclose([found.low, found.high], [expected.low, expected.high], rtol=1e-9)
    assert found.low < found.value < found.high


def test_the_battery_s_rows_have_the_p_values_of_its_table() -> None:
    """Holm: the smallest of n p-values is multiplied by n."""
    report = report_of(0.8, metrics="battery")
    tests = list(report.battery())
    raw = [report.value(f"{name}_p") for name in tests]
    least = tests[int(np.argmin(raw))]
    assert report.value(f"{least}_p_adjusted") == min(1.0, len(tests) * min(raw))
    assert [report.value(f"{name}_p_adjusted") for name in tests] == holm(raw)
    (row,) = (row for row in report.rows if row.metric == f"{least}_p_adjusted")
    assert f"adjusted for all tests (Holm); {len(tests)} tests" in row.definition
    assert row.label.endswith(", adjusted p-value")


def test_groups_of_enough_sequences_have_what_a_calibrated_sampler_would_show() -> None:
    here = world()
    half = np.where(np.isin(here.sequence, np.unique(here.sequence)[:6]), "one", "other")
    labels = {"sequence": here.sequence, "half": half, "action": here.action}
    report = posecal.evaluate(
        sample(here, N, 0.5),
        here.truth,
        joints="h36m-17",
        labels=labels,
        by=["half", "action", "sight"],
        occluded=here.occluded,
    )
    kept = half == "one"
    alone = posecal.evaluate(
        sample(here, N, 0.5)[:, kept], here.truth[kept], joints="h36m-17", labels={"sequence": here.sequence[kept]}
    )
    for ending in ("null", "null_95", "p"):
        np.testing.assert_allclose(report.value(f"ece_{ending}", "half=one"), alone.value(f"ece_{ending}"), rtol=1e-5)
    groups = {row.group for row in report.rows if row.metric == "ece_p"}
    assert groups == {None, "half=one", "half=other", "sight=occluded", "sight=visible"}


def test_a_wide_and_a_narrow_sampler_lie_on_either_side() -> None:
    assert report_of(0.5).value("signed_area") < -0.1
    assert report_of(1.5).value("signed_area") > 0.1


def test_the_floors_say_n_and_that_they_are_of_a_perfect_sampler() -> None:
    (floor,) = (row for row in some().rows if row.metric == "ece_floor")
    assert 0 < floor.value < next(row for row in some().rows if row.metric == "ece_floor_95").value
    assert floor.definition.startswith("expected ECE of a perfect sampler: N=12, 36 independent poses and 16 ")


def test_the_poses_by_sight_are_those_with_such_a_joint() -> None:
    """Every third pose has nothing hidden, and all have something to see."""
    here = world()
    occluded = here.occluded & (np.arange(36) % 3 > 0)[:, None]
    occluded[np.arange(36) % 3 > 0, 2] = True
    report = posecal.evaluate(sample(here, 3), here.truth, joints="h36m-17", occluded=occluded, by=["sight"])
    poses = {(row.group, row.poses) for row in report.rows if (row.group or "").startswith("sight=")}
    assert poses == {("sight=occluded", 24), ("sight=visible", 36)}


def test_a_result_without_numbers_by_sight_says_how_to_get_them() -> None:
    with pytest.raises(PoseDataError, match=r"^by: this result holds no numbers by sight\. Evaluate with"):
        Report(report_of().totals, ["sight"])


def test_a_cut_of_the_spread_that_was_not_kept_is_refused() -> None:
    kept = report_of(by=("spread",)).totals
    assert Report(kept, ["spread"]).by == ("spread",)
    for other in ("spread:5", "spread=40,60"):
        with pytest.raises(PoseDataError, match=r"^by: 'spread:.*' is not a label of these poses"):
            Report(kept, [other])


# --- averaged over groups -------------------------------------------------------------------------------------


def uneven() -> dict[str, Any]:
    """Eight sequences of 1, 2 and 3 frames of an overconfident sampler."""
    here = make_world(8, 3, seed=6)
    kept = np.flatnonzero(np.arange(24) % 3 <= np.repeat([0, 1, 2, 0, 1, 2, 1, 0], 3))
    labels = {"sequence": here.sequence[kept], "action": here.action[kept]}
    return {"x": sample(here, 6, 0.6)[:, kept], "y": here.truth[kept], "labels": labels}


@cache
def averaged_and_repeated(label: str) -> tuple[Report, Report]:
    """The mean over groups, and all poses of as many copies of each group's that all groups are equally large."""
    data = uneven()
    values = data["labels"][label]
    size = np.array([(values == value).sum() for value in values])
    copies = np.repeat(np.arange(len(values)), math.lcm(*size.tolist()) // size)
    metrics = Protocol(metrics="default, battery, ece_paper")
    one, other = (
        posecal.evaluate(
            data["x"][:, chosen],
            data["y"][chosen],
            joints="h36m-17",
            labels={name: words[chosen] for name, words in data["labels"].items()},
            protocol=protocol,
            by=["action"],
        )
        for chosen, protocol in ((slice(None), replace(metrics, average=label)), (copies, metrics))
    )
    return one, other


@pytest.mark.parametrize("label", ["sequence", "action"])
def test_averaged_calibration_and_its_null_are_those_of_equally_large_groups(label: str) -> None:
    one, other = averaged_and_repeated(label)
    for name, metric in one.metrics.items():
        if metric.family in {"calibration", "battery"}:
            np.testing.assert_allclose(one.value(name), other.value(name), rtol=1e-9, err_msg=name)
        if metric.deviation is not None:
            found, expected = (vars(report.null(name)) for report in (one, other))
            np.testing.assert_allclose(list(found.values()), list(expected.values()), rtol=1e-4, err_msg=name)


@pytest.mark.parametrize("label", ["sequence", "action"])
def test_averaged_curves_are_those_of_equally_large_groups(label: str) -> None:
    one, other = averaged_and_repeated(label)
    for definition in ("exchangeable", "paper"):
        np.testing.assert_allclose(one.summary_curve(definition), other.summary_curve(definition), rtol=1e-9)
        curves = [report.calibration(definition).coverage for report in (one, other)]
        np.testing.assert_allclose(*curves, rtol=1e-9)
    for name in ("coordinate_pit", "band_depth"):
        np.testing.assert_allclose(one.rank_curves(name), other.rank_curves(name), rtol=1e-9)
    assert one.joint_tests().keys() == other.joint_tests().keys()
    for joint, (area, p) in one.joint_tests().items():
        np.testing.assert_allclose((area, p), other.joint_tests()[joint], rtol=1e-9)
    np.testing.assert_allclose(one.curve("errors_by_n")[1], other.curve("errors_by_n")[1], rtol=1e-9)


def test_averaged_over_sequences_intervals_are_those_of_equally_long_ones() -> None:
    one, other = averaged_and_repeated("sequence")
    for name, metric in one.metrics.items():
        if metric.family != "spread" or not metric.statistic.kept:
            rows = [
                next(row for row in report.rows if (row.metric, row.group, row.joint) == (name, None, None))
                for report in (one, other)
            ]
            low, high = ([getattr(row, end) for row in rows] for end in ("low", "high"))
            np.testing.assert_allclose([low[0], high[0]], [low[1], high[1]], rtol=1e-9, err_msg=name)


def test_the_curve_that_is_drawn_is_the_one_whose_error_is_reported() -> None:
    one = averaged_and_repeated("action")[0]
    for group in (None, "action=sitting"):
        curve = one.summary_curve("exchangeable", group)
        np.testing.assert_allclose(np.abs(curve - LEVELS).mean(), one.value("ece", group), rtol=1e-9)


def test_the_floor_of_an_average_is_that_of_as_many_poses_as_it_is_worth() -> None:
    """Sequences of 1, 2, 3, 1, 2, 3, 2 and 1 poses: a mean of their means has the variance σ²/8² Σ 1/n = σ²/10.55."""
    worth = 8**2 / sum(1 / n for n in (1, 2, 3, 1, 2, 3, 2, 1))
    (floor,) = (row for row in averaged_and_repeated("sequence")[0].rows if row.metric == "ece_floor")
    assert f"{worth:.0f} independent poses" in floor.definition
    assert floor.value == perfect_sampler(6, round(worth), 16).mean


# --- what is refused ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r: r.value("min_mpjp"), r"^min_mpjp is not in the report\. Did you mean min_mpjpe\?$"),
        (lambda r: r.value("mpjpe", "action=flying"), r"^mpjpe of action=flying is not in the report\. Did you mean"),
        (lambda r: r.value("mpjpe", joint="Tail"), r"^mpjpe at Tail is not in the report\."),
        (lambda r: r.definition("ecee"), r"^ecee is not in the report\. Did you mean ece\?$"),
        (lambda r: r.null("mpjpe"), r"^mpjpe \(group None\) is no calibration error here\."),
        (lambda r: r.null("ece", "action=no"), r"^ece \(group action=no\) is no calibration error here\."),
        (lambda r: r.curve("pck_curv"), r"^curve: 'pck_curv' is not known\. Did you mean pck_curve\?$"),
        (
            lambda r: r.calibration("paper", "action=no"),
            r"^calibration: the report has no paper curves of action=no\.$",
        ),
        (lambda r: r.calibration("papers"), r"^definition: 'papers' is not known\. Did you mean paper\?$"),
        (lambda r: r.rank_curves("ece"), r"^ece is no test in the report\."),
        (lambda r: r.event_reliability(), r"^event: the report has no Brier score\. Evaluate with --scores\.$"),
        (lambda r: r.render("xml"), r"^format: 'xml' is not known\. "),
    ],
)
def test_what_is_not_in_a_report_is_refused_with_the_nearest(call: Any, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        call(some())


def test_a_report_without_calibration_has_no_curves_and_says_so() -> None:
    plain = report_of(metrics="min_mpjpe")
    with pytest.raises(PoseDataError, match=r"^calibration: the report has no exchangeable curves of its poses\.$"):
        plain.calibration()
    with pytest.raises(PoseDataError, match=r"^sparsification: the report kept no spreads and errors"):
        plain.sparsification()
    assert plain.joint_tests() == {}
    assert plain.to_dict()["curves"] == []


# --- remarks --------------------------------------------------------------------------------------------------


def test_one_hypothesis_is_accurate_but_has_no_spread() -> None:
    remarks = " ".join(unlabelled(n=1).remarks)
    assert "calibration and spread need at least 2 hypotheses; there is 1." in remarks


def test_few_hypotheses_are_remarked_on_up_to_twenty() -> None:
    few = "N = 19 hypotheses are few: look at what a perfect sampler would show before reading an ECE (paper)."
    assert few in unlabelled(n=19).remarks
    assert not any("are few" in remark for remark in unlabelled(n=20).remarks)


def test_poses_without_sequences_are_remarked_on() -> None:
    (remark,) = (remark for remark in unlabelled().remarks if remark.startswith("no sequence labels: "))
    assert remark == "no sequence labels: 5 frames are taken as independent. In a video they are not."
    (remark,) = (r for r in unlabelled(poses=201).remarks if r.startswith("no sequence labels: "))
    assert "100 runs of consecutive frames are taken as independent" in remark
    assert not any("sequence" in remark for remark in some().remarks)


def test_one_sequence_is_one_sequence() -> None:
    here = world()
    one = posecal.evaluate(sample(here, 2)[:, :3], here.truth[:3], labels={"sequence": here.sequence[:3]})
    assert any(remark.startswith("1 sequence allows no test: ") for remark in one.remarks)


def test_too_few_sequences_for_a_test_are_remarked_on() -> None:
    """With 3 sequences, 2 of 8 choices of signs make the error as large, whatever it is."""
    here = world()
    three = slice(0, 3 * FRAMES)
    report = posecal.evaluate(
        sample(here, N)[:, three], here.truth[three], joints="h36m-17", labels={"sequence": here.sequence[three]}
    )
    (remark,) = (remark for remark in report.remarks if "sequences allow no test" in remark)
    assert remark.startswith("3 sequences allow no test: ")
    assert "in 25% of cases" in remark
    assert math.isnan(report.null("ece").p)


# --- signature ------------------------------------------------------------------------------------------------


def test_the_same_measurement_has_the_same_signature_whatever_the_hypotheses_and_the_grouping() -> None:
    assert report_of(0.5).signature == report_of(1.5).signature == some().signature


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (Protocol(best="sequence"), "best"),
        (Protocol(root="drop"), "root"),
        (Protocol(joints="Head,RKnee,LKnee,RWrist"), "joints"),
        (Protocol(ece_over="mean"), "ece"),
        (Protocol(where="occluded"), "where"),
        (Protocol(average="action"), "average"),
    ],
)
def test_another_protocol_has_another_signature_that_says_so(changed: Protocol, said: str) -> None:
    here = world()
    labels = {"sequence": here.sequence, "action": here.action}
    one, other = (
        posecal.evaluate(
            sample(here, 4), here.truth, joints="h36m-17", labels=labels, occluded=here.occluded, protocol=how
        )
        for how in (Protocol(), changed)
    )
    assert one.signature != other.signature
    assert f"{said} " in difference_of_signatures(one.totals, other.totals)


def test_another_number_of_hypotheses_has_another_signature() -> None:
    assert report_of(n=4).signature != report_of().signature


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
    assert headings == ["Accuracy", "Calibration", "Spread", "By action", "By sight", "By joint", "Definitions"]
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
