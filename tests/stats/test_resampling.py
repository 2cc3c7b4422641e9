"""Sign-flips and Holm, against loops, enumeration and textbooks."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
import sys
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from posecal.calibration import LEVELS
from posecal.engine.metric import Deviation
from posecal.stats import resampling
from posecal.stats.resampling import (
    DRAWS,
    MAX_VALUES,
    MESH,
    MIN_DRAWS,
    MIN_SEQUENCES,
    _reduce_flips,
    _signs,
    holm,
    n_draws,
    n_patterns,
    sign_flips,
    sign_flips_of_each,
    thin,
)

Array = np.ndarray
Q = LEVELS.size
OVER = ("median", "mean", "worst")
ROOT = Path(__file__).parents[2]


# --- sign-flips against enumeration -----------------------------------------------------------------------------------


def statistic(mean: Array, over: str) -> float:
    """The error of mean deviations (J, Q), by the definitions."""
    if over == "median":
        curve = [float(np.median([mean[j, q] for j in range(len(mean))])) for q in range(Q)]
        return sum(abs(value) for value in curve) / Q
    each = [sum(abs(value) for value in row) / Q for row in mean]
    return max(each) if over == "worst" else sum(each) / len(each)


def furthest(mean: Array, over: str) -> float:
    """Largest weighted distance from the diagonal."""
    curves = np.median(mean, axis=0)[None] if over == "median" else mean
    return max(abs(curve[q]) / math.sqrt(LEVELS[q] * (1 - LEVELS[q])) for curve in curves for q in range(1, Q - 1))


def flipped(D: Array, counts: Array, signs: tuple[int, ...], offset: Array | float = 0.0) -> Array:
    """Mean deviations (J, Q) with each sequence's sign, by loops."""
    mean = np.zeros(D.shape[1:])
    for j in range(D.shape[1]):
        for s, sign in enumerate(signs):
            mean[j] += sign * D[s, j]
        mean[j] /= counts[:, j].sum()
    return mean + offset


def some(seed: int, S: int = 7, J: int = 3) -> tuple[Array, Array]:
    """Deviations (S, J, Q) that lean to one side, and counts."""
    random = np.random.default_rng(seed)
    counts = random.integers(1, 30, (S, J))
    bridge = random.normal(0.4, 1, (S, J, 1)) * np.sqrt(LEVELS * (1 - LEVELS)) + 0.1 * random.normal(size=(S, J, Q))
    return bridge * np.sqrt(counts)[..., None], counts


@pytest.mark.parametrize("J", [3, 4])
@pytest.mark.parametrize("over", ["median", "mean", "worst"])
@pytest.mark.parametrize("offset", [None, 0.02 * np.sin(np.arange(Q))], ids=["unbiased", "biased definition"])
def test_few_sequences_are_flipped_in_every_way(over: str, offset: Array | None, J: int) -> None:
    D, counts = some(3, J=J)
    every = [
        flipped(D, counts, signs, 0 if offset is None else offset) for signs in itertools.product((1, -1), repeat=7)
    ]
    if offset is None:
        reference = every
    else:  # a pattern and its opposite differ where the definition is biased; posecal takes those with the last sign +
        reference = [
            mean for mean, signs in zip(every, itertools.product((1, -1), repeat=7), strict=True) if signs[-1] > 0
        ]
    errors = np.array([statistic(mean, over) for mean in reference])
    observed = statistic(every[0], over)
    found = sign_flips(D, counts, Deviation(over=over), offset=offset)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.observed, observed, rtol=1e-5)
    np.testing.assert_allclose(found.p, (errors >= observed * (1 - 1e-6)).mean(), rtol=1e-9)
    assert found.sequences == 7


@pytest.mark.slow
@pytest.mark.parametrize("over", ["median", "mean", "worst"])
def test_many_sequences_are_flipped_at_random_as_if_in_every_way(over: str) -> None:
    D, counts, draws = *some(4, S=11, J=2), 500
    assert draws < 2**10  # so posecal does not try all of them
    errors = [
        statistic(flipped(D, counts, signs), over)
        for signs in itertools.product((1, -1), repeat=10)
        for signs in [(*signs, 1)]
    ]
    p = float((np.array(errors) >= statistic(flipped(D, counts, (1,) * 11), over)).mean())
    found = sign_flips(D, counts, Deviation(over=over), draws=draws)  # type: ignore[arg-type]
    assert 0.01 < p < 0.9
    assert abs(found.p - p) < 4 * math.sqrt(p * (1 - p) / draws) + 1 / draws


