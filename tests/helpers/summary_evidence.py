"""Evidence for the summary of a report, without data."""

from __future__ import annotations

import math

from posecal.report.evidence import Estimate, Evidence, Joint, NullComparison
from posecal.report.sentences import RULES, sentences

NAN = math.nan


def area_of(value: float, low: float = NAN, high: float = NAN, freedom: float = 39) -> Estimate:
    return Estimate("signed area", value, low, high, 0.0, freedom)


def coverage_of(value: float, low: float = NAN, high: float = NAN, level: int = 90) -> Estimate:
    return Estimate(f"coverage at {level} %", value, low, high, level / 100)


def evidence(
    p: float = 0.5, area: Estimate | None = None, *, error: float = 0.04, units: int = 40, **others: object
) -> Evidence:
    ece = NullComparison(error, 0.01, 0.02, p)
    area = area_of(0.03) if area is None else area
    return Evidence(ece, area, f"{units} sequences", units, **others)  # type: ignore[arg-type]


def first(e: Evidence) -> str:
    return next(sentences(e))


def spoken(e: Evidence) -> list[str]:
    """Names of the rules whose sentences are given."""
    given, names, groups = list(sentences(e)), list[str](), set[str]()
    for rule in RULES:
        if rule.group not in groups and rule.holds(e):
            groups.add(rule.group)
            names.append(rule.name)
    assert len(names) == len(given)
    return names


def mean_of_joints(p: float) -> NullComparison:
    return NullComparison(0.06, 0.03, 0.05, p)


def joint_of(area: float, p: float, half_width: float = 0.02) -> Joint:
    return Joint(0.04, p, area_of(area, area - half_width, area + half_width))


TWO = {"Head": joint_of(-0.03, 0.049), "Hip": joint_of(0.03, 0.05)}


def ranks(**p: float) -> tuple[tuple[str, str, float], ...]:
    return tuple((name, f"why {name}", value) for name, value in p.items())
