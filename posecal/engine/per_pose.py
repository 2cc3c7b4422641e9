"""Blocks of two arrays, and statistics of every pose: what functions of arrays are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import checked, period_of
from posecal.data.arrays import BoolArray, FloatArray, checked_root
from posecal.data.degenerate import is_outside
from posecal.data.root import AnyRoot
from posecal.data.weights import as_weights, checked_weights, poses_last
from posecal.engine.block import Block, block_length
from posecal.engine.coordinate_range import coordinate_range
from posecal.engine.weighted import alike
from posecal.errors import PoseDataError


def per_pose(
    statistic: Callable[[Block], FloatArray],
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    where: npt.ArrayLike | None = None,
    *,
    root: int | None = None,
    follows: BoolArray | None = None,
    earlier: int = 0,
    axes: str | None = None,
    unit: str | float | None = None,
    weights: npt.ArrayLike | None = None,
) -> FloatArray:
    """Compute a statistic of every pose, block by block.

    Parameters
    ----------
    statistic : callable
        From a block to an array (B, ...).
    hypotheses, truth, where, axes, unit
        As for :func:`posecal.data.arguments.checked`.
    root : int, optional
        The joint to subtract from every pose; poses in which it does not count, or it alone, don't count.
    follows : bool array (M,), optional
        Whether each pose comes right after the one before it.
    earlier : int
        How many poses before each pose the statistic needs, for differences over time; none of weighted hypotheses.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 for one that is absent; (M, N) where ``axes`` has M
        first.

    Returns
    -------
    array (M, ...)
        The statistic of each pose, in double.

    Raises
    ------
    PoseDataError
        For arrays and weights that don't fit, no joint of that index, a root that counts in no pose, and coordinates
        that are not finite.
    """
    x, y, mask = checked(hypotheses, truth, where, axes=axes, unit=unit)
    root = checked_root(root, y.shape[1])
    if mask is not None and root is not None:
        if mask.any() and not mask[:, root].any():
            raise PoseDataError(f"where: the root {root} counts in no pose; expected some.")
        mask = mask & mask[:, [root]]  # relative to a root that does not count, no joint does
        if mask.shape[1] > 1:  # nor does a root alone, which is right whatever the hypotheses are
            mask &= np.delete(mask, root, axis=1).any(axis=1, keepdims=True)
    period = period_of(unit)
    if weights is not None:
        given = poses_last(as_weights(weights, "weights"), x.shape[:2], axes or "NMKD", "weights")
        used = checked_weights(given, len(x), "weights", np.arange(len(y)).astype(str))
        if used is not None:
            return _of_weighted(statistic, x, y, mask, used, root, period)
    blocks = iter_blocks(x, y, mask, root=root, follows=follows, earlier=earlier, period=period)
    return _of_blocks(statistic, blocks, x, y, root)


def _of_weighted(
    statistic: Callable[[Block], FloatArray],
    x: FloatArray,
    y: FloatArray,
    mask: BoolArray | None,
    weights: FloatArray,
    root: int | None,
    period: float | None,
) -> FloatArray:
    """Compute a statistic of poses whose hypotheses have weights (N, M): of those alike, together."""
    parts: list[tuple[npt.NDArray[np.intp], FloatArray]] = []
    for rows, kept, some in alike(weights):
        where = None if mask is None else mask[rows]
        length = block_length((len(kept), len(rows), *x.shape[2:]), x.dtype)
        for start in range(0, len(rows), length):
            part = slice(start, start + length)
            own = x[kept[:, part], rows[part]], y[rows[part]]
            lay_out = partial(
                Block,
                *own,
                None if where is None else where[part],
                root=root,
                weights=None if some is None else some[part],
                period=period,
            )
            parts.append((rows[part], _of_blocks(statistic, [lay_out], *own, root, rows[part])))
    found = np.empty((len(y), *parts[0][1].shape[1:]))
    for rows, values in parts:
        found[rows] = values
    return found


def _of_blocks(
    statistic: Callable[[Block], FloatArray],
    blocks: Iterable[Callable[[], Block]],
    x: FloatArray,
    y: FloatArray,
    root: int | None,
    poses: npt.NDArray[np.intp] | None = None,
) -> FloatArray:
    """Compute a statistic of blocks of poses; refuse what is not finite, by the number of the pose."""
    parts: list[FloatArray] = []
    done = 0
    for lay_out in blocks:
        block = lay_out()
        if block.non_finite.any():
            pose, joint = np.argwhere(block.non_finite)[0] + np.array([done, 0])
            if root is not None and not (np.isfinite(x[:, pose, root]).all() and np.isfinite(y[pose, root]).all()):
                joint = root  # which makes all others so
            of_both = x[:, pose, joint], y[pose, joint]
            which = "hypotheses" if is_outside(of_both[0]).any() else "truth"
            is_finite = all(np.isfinite(coordinates).all() for coordinates in of_both)
            what = "coordinates beyond 10 km (1e7 mm)" if is_finite else "non-finite coordinates"
            raise PoseDataError(
                f"{which}: {what} (first: pose {pose if poses is None else poses[pose]}, joint {joint}). "
                "Mask those joints with where, or leave those poses out."
            )
        parts.append(np.asarray(statistic(block), dtype=np.float64))
        done += len(block.truth)
    return np.concatenate(parts)


def refuse_non_finite_arrays(x: FloatArray, y: FloatArray, counted: BoolArray) -> None:
    """Refuse coordinates (N, M, K, D) and (M, K, D) that are not finite at joints (M, K) that count.

    Raises
    ------
    PoseDataError
        With the first.
    """
    bad = counted & ~(np.isfinite(x).all(axis=(0, 3)) & np.isfinite(y).all(axis=2))
    if bad.any():
        pose, joint = np.argwhere(bad)[0]
        raise PoseDataError(
            f"hypotheses or truth: non-finite coordinates (first: pose {pose}, joint {joint}). "
            "Mask those joints with where, or leave those poses out."
        )


def iter_blocks(
    hypotheses: FloatArray,
    truth: FloatArray,
    where: BoolArray | None = None,
    *,
    root: AnyRoot = None,
    follows: BoolArray | None = None,
    earlier: int = 0,
    sequence: npt.NDArray[np.intp] | None = None,
    period: float | None = None,
) -> Iterator[Callable[[], Block]]:
    """Cut checked arrays in the paper's layout into blocks, in the order of their poses.

    Parameters
    ----------
    hypotheses, truth, where, root, follows, sequence, period
        As for :class:`Block`, of M poses instead of B.
    earlier : int
        How many poses before it a block holds as well, for differences over time.

    Yields
    ------
    callable
        Lays out the next few poses as a :class:`Block`: a copy, so better done by the thread that needs it.
    """
    limits = cache(partial(coordinate_range, truth, where, root=root, sequence=sequence))
    step = block_length(hypotheses.shape, hypotheses.dtype)
    for start in range(0, len(truth), step):
        before, poses = (
            partial(
                Block,
                hypotheses[:, part],
                truth[part],
                None if where is None else where[part],
                root=root,
                follows=None if follows is None else follows[part],
                period=period,
            )
            for part in (slice(max(0, start - earlier), start), slice(start, start + step))
        )
        yield partial(
            poses,
            previous=before,
            limits=limits,
            sequence=(np.arange(len(truth)) if sequence is None else sequence)[start : start + step],
        )
