"""Every option takes what it should, and nothing else."""

from __future__ import annotations

from dataclasses import fields
from fractions import Fraction
from typing import get_args

import numpy as np
import pytest

from posecal.data.skeleton import JOINT_SETS
from posecal.engine.presets import PRESETS, preset
from posecal.engine.protocol import CHOICES, OverJoints, Protocol, named_joints
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError
from posecal.registry import metrics_of

PERSON = 9, JOINT_SETS["h36m-17"], 0, ("sequence", "action"), 50.0, True
EVERYTHING = DataSpec(*PERSON, clip_length=25, has_observed=True)


@pytest.mark.parametrize(("option", "choice"), [(o, choice) for o, choices in CHOICES.items() for choice in choices])
def test_an_option_takes_each_of_its_choices(option: str, choice: str) -> None:
    assert getattr(Protocol().changed({option: choice}), option) == choice


@pytest.mark.parametrize("option", CHOICES)
def test_an_option_refuses_what_is_none_of_its_choices(option: str) -> None:
    with pytest.raises(PoseDataError, match=rf"{option}: 'other' is not known\. (Known|Did you mean)"):
        Protocol().changed({option: "other"})


@pytest.mark.parametrize("option", CHOICES)
@pytest.mark.parametrize("value", [None, 1, ["own"], np.zeros(3)], ids=str)
def test_an_option_refuses_what_is_no_text(option: str, value: object) -> None:
    with pytest.raises(PoseDataError, match=rf"{option}: .* is not known\."):
        Protocol(**{option: value})


def test_the_choices_are_those_of_the_types_the_default_first() -> None:
    assert CHOICES["root"] == ("count", "drop")
    assert CHOICES["ece_over"] == ("auto", *get_args(OverJoints))
    for option in fields(Protocol):
        assert (option.type.startswith("Literal")) == (option.name in CHOICES), option.name
        if option.name in CHOICES:
            assert option.default == CHOICES[option.name][0]


def test_the_defaults_that_are_no_choices_are_the_field_s() -> None:
    """PCK at 150 mm is Mehta et al.'s, over 14 joints; CPS is of 16 of 17 joints, all but the spine."""
    defaults = {name: value for name, value in Protocol().options.items() if name not in CHOICES}
    assert defaults == {
        **dict.fromkeys(("joints", "frames"), "all"),
        "best": "frame",
        "mode": "score",
        "average": "poses",
        "metrics": "default",
        "pck_joints": "h36m-14",
        "pck_threshold": "150.0",
        "failure_threshold": "150.0",
        "mm_threshold": "500.0",
        "pck_relative": "none",
        "auc_range": "0:150:31",
        "segment": "100",
        "cps_joints": "all but Spine",
    }


def test_every_option_says_what_it_is_about_and_its_form_where_its_type_does_not() -> None:
    for option in fields(Protocol):
        assert option.metadata["about"]
        assert bool(option.metadata["form"]) != (option.name in CHOICES)


@pytest.mark.parametrize("best", ["frame", "sequence", "joint", "batch:1", "batch:12"])
def test_best_takes_its_forms(best: str) -> None:
    assert Protocol(best=best).best == best


@pytest.mark.parametrize(
    "best",
    ["", "batch", "batch:", "batch:0", "batch:-1", "batch:2.5", "batch:k", "frame:2", "frame:x", "joint:", "poses"],
)
def test_best_refuses_all_else(best: str) -> None:
    with pytest.raises(
        PoseDataError, match=r"best: '.*'; expected frame, sequence, batch:k \(k sequences\) or joint\."
    ):
        Protocol(best=best)


@pytest.mark.parametrize("best", ["sequence", "batch:2", "joint"])
def test_a_linked_alignment_needs_a_best_per_frame(best: str) -> None:
    with pytest.raises(PoseDataError, match=rf"align_best: 'linked' with best: '{best}'; expected best: 'frame'\."):
        Protocol(best=best, align_best="linked")


@pytest.mark.parametrize("mode", ["score", "0", "17"])
def test_mode_takes_score_or_an_index(mode: str) -> None:
    assert Protocol(mode=mode).mode == mode


def test_mode_takes_a_number_for_an_index() -> None:
    assert Protocol(mode=3) == Protocol(mode=np.int64(3)) == Protocol(mode="3")


@pytest.mark.parametrize("mode", ["", "-1", "1.0", "first", -1, True, 1.0, None])
def test_mode_refuses_all_else(mode: str) -> None:
    with pytest.raises(PoseDataError, match=r"mode: .*; expected score or the index of a hypothesis\."):
        Protocol(mode=mode)


@pytest.mark.parametrize("threshold", [0.0, -1.0, float("nan"), float("inf"), True, None, 1j, [150.0], np.zeros(2)])
def test_a_threshold_is_a_length(threshold: float) -> None:
    with pytest.raises(PoseDataError, match=r"pck_threshold: .*; expected a length in mm\."):
        Protocol(pck_threshold=threshold)


def test_a_threshold_is_read_from_text_and_from_any_real_number() -> None:
    assert Protocol().changed({"pck_threshold": "75.5"}).pck_threshold == 75.5
    assert Protocol(pck_threshold=0.5).pck_threshold == 0.5
    for threshold in (75, np.float32(75), np.int16(75), Fraction(75)):
        assert type(Protocol(pck_threshold=threshold).pck_threshold) is float
        assert Protocol(pck_threshold=threshold) == Protocol(pck_threshold=75.0)


