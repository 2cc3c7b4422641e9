"""Confidence intervals and null distributions from per-sequence sums."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from posecal.calibration.error import FEW_HYPOTHESES
from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import FloatArray
from posecal.engine.measure import EFFECTIVE_NUMBER
from posecal.engine.metric import Metric, Statistic
from posecal.engine.scope import DataSpec
from posecal.engine.sums import Cells, Counts, Indices, slices
from posecal.engine.totals import Totals
from posecal.stats.jackknife import (
    Interval,
    degrees_of_freedom,
    jackknife,
    jackknife_columns,
    joint_leave_one_out,
    joint_sequence_sizes,
    leave_one_out,
    sequence_sizes,
)
from posecal.stats.resampling import LEVEL, Null, counting, n_patterns, sign_flips, sign_flips_of_each, thin

BIAS = 0.6
"""Over the effective number of hypotheses, about the largest ECE of calibrated draws of a proposal with weights."""

FEW_DRAWS = 500
"""Sign patterns of each p-value without a sequence."""


def interval(totals: Totals, metric: Metric, cells: Cells = None, value: float | None = None) -> Interval:
    """Compute the 95 % interval of a metric over the sequences among some cells.

    Parameters
    ----------
    totals : Totals
        The sums.
    metric : Metric
        A mean or anything computed from means; not a calibration error, which is never below 0 and has a
        :func:`null` instead.
    cells : array of int, optional
        Indices of the cells; all by default. Sequences without a pose that counts are left out.
    value : float, optional
        The metric over these cells, where it is known.

    Returns
    -------
    Interval
        Within the bounds of the metric; NaN ends where fewer than three sequences have poses that count.
    """
    value = totals.value(metric, cells) if value is None else value
    without, sizes = leave_one_out(totals, metric, cells), sequence_sizes(totals, metric, cells)
    return jackknife(value, without, sizes, metric.bounds)


def joint_intervals(totals: Totals, metric: Metric, cells: Cells = None) -> tuple[FloatArray, FloatArray]:
    """Compute the 95 % intervals of a metric at each joint, over the sequences in which the joint counts.

    Parameters
    ----------
    totals, metric, cells
        As for :func:`interval`, of a metric that has values per joint.

    Returns
    -------
    low, high : arrays (K,)
        Their ends; NaN where there are fewer than three sequences.
    """
    values = totals.by_joint(metric, cells)
    found = jackknife_columns(values, *joint_leave_one_out(totals, metric, cells), metric.bounds)
    return found.low, found.high


def freedom_of(totals: Totals, metric: Metric, joint: int | None = None) -> float:
    """Give the degrees of freedom of an :func:`interval` over all cells, or of one of :func:`joint_intervals`."""
    if joint is None or metric.by_joint is None:
        sizes = sequence_sizes(totals, metric)
    else:
        sizes = joint_sequence_sizes(totals, metric.by_joint[0])[:, joint].astype(np.float64)
    return float(degrees_of_freedom(sizes[:, None])[0])


def null(totals: Totals, metric: Metric, cells: Cells = None) -> Null:
    """Compare a calibration error with what a calibrated sampler would show, by sequence sign-flips.

    Parameters
    ----------
    totals, metric, cells
        As for :func:`interval`, of a metric that has a ``deviation``.

    Returns
    -------
    Null
        NaN p where there are too few sequences, and where :func:`weights_allow_no_test`.
    """
    if metric.deviation is None:
        raise ValueError(f"{metric.name} is no calibration error")
    judged = slice(metric.deviation.first, metric.deviation.last)
    deviations, counts, curves = _judged_deviations(totals, metric.statistic, cells, metric.offset, judged)
    whole = replace(metric.deviation, first=None, last=None)
    errors = _errors_of(totals, metric, cells, curves)
    n = effective_hypotheses(totals)
    test = sign_flips(
        deviations, counts, whole, offset=metric.offset, errors=errors, n=n, slack=bias_of_weights(totals)
    )
    if are_points(totals, metric, cells) or weights_allow_no_test(totals):
        return Null(test.observed, math.nan, math.nan, math.nan, math.nan, test.sequences)
    return test


def are_points(totals: Totals, metric: Metric, cells: Cells = None) -> bool:
    """Whether the hypotheses of each pose are all the same, so that there is no spread to be calibrated."""
    statistic = None if metric.deviation is None else metric.deviation.errors
    if statistic is None or statistic.name not in totals.sums:
        return False
    sums, counts = totals.of_cells(statistic, cells)
    return bool(counts.any() and not sums[..., 0].any())


def _errors_of(totals: Totals, metric: Metric, cells: Cells, curves: Indices) -> FloatArray | None:
    """Sum the standardized errors over each sequence, (S, J, 3), or of the joints that all curves are about."""
    statistic = None if metric.deviation is None else metric.deviation.errors
    if statistic is None or statistic.name not in totals.sums:
        return None
    errors = totals.by_sequence(statistic, cells)[0][..., 1:4]
    rows, *inner, _ = totals.sums[metric.statistic.name].shape[1:]
    joints = curves // int(np.prod(inner, dtype=int))
    is_per_joint = rows == errors.shape[1] + (not inner)  # with the pooled curve, or of each axis
    return errors[:, joints] if is_per_joint and (joints < errors.shape[1]).all() else errors


def p_without_each(totals: Totals, metric: Metric) -> FloatArray:
    """Give the p-value of a calibration error with each sequence left out, from fewer sign patterns than that of all.

    Parameters
    ----------
    totals, metric
        As for :func:`null`.

    Returns
    -------
    array (S,)
        NaN where the others are too few.
    """
    assert metric.deviation is not None
    judged = slice(metric.deviation.first, metric.deviation.last)
    deviations, counts = sequence_deviations(totals, metric.statistic, None, metric.offset, judged)
    over = replace(metric.deviation, first=None, last=None)
    others = (np.arange(len(counts)) != s for s in range(len(counts)))
    flips = partial(sign_flips, offset=metric.offset, draws=FEW_DRAWS, slack=bias_of_weights(totals))
    nulls = (flips(deviations[s], counts[s], over) for s in others)
    return np.array([each.p for each in nulls])


def joint_p_values(totals: Totals, metric: Metric, cells: Cells = None) -> FloatArray:
    """Test the calibration curve of each joint by sequence sign-flips, all joints at once.

    Parameters
    ----------
    totals, metric, cells
        As for :func:`null`, of a metric whose statistic has a row per joint and one more, such as ``ece``.

    Returns
    -------
    array (K,)
        p-values, not adjusted for their number; NaN where the joint counts in too few sequences, and where there are
        so many joints for so few sign patterns that none could be significant after the adjustment (a mesh, say).
    """
    joints = int((totals.counts[metric.statistic.name][:, :-1] > 0).any(axis=0).sum())
    few = joints > LEVEL * n_patterns(totals.n_sequences, joints * LEVELS.size)
    if few or are_points(totals, metric, cells) or weights_allow_no_test(totals):
        return np.full(len(totals.spec.joints), np.nan)
    deviations, counts = sequence_deviations(totals, metric.statistic, cells, metric.offset)
    slack = bias_of_weights(totals)
    return sign_flips_of_each(deviations[:, :-1], counts[:, :-1], offset=metric.offset, slack=slack)


def effective_sample_size(totals: Totals, statistic: Statistic, cells: Cells = None) -> float:
    """Estimate how many independent poses would have calibration curves that vary as much as those of the sequences."""
    deviations, counts = sequence_deviations(totals, statistic, cells)
    return effective_poses(deviations[:, :-1], counts[:, :-1])


def effective_hypotheses(totals: Totals) -> float:
    """Mean over poses of the effective number of hypotheses: N where all have the same weight, and none is absent."""
    known = EFFECTIVE_NUMBER.name in totals.sums
    return float(totals.mean(EFFECTIVE_NUMBER)) if known else float(totals.spec.n_hypotheses)


def measured_spec(totals: Totals) -> DataSpec:
    """What is measured, with the mean effective number of hypotheses where poses have different ones."""
    spec = totals.spec
    varies = spec.is_ragged or spec.has_weights
    return replace(spec, n_effective=effective_hypotheses(totals)) if varies else spec


def weights_allow_no_test(totals: Totals) -> bool:
    """Whether weights are unequal and of so small an effective number that calibrated models have an ECE above 0.

    No p-value knows of that: ranks of weighted hypotheses are right only in the limit of a large effective number.
    """
    return totals.spec.has_weights and effective_hypotheses(totals) < FEW_HYPOTHESES


def bias_of_weights(totals: Totals) -> float:
    """Give about the largest ECE that weights leave draws that are calibrated, of endless data; 0 without weights."""
    return BIAS / effective_hypotheses(totals) if totals.spec.has_weights else 0.0


def unbiased_squared_error(totals: Totals, statistic: Statistic, cells: Cells = None) -> float:
    """Mean squared distance of the joints' curves from the diagonal, without what chance adds."""
    deviations, counts = sequence_deviations(totals, statistic, cells)
    return squared_error(deviations[:, :-1], counts[:, :-1])


