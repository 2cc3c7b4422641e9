"""Poses that shards share, found by hashes of truth and labels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine import pose_hashes as module
from posecal.engine.merge import merge_totals
from posecal.engine.pose_hashes import pose_hashes, smallest_hashes
from posecal.engine.storage import load_totals, save_totals
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError

RANDOM = np.random.default_rng(3)
TRUTH = RANDOM.normal(0, 300, (40, 5, 3))
HYPOTHESES = TRUTH + RANDOM.normal(0, 40, (6, 40, 5, 3))


def part(rows: Any, **described: Any) -> Totals:
    """The sums of some of the poses; the hypotheses are drawn anew, as those of a sampler are."""
    hypotheses = HYPOTHESES[:, rows] + np.random.default_rng(len(rows)).normal(0, 1, (6, len(rows), 5, 3))
    described = {"axes": "NMKD", "unit": "mm", "root_joint": "none", **described}
    return posecal.evaluate(hypotheses, TRUTH[rows], **described).totals


def labels(rows: Any) -> dict[str, Any]:
    return {"sequence": np.where(np.arange(40) < 20, "walk", "sit")[rows]}


def test_two_of_twenty_shared_poses_are_refused() -> None:
    """The poses stand in sequences of other lengths, and their hypotheses differ."""
    parts = [part(rows, labels=labels(rows)) for rows in (np.arange(20), np.arange(18, 40))]
    with pytest.raises(
        PoseDataError, match=r"^a and b hold the same poses: 2 with the same truth and labels; expected"
    ):
        merge_totals(parts, ["a", "b"])


def test_the_first_two_results_that_share_poses_are_named(tmp_path: Any) -> None:
    """Also when they were saved, and where one of them was merged already."""
    rows = [np.arange(10), np.arange(10, 20), np.arange(20, 30), [*range(30, 38), 12, 13, 14]]
    parts = [part(some, labels=labels(some)) for some in rows]
    for number, some in enumerate(parts):
        save_totals(some, tmp_path / f"{number}.npz")
    parts = [load_totals(tmp_path / f"{number}.npz") for number in range(4)]
    with pytest.raises(PoseDataError, match=r"^b and d hold the same poses: 3 with"):
        merge_totals(parts, ["a", "b", "c", "d"])
    with pytest.raises(PoseDataError, match=r"^the 1st result and the 2nd result hold the same poses: 3 with"):
        merge_totals([merge_totals(parts[:3]), parts[3]])


def test_equal_poses_of_other_labels_or_frames_are_others() -> None:
    rows = np.arange(12)
    one, other = (part(rows, labels={"sequence": "walk", "camera": camera}) for camera in ("left", "right"))
    assert merge_totals([one, other]).poses.sum() == 24
    one, other = (part(rows, frame_id=[f"{name} {row}" for row in rows]) for name in "ab")
    assert merge_totals([one, other]).poses.sum() == 24
    with pytest.raises(PoseDataError, match=r"hold the same poses: 12 with"):
        merge_totals([one, part(rows, frame_id=[f"a {row}" for row in rows])])
    with pytest.raises(PoseDataError, match=r"hold the same poses: 12 with"):
        merge_totals([one, part(rows)])  # without names they can't be others


def test_poses_that_repeat_within_a_shard_tell_nothing() -> None:
    """As those of two cameras without a label, in coordinates of the world."""
    twice = [*range(6), *range(6)]
    assert merge_totals([part(twice), part(range(6))]).poses.sum() == 18


def test_repeated_poses_are_remarked_on() -> None:
    evaluation = posecal.Evaluation(axes="NMKD", unit="mm", root_joint="none")
    for rows in ([*range(10)], [*range(10, 17), 0, 1, 2]):  # three to fill the batch
        evaluation.update(HYPOTHESES[:, rows], TRUTH[rows])
    of_hypotheses, remark = evaluation.totals().remarks
    assert of_hypotheses.startswith("hypotheses: in 3 of 20 frames (first: 17, 18, 19) the hypotheses are those of an")
    assert remark.startswith("truth: 3 of 20 frames with truth and labels of another count twice. Were they repeated")


@pytest.mark.parametrize(
    ("rows", "changes"),
    [
        ([*range(17), 0, 1, 2], {"frame_id": range(20)}),
        ([*range(17), 0, 1, 2], {"labels": {"time": range(20)}}),
        ([*range(10)] * 4, {}),
    ],
)
def test_frames_that_are_told_apart_and_views_of_one_moment_are_not_remarked_on(rows: Any, changes: Any) -> None:
    assert part(rows, **changes).remarks == ()


def test_the_hash_depends_on_every_coordinate_and_label_and_not_on_precision_or_the_width_of_text() -> None:
    def hashes(truth: Any, **labels: Any) -> Any:
        some = posecal.PoseData(truth[None].repeat(3, 0), truth, axes="NMKD", unit="mm", labels=labels)
        return pose_hashes(some.truth, some.labels, None)[:, 0]

    truth = TRUTH[:4].astype(np.float32)
    expected = hashes(truth, action="sit")
    np.testing.assert_array_equal(hashes(truth.astype(np.float64), action=np.array(["sit"] * 4, dtype="U9")), expected)
    assert not np.isin(hashes(truth, action="sat"), expected).any()
    assert not np.isin(hashes(truth, deed="sit"), expected).any()
    for place in np.ndindex(5, 3):
        moved = truth.copy()
        moved[(slice(None), *place)] = np.nextafter(moved[(slice(None), *place)], np.inf)
        assert not np.isin(hashes(moved, action="sit"), expected).any()


def test_of_many_poses_the_smallest_hashes_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_HASHES", 5)
    hashes = np.random.default_rng(0).integers(0, 1 << 60, (30, 2), dtype=np.uint64)
    kept = smallest_hashes([hashes[:11], hashes[11:]])
    np.testing.assert_array_equal(kept[:, 0], np.sort(hashes[:, 0])[:5])
    np.testing.assert_array_equal(smallest_hashes([smallest_hashes([hashes[:11]]), hashes[11:]]), kept)


def test_few_coordinates_that_are_equal_by_chance_say_nothing_without_frame_ids() -> None:
    """Such as whole degrees of one angle."""
    angles = np.random.default_rng(0).integers(0, 20, (30, 1, 1)).astype(float)
    samples = angles + np.random.default_rng(1).normal(0, 5, (9, 30, 1, 1))
    one, other = (posecal.evaluate(samples, angles, unit="deg", axes="NMKD", labels={"sequence": "a"}) for _ in "ab")
    assert not any("count twice" in remark for remark in one.remarks)
    assert merge_totals([one.totals, other.totals]).poses.sum() == 60
    named = posecal.evaluate(samples, angles, unit="deg", axes="NMKD", frame_id=range(30)).totals
    with pytest.raises(PoseDataError, match="hold the same poses: 30"):
        merge_totals([named, named])


def test_of_many_poses_the_repeated_ones_are_estimated(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the hashes that are kept, of which the smallest may be of any pose."""
    hashes = np.repeat(
        np.random.default_rng(1).integers(1, 1 << 60, (1000, 2), dtype=np.uint64), [1, 1, 1, 1, 2] * 200, 0
    )
    monkeypatch.setattr(module, "MOST_HASHES", 300)
    (remark,) = module.repeated_remarks(smallest_hashes([hashes]), 1200, "truth")
    number = int(remark.split("about ")[1].split(" of 1,200 frames")[0])
    assert number == pytest.approx(200, rel=0.2)
    monkeypatch.setattr(module, "MOST_HASHES", 1200)
    (remark,) = module.repeated_remarks(smallest_hashes([hashes]), 1200, "truth")
    assert remark.startswith("truth: 200 of 1,200 frames with truth")


