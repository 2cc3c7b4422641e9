"""The simulation of the summary's sentences, with few worlds, and the judge of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from tests.evidence.sentences import CAUTIOUS, KINDS, RIGHT, WRONG, Law, World, contradictions, judge, judged, law_of

GOOD, NARROW = World(), World(spread=(0.5, 1.0, 1.0))
NONE = Law(0, 0, dict.fromkeys(GOOD.joints, (0.0, 0.0)))
OVER = Law(0.1, -0.1, {"Head": (0.1, -0.1), "LWrist": (0.0, 0.0), "RKnee": (0.1, 0.1)})


@pytest.mark.parametrize(
    ("sentence", "of_good", "of_narrow"),
    [
        ("Overconfident, beyond chance: ECE 0.1.", WRONG, RIGHT),
        ("Underconfident, beyond chance: ECE 0.1.", WRONG, WRONG),
        ("Miscalibrated beyond chance, more over- than underconfident: ECE", WRONG, RIGHT),
        ("Miscalibrated beyond chance, more under- than overconfident: ECE", WRONG, WRONG),
        ("Weak evidence of miscalibration, more over- than underconfident: ECE", CAUTIOUS, RIGHT),
        ("Weak evidence of miscalibration, more under- than overconfident: ECE", CAUTIOUS, WRONG),
        ("Looks overconfident: signed area -0.1.", CAUTIOUS, RIGHT),
        ("No miscalibration shown on average: up to 0.2. A true ECE of up to 0.100 can't", RIGHT, CAUTIOUS),
        ("No miscalibration shown on average: up to 0.2. A true ECE of up to 0.099 can't", RIGHT, WRONG),
        ("Not tested: ECE 0.1.", CAUTIOUS, CAUTIOUS),
        ("Yet the 95 % interval of x excludes what is best.", CAUTIOUS, RIGHT),
        ("Some sequences are off throughout.", WRONG, WRONG),
        ("Joint by joint: overconfident at Head, underconfident at RKnee (adjusted", WRONG, RIGHT),
        ("Joint by joint: overconfident at Head and LWrist (adjusted", WRONG, WRONG),
        ("Joint by joint: overconfident at RKnee (adjusted", WRONG, WRONG),
        ("The median over joints hides that some are miscalibrated: x.", WRONG, RIGHT),
        ("Weak evidence that some joints are off, which the median over joints hides: x.", CAUTIOUS, RIGHT),
        ("Hypotheses have two modes at Head.", WRONG, WRONG),
        ("Rank tests reject as well: x.", WRONG, RIGHT),
        ("Rank tests show more than the ECE (x): y.", WRONG, RIGHT),
        ("Weak evidence from rank tests: x.", CAUTIOUS, RIGHT),
        ("No rank test rejects.", RIGHT, CAUTIOUS),
    ],
)
def test_sentences_are_judged_by_the_law(sentence: str, of_good: str, of_narrow: str) -> None:
    nothing: Any = None
    assert judge(sentence, GOOD, NONE, nothing) == of_good
    assert judge(sentence, NARROW, OVER, nothing) == of_narrow


def test_a_range_of_sequences_is_wrong_where_frames_count_as_more() -> None:
    nothing: Any = None
    sentence = "Single sequences range from … no more than 5 independent ones."
    assert judge(sentence, World(frames=6), NONE, nothing) == WRONG
    assert judge(sentence, World(frames=5), NONE, nothing) == CAUTIOUS
    assert judge(sentence, World(frames=20, likeness=0.95), NONE, nothing) == CAUTIOUS
    assert judge(sentence, World(of_sequences=(0.5, 2)), OVER, nothing) == RIGHT
    assert judge("Hypotheses have two modes at Head.", World(modes="both"), OVER, nothing) == RIGHT


def test_a_row_that_the_summary_does_not_mention_contradicts_it() -> None:
    ends = dict.fromkeys(("signed_area", *(f"coverage_{n}" for n in (50, 80, 90, 95))), (-1.0, 2.0))

    class Known(SimpleNamespace):
        def __getitem__(self, name: str) -> float:
            return 0.5

    said = "No miscalibration shown on average."
    known: Any = Known(
        summary=(said,),
        metrics={name: SimpleNamespace(label=name) for name in ends},
        interval=(ends | {"coverage_90": (0.4, 0.8)}).get,
        rank_tests=dict,
    )
    assert list(contradictions(known)) == ["coverage_90: not mentioned"]
    known.summary = (said, "Yet that of coverage_90 excludes it.")
    assert list(contradictions(known)) == []
    known.summary = ("Underconfident, beyond chance.",)
    assert list(contradictions(known)) == ["signed_area: on no side", "coverage_90: on the other side"]


def test_the_law_of_a_spread_is_that_of_distances() -> None:
    """With many hypotheses a spread of half the right one has balls of radius r/2: P(χ²₃ < r²/4) at P(χ²₃ < r²) = q."""
    from scipy.stats import chi2

    law = law_of(World(spread=(0.5, 1.0), hypotheses=200, together=0.0), np.random.default_rng(0))
    q = np.linspace(0, 1, 2001)
    area = np.trapezoid(chi2.cdf(chi2.ppf(q, 3) / 4, 3) - q, q)
    assert law.joints["Head"][1] == pytest.approx(area, abs=0.02)
    assert law.joints["LWrist"] == (0, 0)
    assert law_of(World(rare=0.1), np.random.default_rng(0)).error == 0


@pytest.mark.slow
def test_few_reports_say_anything_untrue() -> None:
    """Were 3 % of reports wrong, more than this would be so in one run of a thousand."""
    each = 6
    worlds = [world for kind in KINDS for world in judged(kind, each)]
    wrong = [sentence for world in worlds for verdict, sentence in world if verdict == WRONG]
    reports = sum(any(verdict == WRONG for verdict, _ in world) for world in worlds)
    assert reports <= binom.ppf(0.999, len(worlds), 0.03), wrong
    assert not any(sentence.startswith("contradicts") for sentence in wrong)