def sequence_deviations(
    totals: Totals,
    statistic: Statistic,
    cells: Cells = None,
    offset: FloatArray | None = None,
    judged: slice | None = None,
) -> tuple[FloatArray, Counts]:
    """Sum the deviations from calibration over each sequence, (S, J, Q), and their counts (S, J).

    Of all curves, or of those that a test judges: at most :data:`posecal.stats.resampling.MESH` of a range of them.
    """
    return _judged_deviations(totals, statistic, cells, offset, judged)[:2]


def _judged_deviations(
    totals: Totals, statistic: Statistic, cells: Cells, offset: FloatArray | None, judged: slice | None
) -> tuple[FloatArray, Counts, Indices]:
    sums, counts = totals.by_sequence(statistic, cells)
    inner = int(np.prod(sums.shape[2:-1], dtype=int))  # axes of a joint, say
    counts = np.repeat(counts, inner, axis=1)
    sums = sums.reshape(len(sums), counts.shape[1], LEVELS.size)
    curves = np.arange(counts.shape[1])
    if judged is not None:
        curves = curves[judged][thin(counts[:, judged])]
        sums, counts = sums[:, curves], counts[:, curves]
    expected = LEVELS if offset is None else LEVELS + offset
    return sums - counts[..., None] * expected, counts, curves


