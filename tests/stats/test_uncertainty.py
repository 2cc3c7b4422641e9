"""Intervals, nulls and p-values of metrics, from the sums over sequences: against the same made number by number."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from posecal.calibration import LEVELS
from posecal.engine.bounds import POSITIVE, UNBOUNDED
from posecal.engine.metric import Deviation, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals
from posecal.stats import resampling, uncertainty
from posecal.stats.jackknife import jackknife, joint_leave_one_out, leave_one_out, sequence_sizes
from posecal.stats.resampling import LEVEL, holm, sign_flips, thin
from posecal.stats.uncertainty import (
    effective_hypotheses,
    effective_poses,
    effective_sample_size,
    interval,
    joint_intervals,
    joint_p_values,
    null,
    p_without_each,
    sequence_deviations,
    squared_error,
    unbiased_squared_error,
)
from tests.helpers.example_totals import HEIGHT, JOINTS, metric, random_totals

Array = np.ndarray
Q = LEVELS.size

INSIDE = Statistic("inside", lambda block: np.zeros((len(block.truth), 4, Q)), per_joint=True)
AXES = Statistic("axes", lambda block: np.zeros((len(block.truth), 3, 2, Q)), per_joint=True)


def with_curves(seed: int, C: int = 40, S: int = 20, average: str = "poses") -> Totals:
    """Sums of 3 joints' curves and their pooled one; joint 1 is missing from some sequences, joint 2 from most."""
    random = np.random.default_rng(seed)
    some = random_totals(seed, C, S, protocol=Protocol(average=average))
    counts = random.integers(1, 6, (C, 4))
    counts[some.sequence_of < 5, 1] = 0
    counts[some.sequence_of < S - 4, 2] = 0
    bow = LEVELS * (1 - LEVELS)
    curves = LEVELS + random.normal(0.1, 0.8, (C, 4, 1)) * bow
    some.add("inside", np.arange(C), curves * counts[..., None], counts)
    axes = LEVELS + random.normal(0.0, 0.5, (C, 3, 2, 1)) * bow
    some.add("axes", np.arange(C), axes * counts[:, :3, None, None], counts[:, :3])
    return some


CELLS = [None, np.arange(6, 35)]
ECE = metric(INSIDE, family="calibration", deviation=Deviation(None, -1, "median"))


@pytest.mark.parametrize("cells", CELLS, ids=["all", "some"])
def test_an_interval_is_the_jackknife_of_the_values_without_each_sequence(cells: Array | None) -> None:
    some = random_totals(1, C=40)
    for bounds in (UNBOUNDED, POSITIVE):
        one = replace(metric(HEIGHT), bounds=bounds)
        expected = leave_one_out(some, one, cells), sequence_sizes(some, one, cells), bounds
        assert interval(some, one, cells) == jackknife(some.value(one, cells), *expected)


@pytest.mark.parametrize("cells", CELLS, ids=["all", "some"])
@pytest.mark.parametrize("average", ["poses", "action"])
def test_a_joint_has_the_interval_over_the_sequences_in_which_it_counts(cells: Array | None, average: str) -> None:
    some = random_totals(2, C=40, S=9, protocol=Protocol(average=average))
    some.sums["joints"][some.sequence_of < 4, 1] = some.counts["joints"][some.sequence_of < 4, 1] = 0
    one = replace(metric(by_joint=(JOINTS, np.asarray)), bounds=POSITIVE)
    low, high = joint_intervals(some, one, cells)
    values, (without, sizes) = some.by_joint(one, cells), joint_leave_one_out(some, one, cells)
    for k in (0, 1):
        expected = jackknife(values[k], without[:, k], sizes[:, k], POSITIVE)
        np.testing.assert_allclose([low[k], high[k]], [expected.low, expected.high], rtol=1e-9)
    assert (sizes[:, 1] > 0).sum() < (sizes[:, 0] > 0).sum()


