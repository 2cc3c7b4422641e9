"""Count of the poses whose hypotheses are one point each, or all the same."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.degenerate import FEWEST_JOINTS
from posecal.data.remarks import Count, Example, Remark

_WORDS = {
    "points": "every hypothesis is one point. Are these frames without a prediction? Leave them out",
    "same": "all hypotheses are the same. A sampler gives different ones",
}
_SHOWN = 3
"""How many frames a remark names."""


class Coinciding:
    """Poses whose hypotheses are one point each, or all the same, counted as they are read."""

    def __init__(self) -> None:
        self._counts = dict.fromkeys(_WORDS, 0)
        self._first: dict[str, list[str]] = {kind: [] for kind in _WORDS}
        self._poses, self._name = 0, ""

    def add(self, name: str, hypotheses: FloatArray, where: BoolArray | None, frames: npt.NDArray[np.str_]) -> None:
        """Look at more poses.

        Parameters
        ----------
        name : str
            What messages call the hypotheses.
        hypotheses : array (N, m, K, D)
            In any unit.
        where : bool array (m, K) or None
            The joints that count.
        frames : array of str (m,)
            Names of the m frames.
        """
        self._poses, self._name = self._poses + len(frames), name
        n, _, k, d = hypotheses.shape
        if k < FEWEST_JOINTS or d < 2:
            return
        ends = hypotheses[[0, -1]]  # few poses are left to look at closely
        suspects = np.flatnonzero(
            (ends[:, :, 0] == ends[:, :, -1]).all(axis=(0, 2)) | (ends[0] == ends[1]).all(axis=(1, 2))
        )
        if not len(suspects):
            return
        some = hypotheses[:, suspects]
        ignored = np.zeros((len(suspects), k, 1), dtype=bool) if where is None else ~where[suspects][..., None]
        points = ((some == some[:, :, :1]) | ignored).all(axis=(0, 2, 3))
        same = ((some == some[:1]) | ignored).all(axis=(0, 2, 3)) & ~points & (n > 1)
        for kind, found in (("points", points), ("same", same)):
            names = [str(frames[pose]) for pose in suspects[found][:_SHOWN]]
            self._first[kind] = [*self._first[kind], *names][:_SHOWN]
            self._counts[kind] += int(found.sum())

    def remarks(self) -> list[str]:
        """Give remarks on them."""
        return [
            Remark(
                f"{self._name}: in ",
                Count(count, "frame", of=self._poses),
                " (first: ",
                Example(", ".join(self._first[kind])),
                f") {_WORDS[kind]}.",
            )
            for kind, count in self._counts.items()
            if count
        ]
