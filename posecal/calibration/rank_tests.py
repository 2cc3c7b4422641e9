"""Rank tests of calibration, each for what the calibration curve does not see.

A distance from the centre knows nothing of direction, side, shape or of how joints move together. Each test here
ranks the truth among the N + 1 pooled points by another number, a *pre-rank*; if the truth and the hypotheses are
exchangeable, its rank is uniform for every one of them, whatever the distribution. The weights are those of the
exchangeable definition (:mod:`posecal.calibration.ranks`), so that E ω(q) = q exactly.

A model that ignores the image and samples from the prior passes every calibration test; a score or the sharpness shows
it.

References
----------
Gneiting et al., Test 17, 211 (2008), doi:10.1007/s11749-008-0114-x (multivariate ranks); Thorarinsdottir, Scheuerer
and Heinz, J. Comput. Graph. Stat. 25, 105 (2016), arXiv:1307.5250 (average rank, band depth); Lemos et al.,
arXiv:2302.03026 (TARP).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from posecal.calibration.curve import joint_ece
from posecal.calibration.ranks import LEVELS, rank_weights, shared_ranks
from posecal.calibration.standardized import standardized_errors_of
from posecal.data.arrays import BoolArray, FloatArray, squared_norms
from posecal.engine.block import Block
from posecal.engine.finish import mean_over_joints
from posecal.engine.metric import Deviation, Metric, Need, Statistic
from posecal.engine.scope import Scope
from posecal.engine.weighted import effective_counts, effective_number
from posecal.errors import PoseDataError

PreRank = Callable[[FloatArray], npt.ArrayLike]
"""A user's own pre-rank: from a pool of poses (N + 1, K, D), the truth last, to a number each, (N + 1,)."""

SHRINKAGE = 0.1
"""Share of the pooled covariance that is shrunk to its diagonal."""


class Pool(NamedTuple):
    """The hypotheses of B poses and, among them, the truth.

    Attributes
    ----------
    points : array (B, J, D, N + 1)
        Relative to the truth, which is the last point, mm, in double; 0 for joints that don't count.
    truth : array (B, J, D)
        The true poses, mm; NaN for joints that don't count.
    low, high : arrays (B, J, D)
        The range of the true poses of the other sequences that are evaluated together, mm.
    """

    points: FloatArray
    truth: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, block: Block, joints: BoolArray) -> Pool:
        """Take some joints of a block."""
        offsets, counted = block.pooled[:, joints], block.where[:, joints]
        zero = np.zeros((*offsets.shape[:-1], 1))
        truth = np.where(counted[..., None], block.truth[:, joints], np.nan)
        low, high = (ends[:, joints].astype(np.float64) for ends in block.range_of_others)
        points = np.concatenate([offsets, zero], axis=-1, dtype=np.float64)
        return cls(points, truth.astype(np.float64), low, high)


def weights_of_ranks(prerank: FloatArray, weights: FloatArray | None = None) -> FloatArray:
    """How far inside each level the truth's rank lies.

    Parameters
    ----------
    prerank : array (..., N + 1)
        A number of each pooled point; the last is the truth's.
    weights : array (B, n), optional
        Weights of the hypotheses, then of (B, N + 1) numbers; of the last N of them.

    Returns
    -------
    array (..., Q)
        As :func:`posecal.calibration.ranks.rank_weights` gives them; NaN where all the numbers are equal, which says
        nothing about the truth's.
    """
    others, truth = prerank[..., :-1], prerank[..., -1:]
    size = np.maximum(np.abs(others).max(axis=-1, keepdims=True), np.abs(truth))
    tie = 64 * np.finfo(prerank.dtype).eps * size  # sums of the same numbers in another order tie
    before, beside = others < truth - tie, np.abs(others - truth) <= tie
    if weights is None:
        ranks = rank_weights(others.shape[-1], before.sum(axis=-1), beside.sum(axis=-1))
    else:
        weights = weights[:, -others.shape[-1] :]  # one may be held out, the first
        counts = (effective_counts(some, weights) for some in (before, beside))
        ranks = rank_weights(effective_number(weights), *counts)
    ranks[beside.all(axis=-1)] = np.nan
    return ranks


