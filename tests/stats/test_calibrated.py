"""Deviations of a calibrated sampler, against loops that follow the formula and a sampler that is calibrated."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from posecal.calibration import LEVELS
from posecal.engine.metric import Deviation
from posecal.stats.calibrated import FAR, FEWEST, calibrated_deviations
from posecal.stats.resampling import sign_flips
from tests.helpers.sequences import Ranks
from tests.stats.test_resampling import OVER, flipped, furthest, some, statistic

Array = np.ndarray
Q = LEVELS.size


def naive(D: Array, counts: Array, expected: Array, drive: Array | None, n: int = 10_000) -> Array:
    """The definition, number by number; ``drive`` is what a curve of unit variance deviates by."""
    S, J, _ = D.shape
    found = np.zeros(D.shape)
    for j in range(J):
        total = sum(counts[s, j] for s in range(S))
        scale = 1 / math.sqrt(1 - sum((counts[s, j] / total) ** 2 for s in range(S)))
        mean = [sum(D[s, j, q] for s in range(S)) / total for q in range(Q)]
        omega = [min(max(expected[q] + mean[q], 0.0), 1.0) for q in range(Q)]
        of_ranks = [q for q in range(1, Q - 1) if q * (n + 1) >= 20 and q * (n + 1) <= 20 * n]  # q is in twentieths
        known = [q for q in of_ranks if omega[q] * (1 - omega[q]) >= FEWEST]

        def odds(share: float) -> float:
            return math.log(share / (1 - share))

        for q in range(1, Q - 1):
            spread = math.sqrt(expected[q] * (1 - expected[q]))
            wanted = odds(expected[q])
            below = [level for level in known if odds(omega[level]) <= wanted]
            above = [level for level in known if odds(omega[level]) > wanted]
            low, high = (below or above or [0])[-1 if below else 0], (above or below or [0])[0 if above else -1]
            gap = odds(omega[high]) - odds(omega[low]) if known else 0.0
            share = (wanted - odds(omega[low])) / gap if gap > 0 else 0.0
            length = math.sqrt(share**2 + (1 - share) ** 2 + 2 * share * (1 - share) * math.exp(-gap / 2))
            far = not known or (drive is not None and max(odds(omega[low]) - wanted, wanted - odds(omega[high])) > FAR)
            for s in range(S):
                weights = [min(max((n + 1) * q / 20 - rank, 0.0), 1.0) for rank in range(min(n, 99) + 1)]
                z = math.sqrt(counts[s, j]) if drive is None else drive[s, j]
                z *= 1 if n > 99 else float(np.std(weights)) / math.sqrt(q / 20 * (1 - q / 20))
                if not far:
                    two = [
                        (D[s, j, level] - counts[s, j] * mean[level]) / math.sqrt(omega[level] * (1 - omega[level]))
                        for level in (low, high)
                    ]
                    z = (two[0] * (1 - share) + two[1] * share) / length
                found[s, j, q] = z * scale * spread
    return found


def sums(spread: float, offset: Array | float = 0.0) -> tuple[Array, Array, Array]:
    """Deviations, counts and sums of standardized errors of a model, joints of unlike numbers of poses."""
    ranks = Ranks(sequences=7, frames=30, joints=3, correlation=0.8)
    inside, errors = ranks.sums(np.random.default_rng(3), spread)
    counts = np.full((7, 3), 30)
    inside[:2, 1], errors[:2, 1], counts[:2, 1] = 0, 0, 0
    return inside - counts[..., None] * (LEVELS + offset), counts, errors


@pytest.mark.parametrize("spread", [0.1, 0.6, 1.0, 3.0, 30.0])
@pytest.mark.parametrize("offset", [0.0, 0.02 * np.sin(np.arange(Q) * np.pi / 10)], ids=["unbiased", "biased"])
def test_they_follow_the_definition(spread: float, offset: Array | float) -> None:
    D, counts, errors = sums(spread, offset)
    expected = LEVELS + offset
    given = None if isinstance(offset, float) else offset
    np.testing.assert_allclose(calibrated_deviations(D, counts, given), naive(D, counts, expected, None), atol=1e-9)
    number, logs, squares = np.moveaxis(errors, -1, 0)
    mean = logs.sum(axis=0) / number.sum(axis=0)
    drive = (logs - number * mean) / np.sqrt(squares.sum(axis=0) / number.sum(axis=0) - mean**2)
    found = calibrated_deviations(D, counts, given, errors)
    np.testing.assert_allclose(found, naive(D, counts, expected, drive), atol=1e-9)


@pytest.mark.parametrize("spread", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("n", [2, 3, 19])
def test_of_few_hypotheses_ranks_say_something_between_the_outermost_alone(n: int, spread: float) -> None:
    ranks = Ranks(sequences=7, frames=30, joints=3, correlation=0.8, hypotheses=n)
    inside, _ = ranks.sums(np.random.default_rng(3), spread)
    counts = np.full((7, 3), 30)
    D = inside - 30 * LEVELS
    np.testing.assert_allclose(
        calibrated_deviations(D, counts, n=n), naive(D, counts, LEVELS, None, n), rtol=1e-9, atol=1e-9
    )


def test_a_joint_with_one_known_error_says_nothing_of_its_own() -> None:
    D, counts, errors = sums(0.02)
    errors[:, 2] = 0
    errors[4, 2] = 1, -0.7, 0.49
    expected = calibrated_deviations(D, counts)
    np.testing.assert_array_equal(calibrated_deviations(D, counts, None, errors)[:, 2], expected[:, 2])


def test_noise_of_the_median_makes_sequences_seem_more_alike() -> None:
    """Errors of which a share r is no noise: the excess of the design effect over 1 is divided by r², r at least ¼."""
    random, number = np.random.default_rng(8), np.full((9, 2), 40.0)
    sums_of_logs = 40 * random.normal(-1, 0.3, (9, 1)) + 4 * random.normal(size=(9, 2))
    D, counts = np.full((9, 2, Q), -40.0) * LEVELS, np.full((9, 2), 40)  # all truths lie outside
    for mean, smallest in ((0.0, None), (-1.0, None), (-2.17, 0.25)):
        logs = sums_of_logs + 40 * (1 + mean)
        squares = logs**2 / 40 + 40 * 0.5
        errors = np.stack([number, logs, squares], axis=-1)
        variance = squares.sum(axis=0) / 360 - (logs.sum(axis=0) / 360) ** 2
        size = np.exp(2 * logs.sum(axis=0) / 360 + 1.5 * variance).mean()
        noise = math.pi / 2 / 1.3489795**2 / 50  # of the median of 50, in squared distances between quartiles
        share = 1 - noise / size
        assert 0.1 < share < 0.25 if smallest else share > 0.25
        share = smallest or share
        plain = calibrated_deviations(D, counts, None, errors)[..., 10]
        effect = (plain**2).sum(axis=0).mean() / 360 / 0.25
        found = calibrated_deviations(D, counts, None, errors, 50)[..., 10]
        ratio = math.sqrt((1 + (effect - 1) / share**2) / effect) * np.std(np.clip(51 / 2 - np.arange(51), 0, 1)) / 0.5
        assert effect > 1.5
        np.testing.assert_allclose(found, ratio * plain, rtol=1e-6)


@pytest.mark.parametrize(("share", "known"), [(0.101, True), (0.099, False)])
def test_errors_that_are_nearly_all_noise_of_the_median_say_nothing(share: float, known: bool) -> None:
    D, counts, errors = sums(20.0)  # all truths lie inside the smallest ball
    number, logs, squares = np.moveaxis(errors, -1, 0)
    mean, total = logs.sum(axis=0) / number.sum(axis=0), number.sum(axis=0)
    size = np.exp(2 * mean + 1.5 * (squares.sum(axis=0) / total - mean**2)).mean()
    n = math.pi / 2 / 1.3489795**2 / ((1 - share) * size)
    assert np.isfinite(calibrated_deviations(D, counts, None, errors, n)).all() == known
    null = sign_flips(D, counts, Deviation(over="median"), errors=errors, n=n)
    assert null.p == 2 / 2**7
    assert [math.isnan(number) for number in (null.mean, null.high, null.band)] == [not known] * 3


@pytest.mark.parametrize("spread", [0.3, 1.0, 4.0])
def test_their_sum_is_0_at_every_level(spread: float) -> None:
    D, counts, errors = sums(spread)
    np.testing.assert_allclose(calibrated_deviations(D, counts, None, errors).sum(axis=0), 0, atol=1e-9)


def test_of_poses_all_joints_together_say_how_much_frames_depend_on_each_other() -> None:
    D, counts, errors = sums(0.02)
    one = calibrated_deviations(D[:, :1], counts[:, :1], None, errors)
    number, logs, squares = np.moveaxis(errors, -1, 0)
    mean, total = logs.sum(axis=0) / number.sum(axis=0), number.sum(axis=0)
    each = (logs - number * mean) / np.sqrt(squares.sum(axis=0) / total - mean**2)
    design_effect = (each**2).sum(axis=0).mean() / total.mean()
    expected = design_effect * 210 / (1 - 1 / 7) * LEVELS * (1 - LEVELS)
    np.testing.assert_allclose((one[:, 0] ** 2).sum(axis=0), expected, rtol=1e-9)
    np.testing.assert_allclose(one[:, 0, 5] / one[0, 0, 5], each.sum(axis=1) / each[0].sum(), rtol=1e-9)


def test_errors_that_never_differ_say_nothing() -> None:
    D, counts, errors = sums(0.02)
    errors[..., 1] = 2 * errors[..., 0]
    errors[..., 2] = 4 * errors[..., 0]
    expected = calibrated_deviations(D, counts)
    np.testing.assert_array_equal(calibrated_deviations(D, counts, None, errors), expected)
    np.testing.assert_array_equal(
        calibrated_deviations(D[:, :1], counts[:, :1], None, errors), calibrated_deviations(D[:, :1], counts[:, :1])
    )


@pytest.mark.parametrize("spread", [0.1, 0.5, 2.0, 10.0])
def test_the_same_sequences_show_nearly_the_same_whatever_the_spread(spread: float) -> None:
    ranks, found = Ranks(sequences=20, frames=50, joints=4, correlation=0.9), []
    for factor in (1.0, spread):
        inside, errors = ranks.sums(np.random.default_rng(5), factor)
        counts = np.full((20, 4), 50)
        found.append(sign_flips(inside - 50 * LEVELS, counts, Deviation(over="median"), errors=errors, n=50))
    assert found[1].p <= 1 / 2000
    assert found[0].p > 0.001
    for number in ("mean", "high"):
        assert 1 / 1.7 < getattr(found[1], number) / getattr(found[0], number) < 1.7


@pytest.mark.parametrize("n", [2, 5, 10])
def test_few_hypotheses_that_hold_no_truth_are_compared_with_the_same(n: int) -> None:
    """Where all truths lie outside, W differ from level to level and not from pose to pose."""
    ranks, found = Ranks(sequences=20, frames=50, joints=4, hypotheses=n), []
    for factor in (1.0, 0.02):
        inside, errors = ranks.sums(np.random.default_rng(5), factor)
        deviations = inside - 50 * LEVELS
        found.append(sign_flips(deviations, np.full((20, 4), 50), Deviation(over="median"), errors=errors, n=n))
    assert 1 / 1.7 < found[1].mean / found[0].mean < 1.7


@pytest.mark.parametrize("over", OVER)
@pytest.mark.parametrize("offset", [None, 0.02 * np.sin(np.arange(Q))], ids=["unbiased", "biased definition"])
def test_what_a_calibrated_sampler_shows_is_over_flips_of_its_deviations(over: str, offset: Array | None) -> None:
    D, counts = some(3)
    calibrated = calibrated_deviations(D, counts, offset)
    plus = 0 if offset is None else offset
    signs = [signs for signs in itertools.product((1, -1), repeat=7) if signs[-1] > 0]  # one of each two opposites
    means = [flipped(calibrated, counts, pattern, plus) for pattern in signs]
    errors, sup = ([of(mean, over) for mean in means] for of in (statistic, furthest))
    found = sign_flips(D, counts, Deviation(over=over), offset=offset)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.mean, np.mean(errors), rtol=1e-5)
    np.testing.assert_allclose(found.band, np.quantile(sup, 0.95), rtol=1e-5)
    of_high = max if found.p >= 0.05 else min
    np.testing.assert_allclose(found.high, of_high(np.quantile(errors, 0.95), found.observed), rtol=1e-5)


@pytest.mark.parametrize("seed", range(30))
def test_the_quantile_of_a_calibrated_sampler_never_contradicts_the_p_value(seed: int) -> None:
    D, counts = some(seed, S=8, J=1)
    found = sign_flips(D, counts, Deviation())
    assert (found.observed <= found.high) == (found.p >= 0.05) or found.observed == found.high
