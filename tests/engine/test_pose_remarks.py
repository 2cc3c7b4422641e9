"""Hypotheses that look like none or like no samples, and joints that repeat or are a fill value, wherever they are."""

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.merge import merge_totals
from tests.helpers.small_files import FRAMES, JOINTS, K, N, hypotheses, truth

Array = np.ndarray[Any, Any]
OPTIONS: dict[str, Any] = {"axes": "NMKD", "unit": "mm", "joints": JOINTS}
LONG = 90  # more frames than any sample looks at
_RANDOM = np.random.default_rng(5)
Y = _RANDOM.normal(0, 300, (LONG, K, 3))
X = Y + _RANDOM.normal(0, 40, (8, LONG, K, 3))


def said(x: Array, y: Array, *words: str, **options: Any) -> list[str]:
    """The remarks on poses, those with such words."""
    options = {**OPTIONS, "metrics": "mpjpe", "threads": 1, **options}
    remarks = [*posecal.evaluate(x, y, **options).remarks]
    return [remark for remark in remarks if any(word in remark for word in words)] if words else remarks


def in_parts(x: Array, y: Array, length: int, **options: Any) -> tuple[list[str], list[str]]:
    """The remarks on batches, and on results that are merged."""
    options = {**OPTIONS, "metrics": "mpjpe", **options}
    parts = [posecal.Evaluation(**options) for _ in range(0, len(y), length)]
    together = posecal.Evaluation(**options)
    for number, part in enumerate(parts):
        rows = slice(number * length, (number + 1) * length)
        part.update(x[:, rows], y[rows], sequence=str(number))
        together.update(x[:, rows], y[rows], sequence=str(number))
    return [*together.compute().remarks], [*merge_totals([part.totals() for part in parts]).remarks]


def without_examples(remarks: list[str]) -> list[str]:
    return [remark.split("(")[0] + remark.split(")", 1)[-1] for remark in remarks]


# --- hypotheses -----------------------------------------------------------------------------------------------


def test_poses_as_they_should_be_are_taken_without_a_word() -> None:
    assert said(X, Y, "hypothes", "truth") == []
    assert said(X[..., :2], Y[..., :2], "hypothes", "truth") == []
    assert said(np.rint(X), np.rint(Y), "hypothes", "truth") == []


def test_a_remark_counts_the_frames_whose_hypotheses_are_points_or_the_same() -> None:
    x = hypotheses()
    x[:, [1, 4]] = 0
    x[:, 3] = x[0, 3]
    points, same = said(x, truth(), "hypotheses")
    assert points.startswith(
        "hypotheses: in 2 of 7 frames (first: 1, 4) every hypothesis is one point. Are these frames without a "
    )
    assert (
        same == "hypotheses: in 1 of 7 frames (first: 3) all hypotheses are the same. A sampler gives different ones."
    )


def test_batches_count_such_frames_together() -> None:
    x = hypotheses()
    x[:, [1, 4, 5, 6]] = 0
    evaluation = posecal.Evaluation(**OPTIONS)
    for rows in (slice(0, 3), slice(3, 7)):
        evaluation.update(x[:, rows], truth()[rows], frame_id=FRAMES[rows])
    first = f"{FRAMES[1]}, {FRAMES[4]}, {FRAMES[5]}"
    wanted = f"hypotheses: in 4 of 7 frames (first: {first}) every hypothesis is one point"
    assert [remark for remark in evaluation.compute().remarks if remark.startswith(wanted)]


@pytest.mark.parametrize("masked", [False, True])
def test_some_hypotheses_that_are_one_point_are_counted_wherever_they_are(masked: bool) -> None:
    x, where = X.copy(), np.ones((LONG, K), dtype=bool)
    x[5:, 47:67] = 3.0
    if masked:
        where[50, [4, 16]], x[:, 50, [4, 16]] = False, 77.0
    (remark,) = said(x, Y, "hypotheses:", where=where)
    assert remark.startswith("hypotheses: 60 hypotheses in 20 of 90 frames (first: 47, 48, 49) are one point, and")


