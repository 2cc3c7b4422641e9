"""What a report says in words, for samplers of which it is known."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.demo import sample
from posecal.errors import for_command_line
from posecal.report.report import Report
from posecal.report.summary import remarks, summarize
from posecal.stats.uncertainty import p_without_each
from tests.helpers.reports import FRAMES, report_of, unlabelled, world
from tests.helpers.reports import N as FEW
from tests.helpers.samplers import gaussian, sequences

Array = np.ndarray
HOW: dict[str, Any] = {"axes": "NMKD", "unit": "mm"}
M, K, N = 240, 4, 19
JOINTS = ("Head", "LWrist", "RKnee", "LFoot")


def report(x: Array, y: Array, metrics: str = "default", S: int = 40) -> Report:
    labels = {"sequence": sequences(len(y), S)}
    return posecal.evaluate(
        x, y, joints=JOINTS, root_joint="none", labels=labels, metrics=metrics, axes="NMKD", unit="mm", threads=1
    )


def said(*, spread: float | list[float] = 1.0, metrics: str = "default", S: int = 40, seed: int = 0) -> list[str]:
    return summarize(report(*gaussian(seed, N, M, K, spread=spread), metrics, S))


def test_a_perfect_sampler_is_not_miscalibrated_beyond_chance() -> None:
    first, *rest = said()
    assert first.startswith("No miscalibration shown on average: ECE 0.0")
    assert "; chance alone gives a calibrated model up to 0.0" in first
    most = re.search(r"A true ECE of up to ([\d.]+) can't be excluded\. The 90\u00a0% balls hold", first)
    assert most is not None
    assert 0.02 < float(most[1]) < 0.1
    assert rest == []


@pytest.mark.parametrize(("spread", "word"), [(0.6, "Overconfident"), (1.7, "Underconfident")])
def test_a_wrong_spread_is_named_with_its_joints_and_what_a_user_would_see(spread: float, word: str) -> None:
    first, second = said(spread=spread)
    assert first.startswith(f"{word}, beyond chance: ECE 0.")
    assert "(p < 0.001). The 90\u00a0% balls hold" in first
    share = int(first.partition("balls hold ")[2].partition("\u00a0")[0])
    assert (share < 80) if spread < 1 else (share > 95)
    assert second.startswith(f"Joint by joint: {word.lower()} at ")
    assert all(joint in second for joint in JOINTS)
    assert second.endswith("(adjusted for 4 joints).")


def test_joints_that_cancel_are_named_and_the_median_is_said_to_hide_them() -> None:
    sentences = said(spread=[0.5, 1.0, 1.0, 2.0])
    assert sentences[0].startswith("No miscalibration shown on average")
    assert sentences[-1] == (
        "Joint by joint: overconfident at Head, underconfident at LFoot (adjusted for 4 joints); "
        "the median over joints hides it."
    )


def test_what_only_rank_tests_reject_is_said_with_its_meaning() -> None:
    random = np.random.default_rng(1)
    common = random.normal(0, 40, (M, 1, 3))
    y = np.sqrt(0.9) * common + np.sqrt(0.1) * random.normal(0, 40, (M, K, 3))  # joints move together
    x = random.normal(0, 40, (N, M, K, 3))  # the model's do not
    first, *_, last = summarize(report(x, y, "default, rank_tests"))
    assert first.startswith("No miscalibration shown on average")
    assert last.startswith("Rank tests show more than the ECE (")
    assert "pair distance" in last
    assert "joints move together less or more than they should" in last


def test_where_the_spread_is_wrong_rank_tests_are_for_later() -> None:
    last = said(spread=0.5, metrics="default, rank_tests")[-1]
    assert last.startswith("Rank tests reject as well: coordinate PIT, ")
    assert last.endswith("A wrong spread alone can cause that: rerun them once it is recalibrated.")


def test_rank_tests_of_which_none_rejects_point_to_a_score() -> None:
    assert said(metrics="default, rank_tests", seed=3)[-1] == (
        "No rank test rejects. A model that ignores the image would pass them too: look at a proper score."
    )


def test_too_few_sequences_are_not_judged() -> None:
    (first,) = said(spread=0.6, S=5)
    assert first.startswith("Looks overconfident: signed area -0.")
    assert "; 5 sequences allow no test. The 90\u00a0% balls hold " in first
    (first,) = said(S=5)
    assert first.startswith("Not tested: ECE 0.0")


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


def test_sequences_that_cancel_are_said_with_the_intervals_that_exclude_what_is_best() -> None:
    """Six sequences half as wide as they should be, six twice as wide: right on average, and in none of them."""
    S, F = 12, 40
    spread = np.repeat([0.5, 2.0], S * F // 2)[:, None, None]
    x, y = gaussian(5, N, S * F, K)
    centre, truth = x.mean(axis=0), y
    first, second, third = summarize(report(centre + spread * (x - centre), truth, S=S))
    assert first.startswith("Some sequences are off throughout (p = 0.0")
    assert second.startswith("No miscalibration shown on average: ECE 0.")
    assert (
        "chance alone gives a model that is calibrated on average, with sequences that differ as much, up to" in second
    )
    assert third.startswith("Yet the 95\u00a0% interval")
    assert "coverage at 95 % (0." in third
    low, high = re.findall(r"(s\d+) \(.*?([+-][\d.]+)\)", first)
    assert low[0] < "s006" <= high[0]
    assert float(low[1]) < -0.2
    assert float(high[1]) > 0.2


def test_nothing_is_said_of_p_values_that_are_not_there() -> None:
    _, y = gaussian(6, N, M, K)
    for x in (np.repeat(y[None], N, axis=0), np.repeat(y[None] + 30, N, axis=0)):
        same = report(x, y, S=12)
        assert math.isnan(same.test("ece").p)
        assert not any("p-values" in remark or "p of the ECE" in remark for remark in same.remarks)


# --- remarks --------------------------------------------------------------------------------------------------


def test_remarks_name_parameters_or_flags() -> None:
    report = unlabelled()
    assert report.remarks == remarks(report)
    (python,) = (remark for remark in remarks(report) if "root_joint" in remark)
    (flags,) = (remark for remark in remarks(report, for_command_line) if "--root-joint" in remark)
    assert python.replace("root_joint", "--root-joint") == flags


@pytest.mark.parametrize(("metrics", "few"), [("default", True), ("mpjpe", False)])
def test_few_hypotheses_matter_to_calibration_only(metrics: str, few: bool) -> None:
    x, y = gaussian(0, 2, 24, K)
    report = posecal.evaluate(x, y, metrics=metrics, axes="NMKD", unit="mm")
    assert any(remark.startswith("N = 2 hypotheses are few") for remark in report.remarks) is few
    assert not any("at least 2 hypotheses" in remark for remark in report.remarks)


def test_one_hypothesis_is_accurate_but_has_no_spread() -> None:
    remarks = " ".join(unlabelled(n=1).remarks)
    assert "calibration and spread need at least 2 hypotheses; there is 1." in remarks


def test_few_hypotheses_are_remarked_on_up_to_twenty() -> None:
    few = (
        "N = 19 hypotheses are few: an ECE lies between 0 and 0.45; look at what a perfect sampler would show before "
        "reading an ECE (paper)."
    )
    assert few in unlabelled(n=19).remarks
    assert not any("are few" in remark for remark in unlabelled(n=20).remarks)


def test_poses_without_sequences_are_remarked_on() -> None:
    (remark,) = (remark for remark in unlabelled().remarks if remark.startswith("no sequence labels: "))
    assert remark == "no sequence labels: 5 frames are taken as independent. In a video they are not."
    (remark,) = (r for r in unlabelled(poses=201).remarks if r.startswith("no sequence labels: "))
    assert "51 runs of consecutive frames are taken as independent" in remark
    assert not any("no sequence labels" in remark for remark in report_of().remarks)


def test_one_sequence_is_one_sequence() -> None:
    here = world()
    one = posecal.evaluate(sample(here, 2)[:, :3], here.truth[:3], labels={"sequence": here.sequence[:3]}, **HOW)
    assert any(remark.startswith("1 sequence allows no test: ") for remark in one.remarks)


def test_too_few_sequences_for_a_test_are_remarked_on() -> None:
    """With 3 sequences, 2 of 8 choices of signs make the error as large, whatever it is."""
    here = world()
    three = slice(0, 3 * FRAMES)
    report = posecal.evaluate(
        sample(here, FEW)[:, three],
        here.truth[three],
        joints="h36m-17",
        labels={"sequence": here.sequence[three]},
        **HOW,
    )
    (remark,) = (remark for remark in report.remarks if "sequences allow no test" in remark)
    assert remark.startswith("3 sequences allow no test: ")
    assert "in 25% of cases" in remark
    assert math.isnan(report.test("ece").p)


@pytest.mark.parametrize(("number", "few"), [(5, True), (6, False)])
def test_six_sequences_are_enough_for_a_test(number: int, few: bool) -> None:
    x, y = gaussian(0, 4, 24, K)
    report = posecal.evaluate(x, y, labels={"sequence": sequences(24, number)}, **HOW)
    assert any("allow no test" in remark for remark in report.remarks) is few


def test_below_twenty_sequences_what_p_values_assume_is_remarked_on_and_how_that_of_the_ece_moves() -> None:
    report = report_of()
    (remark,) = (remark for remark in report.remarks if remark.startswith("p assumes"))
    p = p_without_each(report.totals, report.metrics["ece"])
    low, high = (f"{value:.2f}" if value >= 0.01 else "below 0.01" for value in (p.min(), p.max()))
    words = f"either side alike; without any one, the ECE's is {low} to {high}."
    assert remark.endswith(words)


@pytest.mark.parametrize(("sequences", "assumed", "moves"), [(5, 0, 0), (6, 1, 0), (7, 1, 1), (19, 1, 1), (20, 0, 0)])
def test_p_values_of_six_to_nineteen_sequences_have_the_remark(sequences: int, assumed: int, moves: int) -> None:
    random = np.random.default_rng(1)
    labels = {"sequence": np.arange(40) % sequences}
    report = posecal.evaluate(
        *(random.normal(0, 30, shape) for shape in ((4, 40, 2, 3), (40, 2, 3))),
        labels=labels,
        unit="mm",
        axes="NMKD",
        root_joint="none",
    )
    remarks = [remark for remark in report.remarks if remark.startswith("p assumes")]
    assert (len(remarks), sum("without any one" in remark for remark in remarks)) == (assumed, moves)
