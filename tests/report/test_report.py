"""A report: its numbers, rows, remarks and signature, computed when asked for, and what is not in it."""

import copy
import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

import posecal
from posecal.calibration import perfect_sampler
from posecal.demo import sample
from posecal.engine.metric import Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.totals import difference_of_signatures
from posecal.errors import PoseDataError, for_command_line
from posecal.report import report as report_module
from posecal.report.report import Report
from posecal.stats.resampling import holm
from posecal.stats.uncertainty import effective_sample_size, joint_p_values, unbiased_squared_error
from tests.helpers.reports import FRAMES, SEQUENCES, N, report_of, unlabelled, world

HOW: dict[str, Any] = {"axes": "NMKD", "unit": "mm"}


def some() -> Report:
    return report_of(by=("action", "occlusion"))


def fresh(report: Report) -> Report:
    """The same report with nothing computed yet."""
    return Report(report.totals, report.by)


# --- what is no report's --------------------------------------------------------------------------------------


def test_a_report_is_of_sums() -> None:
    for what in (5, some()):
        with pytest.raises(PoseDataError, match=rf"^totals: {type(what).__name__}; expected Totals\.$"):
            Report(what)  # type: ignore[arg-type]


def test_a_form_and_a_width_are_checked() -> None:
    with pytest.raises(PoseDataError, match=r"^format: 5 is not known\. Known: text, "):
        some().render(5)  # type: ignore[arg-type]
    for width in ("a", 0, 2.0):
        with pytest.raises(PoseDataError, match=rf"^width: {width!r}; expected a whole number, at least 1\.$"):
            some().render(width=width)  # type: ignore[arg-type]


