"""Each number of a report that is NaN has its reason in its own row, and what is shown has it in a remark as well."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.calibration.error import SINCE
from posecal.report.report import Report

M, K = 24, 3
OF_SIX = "a test needs 6 sequences that count"
OF_POINTS = "no pose has several hypotheses"


def report(n: int = 8, m: int = M, sequences: int = 8, k: int = K, **options: Any) -> Report:
    random = np.random.default_rng(1)
    y = random.normal(0, 300, (m, k, 3))
    x = options.pop("x", None)
    x = y + random.normal(0, 40, (n, m, k, 3)) + random.normal(0, 40, (m, k, 3)) if x is None else x(y)
    labels = {"sequence": np.arange(m) * sequences // m, **options.pop("labels", {})}
    options = {"unit": "mm", "axes": "NMKD", "metrics": "all", "root_joint": "none", "threads": 1, **options}
    return posecal.evaluate(x, y, labels=labels, **options)


def with_one_hypothesis(y: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    x = np.full((4, *y.shape), np.nan)
    x[0] = y + 30
    return x


def clips_apart(n: int) -> Report:
    """Six clips of four frames, each after a pose that is 5 m from any other's."""
    random = np.random.default_rng(2)
    y = random.normal(0, 300, (6, 4, K, 3))
    observed = np.full((6, K, 3), 5000.0) * np.arange(6)[:, None, None]
    x = y + random.normal(0, 40, (n, *y.shape))
    return posecal.evaluate(x, y, unit="mm", axes="NMTKD", observed=observed, metrics="all", root_joint="none")


REPORTS: dict[str, tuple[Any, dict[str, str]]] = {
    "one hypothesis": (lambda: report(1), {}),
    "two hypotheses": (lambda: report(2), {"coverage_80": "no ball of N=2 hypotheses holds this share of them"}),
    "one pose": (
        lambda: report(m=1, sequences=1),
        {
            "mpjve": "no 2 frames follow one another in a sequence",
            "jitter": "no 4 frames follow one another in a sequence",
            "ece_p": OF_SIX,
            "effective_poses": "fewer than two sequences have poses that count",
            "spread_error_correlation": "all poses that count have one spread, or one error",
            "failure_auroc": "no pose fails, or every pose does",
        },
    ),
    "one pose and hypothesis": (
        lambda: report(1, m=1, sequences=1),
        {"acceleration_error": "no 3 frames follow one another in a sequence"},
    ),
    "one sequence": (
        lambda: report(sequences=1),
        {"tarp_box_p": "the true poses of the other sequences have no range; expected several", "tarp_p": OF_SIX},
    ),
    "five sequences": (lambda: report(sequences=5), {"ece_null": OF_SIX, "mahalanobis_p_adjusted": OF_SIX}),
    "one joint": (lambda: report(k=1), {"variogram_score": "it needs several joints; there is one"}),
    "copies": (
        lambda: report(x=lambda y: np.repeat(y[None] + 30, 8, axis=0)),
        {"ece_p": "the hypotheses of each pose are all the same"},
    ),
    "equal truth": (
        lambda: report(x=lambda y: np.repeat(y[None], 8, axis=0)),
        {
            "ece": "all hypotheses equal the truth at every joint that counts",
            "tarp_null": "all hypotheses equal the truth at every joint that counts",
            "ause": "the errors are all 0",
        },
    ),
    "all but one absent": (lambda: report(x=with_one_hypothesis), {"ece": OF_POINTS, "crps": OF_POINTS}),
    "weights": (
        lambda: report(weights=np.random.default_rng(3).dirichlet(np.ones(8), M).T),
        {"ece_p": "weights leave an effective N below 20"},
    ),
    "log densities": (
        lambda: report(sequences=1, log_prob=np.full(M, -50.0)),
        {"log_likelihood_skill": "climatology gives the true poses no density (a remark says why)"},
    ),
    "much too wide": (
        lambda: report(m=96, x=lambda y: y + 30 + np.random.default_rng(4).normal(0, 3000, (8, *y.shape))),
        {"ece_null": "nothing tells how much frames resemble each other"},
    ),
    "clips": (lambda: clips_apart(1), {}),
    "clips of several hypotheses": (
        lambda: clips_apart(3),
        {"apde": "every clip is alone in its set of truths, or lacks frames or joints"},
    ),
}


@pytest.mark.parametrize("what", REPORTS)
def test_each_row_that_is_nan_and_no_other_has_a_reason(what: str) -> None:
    make, reasons = REPORTS[what]
    found = make()
    absent = [row for row in found.rows if math.isnan(row.value)]
    assert {row.metric: row.definition.count(SINCE) for row in absent} == {row.metric: 1 for row in absent}
    assert not [row.metric for row in found.rows if SINCE in row.definition and not math.isnan(row.value)]
    assert {name: found.definition(name).partition(SINCE)[2] for name in reasons} == reasons
    said = " ".join(found.remarks)
    shown = [name for name in found.headline_metrics if math.isnan(found[name]) and not name.startswith("coverage")]
    few = len(shown) > 6
    assert all(name in said or few for name in shown), said
    assert ("no value, because" in said or "no calibration can be measured" in said) == bool(shown)


def test_groups_say_why_as_well() -> None:
    where, occluded = np.ones((M, K), dtype=bool), np.zeros((M, K), dtype=bool)
    where[::2] = False
    labels = {"action": np.array(["a", "b"])[np.arange(M) % 2]}
    found = report(where=where, occluded=occluded, labels=labels, by=["action", "occlusion"])
    assert found.definition("mpjpe", "action=a").endswith(
        f"{SINCE}no pose of the group has the joints or frames that it needs"
    )
    assert found.definition("ece", "occlusion=occluded").endswith(f"{SINCE}no joint that counts is occluded")
    assert SINCE not in found.definition("mpjpe", "action=b")
    assert all((SINCE in row.definition) == math.isnan(row.value) for row in found.rows)


def test_a_reason_stands_once_in_the_remarks() -> None:
    said = report(sequences=1).remarks
    assert sum("tarp_box" in remark for remark in said) == 1
    assert not any("log_likelihood_skill" in remark for remark in said)
    of_density = report(sequences=1, log_prob=np.full(M, -50.0)).remarks
    assert sum("log_likelihood_skill" in remark for remark in of_density) == 1


@pytest.mark.parametrize(("sequences", "said"), [(1, True), (2, True), (3, False)])
def test_a_remark_says_where_intervals_are_missing(sequences: int, said: bool) -> None:
    found = report(sequences=sequences, metrics="default")
    assert math.isnan(found.interval("mpjpe")[0]) == said
    assert (
        any(remark.endswith("At least 6 are needed for a p-value, 3 for an interval.") for remark in found.remarks)
        == said
    )


def test_and_where_one_sequence_holds_nearly_all_poses() -> None:
    found = report(labels={"sequence": np.maximum(np.arange(M) - M + 8, 0)}, metrics="default")
    assert math.isnan(found.interval("mpjpe")[0])
    assert (
        "one sequence holds so many of the poses that sequences count as fewer than two: there are no intervals."
        in found.remarks
    )
