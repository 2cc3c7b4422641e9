"""Are the joints of each metric the ones that were asked for, and do the words say so?"""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from posecal.data.skeleton import JOINT_SETS
from posecal.engine.block import Block
from posecal.engine.metric import Direction, Family, Metric, Statistic, entry
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError
from posecal.registry import known_metrics

H36M = JOINT_SETS["h36m-17"]
PERSON = DataSpec(5, H36M, 0, ("sequence",), 25.0, True)


def names(scope: Scope, mask: str) -> set[str]:
    return {name for name, kept in zip(scope.spec.joints, getattr(scope, mask), strict=True) if kept}


def test_by_default_a_pose_is_all_its_joints_and_all_but_the_root_move() -> None:
    scope = Scope(Protocol(), PERSON)
    assert names(scope, "body") == set(H36M)
    assert names(scope, "moving") == set(H36M) - {"Hip"}


def test_a_dropped_root_is_not_scored_but_takes_part_in_the_fit() -> None:
    scope = Scope(Protocol(root="drop"), PERSON)
    assert names(scope, "body") == names(scope, "moving") == set(H36M) - {"Hip"}
    assert names(scope, "fit") == set(H36M)


def test_an_alignment_is_fitted_to_no_joint_that_the_pose_leaves_out() -> None:
    scope = Scope(Protocol(joints="h36m-14", root="drop"), PERSON)
    assert names(scope, "fit") == names(scope, "body") == set(JOINT_SETS["h36m-14"])


@pytest.mark.parametrize(
    ("protocol", "words"),
    [
        (Protocol(root="drop"), "after Procrustes alignment (scale, rotation, translation), fitted to 17 joints (root"),
        (Protocol(where="visible"), "(scale, rotation, translation), fitted to 17 joints (root counted)"),
        (
            Protocol(),
            "the 17 joints (root counted) of ‖x − y‖ after Procrustes alignment (scale, rotation, translation)",
        ),
    ],
)
def test_a_definition_says_what_the_alignment_is_fitted_to_where_that_is_not_what_is_scored(
    protocol: Protocol, words: str
) -> None:
    known = known_metrics(protocol, PERSON)
    assert words in known["pa_min_mpjpe"].definition
    assert "fitted to 17 joints" in known["cps"].definition  # 16 of which are scored
    assert "fitted" not in known["min_mpjpe"].definition
    assert ("fitted" in known["pa_mpjpe"].definition) == (protocol != Protocol())


def test_a_brief_says_which_joints_are_scored() -> None:
    known = known_metrics(Protocol(where="occluded"), PERSON)
    for name in ("min_mpjpe", "pa_mpjpe", "pck", "cps", "ece", "radius_50"):
        assert "occluded ones of 1" in known[name].brief, name


def test_without_a_root_nothing_is_dropped() -> None:
    scope = Scope(Protocol(root="drop"), DataSpec(5, H36M))
    assert names(scope, "body") == names(scope, "moving") == set(H36M)


def test_pck_has_14_joints_and_cps_16() -> None:
    scope = Scope(Protocol(), PERSON)
    # H36M-17 indices 1-6, 8 and 10-16
    assert names(scope, "pck") == {H36M[k] for k in (*range(1, 7), 8, *range(10, 17))}
    assert names(scope, "cps") == set(H36M) - {"Spine"}


def test_metrics_have_no_joint_that_the_pose_leaves_out() -> None:
    scope = Scope(Protocol(joints="h36m-14", pck_joints="all", cps_joints="all"), PERSON)
    assert names(scope, "pck") == names(scope, "cps") == set(JOINT_SETS["h36m-14"])


def test_joints_that_are_no_person_s_have_a_pck_over_all() -> None:
    scope = Scope(Protocol(), DataSpec(5, ("tail", "wing"), None))
    assert names(scope, "pck") == names(scope, "cps") == {"tail", "wing"}


def test_a_joint_set_that_was_asked_for_is_not_replaced() -> None:
    with pytest.raises(PoseDataError, match=r"pck_joints: the poses have none of the joints of mpii-16"):
        Scope(Protocol(pck_joints="mpii-16"), DataSpec(5, ("tail", "wing"), None))


