"""Sums per cell: adding, grouping, and the numbers that are made of them."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from posecal.engine.finish import ReadOff, entry
from posecal.engine.merge import difference_of_signatures
from posecal.engine.metric import Metric, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError
from posecal.stats.jackknife import leave_one_out
from tests.helpers.example_totals import (
    HEIGHT,
    JOINTS,
    KEPT,
    PAIR,
    SIT,
    SPEC,
    WALK,
    keeping,
    metric,
    random_totals,
    totals,
)

# --- what several metrics are read off --------------------------------------------------------------------------------


def reading(calls: list[int]) -> tuple[Metric, Metric, Metric]:
    """The sum of the joints' means and its square, read off one sum, and the sum of another statistic's means."""

    def summary(means: np.ndarray) -> np.ndarray:
        calls.append(1)
        return np.nansum(means, axis=-1)

    of_joints, of_pair = (partial(metric, statistic, family="calibration") for statistic in (JOINTS, PAIR))
    return (
        of_joints(finish=ReadOff(summary, lambda shared: shared)),
        of_joints(finish=ReadOff(summary, lambda shared: shared**2)),
        of_pair(finish=ReadOff(summary, lambda shared: shared)),
    )


def test_metrics_that_are_read_off_the_same_share_it() -> None:
    calls: list[int] = []
    one, square, _ = reading(calls)
    some = random_totals(1)
    np.testing.assert_allclose(some.value(one), some.mean(JOINTS).sum())
    np.testing.assert_allclose(some.value(square), some.mean(JOINTS).sum() ** 2)
    assert len(calls) == 1
    without = leave_one_out(some, one)
    np.testing.assert_allclose(leave_one_out(some, square), without**2)
    assert without.shape == (7,)
    assert some.value(one) == some.mean(JOINTS).sum()
    assert len(calls) == 2


def test_what_is_shared_is_not_that_of_other_cells_sums_or_statistics() -> None:
    one, square, other = reading([])
    first, second = random_totals(1), random_totals(2)
    groups = [None, np.arange(9), np.arange(9, 30)]
    for cells in (*groups, *groups):
        for some in (first, second):
            rest = [np.setdiff1d(np.arange(30) if cells is None else cells, gone) for gone in sequences(some, cells)]
            for each, statistic, power in ((one, JOINTS, 1), (other, PAIR, 1), (square, JOINTS, 2)):
                np.testing.assert_allclose(some.value(each, cells), np.nansum(some.mean(statistic, cells)) ** power)
                expected = [np.nansum(some.mean(statistic, left)) ** power for left in rest]
                np.testing.assert_allclose(leave_one_out(some, each, cells), expected)


def sequences(some: Totals, cells: np.ndarray | None) -> list[np.ndarray]:
    """The cells of each sequence among some cells."""
    numbers = some.sequence_of if cells is None else some.sequence_of[cells]
    return [np.flatnonzero(some.sequence_of == number) for number in np.unique(numbers)]


@pytest.mark.parametrize("again", [copy.copy, lambda some: pickle.loads(pickle.dumps(some)), replace])
def test_what_is_added_later_is_in_what_is_shared(again: Callable[[Totals], Totals]) -> None:
    one, *_ = reading([])
    some = random_totals(1)
    before = some.value(one), leave_one_out(some, one)
    more = np.array([3]), np.array([[50.0, 70.0]]), np.array([[2, 1]])
    other = again(some)
    other.sums, other.counts = copy.deepcopy(some.sums), copy.deepcopy(some.counts)
    other.add("joints", *more)
    np.testing.assert_allclose(other.value(one), other.mean(JOINTS).sum())
    assert other.value(one) != before[0]
    assert some.value(one) == before[0]
    np.testing.assert_array_equal(leave_one_out(some, one), before[1])
    some.add("joints", *more)
    assert some.value(one) == other.value(one) != before[0]
    np.testing.assert_array_equal(leave_one_out(some, one), leave_one_out(other, one))


# --- adding and reading ----------------------------------------------------------------------------------------------


def test_a_mean_is_the_sum_over_the_number_of_poses() -> None:
    assert totals().mean(HEIGHT) == pytest.approx(52 / 10)
    assert totals().mean(HEIGHT, SIT) == pytest.approx(38 / 4)


def test_each_joint_has_a_number_of_poses_of_its_own() -> None:
    np.testing.assert_allclose(totals().mean(JOINTS), [52 / 10, 4 / 2])
    np.testing.assert_allclose(totals().mean(JOINTS, np.array([1, 3])), [8 / 5, math.nan])


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
    nobody = np.zeros(0, dtype=int)
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
    found = totals(has_sequences=False)
    assert found.labels == ("action",)
    with pytest.raises(PoseDataError, match=r"by: 'sequence' is not a label of these poses\. Known: action\."):
        list(found.groups("sequence"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "3 sequences"),
        ({"has_sequences": False}, "3 runs of frames"),
        ({"has_sequences": False, "poses": np.ones(4, dtype=int), "cells": {"sequence": np.arange(4)}}, "4 frames"),
        ({"cells": {"sequence": np.array(["a"] * 4)}}, "1 sequence"),
        ({"cells": {"sequence": np.array(["a"] * 4)}, "has_sequences": False}, "1 run of frames"),
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


# --- values ----------------------------------------------------------------------------------------------------------


def test_a_value_is_the_finish_of_the_mean() -> None:
    assert totals().value(metric(finish=lambda mean: mean**2)) == pytest.approx(5.2**2)


def test_averaged_by_a_label_it_is_the_mean_of_the_groups_values() -> None:
    found = totals(Protocol(average="action"))
    assert found.value(metric()) == pytest.approx((38 / 4 + 14 / 6) / 2)
    assert found.value(metric(), SIT) == pytest.approx(38 / 4)


def test_groups_of_which_nothing_is_known_are_no_part_of_the_average() -> None:
    nothing = metric(JOINTS, finish=entry(1))
    found = totals(Protocol(average="sequence"))
    assert found.value(nothing) == pytest.approx((3 / 1 + 1 / 1) / 2)  # sequences a and b; c has none
    assert math.isnan(found.value(nothing, np.array([3])))


def test_numbers_per_joint_are_averaged_alike() -> None:
    per_joint = metric(by_joint=(JOINTS, np.asarray))
    np.testing.assert_allclose(totals().by_joint(per_joint), [5.2, 2])
    found = totals(Protocol(average="action")).by_joint(per_joint)
    np.testing.assert_allclose(found, [(38 / 4 + 14 / 6) / 2, (3 + 1) / 2])
    np.testing.assert_allclose(totals(Protocol(average="action")).by_joint(per_joint, SIT), [38 / 4, 3])


def test_a_metric_without_joints_has_no_numbers_per_joint() -> None:
    assert np.isnan(totals().by_joint(metric())).tolist() == [True, True]


@pytest.mark.parametrize("statistic", [HEIGHT, JOINTS], ids=["of poses", "of joints"])
def test_averaged_groups_weigh_alike_and_together_as_much_as_their_poses(statistic: Statistic) -> None:
    some, pooled = (random_totals(3, G=9, protocol=Protocol(average=average)) for average in ("action", "poses"))
    for each in (some, pooled):  # a group in which a joint never counts
        cells = next(cells for _, cells in each.groups("action"))
        each.sums["joints"][cells, 1] = each.counts["joints"][cells, 1] = 0
    sums, counts = some.by_sequence(statistic)
    total = some.counts[statistic.name].sum(axis=0)
    np.testing.assert_allclose(counts.sum(axis=0), total)
    of_groups = np.stack([some.counts[statistic.name][cells].sum(axis=0) for _, cells in some.groups("action")])
    means = np.stack([some.mean(statistic, cells) for _, cells in some.groups("action")])
    np.testing.assert_allclose(sums.sum(axis=0), total * np.nanmean(means, axis=0))
    expected = (of_groups > 0).sum(axis=0) ** 2 / np.where(of_groups > 0, 1 / np.maximum(of_groups, 1), 0).sum(axis=0)
    np.testing.assert_allclose(some.effective_sample_size(statistic), expected)
    np.testing.assert_array_equal(pooled.effective_sample_size(statistic), total)
    np.testing.assert_array_equal(pooled.by_sequence(statistic)[1].sum(axis=0), total)


def test_a_joint_that_never_counts_is_of_no_pose() -> None:
    for average in ("poses", "action"):
        some = random_totals(3, protocol=Protocol(average=average))
        some.counts["joints"][:, 1] = 0
        assert some.effective_sample_size(JOINTS)[1] == 0
        assert some.effective_sample_size(JOINTS)[0] > 0


def clips(k: int, protocol: Protocol | None = None) -> tuple[Totals, Metric]:
    """Errors of two hypotheses in the four cells of the sequences a, b, b and c."""
    found = totals(protocol)
    found.add("pair", np.arange(4), np.array([[3.0, 6], [1, 5], [8, 2], [4, 4]]), np.array([3, 1, 2, 4]))
    return found, metric(PAIR, finish=lambda mean: mean.min(axis=-1), sequences_per_batch=k)


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


def test_kept_values_are_those_of_the_poses_of_the_cells() -> None:
    found, added = keeping()
    assert found.value(added) == 1 + 2 + 3 + 4 + 5 + 6 + 9 + 10
    assert found.value(added, SIT) == 21
    assert found.count(KEPT) == 4
    assert found.count(KEPT, WALK) == 1


# --- sequences -------------------------------------------------------------------------------------------------------


def test_sums_of_a_sequence_are_those_of_its_cells() -> None:
    sums, counts = totals().by_sequence(JOINTS)
    np.testing.assert_allclose(sums, [[30, 3], [22, 1], [0, 0]])
    np.testing.assert_array_equal(counts, [[3, 1], [3, 1], [4, 0]])
    sums, counts = totals().by_sequence(HEIGHT, WALK)
    np.testing.assert_allclose(sums, [14, 0])
    np.testing.assert_array_equal(counts, [2, 4])


@pytest.mark.parametrize("average", ["action", "sequence"])
def test_weighted_sums_of_sequences_give_the_mean_of_the_groups_means(average: str) -> None:
    some = random_totals(3, protocol=Protocol(average=average))
    for cells in (None, np.arange(4, 25)):
        sums, counts = some.by_sequence(JOINTS, cells)
        np.testing.assert_allclose(sums.sum(axis=0) / counts.sum(axis=0), some.averaged(JOINTS, cells), rtol=1e-12)


def plain_average(some: Totals, label: str, joint: int, cells: np.ndarray) -> float:
    """The mean of the groups' means at one joint, by loops."""
    means = []
    for value in sorted(set(some.cells[label][cells])):
        group = [cell for cell in cells if some.cells[label][cell] == value]
        number = sum(some.counts["joints"][cell, joint] for cell in group)
        if number:
            means.append(sum(some.sums["joints"][cell, joint] for cell in group) / number)
    return sum(means) / len(means)


