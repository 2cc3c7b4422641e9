r"""Central intervals of single coordinates, such as a joint angle: how many truths they hold, and how wide they are.

The interval of level c lies between the ranks (N + 1)(1 - c)/2 and (N + 1)(1 + c)/2 of the N hypotheses in ascending
order. The truth of a perfect sampler is as likely to fall between any two neighbours of them as below or above all, so
that an interval between the ranks j and N + 1 - j holds it with the chance 1 - 2j/(N + 1), whatever the distribution.
A rank between two whole ones takes either, with the chances that make the mean right: a truth between these two
hypotheses counts in part, and the interval ends on the line between them (the quantiles of Weibull). So a perfect
sampler shows c exactly, at every N. Only of fewer than (1 + c)/(1 - c) hypotheses, 19 for 90 %, the interval is that
from the least to the largest, which holds (N - 1)/(N + 1).

Angles have no least value: they are in order from the point opposite their circular mean, for the coverage that of
hypotheses and truth together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray, checked_number
from posecal.data.units import PERIODS, quantity
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE, SHARE
from posecal.engine.circular import unwrapped
from posecal.engine.finish import mean_over_joints, per_joint
from posecal.engine.metric import Metric, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.scope import Scope

PERCENT = (50, 90)
"""Levels of the intervals that are reported."""


def attained(n_hypotheses: int, level: float) -> float:
    """Share of truths that the central interval of a perfect sampler holds: the level, or what N hypotheses span.

    Examples
    --------
    >>> attained(50, 0.9), round(attained(10, 0.9), 3)
    (0.9, 0.818)
    """
    return min(level, (n_hypotheses - 1) / (n_hypotheses + 1))


def ends(ordered: FloatArray, level: float) -> tuple[FloatArray, FloatArray]:
    """Give the ends of the central interval of hypotheses in ascending order, (..., N) to (...) twice.

    Examples
    --------
    Of seven hypotheses the ranks are 2 and 6.

    >>> ends(np.array([1.0, 2, 4, 5, 6, 8, 9]), 0.5)
    (np.float64(2.0), np.float64(8.0))
    """
    n = ordered.shape[-1]
    rank = (n + 1) * (1 - attained(n, level)) / 2
    below = min(int(round(rank, 9)), n - 1)
    share = ordered.dtype.type(max(rank - below, 0))
    low, high = (
        at[..., below - 1] + share * (at[..., min(below, n - 1)] - at[..., below - 1])
        for at in (ordered, ordered[..., ::-1])
    )
    return low, high


@dataclass(frozen=True)
class CentralIntervals:
    """Central intervals of one coordinate over time, and the truth.

    Attributes
    ----------
    truth : array (M,)
        The true coordinate, of angles without jumps; NaN where it or a hypothesis is not known.
    ends : mapping of two arrays (M,)
        Both ends of the interval of each level, by the share of truths that it holds for a perfect sampler.
    """

    truth: FloatArray
    ends: Mapping[float, tuple[FloatArray, FloatArray]]

    @classmethod
    def of(
        cls, hypotheses: FloatArray, truth: FloatArray, levels: Sequence[float], unit: str | float = "none"
    ) -> CentralIntervals:
        """Find the intervals of hypotheses (N, M) and a truth (M,), angles where the unit is ``deg`` or ``rad``."""
        measured, factor = quantity(unit)
        offsets: FloatArray = (hypotheses - truth).T
        known = np.asarray(np.isfinite(offsets).all(axis=1))
        shown = np.where(known, truth, np.nan)
        if (period := PERIODS.get(measured)) is not None:
            offsets = unwrapped(offsets, period / factor)
            shown[known] = np.unwrap(truth[known], period=period / factor)
        ordered = np.where(known[:, None], np.sort(offsets, axis=1), np.nan)
        found = {attained(len(hypotheses), level): ends(ordered, level) for level in levels}
        return cls(shown, {level: (shown + low, shown + high) for level, (low, high) in found.items()})


def held(block: Block, level: float) -> FloatArray:
    """How far each true coordinate lies within its central interval, (B, K, D), 0 to 1."""
    n, pooled = block.n_hypotheses, block.pooled
    less, equal = (pooled < 0).sum(axis=-1), (pooled == 0).sum(axis=-1)
    inner = attained(n, level)
    below, above = (np.clip(((n + 1) * q - less) / (equal + 1), 0, 1) for q in ((1 - inner) / 2, (1 + inner) / 2))
    return np.asarray(above - below)


def widths(block: Block, level: float) -> FloatArray:
    """Width of each central interval, (B, K, D), mm."""
    low, high = ends(block.sorted, level)
    return high - low


def interval_coverage(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    level: float = 0.9,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Share of the true coordinates of each pose within the central interval of the hypotheses.

    .. math:: W\big(\tfrac{1+c}{2}\big) - W\big(\tfrac{1-c}{2}\big), \qquad
              W(q) = \operatorname{clip}\left(\frac{(N + 1)\, q - n_<}{n_= + 1}, 0, 1\right)

    with the number of hypotheses below the truth, :math:`n_<`, and just at it, :math:`n_=`; mean over coordinates and
    joints.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    truth : array (M, K, D)
        True poses, mm.
    level : float
        c, above 0 and below 1. Of fewer than (1 + c)/(1 - c) hypotheses (N - 1)/(N + 1) is taken.
    where : bool array (M, K), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first; its coordinates, which are certain, count unless ``where`` leaves
        them out.
    axes, unit : str, optional
        Such as ``MNKD`` and ``m``, where the hypotheses are not (N, M, K, D), or both not in mm, or it is not clear.
        Angles, ``deg`` or ``rad``, are in order from the point opposite their circular mean.

    Returns
    -------
    array (M,)
        Shares, 0 to 1; their mean over poses is c for a perfect sampler. NaN for a pose without a joint that counts.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    Where (N + 1)(1 - c)/2 is a whole number j, it is whether the truth lies between the j-th hypothesis from below and
    from above. Differs from the published code: none; ours.

    See Also
    --------
    interval_width : How wide the intervals are.
    posecal.calibration_curve : The same of balls about the median.

    References
    ----------
    Gneiting, Balabdaoui and Raftery, doi:10.1111/j.1467-9868.2007.00587.x (central prediction intervals).

    Examples
    --------
    Between the second of seven hypotheses and the sixth, a perfect sampler's truth lies half of the time.

    >>> hypotheses = np.array([1.0, 2, 4, 5, 6, 8, 9]).reshape(7, 1, 1, 1) * np.ones((1, 2, 1, 1))
    >>> interval_coverage(hypotheses, np.array([7.0, 8.5]).reshape(2, 1, 1), level=0.5)
    array([1., 0.])
    """
    level = _level(level)
    return per_pose(partial(_mean, of=held, level=level), hypotheses, truth, where, root=root, axes=axes, unit=unit)


