"""Rows of a report: a number of a group at a joint, its interval, and what stands beside it."""

import math

import numpy as np
import pytest
from scipy import special, stats

import posecal
from posecal.demo import sample
from posecal.errors import PoseDataError, for_command_line
from posecal.report.report import Report
from posecal.stats.resampling import holm
from tests.helpers.reports import FRAMES, HOW, SEQUENCES, N, grouped_report, report_of, world


def test_a_group_s_rows_are_those_of_its_poses_alone() -> None:
    here = world()
    sitting = here.action == "sitting"
    alone = posecal.evaluate(
        sample(here, N)[:, sitting],
        here.truth[sitting],
        joints="h36m-17",
        labels={"sequence": here.sequence[sitting], "action": here.action[sitting]},
        axes="NMKD",
        unit="mm",
    )
    for metric in ("min_mpjpe", "pck", "ece", "ece_paper", "coverage_90", "cps"):
        np.testing.assert_allclose(grouped_report().value(metric, "action=sitting"), alone.value(metric), rtol=1e-9)


def test_groups_add_to_the_whole() -> None:
    rows = [row for row in grouped_report().rows if row.metric == "mpjpe" and row.joint is None]
    whole = next(row for row in rows if row.group is None)
    parts = [row for row in rows if (row.group or "").startswith("action=")]
    assert sum(row.poses for row in parts) == whole.poses == SEQUENCES * FRAMES
    np.testing.assert_allclose(sum(row.value * row.poses for row in parts), whole.value * whole.poses)


def test_each_number_s_interval_holds_it() -> None:
    held = [row for row in grouped_report().rows if not math.isnan(row.low)]
    assert {row.metric for row in held} >= {"min_mpjpe", "coverage_90", "pck"}
    assert all(row.low <= row.value <= row.high for row in held)


def test_a_joint_s_signed_area_has_the_t_interval_of_its_sequences_areas() -> None:
    """Sequences are equally long: the areas are means of the sequences', and their interval is Student's, of logits."""
    here, report = world(), report_of(0.5, by=("sequence",))
    groups = [f"sequence={name}" for name in np.unique(here.sequence)]
    areas = np.array([report.calibration(group=group).joint_signed_area() for group in groups])
    for k, joint in enumerate(posecal.JOINT_SETS["h36m-17"]):
        if k:
            low, high = stats.t(len(groups) - 1).interval(0.95)
            middle, S = areas[:, k].mean(), len(groups)
            without = special.logit((S * middle - areas[:, k]) / (S - 1) + 0.5)
            scaled = special.logit(middle + 0.5)
            error = np.sqrt((S - 1) / S * ((without - scaled) ** 2).sum())
            interval = report.interval("signed_area", joint=joint)
            ends = [special.expit(scaled + error * end) - 0.5 for end in (low, high)]
            np.testing.assert_allclose(interval, ends, rtol=1e-6)


def test_a_joint_s_ece_has_no_interval() -> None:
    assert all(math.isnan(row.low) for row in grouped_report().rows if row.metric == "ece" and row.joint is not None)


def test_a_joint_s_interval_is_over_the_sequences_in_which_it_counts() -> None:
    """The head is masked but in three sequences: Student's t has two degrees of freedom."""
    here = world()
    where = np.ones(here.truth.shape[:2], dtype=bool)
    where[3 * FRAMES :, 10] = False
    names = posecal.JOINT_SETS["h36m-17"]
    report = posecal.evaluate(
        sample(here, 3), here.truth, joints="h36m-17", labels={"sequence": here.sequence}, where=where, **HOW
    )
    shown = slice(0, 3 * FRAMES)
    labels = {"sequence": here.sequence[shown]}
    alone = posecal.evaluate(sample(here, 3)[:, shown], here.truth[shown], joints="h36m-17", labels=labels, **HOW)
    low, high = report.interval("mpjpe", joint=names[10])
    np.testing.assert_allclose((low, high), alone.interval("mpjpe", joint=names[10]), rtol=1e-9)
    assert low < report.value("mpjpe", joint=names[10]) < high


