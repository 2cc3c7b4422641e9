"""What stands on the sheets of recalibrations."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np

from posecal.calibration import Modes
from posecal.errors import for_command_line
from posecal.recalibration import SpreadMap, judge_spread
from posecal.recalibration.sheets import radius_sheet, spread_sheet
from tests.helpers.flips import depth_flips
from tests.helpers.samplers import gaussian, pairs_of, sequences

JOINTS = ("Hip", "Head", "RKnee")
CHANGES = {"energy_score": (93.0, 120.0), "crps": (18.0, 17.5), "ece": (0.125, 0.108), "min_mpjpe": (21.0, 63.0)}


def spread_map(*factors: float, poses: int = 2000, **more: Any) -> SpreadMap:
    return SpreadMap(JOINTS, np.array(factors), poses, 0, **more)


def test_one_spread_factor_is_a_sentence_and_several_are_a_table() -> None:
    one = spread_sheet(spread_map(1, 1.25, 1.25))
    assert one.sentences[0] == "Spread factor 1.2500 for all joints, fitted on 2,000 poses."
    assert one.tables == []
    several = spread_sheet(spread_map(1, 1.25, 0.5, poses=1))
    assert several.sentences[0] == "A spread factor for each of 2 joints, fitted on 1 pose."
    assert several.tables[0].rows == [("Head", "1.2500"), ("RKnee", "0.5000")]
    assert several.sentences[1].startswith("Judged on these poses alone: ")
    about = spread_sheet(spread_map(1, 2, 2, modal=("Head", "RKnee")))
    assert about.sentences[0].startswith("Spread factor 2.0000 for all joints, about the modes of Head and RKnee, fit")


def test_what_the_factor_changes_stands_with_what_speaks_against_it() -> None:
    sheet = spread_sheet(spread_map(1, 2, 2, changes=CHANGES))
    assert sheet.sentences[1] == "Not recommended: the energy score rises from 93.0 to 120.0 mm."
    assert sheet.tables[0].rows[0] == ("energy score", "93.000 mm", "120.000 mm")
    assert sheet.tables[0].rows[2] == ("ECE", "0.12500", "0.10800")
    good = spread_sheet(spread_map(1, 2, 2, changes={"crps": (18.0, 17.5)}))
    assert not any(sentence.startswith("Not recommended") for sentence in good.sentences)


def test_joints_with_several_modes_are_named() -> None:
    several = Modes(np.array([0, 0.97, 0.6]), np.array([np.nan, 120, 110]), 0.1, np.array([False, True, True]))
    sheet = spread_sheet(spread_map(1, 2, 2), modes=several, words=for_command_line)
    assert sheet.sentences[-1] == (
        "Several modes at Head and RKnee: in 60% to 97% of poses, about 115.0 mm apart. A factor about their median "
        "moves the modes themselves; --about modes rescales each about its own centre."
    )
    none = replace(several, several=np.zeros(3, dtype=bool))
    assert len(spread_sheet(spread_map(1, 2, 2), modes=none).sentences) == 2
    about = spread_sheet(spread_map(1, 2, 2, modal=("Head",)), modes=several)
    assert not any(sentence.startswith("Several modes") for sentence in about.sentences)


def test_a_factor_that_helps_stands_with_the_numbers_and_its_cost() -> None:
    x, y = gaussian(1, 10, 60, 6, spread=0.4)
    judged = judge_spread(pairs_of(x, y, labels={"sequence": sequences(60, 12)}), folds=3, threads=1)
    sheet = spread_sheet(judged.fitted, judged)
    before, after = judged.before, judged.after
    assert list(sheet.tables[0].headings) == ["held out, 3 parts", "before", "after"]
    shown = {row[0]: row[1:] for row in sheet.tables[0].rows}
    assert "ECE" not in shown
    expected = f"{before['energy_score']:.3f} mm", f"{after['energy_score']:.3f} mm"
    assert shown["energy score"] == expected
    energy = judged.difference("energy_score")
    assert sheet.sentences[1].startswith(
        f"It helps held-out sequences: energy score {energy.value:+.2f} mm ({energy.low:+.2f} to {energy.high:+.2f}, p"
    )
    assert sheet.sentences[2] == (
        f"On as many new sequences the ECE is at most {judged.new_ece:.3f} in nine of ten cases; that of "
        f"these, before, is {before['ece']:.3f}."
    )
    cost = after["min_mpjpe"] - before["min_mpjpe"]
    assert cost > 0
    assert sheet.sentences[3] == f"It costs {cost:.1f} mm of minMPJPE, which rewards a spread that is too narrow."


def test_a_calibrated_sampler_gains_nothing() -> None:
    x, y = gaussian(2, 20, 100, 3)
    judged = judge_spread(pairs_of(x, y, labels={"sequence": sequences(100, 10)}), folds=4, threads=1)
    text = " ".join(spread_sheet(judged.fitted, judged).sentences)
    assert re.search(r"Held-out sequences leave open whether it helps: energy|Not recommended: on held-out", text)


def test_without_labelled_sequences_there_is_no_interval() -> None:
    judged = judge_spread(pairs_of(*gaussian(2, 20, 100, 3, spread=0.5)), folds=4, threads=1)
    value = judged.after["energy_score"] - judged.before["energy_score"]
    sentences = spread_sheet(judged.fitted, judged).sentences
    words = "No sequences are labelled: the parts are runs of frames, and chance can't be judged"
    assert sentences[1].startswith(f"{words}: energy score {value:+.2f} mm; CRPS -")
    assert not any("nine of ten" in sentence for sentence in sentences)


def test_a_factor_that_makes_held_out_sequences_worse_is_not_recommended() -> None:
    x, y = depth_flips(0, 30, 120, 4)
    judged = judge_spread(x, y, unit="mm", labels={"sequence": sequences(120, 12)}, threads=1)
    sheet = spread_sheet(judged.fitted, judged)
    assert sheet.sentences[1].startswith("Not recommended: on held-out sequences the energy score rises from ")
    assert not any("It costs" in sentence for sentence in sheet.sentences)


def test_radii_stand_with_the_coverage_of_held_out_truths() -> None:
    radii = {"Hip": float("nan"), "Head": 12.345}
    sheet = radius_sheet(radii, 2000, 0.1, "mm")
    assert sheet.sentences[0] == "Radii about the median that hold 90% of the truths of 2,000 poses."
    assert sheet.sentences[1].startswith("Not judged: ")
    assert sheet.tables[0].rows == [("Head", "12.35")]
    judged = radius_sheet(radii, 2000, 0.1, "mm", {"Hip": float("nan"), "Head": 0.91})
    assert judged.tables[0].rows == [("Head", "12.35", "0.910")]
    assert list(judged.tables[0].headings) == ["joint", "radius, mm", "held-out coverage"]
    assert len(judged.sentences) == 1
