"""Primary metrics, and p-values that are adjusted for the number of tests."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from posecal.errors import PoseDataError
from posecal.stats.multiplicity import adjust, check_known, check_primary, default_primary, names_of
from tests.helpers.comparisons import X, Y, totals_of


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (None, ()),
        ("", ()),
        ("crps", ("crps",)),
        ("crps, ece,crps", ("crps", "ece")),
        (["crps", "ece, pck"], ("crps", "ece", "pck")),
        (("ece",), ("ece",)),
    ],
)
def test_names_are_one_text_or_several(given: object, names: tuple[str, ...]) -> None:
    assert names_of(given) == names


@pytest.mark.parametrize("given", [5, ["ece", 5], {"ece"}])
def test_what_is_no_name_is_refused(given: object) -> None:
    with pytest.raises(PoseDataError, match=r"^primary: .*; expected names of metrics\.$"):
        names_of(given)


@pytest.mark.parametrize(
    ("metrics", "primary"),
    [
        ("ece, crps, energy_score, min_mpjpe", ("energy_score", "ece")),
        ("energy_score, min_mpjpe", ("energy_score",)),
        ("ece, mpjpe, min_mpjpe", ("min_mpjpe", "ece")),
        ("ece, mpjpe", ("ece",)),
        ("pck, mpjpe", ("pck", "mpjpe")),
    ],
)
def test_a_score_and_calibration_are_primary_and_minmpjpe_where_there_is_no_score(
    metrics: str, primary: tuple[str, ...]
) -> None:
    assert default_primary(metrics.split(", ")) == primary


def test_names_that_no_data_could_have_are_refused_before_anything_is_measured() -> None:
    check_known([])
    check_known(["ece", "crps"])
    with pytest.raises(PoseDataError, match=r"^primary: .*mpjp"):
        check_known(["ece", "mpjp"])


def test_unknown_primary_metrics_are_refused_all_at_once() -> None:
    totals = totals_of(X, Y, "ece, mpjpe")
    check_primary(["mpjpe"], ["ece", "mpjpe"], totals)
    with pytest.raises(PoseDataError) as caught:
        check_primary(["mpjp", "ece", "crps"], ["ece", "mpjpe"], totals)
    assert str(caught.value).splitlines()[1:] == [
        "  - primary: mpjp is not in the comparison. Did you mean mpjpe?",
        '  - primary: crps was not measured. Evaluate with metrics="ece, mpjpe, scores".',
    ]


def test_adjusted_p_values_are_those_of_all_tests_together() -> None:
    """Holm by its definition: the i-th smallest counts for those that are no smaller."""
    random = np.random.default_rng(0)
    p = {name: random.random(3).tolist() for name in "abcd"}
    p["b"][1] = math.nan
    tests = sorted((value, name, at) for name, some in p.items() for at, value in enumerate(some) if value == value)
    expected, largest = {}, 0.0
    for place, (value, name, at) in enumerate(tests):
        largest = max(largest, min(1.0, (len(tests) - place) * value))
        expected[name, at] = largest
    found = adjust(p)
    assert {(n, at): v for n, some in found.items() for at, v in enumerate(some) if v == v} == pytest.approx(expected)
    assert math.isnan(found["b"][1])


def test_holm_keeps_its_level_among_independent_tests() -> None:
    times, rejected = 2000, 0
    for p in np.random.default_rng(1).random((times, 12)):
        rejected += min(min(some) for some in adjust({"a": p[:6].tolist(), "b": p[6:].tolist()}).values()) < 0.05
    low, high = stats.binom(times, 1 - (1 - 0.05 / 12) ** 12).interval(0.9999)
    assert low <= rejected <= high
