"""Numbers by horizon of forecasts of a Gaussian process are the exact ones, within what chance allows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

import posecal
from posecal.errors import PoseDataError
from toy.motion_world import Forecast, MotionWorld, mean_norm

WORLD = MotionWorld(joints=4, frames=6, correlation=0.8)
FORECASTS = (Forecast(), Forecast(spread=0.6), Forecast(correlation=0.93), Forecast(is_motion=False))
CLIPS, N = 300, 40
LIMIT = stats.norm.isf(1e-4)
"""Standard errors: one in ten thousand sound numbers lies farther off; 76 are compared."""


def test_one_frame_of_one_joint_is_in_closed_form() -> None:
    """Spread and error are 60 mm: E‖x − y‖ is √2 · 60 · √(8/π), E‖x − x′‖ the same."""
    world = MotionWorld(joints=1, frames=1, correlation=0.8)
    expected = math.sqrt(2) * 60 * math.sqrt(8 / math.pi) / 2
    assert world.frame_energies(Forecast()) == pytest.approx([expected])
    assert world.clip_energy(Forecast()) == pytest.approx(expected)
    assert world.coverage(Forecast(), 0.9) == pytest.approx([0.9])


def test_the_mean_norm_is_that_of_chi_and_of_a_simulation() -> None:
    assert mean_norm(4 * np.eye(2), 3) == pytest.approx(2 * stats.chi(6).mean(), rel=1e-9)
    factor = np.array([[3.0, 0.0], [2.0, 0.5]])
    drawn = np.linalg.norm(np.random.default_rng(0).standard_normal((200_000, 3, 2)) @ factor.T, axis=(1, 2))
    assert abs(drawn.mean() - mean_norm(factor @ factor.T, 3)) < LIMIT * drawn.std() / math.sqrt(len(drawn))


def test_clips_have_the_law_that_is_said() -> None:
    _, truth = WORLD.sample(20_000, np.random.default_rng(2))
    deviations = truth - WORLD.rest
    assert deviations[:, -1].std() == pytest.approx(100, rel=0.02)  # stationary, over all observed poses
    assert np.corrcoef(deviations[:, 1].ravel(), deviations[:, 3].ravel())[0, 1] == pytest.approx(0.64, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("forecast", FORECASTS, ids=str)
def test_numbers_by_horizon_are_the_exact_ones(forecast: Forecast) -> None:
    """Standard errors are a quarter of the 95 % interval over clips, which are independent."""
    random = np.random.default_rng(7)
    observed, truth = WORLD.sample(CLIPS, random)
    metrics = ["coverage_90", "energy_score", "clip_energy_score", "diversity"]
    report = posecal.evaluate(
        WORLD.predict(forecast, observed, N, random),
        truth,
        axes="NMTKD",
        unit="mm",
        root_joint="none",
        by="horizon",
        protocol=posecal.Protocol(ece_over="pooled"),
        metrics=metrics,
    )
    of_sample = math.sqrt(2 / (N - 1)) * math.exp(math.lgamma(N / 2) - math.lgamma((N - 1) / 2))  # mean of s / σ
    exact = {
        "coverage_90": WORLD.coverage(forecast, 0.9, N),
        "energy_score": WORLD.frame_energies(forecast),
        "diversity": of_sample * WORLD.deviations(forecast),
    }
    for t in range(WORLD.frames):
        for name, values in exact.items():
            low, high = report.interval(name, f"horizon={t + 1}")
            error = (high - low) / (2 * 1.96)
            assert abs(report.value(name, f"horizon={t + 1}") - values[t]) < LIMIT * error, (name, t)
    low, high = report.interval("clip_energy_score")
    assert abs(report["clip_energy_score"] - WORLD.clip_energy(forecast)) < LIMIT * (high - low) / (2 * 1.96)


def test_a_world_that_can_t_be_is_refused() -> None:
    with pytest.raises(PoseDataError, match=r"^correlation 1, 6 joints, 25 frames, σ = 100; expected a correlation"):
        MotionWorld(correlation=1.0)