def test_a_threshold_that_is_no_number_is_refused() -> None:
    with pytest.raises(PoseDataError, match=r"pck_threshold: '75 mm'; expected a length in mm\."):
        Protocol().changed({"pck_threshold": "75 mm"})


def test_all_wrong_values_are_said_at_once() -> None:
    with pytest.raises(PoseDataError, match=r"(?s)5 problems:.*joints: .*root: .*best: .*mode: .*metrics: "):
        Protocol(joints=None, root="keep", best="clip", mode="last", metrics=[])  # type: ignore[arg-type]


def test_an_option_that_does_not_exist_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"option: 'jionts' is not known\. Did you mean joints\?"):
        Protocol().changed({"jionts": "all"})


def test_all_options_that_do_not_exist_are_said_at_once() -> None:
    with pytest.raises(PoseDataError, match=r"(?s)2 problems:.*'a1'.*'b2'"):
        Protocol().changed({"a1": "all", "b2": "all"})


def test_a_changed_protocol_leaves_the_first_as_it_was() -> None:
    before = Protocol()
    assert before.changed({"root": "drop"}).root == "drop"
    assert before == Protocol()


def test_the_metrics_that_are_wanted_are_the_words_of_a_list() -> None:
    assert Protocol(metrics=" ece,pck , all").wanted == ("ece", "pck", "all")


@pytest.mark.parametrize("names", [["ece", "pck"], ("ece", "pck"), "ece, pck", ["ece, pck"]])
def test_metrics_are_text_or_a_list_of_names(names: str | list[str]) -> None:
    protocol = Protocol(metrics=names)
    assert protocol.metrics == "ece, pck"
    assert protocol == Protocol(metrics="ece, pck")
    assert protocol.wanted == ("ece", "pck")


@pytest.mark.parametrize("names", ["", "ece,,pck", [], ["ece", ""], ["ece", 3], [None], None, 3, b"ece", {"ece"}])
def test_metrics_refuse_all_else(names: object) -> None:
    words = r"^metrics: .*; expected default, rank_tests, scores, all, or names with commas\.$"
    with pytest.raises(PoseDataError, match=words):
        Protocol(metrics=names)  # type: ignore[arg-type]


@pytest.mark.parametrize("option", ["joints", "frames", "pck_joints", "cps_joints", "average", "best"])
def test_options_of_names_are_text(option: str) -> None:
    with pytest.raises(PoseDataError, match=rf"^{option}: 3; expected "):
        Protocol(**{option: 3})


def test_options_as_text_make_the_same_protocol() -> None:
    protocol = Protocol(best="batch:3", pck_threshold=99.5, metrics="pck, auc")
    assert Protocol().changed(protocol.options) == protocol


def test_differences_name_the_options_that_are_not_the_defaults() -> None:
    assert Protocol().differences == {}
    assert Protocol(root="drop", mode="0").differences == {"root": "drop", "mode": "0"}


@pytest.mark.parametrize(
    ("where", "over", "summary"),
    [
        ("all", "auto", "median"),
        ("occluded", "auto", "pooled"),
        ("visible", "auto", "pooled"),
        ("all", "pooled", "pooled"),
        ("occluded", "median", "median"),
    ],
)
def test_the_summary_over_joints_is_the_paper_s_unless_it_is_said(where: str, over: str, summary: str) -> None:
    assert Protocol(where=where, ece_over=over).summary_over_joints == summary


# --- joints ----------------------------------------------------------------------------------------------------------


JOINTS = ("Head", "Hip", "LWrist", "elbow 3")


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("all", JOINTS),
        ("all but Hip", ("Head", "LWrist", "elbow 3")),
        ("all but elbow 3", ("Head", "Hip", "LWrist")),
        ("all but Spine", JOINTS),
        ("LWrist, Head", ("Head", "LWrist")),
        ("h36m-16", ("Head", "LWrist")),
        ("elbow 3", ("elbow 3",)),
    ],
)
def test_joints_are_chosen_in_the_poses_order(text: str, chosen: tuple[str, ...]) -> None:
    assert named_joints("joints", text, JOINTS) == chosen


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Haed", r"joints: 'Haed' is not among the poses' joints\. Did you mean Head\?"),
        ("Head, RKnee", r"joints: 'RKnee' is not among the poses' joints"),
        ("h36m-18", r"joints: 'h36m-18' is not among the poses' joints\. Did you mean h36m-1[67]\?"),
        ("all but Haed", r"joints: 'Haed' is no joint\. Did you mean Head\?"),
    ],
)
def test_joints_that_are_not_there_are_refused(text: str, words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        named_joints("joints", text, JOINTS)


def test_a_joint_set_of_which_the_poses_have_none_is_refused() -> None:
    with pytest.raises(
        PoseDataError, match=r"pck_joints: the poses have none of the joints of h36m-14\. They have a, b\."
    ):
        named_joints("pck_joints", "h36m-14", ("a", "b"))


# --- presets ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_s_metrics_are_there_under_its_options(name: str) -> None:
    protocol = preset(name).protocol
    assert set(metrics_of(protocol, EVERYTHING)) == set(protocol.wanted)


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_sets_its_options_and_leaves_the_others(name: str) -> None:
    found = preset(name)
    assert found.protocol.differences == {
        key: value for key, value in found.options.items() if value != Protocol().options[key]
    }


def test_an_unknown_preset_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"preset: 'd3dp-best' is not known\. Did you mean d3dp-[jp]best\?"):
        preset("d3dp-best")
