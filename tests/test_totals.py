"""Do sums add, group, and come back from a file as they were?"""

from __future__ import annotations

import math
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from posecal.calibration.battery import OF_THE_RUN
from posecal.errors import PoseDataError, PoseFileError
from posecal.leave_one_out import joints_without, without
from posecal.metric import Metric, Statistic, Subject, item
from posecal.protocol import Protocol
from posecal.registry import known_metrics
from posecal.summation import add_up
from posecal.totals import Totals, difference_of_signatures, is_result
from tests.drawn import World, world

SUBJECT = Subject(7, ("Head", "Hip"), 1, ("sequence", "action"), 25.0)

HEIGHT = Statistic("height", lambda block: block.truth[:, 0, 0])
JOINTS = Statistic("joints", lambda block: block.truth[..., 0], per_joint=True)


def metric(statistic: Statistic = HEIGHT, **changes: object) -> Metric:
    """A metric of which only the parts matter that are tested."""
    words = dict.fromkeys(("name", "label", "unit", "brief", "definition"), "")
    whole = Metric(**words, direction="none", family="spread", statistic=statistic, finish=item())
    return replace(whole, **changes)  # type: ignore[arg-type]


def totals(protocol: Protocol | None = None, **changes: object) -> Totals:
    """Four cells of 3, 1, 2 and 4 poses in three sequences and two actions.

    Their heights add up to 30, 8, 14 and 0, of as many poses each; of the second joint only cells 0 and 2 have any.
    """
    found = Totals(
        subject=SUBJECT,
        protocol=protocol or Protocol(),
        version="1.0",
        cells={"sequence": np.array(["a", "b", "b", "c"]), "action": np.array(["sit", "sit", "walk", "walk"])},
        poses=np.array([3, 1, 2, 4]),
    )
    found.add("height", np.arange(4), np.array([30.0, 8, 14, 0]), np.array([3, 1, 2, 4]))
    columns = np.array([[30.0, 3], [8, 0], [14, 1], [0, 0]])
    found.add("joints", np.arange(4), columns, np.array([[3, 1], [1, 0], [2, 1], [4, 0]]))
    return replace(found, **changes)  # type: ignore[arg-type]


SIT, WALK = np.array([True, True, False, False]), np.array([False, False, True, True])


# --- adding and reading ----------------------------------------------------------------------------------------------


def test_a_mean_is_the_sum_over_the_number_of_poses() -> None:
    assert totals().mean(HEIGHT) == pytest.approx(52 / 10)
    assert totals().mean(HEIGHT, SIT) == pytest.approx(38 / 4)


def test_each_joint_has_a_number_of_poses_of_its_own() -> None:
    np.testing.assert_allclose(totals().mean(JOINTS), [52 / 10, 4 / 2])
    np.testing.assert_allclose(totals().mean(JOINTS, np.array([False, True, False, True])), [8 / 5, math.nan])


def test_added_rows_of_one_cell_add_up() -> None:
    found = totals()
    found.add("height", np.array([1, 1]), np.array([1.0, 2.0]), np.array([1, 1]))
    assert found.sums["height"][1] == 11
    assert found.counts["height"][1] == 3


def test_the_poses_that_count_are_counted_where_most_do() -> None:
    assert totals().count(HEIGHT) == 10
    assert totals().count(JOINTS) == 10
    assert totals().count(JOINTS, SIT) == 4


def test_of_no_pose_nothing_is_known() -> None:
    nobody = np.zeros(4, dtype=bool)
    assert math.isnan(totals().mean(HEIGHT, nobody))
    assert math.isnan(totals().value(metric(), nobody))
    assert totals().count(HEIGHT, nobody) == 0


def test_groups_come_in_their_natural_order() -> None:
    found = totals(cells={"sequence": np.array(["clip 10", "clip 9", "clip 9b", "a"])})
    assert [name for name, _ in found.groups("sequence")] == ["a", "clip 9", "clip 9b", "clip 10"]


