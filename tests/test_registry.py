"""The metrics that are asked for are the ones that are given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posecal.data.skeleton import JOINT_SETS
from posecal.engine.block import Block
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError
from posecal.registry import (
    GROUPS,
    check_names,
    curves_of,
    known_metrics,
    metrics_of,
    occlusion_metrics_of,
    reserved_names,
    statistics_of,
    wants_reference,
)
from posecal.report.table import auxiliary_rows

Array = np.ndarray
H36M = JOINT_SETS["h36m-17"]
PERSON = DataSpec(7, H36M, 0, ("sequence",), 25.0, True)


def test_all_gives_every_metric_that_is_known() -> None:
    assert list(metrics_of(Protocol(metrics="all"), PERSON)) == list(known_metrics(Protocol(), PERSON))


def test_the_default_holds_every_headline_and_both_definitions_of_the_ece_beside_it() -> None:
    known, default = known_metrics(Protocol(), PERSON), metrics_of(Protocol(), PERSON)
    assert {name for name, metric in known.items() if metric.headline} <= set(default)
    assert {"min_mpjpe", "mpjpe", "pa_min_mpjpe", "pck", "auc", "cps", "diversity"} <= set(default)
    assert {"ece", "ece_paper", "ece_reference", "signed_area", "coverage_90", "radius_50"} <= set(default)


def test_a_default_metric_costs_no_statistic_that_no_headline_needs_but_two() -> None:
    default = metrics_of(Protocol(), PERSON)
    needed = {metric.statistic.name for metric in default.values() if metric.headline}
    assert {metric.statistic.name for metric in default.values()} - needed == {"errors_by_n", "inside_reference"}


def test_named_metrics_come_in_the_order_of_a_report() -> None:
    found = metrics_of(Protocol(metrics=" ece,min_mpjpe , pck"), PERSON)
    assert list(found) == ["min_mpjpe", "pck", "ece"]


@pytest.mark.parametrize("group", ["rank_tests", "scores"])
def test_a_group_s_word_gives_its_family(group: str) -> None:
    known = known_metrics(Protocol(), PERSON)
    found = metrics_of(Protocol(metrics=group), PERSON)
    assert list(found) == [name for name, metric in known.items() if metric.family == group]
    assert found


def test_words_and_names_are_put_together() -> None:
    found = metrics_of(Protocol(metrics="scores, tarp, mpjpe"), PERSON)
    assert set(found) == {*metrics_of(Protocol(metrics="scores"), PERSON), "tarp", "mpjpe"}
    assert set(metrics_of(Protocol(metrics="default, all"), PERSON)) == set(known_metrics(Protocol(), PERSON))


def test_a_user_s_pre_rank_is_a_metric_under_its_name() -> None:
    own = replace(PERSON, preranks=("height",))
    known = known_metrics(Protocol(), own, {"height": lambda pool: pool[:, 0, 2]})
    assert known["height"].family == "rank_tests"


def test_a_pre_rank_without_its_function_can_be_read_but_not_computed() -> None:
    metric = known_metrics(Protocol(), replace(PERSON, preranks=("height",)))["height"]
    assert metric.finish(np.full((1, 21), 0.5)) == pytest.approx(np.abs(np.arange(21) / 20 - 0.5).mean())
    with pytest.raises(
        PoseDataError, match=r"prerank: 'height' is known from a saved result only; expected its function\."
    ):
        metric.statistic.compute(Block(np.zeros((7, 1, 17, 3)), np.zeros((1, 17, 3))))


def test_against_a_reference_every_proper_score_has_a_skill() -> None:
    known = known_metrics(Protocol(), replace(PERSON, reference="climatology"))
    skills = {name: metric for name, metric in known.items() if name.endswith("_skill")}
    assert set(skills) == {"energy_skill", "joint_energy_skill", "crps_skill", "variogram_skill", "brier_skill"}
    # the model's mean score is 3, the reference's 4: a quarter better
    assert skills["variogram_skill"].finish(np.array([3.0, 4.0])) == pytest.approx(0.25)
    assert np.isnan(skills["variogram_skill"].finish(np.array([[3.0, 0.0], [3.0, 1e-9]]))).all()  # 0 but for rounding
    assert skills["variogram_skill"].finish(np.array([0.0, 2e-9])) == 1
    ranked = {name for name, metric in skills.items() if metric.direction == "higher"}
    assert ranked == set(skills) - {"brier_skill"}  # whose event is each model's own


def test_numbers_by_occlusion_have_the_names_of_those_over_all_joints() -> None:
    marked = replace(PERSON, has_occlusion=True)
    kinds_of_joints = occlusion_metrics_of(Protocol(), marked)
    assert list(kinds_of_joints) == ["occluded", "visible"]
    for occlusion, metrics in kinds_of_joints.items():
        assert set(metrics) <= set(known_metrics(Protocol(), marked))
        assert all(occlusion in metric.definition for metric in metrics.values())


def test_numbers_by_occlusion_need_marks_and_two_hypotheses() -> None:
    with pytest.raises(
        PoseDataError, match=r"by: occlusion needs to know which joints are occluded; expected a member"
    ):
        occlusion_metrics_of(Protocol(), PERSON)
    with pytest.raises(PoseDataError, match=r"by: occlusion needs at least 2 hypotheses; there is 1\."):
        occlusion_metrics_of(Protocol(), replace(PERSON, has_occlusion=True, n_hypotheses=1))
    assert occlusion_metrics_of(Protocol(), replace(PERSON, has_occlusion=True, n_hypotheses=2))["visible"]


def test_with_one_hypothesis_there_is_no_calibration_and_no_spread() -> None:
    one = known_metrics(Protocol(), DataSpec(1, H36M, 0, ("sequence",), 25.0, True))
    assert {metric.family for metric in one.values()} == {"accuracy"}
    assert {"min_mpjpe", "cps", "mpjve", "weighted_pose_mpjpe"} <= set(one)


def test_without_sequences_there_are_no_velocities() -> None:
    assert not [name for name in known_metrics(Protocol(), DataSpec(7, H36M, 0)) if "mpjve" in name]


def test_without_scores_there_is_no_weighted_pose_and_a_mode_only_by_its_index() -> None:
    unscored = DataSpec(7, H36M, 0)
    assert not [name for name in known_metrics(Protocol(), unscored) if "weighted" in name or "mode" in name]
    assert "pa_mode_mpjpe" in known_metrics(Protocol(mode="6"), unscored)


def test_errors_in_the_world_are_of_sequences_that_are_relative_to_no_root() -> None:
    names = {"wa_mpjpe", "w_mpjpe", "min_wa_mpjpe", "min_w_mpjpe"}
    assert not names & known_metrics(Protocol(), PERSON).keys()
    assert not names & known_metrics(Protocol(), DataSpec(7, H36M)).keys()
    in_world = replace(PERSON, root=None)
    assert names <= known_metrics(Protocol(), in_world).keys()
    assert not names & metrics_of(Protocol(), in_world).keys()
    assert {*metrics_of(Protocol(metrics="w_mpjpe"), in_world)} == {"w_mpjpe"}


def test_no_statistic_of_the_default_report_needs_other_poses() -> None:
    for spec in (PERSON, replace(PERSON, root=None)):
        assert not [s.name for s in statistics_of(Protocol(), spec) if s.earlier or s.by_segment]
    motion = statistics_of(Protocol(metrics="mpjve, acceleration_error, jitter, true_jitter, mpjpe"), PERSON)
    assert {s.name: s.earlier for s in motion} == {
        "truth": 0,
        "errors": 0,
        "joint_errors": 0,
        "mpjve": 1,
        "acceleration_error": 2,
        "jitter": 3,
        "true_jitter": 3,
    }


def test_min_mpjpe_is_given_at_round_numbers_up_to_n() -> None:
    names = [name for name in known_metrics(Protocol(), PERSON) if name.startswith("min_mpjpe_at_")]
    assert names == ["min_mpjpe_at_1", "min_mpjpe_at_2", "min_mpjpe_at_5"]
    many = [name for name in known_metrics(Protocol(), replace(PERSON, n_hypotheses=3000)) if "min_mpjpe_at_" in name]
    assert many == [f"min_mpjpe_at_{d * 10**k}" for k in range(4) for d in (1, 2, 5) if d * 10**k <= 1000]


@pytest.mark.parametrize(
    ("names", "spec", "words"),
    [
        ("minMPJPE", PERSON, r"metrics: minMPJPE is not known\. Did you mean min_mpjpe\?"),
        ("min_mpjep", PERSON, r"metrics: min_mpjep is not known\. Did you mean min_mpjpe\?"),
        (
            "mpjve",
            DataSpec(7, H36M, 0),
            r"metrics: mpjve needs sequences\. Store a label sequence in the truth's file\.",
        ),
        ("true_jitter", DataSpec(1, H36M, 0), r"metrics: true_jitter needs sequences\. Store a label sequence"),
        ("w_mpjpe", DataSpec(7, H36M, 0), r"metrics: w_mpjpe needs sequences\. Store a label sequence"),
        (
            "min_wa_mpjpe",
            PERSON,
            r'^metrics: min_wa_mpjpe needs positions in the world, .*; expected root_joint="none"\.$',
        ),
        (
            "wa_mpjpe",
            replace(PERSON, root=None, n_coordinates=2),
            r"metrics: wa_mpjpe needs positions of three coordinates; the data are mm, D = 2\.",
        ),
        ("mode_mpjpe", DataSpec(7, H36M, 0), r"mode_mpjpe needs the model's scores\..* or set mode to an index\."),
        (
            "n_weighted_pose_mpjpe",
            DataSpec(7, H36M, 0),
            r"n_weighted_pose_mpjpe needs the model's scores\. Store scores beside the hypotheses\.$",
        ),
        ("ece_paper", DataSpec(1, H36M, 0), r"metrics: ece_paper needs at least 2 hypotheses; there is 1\."),
        ("coverage_50", DataSpec(1, H36M, 0), r"coverage_50 needs at least 2 hypotheses"),
        ("radius_50", DataSpec(1, H36M, 0), r"radius_50 needs at least 2 hypotheses"),
        ("rank_tests", DataSpec(1, H36M, 0), r"metrics: rank_tests needs at least 2 hypotheses"),
        ("a1, pck, b2", PERSON, r"(?s)2 problems:.*metrics: a1 is not known.*metrics: b2 is not known"),
        ("", PERSON, r"metrics: ''; expected default, rank_tests, scores, all, or names with commas\."),
    ],
)
def test_metrics_that_can_t_be_given_are_refused_with_what_they_need(names: str, spec: DataSpec, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        metrics_of(Protocol(metrics=names), spec)


@pytest.mark.parametrize("best", ["sequence", "batch:3"])
def test_a_best_per_sequence_needs_sequences(best: str) -> None:
    with pytest.raises(PoseDataError, match=rf"best: {best} needs sequences\. Store a label sequence"):
        known_metrics(Protocol(best=best), DataSpec(7, H36M, 0))


def test_a_velocity_per_second_needs_the_frames_per_second() -> None:
    with pytest.raises(PoseDataError, match=r"velocity: second needs the frames per second\. Store fps"):
        known_metrics(Protocol(velocity="second"), DataSpec(7, H36M, 0, ("sequence",)))


def test_a_mode_is_one_of_the_hypotheses() -> None:
    with pytest.raises(PoseDataError, match=r"mode: 7; expected score or the index of one of 7 hypotheses\."):
        known_metrics(Protocol(mode="7"), PERSON)


def test_the_curves_are_those_that_pictures_are_drawn_from() -> None:
    curves = curves_of(Protocol(), PERSON)
    assert list(curves) == ["errors_by_n", "pck_curve", "cps_curve"]
    for curve in curves.values():
        assert curve.definition
        assert all(curve.axes)


def test_names_that_no_data_could_make_known_are_refused_at_once() -> None:
    for metrics in (
        "default",
        "rank_tests, scores, all",
        "crps_skill, mpjve",
        "jitter, w_mpjpe, pve, pa_pve",
        "min_mpjpe_at_1000",
        "weighted_pose_mpjpe",
    ):
        check_names(Protocol(metrics=metrics))
    check_names(Protocol(metrics="ece, height, mine"), own=["height", "mine"])
    with pytest.raises(PoseDataError, match=r"^metrics: ecee, min_mpjpe_at_3 not known\. Did you mean ece\?$"):
        check_names(Protocol(metrics="ecee, pck, min_mpjpe_at_3"))


@pytest.mark.parametrize(
    ("metrics", "wanted"),
    [("default", False), ("ece, pck", False), ("rank_tests, scores", True), ("all", True), ("ece, crps_skill", True)],
)
def test_a_reference_is_needed_by_skills_only(metrics: str, wanted: bool) -> None:
    assert wants_reference(Protocol(metrics=metrics)) == wanted


@pytest.mark.parametrize(
    ("metrics", "curves"), [("default", True), ("all", True), ("ece, default", True), ("ece", False), ("scores", False)]
)
def test_statistics_are_those_of_the_metrics_and_of_the_curves_of_a_whole_report(metrics: str, curves: bool) -> None:
    protocol, person = Protocol(metrics=metrics), replace(PERSON, has_occlusion=True)
    names = [statistic.name for statistic in statistics_of(protocol, person)]
    needed = {statistic.name for metric in metrics_of(protocol, person).values() for statistic in metric.statistics}
    needed |= {"truth"} | ({"errors_by_n", "pck_curve", "cps_curve"} if curves else set())
    assert set(names) == needed
    assert len(names) == len(needed)
    by_occlusion = {statistic.name for statistic in statistics_of(protocol, person, ["action", "occlusion"])}
    others = set() if metrics == "ece" else {"occlusion_errors", "occlusion_radii"}
    assert by_occlusion == needed | {"standardized_errors", "occlusion_inside", *others}


def test_every_number_of_a_report_of_everything_has_a_reserved_name() -> None:
    spec = replace(PERSON, has_occlusion=True, reference="climatology", n_reference=6, dimensions=48)
    known = known_metrics(Protocol(), spec)
    assert {*known, *auxiliary_rows(known), *GROUPS} <= reserved_names()
