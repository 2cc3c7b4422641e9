"""Confidence intervals and null distributions from per-sequence sums."""

from __future__ import annotations

import numpy as np

from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import FloatArray
from posecal.engine.metric import Metric, Statistic
from posecal.engine.totals import Cells, Counts, Totals
from posecal.stats.jackknife import Interval, jackknife, jackknife_columns, joint_leave_one_out, leave_one_out
from posecal.stats.resampling import Null, effective_poses, sign_flips, sign_flips_of_each, squared_error


def interval(totals: Totals, metric: Metric, cells: Cells = None) -> Interval:
    """Compute the 95 % interval of a metric over the sequences among some cells.

    Parameters
    ----------
    totals : Totals
        The sums.
    metric : Metric
        A mean or anything finished from means; not a calibration error, which is never below 0 and has a
        :func:`null` instead.
    cells : array of int, optional
        Indices of the cells whose sequences count; all by default.

    Returns
    -------
    Interval
        NaN ends where there are fewer than two sequences.
    """
    return jackknife(totals.value(metric, cells), leave_one_out(totals, metric, cells))


def joint_intervals(totals: Totals, metric: Metric, cells: Cells = None) -> tuple[FloatArray, FloatArray]:
    """Compute the 95 % intervals of a metric at each joint, over the sequences in which the joint counts.

    Parameters
    ----------
    totals, metric, cells
        As for :func:`interval`, of a metric that has values per joint.

    Returns
    -------
    low, high : arrays (K,)
        Their ends; NaN where there are fewer than two sequences.
    """
    values = totals.by_joint(metric, cells)
    _, reach = jackknife_columns(*joint_leave_one_out(totals, metric, cells))
    return values - reach, values + reach


def null(totals: Totals, metric: Metric, cells: Cells = None) -> Null:
    """Compare a calibration error with what a calibrated sampler would show, by sequence sign-flips.

    Parameters
    ----------
    totals, metric, cells
        As for :func:`interval`, of a metric that has a ``deviation``.

    Returns
    -------
    Null
        NaN p where there are too few sequences.
    """
    if metric.deviation is None:
        raise ValueError(f"{metric.name} is no calibration error")
    deviations, counts = sequence_deviations(totals, metric.statistic, cells, metric.offset)
    return sign_flips(deviations, counts, metric.deviation, offset=metric.offset)


def joint_p_values(totals: Totals, metric: Metric, cells: Cells = None) -> FloatArray:
    """Test the calibration curve of each joint by sequence sign-flips, all joints at once.

    Parameters
    ----------
    totals, metric, cells
        As for :func:`null`, of a metric whose statistic has a row per joint and one more, such as ``ece``.

    Returns
    -------
    array (K,)
        p-values, not adjusted for their number; NaN where the joint counts in too few sequences.
    """
    deviations, counts = sequence_deviations(totals, metric.statistic, cells, metric.offset)
    return sign_flips_of_each(deviations[:, :-1], counts[:, :-1], offset=metric.offset)


def effective_sample_size(totals: Totals, statistic: Statistic, cells: Cells = None) -> float:
    """Estimate how many independent poses would have calibration curves that vary as much as those of the sequences."""
    deviations, counts = sequence_deviations(totals, statistic, cells)
    return effective_poses(deviations[:, :-1], counts[:, :-1])


def unbiased_squared_error(totals: Totals, statistic: Statistic, cells: Cells = None) -> float:
    """Mean squared distance of the joints' curves from the diagonal, without what chance adds."""
    deviations, counts = sequence_deviations(totals, statistic, cells)
    return squared_error(deviations[:, :-1], counts[:, :-1])


def sequence_deviations(
    totals: Totals, statistic: Statistic, cells: Cells = None, offset: FloatArray | None = None
) -> tuple[FloatArray, Counts]:
    """Sum the deviations from calibration over each sequence, (S, J, Q), and their counts (S, J)."""
    sums, counts = totals.by_sequence(statistic, cells)
    inner = int(np.prod(sums.shape[2:-1], dtype=int))  # axes of a joint, say
    counts = np.repeat(counts, inner, axis=1)
    expected = LEVELS if offset is None else LEVELS + offset
    return sums.reshape(len(sums), counts.shape[1], LEVELS.size) - counts[..., None] * expected, counts
