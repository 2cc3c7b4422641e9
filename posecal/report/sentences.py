"""What a summary may say: a table of rules, each with the evidence that it needs and its sentence.

In each group of rules the first that holds applies. A sentence never says more than the report shows: what is not
shown is not called calibrated, p-values between 0.01 and 0.05 are weak evidence, and intervals are not contradicted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from posecal.calibration.error import COVERAGES
from posecal.report.evidence import NEITHER, OVER, UNDER, Evidence, Rule, side_of
from posecal.report.format import counted, p_value, several, span
from posecal.stats.heterogeneity import CROWDED, WIDE
from posecal.stats.resampling import LEVEL, STRONG

BOTH_SIDES = 0.05
"""Signed areas of at least this size to either side are called over- and underconfident sequences; a spread that is
wrong by an eighth has such an area in three dimensions."""


def sentences(evidence: Evidence) -> Iterator[str]:
    """Give the sentences that the evidence supports, in the order of the groups."""
    spoken = set()
    for rule in RULES:
        if rule.group not in spoken and rule.holds(evidence):
            spoken.add(rule.group)
            yield rule.say(evidence)
            if rule.alone:
                return


# --- whether the model is miscalibrated -------------------------------------------------------------------------


def _untested(e: Evidence) -> bool:
    return math.isnan(e.ece.p)


def _not_shown(e: Evidence) -> bool:
    return e.ece.p >= LEVEL or (_untested(e) and not _one_sided(e))


def _one_sided(e: Evidence) -> bool:
    return e.side != NEITHER and e.area.excludes != 0


def _share(e: Evidence) -> str:
    """What the balls of 90 % hold, as a sentence; of the largest level that is known where that one is not."""
    for row in sorted(e.coverage, key=lambda row: (row.best != 0.9, -row.best)):
        if not math.isnan(row.value) and round(100 * row.best, 6) not in COVERAGES:
            return (
                f" From the least hypothesis to the largest lie {100 * row.value:.0f}\u00a0% of the truths, of a "
                f"calibrated model {100 * row.best:.0f}\u00a0%."
            )
        if not math.isnan(row.value):
            return f" The {100 * row.best:.0f}\u00a0% {e.balls} hold {100 * row.value:.0f}\u00a0% of the truths."
    return ""


def _more(e: Evidence) -> str:
    if e.side == NEITHER:
        return "on neither side throughout"
    return f"more {'over' if e.side == OVER else 'under'}- than {'under' if e.side == OVER else 'over'}confident"


def _looks(e: Evidence) -> str:
    interval = span(e.area.low, e.area.high)
    return f"Looks {e.side}: signed area {e.area.value:+.3f} (95\u00a0% interval {interval}); {_no_test(e)}.{_share(e)}"


def _not_tested(e: Evidence) -> str:
    known = "" if math.isnan(e.floor) else f", a perfect sampler's up to {e.floor:.3f} in as many independent frames"
    return f"Not tested: ECE {e.ece.error:.3f}{known}; signed area {e.area.value:+.3f}; {_no_test(e)}.{_share(e)}"


def _no_test(e: Evidence) -> str:
    return f"{e.units} allow{'s' * (e.n_units == 1)} no test"


def _beyond_chance(e: Evidence) -> str:
    if e.side != NEITHER and (e.area.excludes or math.isnan(e.area.low)):
        verdict = f"{e.side.capitalize()}, beyond chance"
    else:
        verdict = f"Miscalibrated beyond chance, {_more(e)}"
    return f"{verdict}: {_against(e)}"


def _weak(e: Evidence) -> str:
    return f"Weak evidence of miscalibration, {_more(e)}: {_against(e)}"


def _against(e: Evidence) -> str:
    return f"ECE {e.ece.error:.3f}; {_chance(e, 'about', e.ece.mean)}.{_share(e)}"


def _chance(e: Evidence, words: str, value: float) -> str:
    """Say what a calibrated model shows, or where sequences are shown to differ, one whose sequences do as well."""
    if math.isnan(value):
        return f"what chance alone gives a calibrated model is not known ({p_value(e.ece.p)})"
    differ = e.sequences is not None and e.sequences.p < STRONG
    alike = "model that is calibrated on average, with sequences that differ as much,"
    what = "chance and unequal weights give" if e.area.slack else "chance alone gives"
    return f"{what} a {alike if differ else 'calibrated model'} {words} {value:.3f} ({p_value(e.ece.p)})"


def _nothing_shown(e: Evidence) -> str:
    error, high = e.ece.error, e.ece.high
    excluded = "" if math.isnan(high) else f" A true ECE of up to {error + high:.3f} can't be excluded."
    return f"No miscalibration shown on average: ECE {error:.3f}; {_chance(e, 'up to', high)}.{excluded}{_share(e)}"


# --- modes --------------------------------------------------------------------------------------------------------


def _two_modes(e: Evidence) -> str:
    joints, least = sorted(e.modes, key=lambda joint: -e.modes[joint]), min(e.modes.values())
    return (
        f"Hypotheses have two modes at {several(joints)}, in {100 * least:.0f}\u00a0% of poses or more: {e.balls} are "
        "about their common median, and don't say whether each mode is too narrow or too wide."
    )


# --- intervals ----------------------------------------------------------------------------------------------------


def _intervals(e: Evidence) -> str:
    many = "" if len(e.excluded) == 1 else "s"
    rows = " and ".join(f"{row.label} ({span(row.low, row.high)}; best: {row.best:.3g})" for row in e.excluded)
    known = sum(not math.isnan(row.low) for row in (e.area, *e.coverage))
    chance = f"; of {known} intervals one may do so by chance" if known > len(e.excluded) == 1 else ""
    return f"Yet the 95\u00a0% interval{many} of {rows} exclude{'' if many else 's'} what is best{chance}."


# --- sequences ----------------------------------------------------------------------------------------------------


def _to_both_sides(e: Evidence, size: float) -> bool:
    return e.sequences is not None and e.sequences.lowest[1] <= -size and e.sequences.highest[1] >= size


def _differ(e: Evidence) -> bool:
    return _to_both_sides(e, BOTH_SIDES) and e.sequences is not None and e.sequences.p < STRONG


def _sequences_differ(e: Evidence) -> str:
    assert e.sequences is not None
    (low, lowest), (high, highest), p = e.sequences.lowest, e.sequences.highest, e.sequences.p
    return (
        f"Some sequences are off throughout ({p_value(p)}): most overconfident {low} (signed area {lowest:+.2f}), most "
        f"underconfident {high} ({highest:+.2f})."
    )


def _range(e: Evidence) -> bool:
    found = e.sequences
    return not e.strong and found is not None and _to_both_sides(e, WIDE) and found.frames > CROWDED * found.independent


def _sequences_range(e: Evidence) -> str:
    assert e.sequences is not None
    (low, lowest), (high, highest), independent = e.sequences.lowest, e.sequences.highest, e.sequences.independent
    return (
        f"Single sequences range from overconfident ({low}, signed area {lowest:+.2f}) to underconfident ({high}, "
        f"{highest:+.2f}), by chance only if {e.sequences.frames:.0f} frames count as no more than "
        f"{counted(max(1, math.ceil(independent)), 'independent one')}."
    )


# --- joints -------------------------------------------------------------------------------------------------------


def _named_joints(e: Evidence) -> dict[str, list[str]]:
    """Joints that are off beyond chance, by side, the largest signed area first."""
    sides: dict[str, list[str]] = {OVER: [], UNDER: [], NEITHER: []}
    for name, joint in sorted(e.joints.items(), key=lambda entry: -abs(entry[1].area.value)):
        if e.is_beyond_chance(joint.p, joint.area):
            sides[side_of(joint.area.value, joint.error)].append(name)
    return {side: joints for side, joints in sides.items() if joints}


def _mean_p(e: Evidence) -> float:
    return math.nan if e.mean_of_joints is None else e.mean_of_joints.p


def _joints(e: Evidence) -> bool:
    return len(e.joints) > 1 and (e.strong or _mean_p(e) < STRONG) and bool(_named_joints(e))


def _joint_by_joint(e: Evidence) -> str:
    named = [f"{side}{',' * (side == NEITHER)} at {several(joints)}" for side, joints in _named_joints(e).items()]
    hidden = "; the median over joints hides it" if _not_shown(e) else ""
    return f"Joint by joint: {', '.join(named)} (adjusted for {counted(len(e.joints), 'joint')}){hidden}."


def _mean_of_joints(e: Evidence) -> str:
    mean = e.mean_of_joints
    assert mean is not None
    expected = "" if math.isnan(mean.mean) else f", a calibrated model's about {mean.mean:.3f}"
    return f"the joints' own ECEs average {mean.error:.3f}{expected} ({p_value(mean.p)})"


# --- rank tests ---------------------------------------------------------------------------------------------------


def _rejected(e: Evidence, level: float) -> list[tuple[str, str, float]]:
    return [test for test in e.rank_tests if test[2] < level]


def _labels(tests: list[tuple[str, str, float]]) -> str:
    return ", ".join(label for label, _, _ in tests)


def _spread_alone(e: Evidence) -> str:
    """Say that a wrong spread explains rejections, where something speaks for one."""
    advice = " A wrong spread alone can cause that: rerun them once it is recalibrated."
    return advice if e.side != NEITHER and (e.ece.p < LEVEL or e.excluded) else ""


def _rank_tests_too(e: Evidence) -> str:
    return f"Rank tests reject as well: {_labels(_rejected(e, STRONG))}.{_spread_alone(e)}"


def _rank_tests_alone(e: Evidence) -> str:
    meanings = "; ".join(dict.fromkeys(meaning for _, meaning, _ in _rejected(e, STRONG)))
    return f"Rank tests show more than the ECE ({_labels(_rejected(e, STRONG))}): {meanings}.{_spread_alone(e)}"


def _rank_tests_weakly(e: Evidence) -> str:
    weak = _rejected(e, LEVEL)
    return f"Weak evidence from rank tests: {_labels(weak)} (adjusted {p_value(min(p for _, _, p in weak))})."


def _without_power(e: Evidence) -> bool:
    return bool(e.rank_tests) and len(e.rank_tests) >= LEVEL * 2.0 ** (e.n_units - 1)


def _none_rejects(e: Evidence) -> bool:
    return bool(e.rank_tests) and not any(math.isnan(p) for _, _, p in e.rank_tests)


RULES = (
    Rule(
        "sequences",
        "sequences differ, not shown",
        "p ≥ 0.05 of the ECE, and sequences differ as below; chance is then that of sequences that differ as much",
        lambda e: e.ece.p >= LEVEL and _differ(e),
        _sequences_differ,
    ),
    Rule(
        "verdict",
        "no spread",
        "the hypotheses of a pose are all the same; nothing else is said then",
        lambda e: not e.spreads,
        lambda _: "All hypotheses of a pose are the same: there is no predicted distribution to be calibrated.",
        alone=True,
    ),
    Rule(
        "verdict",
        "few by weights",
        "weights are unequal, and effective N is below 20; nothing else is said then",
        lambda e: not math.isnan(e.few_by_weights),
        lambda e: (
            f"Not judged: weights of an effective N of {e.few_by_weights:.1f} leave a calibrated model an ECE "
            f"above 0; here it is {e.ece.error:.3f}."
        ),
        alone=True,
    ),
    Rule(
        "verdict",
        "no test, one side",
        "fewer than 6 sequences; the 95 % interval of the signed area excludes 0, and the curve has a side",
        lambda e: _untested(e) and _one_sided(e),
        _looks,
    ),
    Rule("verdict", "no test", "fewer than 6 sequences", _untested, _not_tested),
    Rule(
        "verdict",
        "beyond chance",
        "p < 0.01 of the ECE; or p < 0.05 and the 99 % interval of the signed area excludes 0. Names a side where the "
        "signed area is more than half of the ECE, its 95 % interval excludes 0, and no interval of a coverage lies on "
        "the other side",
        lambda e: e.strong,
        _beyond_chance,
    ),
    Rule("verdict", "weak evidence", "p < 0.05 of the ECE", lambda e: e.ece.p < LEVEL, _weak),
    Rule("verdict", "not shown", "p ≥ 0.05 of the ECE", lambda e: e.ece.p >= LEVEL, _nothing_shown),
    Rule(
        "modes",
        "two modes",
        "at a joint hypotheses have two modes in more poses than those of a distribution without modes would by chance",
        lambda e: bool(e.modes),
        _two_modes,
    ),
    Rule(
        "intervals",
        "interval excludes",
        "nothing is shown or tested, and the 95 % interval of the signed area or of a coverage excludes its best value",
        lambda e: _not_shown(e) and bool(e.excluded),
        _intervals,
    ),
    Rule(
        "sequences",
        "sequences differ",
        "p < 0.01 of the test that the first and the last third of sequences are off alike; signed areas of at least "
        "0.05 to either side",
        _differ,
        _sequences_differ,
    ),
    Rule(
        "sequences",
        "sequences range",
        "not beyond chance; signed areas of at least 0.1 to either side, and more than 3 frames for each that a "
        "sequence counts as",
        _range,
        _sequences_range,
    ),
    Rule(
        "joints",
        "joints",
        "the ECE is beyond chance, or p < 0.01 of the mean of the joints' ECEs; beyond chance is then, by the same "
        "rule, a joint with its own signed area and p, adjusted for the number of joints",
        _joints,
        _joint_by_joint,
    ),
    Rule(
        "joints",
        "mean of joints",
        "nothing is shown by the median, and p < 0.01 of the mean of the joints' ECEs",
        lambda e: _not_shown(e) and _mean_p(e) < STRONG,
        lambda e: f"The median over joints hides that some are miscalibrated: {_mean_of_joints(e)}.",
    ),
    Rule(
        "joints",
        "mean of joints, weak",
        "the same, and p < 0.05",
        lambda e: _not_shown(e) and _mean_p(e) < LEVEL,
        lambda e: f"Weak evidence that some joints are off, which the median over joints hides: {_mean_of_joints(e)}.",
    ),
    Rule(
        "rank tests",
        "rank tests, too",
        "adjusted p < 0.01 of a rank test, and the ECE is beyond chance",
        lambda e: e.strong and bool(_rejected(e, STRONG)),
        _rank_tests_too,
    ),
    Rule(
        "rank tests",
        "rank tests",
        "adjusted p < 0.01 of a rank test",
        lambda e: bool(_rejected(e, STRONG)),
        _rank_tests_alone,
    ),
    Rule(
        "rank tests",
        "rank tests, weak",
        "adjusted p < 0.05 of a rank test",
        lambda e: bool(_rejected(e, LEVEL)),
        _rank_tests_weakly,
    ),
    Rule(
        "rank tests",
        "rank tests without power",
        "so few sequences that no rank test can have an adjusted p below 0.05",
        _without_power,
        lambda e: (
            f"{e.units.capitalize()} {'is' if e.n_units == 1 else 'are'} too few for "
            f"{counted(len(e.rank_tests), 'rank test')} to reject."
        ),
    ),
    Rule(
        "rank tests",
        "no rank test",
        "all rank tests are made",
        _none_rejects,
        lambda _: "No rank test rejects. A model that ignores the image would pass them too: look at a proper score.",
    ),
)
"""The decision table of the summary, in the order of its sentences."""
