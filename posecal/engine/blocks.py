"""How does one get through all poses? Block by block, and never with more of them in memory than one block a thread.

Everything posecal measures walks these blocks: an array in memory, a file of many gigabytes, and a public function on
three poses take the same path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, checked, working_dtype
from posecal.engine.block import Before, Block
from posecal.engine.coordinate_range import CoordinateRange, coordinate_range
from posecal.errors import PoseDataError

__all__ = ["block_length", "iter_blocks", "per_pose"]

BLOCK_BYTES = 1024 * 1024
"""About what the offsets of one block take: few enough to stay in cache, enough to be worth a call."""


def block_length(shape: tuple[int, ...], dtype: npt.DTypeLike) -> int:
    """Give the number of poses in a block of hypotheses of shape (N, M, K, D)."""
    n, _, k, d = shape
    return max(1, min(512, BLOCK_BYTES // (n * k * d * working_dtype(dtype).itemsize)))


def iter_blocks(
    hypotheses: FloatArray,
    truth: FloatArray,
    where: BoolArray | None = None,
    *,
    root: int | None = None,
    scores: FloatArray | None = None,
    follows: BoolArray | None = None,
    previous: Before | None = None,
    occluded: BoolArray | None = None,
    usable: BoolArray | None = None,
    reference: FloatArray | None = None,
    box: Callable[[], CoordinateRange] | None = None,
    sequence: npt.NDArray[np.intp] | None = None,
) -> Iterator[Callable[[], Block]]:
    """Cut checked arrays in the paper's layout into blocks, in the order of their poses.

    Parameters
    ----------
    hypotheses, truth, where, root, scores, follows, previous, occluded, usable, reference, box, sequence
        As for :class:`Block`, of M poses instead of B.

    Yields
    ------
    callable
        Lays out the next few poses as a :class:`Block`: a copy, so better done by the thread that needs it.
    """
    most = len(hypotheses) if reference is None else max(len(hypotheses), len(reference))
    step = block_length((most, *hypotheses.shape[1:]), hypotheses.dtype)
    box = cache(partial(coordinate_range, truth, where, root=root, sequence=sequence)) if box is None else box
    sequence = np.arange(len(truth)) if sequence is None else sequence
    for start in range(0, truth.shape[0], step):
        poses = slice(start, start + step)
        if start:
            last = slice(start - 1, start)
            previous = hypotheses[:, last], truth[last], None if where is None else where[last]
        yield partial(
            Block,
            hypotheses[:, poses],
            truth[poses],
            None if where is None else where[poses],
            root=root,
            scores=None if scores is None else scores[:, poses],
            follows=None if follows is None else follows[poses],
            previous=previous,
            occluded=None if occluded is None else occluded[poses],
            usable=None if usable is None else usable[poses],
            reference=None if reference is None else reference[:, poses],
            box=box,
            sequence=sequence[poses],
        )


def per_pose(
    statistic: Callable[[Block], FloatArray],
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    where: npt.ArrayLike | None = None,
    *,
    root: int | None = None,
    follows: BoolArray | None = None,
) -> FloatArray:
    """Compute a statistic of every pose, walking the blocks.

    Parameters
    ----------
    statistic : callable
        From a block to an array (B, ...).
    hypotheses, truth, where
        As for :func:`checked`.
    root : int, optional
        The joint to subtract from every pose.
    follows : bool array (M,), optional
        Whether each pose comes right after the one before it.

    Returns
    -------
    array (M, ...)
        The statistic of each pose, in double.
    """
    x, y, mask = checked(hypotheses, truth, where)
    if root is not None and not -y.shape[1] <= root < y.shape[1]:
        raise PoseDataError(f"root: {root}; expected the index of one of {y.shape[1]} joints.")
    root = None if root is None else root % y.shape[1]
    found: list[FloatArray] = []
    for number, lay_out in enumerate(iter_blocks(x, y, mask, root=root, follows=follows)):
        block = lay_out()
        if block.non_finite.any():
            pose, joint = np.argwhere(block.non_finite)[0]
            pose += number * block_length(x.shape, x.dtype)
            raise PoseDataError(
                f"hypotheses or truth: non-finite coordinates (first: pose {pose}, joint {joint}). "
                "Mask those joints with where, or leave those poses out."
            )
        found.append(np.asarray(statistic(block), dtype=np.float64))
    return np.concatenate(found)
