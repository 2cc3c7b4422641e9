"""Radii hold their share of truths in sequences that they were not fitted on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.recalibration import (
    fit_radius,
    held_out_coverage,
    judge_spread,
)
from posecal.recalibration.folds import folds_of
from tests.helpers.random_worlds import skewed
from tests.helpers.samplers import gaussian, pairs_of, sequences

Array = np.ndarray
FEW = Protocol(metrics="ece, signed_area, min_mpjpe")


def distances(x: Array, y: Array, *, scaled: bool) -> Array:
    """From the median of the hypotheses to the truth, (M, K), mm or predicted standard deviations."""
    found = np.linalg.norm(np.median(x, axis=0) - y, axis=-1)
    return found / x.std(axis=0, ddof=1).mean(axis=-1) if scaled else found


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize(("alpha", "place"), [(0.1, 18), (0.25, 15), (0.05, 19)])
def test_the_radius_is_the_one_that_conformal_prediction_takes(scaled: bool, alpha: float, place: int) -> None:
    x, y = skewed(16, 5, 19, 3)  # ⌈20 · 0.9⌉ = 18, ⌈20 · 0.75⌉ = 15, ⌈20 · 0.95⌉ = 19
    found = fit_radius(pairs_of(x, y), alpha=alpha, scaled=scaled, threads=1)
    expected = np.sort(distances(x, y, scaled=scaled), axis=0)[place - 1]
    np.testing.assert_allclose(found.radii, expected, rtol=1e-9)
    assert (found.alpha, found.scaled, found.poses) == (alpha, scaled, 19)


@pytest.mark.parametrize("scaled", [False, True])
def test_radii_hold_their_share_of_new_truths(scaled: bool) -> None:
    M, alpha = 1000, 0.1
    x, y = gaussian(17, 8, 2 * M, 3, spread=0.3)  # however wrong the spread is
    radii = fit_radius(pairs_of(x[:, :M], y[:M]), alpha=alpha, scaled=scaled, threads=1).radii
    held = (distances(x[:, M:], y[M:], scaled=scaled) <= radii).mean(axis=0)
    # Coverage of new draws given M fitted ones is Beta distributed about 1 - α; with M new ones on top of it:
    spread = math.sqrt(alpha * (1 - alpha) * 2 / M)
    np.testing.assert_allclose(held, 1 - alpha, atol=3.5 * spread)


def test_coverage_on_held_out_sequences_is_within_its_binomial_tolerance() -> None:
    M, alpha = 1200, 0.2
    x, y = gaussian(18, 6, M, 2)
    found = held_out_coverage(pairs_of(x, y, labels={"sequence": sequences(M, 60)}), alpha=alpha, folds=4, threads=1)
    low, high = stats.binom(M, 1 - alpha).interval(0.9999)
    assert ((low / M <= found) & (found <= high / M)).all()


def test_a_truth_on_the_sphere_is_inside() -> None:
    x = np.round(skewed(29, 5, 40, 2)[0])
    y = np.median(x, axis=0) + np.array([64, 0, 0])  # every truth is as far from the median
    np.testing.assert_array_equal(held_out_coverage(pairs_of(x, y), alpha=0.3, folds=2), [1, 1])


def test_held_out_coverage_is_counted_part_by_part() -> None:
    x, y = skewed(19, 4, 40, 2)
    where = np.random.default_rng(0).random((40, 2)) < 0.8
    pairs = pairs_of(x, y, labels={"sequence": sequences(40, 8)}, where=where)
    found = held_out_coverage(pairs, alpha=0.3, folds=2, threads=1)
    part, d = folds_of(pairs, 2), distances(x, y, scaled=False)
    for k in range(2):
        inside = []
        for m in np.flatnonzero(where[:, k]):
            others = np.sort([d[o, k] for o in range(40) if part[o] != part[m] and where[o, k]])
            inside.append(d[m, k] <= others[math.ceil((len(others) + 1) * 0.7 - 1e-9) - 1])
        np.testing.assert_allclose(found[k], np.mean(inside))


def test_the_radius_is_the_smallest_distance_where_nearly_all_truths_may_lie_outside() -> None:
    x, y = skewed(27, 4, 12, 3)
    radii = fit_radius(pairs_of(x, y), alpha=1 - 1e-12).radii
    np.testing.assert_allclose(radii, distances(x, y, scaled=False).min(axis=0), rtol=1e-9)


def test_by_default_a_tenth_may_lie_outside_and_there_are_five_parts() -> None:
    data = pairs_of(*skewed(28, 4, 60, 2), labels={"sequence": sequences(60, 12)})
    np.testing.assert_array_equal(fit_radius(data).radii, fit_radius(data, alpha=0.1).radii)
    np.testing.assert_array_equal(held_out_coverage(data), held_out_coverage(data, alpha=0.1, folds=5))
    after = judge_spread(data, protocol=FEW).after
    assert after.render("json") == judge_spread(data, protocol=FEW, folds=5).after.render("json")


def test_a_joint_that_never_counts_has_no_radius() -> None:
    x, y = skewed(20, 4, 12, 3)
    where = np.ones((12, 3), dtype=bool)
    where[:, 1] = False
    pairs = pairs_of(x, y, where=where, labels={"sequence": sequences(12, 4)})
    np.testing.assert_array_equal(np.isnan(fit_radius(pairs, alpha=0.2, threads=1).radii), [False, True, False])
    np.testing.assert_array_equal(np.isnan(held_out_coverage(pairs, alpha=0.3, folds=2)), [False, True, False])


def test_an_alpha_that_no_number_of_poses_allows_is_refused_with_the_smallest_that_is() -> None:
    pairs = pairs_of(*skewed(21, 4, 9, 2))
    with pytest.raises(
        PoseDataError, match=r"alpha: 0\.05 needs more than 9 poses; the smallest possible .* is 0\.1\."
    ):
        fit_radius(pairs, alpha=0.05)
    where = np.ones((9, 2), dtype=bool)
    where[2:5, 0] = False
    with pytest.raises(PoseDataError, match=r"alpha: 0\.05 needs more than 6 poses; the smallest .* is 0\.1429\."):
        fit_radius(pairs.replace(where=where), alpha=0.05)
    assert np.isfinite(fit_radius(pairs, alpha=0.1).radii).all()


@pytest.mark.parametrize("alpha", [0.0, 1.0, -0.1, 7.0, math.nan])
def test_an_alpha_that_is_no_share_is_refused(alpha: float) -> None:
    with pytest.raises(PoseDataError, match=r"alpha: .*; expected between 0 and 1"):
        fit_radius(pairs_of(*skewed(22, 4, 9, 2)), alpha=alpha)


def test_radii_in_standard_deviations_need_two_hypotheses_and_radii_in_mm_do_not() -> None:
    pairs = pairs_of(*skewed(23, 1, 12, 2))
    assert np.isfinite(fit_radius(pairs, alpha=0.2).radii).all()
    with pytest.raises(PoseDataError, match="recalibration needs at least 2"):
        fit_radius(pairs, alpha=0.2, scaled=True)
