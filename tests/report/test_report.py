"""A report: its rows, its remarks, its signature, and what is not in it."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

import posecal
from posecal.calibration import signed_area
from posecal.demo import sample
from posecal.engine.protocol import Protocol
from posecal.engine.totals import difference_of_signatures
from posecal.errors import PoseDataError
from posecal.report.report import Report
from posecal.stats.resampling import holm
from tests.helpers.reports import FRAMES, SEQUENCES, N, report_of, unlabelled, world


def some() -> Report:
    return report_of(by=("action", "occlusion"))


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
    report = report_of(0.8, metrics="rank_tests")
    tests = list(report.rank_tests())
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
        by=["half", "action", "occlusion"],
        occluded=here.occluded,
    )
    kept = half == "one"
    alone = posecal.evaluate(
        sample(here, N, 0.5)[:, kept], here.truth[kept], joints="h36m-17", labels={"sequence": here.sequence[kept]}
    )
    for ending in ("null", "null_95", "p"):
        np.testing.assert_allclose(report.value(f"ece_{ending}", "half=one"), alone.value(f"ece_{ending}"), rtol=1e-5)
    groups = {row.group for row in report.rows if row.metric == "ece_p"}
    assert groups == {None, "half=one", "half=other", "occlusion=occluded", "occlusion=visible"}


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
    report = posecal.evaluate(sample(here, 3), here.truth, joints="h36m-17", occluded=occluded, by=["occlusion"])
    poses = {(row.group, row.poses) for row in report.rows if (row.group or "").startswith("occlusion=")}
    assert poses == {("occlusion=occluded", 24), ("occlusion=visible", 36)}


def test_a_result_without_numbers_by_sight_says_how_to_get_them() -> None:
    with pytest.raises(PoseDataError, match=r"^by: this result holds no numbers by occlusion\. Evaluate with"):
        Report(report_of().totals, ["occlusion"])


def test_a_cut_of_the_spread_that_was_not_kept_is_refused() -> None:
    kept = report_of(by=("spread",)).totals
    assert Report(kept, ["spread"]).by == ("spread",)
    for other in ("spread:5", "spread=40,60"):
        with pytest.raises(PoseDataError, match=r"^by: 'spread:.*' is not a label of these poses"):
            Report(kept, [other])


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
