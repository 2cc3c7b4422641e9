"""Learning rates: their formulas, plateaus, and states that come back."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from posecal_models.config import Config
from posecal_models.schedule import Schedule


def schedule(kind: str, steps: int = 1000, **settings) -> Schedule:
    return Schedule(Config.from_table({"train": {"schedule": kind, **settings}}).train, steps)


def at(kind: str, step: int, steps: int = 1000) -> Schedule:
    """A schedule that goes on from a step."""
    resumed = schedule(kind, steps)
    resumed.load_state_dict({}, step)
    return resumed


def test_the_learning_rate_falls_on_a_plateau_and_the_training_stops_at_the_third():
    falling = schedule("plateau", patience=2)
    rates = []
    for loss in (5.0, 4.0, *[4.0] * 9):
        assert not falling.finished
        falling.after_step()  # changes nothing
        falling.after_epoch(loss)
        rates.append(round(math.log10(falling.learning_rate)))
    assert rates == [-3, -3, -3, -3, -4, -4, -4, -5, -5, -5, -6]
    assert falling.finished


@pytest.mark.parametrize(
    ("kind", "step", "rate"),
    [
        ("exponential", 250_000, 1e-3 * 0.96**2),
        ("continuous", 250_000, 1e-3 * 0.96**2.5),
        ("cosine", 500, 5e-4),
        ("cosine", 0, 1e-3),
        ("halved", 967, 1e-3),  # for the last 5 of 155 parts: from 967.7 on
        ("halved", 968, 5e-4),
    ],
)
def test_the_other_schedules_follow_their_formulas(kind, step, rate):
    np.testing.assert_allclose(at(kind, step).learning_rate, rate, rtol=1e-12)


@pytest.mark.parametrize("kind", ["plateau", "exponential", "continuous", "cosine", "halved"])
@pytest.mark.parametrize("stop", [0, 3, 7])
def test_a_state_comes_back_from_plain_values(kind, stop):
    whole, parts = (schedule(kind, 10, patience=0) for _ in range(2))
    rates = []
    for step, loss in enumerate((5.0, 6.0, 4.0, 4.5, 3.0, 2.0, 2.0, 1.0, 1.5, 1.5)):
        if step == stop:
            state = json.loads(json.dumps(whole.state_dict()))
            parts = schedule(kind, 10, patience=0)
            parts.load_state_dict(state, step)
        for one in (whole, parts):
            one.after_step()
            one.after_epoch(loss)
        rates.append((whole.learning_rate, parts.learning_rate))
    assert {one == other for one, other in rates[stop:]} == {True}
    assert whole.finished == parts.finished


def test_a_plateau_s_state_of_another_format_is_refused():
    with pytest.raises(KeyError, match="learning_rate"):
        schedule("plateau").load_state_dict({"best": 1.0, "waited": 0, "drops": 2}, 5)