def interval_width(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    level: float = 0.9,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Mean width of the central intervals of the coordinates of each pose.

    .. math:: x_{((N + 1)(1 + c)/2)} - x_{((N + 1)(1 - c)/2)}

    with the N hypotheses of a coordinate in ascending order, interpolated between whole ranks; mean over coordinates
    and joints.

    Parameters
    ----------
    hypotheses, truth, level, where, root, axes, unit
        As for :func:`interval_coverage`.

    Returns
    -------
    array (M,)
        Widths, mm; lower is sharper, which is better only among calibrated models.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    ``np.quantile`` with ``method="weibull"``. Its default method gives narrower intervals, which hold too few truths:
    of a perfect sampler with 50 hypotheses about 87 instead of 90 %. Differs from the published code: none; ours.

    See Also
    --------
    interval_coverage : How many truths they hold.
    posecal.metrics.radius : Sharpness of several coordinates together.

    Examples
    --------
    >>> hypotheses = np.array([1.0, 2, 4, 5, 6, 8, 9]).reshape(7, 1, 1, 1)
    >>> interval_width(hypotheses, np.zeros((1, 1, 1)), level=0.5)
    array([6.])
    """
    level = _level(level)
    return per_pose(partial(_mean, of=widths, level=level), hypotheses, truth, where, root=root, axes=axes, unit=unit)


def _level(level: float) -> float:
    return checked_number(level, "level", lambda level: 0 < level < 1, "above 0 and below 1")


def _mean(block: Block, of: Callable[[Block, float], FloatArray], level: float) -> FloatArray:
    return mean_over_joints(np.where(block.where, of(block, level).mean(axis=-1), np.nan))


# --- metrics --------------------------------------------------------------------------------------------------

_COVERAGE = partial(
    Metric,
    needs=("alike hypotheses",),
    unit="",
    direction="none",
    family="calibration",
    range="0 to 1; the level itself is best",
    bounds=SHARE,
    reading="What a user of the interval experiences: of the intervals that should hold 90 % of the truths, so many "
    "do. Fewer: the model is overconfident, or off to one side.",
    source="Gneiting, Balabdaoui and Raftery, doi:10.1111/j.1467-9868.2007.00587.x",
)
_WIDTH = partial(
    Metric,
    needs=("alike hypotheses",),
    unit="mm",
    direction="none",
    family="sharpness",
    range="0 mm upwards",
    bounds=POSITIVE,
    reading="Sharpness: smaller is better only among models that are calibrated. It never looks at the truth.",
    source="Gneiting, Balabdaoui and Raftery, doi:10.1111/j.1467-9868.2007.00587.x",
)


def interval_metrics(scope: Scope) -> Iterator[Metric]:
    """Coverage and width of the central intervals, headlines of data of one coordinate."""
    n, moving = scope.spec.n_hypotheses, scope.moving

    def measure(block: Block) -> FloatArray:
        """Coverage and width at each level, (B, K, 2, 2)."""
        values = [[f(block, percent / 100).mean(axis=-1) for percent in PERCENT] for f in (held, widths)]
        counted = (block.where & moving)[..., None, None]
        return np.where(counted, np.moveaxis(np.array(values, dtype=np.float64), (0, 1), (-2, -1)), np.nan)

    statistic, alone = Statistic("intervals", measure, per_joint=True), scope.spec.n_coordinates == 1
    over = f"mean over {'' if alone else 'axes and '}{scope.counted(moving)}"
    for row, make in enumerate((_COVERAGE, _WIDTH)):
        for column, percent in enumerate(PERCENT):
            best = attained(n, percent / 100)
            whole, ranks = best < percent / 100, f"{(1 - best) / 2:.3g} (N + 1) and {(1 + best) / 2:.3g} (N + 1)"
            between = "from the least to the largest" if whole else f"between the ranks {ranks}"
            interval = f"the central {percent} % interval, {between} of the N={n} hypotheses"
            holds = f"a perfect sampler's holds {best:.3g}"
            yield make(
                name=f"interval_{('coverage', 'width')[row]}_{percent}",
                label=f"{('coverage', 'width')[row]} of the {percent} % interval",
                brief=holds if not row else f"all N={n}, {holds}" if whole else f"central, {scope.number(moving)}",
                definition=(
                    f"share of truths in {interval}, {over}; {holds}"
                    if not row
                    else f"sharpness: width of {interval}, mean over poses, then over {over[10:]}; {holds}"
                ),
                statistic=statistic,
                calibrated=math.nan if row else best,
                finish=lambda means, at=(row, column): mean_over_joints(means[..., *at]),
                by_joint=(statistic, per_joint(row, column)),
                headline=alone,
                in_group_table=alone and percent == 90,
                in_joint_table=alone and percent == 90,
            )