def test_a_slice_of_the_curves_is_judged_by_itself() -> None:
    D, counts = some(5, J=4)
    for first, last in ((None, -1), (-1, None), (1, 3)):
        part = slice(first, last)
        assert sign_flips(D, counts, Deviation(first, last, "worst")) == sign_flips(
            D[:, part], counts[:, part], Deviation(over="worst")
        )


def test_curves_and_sequences_without_a_pose_that_counts_change_nothing() -> None:
    D, counts = some(6)
    plain = sign_flips(D, counts, Deviation(over="mean"))
    wider = np.insert(np.insert(D, 1, 0.0, axis=1), [2, 5], 0.0, axis=0)
    more = np.insert(np.insert(counts, 1, 0, axis=1), [2, 5], 0, axis=0)
    assert sign_flips(wider, more, Deviation(over="mean")) == plain


def test_the_order_of_the_sequences_changes_nothing_where_all_patterns_are_tried() -> None:
    D, counts = some(7, S=9)
    order = np.random.default_rng(0).permutation(9)
    one, other = (sign_flips(d, c, Deviation()) for d, c in ((D, counts), (D[order], counts[order])))
    np.testing.assert_allclose(
        [one.p, one.mean, one.high, one.band], [other.p, other.mean, other.high, other.band], rtol=1e-5
    )


def test_the_same_question_has_the_same_answer() -> None:
    D, counts = some(8, S=30)
    assert sign_flips(D, counts, Deviation()) == sign_flips(D, counts, Deviation())
    assert sign_flips(D, counts, Deviation(), seed=1).p != sign_flips(D, counts, Deviation()).p


@pytest.mark.parametrize("S", [1, 2, 5])
def test_with_fewer_than_six_sequences_there_is_no_p_value(S: int) -> None:
    D, counts = some(9, S=S)
    found = sign_flips(D, counts, Deviation())
    np.testing.assert_allclose(found.observed, statistic(flipped(D, counts, (1,) * S), "mean"), rtol=1e-5)
    assert np.isnan([found.p, found.mean, found.high, found.band]).all()
    assert found.sequences == S


def test_six_is_the_smallest_number_at_which_anything_can_be_rejected() -> None:
    # All sequences deviate alike: of the 2^(S-1) patterns only one is as extreme, the observed one.
    found = sign_flips(np.ones((MIN_SEQUENCES, 1, Q)), np.ones((MIN_SEQUENCES, 1), int), Deviation())
    assert found.p == 1 / 2 ** (MIN_SEQUENCES - 1) < 0.05 < 1 / 2 ** (MIN_SEQUENCES - 2)


@pytest.mark.parametrize(("S", "draws", "every"), [(8, 128, True), (8, 127, False), (9, 128, False)])
def test_signs_are_drawn_where_there_are_more_patterns_than_draws(S: int, draws: int, every: bool) -> None:
    D, counts = some(4, S=S)
    one, other = (sign_flips(D, counts, Deviation(), draws=draws, seed=seed) for seed in (0, 1))
    assert (one == other) == every
    assert one.p * draws == pytest.approx(round(one.p * draws))


def test_there_are_as_many_patterns_as_are_tried() -> None:
    for S in (0, 1, 2, 6, 11, 12, 13, 300):
        assert n_patterns(S, 3 * Q) == len(_signs(S, n_draws(DRAWS, 3 * Q), 0)) == min(2 ** max(S - 1, 0), DRAWS)
    assert n_patterns(300, 6890 * Q) == MIN_DRAWS
    assert n_patterns(8, 6890 * Q, draws=50) == 50


def test_curves_on_the_diagonal_are_as_calibrated_as_can_be() -> None:
    D, counts = np.zeros((8, 2, Q)), np.ones((8, 2), int)
    assert sign_flips(D, counts, Deviation()).p == 1
    assert sign_flips_of_each(D, counts).tolist() == [1, 1]
    rounded = 1e-16 * np.random.default_rng(0).random(D.shape)
    assert sign_flips(rounded, counts, Deviation()).p == 1
    assert sign_flips(rounded, counts, Deviation()).observed == 0
    assert sign_flips_of_each(rounded, counts).tolist() == [1, 1]


