"""Ranks of the truth among its hypotheses, which every calibration number is made of.

For each pose and joint: how far inside the ball that holds a share q of the hypotheses the truth lies. Three
definitions are in use, and each has its own centre and its own rule. All count integers; none compares a rounded Φ with
a rounded q.

=================  ==================================  =================================================
definition         centre, per coordinate              the truth is inside the q-ball
=================  ==================================  =================================================
``exchangeable``   median of the N + 1 pooled points   with weight clip(((N+1) q - n_less)/(n_equal+1), 0, 1)
``paper``          median of the N hypotheses          where n_less_or_equal / N ≤ q
``reference``      lower of the two middle values      where the interpolated q-quantile of the
                                                       distances is strictly larger than the truth's
=================  ==================================  =================================================

n_less counts the hypotheses that lie nearer to the centre than the truth, n_equal those just as far. Of angles,
distances are the shorter way round, and the points whose median is taken are unwrapped about the circular mean of just
these points, so that nothing depends on which of them is the truth.

If the truth and the hypotheses are exchangeable given the input (a perfect sampler), ``exchangeable`` has
E ω(q) = q exactly, for every N, D, distribution and dependence between the hypotheses, ties included. ``paper``
(the text of the publication) and ``reference`` (its released script) are biased at finite N, by rank
discreteness and by a centre that only the hypotheses pull; see :mod:`posecal.calibration.expected`.

Hypotheses of weights w, of sum 1 for each pose, have the ``exchangeable`` definition alone. Draws x_i of a proposal g
with w_i ∝ r(x_i), r = f/g, and a truth y of the density f are weighted exchangeable: given which N + 1 points there
are, the truth is each of them with a chance in proportion to its r. So the rank in which each point has its share, the
truth's spread over its place, is exact: E ω(q) = q. But r(y) is not known. In units of the sum of the others its mean
is E_f r / (N E_g r) = E_g r² / (N E_g² r), which Σ w² = 1/N_eff estimates. With it the truth has the share
1/(N_eff + 1) of the pool, and its weight is clip(((N_eff + 1) q - c_less)/(c_equal + 1), 0, 1), of effective counts
c = N_eff Σ w: the rule above with N_eff in place of N. The centre is the median of the pool by these shares. This is
exact where the weights are equal, and nearly so otherwise, since r(y) is not its mean.

If the hypotheses are the components of a mixture, each at its centre, the truth lies at one of them with the chance
w_i, as far as they are narrow against their distances. Then the truth has no share of its own, and that of
1/(N_eff + 1) is an error of about as much. Of wide components draw samples. docs/evidence.md has simulations of both.

References
----------
Pierzchlewicz et al., arXiv:2210.11179, section 3.1; Tibshirani, Barber, Candès and Ramdas, arXiv:1904.06019 (weighted
exchangeability).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal, cast, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, checked_choice, squared_norms
from posecal.engine.block import Block
from posecal.engine.weighted import weighted_median
from posecal.errors import PoseDataError

Counts = npt.NDArray[np.intp]
Definition = Literal["exchangeable", "paper", "reference"]
DEFINITIONS: tuple[Definition, ...] = get_args(Definition)
"""The three definitions, the default first."""

LEVELS: FloatArray = np.arange(21) / 20
"""The quantile levels q of every calibration curve: 0, 0.05, … 1, both ends in."""

TIE = 8
"""Squared distances that differ by less than so many units of rounding are equal: two points about their midpoint."""


def known_definition(definition: str) -> Definition:
    """Check the name of a definition.

    Raises
    ------
    PoseDataError
        Where it is none of :data:`DEFINITIONS`.
    """
    return cast(Definition, checked_choice(definition, "definition", DEFINITIONS))


def inside(block: Block, definition: Definition = "exchangeable") -> FloatArray:
    """How far inside each q-ball of its hypotheses the truth lies.

    Parameters
    ----------
    block : Block
        B poses of K joints.
    definition : str
        One of :data:`DEFINITIONS`.

    Returns
    -------
    array (B, K, Q)
        Weights W in [0, 1] for the levels of :data:`LEVELS`, rising with q; NaN for joints that don't count and
        where there are fewer than two hypotheses, or all :func:`coincide`. Their mean over poses is ω_k(q).

    Raises
    ------
    PoseDataError
        For hypotheses with weights, of another definition than ``exchangeable``.
    """
    if not block.has_spread:
        return np.full((*block.where.shape, LEVELS.size), np.nan)
    if block.weights is not None and definition != "exchangeable":
        raise PoseDataError(f"definition: {definition}; expected exchangeable for hypotheses of unequal weights.")
    weights = {"exchangeable": _exchangeable, "paper": _paper, "reference": _reference}[definition](block)
    out = ~block.where | coincide(block)
    if out.any():
        weights[out] = np.nan
    return weights


@dataclass(frozen=True)
class Nearness:
    """The hypotheses that lie nearer to each definition's centre than the truth.

    Attributes
    ----------
    centres : array (B, K, 3, D)
        The centre of each of :data:`DEFINITIONS`, relative to the truth, mm.
    within : bool array (B, K, 3, N)
        The hypotheses at most as far from it as the truth.
    at_most : array (B, K, 3)
        How many those are.
    less : array (B, K)
        How many are nearer than the truth to the exchangeable centre.
    """

    centres: FloatArray
    within: BoolArray
    at_most: Counts
    less: Counts


def nearness(block: Block) -> Nearness:
    """Compare every hypothesis with the truth, as seen from the three centres.

    With everything relative to the truth, a hypothesis e lies nearer to a centre c than the truth, ‖e - c‖ < ‖c‖,
    where ‖e‖² < 2 e·c: in the ball about the centre that has the truth on its rim. One product for all three.
    """
    return block.share("nearness", lambda: _nearness(block))


def coincide(block: Block) -> BoolArray:
    """Find joints, (B, K), at which all hypotheses equal the truth: it has no rank among them.

    No matter which of the N + 1 points is the truth, they are found alike, so that without them E ω(q) = q stays exact.
    """
    return block.share("coincide", lambda: _coincide(block))


def _coincide(block: Block) -> BoolArray:
    if block.n_hypotheses < 2:
        return np.zeros_like(block.where)
    if block.weights is not None:
        return np.asarray(~block.offsets.any(axis=(2, 3)))
    near = nearness(block)
    found = (near.less == 0) & (near.at_most[..., 0] == block.n_hypotheses)  # all are as far from the centre
    if found.any():
        found[found] = ~block.offsets[found].any(axis=(1, 2))
    return np.asarray(found)


def _nearness(block: Block) -> Nearness:
    if block.period is not None:
        return _circular_nearness(block, block.period)
    middle, odd = divmod(block.n_hypotheses, 2)
    ordered = block.sorted
    below, above = ordered[..., middle - 1], ordered[..., middle]
    # The i-th of the pooled values is the truth, which is 0, clipped to the (i-1)-th and i-th of the hypotheses'.
    pooled = np.minimum(np.maximum(below, 0), above)
    if odd:
        pooled = (pooled + np.minimum(np.maximum(above, 0), ordered[..., middle + 1])) / 2
    centres = np.stack([pooled, block.median, above if odd else below], axis=2)
    tie = TIE * np.finfo(centres.dtype).eps
    bounds = np.concatenate([centres * (2 / (1 - tie)), pooled[:, :, None] * (2 / (1 + tie))], axis=2)
    reach = bounds @ block.offsets
    within = block.squared_errors[:, :, None] <= reach[:, :, :3]
    return Nearness(centres, within, _count(within), _count(block.squared_errors < reach[:, :, 3]))


def _circular_nearness(block: Block, period: float) -> Nearness:
    """The same of coordinates that repeat: distances the shorter way round, of all coordinates of a joint."""
    truth = np.zeros((*block.pooled.shape[:-1], 1), dtype=block.pooled.dtype)
    pooled = np.median(np.concatenate([block.pooled, truth], axis=-1), axis=-1)
    centres = np.stack([pooled, block.median, block.sorted[..., (block.n_hypotheses - 1) // 2]], axis=2)
    away = block.shortest(block.offsets[:, :, None] - centres[..., None])
    distances = np.linalg.norm(away, axis=3)
    true = np.linalg.norm(block.shortest(centres), axis=-1)[..., None]
    tie = TIE * np.finfo(distances.dtype).eps * period
    within = distances <= true + tie
    return Nearness(centres, within, _count(within), _count(distances[:, :, 0] < true[:, :, 0] - tie))


def _weighted_counts(block: Block, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Effective numbers of hypotheses nearer to the pooled median than the truth, and as near, (B, K) twice."""
    one = np.ones((len(block.truth), 1))
    shares = np.concatenate([weights * block.n_effective[:, None], one], axis=1)
    points = np.concatenate([block.pooled, np.zeros_like(block.pooled[..., :1])], axis=-1)
    centre = weighted_median(points, shares[:, None, None])
    away = squared_norms(block.shortest(block.offsets - centre[..., None]))
    true = squared_norms(block.shortest(centre[..., None]))
    tie = TIE * np.finfo(away.dtype).eps * (true + block.squared_errors)
    less = block.count(away < true - tie)
    return less, block.count(away <= true + tie) - less