# --- computed when asked for ----------------------------------------------------------------------------------


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of what is computed, in order: values, intervals, tests, and those of all joints at once."""
    calls: list[str] = []

    def counting(what: str, function: Any) -> Any:
        def count(totals: Any, metric: Any, *rest: Any) -> Any:
            calls.append(f"{what} {metric.name}")
            return function(totals, metric, *rest)

        return count

    for what in ("interval", "joint_intervals", "joint_p_values", "null"):
        monkeypatch.setattr(report_module, what, counting(what, getattr(report_module, what)))
    for what in ("value", "by_joint"):
        monkeypatch.setattr(posecal.Totals, what, counting(what, getattr(posecal.Totals, what)))
    return calls


def test_a_number_costs_only_itself(computed: list[str]) -> None:
    report = fresh(some())
    assert report["min_mpjpe"] > 0
    assert computed == ["value min_mpjpe"]


@pytest.mark.parametrize(
    ("ask", "expected"),
    [
        (lambda r: r.value("mpjpe", "action=sitting"), ["value mpjpe"]),
        (lambda r: (r["mpjpe"], r.interval("mpjpe")), ["value mpjpe", "interval mpjpe"]),
        (lambda r: r.test("ece"), ["null ece"]),
        (lambda r: (r["ece_p"], r["ece_null_95"], r.definition("ece_p")), ["null ece"]),
        (lambda r: [r.value("mpjpe", joint=j) for j in ("Head", "Hip")], ["by_joint mpjpe"]),
        (lambda r: r.joint_tests(), ["joint_p_values ece"]),
        (lambda r: (r.definition("ece"), r.count("ece"), r.remarks, r.signature), []),
    ],
)
def test_what_is_asked_for_twice_is_computed_once(ask: Any, expected: list[str], computed: list[str]) -> None:
    report = fresh(some())
    ask(report)
    assert computed == expected
    ask(report)
    assert computed == expected


def test_printing_computes_what_it_prints_and_no_more(computed: list[str]) -> None:
    report = fresh(some())
    str(report)
    assert "interval min_mpjpe" in computed
    assert "value min_mpjpe" in computed
    hidden = {name for name in report.metrics if name not in report.headline_metrics}
    hidden -= {"ece_mean"}  # of a sentence
    assert {"ece_reference", "ece_worst", "signed_area_max"} <= hidden
    in_tables = {name for name, metric in report.metrics.items() if metric.in_group_table}
    assert not {name for name in hidden - in_tables if any(call.endswith(f" {name}") for call in computed)}
    assert not [call for call in computed if call.startswith("joint_intervals")]
    before = list(computed)
    str(report)
    assert computed == before


def test_a_report_pickles_and_copies_with_nothing_but_its_sums_and_groups() -> None:
    report = report_of(metrics="all", by=("action", "occlusion"))
    state = report.__reduce__()
    assert state == (Report, (report.totals, ("action", "occlusion")))
    for again in (pickle.loads(pickle.dumps(report)), copy.deepcopy(report)):
        assert again.render("json") == report.render("json")


def test_a_label_to_group_by_may_be_given_by_itself_and_twice() -> None:
    assert Report(some().totals, "action").by == ("action",)
    assert list(Report(some().totals, ["action", "action"]).groups) == [
        None,
        "action=sitting",
        "action=standing",
        "action=walking",
    ]


def test_groups_give_the_cells_of_their_poses() -> None:
    report = some()
    for group, cells in report.groups.items():
        if group is None or group.startswith("occlusion="):
            assert cells is None
        else:
            assert set(report.totals.cells["action"][cells]) == {group.partition("=")[2]}


def test_scalars_are_the_headline_metrics_as_plain_floats() -> None:
    scalars = some().scalars()
    assert {"min_mpjpe", "mpjpe", "ece", "signed_area", "coverage_90", "diversity"} <= set(scalars)
    assert "ece_worst" not in scalars
    assert {type(value) for value in scalars.values()} == {float}
    assert scalars == {name: some()[name] for name in scalars}
    assert list(report_of(metrics="ece_worst").scalars()) == ["ece_worst"]


def test_a_number_of_a_group_at_a_joint_is_that_of_its_poses() -> None:
    here = world()
    sitting = here.action == "sitting"
    errors = np.linalg.norm(sample(here, N)[:, sitting, 10] - here.truth[sitting, 10], axis=-1)
    np.testing.assert_allclose(some().value("mpjpe", "action=sitting", "Head"), errors.mean(), rtol=1e-5)
    low, high = some().interval("mpjpe", "action=sitting", "Head")
    assert low < some().value("mpjpe", "action=sitting", "Head") < high
    assert (low, high) != some().interval("mpjpe", joint="Head")


def test_a_joint_that_does_not_count_has_no_number() -> None:
    assert math.isnan(some().value("ece", joint="Hip"))
    assert "Hip" not in {row.joint for row in some().rows if row.metric == "ece"}


@pytest.mark.parametrize("name", ["ece_null", "ece_null_95", "ece_p", "ece_floor", "effective_poses", "squared_error"])
def test_numbers_beside_metrics_are_numbers_without_intervals(name: str) -> None:
    assert math.isfinite(some()[name])
    assert np.isnan(some().interval(name)).all()
    assert some().count(name) == 36
    (row,) = (row for row in some().rows if (row.metric, row.group) == (name, None))
    assert (row.value, row.definition) == (some()[name], some().definition(name))


def test_a_joint_s_number_of_a_statistic_that_counts_poses_is_over_all_of_them() -> None:
    """A metric of one's own whose statistic gives (B, K) but counts poses, not joints."""
    report = fresh(report_of())
    means = Statistic("own_depth", lambda block: block.truth[..., 2])
    totals = copy.copy(report.totals)
    totals.sums = totals.sums | {"own_depth": np.zeros((len(totals.poses), 17))}
    totals.counts = totals.counts | {"own_depth": totals.poses}
    own = replace(report.metrics["mpjpe"], name="own_depth", statistic=means, by_joint=(means, np.asarray))
    totals.own_metrics = (own,)
    changed = Report(totals)
    changed.metrics["own_depth"] = own
    assert changed.count("own_depth", joint="Head") == 36
    assert changed.value("own_depth", joint="Head") == 0


def test_each_joint_is_tested_by_itself_and_adjusted_for_their_number() -> None:
    report = report_of(0.5)
    tests = report.joint_tests()
    assert list(tests) == list(posecal.JOINT_SETS["h36m-17"][1:])
    assert {joint: area for joint, (area, _) in tests.items()} == {
        joint: report.value("signed_area", joint=joint) for joint in tests
    }
    raw = joint_p_values(report.totals, report.metrics["ece"])[1:]
    assert [p for _, p in tests.values()] == holm(raw.tolist())
    assert unlabelled().joint_tests() == {}
    assert list(report_of(metrics="signed_area").joint_tests()) == list(tests)


def test_numbers_beside_metrics_are_defined_with_what_they_depend_on() -> None:
    report = report_of(metrics="all")
    assert report.definition("ece_null").endswith("over random signs of entire sequences")
    assert report.definition("ece_p").endswith("as large; 12 sequences")
    assert report.definition("tarp_box_p_adjusted").endswith(f"(Holm); {len(report.rank_tests())} tests")
    assert report.definition("ece_paper_floor").endswith("(more where they are correlated); paper definition")
    assert report.definition("ece_floor_95").endswith("exchangeable definition")
    floor = perfect_sampler(N, 36, 16, "reference")
    assert (report["ece_reference_floor"], report["ece_reference_floor_95"]) == (floor.mean, floor.high)


