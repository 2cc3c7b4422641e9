"""The tables on likelihood hold with few replicates, within tolerances that follow from chance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.evidence.likelihood import (
    DESIGNS,
    FAR,
    UNITS,
    half_log_2_pi_e,
    nll_by_unit,
    places_rows,
    planar_models,
    right_model,
    skill_of_the_population,
    stated_rightly,
)

pytestmark = pytest.mark.slow


def test_the_printed_nll_is_that_of_millimetres_whatever_the_unit() -> None:
    rows = nll_by_unit(4)
    right = 12 * (math.log(40) + half_log_2_pi_e())
    (printed,) = {row[2] for row in rows}
    assert [row[0] for row in rows] == [*UNITS]
    assert float(printed.split()[0]) == pytest.approx(right, abs=4.5 * math.sqrt(12 / 2 / (4 * 400)))
    assert float(rows[0][1].split()[0]) - float(rows[2][1].split()[0]) == pytest.approx(12 * math.log(1000), abs=0.002)


def test_the_right_skill_of_a_model_without_an_image_lies_between_the_two_baselines() -> None:
    for (sequences, _, correlation, d), skills in zip(
        DESIGNS[:4], skill_of_the_population(6, DESIGNS[:4]), strict=True
    ):
        own, others = skills.mean(axis=0)
        assert own < 0 < others
        # d + d (d + 1) / 2 parameters, each worth half a nat per independent pose
        independent = sequences * 100 * (1 - correlation) / (1 + correlation)
        expected = (d + d * (d + 1) / 2) / 2 / independent
        assert (others - own) / 2 == pytest.approx(expected, rel=0.6)


def test_a_model_that_is_narrow_across_the_plane_wins_by_nll_alone() -> None:
    right, narrow = right_model(), planar_models(0.01)
    assert narrow["nll"] < right["nll"]
    assert narrow["energy_score"] > 1.05 * right["energy_score"]
    assert narrow["ece"] > 10 * right["ece"]
    # five joints, each log(10 / 0.01) by its width across the plane
    assert planar_models(10.0)["nll"] - narrow["nll"] == pytest.approx(5 * math.log(1000), abs=0.1)
    for report in (right, narrow):
        assert any("don't vary in 5 of 15 directions" in remark for remark in report.remarks)


def test_constraints_are_said_where_there_are_some_wherever_the_poses_are() -> None:
    for *_, now, right in places_rows(1):
        assert now == right


@pytest.mark.parametrize("kind", ["Gaussian", "mixture of 2", FAR])
def test_distributions_that_are_stated_rightly_are_calibrated_and_have_the_exact_nll(kind: str) -> None:
    found = np.array([stated_rightly(50, seed, kind) for seed in range(4)])
    assert np.abs(found[:, 0]).max() < 1e-9
    assert found[:, 1].mean() < 0.02
    # shares of 4 · 1000 poses, of five joints that share a component at most
    assert found[:, 2].mean() == pytest.approx(0.9, abs=4.5 * math.sqrt(0.09 / 4000))