def test_groups_give_the_cells_of_each_value() -> None:
    found = {name: cells.tolist() for name, cells in totals().groups("action")}
    assert found == {"sit": SIT.tolist(), "walk": WALK.tolist()}


def test_a_label_that_is_not_there_is_refused_with_the_nearest() -> None:
    with pytest.raises(PoseDataError, match=r"by: 'actoin' is not a label of these poses\. Did you mean action\?"):
        list(totals().groups("actoin"))


def test_runs_of_frames_are_no_sequences_to_group_by() -> None:
    found = totals(sequences=False)
    assert found.labels == ("action",)
    with pytest.raises(PoseDataError, match=r"by: 'sequence' is not a label of these poses\. Known: action\."):
        list(found.groups("sequence"))


# --- values ----------------------------------------------------------------------------------------------------------


def test_a_value_is_the_finish_of_the_mean() -> None:
    assert totals().value(metric(finish=lambda mean: float(mean) ** 2)) == pytest.approx(5.2**2)


def test_averaged_by_a_label_it_is_the_mean_of_the_groups_values() -> None:
    found = totals(Protocol(average="action"))
    assert found.value(metric()) == pytest.approx((38 / 4 + 14 / 6) / 2)
    assert found.value(metric(), SIT) == pytest.approx(38 / 4)


def test_groups_of_which_nothing_is_known_are_no_part_of_the_average() -> None:
    nothing = metric(JOINTS, finish=item(1))
    found = totals(Protocol(average="sequence"))
    assert found.value(nothing) == pytest.approx((3 / 1 + 1 / 1) / 2)  # sequences a and b; c has none
    assert math.isnan(found.value(nothing, np.array([False, False, False, True])))


def test_numbers_per_joint_are_averaged_alike() -> None:
    per_joint = metric(by_joint=(JOINTS, np.asarray))
    np.testing.assert_allclose(totals().by_joint(per_joint), [5.2, 2])
    found = totals(Protocol(average="action")).by_joint(per_joint)
    np.testing.assert_allclose(found, [(38 / 4 + 14 / 6) / 2, (3 + 1) / 2])
    np.testing.assert_allclose(totals(Protocol(average="action")).by_joint(per_joint, SIT), [38 / 4, 3])


def test_a_metric_without_joints_has_no_numbers_per_joint() -> None:
    assert np.isnan(totals().by_joint(metric())).tolist() == [True, True]


PAIR = Statistic("pair", lambda block: block.truth[:, 0, :2])


def clips(k: int, protocol: Protocol | None = None) -> tuple[Totals, Metric]:
    """Errors of two hypotheses in the four cells of the sequences a, b, b and c."""
    found = totals(protocol)
    found.add("pair", np.arange(4), np.array([[3.0, 6], [1, 5], [8, 2], [4, 4]]), np.array([3, 1, 2, 4]))
    return found, metric(PAIR, finish=lambda mean: float(mean.min()), clips=k)


def test_a_choice_per_sequence_is_averaged_over_its_poses() -> None:
    # a: 3/3 or 6/3; b: 9/3 or 7/3; c: 4/4. The smaller sums are 3, 7 and 4, of 10 poses.
    found, best = clips(1)
    assert found.value(best) == pytest.approx(14 / 10)


def test_a_choice_per_batch_takes_sequences_in_the_order_in_which_they_come() -> None:
    # a and b: 12 or 13; c: 4
    found, best = clips(2)
    assert found.value(best) == pytest.approx(16 / 10)
    # all: 16 or 17
    found, best = clips(3)
    assert found.value(best) == pytest.approx(16 / 10)


def test_a_group_s_batches_are_of_its_own_sequences() -> None:
    # walk: b with 8 or 2, and c with 4 or 4, as one batch: 12 or 6
    found, best = clips(2)
    assert found.value(best, WALK) == pytest.approx(6 / 6)
    averaged, best = clips(2, Protocol(average="action"))
    # sit: a with 3 or 6, and b with 1 or 5: 4 or 11 of 4 poses
    assert averaged.value(best) == pytest.approx((4 / 4 + 6 / 6) / 2)


