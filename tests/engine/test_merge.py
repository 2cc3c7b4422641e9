"""Merged results of shards are what one run gives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.calibration.rank_tests import NEEDS_COORDINATE_RANGE
from posecal.engine import merge
from posecal.engine.merge import in_order_of_sequences, merge_totals, merge_tree
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.registry import known_metrics
from posecal.stats.jackknife import leave_one_out
from posecal.stats.skill import climatology, with_reference
from tests.helpers.example_totals import SPEC, WALK, keeping, totals
from tests.helpers.random_worlds import World, world
from tests.helpers.sums import accumulate

OTHERS = totals().pose_hashes + np.array([100, 0], dtype=np.uint64)
"""Hashes of as many other poses."""


def cut(some: World, *cuts: int) -> list[World]:
    return [some.select(part) for part in np.split(np.arange(len(some.y)), cuts)]


def test_a_sequence_may_be_split_over_shards() -> None:
    some, protocol = world(6, M=23), Protocol(best="sequence")
    whole = some.totals(protocol)
    merged = merge_totals([part.totals(protocol) for part in cut(some, 4, 5, 17)])
    metrics = known_metrics(protocol, merged.spec)
    assert known_metrics(protocol, whole.spec).keys() - metrics.keys() == NEEDS_COORDINATE_RANGE
    for name, metric_ in metrics.items():
        if not metric_.statistic.earlier:  # no step is from shard to shard
            np.testing.assert_allclose(merged.value(metric_), whole.value(metric_), rtol=1e-12, err_msg=name)
    assert merged.poses.sum() == 23
    assert [*merged.cells["sequence"]] == [*whole.cells["sequence"]]


def test_shards_may_come_in_any_order() -> None:
    some, protocol = world(6, M=23), Protocol()
    parts = [part.totals(protocol) for part in cut(some, 9)]
    metrics = known_metrics(protocol, merge_totals(parts).spec)
    for name, metric_ in metrics.items():
        found = [merge_totals(order).value(metric_) for order in (parts, parts[::-1])]
        np.testing.assert_allclose(found[0], found[1], rtol=1e-12, err_msg=name)


def test_merging_leaves_the_parts_as_they_were() -> None:
    parts = [part.totals(Protocol()) for part in cut(world(6, M=23), 9)]
    before = [{name: sums.copy() for name, sums in part.sums.items()} for part in parts]
    merge_totals(parts).sums["errors"][:] = 0
    for part, sums in zip(parts, before, strict=True):
        for name, expected in sums.items():
            np.testing.assert_array_equal(part.sums[name], expected)


def test_one_part_merges_into_itself() -> None:
    part = world(6).totals(Protocol())
    merged = merge_totals([part])
    for name, sums in part.sums.items():
        np.testing.assert_array_equal(merged.sums[name], sums)
        np.testing.assert_array_equal(merged.counts[name], part.counts[name])


def test_a_remark_that_parts_share_stands_once() -> None:
    other = totals(cells={"sequence": np.array(["d"] * 4), "action": np.array(["sit"] * 4)}, remarks=("few", "slow"))
    other.pose_hashes = OTHERS
    other.sums["height"] = other.sums["height"] + [1, 2, 3, 4]
    assert merge_totals([totals(remarks=("few",)), other]).remarks == ("few", "slow")


def test_runs_of_frames_stay_runs_of_frames_of_their_own_shard() -> None:
    """23 poses of two shards are 23 runs of one pose, as in one run: so are their sums, and what is read off them."""
    pairs = world(6, M=23).pairs.replace(labels={})
    parts = [accumulate(part.pairs.replace(labels={})) for part in cut(world(6, M=23), 9)]
    merged, whole = merge_totals(parts), accumulate(pairs)
    assert not merged.has_sequences
    assert merged.poses.tolist() == [1] * 23
    assert merged.cells["sequence"].tolist() == [f"1/{run}" for run in range(9)] + [f"2/{run}" for run in range(14)]
    for name, sums in whole.sums.items():
        np.testing.assert_allclose(merged.sums[name], sums, rtol=1e-12, err_msg=name)
    one = known_metrics(Protocol(), whole.spec)["mpjpe"]
    np.testing.assert_allclose(sorted(leave_one_out(merged, one)), sorted(leave_one_out(whole, one)), rtol=1e-12)


def test_the_same_runs_of_frames_twice_are_refused() -> None:
    part = totals(has_sequences=False)
    with pytest.raises(PoseDataError, match=r"the 1st result and the 2nd result hold the same poses"):
        merge_totals([part, part])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"protocol": Protocol(root="drop")}, r"a and b were not made alike: root count against drop\."),
        ({"protocol": Protocol(pck_threshold=99)}, r"not made alike: pck_threshold default against 99"),
        ({"spec": replace(SPEC, n_hypotheses=9)}, r"not made alike: N 7 against 9\."),
        (
            {"spec": replace(SPEC, joints=("Head", "Spine"))},
            r"not made alike: K 2\(.{8}\) against 2\(.{8}\), origin",
        ),
        ({"version": "2.0"}, r"not made alike: posecal 1\.0 against 2\.0\."),
        (
            {"sums": {}, "counts": {}},
            r"a and b were asked for different metrics \(sums in one only: height, joints\); expected the same m",
        ),
        ({"has_sequences": False}, r"a and b: only one has sequence labels; expected both, or neither\."),
    ],
)
def test_results_that_were_not_made_alike_do_not_add(changes: dict[str, object], words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        merge_totals([totals(), totals(**changes)], ["a", "b"])


def test_labels_that_one_shard_lacks_are_dropped_and_their_cells_joined() -> None:
    """As where a label splits a sequence of one shard alone."""
    other = totals(cells={"sequence": np.array(["d", "d", "e", "e"])}, pose_hashes=OTHERS)
    for parts in ([totals(), other], [other, totals()]):
        merged = merge_totals(parts)
        assert list(merged.cells) == ["sequence"]
        assert dict(zip(merged.cells["sequence"], merged.poses, strict=True)) == {
            "a": 3,
            "b": 3,
            "c": 4,
            "d": 4,
            "e": 6,
        }
        heights = dict(zip(merged.cells["sequence"], merged.sums["height"], strict=True))
        assert heights == {"a": 30, "b": 22, "c": 0, "d": 38, "e": 14}


@pytest.mark.parametrize("parts", [[], [3], [totals(), "result.npz"]])
def test_what_is_no_result_is_refused(parts: list[Any]) -> None:
    with pytest.raises(PoseDataError, match=r"^merge: expected results \(Totals, such as report\.totals\), at least"):
        merge_totals(parts)


def test_velocities_per_second_add_only_at_one_frame_rate() -> None:
    second = Protocol(velocity="second")
    parts = [totals(second), totals(second, spec=replace(SPEC, fps=50.0))]
    with pytest.raises(PoseDataError, match=r"the 1st result and the 2nd result have 25 and 50 frames per second"):
        merge_totals(parts)


def test_sums_of_another_shape_are_refused() -> None:
    """As of a result that an older version saved."""
    parts = [totals(), totals(pose_hashes=OTHERS)]
    parts[1].sums["height"] = np.zeros((*parts[1].sums["height"].shape, 2))
    with pytest.raises(PoseDataError, match=r"have sums of different shapes \(height\); expected those of one version"):
        merge_totals(parts)


def test_a_sequence_that_two_shards_have_in_common_is_refused() -> None:
    some = world(6, M=23)
    parts = [some.select(np.flatnonzero(some.sequence != left)).totals(Protocol()) for left in ("S9/a", "S11/c")]
    both = int((~np.isin(some.sequence, ("S9/a", "S11/c"))).sum())
    with pytest.raises(PoseDataError, match=rf"the 1st result and the 2nd result hold the same poses: {both} with"):
        merge_totals(parts)


def test_a_sequence_in_common_is_refused_beside_a_reference_that_is_drawn_anew() -> None:
    some = world(6, M=23)
    parts = [some.select(np.flatnonzero(some.sequence != left)).pairs for left in ("S9/a", "S11/c")]
    scores = [accumulate(with_reference(pairs, climatology(pairs)), Protocol(metrics="scores")) for pairs in parts]
    both = int((~np.isin(some.sequence, ("S9/a", "S11/c"))).sum())
    with pytest.raises(PoseDataError, match=rf"the 1st result and the 2nd result hold the same poses: {both} with"):
        merge_totals(scores)


def test_the_same_poses_twice_are_refused() -> None:
    with pytest.raises(PoseDataError, match=r"one\.npz and two\.npz hold the same poses: 10 with the same truth"):
        merge_totals([totals(), totals()], ["one.npz", "two.npz"])


@pytest.mark.parametrize(
    ("row", "name"),
    [(2, "2nd"), (3, "3rd"), (4, "4th"), (11, "11th"), (12, "12th"), (13, "13th"), (21, "21st"), (22, "22nd")],
)
def test_results_without_names_are_called_by_their_number(row: int, name: str) -> None:
    parts = [totals(pose_hashes=np.array([[number, 0]], dtype=np.uint64)) for number in range(row)]
    with pytest.raises(PoseDataError, match=rf"^the 1st result and the {name} result hold the same poses"):
        merge_totals([*parts[:-1], parts[0]])


@pytest.mark.parametrize("names", [[], ["one"], ["one", "two", "three"]])
def test_each_result_has_one_name(names: list[str]) -> None:
    with pytest.raises(PoseDataError, match=rf"^names: {len(names)} for 2 results; expected one each\.$"):
        merge_totals([totals(), totals()], names)


def test_values_per_pose_of_shards_follow_their_cells() -> None:
    whole, added = keeping()
    first = replace(whole, per_pose={"kept": whole.per_pose["kept"][:3]}, cell_of=whole.cell_of[:3])
    other = replace(
        totals(),
        cells={"sequence": np.array(["c"]), "action": np.array(["walk"])},
        poses=np.array([2]),
        sums={name: sums[3:] + 1 for name, sums in whole.sums.items()},
        counts={name: counts[3:] for name, counts in whole.counts.items()},
        per_pose={"kept": whole.per_pose["kept"][3:]},
        cell_of=np.array([0, 0]),
        pose_hashes=OTHERS,
    )
    merged = merge_totals([first, other])
    assert merged.cell_of.tolist() == [0, 0, 1, 3, 3]
    assert merged.value(added, WALK) == 19


def test_velocities_per_frame_add_at_any_frame_rate() -> None:
    cells = {"sequence": np.array(["d"] * 4), "action": np.array(["sit"] * 4)}
    merged = merge_totals([totals(), totals(spec=replace(SPEC, fps=50.0), cells=cells, pose_hashes=OTHERS)])
    assert merged.poses.sum() == 20


@pytest.mark.parametrize("what", [5, [], None, [5]])
def test_only_results_are_merged(what: Any) -> None:
    with pytest.raises(PoseDataError, match=r"^merge: expected results \(Totals, such as report\.totals\), at least"):
        merge_totals(what)


# --- many shards ------------------------------------------------------------------------------------------------------


def test_a_tree_of_merges_is_one_merge(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(merge, "FAN_IN", 3)
    protocol = Protocol(metrics="default")
    for number in (1, 3, 4, 9, 11):
        parts = [part.totals(protocol) for part in cut(world(6, M=23), *range(1, number))]
        tree, one = merge_tree(iter(parts)), merge_totals(parts)
        np.testing.assert_array_equal(tree.cells["sequence"], one.cells["sequence"])
        np.testing.assert_array_equal(tree.poses, one.poses)
        for name, sums in one.sums.items():
            np.testing.assert_allclose(tree.sums[name], sums, rtol=1e-12, err_msg=name)
        for name, values in one.per_pose.items():
            np.testing.assert_array_equal(tree.per_pose[name], values)
        np.testing.assert_array_equal(tree.cell_of, one.cell_of)


def test_a_tree_of_merges_keeps_the_poses_of_one_merge(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses without sequence labels are told apart by their shard, which no merge of merges may forget."""
    parts = [
        posecal.evaluate(part.pairs.replace(labels={}), metrics="ece").totals
        for part in cut(world(6, M=69), *range(3, 69, 3))
    ]
    one = merge_totals(parts)
    monkeypatch.setattr(merge, "FAN_IN", 3)
    tree = merge_tree(iter(parts))
    assert one.gallery is not None
    assert tree.gallery is not None
    assert len({*one.gallery.sequence}) > 6
    for name, values in vars(one.gallery).items():
        np.testing.assert_array_equal(getattr(tree.gallery, name), values, err_msg=name)
    halves = [merge_totals(parts[:11]), merge_totals(parts[11:])]
    of_halves = merge_totals(halves).gallery
    assert of_halves is not None
    assert {name.split(",")[0] for name in of_halves.sequence.tolist()} == {"part 1", "part 2"}
    np.testing.assert_array_equal(np.sort(of_halves.numbers[:, 2]), np.sort(one.gallery.numbers[:, 2]))