@pytest.mark.parametrize("label", ["action", "sequence"])
def test_an_average_is_the_mean_of_the_groups_means_for_each_joint_by_itself(label: str) -> None:
    some = random_totals(4, protocol=Protocol(average=label))
    for cells in (np.arange(30), np.arange(5, 17)):
        expected = [plain_average(some, label, joint, cells) for joint in (0, 1)]
        np.testing.assert_allclose(some.averaged(JOINTS, cells), expected, rtol=1e-12)
        values = [some.value(metric(JOINTS, finish=entry(joint)), cells) for joint in (0, 1)]
        np.testing.assert_allclose(values, expected, rtol=1e-12)
    np.testing.assert_allclose(some.averaged(JOINTS), some.averaged(JOINTS, np.arange(30)), rtol=1e-12)


def test_poses_of_some_cells_are_found_in_their_order_without_those_that_are_not_known() -> None:
    some = random_totals(5)
    known = ~np.isnan(some.per_pose["kept"]).any(axis=1)
    for cells in (np.arange(30), np.array([2, 3, 11, 29]), np.zeros(0, dtype=int)):
        expected = np.flatnonzero(np.isin(some.cell_of, cells) & known)
        np.testing.assert_array_equal(some.known_poses(KEPT, cells), expected)
    np.testing.assert_array_equal(some.known_poses(KEPT), np.flatnonzero(known))


def test_an_average_is_worth_fewer_poses_than_it_is_of() -> None:
    some = random_totals(6, protocol=Protocol(average="action"))
    number = [some.counts["joints"][cells].sum(axis=0) for _, cells in some.groups("action")]
    for joint in (0, 1):
        sizes = [n[joint] for n in number if n[joint]]
        expected = len(sizes) ** 2 / sum(1 / n for n in sizes)
        np.testing.assert_allclose(some.effective_sample_size(JOINTS)[joint], expected, rtol=1e-12)
    assert random_totals(6).effective_sample_size(HEIGHT) == some.counts["height"].sum()


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
    assert "origin=as_given" in totals(spec=replace(SPEC, root=None)).signature


def test_signatures_differ_exactly_where_options_do() -> None:
    one, other = totals(), totals(Protocol(root="drop", mode="1"))
    assert one.signature == totals().signature
    assert difference_of_signatures(one, other) == "root count against drop, mode default against 1"
    assert difference_of_signatures(one, one) == ""
