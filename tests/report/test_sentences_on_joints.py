"""Rules of the summary on joints and rank tests, at their edges, from evidence without data."""

from __future__ import annotations

from dataclasses import replace

import pytest

from posecal.report.evidence import NEITHER
from posecal.report.sentences import sentences
from tests.helpers.summary_evidence import (
    NAN,
    TWO,
    area_of,
    evidence,
    joint_of,
    mean_of_joints,
    ranks,
    spoken,
)

NOTHING = "No rank test rejects. A model that ignores the image would pass them too: look at a proper score."


# --- joints -------------------------------------------------------------------------------------------------------


def test_joints_are_named_where_the_ece_or_the_mean_of_joints_is_beyond_chance() -> None:
    joints = "Joint by joint: overconfident at Head (adjusted for 2 joints)"
    assert list(sentences(evidence(0.009, joints=TWO)))[1] == f"{joints}."
    hidden = evidence(0.05, joints=TWO, mean_of_joints=mean_of_joints(0.009))
    assert list(sentences(hidden))[1] == f"{joints}; the median over joints hides it."
    weak = replace(hidden, ece=replace(hidden.ece, p=0.049))
    assert list(sentences(weak))[1] == f"{joints}."
    assert spoken(replace(hidden, mean_of_joints=mean_of_joints(0.01))) == ["not shown", "mean of joints, weak"]


def test_nothing_is_said_of_the_only_joint_beside_what_is_said_of_all() -> None:
    assert spoken(evidence(0.001, joints={"Head": joint_of(0.03, 0.001)})) == ["beyond chance"]


def test_joints_of_weak_p_are_named_where_the_signed_area_agrees() -> None:
    """With 40 sequences t is 2.023 and 2.708: a half-width of 0.0224 becomes 0.02998, and 0.0225 becomes 0.03012."""
    for half_width, p, named in ((0.0224, 0.049, True), (0.0225, 0.049, False), (0.0225, 0.009, True)):
        joints = {"Head": joint_of(-0.03, p, half_width), "Hip": joint_of(0.03, 0.5)}
        assert ("joints" in spoken(evidence(0.001, joints=joints))) is named


def test_joints_are_sorted_to_their_sides_by_the_same_rule_the_largest_area_first() -> None:
    joints = {
        "Hip": joint_of(-0.021, 0.009),
        "Head": joint_of(-0.03, 0.009),
        "Neck": joint_of(0.021, 0.009),
        "Foot": joint_of(0.019, 0.009),
        "Knee": joint_of(-0.019, 0.009),
        "Hand": joint_of(0.04, 0.2),
    }
    assert list(sentences(evidence(0.001, joints=joints)))[1] == (
        "Joint by joint: overconfident at Head and Hip, underconfident at Neck, "
        f"{NEITHER}, at Foot and Knee (adjusted for 6 joints)."
    )


@pytest.mark.parametrize(
    ("number", "words"),
    [(2, "j0 and j1"), (6, "j0, j1, j2, j3, j4 and j5"), (9, "j0, j1, j2, j3, j4, j5 and 3 more")],
)
def test_up_to_six_joints_are_named(number: int, words: str) -> None:
    joints = {f"j{k}": joint_of(0.03, 0.009) for k in range(number)}
    assert list(sentences(evidence(0.001, joints=joints)))[1] == (
        f"Joint by joint: underconfident at {words} (adjusted for {number} joints)."
    )


def test_the_median_hides_what_the_mean_of_the_joints_shows() -> None:
    known = evidence(0.05, mean_of_joints=mean_of_joints(0.009))
    errors = "the joints' own ECEs average 0.060, a calibrated model's about 0.030"
    assert (
        list(sentences(known))[1] == f"The median over joints hides that some are miscalibrated: {errors} (p = 0.009)."
    )
    weak = replace(known, mean_of_joints=mean_of_joints(0.01))
    assert list(sentences(weak))[1] == (
        f"Weak evidence that some joints are off, which the median over joints hides: {errors} (p = 0.010)."
    )
    assert spoken(replace(known, mean_of_joints=mean_of_joints(0.049))) == ["not shown", "mean of joints, weak"]
    assert spoken(replace(known, mean_of_joints=mean_of_joints(0.05))) == ["not shown"]
    assert spoken(evidence(0.049, mean_of_joints=mean_of_joints(0.009))) == ["weak evidence"]


SPREAD = " A wrong spread alone can cause that: rerun them once it is recalibrated."


# --- rank tests ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("p", "tests", "last"),
    [
        (0.5, ranks(a=0.009, b=0.02), "Rank tests show more than the ECE (a): why a."),
        (0.5, ranks(a=0.009, b=0.009), "Rank tests show more than the ECE (a, b): why a; why b."),
        (0.02, ranks(a=0.009), f"Rank tests show more than the ECE (a): why a.{SPREAD}"),
        (0.5, ranks(a=0.01, b=0.02, c=0.05), "Weak evidence from rank tests: a, b (adjusted p = 0.010)."),
        (0.5, ranks(a=0.05, b=0.5), NOTHING),
        (0.001, ranks(a=0.05), NOTHING),
    ],
)
def test_what_rank_tests_add(p: float, tests: tuple[tuple[str, str, float], ...], last: str) -> None:
    assert list(sentences(evidence(p, rank_tests=tests)))[-1] == last


def test_a_wrong_spread_explains_rejections_where_an_interval_speaks_for_it() -> None:
    """Of a spread × 1.15 in 16 sequences rank tests reject where the ECE shows little or nothing."""
    tests = ranks(a=0.009)
    shown = evidence(0.06, area_of(0.03, 0.01, 0.05), rank_tests=tests)
    assert list(sentences(shown))[-1].endswith(SPREAD)
    assert list(sentences(replace(shown, area=area_of(0.03, -0.01, 0.07))))[-1].endswith("why a.")
    assert list(sentences(replace(shown, area=area_of(0.0, -0.02, 0.02))))[-1].endswith("why a.")


def test_rank_tests_beside_a_wrong_spread_are_for_later() -> None:
    beyond = evidence(0.001, area_of(-0.03), rank_tests=ranks(a=0.009))
    assert list(sentences(beyond))[-1] == (
        "Rank tests reject as well: a. A wrong spread alone can cause that: rerun them once it is recalibrated."
    )
    neither = replace(beyond, area=area_of(0.0))
    assert list(sentences(neither))[-1] == "Rank tests reject as well: a."


def test_rank_tests_that_can_reject_nothing_are_not_said_to_pass() -> None:
    """Of 8 sequences the smallest p is 1/128; six times that is 0.047, seven times 0.055."""
    six = evidence(units=8, rank_tests=ranks(**{f"t{n}": 0.5 for n in range(6)}))
    assert list(sentences(six))[-1] == NOTHING
    seven = replace(six, rank_tests=ranks(**{f"t{n}": 0.5 for n in range(7)}))
    assert list(sentences(seven))[-1] == "8 sequences are too few for 7 rank tests to reject."
    assert spoken(evidence(rank_tests=ranks(a=0.5, b=NAN))) == ["not shown"]