def test_there_are_at_most_a_hundred_runs_however_many_shards() -> None:
    parts = [accumulate(part.pairs.replace(labels={})) for part in cut(world(6, M=230), *range(7, 230, 7))]
    merged = merge_totals(parts)
    assert len(merged.poses) == 58  # 230 runs of a pose, four together
    assert merged.poses.tolist() == [4] * 57 + [2]
    np.testing.assert_allclose(
        merged.sums["errors"].sum(axis=0), sum(part.sums["errors"].sum(axis=0) for part in parts)
    )


def test_cells_are_put_in_the_order_of_their_sequences() -> None:
    some = world(6, M=23).totals(Protocol(metrics="default"))
    names = sorted({*some.cells["sequence"].tolist()}, reverse=True)
    found = in_order_of_sequences(some, names)
    assert [*dict.fromkeys(found.cells["sequence"].tolist())] == names
    one = known_metrics(Protocol(), some.spec)
    for name in ("mpjpe", "spread_error_correlation", "ece"):
        assert found.value(one[name]) == pytest.approx(some.value(one[name]), rel=1e-12)
    for row, sequence in enumerate(found.cells["sequence"]):
        assert found.poses[row] == some.poses[some.cells["sequence"] == sequence][0]
    poses = found.cells["sequence"][found.cell_of]
    np.testing.assert_array_equal(poses, some.cells["sequence"][some.cell_of])
