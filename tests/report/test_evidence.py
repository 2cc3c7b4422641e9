"""What the sentences of a summary rest on."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import special, stats

import posecal
from posecal.report.evidence import NEITHER, ONE_SIDED, Estimate, NullComparison, evidence_of, side_of
from tests.helpers.samplers import gaussian
from tests.report.test_sentences import area_of, coverage_of, evidence
from tests.report.test_summary import JOINTS, K, M, N, report


@pytest.mark.parametrize(("sign", "side"), [(-1, "overconfident"), (1, "underconfident")])
def test_a_side_is_named_where_more_than_half_of_the_error_lies_on_it(sign: int, side: str) -> None:
    error, edge = 0.04, 0.02
    assert ONE_SIDED == 0.5
    assert side_of(sign * edge * 1.000001, error) == side
    assert side_of(sign * edge, error) == NEITHER
    assert side_of(sign * edge * 0.999999, error) == NEITHER
    assert side_of(sign * error, error) == side


def test_a_coverage_on_the_other_side_takes_the_side_away() -> None:
    over = evidence(0.001, area_of(-0.03))
    assert over.side == "overconfident"
    assert replace(over, coverage=(coverage_of(0.95, 0.899, 0.97),)).side == "overconfident"
    assert replace(over, coverage=(coverage_of(0.95, 0.901, 0.97),)).side == NEITHER
    under = evidence(0.001, area_of(0.03))
    assert replace(under, coverage=(coverage_of(0.95, 0.901, 0.97),)).side == "underconfident"
    assert replace(under, coverage=(coverage_of(0.8, 0.7, 0.899),)).side == NEITHER


def test_an_interval_excludes_what_lies_beyond_its_ends() -> None:
    assert [coverage_of(0.9, *ends).excludes for ends in ((0.8, 0.899), (0.8, 0.9), (0.9, 0.95), (0.901, 0.95))] == [
        -1,
        0,
        0,
        1,
    ]
    assert coverage_of(math.nan).excludes == 0


def test_the_99_percent_interval_is_wider_by_the_ratio_of_student_quantiles() -> None:
    """With 5 degrees of freedom t is 2.571 and 4.032: a half-width of 0.02 becomes 0.03137."""
    assert not area_of(-0.0313, -0.0513, -0.0113, 5).excludes_at_99()
    assert area_of(-0.0314, -0.0514, -0.0114, 5).excludes_at_99()
    assert area_of(0.0314, 0.0114, 0.0514, 5).excludes_at_99()
    assert not area_of(0.0314, freedom=5).excludes_at_99()
    assert not area_of(0.0314, 0.0114, 0.0514, math.nan).excludes_at_99()


def test_an_interval_within_what_weights_allow_excludes_nothing() -> None:
    area = replace(area_of(-0.03, -0.035, -0.025, 39), slack=0.02)
    assert (area.excludes, area.excludes_at_99()) == (-1, True)
    assert (replace(area, slack=0.0255).excludes, replace(area, slack=0.0255).excludes_at_99()) == (0, False)
    assert (replace(area, slack=0.024).excludes, replace(area, slack=0.024).excludes_at_99()) == (-1, False)
    inside = replace(area_of(0.002, 0.001, 0.003, 39), slack=0.02)
    assert (inside.excludes, inside.excludes_at_99()) == (0, False)


@pytest.mark.parametrize("joint", [None, "Head"])
def test_the_99_percent_interval_is_that_of_sequences_of_unequal_lengths_on_its_own_scale(joint: str | None) -> None:
    """As the jackknife has it with Student's quantile of 99.5 % in place of 97.5 %."""
    lengths = [60, *[12] * 7]
    labels = {"sequence": np.repeat([f"s{s}" for s in range(8)], lengths)}
    x, y = gaussian(4, 12, sum(lengths), K, spread=0.3)
    about: dict[str, Any] = {"joints": JOINTS, "root_joint": "none", "axes": "NMKD", "unit": "mm"}
    known = evidence_of(posecal.evaluate(x, y, labels=labels, threads=1, **about))
    estimate = known.area if joint is None else known.joints[joint].area
    effective = sum(lengths) ** 2 / sum(n**2 for n in lengths)
    assert estimate.freedom == pytest.approx(effective - 1)
    assert estimate.bounds == (-0.5, 0.5)
    centre, end = special.logit(estimate.value + 0.5), special.logit(estimate.high + 0.5)
    t = stats.t(effective - 1)
    wider = special.expit(centre + (end - centre) * t.ppf(0.995) / t.ppf(0.975)) - 0.5
    assert wider < 0  # far off
    for best, excludes in ((wider + 1e-6, True), (wider - 1e-6, False)):
        assert replace(estimate, best=best).excludes_at_99() is excludes


def test_at_the_edge_the_plain_interval_is_made_wider() -> None:
    edge = Estimate("signed area", -0.5, -0.5, -0.2, 0.0, 9, (-0.5, 0.5))
    assert edge.excludes_at_99()
    assert not replace(edge, high=-0.1).excludes_at_99()


