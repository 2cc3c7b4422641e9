"""Rank tests, scores, skills, metrics of the user's own and explanations at the command line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import posecal
from posecal.registry import registered_metrics
from tests.helpers.shell import done, refused, rows

EVALUATE = ("evaluate", "right.npz", "true.npz")

OWN = """
import numpy as np
import posecal

def height(pool):
    return pool[..., 2].max(axis=1)

broken = lambda pool: 1 / 0

def depth_error(hypotheses, truth):
    "Mean absolute error along the third axis."
    return np.abs(hypotheses - truth)[..., 2].mean(axis=(0, 2))

def median_of_joint(hypotheses, truth):
    return np.linalg.norm(np.median(hypotheses, axis=0) - truth, axis=-1)

by_joint = posecal.Metric.from_function(median_of_joint, name="median_joint", by_joint=True)

squares = posecal.engine.metric.Statistic("squares", lambda block: (block.offsets**2).mean(axis=(1, 2, 3)))
rms = posecal.Metric(
    name="rms", label="RMS", unit="mm", direction="lower", family="accuracy", brief="root mean square",
    definition="root of the mean squared coordinate error", statistic=squares, finish=np.sqrt, headline=True,
)
wrong = lambda hypotheses, truth: 1 / 0
number = 3
"""


@pytest.fixture(autouse=True)
def _own() -> Iterator[None]:
    """A file with the user's own code; nothing stays registered."""
    Path("own.py").write_text(OWN)
    yield
    for metric in registered_metrics():
        posecal.unregister(metric.name)


def forget(name: str) -> None:
    """As in the next process."""
    posecal.unregister(name)


def numbers(*words: str) -> dict[str, dict[str, Any]]:
    of_all = json.loads(done("evaluate", *words, "--format=json"))["rows"]
    return {row["metric"]: row for row in of_all if row["group"] is None and row["joint"] is None}


# --- rank tests, scores, skills -------------------------------------------------------------------------------


def test_the_rank_tests_have_p_values_adjusted_together_and_say_what_is_rejected() -> None:
    text = " ".join(done("evaluate", "narrow.npz", "true.npz", "--rank-tests", "--plot=tests.svg").split())
    assert "Rank tests reject as well: " in text
    assert "Mahalanobis" in text
    assert numbers("narrow.npz", "true.npz", "--rank-tests")["mahalanobis_p"]["value"] < 0.05


def test_a_prerank_of_one_s_own_joins_the_rank_tests() -> None:
    assert {"height", "height_p", "tarp"} <= set(numbers(*EVALUATE[1:], "--prerank=own.py:height"))


def test_a_prerank_that_fails_is_refused() -> None:
    said = refused(*EVALUATE, "--prerank=own.py:broken")
    assert "prerank: it fails on a pool of 10 poses (ZeroDivisionError" in said
    assert "has no function 'other'" in refused(*EVALUATE, "--prerank=own.py:other")


def test_a_skill_is_against_climatology_or_another_model() -> None:
    against_others = numbers(*EVALUATE[1:], "--skill=climatology")["energy_skill"]
    assert 0.5 < against_others["value"] < 1
    against_itself = numbers(*EVALUATE[1:], "--skill=right.npz")["energy_skill"]
    assert against_itself["value"] == 0
    assert against_itself["low"] == against_itself["high"] == 0


def test_scores_and_rank_tests_are_there_where_they_are_asked_for() -> None:
    default = numbers(*EVALUATE[1:])
    assert "energy_score" not in default
    assert "tarp" not in default
    assert "energy_score" in numbers(*EVALUATE[1:], "--scores")


def test_motion_and_errors_in_the_world_are_rows_where_they_are_asked_for() -> None:
    asked = "acceleration_error,jitter,true_jitter,wa_mpjpe,w_mpjpe,pve"
    said = refused(*EVALUATE, f"--metrics={asked}", "--root-joint=0")
    assert "wa_mpjpe needs positions in the world, not relative to a root; expected --root-joint none." in said
    found = numbers(*EVALUATE[1:], f"--metrics={asked}", "--root-joint=none", "--set=segment=5")
    assert set(found) == {*asked.split(",")}
    report = posecal.evaluate(
        "right.npz", "true.npz", root_joint="none", protocol=posecal.Protocol(segment="5", metrics=asked)
    )
    assert {name: row["value"] for name, row in found.items()} == report.scalars()
    assert found["wa_mpjpe"]["value"] < found["w_mpjpe"]["value"]
    assert "segment: 'all'; expected a number of frames from 2, or sequence" in refused(
        *EVALUATE, "--set=segment=all", code=2
    )


# --- metrics of one's own -------------------------------------------------------------------------------------