def test_sequences_without_a_pose_that_counts_have_no_choice() -> None:
    found, best = clips(1)
    found.counts["pair"][:] = [0, 1, 2, 0]
    assert found.value(best) == pytest.approx(7 / 3)
    found.counts["pair"][:] = 0
    assert math.isnan(found.value(best))


# --- kept values -----------------------------------------------------------------------------------------------------


KEPT = Statistic("kept", lambda block: block.truth[:, 0, :2], kept=True)


def keeping() -> tuple[Totals, Metric]:
    """Two values of five poses in cells 0, 0, 1, 3 and 3, of which one is not known."""
    values = np.array([[1.0, 2], [3, 4], [5, 6], [7, math.nan], [9, 10]])
    found = totals(kept={"kept": values}, cell_of=np.array([0, 0, 1, 3, 3]))
    return found, metric(KEPT, finish=lambda kept: float(kept.sum()))


def test_kept_values_are_those_of_the_poses_of_the_cells() -> None:
    found, added = keeping()
    assert found.value(added) == 1 + 2 + 3 + 4 + 5 + 6 + 9 + 10
    assert found.value(added, SIT) == 21
    assert found.count(KEPT) == 4
    assert found.count(KEPT, WALK) == 1


def test_kept_values_of_shards_follow_their_cells() -> None:
    whole, added = keeping()
    first = replace(whole, kept={"kept": whole.kept["kept"][:3]}, cell_of=whole.cell_of[:3])
    other = replace(
        totals(),
        cells={"sequence": np.array(["c"]), "action": np.array(["walk"])},
        poses=np.array([2]),
        sums={name: sums[3:] + 1 for name, sums in whole.sums.items()},
        counts={name: counts[3:] for name, counts in whole.counts.items()},
        kept={"kept": whole.kept["kept"][3:]},
        cell_of=np.array([0, 0]),
    )
    merged = Totals.merged([first, other])
    assert merged.cell_of.tolist() == [0, 0, 1, 3, 3]
    assert merged.value(added, WALK) == 19


# --- sequences -------------------------------------------------------------------------------------------------------


def test_sums_of_a_sequence_are_those_of_its_cells() -> None:
    sums, counts = totals().by_sequence(JOINTS)
    np.testing.assert_allclose(sums, [[30, 3], [22, 1], [0, 0]])
    np.testing.assert_array_equal(counts, [[3, 1], [3, 1], [4, 0]])
    sums, counts = totals().by_sequence(HEIGHT, WALK)
    np.testing.assert_allclose(sums, [14, 0])
    np.testing.assert_array_equal(counts, [2, 4])


@pytest.mark.parametrize("protocol", [Protocol(), Protocol(average="action"), Protocol(best="batch:2")])
def test_left_out_in_turn_each_sequence_is_as_if_it_had_not_been_there(protocol: Protocol) -> None:
    some = world(5, M=20)
    found = some.totals(protocol)
    names = np.unique(found.cells["sequence"])
    metrics = known_metrics(found.protocol, found.subject)
    rest = [some.taken(np.flatnonzero(some.sequence != name)).values(found.protocol) for name in names]
    for name in ("min_mpjpe", "ece", "radius_50", "spread_error_correlation", "energy_score"):
        expected = [values[name] for values in rest]
        np.testing.assert_allclose(without(found, metrics[name]), expected, rtol=1e-9, err_msg=name)


@pytest.mark.parametrize("average", ["poses", "action", "sequence"])
def test_per_joint_each_sequence_is_left_out_as_if_it_had_not_been_there(average: str) -> None:
    found = world(5, M=20).totals(Protocol(average=average, where="occluded"))
    names = np.unique(found.cells["sequence"])
    for name in ("mpjpe", "signed_area"):
        one = known_metrics(found.protocol, found.subject)[name]
        expected = [found.by_joint(one, found.cells["sequence"] != left) for left in names]
        np.testing.assert_allclose(joints_without(found, one)[0], expected, rtol=1e-9, atol=1e-12, err_msg=name)