# --- variance between sequences -----------------------------------------------------------------------------------


def _variances(deviations: FloatArray, counts: Counts) -> tuple[FloatArray, FloatArray]:
    """Mean deviations (J, Q), and their variances over sequences."""
    S, total = len(deviations), counts.sum(axis=0)[:, None]
    mean = deviations.sum(axis=0) / total
    squares = np.zeros(mean.shape)
    for some in slices(S, mean.nbytes):
        squares += ((deviations[some] - counts[some, :, None] * mean) ** 2).sum(axis=0)
    return mean, S / (S - 1) * squares / total**2


def squared_error(deviations: FloatArray, counts: Counts) -> float:
    r"""Mean squared distance of the curves from the diagonal, without what chance adds to it.

    .. math:: \operatorname{mean}_{k,q} \big( (\omega_k(q) - q)^2 - \widehat{\operatorname{Var}}\, \omega_k(q) \big)

    Parameters
    ----------
    deviations, counts
        As for :func:`posecal.stats.resampling.sign_flips`.

    Returns
    -------
    float
        About 0 for a calibrated model, on either side; NaN with fewer than two sequences.

    Notes
    -----
    Differs from the published code: none; ours.

    Examples
    --------
    >>> squared_error(np.full((4, 1, 21), 0.5), np.ones((4, 1), int))
    0.25
    """
    deviations, counts = counting(deviations, counts)
    if len(deviations) < 2:
        return float("nan")
    mean, variance = _variances(deviations, counts)
    return float((mean**2 - variance).mean())


def effective_poses(deviations: FloatArray, counts: Counts) -> float:
    r"""Number of independent poses whose calibration curve would vary as much as that of these sequences.

    .. math:: \sum_{k,q} \omega_k(q) (1 - \omega_k(q)) \Big/ \sum_{k,q} \widehat{\operatorname{Var}}\, \omega_k(q)

    Parameters
    ----------
    deviations, counts
        As for :func:`posecal.stats.resampling.sign_flips`.

    Returns
    -------
    float
        At most as many as there are poses; NaN with fewer than two sequences.

    Notes
    -----
    Differs from the published code: none; ours.

    Examples
    --------
    Two sequences that deviate oppositely, whatever their number of frames, count as about two poses.

    >>> deviations = np.stack([np.full((1, 21), 3.0), np.full((1, 21), -3.0)])
    >>> round(effective_poses(deviations, np.full((2, 1), 10)), 1)
    1.9
    """
    deviations, counts = counting(deviations, counts)
    if len(deviations) < 2:
        return float("nan")
    mean, variance = _variances(deviations, counts)
    inner = slice(1, LEVELS.size - 1)
    coverage = np.clip(mean + LEVELS, 0, 1)[:, inner]
    chance = variance[:, inner].sum()
    poses = float(counts.sum(axis=0).max())
    return min(poses, float((coverage * (1 - coverage)).sum() / chance)) if chance > 0 else poses