def test_errors_that_differ_by_less_than_rounding_tie() -> None:
    D = np.full((8, 1, Q), 1e-3)
    D += 1e-10 * np.arange(8)[:, None, None]
    one = np.concatenate([D, -D[:4], D[4:8] * 0])  # no pattern but all-plus of the first is much larger
    assert sign_flips(D, np.ones((8, 1)), Deviation()).p == 1 / 2**7
    assert sign_flips(one * 1e-6, np.ones((16, 1)), Deviation()).p > 0.9


def test_nothing_that_counts_gives_no_number() -> None:
    found = sign_flips(np.zeros((8, 2, Q)), np.zeros((8, 2), int), Deviation())
    assert found.sequences == 0
    assert np.isnan([found.observed, found.p, found.mean, found.high, found.band]).all()


# --- each curve by itself ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("S", [8, 30])
@pytest.mark.parametrize("offset", [None, 0.02 * np.sin(np.arange(Q))], ids=["unbiased", "biased definition"])
def test_curves_tested_together_have_the_p_values_that_they_have_alone(S: int, offset: Array | None) -> None:
    D, counts = some(15, S=S, J=9)
    D = D - 0.3 * np.sqrt(counts)[..., None] * np.sqrt(LEVELS * (1 - LEVELS))  # so that p is neither 0 nor 1
    counts[2:4, 1] = counts[:, 2] = counts[5:, 3] = counts[6:, 4] = 0
    D[counts == 0] = 0
    alone = [sign_flips(D, counts, Deviation(j, j + 1), offset=offset).p for j in range(9)]
    together = sign_flips_of_each(D, counts, offset=offset)
    np.testing.assert_array_equal(together, alone)
    assert np.isnan(together).tolist() == [False, False, True, True, *[False] * 5]
    assert len(set(alone)) > 4


def test_curves_in_chunks_have_the_same_p_values(monkeypatch: pytest.MonkeyPatch) -> None:
    D, counts = some(16, S=25, J=11)
    expected = sign_flips_of_each(D, counts), *(sign_flips(D, counts, Deviation(over=o)) for o in OVER)
    monkeypatch.setattr(resampling, "CHUNK", 3 * Q * 37)
    monkeypatch.setattr(resampling, "MAX_CURVES", 3)
    found = sign_flips_of_each(D, counts), *(sign_flips(D, counts, Deviation(over=o)) for o in OVER)
    np.testing.assert_array_equal(found[0], expected[0])
    for one, other in zip(found[1:], expected[1:], strict=True):
        np.testing.assert_allclose(astuple(one), astuple(other), rtol=1e-6)


@pytest.mark.parametrize(("J", "draws"), [(1, 2000), (6, 500), (60, 199)])
def test_a_mesh_has_fewer_random_patterns_and_never_too_few(
    J: int, draws: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resampling, "MAX_VALUES", 6 * Q * 500)
    lean = np.random.default_rng(17).normal(1.0, 0.1, (20, 1, Q)).repeat(J, axis=1)
    counts = np.ones((20, J))
    for over in OVER:
        p = sign_flips(lean, counts, Deviation(over=over)).p  # only the observed pattern is as extreme
        assert 1 / p == pytest.approx(draws)
    np.testing.assert_allclose(sign_flips_of_each(lean, counts), 1 / draws)
    assert sign_flips(lean[:8], counts[:8], Deviation(over="median")).p == 1 / 2**7  # as few are flipped in every way


def test_the_number_of_patterns_is_bounded_for_a_mesh_and_not_for_a_skeleton() -> None:
    assert [n_draws(DRAWS, J * Q) for J in (16, 17, 52)] == [DRAWS] * 3
    assert n_draws(DRAWS, 133 * Q) == MAX_VALUES // (133 * Q) > MIN_DRAWS
    assert n_draws(DRAWS, 6890 * Q) == MIN_DRAWS
    assert n_draws(DRAWS, 50_000 * Q) == MIN_DRAWS
    assert n_draws(50, 50_000 * Q) == 50


