"""How sure is each number of an evaluation? Its sums, read by sequence."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.calibration.ranks import LEVELS
from posecal.data.arrays import FloatArray
from posecal.engine.metric import Deviation, Metric, Statistic
from posecal.engine.totals import Totals
from posecal.stats.leave_one_out import joints_without, without
from posecal.stats.resampling import Interval, Null, effective_poses, jackknife, sign_flips, squared_error

__all__ = [
    "deviations",
    "independent_poses",
    "interval",
    "joint_intervals",
    "joint_null",
    "null",
    "unbiased_squared_error",
]

Cells = npt.NDArray[np.bool_] | None


def interval(totals: Totals, metric: Metric, cells: Cells = None) -> Interval:
    """Give the 95 % interval of a metric over the sequences among some cells.

    Parameters
    ----------
    totals : Totals
        The sums.
    metric : Metric
        A mean or anything finished from means; not a calibration error, which is never below 0 and for which
        :func:`null` is the statement to make.
    cells : bool array (C,), optional
        Whose sequences.

    Returns
    -------
    Interval
        NaN ends where there are fewer than two sequences.
    """
    return jackknife(totals.value(metric, cells), without(totals, metric, cells))


def joint_intervals(totals: Totals, metric: Metric) -> list[Interval]:
    """Give the 95 % interval of a metric at each of K joints, over the sequences in which the joint counts."""
    values, (left_out, counted) = totals.by_joint(metric), joints_without(totals, metric)
    return [jackknife(float(value), left_out[counted[:, k], k]) for k, value in enumerate(values)]


def deviations(
    totals: Totals, statistic: Statistic, cells: Cells = None, offset: FloatArray | None = None
) -> tuple[FloatArray, npt.NDArray[np.integer] | FloatArray]:
    """Give the deviations of each sequence from calibration, (S, J, Q), and their counts (S, J)."""
    sums, counts = totals.by_sequence(statistic, cells)
    inner = int(np.prod(sums.shape[2:-1], dtype=int))  # axes of a joint, say
    counts = np.repeat(counts, inner, axis=1)
    expected = LEVELS if offset is None else LEVELS + offset
    return sums.reshape(len(sums), -1, LEVELS.size) - counts[..., None] * expected, counts


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
    D, counts = deviations(totals, metric.statistic, cells, metric.offset)
    assert metric.deviation is not None
    return sign_flips(D, counts, metric.deviation, offset=metric.offset)


def joint_null(totals: Totals, metric: Metric, joint: int, cells: Cells = None) -> Null:
    """The same for the curve of a single joint."""
    D, counts = deviations(totals, metric.statistic, cells, metric.offset)
    return sign_flips(D, counts, Deviation(joint, joint + 1), offset=metric.offset)


def independent_poses(totals: Totals, statistic: Statistic, cells: Cells = None) -> float:
    """Effective number of poses of the joints' calibration curves."""
    D, counts = deviations(totals, statistic, cells)
    return effective_poses(D[:, :-1], counts[:, :-1])


def unbiased_squared_error(totals: Totals, statistic: Statistic, cells: Cells = None) -> float:
    """Mean squared distance of the joints' curves from the diagonal, without what chance adds."""
    D, counts = deviations(totals, statistic, cells)
    return squared_error(D[:, :-1], counts[:, :-1])
