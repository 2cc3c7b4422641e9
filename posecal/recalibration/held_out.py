"""What a spread factor does to sequences that it was not fitted on.

Proper scores are means over poses, so those of held-out parts are pooled and compared, paired by sequence. The ECE is
not: a factor that is too large for one part was fitted on parts for which it is too small, so deviations of held-out
parts cancel in one pooled curve. What new sequences show is drawn from halves instead: fitted on a random half of the
sequences, the deviation of the other half has twice the variance that a fit on all has on as many new sequences, so it
is shrunk by √2 about its mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from posecal.calibration.curve import ece_over_joints
from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.frames import frame_remark
from posecal.data.pose_data import PoseData
from posecal.data.stored_poses import Rows
from posecal.engine.merge import merge_totals
from posecal.engine.presets import as_protocol
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.evaluation.call import evaluate
from posecal.evaluation.sources import Source, as_pose_data
from posecal.recalibration import folds as parts
from posecal.recalibration.dispersion import (
    FACTORS,
    About,
    Counts,
    best_factors,
    curve_sums,
    finished_map,
    joints_about_modes,
)
from posecal.recalibration.effect import changes_between, objections
from posecal.recalibration.spread_map import SpreadMap
from posecal.report.comparison import compare_totals
from posecal.report.report import Report
from posecal.stats.pairs import VALUE, Difference
from posecal.stats.resampling import MIN_SEQUENCES

DEFAULT = Protocol(metrics="default, energy_score, crps")
"""What is measured by default."""

JUDGED = ("energy_score", "crps", "signed_area")
"""What speaks against a map, measured whatever else is."""

MOST_PARTS = 60
"""Where there are more sequences, some are put together, so that the curves of all factors fit the memory."""

HALVES = 200
"""So many random halves are fitted on."""


@dataclass(frozen=True)
class HeldOut:
    """A spread factor, fitted on all sequences and judged on held-out ones.

    Attributes
    ----------
    fitted : SpreadMap
        Fitted on all.
    folds : int
        Parts into which the sequences were cut.
    factors : list of arrays (K,)
        Of each part, fitted on the others.
    before, after : Report
        Over all poses: as they are, and each rescaled by the factor of the other parts. Its ECE is too small.
    new_ece : float
        In nine of ten cases the ECE of as many new sequences, rescaled by the fitted map, is at most this; NaN with
        fewer than six labelled sequences.
    """

    fitted: SpreadMap
    folds: int
    factors: list[FloatArray]
    before: Report
    after: Report
    new_ece: float

    @property
    def objections(self) -> tuple[str, ...]:
        """Why the map should not be used, by what it changes on held-out sequences; empty for none."""
        return objections(changes_between(self.before, self.after), self.fitted.data_unit)

    def difference(self, metric: str) -> Difference:
        """Give after minus before of a metric on held-out sequences, paired by sequence.

        Without labelled sequences it has neither an interval nor a p-value.
        """
        if not self.before.totals.has_sequences:
            value, unknown = self.after[metric] - self.before[metric], math.nan
            ends, p = (unknown, unknown), (unknown, unknown)
            return Difference(metric, "after", "before", VALUE, value, *ends, *p, None, False)
        both = compare_totals([self.after.totals, self.before.totals], ["after", "before"])
        (difference,) = both.differences_of(metric)
        return difference


def judge_spread(
    hypotheses: Source | PoseData,
    truth: Source | None = None,
    /,
    *,
    protocol: Protocol | str | None = None,
    folds: int = 5,
    per_joint: bool = False,
    about: About = "median",
    threads: int | None = None,
    **described: Any,
) -> HeldOut:
    """Fit a spread factor on all sequences, and judge it on sequences that it was not fitted on.

    Parameters
    ----------
    hypotheses, truth, per_joint, about, threads, **described
        As for :func:`posecal.recalibration.fit_spread`.
    protocol : Protocol or str, optional
        What is measured; the default metrics by default. Energy score, CRPS and signed area always are: objections
        to the map rest on them.
    folds : int
        Parts into which the sequences are cut; each is rescaled by a factor fitted on the others.

    Returns
    -------
    HeldOut
        The map, reports of held-out sequences before and after, and how large the ECE of new ones may be.

    Raises
    ------
    PoseDataError
        For one hypothesis, and fewer sequences than parts.

    Notes
    -----
    The docs show in simulations how often new sequences keep within what is said of them. Differs from the published
    code: none; ours.
    """
    data = parts.select_fitted(as_pose_data(hypotheses, truth, described))
    fold_of, frames = parts.folds_of(data, folds), frame_remark(data)
    part_of, fold_of_part = _parts_within(data, fold_of)
    modal = joints_about_modes(data, about, threads)
    sums, counts = curve_sums(data, part_of, modal, threads)
    names = tuple(np.array(data.joints)[modal].tolist())

    def fit(some: BoolArray) -> FloatArray:
        of_some = sums[some].sum(axis=0), counts[some].sum(axis=0)
        return best_factors(*of_some, data.joints, per_joint=per_joint, frames=frames)

    totals, factors, chosen = [], list[FloatArray](), as_protocol(DEFAULT if protocol is None else protocol)
    measured = as_protocol(chosen, [*dict.fromkeys((*chosen.wanted, *JUDGED))])
    for fold in range(folds):
        factors.append(fit(fold_of_part != fold))
        held_out = data.select(np.flatnonzero(fold_of == fold))
        moved = SpreadMap(data.joints, factors[-1], 0, 0, data_unit=data.unit, modal=names).rescale(held_out)
        totals.append(evaluate(moved, protocol=measured, threads=threads).totals)
    before = evaluate(data, protocol=measured, threads=threads)
    fitted = finished_map(data, fit(fold_of_part >= 0), modal, threads, before if protocol is None else None)
    labelled = "sequence" in data.labels
    new_ece = _ece_of_new(sums, counts, data.joints, per_joint=per_joint) if labelled else math.nan
    return HeldOut(fitted, folds, factors, before, Report(merge_totals(totals)), new_ece)


def _parts_within(data: PoseData, fold_of: Rows) -> tuple[Rows, Rows]:
    """Cut each fold between its sequences: the part of each pose (M,), and the fold of each part (P,)."""
    if "sequence" not in data.labels:
        return fold_of, np.arange(fold_of.max() + 1)
    sequence = np.unique(data.labels["sequence"], return_inverse=True)[1]
    fold_of_sequence = np.zeros(sequence.max() + 1, dtype=np.intp)
    fold_of_sequence[sequence] = fold_of
    folds = int(fold_of.max()) + 1
    each = max(1, MOST_PARTS // folds)
    number = np.zeros_like(fold_of_sequence)
    for fold in range(folds):
        members = np.flatnonzero(fold_of_sequence == fold)
        number[members] = np.arange(len(members)) % each
    parts_of, part_of_sequence = np.unique(fold_of_sequence * each + number, return_inverse=True)
    return part_of_sequence[sequence], parts_of // each


def _ece_of_new(sums: FloatArray, counts: Counts, joints: tuple[str, ...], *, per_joint: bool, seed: int = 0) -> float:
    """Bound of the ECE of as many new sequences in nine of ten cases, from sums (P, G, K, Q) of the parts' curves."""
    number = len(sums)
    if number < MIN_SEQUENCES:
        return math.nan
    random, curves = np.random.default_rng(seed), list[FloatArray]()
    for _ in range(HALVES // 2):
        half = np.zeros(number, dtype=bool)
        half[random.permutation(number)[: number // 2]] = True
        for fitted in (half, ~half):
            try:
                factors = best_factors(
                    sums[fitted].sum(axis=0), counts[fitted].sum(axis=0), joints, per_joint=per_joint
                )
            except PoseDataError:  # no factor calibrates this half
                return math.nan
            curves.append(_curve_at(factors, sums[~fitted].sum(axis=0), counts[~fitted].sum(axis=0)))
    deviations = np.stack(curves)[:, counts.any(axis=0)] - LEVELS  # (H, K, Q), of the joints that count
    mean = deviations.mean(axis=0)
    few = math.sqrt(number / (number - 2))  # a heavier tail where few sequences show how much they differ
    drawn = mean + few * (deviations - mean) / math.sqrt(2) + LEVELS
    pooled = np.zeros_like(drawn[:, :1])  # the last row of a table, which the median over joints does not read
    errors = ece_over_joints(np.concatenate([drawn, pooled], axis=1), "median")
    return float(np.quantile(errors, 0.95))


def _curve_at(factors: FloatArray, sums: FloatArray, counts: Counts) -> FloatArray:
    """Curves (K, Q) at some factors, interpolated between those that were tried (G, K, Q); NaN where none counts."""
    place = np.log(factors / FACTORS[0]) / np.log(FACTORS[1] / FACTORS[0])
    below = np.clip(place.astype(np.intp), 0, len(sums) - 2)
    share, joint = (place - below)[:, None], np.arange(len(factors))
    at = (1 - share) * sums[below, joint] + share * sums[below + 1, joint]
    return np.asarray(at / np.where(counts > 0, counts, np.nan)[:, None])
