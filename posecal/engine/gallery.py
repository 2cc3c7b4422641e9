"""A gallery: the poses of the worst sequences, with some of their hypotheses, kept beside the sums for pictures.

Worst is by two orders: the error of the median pose, and how far the pose's signed area is from 0 (of equal ones, how
far its error is from its spread). In each order every sequence has its worst pose before any has its second, and of
poses of a sequence that are near in time there is one. So the gallery of two sets of poses is chosen from their two
galleries, and memory does not grow with the number of poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray, squared_norms
from posecal.data.root import AnyRoot, origin
from posecal.engine.chunks import Chunk
from posecal.engine.scope import DataSpec
from posecal.engine.sums import Indices
from posecal.engine.weighted import weighted_median, weighted_quantiles

POSE_NUMBERS = "pose_numbers"
"""The name of the statistic that poses are chosen by."""

NUMBERS = ("signed_area", "predicted_spread", "median_pose_error", "min_mpjpe")
"""The columns of this statistic, (B, 4)."""

FRAMES = 6
"""Poses of each order."""

MOST_HYPOTHESES = 50
"""Hypotheses of a pose that are kept."""

SHARES = 0.5, 0.9
"""Of the hypotheses, that the balls about their median hold."""

MISSING = -32768
"""What stands for a coordinate that does not count."""

_LARGEST = 32767
_BYTES = 120_000

_NEAR = 64
"""So many frames of a sequence, from a multiple of it, stand for one another."""


@dataclass(frozen=True)
class Gallery:
    """F poses, as 16-bit integers.

    Attributes
    ----------
    poses : array of int16 (F, H + 2, K, D)
        Relative to the root: the true pose, the median of all hypotheses, and H of them, as often as their weights
        are; ``MISSING`` where a joint does not count.
    step : array (F,)
        What one stands for, in the unit of the data: 1 mm, or a 32767th of the largest coordinate.
    radii : array (F, K, 2)
        Of the balls about the median that hold the shares ``SHARES`` of all hypotheses.
    nearer : array (F, K)
        Share of all hypotheses that are nearer to their median than the truth is.
    numbers : array (F, 4)
        See ``NUMBERS``.
    sequence, frame_id : arrays of str (F,)
        What the poses are called; an empty sequence where those have no labels.
    order : array of int (F,)
        Rising numbers of the poses of a sequence.
    """

    poses: npt.NDArray[np.int16]
    step: FloatArray
    radii: FloatArray
    nearer: FloatArray
    numbers: FloatArray
    sequence: npt.NDArray[np.str_]
    frame_id: npt.NDArray[np.str_]
    order: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.order)

    def select(self, rows: Indices) -> Self:
        """Keep some poses."""
        return type(self)(**{name: values[rows] for name, values in vars(self).items()})

    @property
    def orders(self) -> tuple[Indices, Indices]:
        """The rows by calibration and by error, worst first."""
        return worst_rows(self.sequence, self.order, self.numbers)

    def check(self, spec: DataSpec) -> None:
        """Refuse arrays that no gallery of such data has.

        Raises
        ------
        ValueError
            With the name of the first.
        """
        f, h, k, d = len(self.order), number_shown(spec), len(spec.joints), spec.n_coordinates
        shapes = {"poses": (h + 2, k, d), "radii": (k, len(SHARES)), "nearer": (k,), "numbers": (len(NUMBERS),)}
        kinds = {"sequence": "U", "frame_id": "U", "order": "i", "poses": "i"}
        for name, values in vars(self).items():
            if values.shape != (f, *shapes.get(name, ())) or values.dtype.kind != kinds.get(name, "f"):
                raise ValueError(f"gallery: {name}")
        if not h or not (np.isfinite(self.step) & (self.step > 0)).all():
            raise ValueError("gallery: step")


def number_shown(spec: DataSpec) -> int:
    """Give how many hypotheses of a pose are kept: fewer of many joints, 0 of angles, single numbers and meshes."""
    if spec.n_coordinates not in (2, 3) or spec.period is not None:
        return 0
    return min(spec.n_hypotheses, MOST_HYPOTHESES, _BYTES // (4 * FRAMES * len(spec.joints) * spec.n_coordinates))


def worst_rows(
    sequence: npt.NDArray[np.str_], order: npt.NDArray[np.int64], numbers: FloatArray
) -> tuple[Indices, Indices]:
    """Choose the worst of some poses, by calibration and by error.

    Parameters
    ----------
    sequence, order : arrays (R,)
        Where the poses stand.
    numbers : array (R, 4)
        See ``NUMBERS``.

    Returns
    -------
    by_calibration, by_error : arrays of int
        At most ``FRAMES`` rows each, worst first; none whose number is NaN.
    """
    area, spread, error, _ = numbers.T
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(np.log(error / spread)).astype(np.float64)
        ratio = np.nan_to_num(ratio, nan=0.0, posinf=np.finfo(float).max)
    return _worst(sequence, order, np.abs(area), ratio), _worst(sequence, order, error, error)


def _worst(
    sequence: npt.NDArray[np.str_], order: npt.NDArray[np.int64], score: FloatArray, then: FloatArray
) -> Indices:
    rows = np.lexsort((then, score))[::-1]
    rows = rows[~np.isnan(score[rows])]
    number, chosen, seen = dict[str, int](), list[tuple[int, int]](), set[tuple[str, int]]()
    for row, name, time in zip(rows.tolist(), sequence[rows].tolist(), (order[rows] // _NEAR).tolist(), strict=True):
        if (name, time) not in seen:
            seen.add((name, time))
            number[name] = number.get(name, -1) + 1
            chosen.append((number[name], row))
    chosen.sort(key=lambda entry: entry[0])
    return np.array([row for _, row in chosen[:FRAMES]], dtype=np.intp)


def worst_of(chunk: Chunk, spec: DataSpec, known: Gallery | None, numbers: FloatArray) -> Gallery | None:
    """Give the poses of a chunk that are among the worst of theirs and of a gallery's; None where there are none.

    Parameters
    ----------
    chunk : Chunk
        B poses.
    spec : DataSpec
        What the data are.
    known : Gallery or None
        Of the poses before.
    numbers : array (B, 4)
        See ``NUMBERS``.
    """
    n, before = len(chunk), (chunk.sequence_name, chunk.order, numbers)
    if known is None:
        rows = np.union1d(*worst_rows(*before))
    else:
        kept = known.sequence, known.order, known.numbers
        rows = np.union1d(*worst_rows(*(np.concatenate(pair) for pair in zip(before, kept, strict=True))))
        rows = rows[rows < n]
    return _packed(chunk, rows, spec, numbers) if len(rows) else None


def join_galleries(galleries: Sequence[Gallery]) -> Gallery:
    """Choose the worst poses of several galleries, at least one, in the order in which they stand."""
    joined = {name: np.concatenate([vars(some)[name] for some in galleries]) for name in vars(galleries[0])}
    gallery = Gallery(**joined)
    return gallery.select(np.union1d(*gallery.orders))


def of_part(gallery: Gallery, number: int) -> Gallery:
    """Name poses without sequence labels after the part of several that they are in, where they have no such name."""
    is_named = (gallery.sequence != "").all()
    return gallery if is_named else replace(gallery, sequence=np.full(len(gallery), f"part {number}"))


def of_parts(galleries: Sequence[Gallery]) -> list[Gallery]:
    """Name poses without sequence labels after their parts, and parts of parts so that no two have one name."""
    named = [of_part(gallery, number) for number, gallery in enumerate(galleries, 1)]
    names = np.concatenate([np.unique(gallery.sequence) for gallery in named])
    if len(np.unique(names)) == len(names):
        return named
    return [replace(g, sequence=np.char.add(f"part {number}, ", g.sequence)) for number, g in enumerate(named, 1)]


def _packed(chunk: Chunk, rows: Indices, spec: DataSpec, numbers: FloatArray) -> Gallery:
    poses, step, radii, nearer = zip(
        *(_pack(chunk.select(rows[i : i + 1]), spec) for i in range(len(rows))), strict=True
    )
    return Gallery(
        poses=np.stack(poses),
        step=np.array(step),
        radii=np.stack(radii),
        nearer=np.stack(nearer),
        numbers=numbers[rows],
        sequence=chunk.sequence_name[rows],
        frame_id=chunk.frame_id[rows],
        order=chunk.order[rows].astype(np.int64),
    )


def _pack(chunk: Chunk, spec: DataSpec) -> tuple[npt.NDArray[np.int16], float, FloatArray, FloatArray]:
    """Give the coordinates of the one pose of a chunk, what one stands for, and radii and nearness of its joints."""
    given = np.ones(len(chunk.hypotheses)) if chunk.weights is None else chunk.weights[:, 0]
    weights = given[given > 0] / given.sum()
    x, y = _rooted(chunk.hypotheses[given > 0, 0], spec.root), _rooted(chunk.truth[0], spec.root)
    where = np.ones(len(y), dtype=bool) if chunk.where is None else chunk.where[0]
    x, y = np.where(where[:, None], x, 0), np.where(where[:, None], y, 0)  # the others may hold anything
    median = weighted_median(np.moveaxis(x, 0, -1), weights)
    away, true = (np.sqrt(squared_norms((points - median)[..., None]))[..., 0] for points in (x, y))
    radii = weighted_quantiles(away.T, weights, SHARES)
    nearer = ((away < true) * weights[:, None]).sum(axis=0)
    shown = number_shown(spec)
    at = np.minimum(np.searchsorted(np.cumsum(weights), (np.arange(shown) + 0.5) / shown), len(x) - 1)
    points = np.concatenate([y[None], median[None], x[at]])
    largest = float(np.abs(points).max())
    step = 1.0 if spec.unit == "mm" and largest <= _LARGEST else max(largest, 1e-30) / _LARGEST
    packed = np.where(where[:, None], np.rint(points / step), MISSING).astype(np.int16)
    return packed, step, np.where(where[:, None], radii, np.nan), np.where(where, nearer, np.nan)


def _rooted(poses: FloatArray, root: AnyRoot) -> FloatArray:
    poses = np.asarray(poses, dtype=np.float64)
    return poses if root is None else poses - origin(poses, root)
