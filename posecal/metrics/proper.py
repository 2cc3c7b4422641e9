"""Is the whole predicted distribution good? Proper scores, which a model can't improve by lying about its spread.

The scores here are *fair*: unbiased in N, so that models with different numbers of hypotheses can share a column,
and the expected score of a sampler is best when it samples from the truth. The energy score looks at whole poses
or single joints and is nearly blind to how joints depend on each other; the variogram score looks at distances
between joints and is blind to a shift of the whole pose; the CRPS looks at one coordinate.

References
----------
Gneiting and Raftery, J. Am. Stat. Assoc. 102, 359 (2007), doi:10.1198/016214506000001437 (energy score, CRPS);
Scheuerer and Hamill, Mon. Weather Rev. 143, 1321 (2015), doi:10.1175/MWR-D-14-00269.1 (variogram score); Ferro,
Q. J. R. Meteorol. Soc. 140, 1917 (2014), doi:10.1002/qj.2270 (fair scores).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, squared_norms
from posecal.engine.block import Block
from posecal.engine.blocks import per_pose
from posecal.errors import PoseDataError
from posecal.metrics.sharpness import mean_over_joints

__all__ = [
    "brier_counts",
    "brier_score",
    "crps",
    "energy_score",
    "fair_brier",
    "joint_crps",
    "joint_energies",
    "variogram_score",
    "variograms",
]


STRIP = 50
"""Points whose distances to all later ones are taken at a time: as many as stay in cache."""


def _half_mean_distances(points: FloatArray) -> FloatArray:
    """Half the mean distance between two different points of each set, (B, S, D, n) to (B, S).

    One product of (x, ‖x‖², 1) with (-2x, 1, ‖x‖²) gives the squared distances of a strip of points to themselves and
    to all later ones, each of which stands for two. A pose at a time, laid into the same memory: its pairs fill the
    cache.
    """
    B, S, D, n = points.shape
    centres = points.mean(axis=-1, keepdims=True)
    left, right = np.ones((2, S, D + 2, n), dtype=points.dtype)
    room = np.empty(S * min(STRIP, n) * n, dtype=points.dtype)
    strips = []
    for start in range(0, n, STRIP):
        own, later = min(STRIP, n - start), n - start
        distances = room[: S * own * later].reshape(S, own, later)
        times = np.repeat(np.array([1, 2], dtype=points.dtype), [own, later - own])
        factors = left[..., start : start + own].swapaxes(-1, -2), right[..., start:]
        strips.append((factors, distances, np.einsum("sii->si", distances[..., :own]), times))

    total = np.zeros((B, S))
    for b in range(B):
        centred = np.subtract(points[b], centres[b], out=left[:, :D])
        left[:, D] = right[:, -1] = squared_norms(centred)
        np.multiply(centred, -2, out=right[:, :D])
        for factors, distances, to_itself, times in strips:
            np.matmul(*factors, out=distances)
            np.abs(distances, out=distances)  # rounding may leave a square a little below 0
            to_itself[...] = 0
            np.sqrt(distances, out=distances)
            total[b] += (distances @ times).sum(axis=-1, dtype=np.float64)
    total /= 2 * n * (n - 1)
    return total


def joint_energies(block: Block, joints: BoolArray | None = None) -> FloatArray:
    """Fair energy score of every joint and, in the last place, of the whole pose.

    Returns
    -------
    array (B, K + 1)
        Scores, mm; NaN for joints that don't count, and for one hypothesis.
    """
    B, K, D, n = block.offsets.shape
    scored = block.where if joints is None else block.where & joints
    if n < 2:
        return np.full((B, K + 1), np.nan)
    offsets, squares = block.offsets, block.squared_errors
    if not scored.all():
        offsets, squares = offsets * scored[..., None, None], squares * scored[..., None]
    each = block.errors.mean(axis=-1, dtype=np.float64) - _half_mean_distances(block.offsets)
    whole = np.sqrt(squares.sum(axis=1)).mean(axis=-1, dtype=np.float64)
    whole -= _half_mean_distances(offsets.reshape(B, 1, K * D, n))[:, 0]
    return np.where(np.column_stack([scored, scored.any(axis=1)]), np.column_stack([each, whole]), np.nan)


def joint_crps(block: Block, joints: BoolArray | None = None) -> FloatArray:
    """Fair CRPS of every joint, the mean over its coordinates, (B, K), mm; NaN for joints that don't count."""
    n = block.n_hypotheses
    scored = block.where if joints is None else block.where & joints
    if n < 2:
        return np.full(scored.shape, np.nan)
    ranks = (2 * np.arange(1, n + 1) - n - 1) / (n * (n - 1))
    error = np.abs(block.offsets).mean(axis=-1, dtype=np.float64)
    return np.where(scored, (error - block.sorted @ ranks).mean(axis=-1), np.nan)


