"""A report: its numbers, remarks and signature, computed when asked for, and what is not in it."""

import copy
import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.calibration import perfect_sampler
from posecal.demo import sample
from posecal.engine.merge import difference_of_signatures
from posecal.engine.metric import Statistic
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.report import report as report_module
from posecal.report.report import Report
from posecal.stats.resampling import holm
from posecal.stats.uncertainty import effective_sample_size, joint_p_values, unbiased_squared_error
from tests.helpers.reports import HOW, N, grouped_report, report_of, unlabelled, world


def fresh(report: Report) -> Report:
    """The same report with nothing computed yet."""
    return Report(report.totals, report.by)


# --- what is no report's --------------------------------------------------------------------------------------


def test_a_report_is_of_sums() -> None:
    for what in (5, grouped_report()):
        with pytest.raises(PoseDataError, match=rf"^totals: {type(what).__name__}; expected Totals\.$"):
            Report(what)  # type: ignore[arg-type]


def test_a_form_and_a_width_are_checked() -> None:
    with pytest.raises(PoseDataError, match=r"^format: 5 is not known\. Known: text, "):
        grouped_report().render(5)  # type: ignore[arg-type]
    for width in ("a", 0, 2.0):
        with pytest.raises(PoseDataError, match=rf"^width: {width!r}; expected a whole number, at least 1\.$"):
            grouped_report().render(width=width)  # type: ignore[arg-type]


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
    report = fresh(grouped_report())
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
        (lambda r: (r.definition("ece"), r.count("ece"), r.signature), []),
        (lambda r: r.remarks, ["null ece"]),
    ],
)
def test_what_is_asked_for_twice_is_computed_once(ask: Any, expected: list[str], computed: list[str]) -> None:
    report = fresh(grouped_report())
    ask(report)
    assert computed == expected
    ask(report)
    assert computed == expected


def test_printing_computes_what_it_prints_and_no_more(computed: list[str]) -> None:
    report = fresh(grouped_report())
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
    assert Report(grouped_report().totals, "action").by == ("action",)
    assert list(Report(grouped_report().totals, ["action", "action"]).groups) == [
        None,
        "action=sitting",
        "action=standing",
        "action=walking",
    ]


def test_groups_give_the_cells_of_their_poses() -> None:
    report = grouped_report()
    for group, cells in report.groups.items():
        if group is None or group.startswith("occlusion="):
            assert cells is None
        else:
            assert set(report.totals.cells["action"][cells]) == {group.partition("=")[2]}


def test_scalars_are_the_headline_metrics_as_plain_floats() -> None:
    scalars = grouped_report().scalars()
    assert {"min_mpjpe", "mpjpe", "ece", "signed_area", "coverage_90", "diversity"} <= set(scalars)
    assert "ece_worst" not in scalars
    assert {type(value) for value in scalars.values()} == {float}
    assert scalars == {name: grouped_report()[name] for name in scalars}
    assert list(report_of(metrics="ece_worst").scalars()) == ["ece_worst"]


def test_a_number_of_a_group_at_a_joint_is_that_of_its_poses() -> None:
    here = world()
    sitting = here.action == "sitting"
    errors = np.linalg.norm(sample(here, N)[:, sitting, 10] - here.truth[sitting, 10], axis=-1)
    np.testing.assert_allclose(grouped_report().value("mpjpe", "action=sitting", "Head"), errors.mean(), rtol=1e-5)
    low, high = grouped_report().interval("mpjpe", "action=sitting", "Head")
    assert low < grouped_report().value("mpjpe", "action=sitting", "Head") < high
    assert (low, high) != grouped_report().interval("mpjpe", joint="Head")


def test_a_joint_that_does_not_count_has_no_number() -> None:
    assert math.isnan(grouped_report().value("ece", joint="Hip"))
    assert "Hip" not in {row.joint for row in grouped_report().rows if row.metric == "ece"}


@pytest.mark.parametrize("name", ["ece_null", "ece_null_95", "ece_p", "ece_floor", "effective_poses", "squared_error"])
def test_numbers_beside_metrics_are_numbers_without_intervals(name: str) -> None:
    assert math.isfinite(grouped_report()[name])
    assert np.isnan(grouped_report().interval(name)).all()
    assert grouped_report().count(name) == 36
    (row,) = (row for row in grouped_report().rows if (row.metric, row.group) == (name, None))
    assert (row.value, row.definition) == (grouped_report()[name], grouped_report().definition(name))


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
    assert "over random signs of entire sequences" in report.definition("ece_null")
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
    report = grouped_report()
    test = report.test("ece")
    assert (report["ece_null"], report["ece_null_95"], report["ece_p"]) == (test.mean, test.high, test.p)
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
        call(grouped_report())


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
    assert report_of(0.5).signature == report_of(1.5).signature == grouped_report().signature


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
