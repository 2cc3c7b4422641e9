"""Sets of true clips that follow alike observations: what a clip might have become, as far as the data show."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray, squared_norms
from posecal.data.pose_data import PoseData
from posecal.engine.chunks import Chunk
from posecal.engine.offsets import relative_to_root
from posecal.errors import PoseDataError

_SAME = "Give clips names that no two share, or batches in the order of what was prepared."

KEY = "true clips"
"""Under which a block of a clip shares what :meth:`TrueClips.of` needs."""


@dataclass(frozen=True)
class TrueClips:
    """All true clips that are evaluated together, with the last observed pose before each.

    Attributes
    ----------
    number : dict
        The number of each clip that has all frames and joints, by its name.
    poses : array (C, T, K, D)
        Relative to the root, mm.
    observed : array (C, K, D)
        Likewise.
    names : frozenset of str
        All clips, those that lack frames or joints among them.
    """

    number: dict[str, int]
    poses: FloatArray
    observed: FloatArray
    names: frozenset[str] = frozenset()

    @property
    def hash(self) -> str:
        """Equal where two are of the same clips."""
        found = zlib.crc32(repr(self.number).encode(errors="surrogatepass"))
        for poses in (self.poses, self.observed):
            found = zlib.crc32(np.ascontiguousarray(poses).data, found)
        return f"{found:08x}"

    @classmethod
    def joined(cls, parts: Sequence[TrueClips | None]) -> TrueClips | None:
        """Put the clips of parts of a test set together, whose names differ; None where those of a part are unknown."""
        known = [part for part in parts if part is not None]
        if len(known) < len(parts):
            return None
        number = {name: row for row, name in enumerate(name for part in known for name in part.number)}
        poses, observed = (np.concatenate([getattr(part, name) for part in known]) for name in ("poses", "observed"))
        return cls(number, poses, observed, frozenset().union(*(part.names for part in known)))

    def of(self, clip: str, truth: FloatArray, threshold: float, joints: BoolArray) -> FloatArray | None:
        """Give the clips whose last observed pose is nearer than a threshold to that of a clip, which is one of them.

        Parameters
        ----------
        clip : str
            Its name.
        truth : array (T, K, D)
            Its true poses, relative to the root, mm.
        threshold : float
            A distance of whole poses, mm.
        joints : bool array (K,)
            Those that it is over.

        Returns
        -------
        array (A, T, K, D) or None
            None for a clip that lacks a frame, or a joint of one.

        Raises
        ------
        PoseDataError
            For a clip that was not among those that were prepared, or is another one of its name.
        """
        if clip not in self.names:
            raise PoseDataError(f"clip: {clip!r} is not among the {len(self.names):,} that were prepared. {_SAME}")
        if clip not in self.number:
            return None
        prepared = self.poses[self.number[clip]]
        if not np.abs(prepared - truth)[:, joints].max() <= 0.1 + 1e-4 * np.abs(prepared).max():
            raise PoseDataError(f"clip: {clip!r} has other true poses than the one that was prepared. {_SAME}")
        apart = (self.observed - self.observed[self.number[clip]])[:, joints]
        return self.poses[np.sqrt(squared_norms(apart.reshape(len(apart), -1, 1))[:, 0]) < threshold]


def true_clips(data: PoseData) -> TrueClips | None:
    """Give the true clips that have all frames and joints; None where the last observed poses are not known."""
    if data.clips is None or not data.clips.observed:
        return None
    clip, length = data.labels["clip"], data.clips.length
    starts = np.concatenate([[0], np.flatnonzero(clip[1:] != clip[:-1]) + 1])
    stops = np.append(starts[1:], len(clip))
    where = np.ones(data.truth.shape[:2], dtype=bool) if data.where is None else data.where
    whole: BoolArray = np.asarray(where.all(axis=1))
    follows = np.concatenate([[True], np.diff(data.order) == 1])
    kept = {
        str(clip[start]): start
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True)
        if stop - start == length and whole[start:stop].all() and follows[start + 1 : stop].all()
    }
    rows = np.array([*kept.values()], dtype=np.intp)[:, None] + np.arange(length)
    observed = np.array([data.clips.observed[name] for name in kept]).reshape(-1, *data.truth.shape[1:])
    poses = relative_to_root(data.truth, data.root, np.dtype(np.float64))[rows]
    number = {name: row for row, name in enumerate(kept)}
    names = frozenset(np.unique(clip).tolist())
    return TrueClips(number, poses, relative_to_root(observed, data.root, np.dtype(np.float64)), names)


def clip_of(chunk: Chunk) -> str:
    """Name the clip of poses that form one."""
    return "" if chunk.clip is None else str(chunk.clip[0])
