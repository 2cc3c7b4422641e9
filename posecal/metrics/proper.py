"""Proper scores of the predicted distribution, which no model can improve by a wrong spread.

The scores here are *fair*: unbiased in N, so that models with different numbers of hypotheses can share a column,
and the expected score of a sampler is best when it samples from the truth. The energy score looks at whole poses
or single joints and is nearly blind to how joints depend on each other; the variogram score looks at distances
between joints and is blind to a shift of the whole pose; the CRPS looks at one coordinate.

References
----------
Gneiting and Raftery, J. Am. Stat. Assoc. 102, 359 (2007), doi:10.1198/016214506000001437 (energy score, CRPS);
Scheuerer and Hamill, Mon. Weather Rev. 143, 1321 (2015), doi:10.1175/MWR-D-14-00269.1 (variogram score); Ferro,
Q. J. R. Meteorol. Soc. 140, 1917 (2014), doi:10.1002/qj.2270 (fair scores); Grimit, Gneiting, Berrocal and Johnson,
Q. J. R. Meteorol. Soc. 132, 2925 (2006), doi:10.1256/qj.05.235 (CRPS of angles).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked, period_of
from posecal.data.arrays import BoolArray, FloatArray, squared_norms
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE
from posecal.engine.finish import entry, mean_over_joints
from posecal.engine.metric import Metric, Statistic
from posecal.engine.per_pose import per_pose
from posecal.engine.scope import Scope
from posecal.errors import PoseDataError
from posecal.geometry.distances import half_mean_arcs, half_mean_differences, half_mean_distances, on_circle


def joint_energies(block: Block, joints: BoolArray | None = None) -> FloatArray:
    """Fair energy score of every joint and, last, of the entire pose.

    Of angles distances are chords of a circle of their period: norms of arcs would not be proper for several angles.

    Returns
    -------
    array (B, K + 1)
        Scores, mm; NaN for joints that don't count, and for one hypothesis.
    """
    scored = block.where if joints is None else block.where & joints
    B, K, n = *scored.shape, block.n_hypotheses
    if not block.has_spread:
        return np.full((B, K + 1), np.nan)
    offsets, squares, errors = block.offsets, block.squared_errors, block.errors
    if block.period is not None:
        offsets = on_circle(offsets, block.period)
        squares = squared_norms(offsets)
        errors = np.sqrt(squares)
    each = block.mean_of_each(errors, np.float64) - half_mean_distances(offsets, block.weights)
    if not scored.all():
        offsets, squares = offsets * scored[..., None, None], squares * scored[..., None]
    of_pose = block.mean_of_each(np.sqrt(squares.sum(axis=1)), np.float64)
    of_pose -= half_mean_distances(offsets.reshape(B, 1, -1, n), block.weights)[:, 0]
    return np.where(np.column_stack([scored, scored.any(axis=1)]), np.column_stack([each, of_pose]), np.nan)


def joint_crps(block: Block, joints: BoolArray | None = None) -> FloatArray:
    """Fair CRPS of every joint, the mean over its coordinates, (B, K), mm; NaN for joints that don't count."""
    n = block.n_hypotheses
    scored = block.where if joints is None else block.where & joints
    if not block.has_spread:
        return np.full(scored.shape, np.nan)
    error = block.mean_of_each(np.abs(block.shortest(block.offsets)), np.float64)
    apart: FloatArray
    if block.period is None and block.weights is not None:
        apart = half_mean_differences(block.offsets, block.weights)
    elif block.period is None:
        apart = block.sorted @ ((2 * np.arange(1, n + 1) - n - 1) / (n * (n - 1)))
    else:
        apart = half_mean_arcs(block.offsets, block.period, block.weights)
    return np.where(scored, (error - apart).mean(axis=-1), np.nan)


def variograms(block: Block, joints: BoolArray | None = None) -> FloatArray:
    """Fair variogram score of order ½ of each pose on the distances between its joints, (B,), mm.

    Returns
    -------
    array (B,)
        Mean over joint pairs; NaN for poses with fewer than two joints that count, and for one hypothesis.
    """
    B, K, _, n = block.offsets.shape
    scored = block.where if joints is None else block.where & joints
    if not block.has_spread:
        return np.full(B, np.nan)
    total, pairs = np.zeros(B), np.zeros(B)
    shares = np.full((B, n, 1), 1 / n) if block.weights is None else block.weights[..., None]
    shares = shares.astype(block.offsets.dtype)
    poses = block.offsets + block.truth[..., None]
    for joint in range(1, K):
        counted = scored[:, :joint] & scored[:, joint, None]
        if not counted.any():
            continue
        roots = squared_norms(poses[:, :joint] - poses[:, joint, None])
        np.sqrt(np.sqrt(roots, out=roots), out=roots)
        true = squared_norms((block.truth[:, :joint] - block.truth[:, joint, None])[..., None])
        roots -= np.sqrt(np.sqrt(true))  # before they are summed, so that little is lost where they differ little
        apart = (roots @ shares)[..., 0]
        roots -= apart[..., None]
        if block.weights is None:
            chance = np.einsum("bkn,bkn->bk", roots, roots) / (n * (n - 1))
        else:
            chance = block.mean_of_each(roots**2) / (block.n_effective - 1)[:, None]
        total += np.where(counted, apart.astype(np.float64) ** 2 - chance, 0).sum(axis=1)
        pairs += counted.sum(axis=1)
    return np.where(pairs > 0, total / np.maximum(pairs, 1), np.nan)