def test_beyond_chance_takes_a_small_p_or_two_that_agree() -> None:
    clear, unclear = area_of(-0.03, -0.04, -0.02), area_of(-0.03, -0.05, 0.01)
    assert [evidence(p, unclear).strong for p in (0.0099, 0.01)] == [True, False]
    assert [evidence(p, clear).strong for p in (0.0499, 0.05)] == [True, False]


# --- from a report ------------------------------------------------------------------------------------------------


def test_joints_and_rank_tests_of_many_joints_are_tested_once() -> None:
    found = report(*gaussian(4, N, M, K))
    assert evidence_of(found).joints.keys() == set(JOINTS)
    assert evidence_of(found).mean_of_joints is not None
    assert evidence_of(report(*gaussian(4, N, M, K, spread=0.5))).mean_of_joints is None  # nothing is hidden


def test_evidence_is_what_the_rows_of_the_report_say() -> None:
    found = report(*gaussian(4, N, M, K, spread=[0.5, 1.0, 1.0, 1.0]), "default, rank_tests")
    evidence = evidence_of(found)
    assert evidence.ece == NullComparison(found["ece"], found["ece_null"], found["ece_null_95"], found["ece_p"])
    assert (evidence.area.value, evidence.area.low, evidence.area.high) == (
        found["signed_area"],
        *found.interval("signed_area"),
    )
    assert [(row.label, row.value, row.best) for row in evidence.coverage] == [
        (f"coverage at {n} %", found[f"coverage_{n}"], n / 100) for n in (50, 80, 90, 95)
    ]
    assert (evidence.units, evidence.n_units) == ("40 sequences", 40)
    assert evidence.joints["Head"].area.low == found.interval("signed_area", joint="Head")[0]
    assert evidence.joints["Head"].error == found.value("ece", joint="Head")
    assert math.isnan(evidence.joints["RKnee"].area.low)  # not beyond chance: not needed
    assert [p for _, _, p in evidence.rank_tests] == [p for _, p in found.rank_tests().values()]
    assert math.isnan(evidence.floor)
    assert evidence_of(report(*gaussian(4, N, 24, K), S=4)).floor > 0


def test_hypotheses_that_are_all_the_same_have_no_spread() -> None:
    x, y = gaussian(4, N, 48, K)
    assert evidence_of(report(x, y, S=12)).spreads
    one = np.broadcast_to(x[:1], x.shape)
    assert not evidence_of(report(one, y, S=12)).spreads
    assert not evidence_of(report(np.broadcast_to(y, x.shape), y, S=12)).spreads
    assert evidence_of(report(one, y, "ece,signed_area", S=12)).spreads  # not known


def test_sequences_are_tested_whichever_side_they_lie_on() -> None:
    S, F = 9, 12
    x, y = gaussian(4, N, S * F, K)
    centre = x.mean(axis=0)
    for factors, both in (([0.4, 0.6], False), ([0.5, 2.5], True)):
        spread = np.resize(factors, S).repeat(F)[:, None, None]
        found = evidence_of(report(centre + spread * (x - centre), y, S=S)).sequences
        assert found is not None
        assert found.lowest[1] < found.highest[1]
        assert (found.highest[1] > 0) is both
        assert found.p < 0.2


def depth_flips_at_one_joint() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    random = np.random.default_rng(5)
    x, y = random.normal(0, 10, (60, 80, 2, 1)), random.normal(0, 10, (80, 2, 1))
    x[:, :, 1] += random.choice([-60, 60], (60, 80, 1))
    y[:, 1] += random.choice([-60, 60], (80, 1))
    return x, y


@pytest.mark.parametrize("what", ["plain", "angles", "weights", "some absent"])
def test_two_modes_are_named_of_angles_and_of_weighted_and_absent_hypotheses_too(what: str) -> None:
    x, y = depth_flips_at_one_joint()
    labels, options = {"sequence": np.arange(80) // 10}, {}
    if what == "weights":
        options["weights"] = np.random.default_rng(6).dirichlet(np.full(60, 2.0), 80).T
    if what == "some absent":
        x[40:, ::3] = np.nan
    unit = "deg" if what == "angles" else "mm"
    found = evidence_of(posecal.evaluate(x, y, unit=unit, axes="NMKD", labels=labels, root_joint="none", **options))
    assert found.modes == {"joint 1": 1.0}


@pytest.mark.parametrize("n", [2, 5, 10])
def test_intervals_of_few_hypotheses_are_held_against_what_so_few_can_hold(n: int) -> None:
    random, shape = np.random.default_rng(n), (400, 2, 1)
    x, y = random.normal(0, 10, (n, *shape)), random.normal(0, 10, shape)
    report = posecal.evaluate(x, y, unit="deg", axes="NMKD", labels={"sequence": np.arange(400) // 20})
    attained = (n - 1) / (n + 1)
    assert [row.best for row in evidence_of(report).coverage] == pytest.approx([min(0.5, attained), attained])
    (sentence,) = report.summary  # none of an interval that excludes what is best
    held = 100 * report["interval_coverage_90"]
    assert sentence.endswith(
        f"From the least hypothesis to the largest lie {held:.0f}\u00a0% of the truths, of a calibrated model "
        f"{100 * attained:.0f}\u00a0%."
    )
