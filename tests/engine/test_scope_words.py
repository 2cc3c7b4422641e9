"""The joints that each kind of metric is about, and the words that say so."""

from __future__ import annotations

import pytest

from posecal.data.skeleton import JOINT_SETS
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
        Scope(Protocol(pck_joints="mpii-16"), DataSpec(5, ("tail", "wing"), None)).pck  # noqa: B018


@pytest.mark.parametrize(
    ("protocol", "option"),
    [
        (Protocol(joints="Hip", root="drop"), "joints"),
        (Protocol(joints="Hip"), "joints without the root"),
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