def fair_per_pose(
    statistic: Callable[[Block], FloatArray],
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    where: npt.ArrayLike | None,
    root: int | None,
    axes: str | None,
    unit: str | float | None,
    weights: npt.ArrayLike | None = None,
    *,
    least: int = 2,
) -> FloatArray:
    """Compute a fair score of every pose, (M,); refuse fewer hypotheses than it needs."""
    if (n := len(checked(hypotheses, truth, axes=axes, unit=unit)[0])) < least:
        raise PoseDataError(f"hypotheses: N = {n}; fair scores need at least {least}.")
    return per_pose(statistic, hypotheses, truth, where, root=root, weights=weights, axes=axes, unit=unit)


def energy_score(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Fair energy score of each whole pose.

    .. math:: \frac{1}{N} \sum_n \lVert x_n - y \rVert - \frac{1}{2 N (N-1)} \sum_{i \ne j} \lVert x_i - x_j \rVert

    with the norm over all joints and coordinates of a pose. Of weights w, of sum 1, it is

    .. math:: \sum_i w_i \lVert x_i - y \rVert
              - \frac{1}{2 (1 - \sum_i w_i^2)} \sum_{i \ne j} w_i w_j \lVert x_i - x_j \rVert

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    truth : array (M, K, D)
        True poses, mm.
    where : bool array (M, K) or (M,), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 where absent; (M, N) where ``axes`` has M first.
    axes, unit : str, optional
        Such as ``MNKD`` and ``m``, where the hypotheses are not (N, M, K, D), or both not in mm, or it is not clear.
        Angles, ``deg`` or ``rad``, are measured the shorter way round, in degrees.

    Returns
    -------
    array (M,)
        Scores, mm; lower is better. Of a perfect sampler it is half the mean distance of two of its samples; single
        poses may be below 0. NaN for a pose without a joint that counts.

    Raises
    ------
    PoseDataError
        For fewer than two hypotheses, and shapes, dtypes or values that don't fit.

    Notes
    -----
    Of angles the norm is over chords of a circle of circumference 360°, nearly the angles themselves where they are
    small: the norm of several arcs would not give a proper score. Differs from the published code: none; the pose
    papers don't report it.

    See Also
    --------
    crps : The same of one coordinate at a time.
    variogram_score : Of the distances between joints, which the energy score hardly sees.

    References
    ----------
    Gneiting and Raftery (2007), doi:10.1198/016214506000001437; Ferro (2014), doi:10.1002/qj.2270.

    Examples
    --------
    Hypotheses 3 and 1 mm from the truth on a line: mean distance 2, half their distance of 2 is 1.

    >>> import numpy as np
    >>> hypotheses = np.array([3.0, 1.0]).reshape(2, 1, 1, 1)
    >>> energy_score(hypotheses, np.zeros((1, 1, 1)))
    array([1.])
    """
    return fair_per_pose(lambda b: joint_energies(b)[:, -1], hypotheses, truth, where, root, axes, unit, weights)


def crps(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Fair continuous ranked probability score of each pose, the mean over its coordinates: CRPS.

    .. math:: \frac{1}{KD} \sum_{k,d} \Big( \frac{1}{N} \sum_n |x_{nkd} - y_{kd}|
              - \frac{1}{2 N (N-1)} \sum_{i \ne j} |x_{ikd} - x_{jkd}| \Big)

    Parameters
    ----------
    hypotheses, truth, where, root, weights, axes, unit
        As for :func:`energy_score`.

    Returns
    -------
    array (M,)
        Scores, mm; lower is better; NaN for a pose without a joint that counts.

    Raises
    ------
    PoseDataError
        For fewer than two hypotheses, and shapes, dtypes or values that don't fit.

    Notes
    -----
    Of angles all distances are arcs, the shorter way round. Differs from the published code: none; the pose papers
    don't report it.

    See Also
    --------
    energy_score : The same of whole poses.

    References
    ----------
    Gneiting and Raftery (2007); Ferro (2014); of angles Grimit et al. (2006), doi:10.1256/qj.05.235.

    Examples
    --------
    In one dimension it is the energy score.

    >>> hypotheses = np.array([3.0, 1.0]).reshape(2, 1, 1, 1)
    >>> crps(hypotheses, np.zeros((1, 1, 1)))
    array([1.])
    """
    return fair_per_pose(lambda b: mean_over_joints(joint_crps(b)), hypotheses, truth, where, root, axes, unit, weights)


def variogram_score(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Fair variogram score of order ½ of each pose, on the distances between its joints.

    .. math:: \operatorname{mean}_{k < l} \Big( \big( \sqrt{d_{kl}(y)} - \bar v_{kl} \big)^2
              - \tfrac{1}{N} s^2_{kl} \Big)

    where d is the distance between two joints, and v̄ and s² are the mean and the variance (N - 1) of √d over the
    hypotheses.

    Parameters
    ----------
    hypotheses, truth, where, root, weights, axes, unit
        As for :func:`energy_score`.

    Returns
    -------
    array (M,)
        Scores, mm; lower is better; NaN for a pose with fewer than two joints that count.

    Raises
    ------
    PoseDataError
        For angles, fewer than two hypotheses, and shapes, dtypes or values that don't fit.

    Notes
    -----
    Blind to where the pose is and which way it faces. Differs from the published code: the distance between two
    points replaces the difference of two numbers.

    See Also
    --------
    energy_score : Of whole poses, with where they are.

    References
    ----------
    Scheuerer and Hamill (2015), doi:10.1175/MWR-D-14-00269.1.

    Examples
    --------
    Two joints 4 mm apart, and 1 and 9 mm apart in the hypotheses: √d is 2, and 1 and 3, with the mean 2 and the
    variance 2, so the score is 0 - 2/2.

    >>> hypotheses = np.array([0.0, 1.0, 0.0, 9.0]).reshape(2, 1, 2, 1)
    >>> variogram_score(hypotheses, np.array([0.0, 4.0]).reshape(1, 2, 1), unit="mm").round(6)
    array([-1.])
    """
    if period_of(unit) is not None:
        raise PoseDataError(f"unit: {unit}; expected positions, not angles, whose distances are compared.")
    return fair_per_pose(variograms, hypotheses, truth, where, root, axes, unit, weights)


# --- metrics --------------------------------------------------------------------------------------------------

SCORE = partial(
    Metric,
    unit="mm",
    direction="lower",
    family="scores",
    range="single poses may be below 0; the mean is not, but for chance",
    bounds=POSITIVE,
    reading="Proper: a model can't gain by a wrong spread. Only differences and skills mean something; a wide but true "
    "distribution may lose to a narrow true one, which knows more.",
    source="Gneiting and Raftery, doi:10.1198/016214506000001437; Ferro, doi:10.1002/qj.2270",
)


def score_metrics(scope: Scope) -> Iterator[Metric]:
    """Energy score, CRPS and variogram score."""
    moving, joints, n = scope.moving, scope.counted(scope.moving), scope.spec.n_hypotheses
    energies = Statistic("energies", partial(joint_energies, joints=moving), per_joint=True)
    crps = Statistic("crps", partial(joint_crps, joints=moving), per_joint=True)
    yield SCORE(
        name="energy_score",
        label="energy score",
        brief=f"fair, whole pose of {scope.number(moving)}",
        definition=f"mean over poses of mean ‖x − y‖ − ½ mean ‖x − x′‖, norm over {joints}; fair in N={n}",
        statistic=energies,
        finish=entry(-1),
        by_joint=(energies, lambda means: means[..., :-1]),
    )
    yield SCORE(
        name="joint_energy_score",
        label="energy score of joints",
        brief="fair, mean over joints of each joint's own",
        definition=f"mean over poses of mean ‖x − y‖ − ½ mean ‖x − x′‖ of one joint, mean over {joints}; fair in N={n}",
        statistic=energies,
        finish=lambda means: mean_over_joints(means[..., :-1]),
    )
    yield SCORE(
        name="crps",
        label="CRPS",
        brief="fair, mean over coordinates",
        definition=f"mean over poses of mean |x − y| − ½ mean |x − x′| of one coordinate, mean over axes and {joints}; "
        f"fair in N={n}",
        statistic=crps,
        finish=mean_over_joints,
        by_joint=(crps, np.asarray),
    )
    yield SCORE(
        name="variogram_score",
        label="variogram score",
        needs=("positions",),
        brief="fair, of √distance between joints",
        definition=f"mean over poses and pairs of {joints} of (√d(y) − mean √d(x))² − var √d(x) / N, d: distance of "
        f"the pair, N={n}",
        statistic=Statistic("variogram", partial(variograms, joints=moving)),
        finish=entry(),
    )
