"""How do a few poses lie in memory while they are measured?

A *block* holds B poses as one contiguous array of *offsets* from the truth, ``x - y``, laid out ``(B, K, D, N)``:
along the last axis the N hypotheses of one coordinate of one joint. Rows that one sorts or sums are then
contiguous, and a block fits into the processor's cache. What several metrics need (errors, sorted coordinates) is
computed once per block, when it is first asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, squared_norms, working_dtype
from posecal.engine.coordinate_range import CoordinateRange, coordinate_range
from posecal.errors import PoseDataError

if TYPE_CHECKING:
    from collections.abc import Hashable

__all__ = ["Before", "Block"]

Result = TypeVar("Result")
Before = tuple[FloatArray, FloatArray, BoolArray | None]


class Block:
    """B poses with their N hypotheses, and what several metrics share about them.

    Parameters
    ----------
    hypotheses : array (N, B, K, D)
        Hypotheses, mm, in any memory layout.
    truth : array (B, K, D)
        True poses, mm.
    where : bool array (B, K), optional
        The joints that count; the others may hold anything, NaN included.
    root : int, optional
        The joint that is subtracted from every pose; None leaves positions as they are.
    previous : tuple of arrays (N, 1, K, D) and (1, K, D) and bool (1, K) or None, optional
        The pose before the first one and the joints of it that count, for velocities.
    follows : bool array (B,), optional
        Whether each pose comes right after the one before it in its sequence.
    scores : array (N, B), optional
        The model's own score of each hypothesis; higher is better.
    occluded : bool array (B, K), optional
        The joints whose keypoints were not seen; none by default.
    usable : bool array (B, K), optional
        Those to which alignments are fitted, those that count among them; those that count by default.
    reference : array (R, B, K, D), optional
        Hypotheses of the same poses by another model, that skills are relative to, mm.
    box : callable, optional
        Gives the range of all true poses that are evaluated together; of these by default.
    sequence : array of int (B,), optional
        The sequence of each pose; each pose is one by default.

    Attributes
    ----------
    offsets : array (B, K, D, N)
        Hypotheses minus truth, mm; 0 for joints that don't count.
    truth : array (B, K, D)
        True poses, mm, relative to the root; 0 for joints that don't count.
    where : bool array (B, K)
        The joints that count.
    """

    def __init__(
        self,
        hypotheses: FloatArray,
        truth: FloatArray,
        where: BoolArray | None = None,
        *,
        root: int | None = None,
        previous: Before | None = None,
        follows: BoolArray | None = None,
        scores: FloatArray | None = None,
        occluded: BoolArray | None = None,
        usable: BoolArray | None = None,
        reference: FloatArray | None = None,
        box: Callable[[], CoordinateRange] | None = None,
        sequence: npt.NDArray[np.intp] | None = None,
    ) -> None:
        self.occluded = np.zeros(truth.shape[:2], dtype=bool) if occluded is None else occluded
        self.where = np.ones(truth.shape[:2], dtype=bool) if where is None else where
        self.offsets = _offsets(hypotheses, truth, root)
        self.truth = _relative(truth, root, self.offsets.dtype)
        if not self.where.all():
            self.offsets[~self.where] = 0
            self.truth = np.where(self.where[..., None], self.truth, 0)
        self._root, self._previous, self._follows, self._scores = root, previous, follows, scores
        self._box, self._sequence = box, sequence
        self._shared: dict[Hashable, Any] = {}
        self._whole: Callable[[], Block] | None = None
        if usable is not None:
            self._whole = partial(_finite, partial(Block, hypotheses, truth, root=root, scores=scores), usable)
        self._reference = None if reference is None else partial(Block, reference, truth, where, root=root)

    @property
    def whole(self) -> Block:
        """The same poses with every usable joint whose coordinates are finite, to which alignments are fitted.

        The block itself where only the joints that count are usable. (Not kept as its own: a block that holds itself
        would stay in memory until Python next looks for such circles.)
        """
        return self if self._whole is None else self._laid_out_whole

    @cached_property
    def _laid_out_whole(self) -> Block:
        return self if self._whole is None else self._whole()

    def stretched(self, factor: float) -> Block:
        """Give the same poses with the spread of the hypotheses about their median multiplied."""
        centre, times = self.median[..., None], self.offsets.dtype.type(factor)
        other = Block.__new__(Block)
        other.where, other.occluded, other.truth = self.where, self.occluded, self.truth
        other._root, other._previous, other._follows, other._scores = self._root, None, self._follows, self._scores
        other._shared, other._reference, other._box, other._sequence = {}, self._reference, self._box, self._sequence
        other._whole = None if self._whole is None else lambda: self.whole.stretched(factor)
        other.offsets = centre + times * (self.offsets - centre)
        other.__dict__["sorted"] = centre + times * (self.sorted - centre)  # stretching keeps the order
        return other

    @cached_property
    def non_finite(self) -> BoolArray:
        """The poses and joints, (B, K), at which a coordinate that counts is NaN or infinite."""
        if np.isfinite(self.squared_errors.sum()):  # one fast pass; true of nearly every block
            return np.zeros_like(self.where)
        return np.asarray(~np.isfinite(self.offsets).all(axis=(2, 3)))

    @cached_property
    def reference(self) -> Block | None:
        """The same poses with the hypotheses that skills are relative to; None without any."""
        return None if self._reference is None else self._reference()

    @cached_property
    def range_of_others(self) -> tuple[FloatArray, FloatArray]:
        """The range of the true poses of the other sequences that are evaluated together, (B, K, D) twice, mm."""
        box = coordinate_range(self.truth, self.where, sequence=self._sequence) if self._box is None else self._box()
        return box.without(np.arange(len(self.truth)) if self._sequence is None else self._sequence)

    def share(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        """Compute something once per block, whoever asks first."""
        if key not in self._shared:
            self._shared[key] = compute()
        found: Result = self._shared[key]
        return found

    @property
    def n_hypotheses(self) -> int:
        """N."""
        return int(self.offsets.shape[-1])

    @property
    def scores(self) -> FloatArray:
        """The model's score of each hypothesis, (B, N)."""
        if self._scores is None:
            raise PoseDataError("hypotheses: no scores given; expected a member scores (N, M) beside them.")
        if not np.isfinite(self._scores).all():
            raise PoseDataError("hypotheses: scores that are not finite; expected a number for each hypothesis.")
        return self._scores.T

    @cached_property
    def sorted(self) -> FloatArray:
        """Each coordinate's offsets in ascending order, (B, K, D, N), mm."""
        ordered = self.offsets.copy()
        ordered.sort(axis=-1)
        return ordered

    @cached_property
    def median(self) -> FloatArray:
        """Per-coordinate median of the offsets, (B, K, D), mm; between the two middle values for an even N."""
        middle, odd = divmod(self.n_hypotheses, 2)
        upper: FloatArray = self.sorted[..., middle]
        return upper if odd else (self.sorted[..., middle - 1] + upper) / 2

    @cached_property
    def squared_errors(self) -> FloatArray:
        """Squared distance of each hypothesis from the truth per joint, (B, K, N), mm²."""
        return squared_norms(self.offsets)

    @cached_property
    def errors(self) -> FloatArray:
        """Distance of each hypothesis from the truth per joint, (B, K, N), mm."""
        return np.sqrt(self.squared_errors)

    def weights(self, joints: BoolArray | None = None) -> FloatArray:
        """Give each joint's share in the mean over a pose's joints, (B, K); 0 where a pose has none that counts.

        Parameters
        ----------
        joints : bool array (K,) or (B, K), optional
            The joints that a metric is about; all by default.
        """
        counted = self.where if joints is None else self.where & joints
        number = counted.sum(axis=1, keepdims=True)
        shares: FloatArray = (counted / np.maximum(number, 1)).astype(self.offsets.dtype)
        return shares

    @cached_property
    def where_before(self) -> BoolArray:
        """The joints that counted in the pose before, (B, K); none without one."""
        before = np.zeros_like(self.where)
        before[1:] = self.where[:-1]
        if self._previous is not None:
            before[:1] = True if self._previous[2] is None else self._previous[2]
        if self._follows is not None:
            before[~self._follows] = False
        return before

    @cached_property
    def velocity_offsets(self) -> FloatArray:
        """Change of the offsets since the pose before, (B, K, D, N), mm per frame; 0 where either does not count."""
        before = np.zeros_like(self.offsets)
        before[1:] = self.offsets[:-1]
        if self._previous is not None:
            before[:1] = _offsets(*self._previous[:2], self._root)
        return np.where((self.where & self.where_before)[..., None, None], self.offsets - before, 0)