def test_poses_that_are_shared_are_at_least_those_whose_hashes_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = [part(np.arange(20), labels=labels(np.arange(20)))] * 2
    monkeypatch.setattr("posecal.engine.merge.MOST_HASHES", 20)
    with pytest.raises(PoseDataError, match="hold the same poses: at least 20 with"):
        merge_totals(parts)


def test_zero_has_one_hash_whatever_its_sign_and_nine_coordinates_are_enough() -> None:
    truth = np.array([[[0.0, 1, 2], [3, 0, 5], [6, 7, 0]]])
    plain = pose_hashes(truth, {}, None)
    assert plain[0, 0] > 0
    np.testing.assert_array_equal(pose_hashes(np.where(truth == 0, -0.0, truth), {}, None), plain)
    assert not pose_hashes(truth[:, :, :2], {}, None).any()


def test_many_parts_are_put_together_and_hold_the_same_hashes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_PARTS", 4)
    hashes = np.random.default_rng(0).integers(1, 1 << 60, (23, 2), dtype=np.uint64)
    parts: list[Any] = []
    for row in hashes:
        module.add_hashes(parts, row[None])
        assert len(parts) <= 4
    np.testing.assert_array_equal(smallest_hashes(parts), smallest_hashes([hashes]))


def test_clips_that_come_twice_are_said_to_whatever_their_numbers() -> None:
    """A sampler for several processes repeats whole clips to fill its last batch."""
    rows = [*range(6), 0, 1]
    x, y = HYPOTHESES.reshape(6, 8, 5, 5, 3)[:, rows], TRUTH.reshape(8, 5, 5, 3)[rows]
    described: dict[str, Any] = {"axes": "NMTKD", "truth_axes": "MTKD", "unit": "mm", "root_joint": "none"}
    found = [
        [remark for remark in posecal.evaluate(x[:, :end], y[:end], **described).remarks if "count twice" in remark]
        for end in (6, 8)
    ]
    assert found[0] == []
    assert len(found[1]) == 1
    assert found[1][0].startswith("truth: 10 of 40 frames with truth and labels of another count twice.")