def test_deviations_are_those_of_each_sequence_from_what_is_expected_there() -> None:
    some, offset = with_curves(3), 0.01 * np.sin(np.arange(Q))
    for cells in CELLS:
        chosen = np.arange(40) if cells is None else cells
        names = some.cells["sequence"][chosen]
        deviations, counts = sequence_deviations(some, AXES, cells, offset)
        for row, name in enumerate(sorted(set(names))):
            for j in range(3):
                own = chosen[names == name]
                n = some.counts["axes"][own, j].sum()
                for axis in range(2):
                    expected = some.sums["axes"][own, j, axis].sum(axis=0) - n * (LEVELS + offset)
                    np.testing.assert_allclose(deviations[row, 2 * j + axis], expected, atol=1e-12)
                    assert counts[row, 2 * j + axis] == n


@pytest.mark.parametrize("average", ["poses", "action"])
def test_a_null_is_that_of_the_sums_of_its_cells(average: str) -> None:
    some = with_curves(4, average=average)
    for cells in CELLS:
        D, counts = sequence_deviations(some, INSIDE, cells)
        assert null(some, ECE, cells) == sign_flips(
            D, counts, Deviation(None, -1, "median"), n=effective_hypotheses(some)
        )
        assert effective_sample_size(some, INSIDE, cells) == effective_poses(D[:, :-1], counts[:, :-1])
        assert unbiased_squared_error(some, INSIDE, cells) == squared_error(D[:, :-1], counts[:, :-1])
    with pytest.raises(ValueError, match="is no calibration error"):
        null(some, metric())


def test_p_values_without_each_sequence_are_those_of_results_without_it() -> None:
    for S in (6, 9, 12):
        some = with_curves(S, S=S)
        D, counts = sequence_deviations(some, INSIDE)
        rest = (np.arange(S) != s for s in range(S))
        expected = [sign_flips(D[r], counts[r], ECE.deviation, draws=uncertainty.FEW_DRAWS).p for r in rest]
        np.testing.assert_array_equal(p_without_each(some, ECE), expected)
        assert np.isnan(expected).all() == (S == 6)


def test_every_joint_is_tested_as_if_it_were_the_only_one() -> None:
    some = with_curves(5)
    for cells in CELLS:
        p = joint_p_values(some, ECE, cells)
        for k in range(3):
            alone = null(some, metric(INSIDE, deviation=Deviation(k, k + 1)), cells).p
            assert p[k] == alone or (math.isnan(p[k]) and math.isnan(alone))
        assert np.isnan(p).tolist() == [False, False, True]  # joint 2 counts in 4 sequences
        assert p[0] != p[1]


@pytest.mark.parametrize("S", [6, 9])
def test_joints_too_many_for_any_to_be_significant_are_not_tested(S: int) -> None:
    """All sequences lean to one side, so each joint's p-value is one of 2^(S - 1) patterns, the smallest there is."""
    patterns = 2 ** (S - 1)
    most = int(LEVEL * patterns)
    assert most / patterns < LEVEL < (most + 1) / patterns  # the smallest p-value of so many joints by Holm
    for joints, tested in ((most, True), (most + 1, False)):
        some = of_joints(joints, S)
        p = joint_p_values(some, ECE)
        assert p.shape == (joints,)
        np.testing.assert_array_equal(p, 1 / patterns if tested else math.nan)
        assert min(holm(p.tolist())) < LEVEL or not tested
    some.sums["inside"][:, 1], some.counts["inside"][:, 1] = 0, 0  # a joint that never counts is none to adjust for
    p = joint_p_values(some, ECE)
    np.testing.assert_array_equal(np.delete(p, 1), 1 / patterns)
    assert math.isnan(p[1])


def of_joints(joints: int, S: int) -> Totals:
    """Sums of joints that lean to one side in every sequence alike, and their pooled curve."""
    some = random_totals(1, S, S)
    some.spec = replace(some.spec, joints=tuple(map(str, range(joints))))
    counts = np.full((S, joints + 1), 3)
    some.add("inside", np.arange(S), counts[..., None] * (LEVELS + 0.1 * LEVELS * (1 - LEVELS)), counts)
    return some