def test_a_joint_s_pose_count_is_that_of_the_poses_in_which_the_joint_counts() -> None:
    """The head is masked but in nine poses, the left knee in five of which the head is in two."""
    here = world()
    where = np.ones(here.truth.shape[:2], dtype=bool)
    where[9:, 10] = False
    where[7:12, 5] = False
    labels = {"sequence": here.sequence, "action": here.action}
    report = posecal.evaluate(
        sample(here, 3), here.truth, joints="h36m-17", labels=labels, where=where, by="action", **HOW
    )
    names = posecal.JOINT_SETS["h36m-17"]
    expected = {name: int(count) for name, count in zip(names, where.sum(axis=0), strict=True)}
    for metric in ("mpjpe", "ece", "coverage_50", "radius_50"):
        poses = {row.joint: row.poses for row in report.rows if row.metric == metric and row.joint is not None}
        assert poses == {name: expected[name] for name in poses}
        assert {poses[names[10]], poses[names[5]], poses["RWrist"]} == {9, 31, 36}
    for action in np.unique(here.action):
        chosen = here.action == action
        assert report.count("mpjpe", f"action={action}", "Head") == where[chosen, 10].sum()
        assert report.count("mpjpe", f"action={action}") == chosen.sum()


def test_the_rank_tests_rows_have_the_p_values_of_their_table() -> None:
    """Holm: the smallest of n p-values is multiplied by n."""
    report = report_of(0.8, metrics="rank_tests")
    tests = list(report.rank_tests())
    raw = [report.value(f"{name}_p") for name in tests]
    least = tests[int(np.argmin(raw))]
    assert report.value(f"{least}_p_adjusted") == min(1.0, len(tests) * min(raw))
    assert [report.value(f"{name}_p_adjusted") for name in tests] == holm(raw)
    (row,) = (row for row in report.rows if row.metric == f"{least}_p_adjusted")
    assert f"adjusted for all tests (Holm); {len(tests)} tests" in row.definition
    assert row.label.startswith("adjusted p-value of ")


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
        **HOW,
    )
    one = half == "one"
    alone = posecal.evaluate(
        sample(here, N, 0.5)[:, one], here.truth[one], joints="h36m-17", labels={"sequence": here.sequence[one]}, **HOW
    )
    for ending in ("null", "null_95", "p"):
        np.testing.assert_allclose(report.value(f"ece_{ending}", "half=one"), alone.value(f"ece_{ending}"), rtol=1e-5)
    groups = {row.group for row in report.rows if row.metric == "ece_p"}
    assert groups == {None, "half=one", "half=other", "occlusion=occluded", "occlusion=visible"}


def test_a_wide_and_a_narrow_sampler_lie_on_either_side() -> None:
    assert report_of(0.5).value("signed_area") < -0.1
    assert report_of(1.5).value("signed_area") > 0.1


def test_the_floors_say_n_and_that_they_are_of_a_perfect_sampler() -> None:
    (floor,) = (row for row in grouped_report().rows if row.metric == "ece_floor")
    assert 0 < floor.value < next(row for row in grouped_report().rows if row.metric == "ece_floor_95").value
    assert floor.definition.startswith("expected ECE of a perfect sampler: N=12, 36 independent poses and 16 ")


def test_the_poses_by_occlusion_are_those_with_such_a_joint() -> None:
    """Every third pose has nothing hidden, and all have something to see."""
    here = world()
    occluded = here.occluded & (np.arange(36) % 3 > 0)[:, None]
    occluded[np.arange(36) % 3 > 0, 2] = True
    report = posecal.evaluate(sample(here, 3), here.truth, joints="h36m-17", occluded=occluded, by="occlusion", **HOW)
    poses = {(row.group, row.poses) for row in report.rows if (row.group or "").startswith("occlusion=")}
    assert poses == {("occlusion=occluded", 24), ("occlusion=visible", 36)}


def test_a_result_without_numbers_by_occlusion_says_how_to_get_them() -> None:
    with pytest.raises(PoseDataError, match=r"^by: this result holds no numbers by occlusion\. ") as refused:
        Report(report_of().totals, ["occlusion"])
    assert str(refused.value).endswith('Evaluate with by="occlusion".')
    assert for_command_line(refused.value.message).endswith("Evaluate with --by occlusion.")


def test_a_cut_of_the_spread_that_the_result_lacks_is_refused() -> None:
    totals = report_of(by=("predicted_spread",)).totals
    assert Report(totals, ["predicted_spread"]).by == ("predicted_spread",)
    for other in ("predicted_spread:5", "predicted_spread=40,60"):
        with pytest.raises(PoseDataError, match=r"^by: 'predicted_spread:.*' is not a label of these poses"):
            Report(totals, [other])