def coordinate_weights(block: Block, joints: BoolArray) -> FloatArray:
    """Weights of the rank of each coordinate of each joint, (B, K, D, Q): the probability integral transform.

    Angles are in order from the point opposite the circular mean of hypotheses and truth. NaN for joints that don't
    count, and where all hypotheses equal the truth.
    """
    beside = block.pooled == 0
    less, equal = block.count(block.pooled < 0), block.count(beside)
    weights = rank_weights(block.n_effective[:, None, None], less, equal)
    counted = block.where & joints & block.has_spread & ~beside.all(axis=(-1, -2))
    return np.where(counted[..., None, None], weights, np.nan)


def _ranks(points: FloatArray) -> FloatArray:
    """Rank of each point in its pool, 0 … N, ties sharing the mean, for each coordinate: (B, J·D, N + 1)."""
    return shared_ranks(points.reshape(len(points), -1, points.shape[-1]))


def average_rank(pool: Pool) -> FloatArray:
    """Mean over coordinates of the rank in the pool, (B, N + 1)."""
    return np.asarray(_ranks(pool.points).mean(axis=1))


def band_depth(pool: Pool) -> FloatArray:
    """Mean over coordinates of (rank - 1)(N + 1 - rank), ranks from 1: how central a point is, (B, N + 1)."""
    ranks = _ranks(pool.points)
    return np.asarray((ranks * (pool.points.shape[-1] - 1 - ranks)).mean(axis=1))


def pair_distance(pool: Pool) -> FloatArray:
    """Sum over joint pairs of (√distance - its mean in the pool)², (B, N + 1): a pooled variogram score."""
    poses = pool.points + pool.truth[..., None]
    total = np.zeros((len(poses), poses.shape[-1]))
    for joint in range(1, poses.shape[1]):
        distances = squared_norms(poses[:, :joint] - poses[:, joint, None]) ** 0.25
        distances -= distances.mean(axis=-1, keepdims=True)
        distances[np.isnan(distances)] = 0  # pairs with a joint that does not count
        total += np.einsum("bkn,bkn->bn", distances, distances)
    return total


def mahalanobis(pool: Pool) -> FloatArray:
    """Squared Mahalanobis distance to the pooled mean, with the pooled covariance shrunk to its diagonal."""
    flat = pool.points.reshape(len(pool.points), -1, pool.points.shape[-1])
    centred = flat - flat.mean(axis=-1, keepdims=True)
    covariance = centred @ centred.swapaxes(1, 2) / flat.shape[-1]
    diagonal = np.einsum("bii->bi", covariance).copy()
    covariance *= 1 - SHRINKAGE
    np.einsum("bii->bi", covariance)[...] = np.where(diagonal > 0, diagonal, 1)  # joints left out don't move
    return np.asarray(np.einsum("bin,bin->bn", centred, np.linalg.solve(covariance, centred)))


def tarp_box(pool: Pool) -> FloatArray:
    """Distance to a random point of the box of the true poses of other sequences, in units of its sides, (B, N + 1).

    The point is drawn from a generator seeded by the true pose: the same in any order. The box is of the true poses
    that are evaluated together, so that a shard which is evaluated apart has its own. The published box holds the
    pose's own truth and its neighbours as well, not its hypotheses, which rejects perfect samplers on few sequences; of
    many it is the same. A coordinate in which the true poses don't differ is left out, where the published code
    divides by 1e-10.
    """
    points, truth, low, high = pool
    with np.errstate(invalid="ignore"):
        side = high - low
    low = np.where(side > 0, low, 0)
    share = np.stack([np.random.default_rng(zlib.crc32(pose.tobytes())).random(pose.shape) for pose in truth])
    counted, unit = (side > 0) & ~np.isnan(truth), np.where(side > 0, side, 1)
    from_reference = points / unit[..., None] + ((truth - low) / unit - share)[..., None]
    from_reference[~counted] = 0
    return np.asarray(np.sqrt(squared_norms(from_reference).sum(axis=1)))