@pytest.mark.parametrize("over", OVER)
def test_of_a_mesh_evenly_spaced_joints_that_count_are_tested(over: str) -> None:
    random = np.random.default_rng(3)
    D = random.normal(0.2, 1, (9, 2 * MESH + 5, Q)) * np.sqrt(LEVELS * (1 - LEVELS))
    counts = np.ones((9, 2 * MESH + 5))
    counts[:, :3] = 0  # of no pose
    chosen = thin(counts)
    assert len(chosen) == MESH
    assert counts[:, chosen].all()
    assert (chosen[0], chosen[-1]) == (3, 2 * MESH + 4)
    assert set(np.diff(chosen)) <= {2, 3}
    whole = sign_flips(D, counts, Deviation(over=over))
    apart = sign_flips(D[:, chosen], counts[:, chosen], Deviation(over=over))
    assert (whole.p, whole.mean, whole.high) == (apart.p, apart.mean, apart.high)
    np.testing.assert_array_equal(thin(counts[:, :MESH]), np.arange(3, MESH))  # all that count


@pytest.mark.parametrize("over", OVER)
def test_the_curves_that_are_tested_of_a_mesh_reject_a_calibrated_one_as_often_as_the_level_says(over: str) -> None:
    """With all 2^7 patterns the p-values of symmetric deviations are uniform: 6 / 128 of them lie below 5 %."""
    random = np.random.default_rng(21)
    times, counts = 250, np.ones((8, MESH + 150))
    curves = (random.normal(size=(8, MESH + 150, 1)) * np.sqrt(LEVELS * (1 - LEVELS)) for _ in range(times))
    rejected = sum(sign_flips(D, counts, Deviation(over=over)).p < 0.05 for D in curves)
    low, high = stats.binom(times, 6 / 128).interval(0.999)
    assert low <= rejected <= high


# --- p-values ---------------------------------------------------------------------------------------------------------


@given(p=st.lists(st.floats(0, 1), min_size=1, max_size=7))
def test_holm_is_the_closed_test_of_bonferronis(p: list[float]) -> None:
    everyone = range(len(p))
    adjusted = [
        max(
            min(1.0, len(group) * min(p[j] for j in group))
            for size in range(1, len(p) + 1)
            for group in itertools.combinations(everyone, size)
            if i in group
        )
        for i in everyone
    ]
    np.testing.assert_allclose(holm(p), adjusted, rtol=1e-12)


def test_holm_leaves_out_what_was_not_tested() -> None:
    assert holm([0.02, math.nan, 0.03])[::2] == [0.04, 0.04]
    assert math.isnan(holm([0.02, math.nan, 0.03])[1])
    assert holm([]) == []


# --- threads of a matrix product ----------------------------------------------------------------------------------


def test_the_order_of_the_sequences_does_not_change_a_bit() -> None:
    random = np.random.default_rng(3)
    deviations, counts = random.normal(0, 1, (900, 3, Q)), random.integers(1, 9, (900, 3))
    signs = (2 * random.integers(0, 2, (50, 900)) - 1).astype(np.int8)
    offset = random.normal(0, 0.1, Q)
    order = random.permutation(900)
    (one,) = _reduce_flips(np.copy, deviations, counts, signs, offset)
    (other,) = _reduce_flips(np.copy, deviations[order], counts[order], signs[:, order], offset)
    np.testing.assert_array_equal(one, other)
    parts = deviations / counts.sum(axis=0)[:, None]
    expected = np.einsum("bs,sjq->bqj", signs.astype(float), parts) + offset[:, None]
    np.testing.assert_allclose(one, expected, atol=1e-5 * np.abs(parts).sum(axis=0).max())


@pytest.mark.slow
def test_numbers_do_not_depend_on_the_threads_of_matrix_products() -> None:
    """So many sequences that a product of matrices would add them in another order."""
    script = """
import numpy as np, posecal
random = np.random.default_rng(5)
truth = random.normal(0, 300, (1200, 5, 3))
hypotheses = truth + random.normal(0, 40, (4, 1200, 5, 3)) + random.normal(0, 25, (1200, 5, 3))
labels = {"sequence": np.arange(1200) // 2}
report = posecal.evaluate(hypotheses, truth, labels=labels, metrics="all", unit="mm")
print([(row.metric, row.joint, row.value, row.low, row.high) for row in report.rows], report.joint_tests())
"""
    found = set()
    for threads in ("1", "2"):
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "OPENBLAS_NUM_THREADS": threads,
            "MKL_NUM_THREADS": threads,
        }
        done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, check=True)
        found.add(done.stdout)
    assert len(found) == 1
