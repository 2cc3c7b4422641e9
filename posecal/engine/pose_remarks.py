"""Remarks on hypotheses and truth that may be none: every pose is looked at as it is read, so that counts add up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.degenerate import FEWEST_JOINTS, Fills, Repeats, is_one_point
from posecal.data.joint_names import joint_keys
from posecal.data.remarks import Count, Example, Remark
from posecal.data.root import root_joints
from posecal.engine.chunks import Chunk
from posecal.engine.metric import Statistic
from posecal.engine.ragged import present
from posecal.engine.scope import DataSpec, Scope

_SHOWN = 3
"""How many frames a remark names."""

_HYPOTHESES = 50
"""Of twice as many and more, some are looked at for fill values."""

_BYTES = 8 * 1024 * 1024
"""How much of the hypotheses is looked at at a time, of what memory holds."""

_FEWEST_COORDINATES = 9
"""Hypotheses of fewer may be equal by chance."""

_REMEMBERED = 65_536
"""Of so many poses, the first ones, it is known whether the hypotheses of a later one are theirs."""

_ROUNDED = 0.01
"""A hypothesis so many times nearer to the truth than most, in every coordinate, is the truth in fewer digits."""

_FACTOR = 100.0
"""Hypotheses so many times as large as the truth, or as small, are in another unit."""

_OF_FRAMES = {
    "points": "every hypothesis is one point. Are these frames without a prediction? Leave them out.",
    "same": "all hypotheses are the same. A sampler gives different ones.",
    "size": f"hypotheses are over {_FACTOR:g} times larger or smaller than the truth. Are all in one unit?",
    "repeated": "the hypotheses are those of an earlier frame. Were they stored twice, or beside other frames?",
    "truth": "a hypothesis equals the truth. Is the truth among the samples?",
    "few": "so few joints count that any pose fits them after alignment: aligned numbers (PA-, CPS) are of the others.",
}
_OF_HYPOTHESES = {
    "some points": "are one point, and count. If they stand for absent ones, store NaN.",
    "equal": " there. Spread, calibration and scores are those of fewer; posecal.collapse_copies gives the distinct "
    "ones with weights.",
    "score 0": "have score 0 or -inf, and count: the scores of their frame are no weights (at least 0, of sum 1). If "
    "they stand for absent ones, store weights, or NaN as coordinates.",
}


_EQUAL = "equal another of their frame, which leaves "


class PoseRemarks:
    """Hypotheses that look like none, or like no samples, and joints that look like none, or are too few to align.

    Parameters
    ----------
    scope : Scope, optional
        Which joints are scored, and how they are aligned.
    statistics : sequence of Statistic
        What is measured of them.
    """

    def __init__(self, scope: Scope | None = None, statistics: Sequence[Statistic] = ()) -> None:
        self._scope = scope
        self._least = max((scope.fewest_to_align(each.name) for each in statistics), default=0) if scope else 0
        self._frames, self._hypotheses = Counter[str](), Counter[str]()
        self._first: dict[str, list[str]] = {}
        self._looks = (Fills(), Repeats()), (Fills(), Repeats())  # at hypotheses, at truth
        self._poses, self._names, self._step, self._distinct = 0, ("", ""), 1, 0
        self._seen: set[float] = set()  # a number of the hypotheses of each pose

    def add(self, names: tuple[str, str], chunk: Chunk, frames: npt.NDArray[np.str_], spec: DataSpec) -> None:
        """Look at more poses.

        Parameters
        ----------
        names : tuple of two str
            What messages call hypotheses and truth.
        chunk : Chunk
            The m poses.
        frames : array of str (m,)
            Names of their frames.
        spec : DataSpec
            What all poses have in common.
        """
        self._poses, self._names = self._poses + len(frames), names
        self._step = max(1, len(chunk.hypotheses) // _HYPOTHESES)
        step = max(1, _BYTES // chunk.hypotheses[:, 0].nbytes)
        for start in range(0, len(chunk), step):
            part = slice(start, start + step)
            self._look(chunk.select(part), frames[part], spec)

    def _look(self, chunk: Chunk, frames: npt.NDArray[np.str_], spec: DataSpec) -> None:
        x, y, where = chunk.hypotheses, chunk.truth, chunk.where
        there = present(x, chunk.scores, chunk.weights) if spec.is_ragged else np.ones(x.shape[:2], dtype=bool)
        if where is not None:
            there &= where.any(axis=1)
            if self._scope is not None:
                usable = where if chunk.usable is None else chunk.usable
                few = np.count_nonzero(usable[:, self._scope.fit], axis=1) < self._least
                self._note("few", few & where[:, self._scope.body].any(axis=1), frames)
        with np.errstate(invalid="ignore", over="ignore"):  # joints that don't count may hold anything
            points = is_one_point(x, where) & there
            empty = (points == there).all(axis=0) & there.any(axis=0)
            self._note("points", empty, frames)
            self._note("some points", points & ~empty, frames)
            self._note("score 0", _without_weight(chunk.scores, there), frames)
            self._note_equal(x, where, there & ~points, frames)
            if len(x) > 1 or not spec.clip_length:  # one pose over a clip is a prediction
                self._note_repeated(x, where, there & ~points, frames)
            root = root_joints(spec.root)
            self._note_truth(x, y, where, frames, root)
            if x.shape[2] >= FEWEST_JOINTS and x.shape[3] > 1:
                self._note("size", _differ_in_size(x[0], y, where) & ~points[0], frames)
                keys = joint_keys(spec.joints)
                resting = root or [keys.index("Hip") if "Hip" in keys else 0]
                for some, others, counted, fills, repeats in (
                    (x, y, there & ~points, *self._looks[0]),
                    (y[None], x[0], np.ones((1, len(y)), dtype=bool), *self._looks[1]),
                ):
                    few = slice(None, None, self._step if some is x else 1)
                    fills.add(some[few], others, where, counted[few], resting, spec.joints)
                    repeats.add(some, others if some is x else None, where, root, spec.joints)

    def remarks(self) -> list[str]:
        """Give remarks on them."""
        found: list[str] = []
        for kind, words in (_OF_FRAMES | _OF_HYPOTHESES).items():
            if self._frames[kind]:
                number = Count(self._hypotheses[kind], "hypothesis", "hypotheses")
                frames = Count(self._frames[kind], "frame", of=self._poses)
                first = Example(", ".join(self._first[kind]))
                name = self._names[kind == "few"]
                start = [f"{name}: in "] if kind in _OF_FRAMES else [f"{name}: ", number, " in "]
                end = (
                    [words]
                    if kind != "equal"
                    else [_EQUAL, Count(self._distinct, "distinct one", "distinct ones"), words]
                )
                found.append(Remark(*start, frames, " (first: ", first, ") ", *end))
        words_of = (("hypothesis", "hypotheses"), None), (("pose", ""), self._poses)
        for name, (fills, repeats), (of, total) in zip(self._names, self._looks, words_of, strict=True):
            found += repeats.remarks(name, self._poses)
            looked_at = f"{name} (one in {self._step} looked at)" if total is None and self._step > 1 else name
            found += fills.remarks(looked_at, of, total)
        return found

    def _note(self, kind: str, found: BoolArray, frames: Sequence[str] | npt.NDArray[np.str_]) -> None:
        """Count frames (m,), or hypotheses (N, m)."""
        if found.any():
            rows = np.flatnonzero(found if found.ndim == 1 else found.any(axis=0))
            self._frames[kind] += len(rows)
            self._hypotheses[kind] += int(found.sum())
            self._first[kind] = [*self._first.get(kind, []), *(str(frames[row]) for row in rows[:_SHOWN])][:_SHOWN]

    def _note_equal(
        self, x: FloatArray, where: BoolArray | None, counted: BoolArray, frames: npt.NDArray[np.str_]
    ) -> None:
        """Count hypotheses that equal another one of their pose, and poses of which all do."""
        n, _, k, d = x.shape
        if n < 2 or (n - 1) * k * d < _FEWEST_COORDINATES - 3:
            return
        keys = np.zeros(x.shape[:2], dtype=x.dtype)
        for j in {0, k // 2, k - 1}:
            keys += x[:, :, j, 0] if where is None else np.where(where[:, j], x[:, :, j, 0], 0)
        keys = np.sort(np.where(counted, keys, np.nan), axis=0)  # few poses are left to look at closely
        rows = np.flatnonzero((keys[1:] == keys[:-1]).any(axis=0))
        if not len(rows):
            return
        some = x[:, rows].astype(np.float64)
        if where is not None:
            some = np.where(where[rows][..., None], some, 0)
        keys = (some.reshape(n, len(rows), -1) * np.random.default_rng(0).normal(size=k * d)).sum(axis=2)
        keys = np.sort(np.where(counted[:, rows], keys, np.nan), axis=0)
        repeated = np.zeros((n, x.shape[1]), dtype=bool)
        repeated[1:, rows] = np.diff(keys, axis=0) == 0
        same = (repeated.sum(axis=0) == counted.sum(axis=0) - 1) & (counted.sum(axis=0) > 1)
        self._note("same", same, frames)
        if k * d >= _FEWEST_COORDINATES:
            some_equal = repeated & ~same
            self._note("equal", some_equal, frames)
            self._distinct += int((counted & ~some_equal)[:, some_equal.any(axis=0)].sum())

    def _note_repeated(
        self, x: FloatArray, where: BoolArray | None, counted: BoolArray, frames: npt.NDArray[np.str_]
    ) -> None:
        """Count poses whose hypotheses are all those of an earlier one, among the first :data:`_REMEMBERED`."""
        n, m, k, d = x.shape
        if n * k * d < 2 * _FEWEST_COORDINATES:
            return
        some = x[:, :, [k // 2, k - 1]].astype(np.float64)
        factors = np.random.default_rng(0).normal(size=(n, 1, 2, d))
        keys = (some * factors).sum(axis=(2, 3)).sum(axis=0)
        looked_at = counted.all(axis=0) & (keys != 0)
        if where is not None:
            looked_at &= where[:, k // 2] & where[:, k - 1]
        found = np.zeros(m, dtype=bool)
        for row in np.flatnonzero(looked_at).tolist():
            key = float(keys[row])
            found[row] = key in self._seen
            if len(self._seen) < _REMEMBERED:
                self._seen.add(key)
        self._note("repeated", found, frames)

    def _note_truth(
        self, x: FloatArray, y: FloatArray, where: BoolArray | None, frames: npt.NDArray[np.str_], root: list[int]
    ) -> None:
        """Count poses of which a hypothesis is the rounded truth, relative to the root, at the joints that count."""
        k, d = y.shape[1:]
        if k * d < _FEWEST_COORDINATES:
            return
        true = y.astype(x.dtype, copy=False)
        ignored = np.zeros(y.shape[:2], dtype=bool) if where is None else ~where
        shift = x[:, :, root[0], 0] - true[:, root[0], 0] if root else np.zeros((), dtype=x.dtype)
        ends = [k // 2, k - 1]
        away, left = np.abs(x[:, :, ends, 0] - true[:, ends, 0] - shift[..., None]), ignored[:, ends]
        there = np.asarray(np.isfinite(np.where(left, 0, away)).all(axis=2))
        ordered = np.sort(np.where(there[..., None], away, np.inf), axis=0)
        middle = np.minimum(there.sum(axis=0) // 2, len(x) - 1)[None, :, None]
        most = np.where(left, np.inf, np.take_along_axis(ordered, middle, axis=0)[0]).min(axis=1)
        near = np.where(np.isfinite(most), _ROUNDED * most, 0)
        may = ((away <= near[:, None]) | left).all(axis=2)
        numbers, rows = np.nonzero(may)  # few are left to look at closely
        offsets = x[numbers, rows] - true[rows]
        if root:
            offsets -= offsets[:, root[:1]]
        equal = ((np.abs(offsets) <= near[rows][:, None, None]) | ignored[rows][..., None]).all(axis=(1, 2))
        found = np.zeros(len(y), dtype=bool)
        found[rows[equal]] = True
        self._note("truth", found & ~ignored.all(axis=1), frames)


def _without_weight(scores: FloatArray | None, there: BoolArray) -> BoolArray:
    """Find hypotheses (N, m) that are there, of a score that may stand for none."""
    if scores is None:
        return np.zeros_like(there)
    found = (scores == -np.inf) & there
    if (scores >= 0).all() and (scores > 0).sum(axis=0).max() > 1:  # one above 0 marks a hypothesis
        found |= (scores == 0) & there
    return np.asarray(found)


def _differ_in_size(x: FloatArray, y: FloatArray, where: BoolArray | None) -> BoolArray:
    """Find hypotheses (N, m) that differ from the truth in the size of a triangle of joints as two units do."""
    ends = [0, y.shape[1] // 2, y.shape[1] - 1]
    size, true_size = (
        np.linalg.norm(some[..., ends, :] - some[..., [ends[-1], *ends[:-1]], :], axis=-1).sum(axis=-1)
        for some in (x, y)
    )
    found = (size > 0) & (true_size > 0) & ((size > _FACTOR * true_size) | (true_size > _FACTOR * size))
    return np.asarray(found if where is None else found & where[:, ends].all(axis=1))