# --- shards ----------------------------------------------------------------------------------------------------------


def cut(some: World, *cuts: int) -> list[World]:
    return [some.taken(part) for part in np.split(np.arange(len(some.y)), cuts)]


def test_a_sequence_may_be_split_over_shards() -> None:
    some, protocol = world(6, M=23), Protocol(best="sequence")
    whole = some.totals(protocol)
    merged = Totals.merged([part.totals(protocol) for part in cut(some, 4, 5, 17)])
    for name, metric_ in known_metrics(protocol, whole.subject).items():
        if "mpjve" not in name and name not in OF_THE_RUN:  # a step from one shard to the next is in none of them
            np.testing.assert_allclose(merged.value(metric_), whole.value(metric_), rtol=1e-12, err_msg=name)
    assert merged.poses.sum() == 23
    assert [*merged.cells["sequence"]] == [*whole.cells["sequence"]]


def test_shards_may_come_in_any_order() -> None:
    some, protocol = world(6, M=23), Protocol()
    parts = [part.totals(protocol) for part in cut(some, 9)]
    metrics = known_metrics(protocol, parts[0].subject)
    for name, metric_ in metrics.items():
        found = [Totals.merged(order).value(metric_) for order in (parts, parts[::-1])]
        np.testing.assert_allclose(found[0], found[1], rtol=1e-12, err_msg=name)


def test_merging_leaves_the_parts_as_they_were() -> None:
    parts = [part.totals(Protocol()) for part in cut(world(6, M=23), 9)]
    before = [{name: sums.copy() for name, sums in part.sums.items()} for part in parts]
    Totals.merged(parts).sums["errors"][:] = 0
    for part, sums in zip(parts, before, strict=True):
        for name, expected in sums.items():
            np.testing.assert_array_equal(part.sums[name], expected)


def test_one_part_merges_into_itself() -> None:
    part = world(6).totals(Protocol())
    merged = Totals.merged([part])
    for name, sums in part.sums.items():
        np.testing.assert_array_equal(merged.sums[name], sums)
        np.testing.assert_array_equal(merged.counts[name], part.counts[name])


def test_remarks_are_said_once() -> None:
    other = totals(cells={"sequence": np.array(["d"] * 4), "action": np.array(["sit"] * 4)}, remarks=("few", "slow"))
    other.sums["height"] = other.sums["height"] + [1, 2, 3, 4]
    assert Totals.merged([totals(remarks=("few",)), other]).remarks == ("few", "slow")


def test_runs_of_frames_stay_runs_of_frames_of_their_own_shard() -> None:
    """23 frames of two shards are 23 runs of one frame, as in one go: so are their sums, and what is read off them."""
    pairs = replace(world(6, M=23).pairs, labels={})
    parts = [add_up(replace(part.pairs, labels={})) for part in cut(world(6, M=23), 9)]
    merged, whole = Totals.merged(parts), add_up(pairs)
    assert not merged.sequences
    assert merged.poses.tolist() == [1] * 23
    for name, sums in whole.sums.items():
        np.testing.assert_allclose(merged.sums[name], sums, rtol=1e-12, err_msg=name)
    one = known_metrics(Protocol(), whole.subject)["mpjpe"]
    np.testing.assert_allclose(sorted(without(merged, one)), sorted(without(whole, one)), rtol=1e-12)


def test_the_same_runs_of_frames_twice_are_refused() -> None:
    part = totals(sequences=False)
    with pytest.raises(PoseDataError, match=r"part 1 and part 2 hold the same poses"):
        Totals.merged([part, part])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "3 sequences"),
        ({"sequences": False}, "3 runs of frames"),
        ({"sequences": False, "poses": np.ones(4, dtype=int), "cells": {"sequence": np.arange(4)}}, "4 frames"),
        ({"cells": {"sequence": np.array(["a"] * 4)}}, "1 sequence"),
        ({"cells": {"sequence": np.array(["a"] * 4)}, "sequences": False}, "1 run of frames"),
    ],
)
def test_what_is_taken_as_independent_is_said_with_its_number(changes: dict[str, object], words: str) -> None:
    assert totals(**changes).units() == words


