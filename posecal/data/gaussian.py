"""Gaussians and mixtures of Gaussians that a model states for each pose: draws from them, and their log density.

Every frame has a generator of its own, made of the seed and the number of the frame, so that draws don't depend on how
many frames are read at a time, and the first draws of many are those of few.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray, checked_root, real_array, working_dtype
from posecal.data.covariances import (
    Kind,
    decoupled,
    factored,
    fixed_joints,
    full_covariance,
    joints_of,
    log_sum,
    normal_log_density,
    times,
)
from posecal.data.layout import LazyArray, MemoryArray
from posecal.data.root import AnyRoot, origin, resting_joints, root_joints
from posecal.data.stored_poses import Rows
from posecal.errors import PoseDataError, checked_integer, first_few

T = TypeVar("T")

_BLOCK = 1 << 22
"""Numbers of covariances that are read together."""

_DRAWN = 1 << 18
"""Numbers that are drawn together: few enough to stay in cache."""

_SUM = 2.5e-3
"""How far from 1 the sum of the weights of a mixture may be, as of numbers of bfloat16."""


class GaussianPrediction:
    r"""Gaussian, or mixture of C Gaussians, that a model states for each of M poses.

    .. math:: p(y_m) = \sum_c w_{cm} \, \mathcal{N}(y_m; \mu_{cm}, \Sigma_{cm})

    Parameters
    ----------
    mean : array (M, K, D) or (C, M, K, D)
        Means; of C components with ``mixture_weights``.
    covariance : array (M, K, D, D) or (M, KD, KD), optional
        Covariances of each joint's coordinates, or of the whole pose, in the squared unit of the means; with C first
        for mixtures. 0 or NaN throughout for a root joint that does not move; anything for joints that don't count.
    sigma : array (M, K) or (M, K, D), optional
        Standard deviations, of independent coordinates, instead.
    mixture_weights : array (C, M), optional
        Weights of the components, of sum 1 for each pose. A component of weight 0 may be anything.
    name : str
        What messages call it; nothing by default.

    Raises
    ------
    PoseDataError
        For shapes that don't fit, neither or both of ``covariance`` and ``sigma``, and weights that are none.

    Notes
    -----
    Draws of a frame follow from the seed and the frame's number in the evaluation. Shards that are evaluated apart
    number theirs from 0 each, and so draw the same numbers: give each another seed.

    See Also
    --------
    posecal.evaluate : Takes one in place of hypotheses.

    Examples
    --------
    A standard deviation of 1 in each of 3 coordinates: at the mean, the density is (2π)^(-3/2).

    >>> prediction = GaussianPrediction(np.zeros((5, 1, 3)), sigma=np.ones((5, 1)))
    >>> prediction.log_prob(np.zeros((5, 1, 3)))[0].round(4), prediction.sample(10, seed=1).shape
    (np.float64(-2.7568), (10, 5, 1, 3))
    """

    def __init__(
        self,
        mean: npt.ArrayLike | LazyArray,
        covariance: npt.ArrayLike | LazyArray | None = None,
        *,
        sigma: npt.ArrayLike | LazyArray | None = None,
        mixture_weights: npt.ArrayLike | None = None,
        name: str = "",
    ) -> None:
        self.name, self.first = f"{name}: " if name else "", 0
        if (covariance is None) == (sigma is None):
            which = "neither" if sigma is None else "both"
            raise PoseDataError(f"{self.name}covariance and sigma: {which} given; expected one of them.")
        given, word = (covariance, "covariance") if sigma is None else (sigma, "sigma")
        self.mean, self.spread = self._lazy(mean, "mean"), self._lazy(given, word)
        shape = self.mean.shape
        if len(shape) != (3 if mixture_weights is None else 4):
            what = "(M, K, D)" if mixture_weights is None else "(C, M, K, D) with mixture_weights"
            raise PoseDataError(f"{self.name}mean {shape}; expected {what}.")
        lead, (k, d) = shape[:-2], shape[-2:]
        known: dict[tuple[int, ...], Kind] = {(*lead, k): "sigma", shape: "sigma"}
        if sigma is None:
            known = {(*lead, k * d, k * d): "full", (*shape, d): "covariance"}
        if self.spread.shape not in known:
            expected = " or ".join(map(str, known))
            raise PoseDataError(f"{self.name}{word} {self.spread.shape}; expected {expected} beside a mean {shape}.")
        self.kind, self.weights = known[self.spread.shape], self._checked_weights(mixture_weights)
        self.counts: BoolArray | None = None

    def _lazy(self, values: Any, name: str) -> LazyArray:
        lazy: LazyArray = values
        return lazy if hasattr(values, "part") else MemoryArray(real_array(values, f"{self.name}{name}"))

    def _checked_weights(self, given: npt.ArrayLike | None) -> FloatArray:
        """Give weights (C, M) of sum 1."""
        if given is None:
            return np.ones((1, self.mean.shape[0]))
        name, shape = f"{self.name}mixture_weights", self.mean.shape[:2]
        weights = real_array(given, name).astype(np.float64)
        if weights.shape != shape:
            raise PoseDataError(f"{name} {weights.shape}; expected (C, M) = {shape}.")
        total = weights.sum(axis=0)
        bad = np.flatnonzero(~((weights >= 0).all(axis=0) & (np.abs(total - 1) < _SUM)))
        if len(bad):
            raise PoseDataError(
                f"{name}: below 0, or not of sum 1, in {len(bad):,} of {shape[1]:,} frames (first: "
                f"{first_few(bad.tolist())}); expected weights of at least 0 and sum 1."
            )
        return np.asarray(weights / total)

    def __repr__(self) -> str:
        (c, _), (m, k, d) = self.weights.shape, self.shape
        return f"GaussianPrediction(C={c}, M={m}, K={k}, D={d})"

    @property
    def shape(self) -> tuple[int, int, int]:
        """(M, K, D)."""
        m, k, d = self.mean.shape[-3:]
        return m, k, d

    @property
    def dtype(self) -> np.dtype[np.floating]:
        """The type of draws: single precision where the means have it."""
        return working_dtype(self.mean.dtype)

    # --- draws

    def sample(self, n: int, seed: int = 0) -> FloatArray:
        """Draw hypotheses.

        Parameters
        ----------
        n : int
            N.
        seed : int
            Of the generators; frame m has its own, whatever else is drawn.

        Returns
        -------
        array (N, M, K, D)
            In the unit of the means.

        Raises
        ------
        PoseDataError
            For covariances that are not symmetric or not positive definite.
        """
        return self.sample_frames(0, self.shape[0], checked_integer(n, "n", 1), checked_integer(seed, "seed", 0))

    def sample_frames(self, start: int, stop: int, n: int, seed: int) -> FloatArray:
        """Draw hypotheses of some frames, (N, stop - start, K, D)."""
        _, k, d = self.shape
        rows = np.arange(start, stop)
        mean, spread = self._read(rows)
        factor, fixed, bad = factored(spread, self.kind, d)
        if self.counts is not None and bad.any():  # again, without what does not count
            some = np.flatnonzero(bad)
            others = decoupled(spread[:, some], self.kind, ~self.counts[rows[some]], d)
            factor[:, some], _, bad[some] = factored(others, self.kind, d)
        counts = True if self.counts is None else self.counts[rows]
        self._refuse(bad, _are_lost(mean, fixed, counts), rows.astype(str).tolist())
        mean = np.where(fixed[..., None] & np.isnan(mean), 0, mean)
        found = np.empty((n, len(rows), k, d), dtype=self.dtype)
        step = max(1, _DRAWN // (n * k * d))
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            z = np.stack([_generator(seed, frame, 0).standard_normal((n, k * d)) for frame in rows[part] + self.first])
            component = self._components(rows[part], n, seed)
            for one in range(len(self.weights)):
                drawn = mean[one, part][:, None] + times(factor[one, part], z, self.kind, (k, d))
                chosen = True if component is None else (component == one)[..., None, None]
                with np.errstate(over="ignore"):  # what is too large is refused where it counts
                    np.copyto(found[:, part].swapaxes(0, 1), drawn, where=chosen, casting="same_kind")
        return found

    def _components(self, rows: Rows, n: int, seed: int) -> Rows | None:
        """Draw the component of each hypothesis of some frames, (m, N); None where there is one."""
        if len(self.weights) == 1:
            return None
        edges = np.cumsum(self.weights[:-1, rows], axis=0)
        shares = np.stack([_generator(seed, frame, 1).random(n) for frame in rows + self.first])
        return np.asarray((shares >= edges[..., None]).sum(axis=0))

    # --- density

    def log_prob(self, truth: npt.ArrayLike, /, *, root: int | None = None) -> FloatArray:
        """Log density at true poses.

        Parameters
        ----------
        truth : array (M, K, D)
            In the unit of the means.
        root : int, optional
            The joint that positions are relative to: the density is then of the other joints' positions relative to it.

        Returns
        -------
        array (M,)
            Nats.

        Raises
        ------
        PoseDataError
            For another shape, and covariances that are not symmetric or not positive definite.
        """
        y = real_array(truth, "truth").astype(np.float64)
        if y.shape != self.shape:
            raise PoseDataError(f"truth {y.shape}; expected (M, K, D) = {self.shape}.")
        m, k, _ = self.shape
        rows = np.arange(m)
        return self.log_density(y, rows, np.arange(k), checked_root(root, k), rows.astype(str).tolist())

    def log_density(
        self, truth: FloatArray, rows: Rows, columns: Rows, root: AnyRoot, frames: Sequence[str]
    ) -> FloatArray:
        """Log density at the true poses of some frames and joints, relative to a root.

        Parameters
        ----------
        truth : array (m, k, D)
            In the unit of the means; NaN for what is not known.
        rows, columns : arrays of int (m,) and (k,)
            The frames and joints.
        root : int, Root or None
            Among these joints; one without midpoints.
        frames : sequence of str
            Names for messages.

        Returns
        -------
        array (m,)
            Nats; the joints that are the root are not among the coordinates.
        """
        found, (bad, lost) = np.empty(len(rows)), np.zeros((2, len(rows)), dtype=bool)
        for part in self._blocks(len(rows)):
            found[part], bad[part], lost[part] = self._log_density(truth[part], rows[part], columns, root)
        self._refuse(bad, lost, frames)
        return found

    def _log_density(
        self, truth: FloatArray, rows: Rows, columns: Rows, root: AnyRoot
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        d, k = truth.shape[-1], len(columns)
        mean, spread = self._read(rows)
        mean, spread = mean[:, :, columns], joints_of(spread, self.kind, columns, d)
        fixed = fixed_joints(spread, self.kind, d)
        away = truth - np.where(fixed[..., None] & np.isnan(mean), 0, mean)
        kind, keep = self.kind, np.arange(k)
        counts = np.ones((len(rows), k), dtype=bool) if self.counts is None else self.counts[np.ix_(rows, columns)]
        lost = _are_lost(mean, fixed, counts)
        if not counts.all():
            counts &= counts[:, root_joints(root)].all(axis=1, keepdims=True)
            spread = decoupled(spread, kind, ~counts, d)
        if root is not None:
            relative = np.eye(k) - origin(np.eye(k), root)
            keep = np.setdiff1d(keep, resting_joints(root))
            away = np.einsum("kj,cmjd->cmkd", relative[keep], away)
            if fixed[:, :, root_joints(root)].all():
                spread = joints_of(spread, kind, keep, d)
            else:
                turn = np.kron(relative[keep], np.eye(d))
                with np.errstate(invalid="ignore"):  # of frames that are refused
                    spread, kind = turn @ full_covariance(spread, kind, d) @ turn.T, "full"
        factor, fixed, bad = factored(spread, kind, d)
        bad |= fixed.any(axis=(0, 2))
        with np.errstate(divide="ignore"):
            weights = np.log(self.weights[:, rows])
        with np.errstate(invalid="ignore"):  # of frames that are refused
            return log_sum(weights + normal_log_density(away, factor, kind)), bad, lost

    def _refuse(self, bad: BoolArray, lost: BoolArray, frames: Sequence[str]) -> None:
        """Refuse frames with spreads or means that can't be."""
        word, expected, unit = "covariance", "symmetric and positive definite", "the squared unit of the mean"
        if self.kind == "sigma":
            word, expected, unit = "sigma", "above 0", "the unit of the mean"
        for wrong, what, where in ((bad, f"{word}: not {expected}", f", in {unit}"), (lost, "mean: not finite", "")):
            if wrong.any():
                first = first_few([frames[row] for row in np.flatnonzero(wrong).tolist()])
                raise PoseDataError(
                    f"{self.name}{what} in {wrong.sum():,} of {len(wrong):,} frames (first: {first}); expected so of "
                    f"every joint but the root{where}."
                )

    # --- reading

    def _blocks(self, number: int) -> Iterator[slice]:
        of_frame = math.prod(self.spread.shape) // self.shape[0] if self.shape[0] else 1
        step = max(1, _BLOCK // max(1, of_frame))
        return (slice(start, start + step) for start in range(0, number, step))

    def _read(self, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """Read means and spreads of some frames, (C, m, …), in double; of components of weight 0 those of another."""
        axis = len(self.mean.shape) - 3
        runs = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
        read = []
        for array in (self.mean, self.spread):
            every = [slice(0, length) for length in array.shape]
            wheres = [(*every[:axis], slice(int(run[0]), int(run[-1]) + 1), *every[axis + 1 :]) for run in runs]
            some = np.concatenate([array.part(where) for where in wheres], axis=axis).astype(np.float64)
            read.append(some if axis else some[None])
        weights = self.weights[:, rows]
        component, row = np.nonzero(weights == 0)
        for some in read:
            some[component, row] = some[weights.argmax(axis=0)[row], row]
        return read[0], read[1]


def counting(prediction: GaussianPrediction, rows: Rows, columns: Rows, counts: BoolArray | None) -> GaussianPrediction:
    """Give a prediction of which only some frames and joints count: what it states of others may be anything.

    Parameters
    ----------
    prediction : GaussianPrediction
        Of all.
    rows, columns : arrays of int (m,) and (k,)
        The frames and joints that may count.
    counts : bool array (m, k) or None
        Those of them that do; all by default.
    """
    other = copy.copy(prediction)
    other.counts = np.zeros(prediction.shape[:2], dtype=bool)
    other.counts[np.ix_(rows, columns)] = True if counts is None else counts
    return other


def starting_at(hypotheses: T, frame: int) -> T:
    """Give a prediction with its first frame at another number, by which its draws are seeded; all else as it is."""
    if not isinstance(hypotheses, GaussianPrediction):
        return hypotheses
    other = copy.copy(hypotheses)
    other.first = frame
    return other


def _are_lost(mean: FloatArray, fixed: BoolArray, counts: BoolArray | bool) -> BoolArray:
    """Find frames (m,) in which a joint that counts moves about a mean (C, m, K, D) that is not finite."""
    return np.asarray((~np.isfinite(mean).all(axis=-1) & ~fixed & counts).any(axis=(0, 2)))


def _generator(seed: int, frame: int, stream: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, stream, int(frame)]))
