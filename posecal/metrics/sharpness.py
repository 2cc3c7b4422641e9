"""Sharpness: how far the hypotheses lie from each other, whatever the truth.

A calibrated model can be useless, if it says only that a person is somewhere; so sharpness is reported beside every
calibration number, in millimetres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, checked_number, squared_norms
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE
from posecal.engine.finish import entry, mean_over_joints, per_joint
from posecal.engine.measure import EFFECTIVE_NUMBER
from posecal.engine.metric import Metric, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.scope import Scope
from posecal.engine.weighted import weighted_quantiles


def joint_deviations(block: Block, *, population: bool = False) -> FloatArray:
    """Standard deviation over the hypotheses, averaged over the axes.

    Returns
    -------
    array (B, K)
        Deviations, mm; NaN for joints that don't count, and for one hypothesis unless ``population``.
    """
    if not block.has_spread and not population:
        return np.full(block.where.shape, np.nan)
    variance, n = block.variance, block.n_effective[:, None, None]
    deviations = np.sqrt(variance if population else variance * (n / (n - 1))).mean(axis=-1)
    return np.where(block.where, deviations, np.nan)


def predicted_spread(block: Block, joints: BoolArray | None = None) -> FloatArray:
    """Predicted spread of a pose: mean over its moving joints of :func:`joint_deviations`, (B,), mm."""
    deviations = joint_deviations(block)
    if joints is not None:
        deviations = np.where(joints, deviations, np.nan)
    moving = mean_over_joints(np.where(deviations > 0, deviations, np.nan))
    return np.where(np.isnan(moving), mean_over_joints(deviations), moving)


def joint_radii(block: Block, shares: tuple[float, ...]) -> FloatArray:
    """Radius of the ball about the median that holds a share of the hypotheses.

    Returns
    -------
    array (B, K, len(shares))
        The ⌈q N⌉-th smallest distance from the per-coordinate median, or the smallest up to which a share q of the
        weights lies, mm; NaN for joints that don't count, and where one hypothesis has nearly all weight.
    """
    if block.weights is not None:
        radii = np.sqrt(squared_norms(block.shortest(block.from_median)), dtype=np.float64)
        radii = weighted_quantiles(radii, block.weights[:, None], shares)
        radii[~block.where | (not block.has_spread)] = np.nan
        return radii
    n = block.n_hypotheses
    squares = block.share("sorted_squares", lambda: np.sort(squared_norms(block.shortest(block.from_median)), axis=-1))
    ranks = [max(1, int(np.ceil(round(share * n, 9)))) - 1 for share in shares]
    radii = np.sqrt(squares[..., ranks], dtype=np.float64)
    radii[~block.where] = np.nan
    return radii


def diversity(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    population: bool = False,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Standard deviation of the hypotheses of each pose, over n, averaged over axes and joints.

    .. math:: \frac{1}{KD} \sum_{k,d} \sqrt{\frac{1}{N-1} \sum_n (x_{nmkd} - \bar x_{mkd})^2}

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    truth : array (M, K, D)
        True poses; only their shape matters.
    population : bool
        Divide by N instead of N - 1.
    where : bool array (M, K) or (M,), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first; its spread of 0 counts unless ``where`` leaves it out.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 where absent; (M, N) where ``axes`` has M first.
    axes, unit : str, optional
        Such as ``MNKD`` and ``m``, where the hypotheses are not (N, M, K, D), or both not in mm, or it is not clear.
        Angles, ``deg`` or ``rad``, are measured the shorter way round, in degrees.

    Returns
    -------
    array (M,)
        Deviations, mm; neither lower nor higher is better. NaN for one hypothesis unless ``population``.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    Differs from the published code: none; GFPose's script takes ``population=True``.

    See Also
    --------
    radius : Radius that holds a share of the hypotheses.

    References
    ----------
    Wehrbein et al., arXiv:2107.13788; Ci et al., arXiv:2212.08641.

    Examples
    --------
    Values 1 and 3 have the standard deviation √2.

    >>> import numpy as np
    >>> hypotheses = np.array([1.0, 3.0]).reshape(2, 1, 1, 1)
    >>> diversity(hypotheses, np.zeros((1, 1, 1))).round(4)
    array([1.4142])
    """

    def statistic(block: Block) -> FloatArray:
        return mean_over_joints(joint_deviations(block, population=population))

    return per_pose(
        statistic,
        hypotheses,
        truth,
        where,
        root=root,
        weights=weights,
        axes=axes,
        unit=unit,
    )


