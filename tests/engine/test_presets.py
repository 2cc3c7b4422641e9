"""Each preset is a set of explicit options, follows a named repository, and works on a file of poses as it stands."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import posecal
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.presets import PRESETS, as_protocol, preset
from posecal.engine.protocol import Protocol, named_joints
from posecal.errors import PoseDataError
from tests.helpers.small_files import JOINTS, K, M, N, hypotheses, truth

LABELS = {"sequence": list("aaaabbb"), "action": list("aaaabbb"), "hard": [True] * 4 + [False] * 3}
OCCLUDED = np.random.default_rng(4).random((M, K)) < 0.4

# What each published evaluation does, as the field's table of definitions says it: one entry per sentence of it.
FACTS = {
    "cgnf": {"joints": "h36m-17", "best": "frame", "root": "count"},
    "cgnf-occluded": {"where": "occluded", "root": "drop", "joints": "h36m-16", "ece_over": "pooled"},
    "prohpe": {"average": "action", "best": "frame"},
    "prohpe-h36ma": {"frames": "hard", "pck_threshold": "150.0", "pck_rule": "<"},
    "diffpose": {"scale": "norm_root"},
    "platypose": {"best": "sequence"},
    "d3dp-jbest": {"best": "joint"},
    "d3dp-pbest": {"best": "batch:4"},
    "d3dp-pagg": {"metrics": "mean_pose_mpjpe, pa_mean_pose_mpjpe"},
    "manipose-oracle": {"pck_joints": "all", "best": "frame"},
    "gfpose": {"align": "reflection"},
    "prohmr-14": {"joints": "h36m-14", "root": "drop"},
    "videopose3d": {"scale": "scale"},
    "dlow": {"mm_threshold": "500.0", "mm_alone": "count", "metrics": "apd, ade, fde, mmade, mmfde"},
    "belfusion": {"mm_threshold": "500.0", "mm_alone": "count"},
    "comusion": {"mm_threshold": "500.0", "mm_alone": "drop"},
    "skeletondiffusion": {"mm_threshold": "500.0", "mm_alone": "count"},
}
MOTION = {"dlow", "belfusion", "comusion", "skeletondiffusion"}


def evaluated(name: str) -> posecal.Report:
    """The small file; for motion prediction each of its poses is a clip, and all follow one observed pose."""
    clips = {"clip": range(M)} if name in MOTION else {}
    return posecal.evaluate(
        hypotheses(),
        truth(),
        unit="mm",
        joints=JOINTS,
        labels={**LABELS, **clips},
        observed=np.zeros((M, K, 3)) if name in MOTION else None,
        occluded=OCCLUDED,
        scores=np.arange(N * M, dtype=float).reshape(N, M),
        protocol=name,
    )


def test_every_preset_that_the_field_asks_for_is_there() -> None:
    assert set(PRESETS) == set(FACTS)


@pytest.mark.parametrize("name", FACTS)
def test_a_preset_says_what_its_evaluation_does(name: str) -> None:
    options = PRESETS[name].protocol.options
    assert {key: options[key] for key in FACTS[name]} == FACTS[name]


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_names_a_repository_and_changes_nothing_that_it_does_not_list(name: str) -> None:
    found = preset(name)
    assert found.source.count("/") == 1
    assert set(found.protocol.differences) <= set(found.options)


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_reports_the_metrics_that_it_names_as_finite_numbers(name: str) -> None:
    report = evaluated(name)
    asked = PRESETS[name].protocol.wanted
    assert set(report.metrics) == set(asked)
    assert all(np.isfinite(report.value(metric)) for metric in asked)


def test_two_presets_share_a_signature_exactly_where_they_differ_in_the_listed_metrics_alone() -> None:
    signatures = {name: evaluated(name).signature for name in PRESETS}
    for one, other in combinations(PRESETS, 2):
        alike = replace(PRESETS[one].protocol, metrics="default") == replace(PRESETS[other].protocol, metrics="default")
        assert (signatures[one] == signatures[other]) == alike, f"{one}, {other}"


def test_joint_best_is_below_frame_best_is_below_batch_best_is_below_the_mean() -> None:
    values = {}
    for name, best in (("joint", "joint"), ("frame", "frame"), ("batch", "batch:2")):
        protocol = Protocol(best=best, metrics="min_mpjpe, mpjpe")
        values[name] = posecal.evaluate(
            hypotheses(), truth(), unit="mm", joints=JOINTS, labels=LABELS, protocol=protocol
        )
    best = [values[name].value("min_mpjpe") for name in ("joint", "frame", "batch")]
    assert best == sorted(best)
    assert best[-1] < values["frame"].value("mpjpe")


def test_an_unknown_preset_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"^preset: 'cgfn' is not known\. Did you mean cgnf\?$"):
        preset("cgfn")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"bset": "frame"}, r"option: 'bset' is not known\. Did you mean best\?"),
        ({"best": "fame"}, r"best: 'fame'; expected frame, sequence, batch:k \(k sequences\) or joint\."),
        ({"best": "batch"}, r"best: 'batch'; expected"),
        ({"best": "batch:0"}, r"best: 'batch:0'; expected"),
        ({"best": "frame:3"}, r"best: 'frame:3'; expected"),
        ({"root": "keep"}, r"root: 'keep' is not known\. Known: count, drop\."),
        ({"mode": "first"}, r"mode: 'first'; expected score or the index of a hypothesis\."),
        ({"mode": "-1"}, r"mode: '-1'; expected"),
        ({"pck_threshold": "wide"}, r"pck_threshold: 'wide'; expected a length in mm\."),
        ({"pck_threshold": "0"}, r"pck_threshold: 0\.0; expected a length in mm\."),
        ({"pck_threshold": "nan"}, r"pck_threshold: nan; expected a length in mm\."),
        ({"metrics": ""}, r"metrics: ''; expected default, rank_tests, scores, all, or names with commas\."),
        ({"metrics": "ece,,pck"}, r"metrics: 'ece,,pck'; expected"),
    ],
    ids=str,
)
def test_an_option_that_can_not_be_is_refused_with_what_can(options: dict[str, str], words: str) -> None:
    with pytest.raises(PoseDataError, match=f"^{words}"):
        Protocol().changed(options)


def test_all_options_that_can_not_be_are_said_at_once() -> None:
    with pytest.raises(PoseDataError, match=r"^3 problems:"):
        Protocol(root="keep", align="no", mode="x")


def test_options_as_text_make_the_same_protocol_again() -> None:
    protocol = Protocol(best="batch:3", pck_threshold=100.0, joints="h36m-14", metrics="ece, pck")
    assert Protocol().changed(protocol.options) == protocol
    assert protocol.differences == {
        "best": "batch:3",
        "joints": "h36m-14",
        "metrics": "ece, pck",
        "pck_threshold": "100.0",
    }


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("all", ("Hip", "RKnee", "LKnee", "Head")),
        ("LKnee, RKnee", ("RKnee", "LKnee")),
        ("right_knee, head top", ("RKnee", "Head")),
        ("h36m-14", ("RKnee", "LKnee", "Head")),
        ("all but Head", ("Hip", "RKnee", "LKnee")),
        ("all but left_knee", ("Hip", "RKnee", "Head")),
        ("all but Spine", ("Hip", "RKnee", "LKnee", "Head")),
    ],
)
def test_joints_are_chosen_by_name_in_the_poses_order(text: str, chosen: tuple[str, ...]) -> None:
    assert named_joints("joints", text, ("Hip", "RKnee", "LKnee", "Head")) == chosen


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("RKne", r"joints: 'RKne' is not among the poses' joints\. Did you mean RKnee\?"),
        ("RKnee, LWrist", r"joints: 'LWrist' is not among the poses' joints\. Known: 3dhp-14, .*Head, RKnee, "),
        ("", r"joints: '' is not among the poses' joints"),
        ("all but RKne", r"joints: 'RKne' is no joint\. Did you mean RKnee\?"),
    ],
)
def test_joints_that_are_not_there_are_refused(text: str, words: str) -> None:
    with pytest.raises(PoseDataError, match=f"^{words}"):
        named_joints("joints", text, ("RKnee", "Head"))


def test_a_joint_set_of_which_nothing_is_there_is_refused() -> None:
    with pytest.raises(
        PoseDataError, match=r"^joints: the poses have none of the joints of h36m-17\. They have a, b\.$"
    ):
        named_joints("joints", "h36m-17", ("a", "b"))
    assert JOINT_SETS["h36m-17"] == JOINTS


def test_a_protocol_is_given_as_itself_by_the_name_of_a_preset_or_not_at_all() -> None:
    assert as_protocol(None) == as_protocol(Protocol()) == Protocol()
    assert as_protocol("d3dp-jbest") == preset("d3dp-jbest").protocol
    assert as_protocol("d3dp-jbest", ["ece", "pck"]) == replace(preset("d3dp-jbest").protocol, metrics="ece, pck")
    for wrong in (3, {"best": "joint"}, Protocol):
        with pytest.raises(PoseDataError, match=r"^protocol: \w+; expected a Protocol or the name of a preset\.$"):
            as_protocol(wrong)  # type: ignore[arg-type]
