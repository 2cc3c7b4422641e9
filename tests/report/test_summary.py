"""What a report says in words, for samplers of which it is known."""

from __future__ import annotations

import numpy as np
import pytest

from posecal.report.report import Report
from posecal.report.summary import summarize
from tests.helpers.samplers import gaussian, pairs_of, report_of, sequences

Array = np.ndarray
M, K, N = 240, 4, 19
JOINTS = ("Head", "LWrist", "RKnee", "LFoot")


def report(x: Array, y: Array, metrics: str = "default", S: int = 40) -> Report:
    return report_of(pairs_of(x, y, joints=JOINTS, labels={"sequence": sequences(len(y), S)}), metrics)


def said(*, spread: float | list[float] = 1.0, metrics: str = "default", S: int = 40, seed: int = 0) -> list[str]:
    return summarize(report(*gaussian(seed, N, M, K, spread=spread), metrics, S))


def test_a_perfect_sampler_is_not_miscalibrated_beyond_chance() -> None:
    first, *rest = said()
    assert first.startswith("Not miscalibrated beyond chance: ECE 0.0")
    assert "a calibrated sampler would show up to 0.0" in first
    assert "on these 40 sequences (p = " in first
    assert rest == []


@pytest.mark.parametrize(("spread", "word"), [(0.6, "Overconfident"), (1.7, "Underconfident")])
def test_a_wrong_spread_is_named_with_its_joints_and_what_a_user_would_see(spread: float, word: str) -> None:
    first, second = said(spread=spread)
    assert first.startswith(f"{word}, beyond chance: ECE 0.")
    assert "(p < 0.001); the 90\u00a0% balls hold" in first
    share = int(first.partition("balls hold ")[2].partition("\u00a0")[0])
    assert (share < 80) if spread < 1 else (share > 95)
    assert second.startswith(f"Joint by joint: {word.lower()} at ")
    assert all(joint in second for joint in JOINTS)
    assert second.endswith("(adjusted for 4 joints).")


def test_joints_that_cancel_are_named_and_the_median_is_said_to_hide_them() -> None:
    sentences = said(spread=[0.5, 1.0, 1.0, 2.0])
    assert sentences[0].startswith("Not miscalibrated beyond chance")
    assert sentences[1] == "Joint by joint: overconfident at Head, underconfident at LFoot (adjusted for 4 joints)."
    assert sentences[2].startswith("The median over joints hides it: the joints' own errors average 0.")


def test_what_only_the_battery_sees_is_said_with_its_meaning() -> None:
    random = np.random.default_rng(1)
    common = random.normal(0, 40, (M, 1, 3))
    y = np.sqrt(0.9) * common + np.sqrt(0.1) * random.normal(0, 40, (M, K, 3))  # joints move together
    x = random.normal(0, 40, (N, M, K, 3))  # the model's do not
    first, *_, last = summarize(report(x, y, "default, battery"))
    assert first.startswith("Not miscalibrated beyond chance")
    assert last.startswith("What the ECE does not see, the battery does (")
    assert "pair distance" in last
    assert "joints move together less or more than they should" in last


def test_where_the_spread_is_wrong_the_battery_is_for_later() -> None:
    assert said(spread=0.5, metrics="default, battery")[-1].endswith("Mend the spread first, and look again.")


def test_a_battery_that_finds_nothing_points_to_a_score() -> None:
    assert said(metrics="default, battery", seed=3)[-1] == (
        "The battery finds nothing more. A model that ignores the image would pass it too: look at a score."
    )


def test_too_few_sequences_are_not_judged() -> None:
    (first,) = said(spread=0.6, S=5)
    assert first.startswith("Looks overconfident (signed area -0.")
    assert first.endswith("whether by chance can't be tested here.")


def test_without_calibration_there_is_nothing_to_say() -> None:
    assert said(metrics="mpjpe") == []
    assert summarize(report(*gaussian(2, 1, 24, K))) == []


def test_no_calibration_error_has_an_interval() -> None:
    found = report(*gaussian(4, N, 60, K), "all", S=12)
    tested = {row.metric for row in found.rows if row.metric.endswith("_p")}
    for row in found.rows:
        if f"{row.metric}_p" in tested or row.metric.startswith("ece"):
            assert np.isnan([row.low, row.high]).all()
    assert "±" not in found.render("text")
