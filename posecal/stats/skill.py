"""What would a model show that knows nothing of the image? Climatology, the reference of skill scores.

A skill score is 1 - S / S_ref for a score S and that of a reference: 0 is no better than the reference, 1 is perfect.
Climatology is the reference that anyone has: hypotheses drawn from the true poses of other sequences.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.pose_data import PoseData, Rows
from posecal.errors import PoseDataError

__all__ = ["climatology", "with_reference"]


@dataclass(frozen=True)
class ClimatologySample:
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

    def taken(self, poses: Rows) -> ClimatologySample:
        """Keep some poses, by their numbers."""
        return replace(self, donors=self.donors[poses])


def climatology(pairs: PoseData, n_hypotheses: int | None = None, seed: int = 0) -> PoseData:
    """Replace the hypotheses by true poses of other sequences, drawn at random.

    Parameters
    ----------
    pairs : PoseData
        M poses. Without sequences, any other pose may be drawn; never one that lacks a joint.
    n_hypotheses : int, optional
        How many; as many as there were by default.
    seed : int
        Of the generator.

    Returns
    -------
    PoseData
        The same truth with other hypotheses.

    Raises
    ------
    PoseDataError
        Where there are no whole poses of other sequences.
    """
    n = n_hypotheses or pairs.shape[0]
    m = len(pairs.truth)
    whole = np.isfinite(pairs.truth).all(axis=(1, 2))
    if pairs.where is not None:
        whole &= pairs.where.all(axis=1)
    sequence = pairs.labels.get("sequence", np.arange(m).astype(np.str_))
    _, place = np.unique(sequence, return_inverse=True)
    order = np.flatnonzero(whole)[np.argsort(place[whole], kind="stable")]
    size = np.bincount(place[whole], minlength=place.max() + 1)
    others = len(order) - size[place]
    if not others.all():
        what = "one sequence" if place.max() == 0 else "too few true poses without missing joints"
        raise PoseDataError(
            f"{pairs.names[1]}: {what}; climatology draws whole poses of other sequences. Give another file of "
            "hypotheses as the reference."
        )
    random = np.random.default_rng(seed)
    draws = random.integers(0, others[:, None], (m, n))
    own_first, own_size = (np.cumsum(size) - size)[place][:, None], size[place][:, None]
    donors = order[np.where(draws >= own_first, draws + own_size, draws)]  # over the gap that one's own sequence is
    return replace(
        pairs,
        hypotheses=ClimatologySample(pairs.truth, donors),
        scores=None,
        names=("climatology", pairs.names[1]),
        remarks=(),
    )


def with_reference(pairs: PoseData, reference: PoseData) -> PoseData:
    """Put the hypotheses of a reference beside a model's, so that skills are reported with the metrics ``scores``.

    Parameters
    ----------
    pairs, reference : PoseData
        Of the model and of the reference, on the same poses.

    Returns
    -------
    PoseData
        The model's, with the reference at hand.

    Raises
    ------
    PoseDataError
        Where the two are not over the same frames, joints, root and true poses, or the reference has one hypothesis.
    """
    ours, theirs = pairs.names[0], reference.names[0]
    if reference.shape[0] < 2:
        raise PoseDataError(f"{theirs}: N = 1; fair scores need at least 2. Give a reference with more hypotheses.")
    if pairs.joints != reference.joints:
        differ = sorted(set(pairs.joints) ^ set(reference.joints)) or ["their order"]
        raise PoseDataError(
            f"{theirs} and {ours} hold other joints: {', '.join(differ)}. Score those in both with --joints, for both."
        )
    if pairs.root != reference.root:
        roots = ["none" if p.root is None else p.joints[p.root] for p in (reference, pairs)]
        raise PoseDataError(
            f"{theirs} and {ours} have other root joints: {' and '.join(roots)}; expected the same. Name it for both."
        )
    if not np.array_equal(pairs.frame_id, reference.frame_id):
        alone = [frame for frame in pairs.frame_id if frame not in set(reference.frame_id)]
        alone = alone or [frame for frame in reference.frame_id if frame not in set(pairs.frame_id)] or ["their order"]
        raise PoseDataError(
            f"{theirs} and {ours} hold other frames: {len(reference.truth):,} and {len(pairs.truth):,} (first: "
            f"{alone[0]}). A skill needs both on the same frames: evaluate those in both."
        )
    if not np.array_equal(pairs.truth, reference.truth, equal_nan=True):
        raise PoseDataError(f"{theirs} and {ours} are held against different true poses; expected the same.")
    remarks = [f"{theirs}: {remark}" for remark in reference.remarks if remark not in pairs.remarks]
    return replace(pairs, reference=reference, remarks=(*pairs.remarks, *remarks))
