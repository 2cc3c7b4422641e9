"""Differences between sequences, from sums per sequence and from values of single poses."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from scipy import signal

import posecal
from posecal.calibration import LEVELS
from posecal.calibration.curve import signed_area
from posecal.report.report import Report
from posecal.stats.heterogeneity import (
    COLUMNS,
    MIN_FRAMES,
    SequenceAreas,
    persistence_p,
    remark_on_differences,
    sequence_areas,
    sequences_differ_p,
)
from tests.helpers.samplers import gaussian, pairs_of, report_of

S, F, K, N = 9, 12, 3, 15


def values_of(random: np.random.Generator, S: int, F: int, likeness: float, effect: float = 0.0) -> np.ndarray:
    """An AR(1) process of unit variance in each of S sequences, and an effect of each, (S, F)."""
    noise = random.standard_normal((S, F))
    noise[:, 1:] *= math.sqrt(1 - likeness**2)
    return np.asarray(signal.lfilter([1.0], [1.0, -likeness], noise, axis=1)) + effect * random.standard_normal((S, 1))


def rejections(replicates: int, *, S: int = 12, F: int = 60, likeness: float = 0.0, effect: float = 0.0) -> int:
    sequence = np.repeat(np.arange(S), F)
    random = np.random.default_rng(7)
    p = [
        persistence_p(values_of(random, S, F, likeness, effect).ravel(), sequence, draws=199, seed=seed)
        for seed in range(replicates)
    ]
    return sum(value < 0.05 for value in p)


def made(spread: float | np.ndarray = 1.0, *, S: int = S, F: int = F, labelled: bool = True) -> Report:
    x, y = gaussian(3, N, S * F, K)
    centre = x.mean(axis=0)
    x = centre + np.broadcast_to(spread, (S * F, 1, 1)) * (x - centre)
    labels = {"sequence": np.repeat([f"s{n}" for n in range(S)], F)} if labelled else None
    return report_of(pairs_of(x, y, labels=labels, joints=("Head", "LWrist", "RKnee")))


# --- signed areas of sequences ------------------------------------------------------------------------------------


def test_signed_areas_are_those_of_evaluations_of_each_sequence_alone() -> None:
    x, y = gaussian(3, N, S * F, K)
    found = sequence_areas(made().totals, made().metrics["ece"])
    assert found.names == tuple(f"s{n}" for n in range(S))
    assert found.frames == F
    for s in range(S):
        some = slice(s * F, (s + 1) * F)
        alone = report_of(pairs_of(x[:, some], y[some], joints=("Head", "LWrist", "RKnee")))
        assert found.areas[s] == pytest.approx(alone["signed_area"], abs=1e-12)


def test_short_sequences_are_left_out() -> None:
    assert MIN_FRAMES == 10
    x, y = gaussian(3, N, 31, K)
    labels = {"sequence": np.repeat(["a", "b", "c"], [10, 9, 12])}
    report = report_of(pairs_of(x, y, labels=labels, joints=("Head", "LWrist", "RKnee")))
    found = sequence_areas(report.totals, report.metrics["ece"])
    assert found.names == ("a", "c")
    assert found.frames == 11


def test_frames_without_sequence_labels_have_no_sequences_that_could_differ() -> None:
    report = made(labelled=False)
    assert sequence_areas(report.totals, report.metrics["ece"]).names == ()
    assert math.isnan(sequences_differ_p(report.totals, report.metrics["spread_error_correlation"].statistic))


def test_only_calibration_errors_have_areas() -> None:
    report = made()
    with pytest.raises(ValueError, match="signed_area is no calibration error"):
        sequence_areas(report.totals, report.metrics["signed_area"])


def test_areas_of_a_calibrated_model_take_as_many_independent_frames_as_there_are() -> None:
    """The area of n independent frames of one joint has a variance of 1/12n."""
    random, n = np.random.default_rng(0), 8
    ranks = random.random((40_000, n))
    curves = (ranks[..., None] <= LEVELS).mean(axis=1)
    areas = SequenceAreas(("",) * len(curves), signed_area(curves), n)
    assert areas.independent_frames == pytest.approx(n, rel=0.03)
    assert SequenceAreas(("a", "b"), np.array([-0.5, 0.5]), 9).independent_frames == pytest.approx(1 / 3)
    assert SequenceAreas(("a",), np.zeros(1), 9).independent_frames == math.inf
    assert math.isinf(SequenceAreas((), np.zeros(0), 9).independent_frames)


# --- from beginning to end ----------------------------------------------------------------------------------------


def test_of_six_sequences_the_pairings_are_those_of_a_permutation_test() -> None:
    """Against all 720 pairings of the means of the thirds, computed one by one."""
    values = values_of(np.random.default_rng(2), 6, 12, 0.0, 0.3)
    first, last = values[:, :4].mean(axis=1), values[:, 8:].mean(axis=1)
    products = [np.cov(first, last[list(order)])[0, 1] for order in permutations(range(6))]
    exact = np.mean(np.array(products) >= np.cov(first, last)[0, 1] - 1e-12)
    p = persistence_p(values.ravel(), np.repeat(np.arange(6), 12), draws=20_000)
    assert p == pytest.approx(exact, abs=4 * math.sqrt(exact * (1 - exact) / 20_000))


def test_five_sequences_or_short_ones_allow_no_test() -> None:
    for S, F, known in ((6, 10, True), (5, 10, False), (6, 9, False)):
        values = np.arange(S)[:, None] + 0.1 * (-1.0) ** np.arange(F)
        p = persistence_p(values.ravel(), np.repeat(np.arange(S), F))
        assert math.isnan(p) is not known


def test_frames_may_lie_in_any_order_of_the_sequences() -> None:
    values = values_of(np.random.default_rng(2), 8, 30, 0.3, 0.5)
    sequence = np.repeat(np.arange(8), 30).reshape(8, 30)
    p = persistence_p(values.ravel(), sequence.ravel())
    assert persistence_p(values.T.ravel(), sequence.T.ravel()) == p


def test_likeness_that_reaches_from_end_to_end_allows_no_test() -> None:
    """A straight line within each sequence: differences at twice the lag are four times as large."""
    line = np.arange(7)[:, None] + np.linspace(0, 1, 24)
    assert math.isnan(persistence_p(line.ravel(), np.repeat(np.arange(7), 24)))
    flat = np.broadcast_to(np.arange(7.0)[:, None], (7, 24))
    assert persistence_p(flat.ravel(), np.repeat(np.arange(7), 24)) < 0.01


@pytest.mark.parametrize("period", [3, 4])
def test_likeness_is_compared_at_a_sixth_and_a_third_of_the_length(period: int) -> None:
    """Of 24 frames: 4 and 8. With a period of 3 differences at both are alike, with 4 there are none."""
    values = np.arange(7)[:, None] + (np.arange(24) % period == 0)
    p = persistence_p(values.ravel(), np.repeat(np.arange(7), 24), draws=99)
    assert p == 1 / 100  # one of 5,040 orders is as extreme


@pytest.mark.slow
@pytest.mark.parametrize("likeness", [0.0, 0.5, 0.9])
def test_likeness_of_neighbouring_frames_is_no_difference_of_sequences(likeness: float) -> None:
    """A third of sixty frames is 20: the correlation of the ends is below 0.9²⁰ = 0.12."""
    assert rejections(400, likeness=likeness) <= 400 * 0.05 + 3.5 * math.sqrt(400 * 0.05 * 0.95)


@pytest.mark.slow
def test_differences_of_sequences_are_found() -> None:
    """Means of 20 frames have a standard deviation of 0.22: those of the effect, 0.5, correlate by 0.83."""
    assert rejections(200, effect=0.5) >= 190
    assert rejections(200, effect=0.5, likeness=0.5) >= 150


def test_a_spread_that_is_wrong_in_some_sequences_makes_them_differ() -> None:
    report = made(np.resize([0.5, 2.0], S).repeat(F)[:, None, None])
    assert sequences_differ_p(report.totals, report.metrics["spread_error_correlation"].statistic) < 0.01
    same = made(0.5)
    assert sequences_differ_p(same.totals, same.metrics["spread_error_correlation"].statistic) > 0.05


def test_what_a_calibrated_sampler_shows_is_said_to_be_of_sequences_that_differ_where_they_do() -> None:
    def remark(p: float, low: float = -0.1, high: float = 0.1, frames: float = 25.1) -> str:
        areas = np.array([low, high])  # of a variance of 0.01, that of 1 / (12 * 0.01) = 8.3 independent frames
        return remark_on_differences(SequenceAreas(("A", "B"), areas, frames), p)

    assert remark(0.0099, 0.1) == f"sequences differ (p = 0.010): {COLUMNS} of a model whose sequences differ as much."
    assert remark(0.0009).startswith("sequences differ (p < 0.001)")
    assert remark(0.01) == f"if sequences differ (weak evidence, p = 0.010), {COLUMNS} too large."
    assert remark(0.05) == ""
    assert remark(math.nan) == f"if sequences differ (not testable here), {COLUMNS} too large."
    assert remark(0.049, 0.1, 0.301) != ""
    assert [remark(0.049, -0.099, frames=99), remark(math.nan, frames=24.9)] == ["", ""]
    assert remark_on_differences(SequenceAreas((), np.zeros(0), math.nan), math.nan) == ""
    chance = "what a calibrated sampler would show is"
    assert f": {chance} of a model" in remark_on_differences(SequenceAreas((), np.zeros(0), 9.0), 0.001, chance)


def test_a_report_and_a_comparison_say_so_whichever_side_sequences_lie_on() -> None:
    report = made(np.resize([0.1, 0.6], 20).repeat(F)[:, None, None], S=20)
    assert (sequence_areas(report.totals, report.metrics["ece"]).areas < 0).all()
    (said,) = (remark for remark in report.remarks if "sequences differ" in remark)
    assert COLUMNS in said
    assert "a model that is calibrated on average, with sequences that differ as much, about" in report.summary[0]
    alike = made(0.3, S=20)
    assert not any("sequences differ" in remark for remark in alike.remarks)
    both = posecal.compare({"mixed": report, "alike": alike})
    (said,) = (remark for remark in both.remarks if "sequences differ" in remark)
    assert said.startswith("mixed: sequences differ (p")
    assert said.endswith("): what a calibrated sampler would show is of a model whose sequences differ as much.")
