"""Blocks: a few poses at a time, laid out so that rows of hypotheses are contiguous.

A *block* holds B poses as one contiguous array of *offsets* from the truth, ``x - y``, laid out ``(B, K, D, N)``: along
the last axis the N hypotheses of one coordinate of one joint. Rows that one sorts or sums are then contiguous, and a
block fits into the processor's cache. What several metrics need (errors, sorted coordinates) is computed once per
block, when it is first asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from posecal.data.arrays import BoolArray, FloatArray, squared_norms, working_dtype
from posecal.data.degenerate import LARGEST, LARGEST_ANGLE, is_outside
from posecal.data.root import AnyRoot
from posecal.engine.circular import circular_mean, turns_of_pool, unwrapped, wrapped
from posecal.engine.coordinate_range import CoordinateRange, coordinate_range
from posecal.engine.memory import reuse_freed_memory
from posecal.engine.offsets import far_roots, offsets_from_truth, relative_to_root
from posecal.engine.weighted import LEAST_SPREAD, effective_counts, effective_number, weighted_median
from posecal.errors import PoseDataError

if TYPE_CHECKING:
    from collections.abc import Hashable

Result = TypeVar("Result")

BLOCK_BYTES = 1536 * 1024
"""About what the offsets of one block take: few enough to stay in cache, enough that the calls cost little."""

MOST_POSES = 2048
"""The most poses of a block, however few hypotheses they have: tables of a pose have a size of their own."""


class Block:
    """B poses as offsets from the truth, laid out so that rows are contiguous, and what several metrics share.

    Parameters
    ----------
    hypotheses : array (N, B, K, D)
        Hypotheses, mm, in any memory layout.
    truth : array (B, K, D)
        True poses, mm.
    where : bool array (B, K), optional
        The joints that count; the others may hold anything, NaN included.
    root : int or Root, optional
        What is subtracted from every pose; None leaves positions as they are.
    previous : callable, optional
        Lays out the poses before the first one, as many as the highest order of differences over time, or all.
    follows : bool array (B,), optional
        Whether each pose comes right after the one before it in its sequence.
    scores : array (N, B), optional
        The model's own score of each hypothesis; higher is better.
    log_prob : array (B,), optional
        The model's log density at the true pose, nats; NaN where it has none.
    weights : array (B, N), optional
        The weight of each hypothesis, of sum 1 for each pose; equal ones by default.
    occluded : bool array (B, K), optional
        The joints whose keypoints were not seen; none by default.
    usable : bool array (B, K), optional
        Those to which alignments are fitted, those that count among them; those that count by default.
    reference : array (R, B, K, D), optional
        Hypotheses of the same poses by another model, that skills are relative to, mm.
    limits : callable, optional
        Gives the range of all true poses that are evaluated together; of these by default.
    sequence : array of int (B,), optional
        The sequence of each pose; each pose is one by default.
    period : float, optional
        After how much coordinates repeat, such as 360 for degrees: hypotheses are unwrapped about their circular mean.

    Attributes
    ----------
    offsets : array (B, K, D, N)
        Hypotheses minus truth, mm; 0 for joints that don't count.
    truth : array (B, K, D)
        True poses, mm, relative to the root; 0 for joints that don't count.
    where : bool array (B, K)
        The joints that count.
    follows : bool array (B,)
        Whether each pose comes right after the one before it.
    stored, root
        What came, and what is subtracted from it.
    period : float or None
        After how much coordinates repeat.
    log_prob : array (B,) or None
        The model's log density at the true pose.
    weights : array (B, N) or None
        The weights of the hypotheses; None where they are equal.
    """

    def __init__(
        self,
        hypotheses: FloatArray,
        truth: FloatArray,
        where: BoolArray | None = None,
        *,
        root: AnyRoot = None,
        previous: Callable[[], Block] | None = None,
        follows: BoolArray | None = None,
        scores: FloatArray | None = None,
        log_prob: FloatArray | None = None,
        weights: FloatArray | None = None,
        occluded: BoolArray | None = None,
        usable: BoolArray | None = None,
        reference: FloatArray | None = None,
        limits: Callable[[], CoordinateRange] | None = None,
        sequence: npt.NDArray[np.intp] | None = None,
        period: float | None = None,
    ) -> None:
        reuse_freed_memory()
        self.occluded = np.zeros(truth.shape[:2], dtype=bool) if occluded is None else occluded
        self.where = np.ones(truth.shape[:2], dtype=bool) if where is None else where
        self.offsets, self.period, self.weights = offsets_from_truth(hypotheses, truth, root), period, weights
        if period is not None:
            outside = is_outside(self.offsets, LARGEST_ANGLE)
            self.offsets = np.where(outside, np.nan, unwrapped(self.offsets, period))
        self.truth = relative_to_root(truth, root, self.offsets.dtype)
        if not self.where.all():
            self.offsets[~self.where] = 0
            self.truth = np.where(self.where[..., None], self.truth, 0)
        self.stored, self.root = (hypotheses, truth), root
        self.follows = np.ones(len(truth), dtype=bool) if follows is None else follows
        self._previous, self._scores, self.log_prob = previous, scores, log_prob
        self._limits, self._sequence = limits, sequence
        self._shared: dict[Hashable, Any] = {}
        self._make_fit_block: Callable[[], Block] | None = None
        if usable is not None:
            lay_out = partial(Block, hypotheses, truth, root=root, scores=scores, weights=weights, period=period)
            self._make_fit_block = partial(_where_finite, lay_out, usable)
        self._reference = (
            None if reference is None else partial(Block, reference, truth, where, root=root, period=period)
        )

    @property
    def fit_block(self) -> Block:
        """The same poses with every usable joint whose coordinates are finite, to which alignments are fitted.

        The block itself where only the joints that count are usable. (It never refers to itself: that would keep it
        in memory until Python next looks for reference cycles.)
        """
        return self if self._make_fit_block is None else self.share("fit_block", self._make_fit_block)

    def scale_dispersion(self, factor: float, centres: FloatArray | None = None) -> Block:
        """Give the same poses with the distances of the hypotheses from their median, or from centres, multiplied.

        Parameters
        ----------
        factor : float
            By which they are multiplied.
        centres : array (B, K, D, N), optional
            The centre of each hypothesis; of angles it is the median.
        """
        centre, times = self.median[..., None], self.offsets.dtype.type(factor)
        other = Block.__new__(Block)
        other.__dict__ |= {name: value for name, value in vars(self).items() if not hasattr(Block, name)}
        other._previous, other._shared = None, {}
        if self._make_fit_block is not None:
            other._make_fit_block = lambda: self.fit_block.scale_dispersion(factor)
        if self.period is not None:
            moved = centre + times * self.shortest(self.offsets - centre)
            other.offsets = unwrapped(moved, self.period)
            return other
        if centres is not None:
            other.offsets = centres + times * (self.offsets - centres)
            return other
        other.offsets = centre + times * (self.offsets - centre)
        other.__dict__["sorted"] = centre + times * (self.sorted - centre)  # the order stays
        return other

    @cached_property
    def non_finite(self) -> BoolArray:
        """The poses and joints, (B, K), at which a coordinate that counts is NaN, infinite or too large."""
        far = far_roots(self.stored[0], self.where, self.root)
        is_near = np.einsum("bkn->", self.squared_errors) < LARGEST**2  # one fast pass; true of nearly every block
        return far if is_near else np.asarray(far | is_outside(self.offsets).any(axis=(2, 3)))

    @cached_property
    def reference(self) -> Block | None:
        """The same poses with the hypotheses that skills are relative to; None without any."""
        return None if self._reference is None else self._reference()

    @cached_property
    def range_of_others(self) -> tuple[FloatArray, FloatArray]:
        """The range of the true poses of the other sequences that are evaluated together, (B, K, D) twice, mm."""
        of_all = self._limits() if self._limits else coordinate_range(self.truth, self.where, sequence=self._sequence)
        return of_all.without(np.arange(len(self.truth)) if self._sequence is None else self._sequence)

    def share(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        """Compute something once per block, whoever asks first."""
        if key not in self._shared:
            self._shared[key] = compute()
        result: Result = self._shared[key]
        return result

    def shortest(self, offsets: FloatArray) -> FloatArray:
        """Give the shorter way round, where coordinates repeat; elsewhere the offsets themselves."""
        return offsets if self.period is None else wrapped(offsets, self.period)

    def mean_of(self, offsets: FloatArray, shares: FloatArray | None = None) -> FloatArray:
        """Mean over the hypotheses, (B, K, D, 1), by their weights, or by shares (B, N); circular where they repeat."""
        shares = self.weights if shares is None else shares
        if self.period is not None:
            return circular_mean(offsets, self.period, 1.0 if shares is None else shares[:, None, None])[..., None]
        if shares is not None:
            return np.asarray(np.einsum("bkdn,bn->bkd", offsets, shares.astype(offsets.dtype)))[..., None]
        return np.asarray(np.einsum("bkdn->bkd", offsets))[..., None] / offsets.dtype.type(offsets.shape[-1])

    def mean_of_each(self, values: npt.NDArray[Any], dtype: npt.DTypeLike | None = None) -> FloatArray:
        """Mean over the hypotheses of a number of each, (B, ..., N) to (B, ...): in double, where they have weights."""
        if self.weights is None:
            return np.asarray(values.mean(axis=-1, dtype=dtype))
        return np.asarray(np.einsum("b...n,bn->b...", values, self.weights))

    def count(self, chosen: BoolArray) -> npt.NDArray[Any]:
        """Count the chosen hypotheses, (B, ..., N) to (B, ...): effective ones where they have weights."""
        return np.asarray(chosen.sum(axis=-1) if self.weights is None else effective_counts(chosen, self.weights))

    @cached_property
    def n_effective(self) -> FloatArray:
        """Effective number of hypotheses of each pose, (B,): N where they have no weights."""
        n = np.full(len(self.truth), float(self.n_hypotheses))
        return n if self.weights is None else effective_number(self.weights)

    @property
    def has_spread(self) -> bool:
        """Whether poses have more than one hypothesis that counts; those that have none lie in blocks of their own."""
        return bool((self.n_effective >= LEAST_SPREAD).all())

    @cached_property
    def pooled(self) -> FloatArray:
        """The offsets, (B, K, D, N), in an order that does not depend on which of N + 1 points is the truth, at 0.

        Where coordinates repeat, all these points are unwrapped about their circular mean.
        """
        if self.period is None:
            return self.offsets
        turns = turns_of_pool(np.concatenate([self.poses, self.truth[..., None]], axis=-1), self.period)
        return self.offsets - (turns[..., :-1] - turns[..., -1:]) * self.offsets.dtype.type(self.period)

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
        """Per-coordinate median of the offsets, (B, K, D), mm, by their weights; midway between the middle values."""
        if self.weights is not None:
            return weighted_median(self.offsets, self.weights[:, None, None])
        middle, odd = divmod(self.n_hypotheses, 2)
        upper: FloatArray = self.sorted[..., middle]
        return upper if odd else (self.sorted[..., middle - 1] + upper) / 2

    @cached_property
    def from_median(self) -> FloatArray:
        """The offsets minus their median, (B, K, D, N), mm."""
        return self.offsets - self.median[..., None]

    @cached_property
    def variance(self) -> FloatArray:
        """Mean squared deviation of the hypotheses from their mean, (B, K, D), mm², in double; 0 where all agree.

        The mean lies within one deviation of the median, so that no digits are lost in the difference.
        """
        if self.weights is not None:
            return np.asarray(self.mean_of_each(self.from_median**2) - self.mean_of_each(self.from_median) ** 2)
        n = self.n_hypotheses
        squares = np.einsum("bkdn,bkdn->bkd", self.from_median, self.from_median).astype(np.float64) / n
        mean = np.einsum("bkdn->bkd", self.from_median).astype(np.float64) / n
        return np.asarray(squares - mean**2)

    @cached_property
    def squared_errors(self) -> FloatArray:
        """Squared distance of each hypothesis from the truth per joint, (B, K, N), mm²."""
        return squared_norms(self.shortest(self.offsets))

    @cached_property
    def errors(self) -> FloatArray:
        """Distance of each hypothesis from the truth per joint, (B, K, N), mm."""
        return np.sqrt(self.squared_errors)

    def joint_weights(self, joints: BoolArray | None = None) -> FloatArray:
        """Give each joint's share in the mean over a pose's joints, (B, K); 0 where a pose has none that counts.

        Parameters
        ----------
        joints : bool array (K,) or (B, K), optional
            The joints that a metric is about; all by default.
        """

        def compute() -> FloatArray:
            counted = self.where if joints is None else self.where & joints
            number = np.maximum(counted.sum(axis=1, keepdims=True), 1)
            return np.asarray((counted / number).astype(self.offsets.dtype))

        return self.share(("joint_weights", None if joints is None else joints.tobytes()), compute)

    @cached_property
    def mean_offsets(self) -> FloatArray:
        """The offset of the mean of the hypotheses, (B, K, D, 1); the circular mean where they repeat."""
        return self.mean_of(self.offsets)

    @property
    def poses(self) -> FloatArray:
        """The hypotheses, (B, K, D, N), mm, relative to the root."""
        return self.offsets + self.truth[..., None]

    @property
    def mean_poses(self) -> FloatArray:
        """Their mean, (B, K, D, 1), likewise."""
        return self.mean_offsets + self.truth[..., None]

    def differences(self, order: int, name: str) -> tuple[FloatArray, BoolArray]:
        """Differences over time between each pose and the ``order`` poses before it, of some order.

        Parameters
        ----------
        order : int
            1 for velocities, 2 for accelerations, 3 for jerks; of angles these are of steps the shorter way round.
        name : str
            Of what: an attribute of this class, (B, K, D, …), such as ``offsets`` or ``truth``.

        Returns
        -------
        array (B, K, D, …)
            mm per frame to the power of the order; 0 where it is not counted.
        bool array (B, K)
            The joints that count in all these poses, which follow each other.
        """

        def compute() -> tuple[FloatArray, BoolArray]:
            earlier = partial(self._with_earlier, order)
            where, follows = (sliding_window_view(earlier(name), order + 1, 0) for name in ("where", "follows"))
            counted: BoolArray = np.asarray(where.all(axis=-1) & follows[:, 1:].all(axis=-1, keepdims=True))
            with np.errstate(invalid="ignore"):  # what is not finite is found in its own block
                changes = np.diff(self.shortest(np.diff(earlier(name), axis=0)), order - 1, axis=0)
            changes[~counted] = 0
            return changes, counted

        return self.share(("differences", order, name), compute)

    def _with_earlier(self, number: int, name: str) -> npt.NDArray[Any]:
        """Put an attribute of so many poses before the first one in front of the own, zeros where there are fewer."""
        own: npt.NDArray[Any] = getattr(self, name)
        before = own[:0] if self._previous is None else getattr(self.share("previous", self._previous), name)[-number:]
        return np.concatenate([np.zeros((number - len(before), *own.shape[1:]), dtype=own.dtype), before, own])


def _where_finite(lay_out: Callable[[BoolArray], Block], where: BoolArray) -> Block:
    """Lay out the joints of a mask whose coordinates are all finite."""
    block = lay_out(where)
    return lay_out(where & ~block.non_finite) if block.non_finite.any() else block


def block_length(shape: tuple[int, ...], dtype: npt.DTypeLike) -> int:
    """Give the number of poses in a block of hypotheses of shape (N, M, K, D)."""
    n, _, k, d = shape
    return max(1, min(MOST_POSES, BLOCK_BYTES // (n * k * d * working_dtype(dtype).itemsize)))
