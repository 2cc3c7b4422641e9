"""Where does the truth fall among its hypotheses, by three definitions, also where distances tie?"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import get_args

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.calibration import DEFINITIONS, LEVELS, Definition, calibration_curve
from posecal.calibration.ranks import coincide, inside, known_definition, nearness, rank_weights
from posecal.engine.block import Block
from posecal.errors import PoseDataError
from tests.helpers import calibration_oracles, oracles
from tests.helpers.random_worlds import skewed

Array = npt.NDArray[np.floating]


def everywhere(y: Array) -> npt.NDArray[np.bool_]:
    return np.ones(y.shape[:2], dtype=bool)


@pytest.mark.parametrize("D", [1, 2, 3])
@pytest.mark.parametrize("N", [2, 3, 4, 5, 20, 21, 40])
@pytest.mark.parametrize("definition", DEFINITIONS)
def test_weights_are_those_of_the_definition(definition: Definition, N: int, D: int) -> None:
    x, y = skewed(N + D, N, 13, 4, D)
    expected = calibration_oracles.inside(x, y, everywhere(y), definition)
    np.testing.assert_allclose(inside(Block(x, y), definition), expected, atol=1e-12)


@pytest.mark.parametrize("definition", DEFINITIONS)
@pytest.mark.parametrize("N", [255, 256, 511, 700])
def test_counts_are_right_beyond_a_byte(definition: Definition, N: int) -> None:
    x, y = skewed(N, N, 3, 2)
    y[0] += 5000  # outside all hypotheses
    y[1, 0] = np.median(x[:, 1, 0], axis=0)  # inside all of them
    expected = calibration_oracles.inside(x, y, everywhere(y), definition)
    np.testing.assert_allclose(inside(Block(x, y), definition), expected, atol=1e-12)


@given(
    st.integers(2, 9),
    st.integers(1, 4),
    st.integers(1, 3),
    st.integers(1, 3),
    st.integers(0, 10**6),
    st.sampled_from(DEFINITIONS),
)
def test_weights_are_those_of_the_definition_for_every_shape(
    N: int, M: int, K: int, D: int, seed: int, definition: Definition
) -> None:
    x, y = skewed(seed, N, M, K, D)
    w = np.random.default_rng(seed).random((M, K)) < 0.7
    np.testing.assert_allclose(
        inside(Block(x, y, w), definition), calibration_oracles.inside(x, y, w, definition), atol=1e-12
    )


def test_positions_are_relative_to_the_root() -> None:
    x, y = skewed(1, 7, 5, 4)
    moved, true = oracles.relative(x, 2), oracles.relative(y, 2)
    found = inside(Block(x, y, root=2))
    kept = [0, 1, 3]
    np.testing.assert_allclose(
        found[:, kept], calibration_oracles.inside(moved, true, everywhere(y), "exchangeable")[:, kept]
    )


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_joints_that_do_not_count_have_no_weight(definition: Definition) -> None:
    x, y = skewed(2, 6, 5, 4)
    w = np.random.default_rng(2).random((5, 4)) < 0.5
    np.testing.assert_array_equal(np.isnan(inside(Block(x, y, w), definition)), np.repeat(~w[..., None], 21, axis=2))


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_one_hypothesis_has_no_calibration(definition: Definition) -> None:
    x, y = skewed(3, 1, 5, 4)
    assert np.isnan(inside(Block(x, y), definition)).all()


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_weights_rise_from_nothing_to_all(definition: Definition) -> None:
    x, y = skewed(4, 9, 50, 4)
    found = inside(Block(x, y), definition)
    assert (np.diff(found, axis=-1) >= 0).all()
    assert found.min() >= 0
    assert found.max() <= 1


def test_at_the_ends_the_exchangeable_weights_are_certain() -> None:
    x, y = skewed(5, 4, 60, 5)
    found = inside(Block(x, y))
    assert not found[..., 0].any()
    np.testing.assert_array_equal(found[..., 20], 1)


def test_levels_are_twentieths_with_both_ends() -> None:
    np.testing.assert_array_equal(LEVELS, [i / 20 for i in range(21)])


# --- counted by hand -------------------------------------------------------------------------------------------------


def line(hypotheses: list[float], truth: float, definition: Definition) -> Array:
    """Weights of one joint in one dimension."""
    x = np.array(hypotheses, dtype=float).reshape(-1, 1, 1, 1)
    return inside(Block(x, np.full((1, 1, 1), float(truth))), definition)[0, 0]


def test_exchangeable_by_hand() -> None:
    """The median of 0, 1, 4, 9 and the truth 2 is 2: the truth is the centre, of rank 0 of 5: (5 q - 0) / 1."""
    np.testing.assert_allclose(line([0, 1, 4, 9], 2, "exchangeable"), np.minimum(5 * LEVELS, 1), atol=1e-12)


def test_paper_by_hand() -> None:
    """The median of 0, 1, 4, 9 is 2.5. The truth 2 is 0.5 off, they are 2.5, 1.5, 1.5 and 6.5 off: Φ = 0."""
    np.testing.assert_array_equal(line([0, 1, 4, 9], 2, "paper"), np.ones(21))
    # The truth 5 is 2.5 off: three of four are no farther, Φ = 3/4 = LEVELS[15].
    np.testing.assert_array_equal(line([0, 1, 4, 9], 5, "paper"), LEVELS >= 0.75)


def test_reference_by_hand() -> None:
    """The lower middle value of 0, 1, 4, 9 is 1; they are 1, 0, 3 and 8 off.

    The truth 3 is 2 off. The quantile at q lies at place 3 q of 0, 1, 3, 8; it exceeds 2 from place 1.5, q = 1/2, on,
    and at q = 1/2 it is 2, which is not strictly larger.
    """
    np.testing.assert_array_equal(line([0, 1, 4, 9], 3, "reference"), LEVELS > 0.5)


def test_a_truth_outside_all_hypotheses_is_in_no_ball() -> None:
    assert not line([0, 1, 4, 9], 500, "reference").any()
    np.testing.assert_array_equal(line([0, 1, 4, 9], 500, "paper"), LEVELS == 1)
    np.testing.assert_allclose(line([0, 1, 4, 9], 500, "exchangeable"), np.maximum(5 * LEVELS - 4, 0), atol=1e-12)


@pytest.mark.parametrize("less", range(4))
def test_a_truth_that_ties_with_none_takes_one_share_of_the_pool(less: int) -> None:
    """Of three hypotheses some come before the truth, which is one of four: 4 q - less, from nothing to all."""
    np.testing.assert_allclose(rank_weights(3, less), np.clip(4 * LEVELS - less, 0, 1))


# --- ties ------------------------------------------------------------------------------------------------------------


def exact_reference(points: Array, truth: Array) -> list[float]:
    """The reference definition with the place of the quantile in fractions, so that ties stay ties."""
    c = calibration_oracles.centre(points, truth, "reference")
    distances, true = sorted(math.dist(p, c) for p in points), math.dist(truth, c)
    found = []
    for q in oracles.QUANTILES:
        place = q * (len(points) - 1)
        low, rest = int(place), place - int(place)
        high = min(low + 1, len(points) - 1)
        found.append(float(distances[low] + (distances[high] - distances[low]) * float(rest) > true))
    return found


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("D", [1, 2, 3])
@pytest.mark.parametrize("N", [2, 3, 4, 7, 20, 21])
def test_points_on_a_lattice_tie_exactly(N: int, D: int, dtype: str) -> None:
    random = np.random.default_rng([N, D])
    x = random.integers(-2, 3, (N, 60, 2, D)).astype(dtype)
    y = random.integers(-2, 3, (60, 2, D)).astype(dtype)
    block, w = Block(x, y), everywhere(y)
    for definition in ("exchangeable", "paper"):
        expected = calibration_oracles.inside(x.astype("f8"), y.astype("f8"), w, definition)
        np.testing.assert_allclose(inside(block, definition), expected, atol=1e-12, err_msg=definition)  # type: ignore[arg-type]
    expected = [[exact_reference(x[:, m, k], y[m, k]) for k in range(2)] for m in range(60)]
    np.testing.assert_array_equal(inside(block, "reference"), expected)


@pytest.mark.parametrize("N", [2, 3, 10, 11])
def test_a_truth_on_all_its_hypotheses_has_no_rank(N: int) -> None:
    y = np.random.default_rng(0).normal(0, 300, (4, 2, 3))
    x = np.repeat(y[None], N, axis=0)
    x[0, 3, 1, 2] += 0.01
    x[:, 2, 0] += 0.01  # hypotheses that agree on another place
    coincides = np.array([[True, True], [True, True], [False, True], [True, False]])
    np.testing.assert_array_equal(coincide(Block(x, y)), coincides)
    np.testing.assert_array_equal(np.isnan(inside(Block(x, y))[..., 0]), coincides)


@pytest.mark.parametrize("N", [2, 3, 10])
def test_a_truth_beside_hypotheses_that_agree_is_outside(N: int) -> None:
    y = np.random.default_rng(0).normal(0, 300, (4, 2, 3))
    x = np.repeat(y[None] + 0.1, N, axis=0)
    np.testing.assert_allclose(
        inside(Block(x, y)), np.broadcast_to(np.maximum((N + 1) * LEVELS - N, 0), (4, 2, 21)), atol=1e-12
    )


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("D", [1, 2, 3])
@pytest.mark.parametrize("N", [3, 5, 21])
def test_a_truth_and_a_hypothesis_about_the_pooled_median_tie_whatever_the_rounding(N: int, D: int, dtype: str) -> None:
    """For odd N the median of the N + 1 pooled points lies between two: here, on every axis, the same two.

    The truth is then as far from the centre as one hypothesis and nearer than all others, whose coordinates lie
    beyond the two on either side. It shares the ranks 0 and 1, so its weight is (N + 1) q / 2.
    """
    random = np.random.default_rng([N, D])
    M, half = 4000, (N - 1) // 2
    y = random.normal(0, 300, (M, 1, D)).astype(dtype)
    partner = (y + random.normal(0, 50, y.shape)).astype(dtype)
    low, high = np.minimum(y, partner), np.maximum(y, partner)
    beyond = random.gamma(2, 40, (N - 1, M, 1, D)) + 2 * (high - low)
    others = np.concatenate([low - beyond[:half], high + beyond[half:]])
    x = np.concatenate([partner[None], random.permuted(others, axis=0)]).astype(dtype)
    found = inside(Block(x, y))
    np.testing.assert_allclose(found, np.broadcast_to(np.minimum((N + 1) * LEVELS / 2, 1), found.shape), atol=1e-6)


# --- what is shared --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("N", [2, 3, 6, 7])
def test_the_three_centres_are_those_of_the_definitions(N: int) -> None:
    x, y = skewed(6, N, 8, 3)
    found = nearness(Block(x, y))
    for place, definition in enumerate(DEFINITIONS):
        for m, k in np.ndindex(8, 3):
            centre = calibration_oracles.centre(x[:, m, k], y[m, k], definition)
            np.testing.assert_allclose(found.centres[m, k, place] + y[m, k], centre, atol=1e-10)
            inner = [math.dist(point, centre) <= math.dist(y[m, k], centre) * (1 + 1e-12) for point in x[:, m, k]]
            np.testing.assert_array_equal(found.within[m, k, place], inner)
            assert found.at_most[m, k, place] == sum(inner)


def test_weights_may_be_changed_without_harm_to_others() -> None:
    block = Block(*skewed(7, 6, 5, 4))
    before = {definition: inside(block, definition).copy() for definition in DEFINITIONS}
    for definition in DEFINITIONS:
        inside(block, definition)[:] = np.nan
    for definition in DEFINITIONS:
        np.testing.assert_array_equal(inside(block, definition), before[definition])


def test_the_definitions_are_those_of_the_type() -> None:
    assert get_args(Definition) == DEFINITIONS == ("exchangeable", "paper", "reference")


def test_an_unknown_definition_is_refused_with_the_nearest() -> None:
    assert known_definition("paper") == "paper"
    with pytest.raises(PoseDataError, match=r"definition: 'exchangable' is not known\. Did you mean exchangeable\?"):
        calibration_curve(*skewed(0, 3, 4, 2), definition="exchangable")  # type: ignore[arg-type]


@pytest.mark.parametrize("inner", range(0, 41, 2))
def test_phi_is_compared_with_q_in_whole_numbers(inner: int) -> None:
    """Of 40 hypotheses about 0, some are 1 off and the others 3; the truth is 2 off, and Φ is a twentieth.

    Φ in single precision would lose such ties against q in double: 0.55 becomes 0.55000001.
    """
    distances = np.where(np.arange(40) < inner, 1.0, 3.0)
    weights = line(list(distances * np.resize([1, -1], 40)), 2, "paper")
    np.testing.assert_array_equal(weights, [Fraction(inner, 40) <= q for q in oracles.QUANTILES])
