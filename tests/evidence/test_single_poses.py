"""The tables on the uncertainty of single poses, with few replicates and computed tolerances."""

from __future__ import annotations

import math

import numpy as np
import pytest

from posecal.metrics import aurc, excess_aurc, failure_auroc
from tests.evidence.single_poses import (
    POSES,
    THRESHOLD,
    WORLDS,
    aurc_in_closed_form,
    auroc_in_closed_form,
    brier_scores,
    errors_of_known_failures,
    order_rows,
    shard_rows,
)


@pytest.mark.parametrize("kind", ["s", "s²", "½"])
def test_failures_of_a_known_chance_have_the_auroc_and_the_aurc_of_the_closed_form(kind: str) -> None:
    spread, error = errors_of_known_failures(np.random.default_rng(7), kind)
    failing = int((error > THRESHOLD).sum())
    # The standard error of an AUROC A is at most √(A (1 − A) / min(n, m)), by Birnbaum and Klose.
    A = auroc_in_closed_form(kind)
    tolerance = 4 * math.sqrt(A * (1 - A) / min(failing, POSES - failing))
    assert abs(failure_auroc(spread, error, THRESHOLD) - A) < tolerance
    # AURC is a mean of means of errors within 150 mm; the weight of a pose is up to (1 + log of the poses) / M.
    area = aurc_in_closed_form(kind)
    deviation = 150 * math.sqrt(0.25 * 2 / POSES)  # ∫ (−log c)² dc = 2
    assert abs(aurc(spread, error) - area) < 4 * deviation


def test_orders_of_uniform_errors_have_their_closed_forms() -> None:
    for name, found, right, excess, _ in order_rows(1):
        assert abs(float(found.split()[0]) - float(right.split()[0])) < 0.02, name
        assert abs(float(excess.split()[0]) - (float(right.split()[0]) - 25)) < 0.02, name


def test_a_perfect_order_has_no_excess() -> None:
    error = np.random.default_rng(1).gamma(2, 30, 500)
    assert excess_aurc(error**2, error) == 0


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("N", [5, 20])
def test_the_brier_score_is_that_of_fresh_hypotheses(world: str, N: int) -> None:
    before, now, right = brier_scores(world, N, 2000)
    difference = now - right
    assert abs(difference.mean()) < 4 * difference.std() / math.sqrt(2000) + 0.005
    if N == 5:
        assert abs((before - right).mean()) > 0.015  # as it was


def test_of_two_hypotheses_there_is_no_brier_score() -> None:
    assert np.isnan(brier_scores("calibrated", 2, 10)[1]).all()


@pytest.mark.slow
def test_shards_have_the_numbers_of_one_run_or_none() -> None:
    rows = {name: rest for name, *rest in shard_rows(1)}
    for one, _, apart, prepared in (rows["ece"], rows["aurc"]):
        assert one == apart == prepared
    for one, summed, apart, prepared in (rows["tarp_box"], rows["energy_skill"]):
        assert (prepared, apart) == (one, "absent")
        assert summed != one