def variograms(block: Block, joints: BoolArray | None = None) -> FloatArray:
    """Fair variogram score of order ½ of each pose on the distances between its joints, (B,), mm.

    Returns
    -------
    array (B,)
        Mean over joint pairs; NaN for poses with fewer than two joints that count, and for one hypothesis.
    """
    B, K, _, n = block.offsets.shape
    scored = block.where if joints is None else block.where & joints
    if n < 2:
        return np.full(B, np.nan)
    total, pairs = np.zeros(B), np.zeros(B)
    shares = np.full(n, 1 / n, dtype=block.offsets.dtype)
    poses = block.offsets + block.truth[..., None]
    for joint in range(1, K):
        counted = scored[:, :joint] & scored[:, joint, None]
        if not counted.any():
            continue
        roots = squared_norms(poses[:, :joint] - poses[:, joint, None])
        np.sqrt(np.sqrt(roots, out=roots), out=roots)
        true = squared_norms((block.truth[:, :joint] - block.truth[:, joint, None])[..., None])
        roots -= np.sqrt(np.sqrt(true))  # before they are added up, so that little is lost where they differ little
        apart = roots @ shares
        roots -= apart[..., None]
        chance = np.einsum("bkn,bkn->bk", roots, roots) / (n * (n - 1))
        total += np.where(counted, apart.astype(np.float64) ** 2 - chance, 0).sum(axis=1)
        pairs += counted.sum(axis=1)
    return np.where(pairs > 0, total / np.maximum(pairs, 1), np.nan)


