"""Frames join by id, with their labels, marks and scores; everything that does not fit is said, all at once."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.data.alone import resolve_hypotheses
from posecal.data.declarations import Declarations
from posecal.data.pose_data import match_poses
from posecal.errors import PoseDataError
from tests.helpers.small_files import (
    FRAMES,
    JOINTS,
    K,
    M,
    N,
    coordinates,
    gt,
    hypotheses,
    hypotheses_file,
    hyps,
    ids,
    read_data,
    truth,
    truth_file,
)

# --- frames ---------------------------------------------------------------------------------------------------


def test_numbers_of_frames_that_differ_are_said_with_the_way_to_join_them() -> None:
    with pytest.raises(
        PoseDataError, match=r"^hyps\.npz has M = 6 poses and gt\.npz 7; expected as many\. Give both a"
    ):
        match_poses(hyps(hypotheses()[:, :6]), gt())
    with pytest.raises(PoseDataError, match=r"to match them by \(hyps\.npz and gt\.npz without\)\.$"):
        match_poses(hyps(hypotheses()[:, :6]), gt())
    with pytest.raises(PoseDataError, match=r"to match them by \(gt\.npz without\)\.$"):
        match_poses(hyps(hypotheses()[:, :6], frame_id=ids(*FRAMES[:6])), gt())


def test_a_declared_layout_that_fits_worse_than_another_is_hinted_at() -> None:
    with pytest.raises(PoseDataError, match=r"M = 5 poses and gt\.npz 7; expected as many\. The shapes fit axes=.NMK"):
        match_poses(hyps(axes="MNKD"), gt())


def test_missing_frames_are_counted_and_the_first_are_named() -> None:
    first = r"\(first: S9/walk/009, S9/walk/001, S9/walk/000 and 2 more\)"
    words = rf"^hyps\.npz lacks 5 of the 7 frames of gt\.npz {first}\. Pass missing=.skip. to score the rest\.$"
    with pytest.raises(PoseDataError, match=words):
        match_poses(hyps(hypotheses()[:, :2], frame_id=ids(*FRAMES[:2])), gt(frame_id=ids(*FRAMES)))


def test_skipping_scores_the_frames_that_both_have_and_says_how_many_are_left_out() -> None:
    other = ["x", *FRAMES[4:1:-1]]
    found = match_poses(
        hyps(hypotheses()[:, [0, 4, 3, 2]], frame_id=ids(*other)),
        gt(frame_id=ids(*FRAMES)),
        Declarations(missing="skip"),
    )
    np.testing.assert_array_equal(coordinates(found), hypotheses()[:, 2:5])
    np.testing.assert_array_equal(found.truth, truth()[2:5])
    assert found.frame_id.tolist() == FRAMES[2:5]
    assert "hyps.npz lacks 4 of the 7 frames of gt.npz: skipped." in found.remarks
    assert "gt.npz lacks 1 of the 4 frames of hyps.npz: skipped." in found.remarks


@pytest.mark.parametrize("missing", ["error", "skip"])
def test_frames_of_no_name_in_common_are_refused_once_and_shown(missing: Any) -> None:
    words = (
        r"^hyps\.npz and gt\.npz have no frame_id in common \(0, 1, 2 and 4 more against S9/walk/005, S9/walk/003, "
        r"S9/walk/009 and 4 more\); expected the same names\.$"
    )
    with pytest.raises(PoseDataError, match=words):
        match_poses(
            hyps(frame_id=ids(*range(M))),
            gt(frame_id=ids(*FRAMES)),
            Declarations(missing=missing),
        )


def test_ids_that_fit_another_order_of_the_axes_are_hinted_at() -> None:
    words = r"^hyps\.npz: 7 frame_id for 5 poses; expected one each\. The shapes fit axes=.NMKD.\.$"
    with pytest.raises(PoseDataError, match=words):
        match_poses(hyps(axes="MNKD", frame_id=ids(*FRAMES)), gt(frame_id=ids(*FRAMES)))


@pytest.mark.parametrize("missing", ["error", "skip"])
def test_duplicate_frames_are_counted_and_named_whatever_happens_to_missing_ones(missing: Any) -> None:
    twice = ids(*FRAMES[:5], FRAMES[0], FRAMES[1])
    with pytest.raises(PoseDataError, match=r"hyps\.npz has 2 of 7 frame_id more than once \(first: S9/walk/005, S9/w"):
        match_poses(hyps(frame_id=twice), gt(frame_id=ids(*FRAMES)), Declarations(missing=missing))
    with pytest.raises(PoseDataError, match=r"gt\.npz has 2 of 7 frame_id more than once .*\. Give each frame once\."):
        match_poses(hyps(frame_id=ids(*FRAMES)), gt(frame_id=twice), Declarations(missing=missing))


@pytest.mark.parametrize("beside", [None, ids(*FRAMES)])
def test_ids_for_another_number_of_poses_are_refused(beside: Any) -> None:
    with pytest.raises(PoseDataError, match=r"gt\.npz: 3 frame_id for 7 poses; expected one each\."):
        match_poses(hyps(frame_id=beside), gt(frame_id=ids(*FRAMES[:3])))


def test_poses_without_ids_are_called_by_their_number() -> None:
    assert match_poses(hyps(), gt()).frame_id.tolist() == ["0", "1", "2", "3", "4", "5", "6"]


# --- labels, marks and scores ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["sequence", "subject", "action", "camera"])
def test_a_common_label_for_another_number_of_poses_is_refused(tmp_path: Path, name: str) -> None:
    theirs = truth_file(tmp_path, **{name: ["a"] * 8})
    with pytest.raises(PoseDataError, match=rf"^gt\.npz: {name} has 8 values for 7 poses; expected one each\.$"):
        read_data(hypotheses_file(tmp_path), theirs)


def test_another_list_of_words_is_no_label(tmp_path: Path) -> None:
    assert "axis_names" not in read_data(hypotheses_file(tmp_path), truth_file(tmp_path, axis_names=list("xyz"))).labels


def test_labels_that_contradict_each_other_are_counted() -> None:
    with pytest.raises(PoseDataError, match=r"^hyps\.npz and gt\.npz differ in action of 2 of 7 frames\. Are they in"):
        match_poses(hyps(labels={"action": ids(*"aabbbcc")}), gt(labels={"action": ids(*"aaabbbc")}))


def test_labels_follow_their_frames() -> None:
    back = slice(None, None, -1)
    pairs = match_poses(
        hyps(hypotheses()[:, back], frame_id=ids(*FRAMES[back]), labels={"camera": ids(*"abcdefg")}),
        gt(frame_id=ids(*FRAMES), labels={"action": ids(*"tuvwxyz")}),
    )
    assert "".join(pairs.labels["camera"]) == "gfedcba"
    assert "".join(pairs.labels["action"]) == "tuvwxyz"


def test_a_sequence_label_is_kept_before_the_clips_of_the_array() -> None:
    clips = gt(truth()[:6].reshape(2, 3, K, 3), axes="MTKD", labels={"sequence": ids(*"aabbbb")})
    assert "".join(match_poses(hyps(hypotheses()[:, :6]), clips).labels["sequence"]) == "aabbbb"


@pytest.mark.parametrize("which", ["hypotheses", "truth"])
def test_clips_of_either_side_are_sequences(which: str) -> None:
    x, y = hyps(hypotheses()[:, :6]), gt(truth()[:6])
    if which == "hypotheses":
        x = hyps(hypotheses()[:, :6].reshape(N, 2, 3, K, 3), axes="NMTKD")
    else:
        y = gt(truth()[:6].reshape(2, 3, K, 3), axes="MTKD")
    assert "".join(match_poses(x, y).labels["sequence"]) == "000111"


def test_marks_of_another_shape_are_refused() -> None:
    with pytest.raises(PoseDataError, match=r"^gt\.npz: occluded \(7, 3\); expected \(M, K\) = \(7, 17\)\.$"):
        match_poses(hyps(), gt(marks={"occluded": np.zeros((M, 3), dtype=bool)}))


def test_both_kinds_of_marks_are_refused() -> None:
    both = {name: np.zeros((M, K), dtype=bool) for name in ("occluded", "visible")}
    with pytest.raises(PoseDataError, match=r"^gt\.npz has both occluded and visible; expected one of them\.$"):
        match_poses(hyps(), gt(marks=both))


def test_marks_of_the_hypotheses_serve_where_the_truth_has_none() -> None:
    marks = np.arange(M * K).reshape(M, K) % 5 == 0
    np.testing.assert_array_equal(match_poses(hyps(marks={"occluded": marks}), gt()).occluded, marks)
    both = match_poses(hyps(marks={"occluded": ~marks}), gt(marks={"occluded": marks}))
    np.testing.assert_array_equal(both.occluded, marks)


def test_marks_follow_their_joints() -> None:
    marks, order = np.arange(M * K).reshape(M, K) % 5 == 0, np.arange(K)[::-1]
    pairs = match_poses(
        hyps(hypotheses()[:, :, order], joints=tuple(JOINTS[k] for k in order), marks={"visible": ~marks[:, order]}),
        gt(joints=JOINTS),
    )
    np.testing.assert_array_equal(pairs.occluded, marks)


def test_scores_are_in_the_order_of_the_declared_axes() -> None:
    scores = np.arange(N * M, dtype=float).reshape(N, M)
    poses_first = hyps(hypotheses().swapaxes(0, 1), axes="MNKD", scores=scores.T)
    np.testing.assert_array_equal(match_poses(poses_first, gt()).scores, scores)
    as_documented = hyps(hypotheses().swapaxes(0, 1), axes="MNKD", scores=scores)
    np.testing.assert_array_equal(match_poses(as_documented, gt()).scores, scores)


def test_declared_axes_decide_the_order_of_scores_where_n_is_m() -> None:
    scores = np.arange(N * N, dtype=float).reshape(N, N)
    for axes, right in (("MNKD", scores.T), ("NMKD", scores)):
        poses = hyps(np.zeros((N, N, K, 3)), axes=axes, scores=scores)
        np.testing.assert_array_equal(match_poses(poses, gt(truth()[:N])).scores, right)


def test_scores_of_another_shape_are_refused() -> None:
    with pytest.raises(PoseDataError, match=r"^hyps\.npz: scores \(7, 5\); expected \(N, M\) = \(5, 7\)\.$"):
        match_poses(hyps(scores=np.zeros((M, N))), gt())


@pytest.mark.parametrize("rate", [0.0, -25.0, np.nan, np.inf])
def test_frames_per_second_that_can_not_be_are_refused(rate: float) -> None:
    with pytest.raises(PoseDataError, match=r"^fps: .*; expected frames per second, above 0\.$"):
        match_poses(hyps(), gt(fps=rate))


def test_any_rate_of_frames_above_0_is_taken() -> None:
    assert match_poses(hyps(), gt(fps=0.5)).fps == 0.5


def test_the_truths_frames_per_second_come_first() -> None:
    assert match_poses(hyps(fps=25), gt(fps=50)).fps == 50
    assert match_poses(hyps(fps=25), gt()).fps == 25


# --- all at once, and what the pairs do -----------------------------------------------------------------------


def test_everything_that_is_wrong_is_said_at_once() -> None:
    with pytest.raises(PoseDataError, match=r"^4 problems:") as refused:
        match_poses(hyps(hypotheses()[:, :6, :16], unit="inch"), gt(joints=JOINTS, unit="yard"))
    for words in ("hyps.npz: unit: 'inch'", "gt.npz: unit: 'yard'", "M = 6 poses", "K = 16 joints"):
        assert words in str(refused.value)


def test_some_poses_of_the_pairs_are_those_of_everything_in_them() -> None:
    marks, scores = np.arange(M * K).reshape(M, K) % 5 == 0, np.arange(N * M, dtype=float).reshape(N, M)
    pairs = match_poses(
        hyps(scores=scores),
        gt(frame_id=None, labels={"action": ids(*"tuvwxyz")}, marks={"occluded": marks}),
    )
    some = pairs.select(np.array([5, 1]))
    np.testing.assert_array_equal(coordinates(some), hypotheses()[:, [5, 1]])
    np.testing.assert_array_equal(some.truth, truth()[[5, 1]])
    np.testing.assert_array_equal(some.occluded, marks[[5, 1]])
    np.testing.assert_array_equal(some.scores, scores[:, [5, 1]])
    assert some.labels["action"].tolist() == ["y", "u"]
    assert some.frame_id.tolist() == ["5", "1"]


def test_the_first_hypotheses_are_taken_where_fewer_are_asked_for() -> None:
    scores = np.arange(N * M, dtype=float).reshape(N, M)
    pairs = match_poses(hyps(scores=scores), gt(), Declarations(n_hypotheses=2))
    assert pairs.shape == (2, M, K, 3)
    np.testing.assert_array_equal(coordinates(pairs), hypotheses()[:2])
    np.testing.assert_array_equal(pairs.scores, scores[:2])


@pytest.mark.parametrize("number", [1, N, np.int64(2), 3.0])
def test_any_number_of_hypotheses_that_are_there_may_be_asked_for(number: Any) -> None:
    pairs = match_poses(hyps(), gt(), Declarations(n_hypotheses=number))
    assert pairs.shape[0] == len(coordinates(pairs)) == number
    assert type(pairs.shape[0]) is int


@pytest.mark.parametrize("number", [0, 6, -1, 1.5, True, "2", [2]])
def test_a_number_of_hypotheses_that_are_not_there_is_refused(number: Any) -> None:
    words = f"n_hypotheses: {number!r}; expected 1 to N = 5, the hypotheses of hyps.npz."
    with pytest.raises(PoseDataError, match=f"^{re.escape(words)}$"):
        match_poses(hyps(), gt(), Declarations(n_hypotheses=number))


def test_hypotheses_alone_need_no_truth() -> None:
    stored, joints, root = resolve_hypotheses(hyps(hypotheses() / 1000, unit="m", joints=JOINTS, axes="NMKD"))
    np.testing.assert_allclose(stored.read(0, M), hypotheses(), atol=1e-3)
    assert (joints, root) == (JOINTS, 0)
    with pytest.raises(PoseDataError, match=r"^hyps\.npz: nothing in it; its shape is \(5, 0, 17, 3\)\.$"):
        resolve_hypotheses(hyps(np.ones((5, 0, 17, 3))))


def test_hypotheses_alone_without_names_are_relative_to_the_joint_at_zero_of_the_first() -> None:
    moved_on = hypotheses() + 5
    moved_on[0, 0, 3] = moved_on[-1, 0, 4] = moved_on[1, 0, 5] = 0
    stored, joints, root = resolve_hypotheses(hyps(moved_on, axes="NMKD"))
    assert (root, joints[3], stored.n_hypotheses) == (3, "joint 3", N)


def test_everything_that_is_wrong_with_hypotheses_alone_is_said_at_once() -> None:
    with pytest.raises(
        PoseDataError, match=r"^2 problems:\n  - hyps\.npz: unit: 'inch'; .*\n  - hyps\.npz: 2 joints named"
    ):
        resolve_hypotheses(hyps(unit="inch", joints=("Hip", "Head")))
    with pytest.raises(PoseDataError, match=r"^hyps\.npz: axes: 'NM' lacks K, D; expected"):
        resolve_hypotheses(hyps(axes="NM"))
    with pytest.raises(PoseDataError, match=r"^hyps\.npz: axes: NMKD names 4 axes; the array has 3"):
        resolve_hypotheses(hyps(truth()))


@pytest.mark.parametrize(
    ("numbers", "follows"),
    [
        ([1, 2, 3, 5, 6, 9, 10], [True, True, False, True, False, True]),
        ([0, 64, 128, 192, 320, 384, 448], [True, True, True, False, True, True]),
        ([5, 4, 3, 2, 1, 0, 9], [True] * 5 + [False]),
    ],
)
def test_frames_follow_each_other_by_their_numbers(numbers: list[int], follows: list[bool]) -> None:
    names = ids(*[f"walk/{number:06}.png" for number in numbers])
    data = match_poses(hyps(), gt(frame_id=names, labels={"sequence": ids(*["walk"] * M)}))
    assert (np.diff(data.order) == 1).tolist() == follows
    said = [remark for remark in data.remarks if remark.startswith("frame numbers")]
    assert said == (["frame numbers are 64 apart: velocities are of steps of so many frames."] if 64 in numbers else [])


def test_velocities_skip_frames_that_are_not_there() -> None:
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (12, 5, 3))
    x = y + random.normal(0, 40, (4, 12, 5, 3))
    numbers = np.array([0, 1, 2, 3, 7, 8, 9, 10, 11, 20, 21, 22])
    names = ["mpjve", "acceleration_error", "true_jitter"]
    found = posecal.evaluate(
        *(x, y), frame_id=numbers, labels={"sequence": "a"}, unit="mm", axes="NMKD", root_joint="none", metrics=names
    )
    for order, (name, moving) in enumerate(zip(names, (x - y, x - y, y[None]), strict=True), 1):
        changes = np.linalg.norm(np.diff(moving, order, axis=1), axis=-1).mean(axis=(0, 2))
        known = numbers[order:] - numbers[:-order] == order
        assert found[name] == pytest.approx(changes[known].mean(), rel=1e-9)