def test_a_number_of_them_may_be_given() -> None:
    assert totals().units(1) == "1 sequence"
    assert totals().units(2) == "2 sequences"


def test_poses_of_one_row_of_a_statistic_are_counted() -> None:
    assert totals().count(JOINTS, row=1) == 2
    assert totals().count(JOINTS, SIT, row=1) == 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"protocol": Protocol(root="drop")}, r"a and b were not made alike: root count against drop\."),
        ({"protocol": Protocol(pck_threshold=99)}, r"not made alike: pck_threshold default against 99"),
        ({"subject": replace(SUBJECT, n_hypotheses=9)}, r"not made alike: N 7 against 9\."),
        (
            {"subject": replace(SUBJECT, joints=("Head", "Spine"))},
            r"not made alike: K 2\(.{8}\) against 2\(.{8}\), origin",
        ),
        ({"version": "2.0"}, r"not made alike: posecal 1\.0 against 2\.0\."),
        ({"sums": {}, "counts": {}}, r"a and b differ in what they hold: height, joints\."),
        ({"cells": {"sequence": np.array(["a", "b", "b", "c"])}}, r"a and b differ in what they hold: action\."),
    ],
)
def test_results_that_were_not_made_alike_do_not_add(changes: dict[str, object], words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        Totals.merged([totals(), totals(**changes)], ["a", "b"])


def test_velocities_per_second_add_only_at_one_frame_rate() -> None:
    second = Protocol(velocity="second")
    parts = [totals(second), totals(second, subject=replace(SUBJECT, fps=50.0))]
    with pytest.raises(PoseDataError, match=r"part 1 and part 2 have 25 and 50 frames per second; expected the same\."):
        Totals.merged(parts)


def test_a_sequence_that_two_shards_have_in_common_is_refused() -> None:
    some = world(6, M=23)
    parts = [some.taken(np.flatnonzero(some.sequence != left)).totals(Protocol()) for left in ("S9/a", "S11/c")]
    with pytest.raises(PoseDataError, match=r"part 1 and part 2 hold the same poses \(cell S9/b, sit\)"):
        Totals.merged(parts)


def test_the_same_poses_twice_are_refused() -> None:
    with pytest.raises(
        PoseDataError, match=r"one\.npz and two\.npz hold the same poses \(cell a, sit\); expected shards"
    ):
        Totals.merged([totals(), totals()], ["one.npz", "two.npz"])


# --- signature -------------------------------------------------------------------------------------------------------


def test_a_signature_names_what_numbers_depend_on() -> None:
    found = totals(Protocol(align="rigid", pck_joints="Head, Hip", metrics="pck")).signature
    parts = dict(part.split("=", 1) for part in found.split())
    assert parts["N"] == "7"
    assert parts["origin"] == "Hip"
    assert parts["align"] == "rigid"
    assert parts["pck_joints"] == "Head,_Hip"
    assert parts["ece"] == "exchangeable,median"
    assert "metrics" not in parts
    assert "cps_best" not in parts


def test_without_a_root_the_origin_is_as_given() -> None:
    assert "origin=as_given" in totals(subject=replace(SUBJECT, root=None)).signature


def test_signatures_differ_exactly_where_options_do() -> None:
    one, other = totals(), totals(Protocol(root="drop", mode="1"))
    assert one.signature == totals().signature
    assert difference_of_signatures(one, other) == "root count against drop, mode default against 1"
    assert difference_of_signatures(one, one) == ""


# --- files -----------------------------------------------------------------------------------------------------------


def test_a_file_gives_back_what_was_saved(tmp_path: Path) -> None:
    protocol = Protocol(where="visible", best="batch:2", average="action", pck_threshold=80.5)
    before = replace(world(8).totals(protocol), remarks=("one", "two, three"))
    before.save(tmp_path / "result.npz")
    after = Totals.load(tmp_path / "result.npz")
    assert after.subject == before.subject
    assert after.protocol == before.protocol
    assert (after.version, after.remarks, after.sequences) == (before.version, before.remarks, before.sequences)
    assert list(after.cells) == list(before.cells)
    assert after.signature == before.signature
    for name in before.sums:
        np.testing.assert_array_equal(after.sums[name], before.sums[name])
        np.testing.assert_array_equal(after.counts[name], before.counts[name])
    for name in before.kept:  # in single precision
        np.testing.assert_allclose(after.kept[name], before.kept[name], rtol=2**-24)
    metrics = known_metrics(after.protocol, after.subject)
    for name, metric_ in metrics.items():
        np.testing.assert_allclose(after.value(metric_), before.value(metric_), rtol=1e-6, err_msg=name)


def test_a_saved_result_is_known_as_one(tmp_path: Path) -> None:
    totals().save(tmp_path / "result.npz")
    np.savez(tmp_path / "other.npz", hypotheses=np.zeros(3))
    (tmp_path / "text.npz").write_text("no zip")
    assert is_result(tmp_path / "result.npz")
    assert not is_result(tmp_path / "other.npz")
    assert not is_result(tmp_path / "text.npz")
    assert not is_result(tmp_path / "nothing.npz")


def test_what_is_missing_or_a_folder_is_said(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"nothing\.npz: no such file\."):
        Totals.load(tmp_path / "nothing.npz")
    with pytest.raises(PoseFileError, match=r"is a folder; expected a result of posecal evaluate --save\."):
        Totals.load(tmp_path)


@pytest.mark.parametrize("kind", ["empty", "text", "array", "other members", "cut", "no json", "unknown option"])
def test_what_is_no_whole_result_is_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "bad.npz"
    totals().save(tmp_path / "good.npz")
    whole = (tmp_path / "good.npz").read_bytes()
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_text("hello, I am no archive")
    elif kind == "array":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    elif kind == "other members":
        np.savez(path, hypotheses=np.zeros(3))
    elif kind == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    else:
        with np.load(tmp_path / "good.npz") as stored:
            members: dict[str, npt.NDArray[np.generic]] = dict(stored)
        about = str(members["about"])
        members["about"] = np.array("{" if kind == "no json" else about.replace('"root": "count"', '"root": "gone"'))
        np.savez(path, **members)
    with pytest.raises(PoseFileError, match=r"bad\.npz: no result of posecal evaluate --save, or not a whole one\."):
        Totals.load(path)


def test_a_result_of_another_format_is_to_be_made_anew(tmp_path: Path) -> None:
    totals().save(tmp_path / "result.npz")
    with np.load(tmp_path / "result.npz") as stored:
        members: dict[str, npt.NDArray[np.generic]] = dict(stored)
    members["about"] = np.array(str(members["about"]).replace('"format": 1', '"format": 99'))
    np.savez(tmp_path / "later.npz", **members)
    with pytest.raises(PoseFileError, match=r"later\.npz: format 99 of posecal 1\.0; expected 1\. Evaluate again\."):
        Totals.load(tmp_path / "later.npz")


def test_a_corrupted_member_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    totals().save(path)
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("sum/height.npy").header_offset
    whole = bytearray(path.read_bytes())
    whole[start + 60 : start + 90] = bytes(30)
    path.write_bytes(whole)
    with pytest.raises(PoseFileError, match=r"bad\.npz: no result"):
        Totals.load(path)


def test_a_folder_that_is_not_there_is_said_and_nothing_is_left(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"missing"):
        totals().save(tmp_path / "missing" / "result.npz")
    assert list(tmp_path.iterdir()) == []
