"""Ranks of the truth among weighted hypotheses: what they are for draws of a proposal, and that they are no worse."""

from typing import Any

import numpy as np
import pytest

import posecal
from posecal.calibration.rank_tests import RANK_TESTS, weights_of_ranks
from posecal.calibration.ranks import LEVELS, inside, rank_weights
from posecal.engine.block import Block
from tests.evidence.weights import TABLES, importance_draws, mixture, p_values

Array = np.ndarray[Any, Any]


def test_ranks_take_the_effective_number() -> None:
    """Of weights ½, ¼, ¼ the effective number is 8/3, so the truth has the share 3/11 of the pool."""
    found = weights_of_ranks(np.array([[1.0, 3.0, 4.0, 2.0]]), np.array([[0.5, 0.25, 0.25]]))[0]
    np.testing.assert_allclose(found, np.clip((LEVELS - 4 / 11) / (3 / 11), 0, 1))
    np.testing.assert_allclose(rank_weights(np.array([3, 5]), np.array([1, 1]))[0], rank_weights(3, 1))


def test_a_held_out_hypothesis_takes_its_weight_with_it() -> None:
    weights = np.array([[0.6, 0.2, 0.1, 0.1]])
    found = weights_of_ranks(np.array([[1.0, 3.0, 4.0, 2.0]]), weights)
    np.testing.assert_allclose(found, weights_of_ranks(np.array([[1.0, 3.0, 4.0, 2.0]]), weights[:, 1:] / 0.4))


@pytest.mark.parametrize("N", [5, 6])
def test_weights_that_hardly_differ_give_what_equal_ones_give(N: int) -> None:
    random = np.random.default_rng(N)
    x, y = random.normal(0, 50, (N, 200, 3, 3)), random.normal(0, 50, (200, 3, 3))
    weights = 1 / N + 1e-7 * random.standard_normal((200, N))
    weights /= weights.sum(axis=1, keepdims=True)
    plain, weighted = Block(x, y), Block(x, y, weights=weights)
    np.testing.assert_allclose(inside(weighted), inside(plain), atol=1e-5)
    joints = np.ones(3, dtype=bool)
    for test in RANK_TESTS:
        np.testing.assert_allclose(
            test.weights(weighted, joints), test.weights(plain, joints), atol=1e-5, err_msg=test.name
        )


def test_a_truth_that_ties_shares_the_weight_of_those_beside_it() -> None:
    """The truth equals the hypothesis of weight ½, n = 8/3: the pool has the shares 3/11, and 4/11, 2/11, 2/11."""
    x, y = np.array([0.0, -3, 40]).reshape(3, 1, 1, 1), np.zeros((1, 1, 1))
    found = inside(Block(x, y, weights=np.array([[0.5, 0.25, 0.25]])))[0, 0]  # the median of the pool is 0
    np.testing.assert_allclose(found, np.clip(LEVELS / (7 / 11), 0, 1))


@pytest.mark.slow
def test_weighted_draws_of_a_wide_proposal_are_calibrated() -> None:
    """With 5,000 poses the mean of |ω − q| is .004 by chance; 0.2 / n is what the share of the truth leaves."""
    for N, width in ((20, 1.5), (50, 1.5), (200, 1.2)):
        x, y, w = importance_draws(N, N, 5000, width)
        options: dict[str, Any] = {"unit": "mm", "axes": "NMKD"}
        number = (1 / (w**2).sum(axis=0)).mean()
        assert posecal.ece(x, y, weights=w, **options) < 0.25 / number + 0.008
        assert posecal.ece(x, y, **options) > 0.08


@pytest.mark.slow
def test_the_error_at_components_of_a_mixture_is_at_most_the_share_of_the_truth() -> None:
    for N in (20, 50):
        x, y, w = mixture(N, N, 5000, 0.0)
        number = (1 / (w**2).sum(axis=0)).mean()
        assert posecal.ece(x, y, weights=w, unit="mm", axes="NMKD") < 1 / (number + 1)


@pytest.mark.slow
def test_the_tables_say_what_the_page_says() -> None:
    rows = {table.name: table.rows(table.replicates // 20) for table in TABLES if table.name != "weights-levels"}
    for _, number, before, now, right in rows["weights-calibration"][:9]:
        assert float(now) < 0.25 / float(number) + 0.03
        assert float(before) > 0.06
        assert right == "0"
    as_they_stand, collapsed, draws = ([row[column] for row in rows["weights-copies"]] for column in (1, 2, 3))
    assert collapsed == draws
    assert float(as_they_stand[2]) > 1.05 * float(draws[2])
    for name, before, now, perfect in rows["weights-scores"]:
        right, error = map(float, perfect.split(" ± "))
        if "× 1.2" in name:
            assert abs(float(now) - right) < 5 * error
        assert float(now) < float(before)


@pytest.mark.slow
def test_an_allowance_keeps_weighted_draws_of_a_proposal_from_being_rejected() -> None:
    before, now = p_values(8, 20, True, 1.5, 100, "ece", seed=0)
    assert (now["ece"] > before["ece"]).all()
    assert (now["ece"] >= 0.05).all()
