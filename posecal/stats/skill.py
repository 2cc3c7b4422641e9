"""References of skill scores: climatology, which knows nothing of the image, or another model.

A skill score is 1 - S / S_ref for a score S and that of a reference: 0 is no better than the reference, 1 is perfect.
Climatology is the reference that anyone has: hypotheses sampled from the true poses of other sequences.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import joint_keys
from posecal.data.pose_data import PoseData
from posecal.data.root import root_name
from posecal.data.stored_poses import Rows
from posecal.errors import PoseDataError, checked_integer, checked_type, option


@dataclass(frozen=True)
class ClimatologySample:
    """Hypotheses sampled from true poses.

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
    def hash(self) -> str:
        """Equal where two are drawn from the same true poses."""
        return f"{zlib.crc32(np.ascontiguousarray(self.truth).tobytes()):08x}"

    @property
    def itemsize(self) -> int:
        """Bytes of a coordinate."""
        return self.truth.dtype.itemsize

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        hypotheses: FloatArray = self.truth[self.donors[start:stop]].swapaxes(0, 1)
        return hypotheses

    def select(self, poses: Rows) -> ClimatologySample:
        """Keep some poses, by their numbers."""
        return replace(self, donors=self.donors[poses])


def climatology(pairs: PoseData, n_hypotheses: int | None = None, seed: int = 0) -> PoseData:
    """Replace the hypotheses by random true poses of other sequences.

    Parameters
    ----------
    pairs : PoseData
        M poses. Without sequences, any other pose may be sampled; never one that lacks a joint.
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
        Where there are no complete poses of other sequences, and for numbers that are none.
    """
    checked_type(pairs, "pairs", PoseData)
    n = pairs.shape[0] if n_hypotheses is None else checked_integer(n_hypotheses, "n_hypotheses", 1)
    checked_integer(seed, "seed", 0)
    m = len(pairs.truth)
    complete = np.isfinite(pairs.truth).all(axis=(1, 2))
    if pairs.where is not None:
        complete &= pairs.where.all(axis=1)
    sequence = np.unique(pairs.labels.get("sequence", np.arange(m)), return_inverse=True)[1]
    order = np.flatnonzero(complete)[np.argsort(sequence[complete], kind="stable")]
    size = np.bincount(sequence[complete], minlength=sequence.max() + 1)
    others = len(order) - size[sequence]
    if not others.all():
        what = "one sequence" if sequence.max() == 0 else "too few true poses without missing joints"
        raise PoseDataError(
            f"{pairs.names[1]}: {what}; climatology samples complete poses of other sequences. Give another file of "
            f"hypotheses as the {option('reference')}."
        )
    random = np.random.default_rng(seed)
    draws = random.integers(0, others[:, None], (m, n))
    own_first, own_size = (np.cumsum(size) - size)[sequence][:, None], size[sequence][:, None]
    donors = order[np.where(draws >= own_first, draws + own_size, draws)]  # skip the poses of one's own sequence
    sample = ClimatologySample(pairs.truth, donors)
    own: dict[str, Any] = {"scores": None, "weights": None, "log_prob": None, "dimensions": 0}  # of the model
    return pairs.replace(hypotheses=sample, **own, names=("climatology", pairs.names[1]), remarks=())


def with_reference(pairs: PoseData, reference: PoseData) -> PoseData:
    """Add the hypotheses of a reference to a model's, so that skills are reported with the metrics ``scores``.

    Parameters
    ----------
    pairs, reference : PoseData
        Of the model and of the reference, on the same poses.

    Returns
    -------
    PoseData
        The model's, with the reference.

    Raises
    ------
    PoseDataError
        Where the two are not over the same frames, joints, root and true poses, or the reference has one hypothesis or
        weights.
    """
    model, other = pairs.names[0], reference.names[0]
    if reference.shape[0] < 2:
        raise PoseDataError(f"{other}: N = 1; fair scores need at least 2. Give a reference with more hypotheses.")
    if reference.weights is not None:
        raise PoseDataError(f"{other}: has weights; expected a reference whose hypotheses all count alike.")
    if joint_keys(pairs.joints) != joint_keys(reference.joints):
        differ = sorted(set(pairs.joints) ^ set(reference.joints)) or ["their order"]
        raise PoseDataError(
            f"{other} and {model} hold other joints: {', '.join(differ)}. Score those in both with "
            f"{option('shared_joints', 'common')}, for both."
        )
    if pairs.root != reference.root:
        roots = [root_name(p.root, p.joints) for p in (reference, pairs)]
        raise PoseDataError(
            f"{other} and {model} have other root joints: {' and '.join(roots)}; expected the same. Name it for both."
        )
    if not np.array_equal(pairs.frame_id, reference.frame_id):
        first, second = pairs.frame_id, reference.frame_id
        alone = [*first[~np.isin(first, second)], *second[~np.isin(second, first)], "their order"]
        raise PoseDataError(
            f"{other} and {model} hold other frames: {len(reference.truth):,} and {len(pairs.truth):,} (first: "
            f"{alone[0]}). A skill needs both on the same frames: evaluate those in both."
        )
    if not np.array_equal(pairs.truth, reference.truth, equal_nan=True):
        raise PoseDataError(f"{other} and {model} were evaluated against different true poses; expected the same.")
    remarks = [f"{other}: {remark}" for remark in reference.remarks if remark not in pairs.remarks]
    return pairs.replace(reference=reference, remarks=(*pairs.remarks, *remarks))