@pytest.mark.parametrize(
    ("protocol", "option"),
    [
        (Protocol(joints="Hip", root="drop"), "joints"),
        (Protocol(joints="Hip"), "joints without the root"),
        (Protocol(joints="Spine, Head", pck_joints="LWrist"), "pck_joints"),
        (Protocol(joints="Spine, Head", cps_joints="LWrist"), "cps_joints"),
    ],
)
def test_a_metric_without_joints_is_refused(protocol: Protocol, option: str) -> None:
    with pytest.raises(PoseDataError, match=rf"{option}: none is left; the poses have Hip, RHip"):
        Scope(protocol, PERSON)


@pytest.mark.parametrize(
    ("protocol", "spec", "words"),
    [
        (Protocol(), PERSON, "the 17 joints (root counted)"),
        (Protocol(root="drop"), PERSON, "the 16 joints (no root)"),
        (Protocol(joints="Hip, Head"), PERSON, "the 2 joints (root counted)"),
        (Protocol(joints="Head"), PERSON, "the 1 joint (no root)"),
        (Protocol(), DataSpec(5, H36M), "the 17 joints"),
        (Protocol(where="occluded"), PERSON, "the occluded ones of 17 joints (root counted)"),
    ],
)
def test_words_count_the_joints_and_say_what_becomes_of_the_root(
    protocol: Protocol, spec: DataSpec, words: str
) -> None:
    scope = Scope(protocol, spec)
    assert scope.counted(scope.body) == words


def test_an_item_finishes_by_reading_one_entry() -> None:
    assert entry()(np.array(2.5)) == 2.5
    assert entry(1)(np.array([2.5, 3.5])) == 3.5
    assert type(entry(0, 1)(np.array([[1.0, 2.0]]))) is float


def test_a_metric_s_statistics_are_those_of_its_number_and_of_its_joints() -> None:
    def first(block: Block) -> np.ndarray:
        return block.truth[:, 0, 0]

    one, two = Statistic("one", first), Statistic("two", first, per_joint=True)
    words = dict.fromkeys(("name", "label", "unit", "brief", "definition"), "")
    metric = Metric(**words, direction="none", family="spread", statistic=one, finish=entry())
    assert metric.statistics == (one,)
    metric = Metric(
        **words, direction="none", family="spread", statistic=one, finish=entry(), by_joint=(two, np.asarray)
    )
    assert metric.statistics == (one, two)


PROTOCOLS = [
    Protocol(),
    Protocol(best="joint", where="occluded", pck_best="linked", pck_rule="<=", auc="integral", cps_unit="share"),
    Protocol(best="sequence", align="rigid", scale="rms_mean", cps_align="none", cps_best="mean", mode="0"),
    Protocol(best="batch:3", align="reflection", align_best="own", velocity="second", deviation="population"),
    Protocol(align_best="linked", scale="norm_root", root="drop", ece_over="worst"),
]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_metric_can_be_read(protocol: Protocol) -> None:
    for name, metric in known_metrics(protocol, PERSON).items():
        assert name == metric.name
        assert name.isidentifier()
        assert name == name.lower()
        assert metric.label
        assert metric.brief
        assert metric.unit in {"", "mm", "mm/frame", "mm/s"}
        assert metric.direction in get_args(Direction)
        assert metric.family in get_args(Family)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_definition_is_one_line_that_says_what_it_is_over(protocol: Protocol) -> None:
    for metric in known_metrics(protocol, PERSON).values():
        assert "\n" not in metric.definition
        assert "joint" in metric.definition or "hypotheses" in metric.definition, metric.name


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_statistics_of_one_name_are_one_statistic(protocol: Protocol) -> None:
    """Sums are kept by name: two statistics that share one would be added to each other."""
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (4, 17, 3))
    block = Block(y + random.normal(0, 50, (5, 4, 17, 3)), y, root=0, scores=random.random((5, 4)))
    found: dict[str, np.ndarray] = {}
    for metric in known_metrics(protocol, PERSON).values():
        for statistic in metric.statistics:
            values = statistic.compute(block)
            np.testing.assert_array_equal(values, found.setdefault(statistic.name, values), err_msg=statistic.name)


def test_two_numbers_never_share_a_definition() -> None:
    for protocol in PROTOCOLS:
        definitions = [metric.definition for metric in known_metrics(protocol, PERSON).values()]
        assert len(set(definitions)) == len(definitions)
