"""Several modes among hypotheses, such as a limb that is bent towards the camera or away from it.

At each joint of each pose the hypotheses are cut into two groups where that explains most of their variance along their
first principal axis. The groups are modes where they explain more than :data:`EXPLAINED` of it and there is a valley
between them: of three windows as wide as a third of the distance of the two centres, the one in the middle holds at
most a third of the hypotheses of either outer one. A distribution with one peak has no such valley, however heavy its
tails; with few hypotheses one appears by chance. A joint has several modes where the share of its poses with modes is
beyond what distributions without modes show at this N, a thin ring being the worst of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked
from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.engine.per_pose import per_pose
from posecal.engine.weighted import effective_number, weighted_quantiles
from posecal.errors import PoseDataError

LEAST = 10
"""The fewest hypotheses among which modes are looked for."""

LEAST_WEIGHTED = 20
"""The smallest effective number of weighted hypotheses among which they are."""

EXPLAINED = 0.8
"""Two modes explain more of the variance along their axis than this; a Gaussian's halves explain 2/π."""

POINTS = 24
"""So many of the ordered hypotheses, up to twice as many, tell :func:`two_modes`."""

SMALLEST = 0.15
"""Of the hypotheses, the smaller mode holds at least this share."""


@dataclass(frozen=True)
class Groups:
    """Modes of the hypotheses of some poses.

    Attributes
    ----------
    several : bool array (B, K)
        Whether the hypotheses of a joint have two modes.
    second : bool array (B, K, N)
        The hypotheses that belong to the second one; none where there is one mode.
    apart : array (B, K)
        The distance of the modes' means along the first principal axis; NaN where there is one mode.
    """

    several: BoolArray
    second: BoolArray
    apart: FloatArray


@dataclass(frozen=True)
class Modes:
    """Which joints have several modes.

    Attributes
    ----------
    share : array (K,)
        The share of poses in which the hypotheses of a joint have two modes; NaN where it counts in none.
    apart : array (K,)
        The median over these poses of the distance of the modes, in the unit of the hypotheses.
    limit : float
        The share that may come by chance, of whatever distributions without modes.
    several : bool array (K,)
        Whether the share is beyond the limit by more than three standard errors.
    """

    share: FloatArray
    apart: FloatArray
    limit: float
    several: BoolArray


def split_modes(offsets: FloatArray) -> Groups:
    """Cut the hypotheses of every joint of every pose into two modes where they have two.

    Parameters
    ----------
    offsets : array (B, K, D, N)
        Hypotheses, from any origin.

    Returns
    -------
    Groups
        None are cut where N is below :data:`LEAST`.
    """
    B, K, D, N = offsets.shape
    if N < LEAST:
        return Groups(np.zeros((B, K), dtype=bool), np.zeros((B, K, N), dtype=bool), np.full((B, K), np.nan))
    x = offsets.reshape(B * K, D, N).astype(np.float64)
    x -= x.mean(axis=-1, keepdims=True)
    along = np.einsum("rdn,rd->rn", x, np.linalg.eigh(x @ x.swapaxes(1, 2))[1][..., -1])
    ordered = np.sort(along, axis=-1)
    several, cut, apart = _cut(ordered)
    second = (along > ordered[np.arange(len(along)), cut][:, None]) & several[:, None]
    apart = np.where(several, apart, np.nan)
    return Groups(several.reshape(B, K), second.reshape(B, K, N), apart.reshape(B, K))