@pytest.mark.parametrize("masked", [False, True])
def test_hypotheses_that_repeat_others_are_counted_wherever_they_are(masked: bool) -> None:
    x, where = X.copy(), np.ones((LONG, K), dtype=bool)
    x[4:, 50:70] = x[1:2, 50:70]  # no neighbour of theirs
    if masked:
        where[55, 3], x[:, 55, 3] = False, np.arange(24).reshape(8, 3)
    (remark,) = said(x, Y, "hypotheses:", where=where)
    assert remark == (
        "hypotheses: 80 hypotheses in 20 of 90 frames (first: 50, 51, 52) equal another of their frame, which leaves "
        "80 distinct ones there. Spread, calibration and scores are those of fewer; posecal.collapse_copies gives the "
        "distinct ones with weights."
    )


@pytest.mark.parametrize(("copies", "repeated"), [(1, 0), (2, 2), (3, 3)])
def test_copies_of_hypotheses_are_counted(copies: int, repeated: int) -> None:
    remarks = said(hypotheses()[np.arange(N) // copies], truth(), "equal another")
    assert [remark.split(" in ")[0] for remark in remarks] == [f"hypotheses: {7 * repeated} hypotheses"] * (copies > 1)


def test_few_coordinates_may_be_equal_by_chance() -> None:
    x = np.random.default_rng(0).integers(0, 4, (9, 200, 2, 1)).astype(float)
    assert said(x, x.mean(axis=0).round(), "hypotheses:", joints=None, unit="deg") == []


def test_angles_of_which_all_hypotheses_are_the_same_are_counted() -> None:
    random = np.random.default_rng(1)
    y = random.uniform(-150, 150, (60, 3, 1))
    x = y + random.normal(0, 8, (12, *y.shape))
    assert said(x, y, "hypotheses:", joints=None, unit="deg") == []
    x[:, ::10] = 0
    (remark,) = said(x, y, "hypotheses:", joints=None, unit="deg")
    assert remark.startswith("hypotheses: in 6 of 60 frames (first: 0, 10, 20) all hypotheses are the same.")


def test_the_truth_among_the_hypotheses_is_found() -> None:
    x = X.copy()
    x[3, 40:52] = Y[40:52]
    x[3, 51, 8, 1] += 5
    where = np.ones((LONG, K), dtype=bool)
    where[40, 5], x[3, 40, 5] = False, 1.0
    words = "a hypothesis equals the truth. Is the truth among the samples?"
    assert said(x, Y, "hypotheses:", where=where) == [f"hypotheses: in 11 of 90 frames (first: 40, 41, 42) {words}"]
    assert said(Y[None], Y, "hypotheses:") == [f"hypotheses: in 90 of 90 frames (first: 0, 1, 2) {words}"]
    assert said(Y[None].astype(np.float32), Y, "equals the truth")


def test_the_truth_in_fewer_digits_or_elsewhere_is_found_and_a_sharp_model_is_not() -> None:
    """Positions are relative to the root, so that the truth in the camera's frame and about its root are one."""
    words = "a hypothesis equals the truth"
    x = np.concatenate([X, (Y / 1000).astype(np.float16)[None] * 1000.0])
    assert said(x, Y, words)
    elsewhere = np.concatenate([X, Y[None] - Y[:, :1]])
    assert said(elsewhere, Y, words)
    assert said(elsewhere, Y, words, root_joint="none") == []
    sharp = np.concatenate([X, Y[None] + _RANDOM.normal(0, 2, Y.shape)])
    assert said(sharp, Y, words) == said(X[:1], Y, words) == []


def test_the_truth_is_found_where_joints_or_hypotheses_are_absent_and_a_joint_is_not_judged_by_another() -> None:
    words, last = "a hypothesis equals the truth", Y.shape[1] - 1
    where = np.ones(Y.shape[:2], dtype=bool)
    where[:, last] = False
    x = np.concatenate([X, Y[None]])
    x[:, :, last] = np.nan
    assert said(x, Y, words, where=where)
    absent = np.concatenate([np.full((len(X) + 5, *Y.shape), np.nan), X, Y[None]])
    assert said(absent, Y, words)
    spread = np.full(Y.shape[1], 0.5)
    spread[last] = 300.0
    sharp = Y + _RANDOM.normal(0, 1, (50, *Y.shape)) * spread[:, None]
    where[:] = False
    where[:, 1] = True
    assert said(sharp, Y, words, where=where, root_joint="none") == []


def test_one_pose_over_a_clip_is_a_prediction() -> None:
    truth = np.random.default_rng(3).normal(0, 300, (6, 5, 9, 3))
    still = np.repeat(truth[:, :1] + 20.0, 5, axis=1)[:, :, None]
    report = posecal.evaluate(still, truth, unit="mm", axes="MTNKD", root_joint="none", metrics="mpjpe")
    assert not [remark for remark in report.remarks if "earlier frame" in remark]


def test_hypotheses_of_an_earlier_frame_are_counted_also_in_batches() -> None:
    x, words = X.copy(), "the hypotheses are those of an earlier frame. Were they stored twice, or beside other frames?"
    assert said(x, Y, words) == []
    x[:, 60:63] = x[:, 7:10]
    remark = f"hypotheses: in 3 of 90 frames (first: 60, 61, 62) {words}"
    assert said(x, Y, words) == [remark]
    of_batches, _ = in_parts(x, Y, 30)
    assert [found.startswith("hypotheses: in 3 of 90 frames") for found in of_batches if words in found] == [True]
    x[1, 60:63] += 9  # others beside the same are others
    assert said(x, Y, words) == []


def test_frames_whose_hypotheses_are_in_another_unit_are_counted() -> None:
    x = X.copy()
    x[:, 30:45] /= 1000
    (remark,) = said(x, Y, "one unit")
    assert remark.startswith("hypotheses: in 15 of 90 frames (first: 30, 31, 32) hypotheses are over 100 times larger")
    assert said(X * 15, Y, "one unit") == []


@pytest.mark.parametrize(
    ("scores", "number"),
    [
        (lambda live: live * 1.0, 60),
        (lambda live: live / live.sum(axis=0) * 10, 60),
        (lambda live: np.where(live, -1.0, -np.inf), 60),
        (lambda live: np.where(live, 0.5, 0.25), 0),
        (lambda live: (np.arange(8)[:, None] == 2) * np.ones(LONG), 0),  # it marks a hypothesis
        (lambda live: np.float32(live / live.sum(axis=0) * 1.0015), 0),  # as numbers of eight bits may be off
    ],
)
def test_scores_that_may_mark_absent_hypotheses_and_do_not_are_remarked_on(scores: Any, number: int) -> None:
    live = np.ones((8, LONG))
    live[5:, 40:60] = 0
    remarks = said(X, Y, "score 0", scores=scores(live))
    start = "hypotheses: 60 hypotheses in 20 of 90 frames (first: 40, 41, 42) have score 0 or -inf, and count"
    assert [remark.startswith(start) for remark in remarks] == [True] * (number > 0)


def test_absent_hypotheses_are_not_looked_at() -> None:
    live = np.ones((8, LONG))
    live[5:, 40:60] = 0
    x = np.where(live[..., None, None], X, 0)
    assert said(x, Y, "one point", "equal another", "score 0", scores=live / live.sum(axis=0)) == []
    assert said(np.where(live[..., None, None], X, np.nan), Y, "one point", "equal another") == []


# --- joints ---------------------------------------------------------------------------------------------------


def test_joints_that_equal_others_are_named_with_them() -> None:
    y = truth()
    y[:, 5], y[:, 9] = y[:, 2], y[:, 2]
    y[1:, 12] = y[1:, 3]  # whole numbers in some frames may be chance
    remarks = said(hypotheses(), y, "equal others")
    pairs = f"{JOINTS[5]} = {JOINTS[2]}, {JOINTS[9]} = {JOINTS[5]}"
    assert remarks == [
        f"truth: joints equal others in 7 of 7 frames ({pairs}), which so count more than once in means over "
        "joints. The protocol's option joints chooses those to score."
    ]


@pytest.mark.parametrize("length", [1, 30])
def test_joints_that_repeat_in_some_frames_are_counted_in_batches_of_any_length(length: int) -> None:
    y, x = Y.copy(), X.copy()
    y[60:, 5] = y[60:, 6]
    x[:, 33:53, 8] = x[:, 33:53, 9]
    x[0, :33, 8] = x[0, :33, 9]  # in one hypothesis
    expected = [
        f"hypotheses: joints equal others in 20 of 90 frames ({JOINTS[9]} = {JOINTS[8]})",
        f"truth: joints equal others in 30 of 90 frames ({JOINTS[6]} = {JOINTS[5]})",
    ]
    for remarks in (said(x, y), *in_parts(x, y, length)):
        assert [remark.split(",")[0] for remark in remarks if "equal others" in remark] == expected


def test_joints_repeat_also_where_some_do_not_count_and_in_hypotheses_only_where_the_truth_does_not() -> None:
    x, y, where = X.copy(), Y.copy(), np.ones((LONG, K), dtype=bool)
    y[:, 5], x[:, :, 5] = y[:, 6], x[:, :, 6]
    where[np.arange(LONG), np.arange(LONG) % 4 + 7] = False
    where[3, 5] = False
    (remark,) = said(x, y, "equal others", where=where)
    assert remark.startswith(f"truth: joints equal others in 89 of 90 frames ({JOINTS[6]} = {JOINTS[5]})")


def test_whole_pixels_that_are_equal_by_chance_are_neither_repeated_joints_nor_fill_values() -> None:
    random = np.random.default_rng(1)
    y = random.integers(0, 400, (500, K, 2)).astype(float)
    y[:40, 3] = y[:40, 4]
    assert (y[..., 0] == y[..., 1]).sum() > 10
    x = np.rint(y + random.normal(0, 5, (4, *y.shape)))
    assert said(x, y, "exactly", "equal", unit="px") == []


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("value", [-1000.0, 9999.0, -1.0, 0.0])
def test_joints_that_are_a_fill_value_are_counted_in_truth_and_hypotheses(value: float, d: int) -> None:
    random = np.random.default_rng(0)
    y = random.uniform(100, 900, (20, K, d))
    x = y + random.normal(0, 30, (5, *y.shape))
    y[[3, 4, 11], 2] = x[:, [6, 18], 5] = value
    options: dict[str, Any] = {"unit": "px", "root_joint": "none"}
    expected = [
        f"hypotheses: joints are exactly {value:g} in 10 hypotheses (first: {JOINTS[5]}). Where",
        f"truth: joints are exactly {value:g} in 3 of 20 poses (first: {JOINTS[2]}). Where",
    ]
    found = said(x, y, "exactly", **options)
    assert [remark.split(" that stands")[0] for remark in found] == expected
    if value in (0, -1000, 9999) and d == 3:
        for remarks in in_parts(x, y, 1, **options):
            assert sorted(remark for remark in remarks if "exactly" in remark) == found
    where = np.ones(y.shape[:2], dtype=bool)
    where[[3, 4, 11], 2] = where[[6, 18], 5] = False
    assert said(x, y, "exactly", where=where, **options) == []


@pytest.mark.parametrize("value", [65504.0, 9.9e6, -1000.0])
def test_one_place_is_enough_where_three_large_coordinates_are_equal(value: float) -> None:
    x, y = X.copy(), Y.copy()
    x[3, 47, 4] = value
    (remark,) = said(x, y, "exactly")
    assert remark.startswith(f"hypotheses: joints are exactly {value:g} in 1 hypothesis (first: {JOINTS[4]}).")
    y[61, 5] = 9999
    assert said(X, y, "exactly")[0].startswith(f"truth: joints are exactly 9999 in 1 of 90 poses (first: {JOINTS[5]}).")
    x[3, 47, 4] = 321.0  # once
    assert said(x, Y, "exactly") == []


def test_joints_that_are_0_in_every_frame_are_counted_but_roots() -> None:
    x, y = X.copy(), Y.copy()
    x[:, :, 0] = y[:, 0] = 0
    assert said(x, y, "exactly") == []
    assert said(x, y, "exactly", root_joint="none") == []
    assert said(X, y, "exactly", root_joint="none") == []
    x[:, :, 9] = y[:, 9] = 0  # the root of another skeleton
    assert said(x, y, "exactly", root_joint="none") == []
    x[:, :, 9] = X[:, :, 9]
    (remark,) = said(x, y, "exactly")
    assert remark.startswith(f"truth: joints are exactly 0 in 90 of 90 poses (first: {JOINTS[9]}).")
    x = X.copy()
    x[:, :, 5] = 0
    (remark,) = said(x, Y, "exactly")
    assert remark.startswith(f"hypotheses: joints are exactly 0 in 720 hypotheses (first: {JOINTS[5]}).")


def test_a_root_that_is_0_far_from_its_pose_is_a_fill_value() -> None:
    """Of poses in the camera's frame; where poses are relative to the root, or stand at the origin, it is none."""
    there = np.array([300.0, -200, 4000])
    y, x = Y + there, X + there
    assert said(x, y, "exactly") == []
    y[[3, 8], 0] = 0
    (remark,) = said(x, y, "exactly")
    assert remark.startswith("truth: joints are exactly 0 in 2 of 90 poses (first: Hip).")
    x[:5, 7, 0] = 0
    assert said(x, y, "exactly")[0].startswith("hypotheses: joints are exactly 0 in 5 hypotheses (first: Hip).")
    assert said(X, np.where(np.arange(LONG)[:, None, None] < 3, Y - Y[:, :1], Y), "exactly") == []


def test_a_wrist_that_is_0_before_straight_fingers_is_none() -> None:
    """Three fingertips lie closer to each other than to the wrist, about which the hypotheses are."""
    random = np.random.default_rng(8)
    across, along = np.meshgrid(np.linspace(-30, 30, 5), np.linspace(80, 170, 4))
    hand = np.vstack([np.zeros(3), np.stack([across.T, along.T, np.zeros((5, 4))], axis=-1).reshape(20, 3)])
    y = hand + random.normal(0, 3, (40, 21, 3)) + [50, -20, 600]
    x = y - y[:, :1] + random.normal(0, 5, (8, 40, 21, 3))
    x[:, :, 0] = 0
    names = ["Wrist", *(f"finger{number}" for number in range(20))]
    assert said(x, y, "exactly", joints=names, root_joint="Wrist") == []


def test_counts_of_every_kind_add_up_over_batches_and_results() -> None:
    x, y = X.copy(), Y.copy()
    x[5, ::7], x[2, 1::9], x[4, 2::5] = 0, x[3, 1::9], y[2::5]
    x[:, 3::11], x[:, 43:47, 6], y[50:53, 7] = x[0, 3::11], -1000, 0
    whole = without_examples(said(x, y, "hypotheses:", "truth:"))
    assert len(whole) == 6
    for remarks in in_parts(x, y, 10):
        found = [remark for remark in remarks if remark.startswith(("hypotheses:", "truth:"))]
        assert sorted(without_examples(found)) == sorted(whole)


@pytest.mark.parametrize("kind", ["float32", "float16", "N = 1", "K = 3", "degrees", "masked", "far away"])
def test_poses_of_any_kind_are_taken_without_a_word(kind: str) -> None:
    x, y, options = X, Y, dict[str, Any]()
    if kind.startswith("float"):
        x, y = x.astype(kind), y.astype(kind)
    elif kind == "N = 1":
        x = x[:1]
    elif kind == "K = 3":
        x, y, options = x[:, :, :3], y[:, :3], {"joints": None}
    elif kind == "degrees":
        x, y, options = np.rint(x[..., :1] / 4), np.rint(y[..., :1] / 4), {"unit": "deg", "truth_axes": "MKD"}
    elif kind == "masked":
        where = np.random.default_rng(0).random((LONG, K)) < 0.7
        where[:, 0] = True
        x, y, options = np.where(where[..., None], x, 9.0), np.where(where[..., None], y, 9.0), {"where": where}
    else:
        x, y = np.float32(x + 5000), np.float32(y + 5000)
    assert said(x, y, "hypotheses:", "truth:", "one unit", "radians", **options) == []