def test_a_test_of_a_mesh_is_that_of_the_curves_that_it_judges(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resampling, "MESH", 2)
    some = with_curves(8)
    judged = some.spec.joints
    D, counts = sequence_deviations(some, INSIDE, judged=slice(None, -1))
    chosen = thin(sequence_deviations(some, INSIDE)[1][:, :-1])
    np.testing.assert_array_equal(chosen, [0, 2])
    assert len(judged) == 2
    np.testing.assert_array_equal(D, sequence_deviations(some, INSIDE)[0][:, chosen])
    np.testing.assert_array_equal(counts, sequence_deviations(some, INSIDE)[1][:, chosen])
    assert null(some, ECE) == sign_flips(D, counts, Deviation(over="median"), n=effective_hypotheses(some))
    np.testing.assert_array_equal(sequence_deviations(some, INSIDE, judged=slice(-1, None))[0][:, 0], pooled(some))


def pooled(some: Totals) -> Array:
    """Deviations of the last curve."""
    return sequence_deviations(some, INSIDE)[0][:, -1]


def test_of_one_sequence_nothing_is_uncertain() -> None:
    some = random_totals(6, S=1)
    one = interval(some, metric(HEIGHT))
    assert math.isnan(one.low)
    assert one.sequences == 1
    low, high = joint_intervals(some, metric(by_joint=(JOINTS, np.asarray)))
    assert np.isnan([low, high]).all()
    few = with_curves(7, C=10, S=5)
    assert math.isnan(null(few, ECE).p)
    assert not math.isnan(null(few, ECE).observed)
    assert np.isnan(joint_p_values(few, ECE)).all()


# --- variance between sequences ---------------------------------------------------------------------------------------


def leaning(seed: int, S: int = 7, J: int = 3) -> tuple[Array, Array]:
    """Deviations (S, J, Q) that lean to one side, and counts."""
    random = np.random.default_rng(seed)
    counts = random.integers(1, 30, (S, J))
    bridge = random.normal(0.4, 1, (S, J, 1)) * np.sqrt(LEVELS * (1 - LEVELS)) + 0.1 * random.normal(size=(S, J, Q))
    return bridge * np.sqrt(counts)[..., None], counts


def test_the_squared_error_is_the_square_of_the_mean_less_its_variance() -> None:
    D, counts = leaning(10)
    S, expected = len(D), []
    for j in range(D.shape[1]):
        n = counts[:, j].sum()
        for q in range(Q):
            mean = sum(D[s, j, q] for s in range(S)) / n
            residuals = [D[s, j, q] - counts[s, j] * mean for s in range(S)]
            expected.append(mean**2 - S / (S - 1) * sum(r**2 for r in residuals) / n**2)
    np.testing.assert_allclose(squared_error(D, counts), np.mean(expected), rtol=1e-9)


def test_the_squared_error_of_a_calibrated_model_is_0_but_for_chance() -> None:
    random = np.random.default_rng(11)
    found = [squared_error(random.normal(size=(10, 2, Q)), np.full((10, 2), 3)) for _ in range(600)]
    assert abs(np.mean(found)) < 4 * np.std(found) / math.sqrt(len(found))
    assert min(found) < 0 < max(found)


@pytest.mark.parametrize("frames", [1, 7])
def test_sequences_of_like_frames_count_as_one_pose_each_but_one(frames: int) -> None:
    # W is 0 or 1 and the same in all frames of a sequence. Then the variance of ω over sequences is estimated as
    # S/(S-1) Σ(W-ω)²/S² = ω(1-ω)/(S-1), so the effective number of poses is S - 1.
    random = np.random.default_rng(12)
    S = 40
    inside = random.random((S, 3, 1)) <= LEVELS
    D = frames * (inside - LEVELS)
    np.testing.assert_allclose(effective_poses(D, np.full((S, 3), frames)), S - 1, rtol=1e-9)