def tarp_hypothesis(pool: Pool) -> FloatArray:
    """Distance to the first hypothesis, which is held out of the pool, (B, N)."""
    left = pool.points[..., 1:] - pool.points[..., :1]
    return np.asarray(np.sqrt(squared_norms(left).sum(axis=1)))


@dataclass(frozen=True)
class Test:
    """A rank test.

    Attributes
    ----------
    name : str
        In snake case.
    label : str
        For people.
    definition : str
        The pre-rank, in words.
    rejection : str
        What it means when the test rejects.
    prerank : callable or None
        From a pool to a number of each point, (B, N + 1); None for the ranks of single coordinates.
    """

    __test__ = False  # not one of pytest's

    name: str
    label: str
    definition: str
    rejection: str
    prerank: Callable[[Pool], FloatArray] | None = None

    def weights(self, block: Block, joints: BoolArray) -> FloatArray:
        """Weights of the truth's rank, (B, 1, Q), or (B, K, D, Q) for the coordinates; NaN of one hypothesis."""
        if self.prerank is None:
            return coordinate_weights(block, joints)
        if not block.has_spread:
            return np.full((len(block.truth), 1, LEVELS.size), np.nan)
        weights = weights_of_ranks(self.prerank(Pool.of(block, joints)), block.weights)
        weights[~block.where[:, joints].any(axis=1)] = np.nan
        return weights[:, None]


def user_weights(block: Block, joints: BoolArray, prerank: PreRank | None, name: str = "") -> FloatArray:
    """Weights of the rank of a user's own pre-rank, (B, 1, Q).

    Raises
    ------
    PoseDataError
        Where its function is not available, fails, or does not give one number per pooled pose.
    """
    if prerank is None:
        raise PoseDataError(f"prerank: {name!r} is known from a saved result only; expected its function.")
    if not block.has_spread:
        return np.full((len(block.truth), 1, LEVELS.size), np.nan)
    points = block.shortest(Pool.of(block, joints).points + block.truth[:, joints].astype(np.float64)[..., None])
    numbers = np.empty((len(points), points.shape[-1]))
    for b, poses in enumerate(points):
        try:
            values = np.asarray(prerank(np.ascontiguousarray(poses.transpose(2, 0, 1))), dtype=np.float64)
        except Exception as error:  # the user's code fails in any way
            raise PoseDataError(
                f"prerank: it fails on a pool of {numbers.shape[1]} poses ({type(error).__name__}: {error})."
            ) from error
        if values.shape != numbers[b].shape or not np.isfinite(values).all():
            raise PoseDataError(
                f"prerank: gave {values.shape} for a pool of {numbers.shape[1]} poses; expected one finite number each."
            )
        numbers[b] = values
    weights = weights_of_ranks(numbers, block.weights)
    weights[~(block.where & joints).any(axis=1)] = np.nan
    return weights[:, None]