def test_a_function_joins_the_report() -> None:
    text = done(*EVALUATE, "--metric=own.py:depth_error", "--all")
    assert "depth error " in text
    assert "Mean absolute error along the third axis." in text
    forget("depth_error")
    both = done(
        *EVALUATE, "--metric=own.py:depth_error", "--metric", "own.py:by_joint", "--format=json", "--by=sequence"
    )
    values = rows(both)
    assert values["depth_error", None, None] is not None
    assert values["depth_error", "sequence=s000", None] is not None
    assert values["median_joint", None, "Head"] is not None
    assert posecal.evaluate("right.npz", "true.npz")["depth_error"] == values["depth_error", None, None]


def test_only_the_metric_of_one_s_own_may_be_asked_for() -> None:
    assert set(numbers(*EVALUATE[1:], "--metric=own.py:by_joint", "--metrics=median_joint")) == {"median_joint"}


def test_a_saved_mean_is_reported_without_its_function() -> None:
    words = ("--format=json", "--by=sequence")
    one = done(*EVALUATE, "--metric=own.py:depth_error", "--save=s.npz", *words)
    forget("depth_error")
    assert rows(done("report", "s.npz", *words)) == rows(one)


def test_a_saved_metric_that_is_no_mean_is_reported_with_its_file() -> None:
    one = done(*EVALUATE, "--metric=own.py:rms", "--save=s.npz")
    forget("rms")
    said = refused("report", "s.npz")
    assert said == ("posecal: metric: the functions of rms are not available here; expected it to be registered.")
    assert done("report", "s.npz", "--metric=own.py:rms") == one


def test_models_are_compared_by_a_metric_of_one_s_own() -> None:
    words = ("compare", "right.npz", "narrow.npz", "true.npz", "--metric=own.py:depth_error", "--format=json")
    differences = {row["metric"]: row for row in json.loads(done(*words))["differences"]}
    assert differences["depth_error"]["better"] == "narrow"
    assert "min_mpjpe" in differences


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("own.py:nothing", "metric: own.py has no function 'nothing'; expected"),
        (
            "own.py:number",
            "metric: 'number' in own.py is of type int; expected a function that takes poses or a Metric.",
        ),
        ("own.py", "metric: 'own.py'; expected FILE.py:NAME."),
        ("none.py:x", "metric: none.py can't be read (No such file or directory)."),
        ("own.py:wrong", "metric: wrong fails on hypotheses (9, "),
        ("own.py:height", "metric: height fails on hypotheses (9, "),
    ],
)
def test_a_metric_that_can_not_be_had_is_refused(entry: str, words: str) -> None:
    assert refused(*EVALUATE, "--metric", entry).startswith(f"posecal: {words}")


def test_a_metric_under_a_known_name_is_refused() -> None:
    Path("known.py").write_text("def mpjpe(hypotheses, truth):\n    return truth[:, 0, 0]\n")
    assert "metric: mpjpe is one of posecal's own names; expected another." in refused(
        *EVALUATE, "--metric=known.py:mpjpe"
    )
    twice = ("--metric=own.py:depth_error", "--metric=own.py:depth_error")
    assert "metric: depth_error is registered already; " in refused(*EVALUATE, *twice)


def test_the_file_of_a_metric_is_not_overwritten() -> None:
    assert "own.py is read already" in refused(*EVALUATE, "--metric=own.py:rms", "--save=own.py", code=2)


@pytest.mark.parametrize("name", ["depth_error", "registered"])
def test_a_file_that_registers_its_metrics_itself_is_accepted(name: str) -> None:
    Path("own.py").write_text(
        f"{OWN}\nregistered = posecal.register(posecal.Metric.from_function(depth_error, label='Depth'))\n"
        "posecal.register(by_joint)\n"
    )
    text = done(*EVALUATE, f"--metric=own.py:{name}", "--metric=own.py:by_joint")
    assert "Depth " in text
    assert [metric.name for metric in registered_metrics()] == ["depth_error", "median_joint"]


def test_two_files_with_metrics_of_one_name_are_refused() -> None:
    Path("other.py").write_text(OWN)
    said = refused(*EVALUATE, "--metric=own.py:depth_error", "--metric=other.py:depth_error")
    assert "depth_error is registered already" in said


def test_a_function_with_a_value_per_joint_is_refused_with_what_to_pass_instead() -> None:
    said = refused(*EVALUATE, "--metric=own.py:median_of_joint")
    assert said.endswith(", or a Metric made with by_joint=True.")


# --- explanations ---------------------------------------------------------------------------------------------


def test_a_metric_is_explained() -> None:
    text = done("--explain", "ece")
    for part in ("definition", "range", "direction", "how to read", "source"):
        assert part in text


def test_an_unknown_metric_is_refused_with_the_nearest() -> None:
    assert "Did you mean ece" in refused("--explain", "ecee", code=2)
