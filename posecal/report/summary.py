"""What do the numbers say, in words? Once, and no more than they carry.

Whether the model is over- or underconfident, whether beyond chance, at which joints, and what the calibration error
alone would have missed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from posecal.report.findings import Findings
from posecal.report.format import p_value

__all__ = ["summarize"]

LEVEL = 0.05
"""What counts as beyond chance."""


def summarize(report: Findings) -> list[str]:
    """Say what a report's calibration comes down to.

    Parameters
    ----------
    report : Report
        The numbers.

    Returns
    -------
    list of str
        Sentences; none without calibration.
    """
    if "ece" not in report.metrics or "signed_area" not in report.metrics:
        return []
    return [*_whole(report), *_joints(report), *_battery(report)]


def _side(area: float) -> str:
    return "overconfident" if area < 0 else "underconfident"


def _whole(report: Findings) -> Iterator[str]:
    error, area = report.value("ece"), report.value("signed_area")
    if math.isnan(error):
        return
    coverage = report.value("coverage_90") if "coverage_90" in report.metrics else math.nan
    share = "" if math.isnan(coverage) else f"; the 90\u00a0% balls hold {100 * coverage:.0f}\u00a0% of the truths"
    found = report.null("ece")
    if math.isnan(found.p):
        yield f"Looks {_side(area)} (signed area {area:+.3f}{share}); whether by chance can't be tested here."
    elif found.p < LEVEL:
        clear = abs(area) > error / 2
        what = _side(area).capitalize() if clear else "Miscalibrated, on neither side throughout"
        yield (
            f"{what}, beyond chance: ECE {error:.3f} where a calibrated sampler would show {found.mean:.3f} "
            f"({p_value(found.p)}){share}."
        )
    else:
        yield (
            f"Not miscalibrated beyond chance: ECE {error:.3f}, and a calibrated sampler would show up to "
            f"{found.high:.3f} on these {report.totals.units(found.sequences)} ({p_value(found.p)}){share}."
        )


def _joints(report: Findings) -> Iterator[str]:
    tests = report.joint_tests()
    sides: dict[str, list[str]] = {"overconfident": [], "underconfident": [], "off, on neither side throughout,": []}
    for joint, (area, p) in sorted(tests.items(), key=lambda entry: -abs(entry[1][0])):
        if p < LEVEL:
            clear = abs(area) > report.value("ece", joint=joint) / 2
            sides[_side(area) if clear else "off, on neither side throughout,"].append(joint)
    named = [f"{side} at {_several(joints)}" for side, joints in sides.items() if joints]
    if named:
        yield f"Joint by joint: {', '.join(named)} (adjusted for {len(tests)} joints)."
    if "ece_mean" in report.metrics and report.null("ece_mean").p < LEVEL <= report.null("ece").p:
        yield (
            f"The median over joints hides it: the joints' own errors average {report.value('ece_mean'):.3f} "
            f"({p_value(report.null('ece_mean').p)})."
        )


def _several(joints: list[str], most: int = 6) -> str:
    if len(joints) > most:
        return f"{', '.join(joints[:most])} and {len(joints) - most} more"
    return ", ".join(joints[:-1]) + (" and " if len(joints) > 1 else "") + joints[-1]


def _battery(report: Findings) -> Iterator[str]:
    tests = report.rank_tests()
    fired = [name for name, (_, p) in tests.items() if p < LEVEL]
    labels = ", ".join(report.metrics[name].label for name in fired)
    if fired and report.null("ece").p < LEVEL:
        yield f"The battery fires as well: {labels}. Mend the spread first, and look again."
    elif fired:
        meanings = dict.fromkeys(report.metrics[name].rejection for name in fired)
        yield f"What the ECE does not see, the battery does ({labels}): {'; '.join(meanings)}."
    elif tests and not any(math.isnan(p) for _, p in tests.values()):
        yield "The battery finds nothing more. A model that ignores the image would pass it too: look at a score."
