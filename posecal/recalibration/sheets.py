"""The printed page of a recalibration: what was fitted, what it changes, and whether it helps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np

from posecal.calibration.modes import Modes
from posecal.errors import for_python, option
from posecal.recalibration.held_out import HeldOut
from posecal.recalibration.spread_map import SpreadMap
from posecal.report.format import counted, number, p_value, several, short_number
from posecal.report.sheet import Sheet, Table
from posecal.stats.resampling import LEVEL

HELD_OUT = ("energy_score", "crps", "coverage_50", "coverage_90", "radius_50", "min_mpjpe", "mpjpe")
"""What is shown of held-out sequences; not the ECE, which is too small where it is pooled."""

LABELS = {"energy_score": "energy score", "crps": "CRPS", "ece": "ECE", "signed_area": "signed area"}
LABELS |= {"min_mpjpe": "minMPJPE"}
UNITLESS = ("ece", "signed_area")


def spread_sheet(
    spread_map: SpreadMap,
    judged: HeldOut | None = None,
    modes: Modes | None = None,
    remarks: Iterable[str] = (),
    words: Callable[[str], str] = for_python,
) -> Sheet:
    """Lay out fitted spread factors, what they change, and whether they help.

    Parameters
    ----------
    spread_map : SpreadMap
        The factors, and what they change on the poses that they were fitted on.
    judged : HeldOut, optional
        What they do to held-out sequences.
    modes : Modes, optional
        The joints with several modes.
    remarks : iterable of str
        On the data.
    words : callable
        How options are named: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.
    """
    moving = {joint: factor for joint, factor in spread_map.by_joint.items() if factor != 1}
    fitted, about = f"fitted on {counted(spread_map.poses, 'pose')}", ""
    if spread_map.modal:
        about = f", about the modes of {several(spread_map.modal)}"
    sentences, tables = list[str](), list[Table]()
    if len({round(factor, 9) for factor in moving.values()}) == 1:
        sentences.append(f"Spread factor {next(iter(moving.values())):.4f} for all joints{about}, {fitted}.")
    else:
        sentences.append(f"A spread factor for each of {len(moving)} joints{about}, {fitted}.")
        rows = [(joint, f"{factor:.4f}") for joint, factor in moving.items()]
        tables.append(Table("Factors", ("joint", "factor"), rows))
    unit = spread_map.data_unit
    if judged is None:
        if spread_map.changes:
            changed = [_changed(name, *pair, unit) for name, pair in spread_map.changes.items()]
            tables.append(Table("Fitted poses", ("the poses that it was fitted on", "before", "after"), changed))
        if spread_map.objections:
            sentences.append(f"Not recommended: {' and '.join(spread_map.objections)}.")
        held_out = "--split says what it does to sequences that it was not fitted on"
        sentences.append(f"Judged on these poses alone: {held_out}.")
    else:
        before, after = judged.before, judged.after
        metrics = [before.metrics[name] for name in HELD_OUT if name in before.metrics]
        compared = [(m.label, *(number(report[m.name], m.unit) for report in (before, after))) for m in metrics]
        tables.append(Table("Held-out sequences", (f"held out, {judged.folds} parts", "before", "after"), compared))
        sentences += _judgement(judged, unit)
    if not spread_map.modal:
        sentences += _of_modes(spread_map.joints, modes, unit)
    return Sheet("Recalibrated spread", [*map(words, sentences)], [*map(words, remarks)], tables)


def _changed(name: str, before: float, after: float, unit: str) -> tuple[str, str, str]:
    unit = "" if name in UNITLESS else unit
    return LABELS[name], number(before, unit), number(after, unit)


def _judgement(judged: HeldOut, unit: str) -> Iterator[str]:
    """Say whether held-out sequences gain, how sure that is, and what it costs."""
    objections = judged.objections or judged.fitted.objections
    if objections:
        where = "on held-out sequences" if judged.objections else "on the poses that it was fitted on"
        yield f"Not recommended: {where} {' and '.join(objections)}."
    else:
        differences = {name: judged.difference(name) for name in ("energy_score", "crps")}
        changes = [
            _difference(LABELS[name], each.value, each.low, each.high, each.p, unit)
            for name, each in differences.items()
        ]
        energy = differences["energy_score"]
        helps = energy.value < 0 and energy.p < LEVEL
        if not judged.before.totals.has_sequences:
            verdict = "No sequences are labelled: the parts are runs of frames, and chance can't be judged"
        else:
            verdict = "It helps held-out sequences" if helps else "Held-out sequences leave open whether it helps"
        yield f"{verdict}: {'; '.join(changes)}."
    before = short_number(judged.before["ece"])
    if not math.isnan(judged.new_ece):
        yield (
            f"On as many new sequences the ECE is at most {short_number(judged.new_ece)} in nine of ten cases; that of "
            f"these, before, is {before}."
        )
    cost = judged.after["min_mpjpe"] - judged.before["min_mpjpe"]
    if cost > 0 and not objections:
        costs = f"{short_number(cost, unit)} {unit}".rstrip()
        yield f"It costs {costs} of minMPJPE, which rewards a spread that is too narrow."


def _difference(label: str, value: float, low: float, high: float, p: float, unit: str) -> str:
    digits = 2 if unit else 4
    chance = "" if math.isnan(p) else f", {p_value(p)}"
    ends = "" if math.isnan(low) else f" ({low:+.{digits}f} to {high:+.{digits}f}{chance})"
    return f"{label} {value:+.{digits}f} {unit}".rstrip() + ends


def _of_modes(joints: tuple[str, ...], modes: Modes | None, unit: str) -> Iterator[str]:
    """Name the joints with several modes, and what to do."""
    if modes is None or not modes.several.any():
        return
    shares, apart = modes.share[modes.several], modes.apart[modes.several]
    named = several([joint for joint, has_some in zip(joints, modes.several, strict=True) if has_some])
    distance = f"{short_number(float(np.median(apart)), unit)} {unit}".rstrip()
    least, most = f"{shares.min():.0%}", f"{shares.max():.0%}"
    share = least if least == most else f"{least} to {most}"
    yield (
        f"Several modes at {named}: in {share} of poses, about {distance} apart. A factor about their median moves the "
        f"modes themselves; {option('about', 'modes')} rescales each about its own centre."
    )


def radius_sheet(
    radii: Mapping[str, float],
    poses: int,
    alpha: float,
    unit: str,
    coverage: Mapping[str, float] | None = None,
    remarks: Iterable[str] = (),
) -> Sheet:
    """Lay out fitted radii, and the share of held-out truths within them.

    Parameters
    ----------
    radii : mapping of float
        The radius of each joint; NaN for joints without.
    poses : int
        The number of poses that they were fitted on.
    alpha : float
        The share of truths outside.
    unit : str
        Of the radii; empty where the data have none.
    coverage : mapping of float, optional
        Of held-out sequences: the share of truths within, by joint.
    remarks : iterable of str
        On the data.
    """
    known = {joint: radius for joint, radius in radii.items() if not math.isnan(radius)}
    sentences = [f"Radii about the median that hold {1 - alpha:.0%} of the truths of {poses:,} poses."]
    headings = ["joint", f"radius, {unit}" if unit else "radius"]
    rows: list[tuple[str, ...]] = [(joint, f"{radius:.2f}") for joint, radius in known.items()]
    if coverage is None:
        sentences.append("Not judged: --split says how many truths they hold in sequences they were not fitted on.")
    else:
        headings.append("held-out coverage")
        rows = [(joint, radius, f"{coverage[joint]:.3f}") for joint, radius in rows]
    return Sheet("Conformal radii", sentences, list(remarks), [Table("Radii", headings, rows)])