def _count(chosen: BoolArray) -> Counts:
    """Count along the last axis, by bytes: many times faster than by words."""
    total = np.zeros(chosen.shape[:-1], dtype=np.intp)
    for start in range(0, chosen.shape[-1], 255):
        total += np.add.reduce(chosen[..., start : start + 255].view(np.uint8), axis=-1, dtype=np.uint8)
    return total


def rank_weights(n_hypotheses: npt.ArrayLike, less: npt.ArrayLike, equal: npt.ArrayLike = 0) -> FloatArray:
    r"""Weights of truths of some rank: how far inside each level they lie, ties shared.

    .. math:: \operatorname{clip}\left(\frac{(N + 1)\, q - n_<}{n_= + 1}, 0, 1\right)

    Parameters
    ----------
    n_hypotheses : int or array (...)
        N; of hypotheses with weights, like the counts, the effective number.
    less, equal : arrays (...)
        How many of the hypotheses come before the truth, and how many beside it.

    Returns
    -------
    array (..., Q)
        Weights for the levels of :data:`LEVELS`.

    Examples
    --------
    Of three hypotheses one comes before the truth and one beside it: (4 q - 1) / 2.

    >>> rank_weights(3, 1, 1)[[0, 5, 10, 15, 20]]
    array([0. , 0. , 0.5, 1. , 1. ])
    """
    places = LEVELS * (np.asarray(n_hypotheses)[..., None] + 1)
    weights = (places - np.asarray(less)[..., None]) / (np.asarray(equal)[..., None] + 1)
    return np.asarray(np.clip(weights, 0, 1, out=weights))