def test_the_effective_number_of_poses_and_the_squared_error_are_of_the_exchangeable_curves() -> None:
    report = report_of(metrics="all")
    statistic = report.metrics["ece"].statistic
    assert report["effective_poses"] == effective_sample_size(report.totals, statistic)
    assert report["squared_error"] == unbiased_squared_error(report.totals, statistic)


def test_without_a_pose_that_counts_there_is_nothing_but_nan() -> None:
    """Sums of no pose, as a group of a shard may have."""
    totals = copy.deepcopy(report_of().totals)
    for name in totals.sums:
        totals.sums[name][:], totals.counts[name][:] = 0, 0
    report = Report(totals)
    assert math.isnan(report["ece"])
    assert math.isnan(report["ece_floor"])
    assert "0 independent poses" in report.definition("ece_floor")
    assert report.summary == ()
    assert report.count("ece") == 0
    assert str(report)


def test_the_null_is_that_of_the_test() -> None:
    test = some().test("ece")
    assert (some()["ece_null"], some()["ece_null_95"], some()["ece_p"]) == (test.mean, test.high, test.p)
    assert test.mean < test.high


def test_its_repr_says_what_it_is_and_the_numbers_of_the_model() -> None:
    report = report_of()
    assert repr(report) == (
        f"<posecal Report: N=12, M=36, K=17, 12 sequences: minMPJPE {report['min_mpjpe']:.1f} mm, "
        f"ECE {report['ece']:.3f}, signed area {report['signed_area']:.3f}>"
    )
    accuracy = report_of(metrics="mpjpe, pck, auc, cps")
    assert [word in repr(accuracy) for word in ("MPJPE", "PCK", "AUC", "CPS")] == [True, True, True, False]
    assert repr(report_of(metrics="pck")).endswith(f": PCK 150 mm {report['pck']:.3f}>")


# --- rows -----------------------------------------------------------------------------------------------------


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
    areas = np.array([report.calibration(group=group).joint_signed_area() for group in groups])
    for k, joint in enumerate(posecal.JOINT_SETS["h36m-17"]):
        if k:
            low, high = stats.t(len(groups) - 1).interval(0.95)
            middle, error = areas[:, k].mean(), stats.sem(areas[:, k])
            interval = report.interval("signed_area", joint=joint)
            np.testing.assert_allclose(interval, [middle + error * low, middle + error * high], rtol=1e-9)


def test_a_joint_s_ece_has_no_interval() -> None:
    assert all(math.isnan(row.low) for row in some().rows if row.metric == "ece" and row.joint is not None)


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
    for metric in ("mpjpe", "ece", "coverage_90", "radius_50"):
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
    (floor,) = (row for row in some().rows if row.metric == "ece_floor")
    assert 0 < floor.value < next(row for row in some().rows if row.metric == "ece_floor_95").value
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