def _within(
    block: Block, joints: BoolArray | None, threshold: float, forecast: Block
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Share of a forecast with every joint near the block's median, whether the truth is, and which poses count."""
    scored = block.where if joints is None else block.where & joints
    reach = np.where(scored[..., None], squared_norms(forecast.offsets - block.median[..., None]), 0).max(axis=1)
    truth = np.where(scored, squared_norms(block.median[..., None])[..., 0], 0).max(axis=1)
    share: FloatArray = (reach < threshold**2).mean(axis=-1)
    return share, np.asarray(truth < threshold**2), np.asarray(scored.any(axis=1))


def fair_brier(
    block: Block, joints: BoolArray | None = None, threshold: float = 150.0, *, forecast: Block | None = None
) -> FloatArray:
    """Fair Brier score of "every joint lies within the threshold of the median pose", (B,); NaN for no joint.

    The probability is the share of the forecast's hypotheses, by default the block's own; the median is the block's.
    """
    forecast = block if forecast is None else forecast
    n = forecast.n_hypotheses
    share, happened, counted = _within(block, joints, threshold, forecast)
    if n < 2:
        return np.full(len(share), np.nan)
    return np.where(counted, (share - happened) ** 2 - share * (1 - share) / (n - 1), np.nan)


def brier_counts(block: Block, joints: BoolArray | None = None, threshold: float = 150.0) -> FloatArray:
    """One-hot table of the predicted share and the outcome, (B, N + 1, 2); its sums give the reliability diagram."""
    n = block.n_hypotheses
    share, happened, counted = _within(block, joints, threshold, block)
    found = np.zeros((len(share), n + 1, 2))
    found[np.arange(len(share)), np.rint(share * n).astype(int), happened.astype(int)] = 1
    found[~counted] = np.nan
    return found


def _checked_scores(hypotheses: npt.ArrayLike) -> None:
    if np.ndim(hypotheses) == 4 and np.shape(hypotheses)[0] < 2:
        raise PoseDataError("hypotheses: N = 1; fair scores need at least 2.")


def energy_score(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Fair energy score of each whole pose.

    .. math:: \frac{1}{N} \sum_n \lVert x_n - y \rVert - \frac{1}{2 N (N-1)} \sum_{i \ne j} \lVert x_i - x_j \rVert

    with the norm over all joints and coordinates of a pose.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, mm.
    truth : array (M, K, D)
        True poses, mm.
    where : bool array (M, K), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first.

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
    Differs from the published code: none; the pose papers don't report it.

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
    _checked_scores(hypotheses)
    return per_pose(lambda b: joint_energies(b)[:, -1], hypotheses, truth, where, root=root)


def crps(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Fair continuous ranked probability score of each pose, the mean over its coordinates: CRPS.

    .. math:: \frac{1}{KD} \sum_{k,d} \Big( \frac{1}{N} \sum_n |x_{nkd} - y_{kd}|
              - \frac{1}{2 N (N-1)} \sum_{i \ne j} |x_{ikd} - x_{jkd}| \Big)

    Parameters
    ----------
    hypotheses, truth, where, root
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
    Differs from the published code: none; the pose papers don't report it.

    References
    ----------
    Gneiting and Raftery (2007), doi:10.1198/016214506000001437; Ferro (2014), doi:10.1002/qj.2270.

    Examples
    --------
    In one dimension it is the energy score.

    >>> import numpy as np
    >>> hypotheses = np.array([3.0, 1.0]).reshape(2, 1, 1, 1)
    >>> crps(hypotheses, np.zeros((1, 1, 1)))
    array([1.])
    """
    _checked_scores(hypotheses)
    return per_pose(lambda b: mean_over_joints(joint_crps(b)), hypotheses, truth, where, root=root)


def variogram_score(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Fair variogram score of order ½ of each pose, on the distances between its joints.

    .. math:: \operatorname{mean}_{k < l} \Big( \big( \sqrt{d_{kl}(y)} - \bar v_{kl} \big)^2
              - \tfrac{1}{N} s^2_{kl} \Big)

    where d is the distance between two joints, and v̄ and s² are the mean and the variance (N - 1) of √d over the
    hypotheses.

    Parameters
    ----------
    hypotheses, truth, where, root
        As for :func:`energy_score`.

    Returns
    -------
    array (M,)
        Scores, mm; lower is better; NaN for a pose with fewer than two joints that count.

    Raises
    ------
    PoseDataError
        For fewer than two hypotheses, and shapes, dtypes or values that don't fit.

    Notes
    -----
    Blind to where the pose is and which way it faces. Differs from the published code: the distance between two
    points takes the place of the difference of two numbers.

    References
    ----------
    Scheuerer and Hamill (2015), doi:10.1175/MWR-D-14-00269.1.

    Examples
    --------
    Two joints 4 mm apart, and 1 and 9 mm apart in the hypotheses: √d is 2, and 1 and 3, with the mean 2 and the
    variance 2, so the score is 0 - 2/2.

    >>> import numpy as np
    >>> hypotheses = np.zeros((2, 1, 2, 1))
    >>> hypotheses[:, 0, 1, 0] = 1, 9
    >>> variogram_score(hypotheses, np.array([0.0, 4.0]).reshape(1, 2, 1)).round(6)
    array([-1.])
    """
    _checked_scores(hypotheses)
    return per_pose(variograms, hypotheses, truth, where, root=root)


def brier_score(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    threshold: float = 150.0,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
) -> FloatArray:
    r"""Fair Brier score of each pose for the event that the median pose is right at every joint.

    .. math:: (p - o)^2 - \frac{p (1 - p)}{N - 1}

    where o says whether every joint of the truth lies within the threshold of the median of the hypotheses, and p is
    the share of the hypotheses of which every joint does: the probability that the model gives the event.

    Parameters
    ----------
    hypotheses, truth, where, root
        As for :func:`energy_score`.
    threshold : float
        Largest distance that is right, mm.

    Returns
    -------
    array (M,)
        Scores, about 0 to 1; lower is better; NaN for a pose without a joint that counts.

    Raises
    ------
    PoseDataError
        For fewer than two hypotheses, and shapes, dtypes or values that don't fit.

    Notes
    -----
    Whether a model knows when its own median can be relied on. The event is each model's own, so models are not ranked
    by it: one that is always wrong and knows it has a score of 0. Differs from the published code: none; the pose
    papers don't report it.

    References
    ----------
    Brier, Mon. Weather Rev. 78, 1 (1950); Ferro (2014), doi:10.1002/qj.2270.

    Examples
    --------
    All three hypotheses lie near their median, and the truth does not.

    >>> import numpy as np
    >>> hypotheses = np.array([200.0, 201.0, 202.0]).reshape(3, 1, 1, 1)
    >>> brier_score(hypotheses, np.zeros((1, 1, 1)))
    array([1.])
    """
    _checked_scores(hypotheses)
    return per_pose(lambda b: fair_brier(b, None, threshold), hypotheses, truth, where, root=root)