def _finite(lay_out: Callable[[BoolArray], Block], where: BoolArray) -> Block:
    """Lay out the joints of a mask whose coordinates are all finite."""
    block = lay_out(where)
    return lay_out(where & ~block.non_finite) if block.non_finite.any() else block


def _offsets(hypotheses: FloatArray, truth: FloatArray, root: int | None) -> FloatArray:
    """Subtract the truth, (N, B, K, D) minus (B, K, D), root-relative where a root is given, as (B, K, D, N)."""
    offsets = np.empty((*truth.shape, len(hypotheses)), dtype=working_dtype(hypotheses.dtype))
    with np.errstate(invalid="ignore", over="ignore"):  # joints that don't count may hold anything
        offsets[...] = hypotheses.transpose(1, 2, 3, 0)
        offsets -= truth[..., None].astype(offsets.dtype, copy=False)
        if root is not None and offsets[:, root].any():
            offsets -= offsets[:, root, None].copy()
    return offsets


def _relative(truth: FloatArray, root: int | None, dtype: np.dtype[np.floating]) -> FloatArray:
    """Give true poses relative to the root, if there is one, in the precision of the offsets."""
    with np.errstate(invalid="ignore", over="ignore"):
        wide = truth.astype(working_dtype(truth.dtype), copy=False)
        return (wide if root is None else wide - wide[:, root, None]).astype(dtype)
