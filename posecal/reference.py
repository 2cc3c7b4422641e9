"""What would a model show that knows nothing of the image? Climatology, the reference of skill scores.

A skill score is 1 - S / S_ref for a score S and that of a reference: 0 is no better than the reference, 1 is perfect.
Climatology is the reference that anyone has: hypotheses drawn from the true poses of other sequences.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posecal.block import FloatArray
from posecal.comparison import check_same_poses
from posecal.errors import PoseDataError
from posecal.metrics.score_table import PAIRED
from posecal.pairs import PosePairs, Rows
from posecal.totals import Totals

__all__ = ["climatology", "with_skills"]


@dataclass(frozen=True)
class Drawn:
    """Hypotheses drawn from true poses.

    Attributes
    ----------
    truth : array (M, K, D)
        All true poses, mm.
    donors : array of int (M, N)
        For each pose, whose truth its hypotheses are.
    """

    truth: FloatArray
    donors: Rows

    @property
    def n_hypotheses(self) -> int:
        """N."""
        return int(self.donors.shape[1])

    @property
    def itemsize(self) -> int:
        """Bytes of a coordinate."""
        return self.truth.dtype.itemsize

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        found: FloatArray = self.truth[self.donors[start:stop]].swapaxes(0, 1)
        return found

    def taken(self, poses: Rows) -> Drawn:
        """Keep some poses, by their numbers."""
        return replace(self, donors=self.donors[poses])


def climatology(pairs: PosePairs, n_hypotheses: int | None = None, seed: int = 0) -> PosePairs:
    """Replace the hypotheses by true poses of other sequences, drawn at random.

    Parameters
    ----------
    pairs : PosePairs
        M poses. Without sequences, any other pose may be drawn.
    n_hypotheses : int, optional
        How many; as many as there were by default.
    seed : int
        Of the generator.

    Returns
    -------
    PosePairs
        The same truth with other hypotheses.

    Raises
    ------
    PoseDataError
        Where all poses are of one sequence.
    """
    n = n_hypotheses or pairs.shape[0]
    m = len(pairs.truth)
    sequence = pairs.labels.get("sequence", np.arange(m).astype(np.str_))
    _, place = np.unique(sequence, return_inverse=True)
    if place.max() == 0:
        raise PoseDataError(f"{pairs.names[1]}: one sequence; expected several to draw poses of others from.")
    random = np.random.default_rng(seed)
    order = np.argsort(place, kind="stable")
    first = np.searchsorted(place[order], np.arange(place.max() + 1))
    size = np.bincount(place)
    draws = random.integers(0, (m - size[place])[:, None], (m, n))
    own_first, own_size = first[place][:, None], size[place][:, None]
    donors = order[np.where(draws >= own_first, draws + own_size, draws)]  # over the gap that one's own sequence is
    return replace(
        pairs,
        hypotheses=Drawn(pairs.truth, donors),
        scores=None,
        names=("climatology", pairs.names[1]),
        remarks=(),
    )


def with_skills(totals: Totals, reference: Totals, name: str) -> Totals:
    """Put a reference's scores beside a model's, so that skills can be reported and saved.

    Parameters
    ----------
    totals, reference : Totals
        Of the model and of the reference, on the same poses, both with the proper scores.
    name : str
        What the reference is called.

    Returns
    -------
    Totals
        The model's, with the sums of both side by side.

    Raises
    ------
    PoseDataError
        Where the two are not over the same poses.
    """
    check_same_poses(totals, reference, "the model", name)
    if any(not np.array_equal(labels, reference.cells[label]) for label, labels in totals.cells.items()):
        raise PoseDataError(f"{name}: its poses are labelled in another way; expected the labels of the model's.")
    found = replace(totals, subject=replace(totals.subject, reference=name), sums=dict(totals.sums))
    found.counts = dict(totals.counts)
    for statistic in PAIRED:
        both = totals.sums[statistic], reference.sums[statistic]
        found.sums[f"paired_{statistic}"] = np.stack(both, axis=-1)
        found.counts[f"paired_{statistic}"] = totals.counts[statistic]
    return found
