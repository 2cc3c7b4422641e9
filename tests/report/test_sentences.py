"""Each rule of the summary at its edges, from evidence without data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from runpy import run_path

import pytest

from posecal.report.evidence import (
    STRONG,
    Estimate,
    Evidence,
    NullComparison,
    Sequences,
)
from posecal.report.sentences import RULES, sentences
from tests.helpers.summary_evidence import (
    NAN,
    TWO,
    area_of,
    coverage_of,
    evidence,
    first,
    mean_of_joints,
    ranks,
    spoken,
)

# --- verdicts -----------------------------------------------------------------------------------------------------


def test_nothing_is_judged_of_hypotheses_that_are_all_the_same() -> None:
    off = coverage_of(0.68, 0.47, 0.89)
    same = evidence(0.5, coverage=(off,), rank_tests=ranks(a=0.001), spreads=False)
    assert list(sentences(same)) == [
        "All hypotheses of a pose are the same: there is no predicted distribution to be calibrated."
    ]
    assert len(list(sentences(replace(same, spreads=True)))) == 3


def test_nothing_is_judged_of_weights_of_a_small_effective_number() -> None:
    few = evidence(NAN, area_of(-0.03, -0.04, -0.02), rank_tests=ranks(a=NAN), few_by_weights=3.14)
    assert list(sentences(few)) == [
        "Not judged: weights of an effective N of 3.1 leave a calibrated model an ECE above 0; here it is 0.040."
    ]
    assert spoken(replace(few, few_by_weights=NAN))[0] == "no test, one side"


def test_beyond_chance_is_below_one_percent() -> None:
    assert STRONG == 0.01
    assert first(evidence(0.0099, area_of(-0.03))) == (
        "Overconfident, beyond chance: ECE 0.040; chance alone gives a calibrated model about 0.010 (p = 0.010)."
    )
    assert first(evidence(0.01, area_of(-0.03))) == (
        "Weak evidence of miscalibration, more over- than underconfident: ECE 0.040; chance alone gives a calibrated "
        "model about 0.010 (p = 0.010)."
    )


def test_few_sequences_are_beyond_chance_where_the_signed_area_agrees() -> None:
    """Of six sequences no p is below 1/32."""
    assert first(evidence(0.031, area_of(-0.03, -0.04, -0.02), units=6)).startswith("Overconfident, beyond chance")
    assert first(evidence(0.031, area_of(-0.03, -0.055, -0.005), units=6)).startswith("Weak evidence")
    assert first(evidence(0.05, area_of(-0.03, -0.04, -0.02), units=6)).startswith("No miscalibration shown")


@pytest.mark.parametrize(
    ("area", "words"),
    [
        (area_of(-0.021), "Overconfident, beyond chance"),
        (area_of(0.021), "Underconfident, beyond chance"),
        (area_of(0.021, 0.001, 0.041), "Underconfident, beyond chance"),
        (area_of(0.021, -0.001, 0.043), "Miscalibrated beyond chance, more under- than overconfident"),
        (area_of(-0.021, -0.043, 0.001), "Miscalibrated beyond chance, more over- than underconfident"),
        (area_of(0.019, 0.001, 0.037), "Miscalibrated beyond chance, on neither side throughout"),
    ],
)
def test_a_side_is_named_where_its_interval_excludes_zero(area: Estimate, words: str) -> None:
    assert first(evidence(0.001, area)).startswith(f"{words}: ECE 0.040")


def test_weak_evidence_is_below_five_percent() -> None:
    assert first(evidence(0.049, area_of(0.0))).startswith(
        "Weak evidence of miscalibration, on neither side throughout: ECE 0.040"
    )
    assert first(evidence(0.05)) == (
        "No miscalibration shown on average: ECE 0.040; chance alone gives a calibrated model up to 0.020 (p = 0.050). "
        "A true ECE of up to 0.060 can't be excluded."
    )


def test_without_a_test_the_error_stands_beside_a_perfect_sampler() -> None:
    few = evidence(NAN, units=3)
    assert first(replace(few, floor=0.05)) == (
        "Not tested: ECE 0.040, a perfect sampler's up to 0.050 in as many independent frames; signed area +0.030; "
        "3 sequences allow no test."
    )
    assert first(few) == "Not tested: ECE 0.040; signed area +0.030; 3 sequences allow no test."
    assert first(replace(few, units="1 sequence", n_units=1)).endswith("; 1 sequence allows no test.")


def test_without_a_test_a_side_is_named_where_the_signed_area_excludes_zero() -> None:
    few = evidence(NAN, area_of(-0.03, -0.05, -0.01), units=4)
    assert first(few) == (
        "Looks overconfident: signed area -0.030 (95\u00a0% interval -0.050 to -0.010); 4 sequences allow no test."
    )
    assert spoken(replace(few, area=area_of(-0.03, -0.07, 0.01))) == ["no test"]
    neither = replace(few, area=area_of(-0.019, -0.03, -0.01))
    assert spoken(neither) == ["no test", "interval excludes"]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ((coverage_of(0.916),), " The 90\u00a0% balls hold 92\u00a0% of the truths."),
        ((coverage_of(0.0),), " The 90\u00a0% balls hold 0\u00a0% of the truths."),
        ((coverage_of(0.5, level=50), coverage_of(1.0), coverage_of(0.9, level=95)), " The 90\u00a0% balls hold 100"),
        ((coverage_of(0.4, level=50), coverage_of(0.7, level=80), coverage_of(NAN)), " The 80\u00a0% balls hold 70"),
        ((coverage_of(NAN),), "can't be excluded."),
    ],
)
def test_what_the_balls_hold_is_said_of_90_percent_or_of_the_largest_known(
    rows: Sequence[Estimate], words: str
) -> None:
    assert words in first(evidence(coverage=tuple(rows)))


def test_coordinates_have_intervals() -> None:
    assert "The 90\u00a0% intervals hold 92\u00a0%" in first(
        evidence(coverage=(coverage_of(0.916),), balls="intervals")
    )


def test_what_a_calibrated_sampler_would_show_is_not_said_where_it_is_not_known() -> None:
    unknown = NullComparison(0.45, NAN, NAN, 0.0005)
    sentence = "ECE 0.450; what chance alone gives a calibrated model is not known (p < 0.001)."
    assert first(Evidence(unknown, area_of(0.45))) == f"Underconfident, beyond chance: {sentence}"
    assert first(Evidence(replace(unknown, p=0.05), area_of(0.45))) == (
        f"No miscalibration shown on average: {sentence.replace('p < 0.001', 'p = 0.050')}"
    )
    of_joints = replace(mean_of_joints(0.009), mean=NAN)
    assert list(sentences(evidence(mean_of_joints=of_joints)))[1].endswith(
        ": the joints' own ECEs average 0.060 (p = 0.009)."
    )


# --- modes --------------------------------------------------------------------------------------------------------


def test_two_modes_are_said_right_after_the_verdict_with_the_joint_where_most_poses_have_them_first() -> None:
    found = evidence(0.001, modes={"Head": 0.314, "Hip": 0.99}, joints=TWO)
    assert spoken(found) == ["beyond chance", "two modes", "joints"]
    assert list(sentences(found))[1] == (
        "Hypotheses have two modes at Hip and Head, in 31\u00a0% of poses or more: balls are about their common "
        "median, and don't say whether each mode is too narrow or too wide."
    )
    assert "or more: intervals are about" in list(sentences(replace(found, balls="intervals")))[1]
    assert spoken(replace(found, modes={})) == ["beyond chance", "joints"]


# --- intervals that exclude what is best -----------------------------------------------------------------------


def test_an_interval_that_excludes_what_is_best_is_said_where_nothing_is_shown() -> None:
    off, around = coverage_of(0.68, 0.47, 0.89), coverage_of(0.5, 0.4, 0.6, level=50)
    (_, second) = sentences(evidence(0.05, area_of(0.03, -0.01, 0.07), coverage=(around, off)))
    assert second == (
        "Yet the 95\u00a0% interval of coverage at 90 % (0.47 to 0.89; best: 0.9) excludes what is best; of 3 "
        "intervals one may do so by chance."
    )
    (_, second) = sentences(evidence(0.05, area_of(-0.03, -0.05, -0.01), coverage=(off,)))
    assert second == (
        "Yet the 95\u00a0% intervals of signed area (-0.050 to -0.010; best: 0) and coverage at 90 % (0.47 to 0.89; "
        "best: 0.9) exclude what is best."
    )
    (_, second) = sentences(evidence(0.05, area_of(-0.03), coverage=(off,)))
    assert second.endswith("excludes what is best.")  # the only one that is known
    assert spoken(evidence(NAN, area_of(0.03), coverage=(off,))) == ["no test", "interval excludes"]
    assert spoken(evidence(NAN, area_of(-0.03, -0.05, -0.01), coverage=(off,))) == ["no test, one side"]


def test_no_interval_is_said_where_it_adds_nothing() -> None:
    off = coverage_of(0.68, 0.47, 0.89)
    assert spoken(evidence(0.049, coverage=(off,))) == ["weak evidence"]
    assert spoken(evidence(0.05, coverage=(coverage_of(0.68, 0.47, 0.9),))) == ["not shown"]


# --- sequences ----------------------------------------------------------------------------------------------------


def of_sequences(low: float, high: float, p: float = NAN, *, frames: float = 50, independent: float = 2) -> Sequences:
    return Sequences(("A", low), ("B", high), independent, frames, p)


def test_sequences_differ_where_both_sides_and_a_test_show_it() -> None:
    shown = evidence(0.05, sequences=of_sequences(-0.05, 0.05, 0.009))
    assert spoken(shown) == ["sequences differ, not shown", "not shown"]
    assert list(sentences(shown)) == [
        "Some sequences are off throughout (p = 0.009): most overconfident A (signed area -0.05), most "
        "underconfident B (+0.05).",
        "No miscalibration shown on average: ECE 0.040; chance alone gives a model that is calibrated on average, with "
        "sequences that differ as much, up to 0.020 (p = 0.050). A true ECE of up to 0.060 can't be excluded.",
    ]
    assert spoken(replace(shown, sequences=of_sequences(-0.05, 0.05, 0.01))) == ["not shown"]
    assert spoken(replace(shown, sequences=of_sequences(-0.049, 0.05, 0.009))) == ["not shown"]
    assert spoken(replace(shown, sequences=of_sequences(-0.05, 0.049, 0.009))) == ["not shown"]
    for p, verdict in ((0.001, "beyond chance"), (0.049, "weak evidence"), (NAN, "no test")):
        assert spoken(replace(shown, ece=replace(shown.ece, p=p))) == [verdict, "sequences differ"]
    one_sided = replace(shown, sequences=of_sequences(0.01, 0.2, 0.009))
    assert "a model that is calibrated on average, with sequences that differ as much, up to 0.020" in first(one_sided)
    weak = replace(shown, ece=replace(shown.ece, p=0.049))
    assert first(weak).endswith(
        "chance alone gives a model that is calibrated on average, with sequences that differ as much, about 0.010 "
        "(p = 0.049)."
    )


def test_sequences_that_range_widely_are_said_with_what_chance_would_take() -> None:
    wide = evidence(sequences=of_sequences(-0.1, 0.1, independent=2.1))
    assert list(sentences(wide))[1] == (
        "Single sequences range from overconfident (A, signed area -0.10) to underconfident (B, +0.10), by chance only "
        "if 50 frames count as no more than 3 independent ones."
    )
    assert spoken(replace(wide, sequences=of_sequences(-0.1, 0.099))) == ["not shown"]
    assert spoken(replace(wide, sequences=of_sequences(-0.099, 0.1))) == ["not shown"]
    assert spoken(replace(wide, sequences=of_sequences(-0.1, 0.1, frames=6, independent=2))) == ["not shown"]
    assert spoken(replace(wide, sequences=of_sequences(-0.1, 0.1, frames=6.1, independent=2)))[1] == "sequences range"
    assert spoken(evidence(0.001, sequences=wide.sequences)) == ["beyond chance"]
    assert spoken(evidence(0.02, sequences=wide.sequences)) == ["weak evidence", "sequences range"]
    few = replace(wide, sequences=of_sequences(-0.4, 0.4, independent=0.5))
    assert list(sentences(few))[1].endswith("count as no more than 1 independent one.")


# --- the table ----------------------------------------------------------------------------------------------------


def test_the_table_of_the_documentation_is_that_of_the_rules() -> None:
    page = Path(__file__).parents[2] / "docs" / "report.md"
    text, generated = page.read_text(encoding="utf-8"), run_path(str(page.with_name("generate.py")))["generated"]
    assert text == generated(text), "run python docs/generate.py"
    for rule in RULES:
        assert f"| {rule.group} | {rule.name} | {rule.when}" in text
    assert len({rule.name for rule in RULES}) == len(RULES)
