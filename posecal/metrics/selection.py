"""Scores of a pose's joints, of the hypothesis that is best for them, of minMPJPE's, or the mean over all.

The best hypothesis at every threshold comes from one sort: the number of joints that the best hypothesis gets right at
τ is the number of i with min_n e_(i),n < τ, where e_(i),n is the i-th smallest joint error of hypothesis n. So PCK and
AUC are closed forms of K numbers per pose, and no loop over thresholds is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Literal, get_args

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray
from posecal.engine.block import Block
from posecal.geometry.procrustes import Alignment
from posecal.metrics.position import joint_errors, linked, scored_weights

Selection = Literal["own", "linked", "mean"]
SELECTIONS: tuple[Selection, ...] = get_args(Selection)

Score = Callable[[FloatArray], FloatArray]


def joint_score(
    block: Block,
    score: Score,
    select: Selection = "own",
    align: Alignment = "none",
    joints: BoolArray | None = None,
    body: BoolArray | None = None,
    fit: BoolArray | None = None,
    length: Callable[[Block], FloatArray] | None = None,
) -> FloatArray:
    """Mean over a pose's joints of a score of their errors, of the hypothesis that ``select`` takes.

    Parameters
    ----------
    block : Block
        B poses.
    score : callable
        From errors in mm to numbers that fall with the error, elementwise; 0 at infinity.
    select : str
        One of :data:`SELECTIONS`; ``own`` takes the best hypothesis at each threshold that the score sums over.
    align : str
        See :mod:`posecal.geometry.procrustes`.
    joints : bool array (K,), optional
        The joints that are scored.
    body : bool array (K,), optional
        The joints that minMPJPE is of, by which ``linked`` chooses.
    fit : bool array (K,), optional
        The joints to which the alignment is fitted, of those that are usable; those of ``body`` by default.
    length : callable, optional
        Gives the length, (B,), of which errors are shares; NaN where a pose has none, which then does not count.

    Returns
    -------
    array (B, ...)
        Scores, with the trailing axes that the score adds; NaN for poses without a joint that counts, or with too
        few to align.
    """
    fit = body if fit is None else fit
    weights = scored_weights(block, align, joints, fit).astype(np.float64)
    scores: FloatArray
    if length is not None:
        lengths = length(block)
        weights = weights * np.isfinite(lengths)[:, None]
        plain, lengths = score, np.where(np.isfinite(lengths), lengths, 1)

        def score(errors: FloatArray) -> FloatArray:
            return plain(errors / lengths.reshape(-1, *[1] * (errors.ndim - 1)))

    if select == "own":
        scores = score(_best_ordered(block, align, joints, fit)).sum(axis=1)
        number = np.maximum(np.count_nonzero(weights, axis=1), 1)
        scores /= number.reshape(-1, *[1] * (scores.ndim - 1))
    elif select == "linked":
        errors = linked(block, joint_errors(block, align, None, fit), body)
        scores = np.einsum("bk,bk...->b...", weights, score(errors))
    else:
        each = score(joint_errors(block, align, None, fit))
        if block.weights is None:
            scores = np.einsum("bk,bkn...->b...", weights, each) / block.n_hypotheses
        else:
            scores = np.einsum("bn,bn...->b...", block.weights, np.einsum("bk,bkn...->bn...", weights, each))
    scores[~weights.any(axis=1)] = np.nan
    return scores


def least_of_each_rank(errors: FloatArray) -> FloatArray:
    """Sort (K, B, N) errors over the K joints, in place, and give the smallest of the N hypotheses, (K, B).

    Few joints are sorted by a network of comparisons, each of two rows of memory.
    """
    if len(errors) > 40:
        return np.asarray(np.sort(errors, axis=0).min(axis=-1))
    rows, smaller = list(errors), np.empty_like(errors[0])
    for i, j in _comparisons(len(rows)):
        np.minimum(rows[i], rows[j], out=smaller)
        np.maximum(rows[i], rows[j], out=rows[j])
        rows[i], smaller = smaller, rows[i]
    return np.stack([row.min(axis=-1) for row in rows])


@cache
def _comparisons(n: int) -> list[tuple[int, int]]:
    """Pairs of positions that Batcher's odd-even merge sort puts in order, one after another."""
    return [
        (i + j, i + j + step)
        for size in (1 << level for level in range((n - 1).bit_length()))
        for step in (size >> level for level in range(size.bit_length()))
        for j in range(step % size, n - step, 2 * step)
        for i in range(min(step, n - j - step))
        if (i + j) // (2 * size) == (i + j + step) // (2 * size)
    ]


def _best_ordered(block: Block, align: Alignment, joints: BoolArray | None, fit: BoolArray | None) -> FloatArray:
    """Smallest, over the hypotheses, of the i-th smallest joint error, (B, K); infinite for joints left out."""

    def compute() -> FloatArray:
        rows, counted = joint_errors(block, align, None, fit).swapaxes(0, 1), block.joint_weights(joints).T > 0
        chosen = np.ones(len(rows), dtype=bool) if joints is None else joints
        rows, counted = rows[chosen], counted[chosen]
        if not counted.all():
            rows[~counted] = np.inf
        return least_of_each_rank(rows).T

    masks = (None if mask is None else mask.tobytes() for mask in (joints, fit))
    return block.share(("best_ordered", align, *masks), compute)