def radius(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    share: float = 0.5,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Sharpness of each pose: mean radius of the balls that hold a share q of the hypotheses of a joint.

    .. math:: \frac{1}{K} \sum_k \varepsilon_{(\lceil qN \rceil)mk}, \qquad
              \varepsilon_{nmk} = \lVert x_{nmk} - \operatorname{median}_n x_{nmk} \rVert

    Parameters
    ----------
    hypotheses, truth, where, root, weights, axes, unit
        As for :func:`diversity`.
    share : float
        q, above 0 and at most 1.

    Returns
    -------
    array (M,)
        Radii, mm; lower is sharper, which is better only among calibrated models.

    Raises
    ------
    PoseDataError
        For shapes, dtypes or values that don't fit.

    Notes
    -----
    Differs from the published code: none; ours.

    See Also
    --------
    diversity : Standard deviation of the hypotheses.
    posecal.calibration_curve : How often the truth lies within such a ball.

    References
    ----------
    Gneiting, Balabdaoui and Raftery, J. R. Stat. Soc. B 69, 243 (2007), doi:10.1111/j.1467-9868.2007.00587.x.

    Examples
    --------
    Of five points on a line, three lie within 1 of the middle.

    >>> import numpy as np
    >>> hypotheses = np.array([0.0, 5.0, 4.0, 6.0, 9.0]).reshape(5, 1, 1, 1)
    >>> radius(hypotheses, np.zeros((1, 1, 1)))
    array([1.])
    """
    share = checked_number(share, "share", lambda share: 0 < share <= 1, "above 0 and at most 1")

    def statistic(block: Block) -> FloatArray:
        return mean_over_joints(joint_radii(block, (share,))[..., 0])

    return per_pose(statistic, hypotheses, truth, where, root=root, weights=weights, axes=axes, unit=unit)


# --- metrics --------------------------------------------------------------------------------------------------

_SHARPNESS = partial(
    Metric,
    unit="mm",
    direction="none",
    family="sharpness",
    range="0 mm upwards",
    bounds=POSITIVE,
    reading="Sharpness: smaller is better only among models that are calibrated. It never looks at the truth.",
    source="Gneiting, Balabdaoui and Raftery, doi:10.1111/j.1467-9868.2007.00587.x",
)


def number_metrics(scope: Scope) -> Iterator[Metric]:
    """Effective number of hypotheses, where they have weights or some are absent."""
    if scope.spec.is_ragged or scope.spec.has_weights:
        yield Metric(
            name="effective_hypotheses",
            label="effective N",
            unit="",
            direction="none",
            family="sharpness",
            brief=f"1 / Σ w², of up to N={scope.spec.n_hypotheses}",
            definition=f"mean over poses of 1 / Σ w², w: weights of the up to N={scope.spec.n_hypotheses} hypotheses",
            statistic=EFFECTIVE_NUMBER,
            finish=entry(),
            headline=True,
            bounds=POSITIVE,
            range="1 (one hypothesis has all weight) to N (all have the same)",
            reading="As many hypotheses of equal weight give as sure a mean. Where it is small against N, most "
            "hypotheses hardly count: the weights come from a proposal that is far from the model's distribution.",
            source="Kong, Liu and Wong, J. Am. Stat. Assoc. 89, 278 (1994), doi:10.1080/01621459.1994.10476469",
        )


def _mean_of(index: int) -> Callable[[FloatArray], FloatArray]:
    """Finish by the mean over joints of one entry of each."""
    return lambda means: mean_over_joints(means[..., index])


def sharpness_metrics(scope: Scope) -> Iterator[Metric]:
    """Radii that hold a share of the hypotheses, and diversity."""
    joints, n = scope.counted(scope.moving), scope.spec.n_hypotheses
    population = scope.protocol.deviation == "population"
    divisor = "n" if population else "n − 1"

    def radii(block: Block) -> FloatArray:
        return np.where((scope.moving & block.has_spread)[:, None], joint_radii(block, (0.5, 0.9)), np.nan)

    def deviations(block: Block) -> FloatArray:
        return np.where(scope.moving, joint_deviations(block, population=population), np.nan)

    statistic, several = Statistic("radii", radii, per_joint=True), scope.spec.n_coordinates > 1
    for index, share in enumerate((50, 90)):
        yield _SHARPNESS(
            name=f"radius_{share}",
            label=f"radius of {share} %",
            brief=f"mean radius about the median, {scope.number(scope.moving)}",
            definition=f"sharpness: radius about the per-coordinate median that holds {share} % of the N={n} "
            f"hypotheses, mean over poses, then over {joints}",
            statistic=statistic,
            finish=_mean_of(index),
            by_joint=(statistic, per_joint(index)),
            headline=several,  # of one coordinate, intervals stand for balls
            in_group_table=several and share == 50,
            in_joint_table=several,
        )
    statistic = Statistic("deviations", deviations, per_joint=True)
    yield _SHARPNESS(
        name="diversity",
        label="diversity",
        brief=f"standard deviation of the hypotheses ({divisor})",
        definition=f"standard deviation over the N={n} hypotheses ({divisor}), mean over axes and poses, then over "
        f"{joints}",
        statistic=statistic,
        finish=mean_over_joints,
        by_joint=(statistic, np.asarray),
        headline=True,
    )