def _cut(ordered: FloatArray) -> tuple[BoolArray, npt.NDArray[np.intp], FloatArray]:
    """Cut rows of ascending numbers of mean 0, (R, N), in two: whether these are modes, the cut, how far apart."""
    N, rows = ordered.shape[-1], np.arange(len(ordered))
    first = np.arange(1, N)  # so many are in the first group
    sums = np.cumsum(ordered, axis=-1)[:, :-1]
    between = np.where(np.minimum(first, N - first) >= max(2, SMALLEST * N), sums**2 / (first * (N - first)), 0)
    cut = between.argmax(axis=-1)
    total = sums[rows, cut]
    low, high = total / first[cut], -total / (N - first[cut])
    width = (high - low) / 3
    middle, left, right = (
        ((ordered > (at - width / 2)[:, None]) & (ordered <= (at + width / 2)[:, None])).sum(axis=-1)
        for at in ((low + high) / 2, low, high)
    )
    side = np.minimum(left, right)
    several = (between[rows, cut] > EXPLAINED * (ordered**2).mean(axis=-1)) & (3 * middle <= side) & (side > 0)
    return several, cut, high - low


def two_modes(
    ordered: FloatArray, axis: npt.NDArray[np.intp], weights: FloatArray | None = None, period: float | None = None
) -> BoolArray:
    """Find two modes along one coordinate, by some of the ordered hypotheses: in little time, and less surely.

    Parameters
    ----------
    ordered : array (B, K, D, N)
        Each coordinate of the hypotheses in ascending order; with weights in the order of the hypotheses.
    axis : array of int (B, K)
        The coordinate.
    weights : array (B, N), optional
        The weight of each hypothesis; equal ones by default.
    period : float, optional
        After how much the coordinate repeats: it is then cut open where hypotheses leave the widest gap.

    Returns
    -------
    bool array (B, K)
        None where N, with weights the effective one, is below :data:`LEAST`, with weights :data:`LEAST_WEIGHTED`, and
        where, without weights, more than half of the hypotheses are copies of others: of few draws groups appear by
        chance.
    """
    B, K, _, N = ordered.shape
    if N < LEAST:
        return np.zeros((B, K), dtype=bool)
    points: FloatArray = ordered[np.arange(B)[:, None], np.arange(K), axis].astype(np.float64)
    if weights is not None:
        shares = tuple(((np.arange(POINTS) + 0.5) / POINTS).tolist())
        points = weighted_quantiles(points, weights[:, None], shares)
    if period is not None:
        points = _cut_open(points, period)
    if weights is None:
        enough = 2 * (np.diff(points, axis=-1) != 0).sum(axis=-1) + 2 >= N
        step = max(1, N // POINTS)
        points = points[..., (N - 1) % step // 2 :: step]
    else:
        enough = (effective_number(weights) >= LEAST_WEIGHTED)[:, None]
    points -= points.mean(axis=-1, keepdims=True)
    return np.asarray(_cut(points.reshape(B * K, -1))[0].reshape(B, K) & enough)


def _cut_open(points: FloatArray, period: float) -> FloatArray:
    """Cut ascending points of a circle, (..., N), where the gap between two neighbours is widest; ascending again."""
    gaps = np.diff(points, axis=-1, append=points[..., :1] + period)
    at = gaps.argmax(axis=-1)[..., None] + 1 + np.arange(points.shape[-1])
    return np.asarray(np.take_along_axis(points, at % points.shape[-1], axis=-1) + period * (at >= points.shape[-1]))


def centres_of_modes(block: Block, joints: BoolArray) -> FloatArray:
    """Give the centre of the mode that each hypothesis belongs to.

    Parameters
    ----------
    block : Block
        B poses.
    joints : bool array (K,)
        The joints whose hypotheses are cut into modes; those of the others are one.

    Returns
    -------
    array (B, K, D, N)
        Per-coordinate medians, relative to the truth.
    """
    centres = np.repeat(block.median[..., None], block.n_hypotheses, axis=-1)
    groups = split_modes(block.offsets[:, joints])
    pose, number = np.nonzero(groups.several)
    joint = np.flatnonzero(joints)[number]
    x, second = block.offsets[pose, joint], groups.second[pose, number][:, None]
    medians = [_median_of(x, ~second), _median_of(x, second)]
    centres[pose, joint] = np.where(second, medians[1], medians[0])
    return centres


def _median_of(x: FloatArray, members: BoolArray) -> FloatArray:
    """Per-coordinate median of the members (R, 1, N) among (R, D, N), (R, D, 1)."""
    ordered = np.sort(np.where(members, x, np.inf), axis=-1)
    number = members.sum(axis=-1, keepdims=True)
    low, high = (np.take_along_axis(ordered, at, axis=-1) for at in ((number - 1) // 2, number // 2))
    return np.asarray((low + high) / 2)


def chance_limit(n_hypotheses: int) -> float:
    """Give the share of poses that may seem to have two modes by chance, whatever the distribution without modes."""
    return float(0.05 + 0.85 * np.exp(-n_hypotheses / 33))


def summarize_modes(several: BoolArray, apart: FloatArray, counted: BoolArray, n_hypotheses: int) -> Modes:
    """Say which joints have several modes, from those of all poses.

    Parameters
    ----------
    several, apart : arrays (M, K)
        As in :class:`Groups`.
    counted : bool array (M, K)
        The joints that count.
    n_hypotheses : int
        N.
    """
    found = several & counted
    share, most = share_with_modes(found.sum(axis=0), counted.sum(axis=0), n_hypotheses)
    ordered = np.sort(np.where(found, apart, np.nan), axis=0)  # NaN last
    middle = np.maximum(found.sum(axis=0) - 1, 0) // 2
    distance = np.take_along_axis(ordered, middle[None], axis=0)[0]
    return Modes(share, distance, chance_limit(n_hypotheses), share > most)


def share_with_modes(found: FloatArray, number: FloatArray, n_hypotheses: int) -> tuple[FloatArray, FloatArray]:
    """Give the share of poses with two modes at each joint, (K,), and the largest one that may come by chance."""
    poses, limit = np.maximum(number, 1), chance_limit(n_hypotheses)
    return np.where(number > 0, found / poses, np.nan), limit + 3 * np.sqrt(limit * (1 - limit) / poses)


def joint_modes(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
) -> Modes:
    """Joints with several modes among their hypotheses, such as depth flips.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, any unit; positions or pixels, not angles.
    truth : array (M, K, D)
        True poses, which change nothing.
    where : bool array (M, K) or (M,), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first.
    axes : str, optional
        The layout of the hypotheses, such as ``MNKD``; needed where the shapes leave it open.

    Returns
    -------
    Modes
        Of each joint the share of poses with two modes, how far these are apart, and whether that is beyond chance.

    Raises
    ------
    PoseDataError
        For fewer than ten hypotheses, and shapes, dtypes or values that don't fit.

    Notes
    -----
    Modes are seen where they are some five standard deviations apart, and each holds at least 15 % of the hypotheses;
    with 10 to 20 hypotheses, six. Of more than two modes two are found, along the first principal axis. Differs from
    the published code: none; ours.

    See Also
    --------
    posecal.recalibration.fit_spread : Which rescales hypotheses about their modes with ``about="modes"``.

    Examples
    --------
    One joint is 60 mm before or behind a point, the other within some 10 mm of it.

    >>> import numpy as np
    >>> random = np.random.default_rng(0)
    >>> hypotheses = random.normal(0, 10, (50, 100, 2, 3))
    >>> hypotheses[:, :, 0, 2] += random.choice([-60, 60], (50, 100))
    >>> modes = joint_modes(hypotheses, np.zeros((100, 2, 3)))
    >>> modes.several.tolist(), modes.share.tolist(), bool(115 < modes.apart[0] < 125)
    ([True, False], [1.0, 0.0], True)
    """

    def measure(block: Block) -> FloatArray:
        if block.n_hypotheses < LEAST:
            raise PoseDataError(f"hypotheses: N = {block.n_hypotheses}; expected at least {LEAST}, to find modes.")
        groups = split_modes(block.offsets)
        return np.stack([groups.several, groups.apart, block.where], axis=1)

    several, apart, counted = np.moveaxis(per_pose(measure, hypotheses, truth, where, root=root, axes=axes), 1, 0)
    return summarize_modes(several > 0, apart, counted > 0, checked(hypotheses, truth, axes=axes)[0].shape[0])