def shared_ranks(values: FloatArray) -> FloatArray:
    """Rank of each value along the last axis, from 0, ties sharing the mean.

    Examples
    --------
    >>> shared_ranks(np.array([4.0, 1, 4, 2]))
    array([2.5, 0. , 2.5, 1. ])
    """
    order = np.argsort(values, axis=-1)
    ordered, places = np.take_along_axis(values, order, axis=-1), np.arange(values.shape[-1], dtype=np.float64)
    ranks_in_order = np.broadcast_to(places, values.shape)
    apart = ordered[..., 1:] != ordered[..., :-1]
    if not apart.all():
        ends = np.ones((*values.shape[:-1], 1), dtype=bool)
        first = np.maximum.accumulate(np.where(np.concatenate([ends, apart], axis=-1), places, 0), axis=-1)
        last = np.where(np.concatenate([apart, ends], axis=-1), places, np.inf)[..., ::-1]
        ranks_in_order = (first + np.minimum.accumulate(last, axis=-1)[..., ::-1]) / 2
    ranks = np.empty(values.shape)
    np.put_along_axis(ranks, order, ranks_in_order, axis=-1)
    return ranks


def _exchangeable(block: Block) -> FloatArray:
    if block.weights is not None:
        return rank_weights(block.n_effective[:, None], *_weighted_counts(block, block.weights))
    near = nearness(block)
    return rank_weights(block.n_hypotheses, near.less, near.at_most[..., 0] - near.less)


def _paper(block: Block) -> FloatArray:
    allowed = np.arange(LEVELS.size) * block.n_hypotheses // (LEVELS.size - 1)  # floor(q N), in integers
    return (nearness(block).at_most[..., 1, None] <= allowed).astype(np.float64)


def _reference(block: Block) -> FloatArray:
    """Fractional rank of the truth among the N distances, against the rank q (N - 1) of the quantile.

    With ε_(i) ≤ ε* < ε_(i+1) (counted from 0), the interpolated quantile exceeds ε* exactly where
    q (N - 1) > i + (ε* - ε_(i)) / (ε_(i+1) - ε_(i)). The fraction matters to few of the poses, so only those few
    look for their two neighbours.
    """
    near = nearness(block)
    at_most = near.at_most[..., 2]
    targets, fractional = _quantile_ranks(block.n_hypotheses)
    rank = at_most - 1.0  # -1 inside all, N - 1 outside all
    between = fractional[at_most]
    if between.any():
        centre, nearer = near.centres[between][:, 2].astype(np.float64), near.within[between][:, 2]
        distances = np.sqrt(squared_norms(block.shortest(block.offsets[between] - centre[..., None])))
        true = np.sqrt((block.shortest(centre) ** 2).sum(axis=-1))
        below = np.where(nearer, distances, -np.inf).max(axis=-1)
        above = np.where(nearer, np.inf, distances).min(axis=-1)
        gap = above - below
        rank[between] += np.divide(true - below, gap, out=np.zeros_like(gap), where=gap > 0)
    return (targets > rank[..., None]).astype(np.float64)


@cache
def _quantile_ranks(n_hypotheses: int) -> tuple[FloatArray, BoolArray]:
    """Give q (N - 1) for each level, and the numbers of nearer hypotheses at which a fraction of it matters."""
    levels = LEVELS.size - 1
    quotient, rest = np.divmod(np.arange(levels + 1) * (n_hypotheses - 1), levels)
    fractional = np.zeros(n_hypotheses + 1, dtype=bool)
    fractional[quotient[rest > 0] + 1] = True
    return quotient + rest / levels, fractional