# --- what is refused ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r: r["min_mpjp"], r"^metric: 'min_mpjp' is not in the report\. Did you mean min_mpjpe\?$"),
        (lambda r: r["minMPJPE"], r"^metric: 'minMPJPE' is not in the report\. Did you mean min_mpjpe\?$"),
        (
            lambda r: r["energy_score"],
            r"^metric: 'energy_score' was not measured\. Evaluate with metrics=\"default, scores\"\.$",
        ),
        (lambda r: r.value("ece_pp"), r"^metric: 'ece_pp' is not in the report\. Did you mean ece_p\?$"),
        (lambda r: r.value("pck", "occlusion=visible"), r"^metric: 'pck' is not in the report of occlusion=visible\."),
        (lambda r: r.value("mpjpe", "action=siting"), r"^group: 'action=siting' .* Did you mean action=sitting\?$"),
        (lambda r: r.value("mpjpe", joint="Tail"), r"^joint: 'Tail' is not in the report\."),
        (lambda r: r.value("ece_floor", "action=sitting"), r"^group: ece_floor is known over all poses only"),
        (lambda r: r.value("ece_p", joint="Head"), r"^joint: ece_p has no values per joint\."),
        (lambda r: r.value("cps", joint="Head"), r"^joint: cps has no values per joint\."),
        (lambda r: r.value("pck_", joint="Head"), r"^metric: 'pck_' is not in the report\."),
        (lambda r: r.value("worst_mpjpe", joint="Head"), r"^joint: worst_mpjpe has .* Did you mean mpjpe\?$"),
        (lambda r: r.interval("cps", joint="Head"), r"^joint: cps has no values per joint\."),
        (lambda r: r.interval("mpjpe", joint="Tail"), r"^joint: 'Tail' is not in the report\."),
        (lambda r: r.interval("mpjp"), r"^metric: 'mpjp' is not in the report\."),
        (lambda r: r.count("mpjp"), r"^metric: 'mpjp' is not in the report\."),
        (lambda r: r.definition("ecee"), r"^metric: 'ecee' is not in the report\. Did you mean ece\?$"),
        (lambda r: r.test("mpjpe"), r"^test: mpjpe is no calibration error or rank test\. "),
        (lambda r: r.test("ece_p"), r"^test: ece_p is no calibration error or rank test\. Did you mean ece\?$"),
        (lambda r: r.test("ece", "action=no"), r"^group: 'action=no' is not in the report\."),
        (lambda r: r.curve("pck_curv"), r"^curve: 'pck_curv' is not known\. Did you mean pck_curve\?$"),
        (
            lambda r: r.calibration("paper", "action=no"),
            r"^group: 'action=no' is not in the report\.",
        ),
        (
            lambda r: r.calibration("paper", "occlusion=visible"),
            r"^calibration: the report has no paper curves of occlusion=visible\.$",
        ),
        (lambda r: r.calibration("papers"), r"^definition: 'papers' is not known\. Did you mean paper\?$"),
        (lambda r: r.rank_curves("ece"), r"^test: ece is no rank test of the report\."),
        (lambda r: r.event_reliability(), r'^event: the report has no Brier score\. Evaluate with metrics="scores"\.$'),
        (lambda r: r.render("xml"), r"^format: 'xml' is not known\. "),
        (lambda r: r[3], r"^metric: 3 is not in the report\. Known: "),
        (lambda r: r[["mpjpe"]], r"^metric: \['mpjpe'\] is not in the report\. Did you mean mpjpe\?$"),
        (lambda r: r[None], r"^metric: None is not in the report\."),
        (lambda r: r.value("mpjpe", joint=3), r"^joint: 3 is not in the report\. Known: .*Head"),
        (lambda r: r.value("mpjpe", joint=["Head"]), r"^joint: \['Head'\] is not in the report\."),
        (lambda r: r.value("mpjpe", group=3), r"^group: 3 is not in the report\."),
        (lambda r: r.value("mpjpe", group=["action=sitting"]), r"^group: \['action=sitting'\] is not in the report\."),
        (lambda r: r.interval("mpjpe", joint=3), r"^joint: 3 is not in the report\."),
        (lambda r: r.interval(3), r"^metric: 3 is not in the report\."),
        (lambda r: r.count("mpjpe", joint=3), r"^joint: 3 is not in the report\."),
        (lambda r: r.definition(3), r"^metric: 3 is not in the report\."),
        (lambda r: r.test(["ece"]), r"^metric: \['ece'\] is not in the report\."),
        (lambda r: r.curve(3), r"^curve: 3 is not known\."),
        (lambda r: r.curve(["pck_curve"]), r"^curve: \['pck_curve'\] is not known\."),
        (lambda r: r.calibration(3), r"^definition: 3 is not known\."),
        (lambda r: r.calibration("paper", ["all"]), r"^group: \['all'\] is not in the report\."),
        (lambda r: r.rank_curves(3), r"^test: 3 is no rank test of the report\."),
        (lambda r: r.rank_curves(["ece"]), r"^test: \['ece'\] is no rank test of the report\."),
        (lambda r: r.render(3), r"^format: 3 is not known\."),
        (lambda r: Report(r.totals, [3]), r"^by: "),
        (lambda r: Report(r.totals, 3), r"^by: "),
    ],
)
def test_what_is_not_in_a_report_is_refused_with_the_nearest(call: Any, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        call(some())


def test_a_report_without_calibration_has_no_curves_and_says_so() -> None:
    plain = report_of(metrics="min_mpjpe")
    with pytest.raises(PoseDataError, match=r"^calibration: the report has no exchangeable curves of its poses\.$"):
        plain.calibration()
    with pytest.raises(PoseDataError, match=r"^sparsification: the report has no spreads and errors"):
        plain.sparsification()
    assert plain.joint_tests() == {}
    assert plain.to_dict()["curves"] == []


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
            sample(here, 4), here.truth, joints="h36m-17", labels=labels, occluded=here.occluded, protocol=how, **HOW
        )
        for how in (Protocol(), changed)
    )
    assert one.signature != other.signature
    assert f"{said} " in difference_of_signatures(one.totals, other.totals)


def test_another_number_of_hypotheses_has_another_signature() -> None:
    assert report_of(n=4).signature != report_of().signature
