"""The jackknife: intervals against textbooks, and every metric without each sequence against loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special, stats

from posecal.engine.bounds import POSITIVE, SHARE, UNBOUNDED
from posecal.engine.metric import Metric, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals
from posecal.registry import known_metrics
from posecal.stats import jackknife as module
from posecal.stats.jackknife import (
    Interval,
    jackknife,
    jackknife_columns,
    joint_leave_one_out,
    leave_one_out,
    paired_p,
    sequence_sizes,
)
from tests.helpers.example_totals import HEIGHT, JOINTS, KEPT, PAIR, metric, random_totals
from tests.helpers.random_worlds import world

Array = np.ndarray

# --- intervals ------------------------------------------------------------------------------------------------------


def left_out(sums: Array, sizes: Array) -> Array:
    """Ratio of sums with each sequence left out, one at a time."""
    found = []
    for s in range(len(sums)):
        others = [t for t in range(len(sums)) if t != s]
        found.append(sum(sums[t] for t in others) / sum(sizes[t] for t in others))
    return np.array(found)


@given(means=st.lists(st.floats(-50, 50), min_size=3, max_size=12), frames=st.integers(1, 9))
def test_a_mean_over_equal_sequences_has_the_t_interval_of_their_means(means: list[float], frames: int) -> None:
    sums, sizes = frames * np.array(means), np.full(len(means), frames)
    found = jackknife(sums.sum() / sizes.sum(), left_out(sums, sizes))
    error = stats.sem(means)
    np.testing.assert_allclose(found.error, error, rtol=1e-6, atol=1e-9)
    low, high = stats.t.interval(0.95, len(means) - 1) if error == 0 else stats.t(len(means) - 1).interval(0.95)
    np.testing.assert_allclose(found.low, np.mean(means) + error * low, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.high, np.mean(means) + error * high, rtol=1e-6, atol=1e-6)


def test_a_ratio_over_unequal_sequences_has_the_cluster_robust_error() -> None:
    random = np.random.default_rng(1)
    sizes = random.integers(3, 40, 60)
    sums = sizes * random.normal(80, 15, 60)
    ratio, n, S = sums.sum() / sizes.sum(), sizes.sum(), len(sizes)
    residual = sums - ratio * sizes
    # Leaving s out moves the ratio by -residual_s / (n - n_s), so with h = max n_s / n the jackknife's variance lies
    # between the cluster-robust one, S/(S-1) Σ residual² / n² (its S - 1 for S here), and that over (1 - h)².
    found = jackknife(ratio, left_out(sums, sizes)).error ** 2
    robust = (S - 1) / S * (residual**2).sum() / n**2
    most = (S - 1) / S * (residual**2).sum() / (n - sizes.max()) ** 2
    centring = 1 - 1 / S  # the mean of the left-out ratios is not quite the ratio
    assert centring * robust < found < most
    np.testing.assert_allclose(left_out(sums, sizes), ratio - residual / (n - sizes), rtol=1e-12)


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    random = np.random.default_rng(2)
    times, S = 1000, 8
    means = random.standard_normal((times, S))  # of sequences of equal size: the interval is Student's, and exact
    held = 0
    for row in means:
        found = jackknife(row.mean(), left_out(row, np.ones(S)))
        held += found.low <= 0 <= found.high
    low, high = stats.binom(times, 0.95).interval(0.9999)
    assert low <= held <= high


@pytest.mark.parametrize(
    ("value", "without"),
    [(1.0, [1.0, 2.0]), (1.0, []), (math.nan, [1.0, 2.0, 2.0]), (1.0, [1.0, math.nan, 2.0])],
    ids=["two sequences", "none", "no value", "not defined without one"],
)
def test_there_is_no_interval_of(value: float, without: list[float]) -> None:
    found = jackknife(value, np.array(without))
    assert found.sequences == len(without)
    assert np.isnan([found.low, found.high, found.error]).all()


# --- many numbers at once ---------------------------------------------------------------------------------------------


def test_many_numbers_have_the_intervals_that_they_have_alone_over_the_sequences_in_which_they_count() -> None:
    random = np.random.default_rng(3)
    without, sizes = random.normal(50, 9, (12, 6)), random.integers(0, 3, (12, 6))
    sizes[:, 4], sizes[2:, 5] = 0, 0
    sizes[:2, 5] = 1
    without[sizes == 0] = math.nan
    without[np.flatnonzero(sizes[:, 3])[0], 3] = math.nan
    values = random.normal(50, 9, 6)
    for bounds in (UNBOUNDED, POSITIVE, (0.0, 100.0)):
        found = jackknife_columns(values, without, sizes, bounds)
        for k in range(6):
            alone = jackknife(values[k], without[sizes[:, k] > 0, k], sizes[sizes[:, k] > 0, k], bounds)
            many = [getattr(found, name)[k] for name in ("low", "high", "error", "freedom", "sequences")]
            np.testing.assert_allclose(many, list(vars(alone).values()), rtol=1e-12)
        assert np.isnan(found.high).tolist() == [False, False, False, True, True, True]


# --- sequences of unequal lengths -------------------------------------------------------------------------------------


def test_the_degrees_of_freedom_are_those_of_the_effective_number_of_sequences() -> None:
    without, sizes = np.arange(6.0), np.array([50, 10, 10, 10, 10, 10])
    found = jackknife(0.0, without, sizes)
    assert found.freedom == pytest.approx(100**2 / (50**2 + 5 * 10**2) - 1)
    assert found.high == pytest.approx(found.error * stats.t(found.freedom).ppf(0.975))
    assert jackknife(0.0, without).freedom == 5
    assert jackknife(0.0, without, 7 * np.ones(6)).freedom == pytest.approx(5)


def test_a_sequence_that_outweighs_all_others_leaves_no_interval() -> None:
    assert math.isnan(jackknife(1.0, np.arange(4.0), np.array([900, 1, 1, 1])).high)
    assert not math.isnan(jackknife(1.0, np.arange(4.0), np.array([2, 1, 1, 1])).high)


def test_a_positive_number_has_the_interval_of_its_logarithm_and_a_share_of_its_logit() -> None:
    without, reach = np.array([40.0, 50.0, 60.0, 70.0]), stats.t(3).ppf(0.975) * math.sqrt(3 / 4)
    steps = np.log(without) - math.log(55)
    found = jackknife(55.0, without, bounds=POSITIVE)
    size = reach * math.sqrt((steps**2).sum())
    np.testing.assert_allclose([found.low, found.high], [55 * math.exp(-size), 55 * math.exp(size)], rtol=1e-12)
    steps = special.logit(without / 100) - special.logit(0.55)
    found = jackknife(0.55, without / 100, bounds=SHARE)
    ends = special.logit(0.55) + reach * math.sqrt((steps**2).sum()) * np.array([-1, 1])
    np.testing.assert_allclose([found.low, found.high], special.expit(ends), rtol=1e-12)


def test_a_sequence_that_holds_all_misses_moves_a_share_as_five_times_the_odds_do() -> None:
    found = jackknife(0.99, np.array([1.0, 0.99, 0.99, 0.99]), bounds=SHARE)
    reach = stats.t(3).ppf(0.975) * math.sqrt(3 / 4) * math.log(5)
    ends = special.expit([special.logit(0.99) - reach, special.logit(0.99) + reach])
    np.testing.assert_allclose([found.low, found.high], ends, rtol=1e-12)


def test_at_the_edge_of_its_range_a_share_has_the_rule_of_three_and_outside_of_it_the_plain_interval() -> None:
    assert jackknife(1.0, np.ones(10), bounds=SHARE).low == pytest.approx(0.05**0.1)
    assert jackknife(1.0, np.ones(10), bounds=SHARE).high == 1.0
    assert np.isnan([(found := jackknife(1.0, np.ones(2), bounds=SHARE)).low, found.high]).all()
    without = np.array([-3.0, -1.0, 1.0])
    assert jackknife(-1.0, without, bounds=POSITIVE) == jackknife(-1.0, without)
    assert jackknife(0.0, np.zeros(4), bounds=POSITIVE).high == 0.0


def test_at_the_edge_the_rule_of_three_takes_that_the_number_lies_there_without_any_sequence() -> None:
    undefined = jackknife(1.0, np.array([1, 1, 1, math.nan, 1, 1]), bounds=SHARE)
    assert np.isnan([undefined.low, undefined.high]).all()
    missing = jackknife(1.0, np.array([1, 1, 1, math.nan, 1, 1]), np.array([1, 1, 1, 0, 1, 1]), SHARE)
    assert missing == jackknife(1.0, np.ones(5), bounds=SHARE)
    without = np.array([0, 0, 0, 0.02, 0.05, 0.1])
    found, plain = jackknife(0.0, without, bounds=SHARE), jackknife(0.0, without)
    assert (found.low, found.high) == (0.0, plain.high)
    assert found.high == pytest.approx(stats.t(5).ppf(0.975) * math.sqrt(5 * without.var()))
    assert jackknife(0.0, without, bounds=POSITIVE) == found
    opposite = jackknife(1.0, np.array([1, 1, 0.0]), bounds=SHARE)
    assert (opposite.low, opposite.high) == (0.0, 1.0)


def test_sizes_of_sequences_are_shares_of_their_groups_where_groups_are_averaged() -> None:
    some = random_totals(3, protocol=Protocol(average="action"))
    counts, names = some.counts["height"], some.cells["sequence"]
    actions = some.cells["action"]
    shares = np.array([count / counts[actions == action].sum() for count, action in zip(counts, actions, strict=True)])
    expected = [shares[names == name].sum() for name in sorted(set(names))]
    np.testing.assert_allclose(sequence_sizes(some, metric()), expected, rtol=1e-12)


# --- metrics without each sequence ------------------------------------------------------------------------------------


def rest(some: Totals, cells: Array | None) -> list[Array]:
    """The cells that are left without each sequence among some cells, in the order of the names."""
    chosen = np.arange(len(some.poses)) if cells is None else cells
    names = some.cells["sequence"][chosen]
    return [chosen[names != name] for name in sorted(set(names))]


METRICS = {
    "a mean": metric(finish=lambda mean: mean**2),
    "a curve": metric(JOINTS, family="calibration", finish=lambda mean: mean.max(axis=-1)),
    "per sequence": metric(PAIR, finish=lambda mean: mean.min(axis=-1), sequences_per_batch=1),
    "per two": metric(PAIR, finish=lambda mean: mean.min(axis=-1), sequences_per_batch=2),
    "per three": metric(PAIR, finish=lambda mean: mean.min(axis=-1), sequences_per_batch=3),
    "all in one": metric(PAIR, finish=lambda mean: mean.min(axis=-1), sequences_per_batch=99),
    "of the order": metric(
        KEPT,
        finish=lambda values: np.median(values[:, 0] * values[:, 1]) if len(values) else math.nan,
        leave_out=lambda values, sequence: np.array(
            [
                np.median((values[:, 0] * values[:, 1])[sequence != s]) if (sequence != s).any() else math.nan
                for s in range(sequence.max() + 1)
            ]
        ),
    ),
    "of the order, by loops": metric(
        KEPT, finish=lambda values: np.median(values[:, 0] * values[:, 1]) if len(values) else math.nan
    ),
}


@pytest.mark.parametrize("kind", METRICS)
@pytest.mark.parametrize("average", ["poses", "action", "sequence"])
def test_left_out_in_turn_each_sequence_is_as_if_its_cells_had_not_been_there(kind: str, average: str) -> None:
    one = METRICS[kind]
    for seed in range(6):
        some = random_totals(seed, S=3 + seed, protocol=Protocol(average=average))
        for cells in (None, np.arange(3, 20), np.array([5]), np.zeros(0, dtype=int)):
            expected = [some.value(one, left) for left in rest(some, cells)]
            np.testing.assert_allclose(leave_one_out(some, one, cells), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("average", ["poses", "action", "sequence"])
def test_per_joint_each_sequence_is_left_out_as_if_its_cells_had_not_been_there(average: str) -> None:
    one = metric(by_joint=(JOINTS, np.asarray))
    for seed in range(4):
        some = random_totals(seed, protocol=Protocol(average=average))
        for cells in (None, np.arange(3, 20)):
            without, present = joint_leave_one_out(some, one, cells)
            expected = [some.by_joint(one, left) for left in rest(some, cells)]
            np.testing.assert_allclose(without, expected, rtol=1e-9)
            chosen = np.arange(30) if cells is None else cells
            names = some.cells["sequence"][chosen]
            counts = [some.counts["joints"][chosen[names == name]].sum(axis=0) > 0 for name in sorted(set(names))]
            np.testing.assert_array_equal(present > 0, counts)


@pytest.mark.parametrize("statistic", [HEIGHT, JOINTS, PAIR, KEPT], ids=["number", "joints", "pair", "per pose"])
def test_sequences_count_that_have_a_pose_of_which_something_is_known(statistic: Statistic) -> None:
    one = metric(statistic, finish=lambda mean: mean)
    for seed in range(8):
        some = random_totals(seed, C=20, S=9)
        some.per_pose["kept"][:, 0] = -1
        for name in some.sums:
            some.sums[name] = -np.abs(some.sums[name])
        for cells in (None, np.arange(3, 15), np.array([5])):
            chosen = np.arange(20) if cells is None else cells
            names, expected = some.cells["sequence"][chosen], []
            for name in sorted(set(names)):
                own = chosen[names == name]
                if statistic is KEPT:
                    values = some.per_pose["kept"][np.isin(some.cell_of, own)]
                    expected.append(bool((~np.isnan(values)).all(axis=1).any()))
                else:
                    expected.append(bool((some.counts[statistic.name][own] > 0).any()))
            assert (sequence_sizes(some, one, cells) > 0).tolist() == expected


def test_a_statistic_that_is_not_per_joint_counts_at_every_joint() -> None:
    some = random_totals(1)
    one = metric(by_joint=(PAIR, np.asarray))
    _, present = joint_leave_one_out(some, one)
    assert present.shape == (7, 2)
    assert (present > 0).all()
    with pytest.raises(ValueError, match="has no values per joint"):
        joint_leave_one_out(some, metric())


@pytest.mark.parametrize("average", ["poses", "action", "sequence"])
def test_slices_of_the_sequences_give_the_same(average: str, monkeypatch: pytest.MonkeyPatch) -> None:
    some, one = random_totals(7, protocol=Protocol(average=average)), metric(by_joint=(JOINTS, np.asarray))
    kinds = [METRICS["a mean"], METRICS["a curve"]]
    expected = [leave_one_out(some, kind) for kind in kinds] + [joint_leave_one_out(some, one)[0]]
    slices = module.slices
    monkeypatch.setattr(module, "slices", lambda length, row_bytes: slices(length, row_bytes, 2 * row_bytes))
    sizes = []
    watched = metric(JOINTS, family="calibration", finish=lambda mean: sizes.append(len(mean)) or mean.max(axis=-1))  # type: ignore[func-returns-value]
    found = [leave_one_out(some, kind) for kind in kinds] + [joint_leave_one_out(some, one)[0]]
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    leave_one_out(some, watched)
    assert sizes == [2, 2, 2, 1]


@pytest.mark.parametrize(
    "protocol", [Protocol(), Protocol(average="action"), Protocol(best="batch:2"), Protocol(best="sequence")]
)
def test_metrics_of_poses_without_a_sequence_are_those_of_a_result_without_it(protocol: Protocol) -> None:
    some = world(5, M=20)
    totals = some.totals(protocol)
    metrics = known_metrics(totals.protocol, totals.spec)
    parts = [some.select(np.flatnonzero(some.sequence != name)) for name in np.unique(totals.cells["sequence"])]
    values = [part.values(totals.protocol) for part in parts]
    for name in ("min_mpjpe", "ece", "radius_50", "spread_error_correlation", "ause", "energy_score"):
        expected = [value[name] for value in values]
        np.testing.assert_allclose(leave_one_out(totals, metrics[name]), expected, rtol=1e-9, atol=1e-12, err_msg=name)


def every_metric(totals: Totals) -> list[Metric]:
    return list(known_metrics(totals.protocol, totals.spec).values())


@pytest.mark.parametrize("average", ["poses", "action", "sequence"])
def test_every_metric_is_finished_from_a_stack_of_means_as_from_each(average: str) -> None:
    totals = world(5, M=20).totals(Protocol(average=average, where="occluded"))
    for one in every_metric(totals):
        expected = [totals.value(one, left) for left in rest(totals, None)]
        np.testing.assert_allclose(leave_one_out(totals, one), expected, rtol=1e-7, atol=1e-9, err_msg=one.name)
        if one.by_joint is not None:
            joints = [totals.by_joint(one, left) for left in rest(totals, None)]
            found = joint_leave_one_out(totals, one)[0]
            np.testing.assert_allclose(found, joints, rtol=1e-7, atol=1e-9, err_msg=one.name)


# --- p-values ---------------------------------------------------------------------------------------------------------


@given(differences=st.lists(st.floats(-9, 9).filter(lambda v: v == 0 or abs(v) > 1e-3), min_size=3, max_size=15))
def test_a_paired_p_value_is_the_t_tests(differences: list[float]) -> None:
    if np.std(differences) < 1e-6:
        differences = [*differences, differences[0] + 1]
    values = np.array(differences)
    found = jackknife(values.mean(), left_out(values, np.ones(len(values))))
    np.testing.assert_allclose(paired_p(found), stats.ttest_1samp(values, 0).pvalue, rtol=1e-6, atol=1e-9)


def test_without_any_spread_a_difference_is_certain_and_no_difference_is_none() -> None:
    assert paired_p(Interval(2.0, 2.0, 0.0, 4.0, 5)) == 0.0
    assert paired_p(Interval(0.0, 0.0, 0.0, 4.0, 5)) == 1.0


@pytest.mark.parametrize("sequences", [1, 2])
def test_one_or_two_sequences_give_no_paired_p_value(sequences: int) -> None:
    assert math.isnan(paired_p(jackknife(1.0, np.ones(sequences))))
