"""What a map changes: proper scores, calibration and accuracy before and after, and objections to it."""

from __future__ import annotations

import math
from collections.abc import Mapping

from posecal.data.pose_data import PoseData
from posecal.evaluation.call import evaluate
from posecal.report.format import short_number
from posecal.report.report import Report

METRICS = ("energy_score", "crps", "ece", "signed_area", "min_mpjpe")
"""What is compared before and after."""

SCORES = {"energy_score": "energy score", "crps": "CRPS"}
"""The proper scores, of which none may get worse, and what sentences call them."""

WORSE = 1e-3
"""A score is worse where it rises by more than this share: as much as a right spread loses by a factor of 1.06."""

FLIPPED = 0.5, 0.02
"""A side is flipped where the signed area changes its sign and keeps more than this share, and is more than this."""


def report_of(data: PoseData, threads: int | None) -> Report:
    """Evaluate what is compared before and after."""
    return evaluate(data, metrics=METRICS, threads=threads)


def changes_between(before: Report, after: Report) -> dict[str, tuple[float, float]]:
    """Give each metric of :data:`METRICS` that both reports have, before and after."""
    return {name: (before[name], after[name]) for name in METRICS if name in before.metrics and name in after.metrics}


def objections(changes: Mapping[str, tuple[float, float]], unit: str) -> tuple[str, ...]:
    """Give the objections to a map: proper scores that get worse, and a side that is only exchanged for the other.

    Parameters
    ----------
    changes : mapping of tuples
        Metrics before and after.
    unit : str
        Of the scores.

    Returns
    -------
    tuple of str
        Clauses; empty where there is none.

    Examples
    --------
    >>> objections({"crps": (18.0, 23.0), "ece": (0.125, 0.108)}, "mm")
    ('the CRPS rises from 18.0 to 23.0 mm',)
    """
    found = []
    for name, label in SCORES.items():
        before, after = changes.get(name, (math.nan, math.nan))
        if after > before + WORSE * abs(before):
            values = f"from {short_number(before, unit)} to {short_number(after, unit)} {unit}".rstrip()
            found.append(f"the {label} rises {values}")
    before, after = changes.get("signed_area", (0.0, 0.0))
    if before * after < 0 and abs(after) > max(FLIPPED[0] * abs(before), FLIPPED[1]):
        sides = ("overconfident", "underconfident")[:: 1 if before < 0 else -1]
        areas = f"signed area {before:+.3f} to {after:+.3f}"
        found.append(f"the hypotheses turn from {sides[0]} to {sides[1]} ({areas})")
    return tuple(found)
