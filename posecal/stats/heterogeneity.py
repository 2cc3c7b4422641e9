"""Differences between sequences: how far each one's calibration curve is off, and whether it is so throughout.

A model may be too narrow in one sequence and too wide in another, and right on average. Sums per sequence show that
sequences deviate to both sides, and not why: so do those of a calibrated sampler whose frames resemble each other.
Two things can be said. How few independent frames a sequence would have to count as, if nothing but chance were behind
its deviation; and, from values of single poses, whether the beginning and the end of a sequence are off alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posecal.calibration.curve import joint_median, signed_area
from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import FloatArray
from posecal.engine.metric import Metric, Statistic
from posecal.engine.sums import Indices, mean_of
from posecal.engine.totals import Totals
from posecal.stats.resampling import LEVEL, MIN_SEQUENCES, STRONG
from posecal.stats.uncertainty import sequence_deviations

MIN_FRAMES = 10
"""Sequences of fewer frames are not looked at: a single pose has a signed area anywhere from −0.5 to 0.5."""

DRAWS = 999
"""Random pairings of beginnings and ends."""

WIDE = 0.1
"""Where sequences are not shown to differ, a remark says that they may if their signed areas span twice this."""

CROWDED = 3.0
"""And if their variance is so many times that of independent frames, 1/12 over the number of frames."""

RISING = 1.25
"""Where the variogram within sequences at a third of their length is more than so many times that at a sixth, the
correlation of frames reaches from end to end."""


COLUMNS, SHOWN = '"if calibrated" and "up to" (…_null) are', "what a calibrated sampler would show is"
"""What is said of a calibrated sampler in reports, and in comparisons."""


@dataclass(frozen=True)
class SequenceAreas:
    """Signed areas of single sequences.

    Attributes
    ----------
    names : tuple of str
        The sequences of at least :data:`MIN_FRAMES` frames.
    areas : array (S,)
        Their signed areas; negative is overconfident.
    frames : float
        Their mean number of frames.
    """

    names: tuple[str, ...]
    areas: FloatArray
    frames: float

    @property
    def independent_frames(self) -> float:
        r"""Independent frames that a sequence counts as at most, if the model is calibrated in each.

        .. math:: \frac{1}{12} \Big/ \frac{1}{S} \sum_s A_s^2

        The signed area of n independent frames of a calibrated sampler is ½ less a mean of uniform ranks, of variance
        1/12n where all joints have the same rank, and smaller otherwise.
        """
        square = float((self.areas**2).mean()) if self.areas.size else np.nan
        return 1 / (12 * square) if square > 0 else np.inf


NO_AREAS = SequenceAreas((), np.zeros(0), float("nan"))
"""Of no sequence."""


def sequence_areas(totals: Totals, metric: Metric) -> SequenceAreas:
    """Signed area of the calibration curve of each sequence.

    Parameters
    ----------
    totals : Totals
        The sums.
    metric : Metric
        The ECE: of the median of joints, or pooled.

    Returns
    -------
    SequenceAreas
        Without sequences of fewer than :data:`MIN_FRAMES` frames; of no sequence where frames have no sequence labels.
    """
    if metric.deviation is None:
        raise ValueError(f"{metric.name} is no calibration error")
    judged = slice(metric.deviation.first, metric.deviation.last)
    deviations, counts = sequence_deviations(totals, metric.statistic, None, metric.offset, judged)
    frames = counts.max(axis=1, initial=0)
    long = (frames >= MIN_FRAMES) & totals.has_sequences
    if not long.any():
        return NO_AREAS
    curves = joint_median(mean_of(deviations[long], counts[long])) + LEVELS
    names = np.unique(totals.cells["sequence"])[long]
    return SequenceAreas(tuple(map(str, names)), np.asarray(signed_area(curves)), float(frames[long].mean()))


def sequences_differ(totals: Totals, metrics: Mapping[str, Metric]) -> tuple[SequenceAreas, float]:
    """Give the signed areas of single sequences, and :func:`sequences_differ_p`; no sequence and NaN without an ECE."""
    if "ece" not in metrics:
        return NO_AREAS, float("nan")
    kept = metrics.get("spread_error_correlation")
    areas = sequence_areas(totals, metrics["ece"])
    p = sequences_differ_p(totals, kept.statistic) if kept is not None and len(areas.names) > 1 else float("nan")
    return areas, p


def remark_on_differences(areas: SequenceAreas, p: float, chance: str = COLUMNS) -> str:
    """Say that what a calibrated sampler shows is of one whose sequences differ, or may; empty where not.

    They may where signed areas vary by more than those of a third of their frames would, if these were independent.
    """
    if p < STRONG:
        shown = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
        return f"sequences differ ({shown}): {chance} of a model whose sequences differ as much."
    found = areas.areas
    if p >= LEVEL or len(found) < 2 or np.ptp(found) < 2 * WIDE or 12 * found.var() * areas.frames <= CROWDED:
        return ""
    shown = "not testable here" if np.isnan(p) else f"weak evidence, p = {p:.3f}"
    return f"if sequences differ ({shown}), {chance} too large."


def sequences_differ_p(totals: Totals, statistic: Statistic) -> float:
    """Test whether poses err more for their spread in some sequences than in others, from beginning to end.

    Parameters
    ----------
    totals : Totals
        With the values of all poses of the statistic, in the order of the frames.
    statistic : Statistic
        Predicted spread and error of each pose.

    Returns
    -------
    float
        p-value; NaN without sequence labels, or with fewer than six sequences of at least :data:`MIN_FRAMES` frames.
    """
    if not totals.has_sequences or statistic.name not in totals.per_pose:
        return float("nan")
    poses = totals.known_poses(statistic)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(np.divide(*totals.per_pose[statistic.name][poses, ::-1].T))
    finite = np.isfinite(ratio)
    return persistence_p(ratio[finite], totals.sequence_of[totals.cell_of[poses[finite]]])


def persistence_p(values: FloatArray, sequence: Indices, *, draws: int = DRAWS, seed: int = 0) -> float:
    r"""Test whether the first and the last third of sequences resemble each other.

    .. math:: \sum_s (a_s - \bar a)(b_s - \bar b)

    of the means a over the first and b over the last third of each sequence's frames, against random pairings of a and
    b. What neighbouring frames share is not shared by the ends of a long sequence; a property of the sequence is.

    Parameters
    ----------
    values : array (M,)
        One value of each pose, in the order of the frames.
    sequence : array of int (M,)
        The sequence of each.
    draws : int
        Random pairings.
    seed : int
        Of the generator.

    Returns
    -------
    float
        One-sided p-value, at least 1 / (draws + 1); NaN with fewer than six sequences of at least :data:`MIN_FRAMES`
        frames, and where the correlation of frames reaches from end to end: half the mean squared difference of two
        frames, which no property of their sequence changes, still rises by :data:`RISING` from a sixth to a third of
        the length.

    Notes
    -----
    A calibrated sampler whose frames are correlated throughout a sequence can't be distinguished from a model that is
    off in single sequences, by any test. Differs from the published code: none; ours.

    Examples
    --------
    >>> values = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 12)
    >>> persistence_p(values, np.repeat(np.arange(7), 12)) < 0.01
    True
    """
    order, place, n = _ordered(sequence)
    values, sequence = values[order], sequence[order]
    thirds = _thirds(values, sequence, place, n)
    if len(thirds) < MIN_SEQUENCES or _rises(values, place, n):
        return float("nan")
    first, _, last = (thirds - thirds.mean(axis=0)).T
    ends = first @ last
    random = np.random.default_rng(seed)
    paired = np.array([first @ random.permutation(last) for _ in range(draws)])
    return float((1 + (paired >= ends * (1 - 1e-9)).sum()) / (draws + 1))


def _ordered(sequence: Indices) -> tuple[Indices, Indices, Indices]:
    """Frames sorted by sequence, the place of each in its sequence, and the sequence's length beside it."""
    n = np.bincount(sequence)
    order = np.argsort(sequence, kind="stable")
    length = np.repeat(n, n)
    return order, np.arange(len(order)) - np.repeat(np.cumsum(n) - n, n), length


def _thirds(values: FloatArray, sequence: Indices, place: Indices, n: Indices) -> FloatArray:
    """Means over each third of the frames of each sequence that is long enough, (S, 3)."""
    long = n >= MIN_FRAMES
    cell = 3 * np.unique(sequence[long], return_inverse=True)[1] + (3 * place // n)[long]
    return np.asarray(np.bincount(cell, values[long]) / np.bincount(cell)).reshape(-1, 3)


def _rises(values: FloatArray, place: Indices, n: Indices) -> bool:
    """Whether the variogram within sequences rises from a sixth to a third of their length."""
    squares = []
    for lag in (n // 6, 2 * (n // 6)):
        at = np.flatnonzero((n >= MIN_FRAMES) & (place + lag < n))
        squares.append(float(((values[at + lag[at]] - values[at]) ** 2).mean()))
    return squares[1] > RISING * squares[0]