RANK_TESTS: tuple[Test, ...] = (
    Test(
        "coordinate_pit",
        "coordinate PIT",
        "rank of each coordinate itself, per joint and axis",
        "single coordinates are off to one side, or too narrow or too wide along an axis",
    ),
    Test(
        "average_rank",
        "average rank",
        "mean over coordinates of the rank in the pool",
        "whole poses are shifted to one side, or joints move together less or more than they should",
        average_rank,
    ),
    Test(
        "band_depth",
        "band depth",
        "mean over coordinates of (rank − 1)(N + 1 − rank)",
        "the truth is more central or more extreme among the hypotheses than one of them would be",
        band_depth,
    ),
    Test(
        "pair_distance",
        "pair distance",
        "sum over joint pairs of (√distance − its mean in the pool)²",
        "distances between joints are not predicted as they vary: joints move together less or more than they should",
        pair_distance,
    ),
    Test(
        "mahalanobis",
        "Mahalanobis",
        "squared distance to the pooled mean in units of the pooled covariance, shrunk 10 % to its diagonal",
        "the shape of the cloud is wrong: its axes, its correlations, or the spread of some joints or poses",
        mahalanobis,
    ),
    Test(
        "tarp",
        "TARP about a hypothesis",
        "distance of the whole pose to one hypothesis that is held out",
        "the distances among hypotheses differ from those between hypotheses and truth",
        tarp_hypothesis,
    ),
    Test(
        "tarp_box",
        "TARP about a random point",
        "distance of the whole pose, each coordinate in units of its range over the true poses of the other sequences, "
        "to a random point of the box of these ranges",
        "seen from a random point, the truth lies nearer or farther than the hypotheses do",
        tarp_box,
    ),
)
"""The tests, in the order of a report."""

NEEDS_COORDINATE_RANGE = frozenset({"tarp_box"})
"""The tests whose ranks depend on which poses are evaluated together."""

_NEEDS: dict[str, tuple[Need, ...]] = {"pair_distance": ("positions",), "tarp_box": ("positions", "coordinate range")}
"""Of the tests that measure distances between joints, or the range of coordinates, which angles don't have."""

# --- metrics --------------------------------------------------------------------------------------------------


def rank_test_metrics(scope: Scope, preranks: Mapping[str, PreRank] | None = None) -> Iterator[Metric]:
    """The rank tests, and those of the user's own pre-ranks.

    Parameters
    ----------
    scope : Scope
        The joints.
    preranks : mapping of callables, optional
        The functions of the user's pre-ranks, where they are available; a saved result has only their names.
    """
    for test in RANK_TESTS:
        yield _rank_metric(scope, test, partial(test.weights, joints=scope.moving))
    for name in scope.spec.preranks:
        test = Test(name, name, "the user's own", "the truth does not rank as one of the hypotheses would")
        prerank = (preranks or {}).get(name)
        yield _rank_metric(scope, test, partial(user_weights, joints=scope.moving, prerank=prerank, name=name))


def _rank_metric(scope: Scope, test: Test, weights: Callable[[Block], FloatArray]) -> Metric:
    n, coordinates, joints = scope.spec.n_hypotheses, test.name == "coordinate_pit", scope.counted(scope.moving)
    over = f", mean over axes and {joints}" if coordinates else f" of poses of {joints}"
    statistic = Statistic(test.name, weights, per_joint=True)

    def by_joint(means: FloatArray) -> FloatArray:
        return np.asarray(joint_ece(means).mean(axis=-1))

    return Metric(
        name=test.name,
        label=test.label,
        unit="",
        direction="lower",
        family="rank_tests",
        brief=test.definition,
        definition=f"mean over q of |ω(q) − q|{over}, ω: exchangeable rank of the truth among N={n} hypotheses by the "
        f"{test.definition}",
        statistic=statistic,
        finish=(lambda means: mean_over_joints(by_joint(means))) if coordinates else _ece_of_poses,
        by_joint=(statistic, by_joint) if coordinates else None,
        deviation=Deviation(errors=standardized_errors_of(scope)),
        rejection=test.rejection,
        needs=_NEEDS.get(test.name, ()),
        range="0 (ranks uniform) to about 0.5",
        reading="A test, not a score: read its p-value, which is adjusted for the number of tests. Small p: the truth "
        "does not rank among the hypotheses as one of them would.",
        source="Gneiting et al., Test 17, 211 (2008); Thorarinsdottir et al., arXiv:1307.5250; Lemos et al., "
        "arXiv:2302.03026",
    )


def _ece_of_poses(means: FloatArray) -> FloatArray:
    return joint_ece(means[..., 0, :])
