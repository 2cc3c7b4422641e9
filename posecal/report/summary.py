"""Sentences: what the numbers of a report say about calibration, and remarks on what they rest on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from posecal.data.frames import DIFFERENT_FRAMES
from posecal.engine.totals import Totals
from posecal.errors import first_few, for_python
from posecal.metrics.occlusion import occlusion_words
from posecal.registry import left_out
from posecal.report.evidence import evidence_of
from posecal.report.sentences import sentences
from posecal.stats.resampling import MIN_SEQUENCES

if TYPE_CHECKING:
    from posecal.report.report import Report

FEW_HYPOTHESES = 20
"""With fewer hypotheses than this a perfect sampler's ECE (paper) is above 0.018, however many poses there are."""


def remarks(report: Report, words: Callable[[str], str] = for_python) -> tuple[str, ...]:
    """Say what a careful reader should know about the data and about what can be tested on them.

    Parameters
    ----------
    report : Report
        The numbers.
    words : callable
        How options are named: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.
    """
    return tuple(words(remark) for remark in (*report.totals.remarks, *_of_statistics(report)))


def _of_statistics(report: Report) -> Iterator[str]:
    totals, units = report.totals, report.totals.units()
    if not totals.has_sequences:
        consecutive = units.replace("of frames", "of consecutive frames")
        are = "is" if totals.n_sequences == 1 else "are"
        yield f"no sequence labels: {consecutive} {are} taken as independent. In a video they are not."
    sequences = totals.n_sequences
    if sequences < MIN_SEQUENCES:
        yield (
            f"{units} allow{'s' * (sequences == 1)} no test: even if all err alike, chance would do that in "
            f"{2 / 2**sequences:.0%} of cases. At least {MIN_SEQUENCES} are needed for a p-value."
        )
    if (average := totals.protocol.average) != "poses":
        groups = [value for value, _ in totals.groups(average)]
        yield f"numbers are means over {len(groups):,} values of {average} ({first_few(groups, 5)})."
    steps = {name: m.statistic for name, m in report.metrics.items() if m.statistic.earlier == 1}
    if steps and totals.has_sequences and totals.poses.sum() > sequences and not any(map(totals.count, steps.values())):
        yield (
            f"{next(iter(steps))}: no value, because no frame comes right after another of its sequence; expected the "
            "frames of each sequence one after another, or a frame_id with their numbers."
        )
    if line := left_out(totals.protocol, totals.spec):
        yield line
    if "occlusion" in report.by:
        yield occlusion_words(totals.protocol, totals.spec)
    n = totals.spec.n_hypotheses
    if n < 2:
        yield "calibration and spread need at least 2 hypotheses; there is 1."
    elif n < FEW_HYPOTHESES and any(metric.family == "calibration" for metric in report.metrics.values()):
        yield f"N = {n} hypotheses are few: look at what a perfect sampler would show before reading an ECE (paper)."


def summarize(report: Report) -> list[str]:
    """Say in sentences what is shown about calibration, by :data:`posecal.report.sentences.RULES`.

    Parameters
    ----------
    report : Report
        The numbers.

    Returns
    -------
    list of str
        Sentences; none without calibration.

    Examples
    --------
    >>> import numpy as np
    >>> from posecal.evaluation import evaluate
    >>> summarize(evaluate(np.zeros((1, 8, 2, 3)), np.zeros((8, 2, 3)), unit="mm"))
    []
    """
    if not {"ece", "signed_area"} <= report.metrics.keys() or math.isnan(report["ece"]):
        return []
    if frames_differ(report.totals):
        return []  # what a curve says then is about axes, not about the model
    return list(sentences(evidence_of(report)))


def frames_differ(totals: Totals) -> bool:
    """Whether a remark says that the coordinate frames of hypotheses and truth differ."""
    return any(remark.startswith(DIFFERENT_FRAMES) for remark in totals.remarks)