def test_there_are_never_more_effective_poses_than_poses() -> None:
    random = np.random.default_rng(13)
    even = (np.arange(20) + random.random()) / 20  # more even than chance: hardly any variance between sequences
    D = (even[:, None, None] <= LEVELS) - LEVELS
    pairs = D[:10] + D[::-1][:10]
    assert effective_poses(pairs, np.full((10, 1), 2)) == 20
    assert effective_poses(np.zeros((4, 1, Q)), np.full((4, 1), 5)) == 20


def test_a_sequence_without_a_pose_that_counts_changes_neither() -> None:
    D, counts = leaning(14)
    empty_D, empty = np.insert(D, 3, 0.0, axis=0), np.insert(counts, 3, 0, axis=0)
    np.testing.assert_allclose(squared_error(empty_D, empty), squared_error(D, counts), rtol=1e-12)
    np.testing.assert_allclose(effective_poses(empty_D, empty), effective_poses(D, counts), rtol=1e-12)


@pytest.mark.parametrize("number", [squared_error, effective_poses])
def test_one_sequence_or_none_that_counts_says_nothing_of_chance(number: object) -> None:
    assert math.isnan(number(np.ones((1, 2, Q)), np.ones((1, 2), int)))  # type: ignore[operator]
    assert math.isnan(number(np.zeros((4, 2, Q)), np.zeros((4, 2), int)))  # type: ignore[operator]


def test_sequences_in_slices_vary_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    D, counts = leaning(15, S=9)
    expected = squared_error(D, counts), effective_poses(D, counts)
    slices = uncertainty.slices
    monkeypatch.setattr(uncertainty, "slices", lambda length, row_bytes: slices(length, row_bytes, 2 * row_bytes))
    np.testing.assert_allclose((squared_error(D, counts), effective_poses(D, counts)), expected, rtol=1e-12)


# --- standardized errors ----------------------------------------------------------------------------------------------

ERRORS = Statistic("standardized_errors", lambda block: np.zeros((len(block.truth), 3, 4)), per_joint=True)


@pytest.mark.parametrize(
    ("statistic", "deviation", "joints"),
    [(INSIDE, Deviation(None, -1, "median"), [0, 1, 2]), (INSIDE, Deviation(-1), None), (AXES, Deviation(), [0, 1, 2])],
)
def test_each_curve_has_the_standardized_errors_of_its_joint_or_of_all(
    statistic: Statistic, deviation: Deviation, joints: list[int] | None
) -> None:
    some, random = with_curves(9), np.random.default_rng(9)
    logs = random.normal(size=(40, 3, 5))
    sums = np.stack([np.full((40, 3), 5.0), np.full((40, 3), 5.0), logs.sum(axis=2), (logs**2).sum(axis=2)], axis=-1)
    some.add("standardized_errors", np.arange(40), sums, np.full((40, 3), 5))
    some.sums[statistic.name] *= 0  # so that ranks say nothing
    found = null(some, metric(statistic, deviation=replace(deviation, errors=ERRORS)))
    D, counts = sequence_deviations(some, statistic)
    errors = some.by_sequence(ERRORS)[0][..., 1:]
    if joints is not None:
        errors = errors[:, np.repeat(joints, 2 if statistic is AXES else 1)]
        D, counts = D[:, : errors.shape[1]], counts[:, : errors.shape[1]]
    else:
        D, counts = D[:, -1:], counts[:, -1:]
    over, n = Deviation(over=deviation.over), effective_hypotheses(some)
    assert found == sign_flips(D, counts, over, errors=errors, n=n)
    assert found != sign_flips(D, counts, over, n=n)


def test_hypotheses_that_never_differ_are_not_tested() -> None:
    some = with_curves(9)
    some.add("standardized_errors", np.arange(40), np.zeros((40, 3, 4)), np.full((40, 3), 5))
    one = metric(INSIDE, deviation=Deviation(None, -1, errors=ERRORS))
    found = null(some, one)
    assert np.isnan([found.mean, found.high, found.p, found.band]).all()
    assert found.observed == null(some, metric(INSIDE, deviation=Deviation(None, -1))).observed
    assert np.isnan(joint_p_values(some, one)).all()
